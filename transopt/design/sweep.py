"""Entries of varied scenes: each solved, certified and replayed, what cannot be told apart from what falls short.

A task is a handful of entries of one grip that can share work: stage models and references are kept from task to
task, and what has the same device is replayed together. Tasks and outcomes are plain values, for any executor.
"""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from transopt.base.errors import InputError
from transopt.base.threads import one_blas_thread
from transopt.design.context import KEPT_STAGES, OF_A_STAGE, Context, Kept, Posed, as_text
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.plant.discretise import StageModel
from transopt.problem.limits import KINDS
from transopt.problem.limits.limit import Limit
from transopt.problem.limits.supply import SupplyLimit
from transopt.proof.certify import boxes_of
from transopt.recordings.recording import Recording
from transopt.recordings.references import References
from transopt.scene.keys import Changes, with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

REFUSED = "REFUSED"  # beside the names of Status: the scene itself cannot be
DEFECT = "DEFECT"  # a solve that ended in an exception that no input should cause
KEPT_REFERENCES = 8
NAN = float("nan")


@dataclass(frozen=True)
class Item:
    """One entry of a task: `index` is the caller's, `point` the place of its changes in the task.

    It is for a speed, or for the target of that name.
    """

    index: int
    point: int
    speed_m_s: float
    target: str = ""


@dataclass(frozen=True)
class Task:
    """Entries of one grip.

    Attributes
    ----------
    scene : with nothing changed; its grid has the recorded speeds. points : changes of keys.
    recordings : for all of its points. source : names them; what is kept of them is kept under this name.
    rivals : whether the baselines and the prices of the limits are wanted too, which cost more than the optimum.
    """

    scene: Scene
    recordings: tuple[Recording, ...]
    source: str
    grip_N: float
    points: tuple[Changes, ...]
    items: tuple[Item, ...]
    options: SolverOptions
    rivals: bool = False


@dataclass(frozen=True)
class Outcome:
    """One entry; NaN and empty text where there is nothing to say.

    Attributes
    ----------
    status : name of a `Status`, REFUSED or DEFECT. reason : why it is not OPTIMAL.
    energy_dB : energy in the last term of the error over the target's.
    waveform_dB : the same as `energy_dB` of the nearest waveform; what it is where the scene asks for no energy.
    intensity : lam, the price of the energy; 0 where the scene asks for none, or the nearest waveform has it.
    relative_gap, relative_bound, violation_A, violation_V, violation_K : certificate.
    multipliers : column of a limit (`multiplier_column`) -> its largest multiplier.
    binding : which limits bind, from when to when.
    price : what more of each binding limit would buy; with it the baselines at the transient limit.
    solve_ms : of the solver; total_ms : share of the entry in the time of its task.
    """

    index: int
    speed_m_s: float
    grip_N: float
    target: str
    status: str
    tap_error: float = NAN
    floor: float = NAN
    felt_error: float = NAN
    felt_dB: float = NAN
    speed_change: float = NAN
    bump_m_s2: float = NAN
    heat_A2_s: float = NAN
    energy_dB: float = NAN
    waveform_dB: float = NAN
    intensity: float = NAN
    free_peak: float = NAN
    peak_input: float = NAN
    peak_command: float = NAN
    peak_temperature_C: float = NAN
    peak_voltage_V: float = NAN
    objective: float = NAN
    relative_gap: float = NAN
    relative_bound: float = NAN
    violation_A: float = NAN
    violation_V: float = NAN
    violation_K: float = NAN
    multipliers: Mapping[str, float] = field(default_factory=dict)
    tap_error_seed: float = NAN
    tap_error_clipped: float = NAN
    binding: str = ""
    price: str = ""
    solver: str = ""
    reason: str = ""
    solve_ms: float = NAN
    total_ms: float = NAN


_references: Kept[References] = Kept(KEPT_REFERENCES)
_stages: Kept[StageModel] = Kept(KEPT_STAGES)
# CasADi's solver objects are shared by all problems of a shape, and reading how one ended after another thread has
# called it again would tell of the wrong problem.
_one_at_a_time = threading.Lock()


def _context(task: Task, changes: Changes) -> Context:
    """One scene of a task; what it shares with the others of its device or of its recordings is kept."""
    scene = with_values(task.scene, changes)
    recorded = scene.model_copy(update={"grid": task.scene.grid})
    of = as_text(recorded, "recordings", "targets", "grid", "hand", *OF_A_STAGE)
    key = f"{task.source} {scene.time_grid()} {of}"
    return Context(scene, lambda: _references.get(key, lambda: references_of(recorded, task.recordings)), _stages)


def multiplier_column(kind: type[Limit]) -> str:
    """Name of a limit's column among the rows of a study."""
    return f"mu_{kind.label}_1_{kind.base_unit()}"


MULTIPLIER_COLUMNS = {kind.label: multiplier_column(kind) for kind in KINDS}


def _largest(entry: Entry) -> dict[str, float]:
    """Largest multiplier of each limit that the problem has."""
    found: dict[str, float] = {}
    for box in boxes_of(entry.designed.effect, entry.solution.multipliers):
        name = multiplier_column(type(box.limit))
        found[name] = max(found.get(name, 0.0), float(box.by_upper.max()), float(box.by_lower.max()))
    return found


def _intensity(entry: Entry) -> dict[str, float]:
    """The columns of an outcome that say how strong the tap is; none of a zero reference."""
    problem, attained = entry.problem, entry.attained
    if problem.reference_is_zero:
        return {}
    made_dB = problem.tracking.energy_dB(entry.designed.effect.accelerations_m_s2)
    return {
        "energy_dB": made_dB,
        "waveform_dB": made_dB if attained is None else attained.waveform_dB,
        "intensity": problem.intensity,
    }


def _outcome(task: Task, item: Item, entry: Entry) -> Outcome:
    played, proof, figures = entry.played, entry.certificate, entry.figures
    finite = bool(np.all(np.isfinite(entry.solution.command)))
    return Outcome(
        index=item.index,
        speed_m_s=item.speed_m_s,
        grip_N=task.grip_N,
        target=item.target,
        status=entry.status.name,
        tap_error=figures.tap_error,
        felt_error=figures.felt_error,
        felt_dB=figures.felt_dB,
        speed_change=figures.speed,
        bump_m_s2=figures.bump_m_s2,
        heat_A2_s=entry.heat_A2_s,
        floor=entry.floor,
        **_intensity(entry),
        free_peak=entry.free_peak,
        peak_input=played.peak_input,
        peak_command=played.peak_command,
        peak_temperature_C=played.winding_C,
        peak_voltage_V=played.reached.get(SupplyLimit.name, NAN),
        objective=proof.objective,
        relative_gap=proof.relative_gap,
        relative_bound=proof.relative_bound,
        violation_A=proof.violation("A"),
        violation_V=proof.violation("V"),
        violation_K=proof.violation("K"),
        multipliers=_largest(entry) if finite else {},
        tap_error_seed=entry.baselines.seed.tap_error if task.rivals else NAN,
        tap_error_clipped=entry.baselines.clipped.tap_error if task.rivals else NAN,
        binding=entry.binding,
        price="; ".join(one.sentence for one in entry.prices) if task.rivals else "",
        solver=entry.solution.solver,
        reason="; ".join(entry.shortfalls),
        solve_ms=1e3 * entry.solution.solve_time_s,
    )


def _ended(task: Task, item: Item, error: Exception) -> Outcome:
    """What tells that an item has no entry, and why."""
    if isinstance(error, InputError):
        status, reason = REFUSED, str(error)
    else:  # one entry must not take thousands with it: it is told, by name, in its row
        status, reason = DEFECT, f"{type(error).__name__}: {error}"[:300]
    said = " ".join(reason.split())
    return Outcome(item.index, item.speed_m_s, task.grip_N, item.target, status, reason=said)


@one_blas_thread()
def run_task(task: Task) -> list[Outcome]:
    """Every entry of a task, in the order of its items; never raises for what an entry does."""
    with _one_at_a_time:
        return _run(task)


def _run(task: Task) -> list[Outcome]:
    start = time.perf_counter()
    outcomes: list[Outcome | None] = []
    items: list[tuple[int, Item]] = []
    posed: list[Posed] = []
    contexts: dict[int, Context] = {}
    for place, item in enumerate(task.items):
        outcomes.append(None)
        try:
            if item.point not in contexts:
                contexts[item.point] = _context(task, task.points[item.point])
            posed.append(contexts[item.point].posed(item.speed_m_s, task.grip_N, item.target))
        except Exception as error:
            outcomes[place] = _ended(task, item, error)
        else:
            items.append((place, item))
    failed: dict[int, Exception] = {}

    def tell(which: Posed, error: Exception) -> None:
        failed[id(which)] = error

    entries = iter(design(posed, rivals=task.rivals, options=task.options, failed=tell))
    for (place, item), one in zip(items, posed, strict=True):
        if id(one) in failed:
            outcomes[place] = _ended(task, item, failed[id(one)])
            continue
        entry = next(entries)
        try:
            outcomes[place] = _outcome(task, item, entry)
        except Exception as error:
            outcomes[place] = _ended(task, item, error)
    share_ms = 1e3 * (time.perf_counter() - start) / len(task.items)
    return [
        replace(outcome, total_ms=share_ms if outcome.solver else NAN) for outcome in outcomes if outcome is not None
    ]
