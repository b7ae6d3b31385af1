"""Every entry of a library made again from its file alone: certified, replayed, every stated figure recomputed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from transopt.base.threads import one_blas_thread
from transopt.design.batch import Batch
from transopt.design.entry import Entry
from transopt.design.optimum import optimum
from transopt.library.library import Library
from transopt.library.multipliers import ARRAYS
from transopt.library.nonlinear import as_on_linear, nonlinear_problem
from transopt.library.nonlinear_proven import certificate_of, of_linear_design, shortfall
from transopt.library.proven import contradictions
from transopt.plant.discretise import StageModel
from transopt.plant.nonlinear import NonlinearCoil
from transopt.problem.answer import Certificate, Multipliers, Solution, Status
from transopt.problem.limits.limit import tolerated
from transopt.problem.problem import TransientProblem
from transopt.proof.admit import admit
from transopt.proof.certify import Effect, certify
from transopt.proof.designed import Designed
from transopt.solvers import unlimited
from transopt.solvers.choose import prove
from transopt.solvers.options import SolverOptions

STORED_TOLERANCE = 1e-6  # relative, to which stored figures agree with recomputed ones
ROUNDING = 1e-9  # absolute, for figures that are zero


@one_blas_thread()
@np.errstate(all="ignore")  # what overflows is found as not finite, and said
def verify_library(library: Library, progress: Callable[[int], None] = lambda done: None) -> list[Entry]:
    """Certify and replay every entry from the file alone.

    Only the floor takes a (linear) solve and, where the temperature binds, the lower bound a convex one; on a
    nonlinear plant the linear design is solved besides.

    Parameters
    ----------
    progress : called with the number of entries that have just been checked.

    Returns
    -------
    Entries made again, speeds outermost, and behind them those of the cool commands; one is clean where
    `shortfalls` is empty.

    Raises
    ------
    InputError : a file whose numbers make no problem.
    """
    first = _verified(library, progress)
    return first if library.cool is None else first + _verified(library.cool, progress)


def _verified(library: Library, progress: Callable[[int], None]) -> list[Entry]:
    nv, ng, _ = library.command.shape
    plant = library.scene().nonlinear_plant() if library.nonlinear else None
    checked: dict[tuple[int, int], Entry] = {}
    for ig in range(ng):
        stage = library.stage(ig)
        designed = [_again(library, iv, ig, stage, plant) for iv in range(nv)]
        told = [library.told(iv, ig) for iv in range(nv)]
        # A device with a wall plays the file's transient on top of its own feedback.
        played = library.command if library.wall() is None else library.transient_command
        batch = Batch(designed, library.coil(), library.steady_input, told, played[:, ig])
        for iv in range(nv):
            entry = _entry(library, iv, ig, batch)
            found = (
                _of_nonlinear_plant(library, iv, ig, entry)
                if library.nonlinear
                else _of_linear_plant(library, iv, ig, entry)
            )
            checked[iv, ig] = entry.stating(shortfalls=found)
            progress(1)
    return [checked[iv, ig] for iv in range(nv) for ig in range(ng)]


def _again(library: Library, iv: int, ig: int, stage: StageModel, plant: NonlinearCoil | None) -> Designed:
    """The answer that the file states, proven anew."""
    problem, command, options = library.problem(iv, ig, stage), library.command[iv, ig], SolverOptions()
    multipliers, claimed = library.multipliers(iv, ig), str(library.status[iv, ig])
    accepted = Status.OPTIMAL if plant is None else Status.STATIONARY
    status = Status.OPTIMAL if claimed == accepted.value else Status.NOT_CERTIFIED
    answer = Solution(status, command, multipliers, "", claimed, 0, float(library.solve_time_s[iv, ig]))
    if plant is None:
        effect = Effect(problem, command)
        return _bare(problem, answer, prove(problem, command, multipliers, options, effect=effect), effect)
    nonlinear = nonlinear_problem(library, iv, ig, plant)
    on_plant = nonlinear.effect(command)
    found = _bare(problem, answer, certificate_of(library, iv, ig, on_plant), as_on_linear(on_plant))
    # The file has no multipliers of the linear design, so that its certificate proves no more than its limits.
    none, at_rest = Multipliers.zero(problem), Effect(problem, library.linear_command[iv, ig])
    proof = certify(problem, at_rest.command, none, effect=at_rest)
    stated = Solution(Status.NOT_CERTIFIED, at_rest.command, none, "", "", 0, 0.0)
    return replace(
        found, nonlinear=nonlinear, linear=replace(found, solution=stated, certificate=proof, effect=at_rest)
    )


def _bare(problem: TransientProblem, answer: Solution, proof: Certificate, effect: Effect) -> Designed:
    """An answer with its proof, and the optimum without limits beside it."""
    free = np.zeros(problem.grid.stages)
    if not problem.reference_is_zero:
        free = unlimited.solve(problem.without_intensity()).command
    motion = problem.stage.motion(free)
    floor = problem.yardstick.tap_error(problem.target, motion.acceleration_m_s2)
    peak = float(np.abs(motion.plant_input).max())
    return Designed(problem, answer, proof, effect, free, floor, peak, {}, None, [])


def _entry(library: Library, iv: int, ig: int, batch: Batch) -> Entry:
    repeats, targets = library.meta["repeatability"][iv][ig], library.axes.targets
    return Entry(
        speed_m_s=float(library.speeds_m_s[iv]),
        grip_N=float(library.grips_N[ig]),
        target=targets[iv] if targets else "",
        designed=batch.designed[iv],
        batch=batch,
        index=iv,
        repeatability=float("nan") if repeats is None else float(repeats),
        options=SolverOptions(),
        objective=library.posing().objective,
    )


def _of_linear_plant(library: Library, iv: int, ig: int, entry: Entry) -> list[str]:
    """What speaks against an entry."""
    effect = entry.designed.effect
    found = [f"status in the file: {library.status[iv, ig]}"]
    if entry.solution.status is Status.OPTIMAL:
        # The prediction that the replay is held against is the file's.
        motion = replace(effect.motion, acceleration_m_s2=library.acceleration_m_s2[iv, ig])
        stated = replace(entry.designed, effect=Effect(entry.problem, effect.command, motion))
        found = list(admit(stated, entry.played)[1])
    return found + _stored_contradictions(library, iv, ig, entry, effect)


def _of_nonlinear_plant(library: Library, iv: int, ig: int, entry: Entry) -> list[str]:
    """What speaks against an entry on a nonlinear plant, or against the linear design beside it."""
    problem, effect, proof = entry.designed.nonlinear, entry.designed.effect, entry.certificate
    assert problem is not None
    assert entry.linear_command is not None
    said = shortfall(library, iv, ig, proof)
    found = [said] if said else []
    found += entry.played.shortfalls(entry.problem, effect.command, library.acceleration_m_s2[iv, ig])
    if proof.finite:
        found += _stored_contradictions(library, iv, ig, entry, effect)
    found += of_linear_design(library, iv, ig, problem, entry.linear_tap_error, STORED_TOLERANCE)
    options = SolverOptions()
    designed = optimum(problem.linear, options)
    # Limits that no command meets at rest may be met on the nonlinear plant: then there is no linear design.
    if designed.is_proven:
        proof = prove(designed.problem, entry.linear_command, designed.solution.multipliers, options)
        if not proof.is_stationary:
            found.append(
                "linear_command is not the optimum of the plant at rest: its gap is "
                f"{proof.relative_gap:.1e}, limit {proof.GAP_TOLERANCE:.0e}"
            )
    return found


def _stored_contradictions(library: Library, iv: int, ig: int, entry: Entry, effect: Effect) -> list[str]:
    """Figures in the file that do not follow from the waveform in the file.

    Parameters
    ----------
    effect : of the entry's command.
    """
    problem, played, certificate = entry.problem, entry.played, entry.certificate
    found = []
    for name, array in ARRAYS.items():
        if array.made is None or not array.replayed:
            continue
        stored, value = getattr(library, name)[iv, ig], array.made(entry)
        if np.ndim(value):
            off = float(np.abs(stored - value).max(initial=0.0))
            if not off <= STORED_TOLERANCE * max(float(np.abs(value).max(initial=0.0)), ROUNDING):
                found.append(f"{name} is off by {off:.3g}")
        elif not np.isclose(stored, value, rtol=STORED_TOLERANCE, atol=ROUNDING, equal_nan=True):
            found.append(f"{name} says {stored:.8g}, recomputed {value:.8g}")
    found += contradictions(library, iv, ig, effect, certificate, entry.floor, of_bound=Certificate.GAP_TOLERANCE)
    current_off = float(np.abs(library.plant_input[iv, ig] - played.plant_input).max())
    if not current_off <= tolerated(problem.limits.input_limit):
        found.append(f"plant_input differs from the replay by {current_off:.1e} {library.driven_by.unit}")
    return found
