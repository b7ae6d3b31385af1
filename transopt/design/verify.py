"""Admission of entries, when a library is built and whenever it is checked again."""

from dataclasses import dataclass

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.design.explain import stated_wall, unstable_wall
from transopt.library.columns import TableRow
from transopt.library.library import Library
from transopt.library.proven import contradictions, rivals_misstated
from transopt.plant.continuous import after_s
from transopt.problem.answer import Certificate, Status
from transopt.problem.leave_out import encoder_course, pressing
from transopt.problem.limits.limit import Limit, tolerated
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import Effect
from transopt.proof.replay import Replay, replay
from transopt.solvers import unlimited
from transopt.solvers.choose import prove
from transopt.solvers.options import SolverOptions

STORED_TOLERANCE = 1e-6  # relative, to which stored figures agree with recomputed ones
ROUNDING = 1e-9  # absolute, for figures that are zero


def admit(
    status: Status,
    certificate: Certificate,
    played: Replay,
    problem: TransientProblem,
    command: FloatArray,
    predicted_m_s2: FloatArray,
) -> tuple[Status, list[str]]:
    """Whether an entry may stand in a library: OPTIMAL, certified, replayed clean.

    Returns
    -------
    The entry's status and, unless it is OPTIMAL, what speaks against it.
    """
    if status is not Status.OPTIMAL:
        return status, [status.value]
    # For a limit of a user's own that is not convex nobody can promise more than a stationary point.
    bent = certificate.is_stationary and any(name != TemperatureLimit.name for name in problem.nonlinear)
    if not (certificate.accepted or bent):
        c = certificate
        if c.is_stationary and c.relative_bound > c.BOUND_TOLERANCE:
            return Status.NOT_GLOBAL, [
                f"J lies {c.relative_bound:.1%} above the convex lower bound, limit {c.BOUND_TOLERANCE:.0%}"
            ]
        return Status.NOT_CERTIFIED, [
            f"violation {', '.join(f'{by:.1e} {unit}' for unit, by in c.stated_violations.items())}, "
            f"{c.excess:.1e} times what is tolerated, gap {c.relative_gap:.1e} (limit {c.GAP_TOLERANCE:.0e}), above "
            f"the lower bound by {c.relative_bound:.1e} (limit {c.BOUND_TOLERANCE:.0e})"
        ]
    shortfalls = played.shortfalls(problem, command, predicted_m_s2)
    if not shortfalls:
        return Status.OPTIMAL, []
    unstable = unstable_wall(problem)
    if unstable:
        return Status.UNSTABLE_WALL, [unstable]
    left = [limit for limit in problem.limits if played.leaves(limit)]
    late = [limit for limit in left if problem.wall is not None and played.leaves_late(limit)]
    between = [limit.unresolved(problem, command, played.peak(limit)) for limit in left if limit not in late]
    if problem.wall is not None and not left and (elsewhere := _pushes_elsewhere(played, problem, command)):
        return Status.HAND_OVER, [elsewhere]
    # A cause that explains some of it is no cause.
    if len(left) < len(shortfalls) or not all(between):
        return Status.REPLAY_VIOLATION, shortfalls
    return (
        (Status.HAND_OVER, [_after_hand_over(played, problem, late), *between])
        if late
        else (
            Status.UNRESOLVED,
            between,
        )
    )


def _pushes_elsewhere(played: Replay, problem: TransientProblem, command: FloatArray) -> str:
    """Whether the wall pushes at other ticks of the hand-over than the optimum was sought for; empty if not."""
    assert problem.wall is not None
    truly = pressing(problem, encoder_course(problem, command)).wall
    assert truly is not None
    ticks = int(np.sum((truly.pressing != problem.wall.pressing)[max(problem.free_stages - 1, 0) :]))
    if not ticks:
        return ""
    off = float(np.abs(played.command - command).max())
    return (
        f"hand-over: the stylus grazes the surface, and the wall pushes at {ticks} of its ticks other than the "
        f"optimum was sought for: the command is {off:.1e} {problem.driven_by.unit} off, limit "
        f"{tolerated(problem.limits.input_limit):.0e} {problem.driven_by.unit}"
    )


def _after_hand_over(played: Replay, problem: TransientProblem, late: list[Limit]) -> str:
    """What the wall does with the limits when the waveform has ended, which no transient can help any more."""
    assert problem.wall is not None
    asked = " and ".join(
        f"a {limit.label} of {played.peak(limit):.6g} {limit.unit}, {played.peak(limit) - limit.stated:.2g} "
        f"{limit.unit} over its limit of {limit.stated:g} {limit.unit}"
        for limit in late
    )
    return (
        f"hand-over: within {after_s(problem.grid) * 1e3:g} ms after the last command the wall alone asks for "
        f"{asked}, with {stated_wall(problem.wall.wall)}"
    )


@dataclass(frozen=True)
class EntryCheck:
    """One entry checked again from the file alone.

    Attributes
    ----------
    columns, cells : which entry it is, in a table.
    unit : of its commands.
    """

    columns: list[str]
    cells: list[str]
    unit: str
    certificate: Certificate
    played: Replay
    shortfalls: list[str]

    __repr__ = brief

    @property
    def row(self) -> TableRow:
        """What tables show of it; the figures of an entry that falls short are shown too."""
        return TableRow(
            place=tuple(self.cells),
            nrmse=self.played.nrmse,
            peak_input=self.played.peak_input,
            violation=self.certificate.violation(self.unit),
            relative_gap=self.certificate.relative_gap,
            result="; ".join(self.shortfalls) or "certified, replayed clean",
        )


def unlimited_nrmse(problem: TransientProblem, target: Target) -> float:
    """NRMSE against a target of the optimum of J without limits, which in a refined library aims elsewhere."""
    plain = problem.without_intensity()
    free = np.zeros(problem.grid.stages) if problem.reference_is_zero else unlimited.solve(plain).command
    return target.nrmse(problem.stage.rollout(free)[0])


def stored_contradictions(
    library: Library, iv: int, ig: int, effect: Effect, certificate: Certificate, played: Replay
) -> list[str]:
    """Figures in the file that do not follow from the waveform in the file.

    Parameters
    ----------
    effect : of the entry's command. certificate : of it. played : its replay.
    """
    problem = effect.problem
    claims = {
        "nrmse": played.nrmse,
        "nrmse_after": played.nrmse_after,
        "peak_after_m_s2": played.error_peak_after_m_s2,
        "peak_input": played.peak_input,
        "peak_temperature_C": played.winding_C,
    }
    found = []
    for name, value in claims.items():
        stored = float(getattr(library, name)[iv, ig])
        if not np.isclose(stored, value, rtol=STORED_TOLERANCE, atol=ROUNDING, equal_nan=True):
            found.append(f"{library.in_file(name)} says {stored:.8g}, recomputed {value:.8g}")
    floor = unlimited_nrmse(problem, library.target(np.eye(library.speeds_m_s.size)[iv]))
    found += contradictions(library, iv, ig, effect, certificate, floor, of_bound=Certificate.GAP_TOLERANCE)
    current_off = float(np.abs(library.plant_input[iv, ig] - played.plant_input).max())
    if not current_off <= tolerated(problem.limits.input_limit):
        found.append(
            f"{library.in_file('plant_input')} differs from the replay by {current_off:.1e} {library.driven_by.unit}"
        )
    return found


@one_blas_thread()
@np.errstate(all="ignore")  # what overflows is found as not finite, and said
def verify_library(library: Library) -> list[EntryCheck]:
    """Certify and replay every entry from the file alone.

    Only the floor takes a (linear) solve and, where the temperature binds, the lower bound a convex one; on a
    nonlinear plant the linear design is solved besides.

    Returns
    -------
    One check per entry, speeds outermost; clean where `shortfalls` is empty.
    """
    if library.nonlinear:
        # Only a library of a nonlinear plant needs this import.
        from transopt.design.verify_nonlinear import verify_nonlinear

        return verify_nonlinear(library)
    options, axes = SolverOptions(), library.axes
    nv, ng, _ = library.command.shape
    checks: dict[tuple[int, int], EntryCheck] = {}
    for ig in range(ng):
        stage = library.stage(ig)
        problems = [library.problem(iv, ig, stage) for iv in range(nv)]
        walls = [problem.wall for problem in problems if problem.wall is not None]
        replays = replay(
            stage,
            library.time_grid(),
            library.transient_command[:, ig] if walls else library.command[:, ig],
            [library.target(own) for own in np.eye(nv)],
            library.coil(),
            limits=[problem.limits for problem in problems],
            walls=walls or None,
            budgets=[p.thermal.budget for p in problems if p.thermal is not None] or None,
            spread=problems[0].spread,
        )
        rivals = rivals_misstated(library, ig, stage)
        for iv, (problem, played) in enumerate(zip(problems, replays, strict=True)):
            command = library.command[iv, ig]
            certificate = prove(problem, command, library.multipliers(iv, ig), options)
            claimed = str(library.status[iv, ig])
            status = Status.OPTIMAL if claimed == Status.OPTIMAL.value else Status.NOT_CERTIFIED
            predicted = library.acceleration_m_s2[iv, ig]
            _, shortfalls = admit(status, certificate, played, problem, command, predicted)
            if status is not Status.OPTIMAL:
                shortfalls = [f"status in the file: {claimed}"]
            checks[iv, ig] = EntryCheck(
                columns=axes.columns,
                cells=axes.cells(iv, ig),
                unit=library.driven_by.unit,
                certificate=certificate,
                played=played,
                shortfalls=shortfalls
                + stored_contradictions(library, iv, ig, Effect(problem, command), certificate, played)
                + ([rivals[iv]] if iv in rivals else []),
            )
    return [checks[iv, ig] for iv in range(nv) for ig in range(ng)]
