"""Admission of entries, when a library is built and whenever it is checked again."""

from dataclasses import dataclass

import numpy as np

from transopt.certify import binding_limits, certify
from transopt.library import Library
from transopt.problem import OBJECTIVE_SCALE, Certificate, Status, TransientProblem
from transopt.replay import Replay, replay
from transopt.signals import FloatArray, nrmse
from transopt.solvers import unlimited
from transopt.thermal import CoilModel

STORED_TOLERANCE = 1e-6  # relative, to which stored figures agree with recomputed ones
ROUNDING = 1e-9  # absolute, for figures that are zero


def admit(
    status: Status,
    certificate: Certificate,
    played: Replay,
    problem: TransientProblem,
    coil: CoilModel | None,
    predicted_m_s2: FloatArray,
) -> tuple[Status, list[str]]:
    """Whether an entry may stand in a library: OPTIMAL, certified, replayed clean, temperature proven.

    Returns
    -------
    The entry's status and, unless it is OPTIMAL, what speaks against it.
    """
    if status is not Status.OPTIMAL:
        return status, [status.value]
    if not certificate.accepted:
        return Status.NOT_CERTIFIED, [
            f"violation {certificate.primal_violation_A:.1e} A (limit {Certificate.VIOLATION_TOLERANCE_A:.0e} A), "
            f"gap {certificate.relative_gap:.1e} (limit {Certificate.GAP_TOLERANCE:.0e})"
        ]
    shortfalls = played.shortfalls(problem, coil, predicted_m_s2)
    if shortfalls:
        return Status.REPLAY_VIOLATION, shortfalls
    if coil is not None:
        bound = temperature_bound_C(problem, coil)
        if not bound <= coil.limit_C:
            return Status.TEMPERATURE_MAY_BIND, [
                f"{problem.limits.current_A:g} A held throughout would reach up to {bound:.2f} C, "
                f"limit {coil.limit_C:g} C"
            ]
    return Status.OPTIMAL, []


def temperature_bound_C(problem: TransientProblem, coil: CoilModel) -> float:
    """What the winding cannot exceed within the horizon, whatever the optimiser chooses."""
    # The delay belongs to it: the ripple of Eq. 7 heats before the first command arrives.
    duration = (problem.grid.stages + 1) * problem.grid.dt_s + problem.grid.delay_s
    return coil.adiabatic_bound_C(problem.limits.current_A, duration)


@dataclass(frozen=True)
class EntryCheck:
    """One entry checked again from the file alone."""

    speed_m_s: float
    grip_N: float
    certificate: Certificate
    played: Replay
    shortfalls: list[str]


def _floor(problem: TransientProblem) -> float:
    free = np.zeros(problem.grid.stages) if problem.reference_is_zero else unlimited.solve(problem).command_A
    return nrmse(problem.stage.rollout(free)[0], problem.reference_m_s2)


def _stored(
    library: Library, iv: int, ig: int, problem: TransientProblem, certificate: Certificate, played: Replay
) -> list[str]:
    """Figures in the file that do not follow from the waveform in the file."""
    claims = {
        "nrmse": played.nrmse,
        "peak_current_A": played.peak_current_A,
        "peak_temperature_C": played.winding_C,
        "objective": certificate.objective,
    }
    found = []
    for name, value in claims.items():
        stored = float(getattr(library, name)[iv, ig])
        if not np.isclose(stored, value, rtol=STORED_TOLERANCE, atol=ROUNDING, equal_nan=True):
            found.append(f"{name} says {stored:.8g}, recomputed {value:.8g}")
    bounds = {
        "primal_violation": (certificate.primal_violation_A, Certificate.VIOLATION_TOLERANCE_A),
        "duality_gap": (
            certificate.duality_gap,
            Certificate.GAP_TOLERANCE * max(certificate.objective, OBJECTIVE_SCALE),
        ),
        "dual_residual": (certificate.dual_residual, Certificate.GAP_TOLERANCE),
        "floor": (_floor(problem), STORED_TOLERANCE),
    }
    for name, (value, tolerance) in bounds.items():
        stored = float(getattr(library, name)[iv, ig])
        if not abs(stored - value) <= tolerance:
            found.append(f"{name} says {stored:.3g}, recomputed {value:.3g}")
    binds = binding_limits(problem, library.command_A[iv, ig], library.multipliers(iv, ig))
    if str(library.binding[iv, ig]) != binds:
        found.append(f"binding says {library.binding[iv, ig]}, recomputed {binds}")
    if not np.array_equal(library.transient_command_A[iv, ig], library.command_A[iv, ig]):
        found.append("transient_command_A differs from command_A, though the scene has no wall")
    current_off = float(np.abs(library.current_A[iv, ig] - played.current_A).max())
    if not current_off <= STORED_TOLERANCE:
        found.append(f"current_A differs from the replay by {current_off:.1e} A")
    return found


def verify_library(library: Library) -> list[EntryCheck]:
    """Certify and replay every entry from the file alone; only the floor takes a (linear) solve.

    Returns
    -------
    One check per entry, speeds outermost; clean where `shortfalls` is empty.
    """
    coil = library.coil()
    nv, ng, _ = library.command_A.shape
    checks: dict[tuple[int, int], EntryCheck] = {}
    for ig in range(ng):
        stage = library.stage(ig)
        replays = replay(stage, library.time_grid(), library.command_A[:, ig], library.reference_m_s2, coil)
        for iv, played in enumerate(replays):
            problem = library.problem(iv, ig, stage)
            certificate = certify(problem, library.command_A[iv, ig], library.multipliers(iv, ig))
            claimed = str(library.status[iv, ig])
            status = Status.OPTIMAL if claimed == Status.OPTIMAL.value else Status.NOT_CERTIFIED
            predicted = library.acceleration_m_s2[iv, ig]
            _, shortfalls = admit(status, certificate, played, problem, coil, predicted)
            if status is not Status.OPTIMAL:
                shortfalls = [f"status in the file: {claimed}"]
            checks[iv, ig] = EntryCheck(
                speed_m_s=float(library.speeds_m_s[iv]),
                grip_N=float(library.grips_N[ig]),
                certificate=certificate,
                played=played,
                shortfalls=shortfalls + _stored(library, iv, ig, problem, certificate, played),
            )
    return [checks[iv, ig] for iv in range(nv) for ig in range(ng)]
