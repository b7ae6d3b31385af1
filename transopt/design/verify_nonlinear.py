"""Entries on a nonlinear plant, checked again from the file alone.

Each stored command is rolled out on the nonlinear plant of the library's own scene, certified stationary with its
stored multipliers, and played by DOP853; every stated figure has to follow from that. The linear design that stands
beside it is played likewise, and has to be the optimum of the plant as it is at rest, which is solved for.
"""

from collections.abc import Iterator

import numpy as np

from transopt.design.optimum import optimum
from transopt.design.verify import (
    STORED_TOLERANCE,
    EntryCheck,
    stored_contradictions,
)
from transopt.library.library import Library
from transopt.library.nonlinear import as_on_linear, nonlinear_problem
from transopt.library.nonlinear_proven import certificate_of, of_the_others, shortfall
from transopt.problem.nonlinear import NonlinearProblem
from transopt.proof.nonlinear_replay import replay_nonlinear
from transopt.proof.replay import Replay
from transopt.solvers.choose import prove
from transopt.solvers.options import SolverOptions


def verify_nonlinear(library: Library) -> list[EntryCheck]:
    """One check per entry, speeds outermost; clean where `shortfalls` is empty.

    Raises
    ------
    InputError : a file whose numbers make no nonlinear problem.
    """
    plant = library.scene().nonlinear_plant()
    nv, ng, _ = library.command.shape
    return [
        _checked(library, iv, ig, nonlinear_problem(library, iv, ig, plant)) for iv in range(nv) for ig in range(ng)
    ]


def _checked(library: Library, iv: int, ig: int, problem: NonlinearProblem) -> EntryCheck:
    command, predicted = library.command[iv, ig], library.acceleration_m_s2[iv, ig]
    effect = problem.effect(command)
    certificate = certificate_of(library, iv, ig, effect)
    # Together, as when they were designed: then the integrator takes the same steps.
    linear_played, played = replay_nonlinear(problem, [library.linear_command[iv, ig], command])
    said = shortfall(library, iv, ig, certificate)
    found = [said] if said else []
    found += played.shortfalls(problem.linear, command, predicted)
    if certificate.finite:
        found += stored_contradictions(library, iv, ig, as_on_linear(effect), certificate, played)
    found += _linear_design(library, iv, ig, problem, linear_played)
    return EntryCheck(
        columns=library.axes.columns,
        cells=library.axes.cells(iv, ig),
        unit=library.driven_by.unit,
        certificate=certificate,
        played=played,
        shortfalls=found,
    )


def _linear_design(library: Library, iv: int, ig: int, problem: NonlinearProblem, played: Replay) -> Iterator[str]:
    """What the file says of the linear design and does not hold: its errors, and that it is one."""
    error = played.nrmse if np.isfinite(played.nrmse) else float("nan")
    yield from of_the_others(library, iv, ig, problem, error, STORED_TOLERANCE)
    options = SolverOptions()
    designed = optimum(problem.linear, options)
    # Limits that no command meets at rest may be met on the nonlinear plant: then there is no linear design.
    if not designed.is_proven:
        return
    proof = prove(problem.linear, library.linear_command[iv, ig], designed.solution.multipliers, options)
    if not proof.is_stationary:
        yield (
            "linear_command is not the optimum of the plant at rest: its gap is "
            f"{proof.relative_gap:.1e}, limit {proof.GAP_TOLERANCE:.0e}"
        )
