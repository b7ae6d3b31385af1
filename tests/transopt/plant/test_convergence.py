"""Orders of convergence, and an oracle in extended precision for the linear algebra of the hardest cases."""

from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from scipy import linalg

from problems.generators.tapping_trials import rk4_step
from problems.stress.cases import StressCase
from problems.stress.families import SMALL_A
from problems.stress.parts import Current, Demand, DrawnDevice, Horizon
from transopt.base.signals import FloatArray
from transopt.design.optimum import optimum
from transopt.plant.amplifier import Amplifier
from transopt.plant.discretise import StageModel, discretise
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify
from transopt.proof.continuous import _step_maps
from transopt.solvers.options import SolverOptions

DIGITS = 60


def slope(steps: list[float], errors: list[float]) -> float:
    """Fitted slope of log error against log step."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def oscillator() -> tuple[FloatArray, FloatArray]:
    """390 Hz, damping 0.1, scaled to rates."""
    w = 2 * np.pi * 390.0
    return np.array([[0.0, w], [-w, -0.2 * w]]), np.array([[0.0], [w]])


def test_the_replay_integrator_has_order_nine_until_rounding() -> None:
    A, B = oscillator()
    whole_s = 4e-3
    exact = linalg.expm(np.block([[A, B], [np.zeros((1, 3))]]) * whole_s)[:2]
    x0 = np.array([1.0, -0.5, 1.0])
    errors, counts = [], [2, 3, 4, 6, 8]
    for count, step in zip(counts, _step_maps(A, B, whole_s / np.array(counts)), strict=True):
        errors.append(float(np.abs((np.linalg.matrix_power(step, count)[:2] - exact) @ x0).max()))
    assert slope([whole_s / count for count in counts], errors) == pytest.approx(9, abs=0.6)
    (step,) = _step_maps(A, B, np.array([whole_s / 64]))
    assert np.abs(np.linalg.matrix_power(step, 64)[:2] - exact).max() < 1e-13


def test_the_recordings_integrator_has_order_four() -> None:
    A, _ = oscillator()
    whole_s, counts, errors = 4e-3, [20, 40, 80, 160], []
    x0 = np.array([1.0, -0.5])
    exact = linalg.expm(A * whole_s) @ x0
    for count in counts:
        x = x0
        for _ in range(count):
            x = rk4_step(lambda state: A @ state, x, whole_s / count)
        errors.append(float(np.abs(x - exact).max()))
    assert slope([1 / count for count in counts], errors) == pytest.approx(4, abs=0.3)


HARD = {
    "35 kHz, damping 1e-4": (DrawnDevice(mode_Hz=35e3, damping_ratio=1e-4), 1050.0, 1e-3),
    "pole 1 MHz": (DrawnDevice(), 1e6, 1e-3),
    "1 mg": (DrawnDevice(moving_kg=1e-6, stylus_kg=1e-6, mode_Hz=35e3), 1e6, 1e-4),
    "100 kg": (DrawnDevice(moving_kg=100.0, stylus_kg=100.0, mode_Hz=50.0), 10.0, 1e-6),
    "1 mg on 100 kg": (DrawnDevice(moving_kg=1e-6, stylus_kg=100.0, mode_Hz=35e3, damping_ratio=1e-4), 1e6, 1e-4),
    "defective": (DrawnDevice("defective", mode_Hz=35e3), None, 1e-4),
    "defective with the amplifier": (DrawnDevice("defective", mode_Hz=1050.0), 1050.0, 1e-4),
    "free, other units": (DrawnDevice(grip_N=0.0, units=1e6), 1050.0, 1e-3),
}


@pytest.mark.parametrize("name", HARD)
def test_the_hold_agrees_with_extended_precision(name: str) -> None:
    device, pole_Hz, dt_s = HARD[name]
    amplifier = None if pole_Hz is None else Amplifier(pole_Hz, 0.0, 6.0)
    stage = discretise(device.plant(), amplifier, dt_s, position=True)
    n = stage.A.shape[0]
    flow = mpmath.zeros(n + 1)
    size = stage.plant.order
    for i in range(size):
        for j in range(size):
            flow[i, j] = mpmath.mpf(stage.plant.A[i, j])
        flow[i, size] = mpmath.mpf(stage.plant.B[i, 0])
    if amplifier is not None:
        flow[n - 1, n - 1], flow[n - 1, n] = -amplifier.rate_rad_s, amplifier.rate_rad_s
    with mpmath.workdps(DIGITS):
        exact = np.array((mpmath.expm(flow * mpmath.mpf(dt_s))).tolist(), dtype=float)[:n]
    found = np.hstack([stage.A, stage.B])
    # Beside what the state is moved by from any other, in units in which all are alike.
    rates = np.array(flow.tolist(), dtype=float)
    _, (units, _) = linalg.matrix_balance(rates, permute=False, separate=True)
    scaled = np.abs(found - exact) * units / units[:n, None]
    size_of_all = np.abs(exact * units / units[:n, None]).max()
    phase = max(float(np.abs(np.linalg.eigvals(rates)).max()) * dt_s, 1.0)
    # Rounding the rates turns the phase of a mode by that many units of the last digit.
    assert scaled.max() <= 50 * np.finfo(float).eps * phase * size_of_all


def _exact(matrix: FloatArray) -> np.ndarray:
    return np.array([[mpmath.mpf(value) for value in row] for row in np.atleast_2d(matrix)], dtype=object)


def judged_exactly(problem: TransientProblem, command: FloatArray, m: Multipliers) -> tuple[float, float]:
    """J and gap of a problem with current and command limits only, written out in extended precision."""
    stage, N, free = problem.stage, problem.grid.stages, problem.free_stages
    A, B, C, Ci = (_exact(getattr(stage, name)) for name in ("A", "B", "C", "Ci"))
    D, Di = mpmath.mpf(stage.D[0, 0]), mpmath.mpf(stage.Di[0, 0])
    c, r, w = (_exact(values)[0] for values in (command, problem.reference_m_s2, problem.terms[0].weights))
    B, C, Ci = B[:, 0], C[0], Ci[0]
    x, error, current = B * 0, [], []
    for k in range(N):
        error.append(C @ x + D * c[k] - r[k])
        current.append(Ci @ x + Di * c[k])
        x = A @ x + B * c[k]
    norm, movement = sum(r * r), np.diff(c, prepend=mpmath.mpf(0))
    weight = mpmath.mpf(problem.movement.weight)
    J = sum(w * np.array(error) ** 2) / norm + weight * sum(movement**2)
    by_movement = 2 * weight * movement
    limit, bound = mpmath.mpf(problem.limits.input_limit), mpmath.mpf(problem.command_bound)
    costate, gap = B * 0, mpmath.mpf(0)
    for k in range(N - 1, -1, -1):
        by_error = 2 * w[k] * error[k] / norm
        by_current = mpmath.mpf(m.upper("current")[k]) - mpmath.mpf(m.lower("current")[k])
        g = B @ costate + D * by_error + Di * by_current + by_movement[k]
        g += -(by_movement[k + 1] if k + 1 < N else 0) + mpmath.mpf(m.upper("command")[k] - m.lower("command")[k])
        g += mpmath.mpf(m.hand_over[k - free]) if k >= free else 0
        costate = A.T @ costate + C * by_error + Ci * by_current
        gap += abs(g) * (bound + abs(c[k]))
        gap += m.upper("current")[k] * abs(limit - current[k]) + m.lower("current")[k] * abs(limit + current[k])
        gap += m.upper("command")[k] * abs(bound - c[k]) + m.lower("command")[k] * abs(bound + c[k])
        gap += abs(m.hand_over[k - free]) * abs(c[k]) if k >= free else 0
    return float(J), float(gap)


PROVEN: dict[str, Callable[[], StressCase]] = {
    "35 kHz": lambda: StressCase("o", DrawnDevice(mode_Hz=35e3, damping_ratio=1e-4), Current(limit_A=SMALL_A)),
    "1 mg": lambda: StressCase("o", DrawnDevice(moving_kg=1e-6, stylus_kg=1e-6), Current(limit_A=1e-4)),
    "100 kg": lambda: StressCase("o", DrawnDevice(moving_kg=100.0, stylus_kg=100.0), Current(pole_Hz=1e6)),
    "microampere": lambda: StressCase("o", current=Current(limit_A=1e-6), demand=Demand("noise")),
    "ideal, rho 0": lambda: StressCase("o", current=Current(SMALL_A, pole_Hz=None), demand=Demand(rho=0.0)),
    "slow amplifier": lambda: StressCase("o", current=Current(pole_Hz=10.0, command=10.0)),
    "unlimited": lambda: StressCase("o", current=Current(limit_A=1e3), horizon=Horizon(stages=80)),
}


@pytest.mark.parametrize("name", PROVEN)
def test_the_certificate_agrees_with_extended_precision(name: str) -> None:
    designed = optimum(PROVEN[name]().problem(), SolverOptions())
    problem, answer = designed.problem, designed.solution
    proof = certify(problem, answer.command, answer.multipliers)
    with mpmath.workdps(DIGITS):
        objective, gap = judged_exactly(problem, answer.command, answer.multipliers)
    allowed = 0.1 * Certificate.GAP_TOLERANCE * max(objective, OBJECTIVE_SCALE)
    assert proof.accepted
    assert abs(proof.objective - objective) <= 1e-9 * max(objective, OBJECTIVE_SCALE)
    assert abs(proof.duality_gap - gap) <= allowed
    assert gap <= Certificate.GAP_TOLERANCE * max(objective, OBJECTIVE_SCALE)


def test_extended_matrices_are_the_same_matrices() -> None:
    stage = discretise(DrawnDevice().plant(), Amplifier(1050.0, 0.0, 6.0), 1e-4)
    wide: StageModel = stage.extended()
    command = np.random.default_rng(1).uniform(-1, 1, 50)
    exact = wide.rollout(command.astype(np.longdouble))[0]
    assert exact.dtype == np.longdouble
    np.testing.assert_allclose(
        stage.rollout(command)[0], exact.astype(float), rtol=0, atol=1e-11 * np.abs(exact).max()
    )
