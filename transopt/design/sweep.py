"""Entries of varied scenes: each solved, certified and replayed, what cannot be told apart from what falls short.

A task is a handful of entries of one grip that can share work: stage models and references are kept from task to
task, and what has the same device is replayed together. Tasks and outcomes are plain values, for any executor.
"""

import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Generic, TypeVar

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.design.entry import Baselines, played_with_rivals, replayed
from transopt.design.intensity import best
from transopt.design.optimum import Designed
from transopt.design.posed import entry_problem, scene_stage
from transopt.design.price import prices
from transopt.design.verify import admit
from transopt.plant.discretise import StageModel
from transopt.problem.answer import Status
from transopt.problem.limits import KINDS
from transopt.problem.limits.limit import Limit
from transopt.problem.limits.supply import SupplyLimit
from transopt.problem.objective.bands import pacinian_dB
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import binding_limits, boxes_of
from transopt.proof.replay import Replay
from transopt.recordings.recording import Recording
from transopt.recordings.reference import Reference, between
from transopt.scene.keys import Changes, with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

REFUSED = "REFUSED"  # beside the names of Status: the scene itself cannot be
DEFECT = "DEFECT"  # a solve that ended in an exception that no input should cause
KEPT_REFERENCES, KEPT_BETWEEN, KEPT_STAGES = 8, 32, 64
NAN = float("nan")
T = TypeVar("T")


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
    energy_dB, pacinian_dB : energy over the recorded tap's, as the scene counts it and as it is felt.
    waveform_dB : the same as `energy_dB` of the nearest waveform; what it is where the scene asks for no energy.
    intensity : lam, the price of the energy; 0 where the scene asks for none, or the nearest waveform has it.
    relative_gap, relative_bound, violation_A, violation_V, violation_K : certificate.
    multipliers : column of a limit (`multiplier_column`) -> its largest multiplier.
    binding : which limits bind, from when to when.
    price : what more of each binding limit would buy; with it the baselines at the transient limit.
    solve_ms : of the solver; total_ms : with certificate and share of the replay.
    """

    index: int
    speed_m_s: float
    grip_N: float
    target: str
    status: str
    nrmse: float = NAN
    floor: float = NAN
    weighted_nrmse: float = NAN
    energy_dB: float = NAN
    pacinian_dB: float = NAN
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
    nrmse_seed: float = NAN
    nrmse_clipped: float = NAN
    binding: str = ""
    price: str = ""
    solver: str = ""
    reason: str = ""
    solve_ms: float = NAN
    total_ms: float = NAN


class _Kept(Generic[T]):
    """The values made last, by key."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._values: OrderedDict[str, T] = OrderedDict()

    def get(self, key: str, make: Callable[[], T]) -> T:
        if key not in self._values:
            self._values[key] = make()
            if len(self._values) > self._most:
                self._values.popitem(last=False)
        self._values.move_to_end(key)
        return self._values[key]


_references: _Kept[list[Reference]] = _Kept(KEPT_REFERENCES)
_between: _Kept[Reference] = _Kept(KEPT_BETWEEN)
_stages: _Kept[StageModel] = _Kept(KEPT_STAGES)
# CasADi's solver objects are shared by all problems of a shape, and reading how one ended after another thread has
# called it again would tell of the wrong problem.
_one_at_a_time = threading.Lock()


def _text(scene: Scene, *parts: str) -> str:
    return json.dumps(scene.model_dump(include=set(parts), mode="json"), sort_keys=True)


def _device(scene: Scene, grip_N: float) -> str:
    """Everything that the stage model and its time axis depend on."""
    parts = ("model", "motor", "transmission", "tip", "amplifier", "time", "feedback")
    return f"{grip_N!r} {_text(scene, *parts)}"


def _stage(scene: Scene, grip_N: float) -> StageModel:
    return _stages.get(_device(scene, grip_N), lambda: scene_stage(scene, grip_N))


class _Point:
    """One scene of a task: what all its entries have in common, found when it is first asked for."""

    def __init__(self, task: Task, scene: Scene) -> None:
        self.task, self.scene = task, scene

    @cached_property
    def references(self) -> list[Reference]:
        """References of all recorded speeds, or of all targets."""
        task = self.task
        recorded = self.scene.model_copy(update={"grid": task.scene.grid})
        return _references.get(self._of_references, lambda: references_of(recorded, task.recordings))

    @cached_property
    def _of_references(self) -> str:
        """Everything that the references depend on."""
        task, scene = self.task, self.scene
        recorded = _text(scene, "recordings", "targets")
        return f"{task.source} {scene.time_grid()} {recorded} {task.scene.grid.speeds_m_s}"

    def reference(self, item: Item) -> Reference:
        if item.target:
            return next(reference for reference in self.references if reference.name == item.target)
        references = self.references
        return _between.get(f"{self._of_references} {item.speed_m_s!r}", lambda: between(references, item.speed_m_s))

    @cached_property
    def stage(self) -> StageModel:
        return _stage(self.scene, self.task.grip_N)

    @cached_property
    def spread(self) -> tuple[StageModel, ...]:
        return tuple(_stage(of, grip) for of, grip in self.scene.spread(self.task.grip_N))

    @cached_property
    def _plays_on(self) -> str:
        scene = self.scene
        return f"{_device(scene, self.task.grip_N)} {scene.coil()} {scene.thermal.tap_rate_Hz}"

    def played_with(self, problem: TransientProblem) -> str:
        """What entries must have in common to be replayed together."""
        parts = ([limit.name for limit in problem.limits], problem.wall is None)
        return f"{self._plays_on} {parts}"


@dataclass(frozen=True)
class _Solved:
    item: Item
    point: _Point
    designed: Designed
    spent_s: float


def _solved(task: Task, item: Item, points: dict[int, _Point]) -> _Solved:
    start = time.perf_counter()
    if item.point not in points:
        points[item.point] = _Point(task, with_values(task.scene, task.points[item.point]))
    point = points[item.point]
    problem = entry_problem(point.scene, point.stage, point.reference(item), point.spread)
    designed = best(problem, task.options, objective=point.scene.weights.objective)
    return _Solved(item, point, designed, time.perf_counter() - start)


def multiplier_column(kind: type[Limit]) -> str:
    """Name of a limit's column among the rows of a study."""
    return f"mu_{kind.label}_1_{kind.base_unit()}"


MULTIPLIER_COLUMNS = {kind.label: multiplier_column(kind) for kind in KINDS}


def _largest(designed: Designed) -> dict[str, float]:
    """Largest multiplier of each limit that the problem has."""
    found: dict[str, float] = {}
    for box in boxes_of(designed.effect, designed.solution.multipliers):
        name = multiplier_column(type(box.limit))
        found[name] = max(found.get(name, 0.0), float(box.by_upper.max()), float(box.by_lower.max()))
    return found


def _intensity(designed: Designed, predicted_m_s2: FloatArray) -> dict[str, float]:
    """The columns of an outcome that say how strong the tap is; none of a zero reference."""
    problem, attained = designed.problem, designed.attained
    if problem.reference_is_zero:
        return {}
    made_dB = problem.tracking.energy_dB(designed.effect.accelerations_m_s2)
    return {
        "energy_dB": made_dB,
        "pacinian_dB": pacinian_dB(predicted_m_s2, problem.reference_m_s2, problem.grid.dt_s),
        "waveform_dB": made_dB if attained is None else attained.waveform_dB,
        "intensity": problem.intensity,
    }


def _outcome(task: Task, solved: _Solved, played: Replay, rivals: Baselines | None, replay_s: float) -> Outcome:
    start = time.perf_counter()
    designed, item = solved.designed, solved.item
    problem, answer, proof = designed.problem, designed.solution, designed.certificate
    command, predicted = answer.command, designed.effect.motion.acceleration_m_s2
    status, shortfalls = admit(answer.status, proof, played, problem, command, predicted)
    finite = bool(np.all(np.isfinite(command)))
    price = ""
    if task.rivals and status is Status.OPTIMAL:
        free, effect = designed.unlimited_command, designed.effect
        found = prices(problem, command, answer.multipliers, free, task.options, effect=effect)
        price = "; ".join(one.sentence for one in found)
    return Outcome(
        index=item.index,
        speed_m_s=item.speed_m_s,
        grip_N=task.grip_N,
        target=item.target,
        status=status.name,
        nrmse=played.nrmse,
        floor=designed.floor,
        weighted_nrmse=played.nrmse if problem.reference_is_zero else problem.tracking.nrmse(predicted),
        **_intensity(designed, predicted),
        free_peak=designed.free_peak,
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
        multipliers=_largest(designed) if finite else {},
        nrmse_seed=NAN if rivals is None else rivals.seed,
        nrmse_clipped=NAN if rivals is None else rivals.clipped,
        binding=binding_limits(problem, command, answer.multipliers, effect=designed.effect) if finite else "",
        price=price,
        solver=answer.solver,
        reason="; ".join(designed.remarks or shortfalls),
        solve_ms=1e3 * answer.solve_time_s,
        total_ms=1e3 * (solved.spent_s + replay_s + time.perf_counter() - start),
    )


def _guarded(items: Sequence[Item], task: Task, work: Callable[[], T]) -> tuple[T | None, list[Outcome]]:
    """What the work gives, or an outcome for each of its items that tells why it gives nothing."""

    def ended(status: str, reason: str) -> list[Outcome]:
        said = " ".join(reason.split())
        return [Outcome(i.index, i.speed_m_s, task.grip_N, i.target, status, reason=said) for i in items]

    try:
        return work(), []
    except InputError as error:
        return None, ended(REFUSED, str(error))
    except Exception as error:  # one entry must not take thousands with it: it is told, by name, in its row
        return None, ended(DEFECT, f"{type(error).__name__}: {error}"[:300])


@one_blas_thread()
def run_task(task: Task) -> list[Outcome]:
    """Every entry of a task, in the order of its items; never raises for what an entry does."""
    with _one_at_a_time:
        return _run(task)


def _run(task: Task) -> list[Outcome]:
    outcomes: list[Outcome] = []
    together: dict[str, list[_Solved]] = {}
    points: dict[int, _Point] = {}
    for item in task.items:
        solved, refused = _guarded([item], task, partial(_solved, task, item, points))
        outcomes += refused
        if solved is not None:
            together.setdefault(solved.point.played_with(solved.designed.problem), []).append(solved)
    for group in together.values():
        finished, refused = _guarded([s.item for s in group], task, partial(_finished, task, group))
        outcomes += refused if finished is None else finished
    place = {item.index: j for j, item in enumerate(task.items)}
    return sorted(outcomes, key=lambda outcome: place[outcome.index])


def _finished(task: Task, group: Sequence[_Solved]) -> list[Outcome]:
    start = time.perf_counter()
    scene, designed = group[0].point.scene, [solved.designed for solved in group]
    rivals: Sequence[Baselines | None] = [None] * len(designed)
    if task.rivals:
        replays, rivals = played_with_rivals(scene.limits.steady_input, scene.coil(), designed)
    else:
        replays = replayed(scene.coil(), designed)
    share = (time.perf_counter() - start) / len(group)
    return [
        _outcome(task, solved, played, baselines, share)
        for solved, played, baselines in zip(group, replays, rivals, strict=True)
    ]
