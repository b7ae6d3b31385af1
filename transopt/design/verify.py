"""Verify a library from its file alone: every entry certified and replayed again, every stored figure recomputed."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.design.batch import Batch
from transopt.design.design import SOLVED_TOGETHER
from transopt.design.entry import Entry
from transopt.design.optimum import optimum
from transopt.library.answered import answers_of, uncorrected_of
from transopt.library.library import Library
from transopt.library.proven import departures
from transopt.problem.answer import Certificate, Multipliers, Status
from transopt.problem.limits.limit import tolerated
from transopt.problem.problem import TransientProblem
from transopt.proof.admit import admit
from transopt.proof.certify import certify_all
from transopt.proof.designed import Designed
from transopt.proof.effect import Effect
from transopt.solvers import unlimited
from transopt.solvers.choose import prove, prove_all
from transopt.solvers.options import SolverOptions


@one_blas_thread()
@np.errstate(all="ignore")  # overflow in a damaged file is reported as a non-finite value instead
def verify_library(library: Library, progress: Callable[[int], None] = lambda done: None) -> list[Entry]:
    """Certify and replay every entry from the file alone.

    Nothing is solved, with three exceptions: the floor takes a linear solve; where the temperature binds, the lower
    bound takes a convex one; and on a nonlinear plant the linear design is solved too.

    Parameters
    ----------
    progress : called with the number of entries that have just been checked.

    Returns
    -------
    Recomputed entries, speeds outermost, followed by those of the cool commands; an entry passes if its `shortfalls`
    are empty.

    Raises
    ------
    InputError : a file whose numbers define no valid problem.
    """
    first = _verified(library, progress)
    return first if library.cool is None else first + _verified(library.cool, progress)


def _verified(library: Library, progress: Callable[[int], None]) -> list[Entry]:
    nv, ng = library.command.shape[:2]
    options, checked = SolverOptions(), dict[tuple[int, int], Entry]()

    def proofs(answers: Sequence[tuple[Effect, Multipliers]]) -> list[Certificate]:
        # `certify_all` is an adjoint in Python, which shares no stage data with the solver.
        return prove_all(answers, options, certify_all)

    def free(problems: Sequence[TransientProblem]) -> list[FloatArray | None]:
        return [solution.command for solution in unlimited.solve(problems)]

    some, found = max(SOLVED_TOGETHER // nv, 1), list[Designed]()
    for ig in range(ng):
        if not found:
            found = answers_of(library, range(ig, min(ig + some, ng)), proofs, free)
        designed, found = found[:nv], found[nv:]
        uncorrected = [uncorrected_of(library, iv, ig, designed[iv].problem) for iv in range(nv)]
        # A device with a wall adds the file's transient to its own feedback.
        played = library.command if library.wall() is None else library.transient_command
        batch = Batch(designed, library.coil(), library.steady_input, uncorrected, played[:, ig])
        entries = {iv: _entry(library, iv, ig, batch, options) for iv in range(nv)}
        off = departures(library, ig, entries, replayed=True, of_bound=Certificate.GAP_TOLERANCE)
        for iv, entry in entries.items():
            checked[iv, ig] = entry.stating(shortfalls=_shortfalls(library, iv, ig, entry, off[iv]))
            progress(1)
        for entry in entries.values():
            entry.let_go()
    return [checked[iv, ig] for iv in range(nv) for ig in range(ng)]


def _entry(library: Library, iv: int, ig: int, batch: Batch, options: SolverOptions) -> Entry:
    repeats, targets = library.meta["repeatability"][iv][ig], library.axes.targets
    return Entry(
        speed_m_s=float(library.speeds_m_s[iv]),
        grip_N=float(library.grips_N[ig]),
        target=targets[iv] if targets else "",
        designed=batch.designed[iv],
        batch=batch,
        index=iv,
        repeatability=float("nan") if repeats is None else float(repeats),
        options=options,
        objective=library.posing().objective,
    )


def _shortfalls(library: Library, iv: int, ig: int, entry: Entry, off: Sequence[str]) -> list[str]:
    """Reasons against an entry, or against the linear design stored beside it; empty if it passes.

    Parameters
    ----------
    off : its `departures`.
    """
    designed, played = entry.designed, entry.played
    found = [f"status in the file: {library.status[iv, ig]}"]
    if entry.solution.status is Status.OPTIMAL:
        # The replay is compared with the prediction stored in the file.
        motion = replace(designed.effect.motion, acceleration_m_s2=library.acceleration_m_s2[iv, ig])
        stated = replace(designed, effect=Effect(entry.problem, designed.effect.command, motion))
        status, reasons = admit(stated, played)
        found = list(reasons)
        if status is Status.STATIONARY and library.status[iv, ig] == Status.OPTIMAL.value:
            found = [f"status in the file: {Status.OPTIMAL.value}; proven is: {status.value}"]
    found += off
    beside = float(np.abs(library.plant_input[iv, ig] - played.plant_input).max())
    if not beside <= tolerated(entry.problem.limits.input_limit):
        found.append(f"plant_input differs from the replay by {beside:.1e} {entry.unit}")
    return found + ([] if designed.nonlinear is None else _of_linear_design(entry))


def _of_linear_design(entry: Entry) -> list[str]:
    """Reasons against a stored linear design: it has to be the optimum for the plant at rest."""
    assert entry.designed.nonlinear is not None
    assert entry.linear_command is not None
    designed = optimum(entry.designed.nonlinear.linear, entry.options)
    # Limits that are infeasible for the plant at rest may be feasible on the nonlinear one: no linear design then.
    if not designed.is_proven:
        return []
    proof = prove(designed.problem, entry.linear_command, designed.solution.multipliers, entry.options)
    if proof.is_stationary:
        return []
    return [
        f"linear_command is not the optimum of the plant at rest: its gap is {proof.relative_gap:.1e}, limit "
        f"{proof.GAP_TOLERANCE:.0e}"
    ]
