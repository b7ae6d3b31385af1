"""The error filter: its response, its transpose, weighted designs against dense least squares."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from tests.conftest import ProblemMaker
from transopt.base.errors import InputError
from transopt.base.signals import nrmse
from transopt.design.optimum import optimum
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.weighting import pacinian
from transopt.proof.certify import certify
from transopt.solvers import unlimited
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

DT_S = 1e-4


@pytest.mark.parametrize("dt_s", [1e-4, 5e-5, 1e-3])
def test_gain_is_one_where_vibration_is_felt_best_and_never_below_the_floor(dt_s: float) -> None:
    f = pacinian(dt_s)
    _, peak = signal.freqz(f.b, f.a, worN=[275.0], fs=1 / dt_s)
    assert abs(peak[0]) == pytest.approx(1, abs=1e-12)
    _, response = signal.freqz(f.b, f.a, worN=np.linspace(0, 0.5 / dt_s, 20001), fs=1 / dt_s)
    assert np.abs(response).min() >= 0.1 - 1e-12
    assert np.abs(response).max() <= 1 + 1e-12
    b, a = signal.iirpeak(275.0, 0.5, fs=1 / dt_s)
    np.testing.assert_allclose([f.b, f.a], [0.1 * a + 0.9 * b, a], atol=1e-12)


def test_state_space_is_the_same_filter() -> None:
    f = pacinian(DT_S)
    A, B, C, D = f.state_space()
    e = np.random.default_rng(2).standard_normal(200)
    x, out = np.zeros(2), np.zeros(200)
    for k in range(200):
        out[k] = C[0] @ x + D[0, 0] * e[k]
        x = A @ x + B[:, 0] * e[k]
    np.testing.assert_allclose(f.apply(e), out, atol=1e-12)


def test_a_servo_too_slow_for_it_is_refused() -> None:
    with pytest.raises(InputError, match="pacinian lies at 275 Hz, above half the servo rate 250 Hz"):
        pacinian(2e-3)


@pytest.mark.parametrize("ideal", [False, True])
def test_weighted_optimum_against_dense_least_squares(make_problem: ProblemMaker, ideal: bool) -> None:
    """Columns from rolled-out impulses and a filter matrix from its own impulse response."""
    N = 60
    problem = replace(
        make_problem(0.4, 3.0, stages=N, ideal=ideal, current_A=40.0, **({} if ideal else {"command_A": 60.0})),
        terms=(ErrorTerm("rapid", np.linspace(0.5, 2.0, N), error_filter=pacinian(DT_S)),),
        rho=1.6,  # as large beside 40 A as 1e-3 beside 1 A
    )
    f = pacinian(DT_S)
    plant = problem.stage.rollout(np.eye(N))[0].T
    response = signal.lfilter(f.b, f.a, np.eye(N)[0])
    filtering = np.array([[response[i - j] if i >= j else 0.0 for j in range(N)] for i in range(N)])
    r = problem.reference_m_s2
    roots = np.sqrt(np.linspace(0.5, 2.0, N))
    weights = roots / np.linalg.norm(roots * (filtering @ r))
    moves = np.sqrt(problem.movement.weight) * (np.eye(N) - np.eye(N, k=-1))
    free = problem.free_stages
    matrix = np.vstack([weights[:, None] * (filtering @ plant), moves])[:, :free]
    right = np.concatenate([weights * (filtering @ r), np.zeros(N)])
    dense, *_ = np.linalg.lstsq(matrix, right, rcond=None)
    J = float(np.sum((matrix @ dense - right) ** 2))
    for answer in (solve(problem), unlimited.solve([problem])[0]):
        certificate = certify(problem, answer.command, answer.multipliers)
        assert certificate.accepted
        assert certificate.objective == pytest.approx(J, rel=1e-8, abs=1e-12)
    np.testing.assert_allclose(unlimited.solve([problem])[0].command[:free], dense, atol=1e-6 * np.abs(dense).max())


@pytest.mark.parametrize("limit_A", [4.0, 2.0])
def test_a_weighted_design_is_better_weighted_and_worse_plain(make_problem: ProblemMaker, limit_A: float) -> None:
    plain = make_problem(0.4, 5.0, current_A=limit_A)
    weighted = replace(plain, terms=(replace(plain.terms[0], error_filter=pacinian(DT_S)),))
    answers = [optimum(problem, SolverOptions()) for problem in (plain, weighted)]
    assert all(designed.certificate.accepted for designed in answers)
    motions = [plain.stage.rollout(designed.solution.command)[0] for designed in answers]
    heard = [weighted.tracking.value(motion[None]) for motion in motions]
    raw = [nrmse(motion, plain.reference_m_s2) for motion in motions]
    assert heard[1] < heard[0] * (1 - 1e-3)
    assert raw[0] < raw[1] * (1 - 1e-3)
