"""The nonlinear program against a general optimiser on a short instance; its certificate against wrong answers."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy import optimize

from tests.benches.actuators import LRA
from transopt.base.errors import InputError
from transopt.design.context import Context
from transopt.design.optimum import optimum
from transopt.plant.nonlinear_stage import NonlinearStage, resolved
from transopt.problem.answer import Multipliers, Solution, Status
from transopt.problem.nonlinear import NonlinearProblem
from transopt.proof.nonlinear import NonlinearEffect, certify_nonlinear, reduced_gradient
from transopt.references.targets import target_references
from transopt.scene.scene import Scene
from transopt.solvers.nonlinear import NonlinearProgram, solve
from transopt.solvers.options import SolverOptions

MODEL = {
    **LRA,
    "L_H": 1e-3,
    "nonlinear": {"force_factor": "BL*(1 - 0.3*(x/0.6e-3)**2)", "friction": "0.02*tanh(v/0.05)"},
}
State = tuple[float, float, float, float]  # displacement, velocity, current, voltage behind the amplifier's pole
AMPLIFIERS: dict[str, Any] = {"ideal": "ideal", "pole": {"pole_Hz": 1000.0, "delay_s": 1e-4, "command_limit_V": 10.0}}


def scene(stages: int = 20, *, amplifier: str = "ideal", limits: dict[str, Any], after_s: float = 2e-3) -> Scene:
    return Scene.model_validate(
        {
            "name": "short",
            "amplifier": AMPLIFIERS[amplifier],
            "hand_over_samples": 2,
            "time": {"dt_s": 5e-4, "stages": stages, "lead_s": 0.0 if amplifier == "ideal" else None},
            "targets": [{"name": "click", "shape": "burst", "frequency_Hz": 150, "cycles": 1.4, "peak_m_s2": 12.0}],
            "model": MODEL,
            "limits": limits,
            "weights": {"after_s": after_s},
        }
    )


def posed(of: Scene) -> NonlinearProblem:
    linear = of.at_rest()
    (reference,) = target_references(linear.targets, linear.time_grid(), linear.recordings)
    problem = Context(linear).posed_as(reference, 0.0).problem
    model: Any = of.model
    device = NonlinearStage(model.nonlinear_plant(), problem.stage.amplifier, 5e-4, 1, tuple(problem.stage.outputs))
    device, error = resolved(device, optimum(problem, SolverOptions()).solution.command)
    assert error <= 1e-6
    return NonlinearProblem(problem, device)


def solved(problem: NonlinearProblem) -> Solution:
    start = optimum(problem.linear, SolverOptions()).solution.command
    return NonlinearProgram(problem, SolverOptions()).solve(start)[0]


CASES = {
    "voltage": scene(limits={"voltage_V": 6.0}),
    "stroke": scene(limits={"voltage_V": 30.0, "stroke_m": 6e-4}),
    "velocity": scene(limits={"voltage_V": 30.0, "velocity_m_s": 0.23}),
    "current": scene(limits={"voltage_V": 10.0, "current_A": 1.0}),
    "slew": scene(limits={"voltage_V": 30.0, "slew_V_per_s": 8e3}),
    "pole": scene(amplifier="pole", limits={"voltage_V": 5.0, "stroke_m": 3.5e-4}),
}


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[NonlinearProblem, Solution]:
    problem = posed(CASES[request.param])
    found = solved(problem)
    assert found.status is Status.OPTIMAL
    row = problem.linear.limits.get({"slew": "voltage_slew", "pole": "stroke"}.get(request.param, request.param))
    assert row is not None
    (name,) = row.row_names
    assert max(found.multipliers.lower(name).max(), found.multipliers.upper(name).max()) > 1e-5  # it binds
    return problem, found


def by_integrator(
    problem: NonlinearProblem,
) -> tuple[Callable[[np.ndarray], float], Callable[[np.ndarray], np.ndarray]]:
    """J and the slacks of all limits by commands, from a classical Runge-Kutta method with 40 steps a period."""
    linear, stage = problem.linear, problem.stage
    N, M, free = linear.grid.stages, linear.grid.after_stages, linear.free_stages
    mu, w = 0.003 * 0.1 / 0.103, 2 * np.pi * 150
    K, c, BL0, R, L = mu * w**2, mu * w / 8, 0.8, 8.0, 1e-3
    pole = None if stage.amplifier is None else stage.amplifier.rate_rad_s

    # Plain floats: an array for each evaluation would take ten times as long.
    def force(x: float, v: float, i: float) -> float:
        return BL0 * (1 - 0.3 * (x / 0.6e-3) ** 2) * i - K * x - c * v - 0.02 * math.tanh(v / 0.05)

    def rate(z: State, command: float) -> State:
        x, v, i, u = z
        u = command if pole is None else u
        BL = BL0 * (1 - 0.3 * (x / 0.6e-3) ** 2)
        return v, force(x, v, i) / mu, (u - R * i - BL * v) / L, 0.0 if pole is None else pole * (command - u)

    def moved(z: State, by: float, rate: State) -> State:
        return z[0] + by * rate[0], z[1] + by * rate[1], z[2] + by * rate[2], z[3] + by * rate[3]

    @lru_cache(maxsize=64)  # objective and limits are differenced at the same points
    def rolled_once(commands: bytes) -> tuple[np.ndarray, np.ndarray]:
        return rolled(np.frombuffer(commands))

    def rolled(commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z, states, h = (0.0, 0.0, 0.0, 0.0), [], linear.grid.dt_s / 40
        for command in [*commands.tolist(), *[0.0] * (N - free + M)]:
            states.append(z)
            for _ in range(40):
                k1 = rate(z, command)
                k2 = rate(moved(z, h / 2, k1), command)
                k3 = rate(moved(z, h / 2, k2), command)
                k4 = rate(moved(z, h, k3), command)
                for by, k in ((h / 6, k1), (h / 3, k2), (h / 3, k3), (h / 6, k4)):
                    z = moved(z, by, k)
        return np.array([*states, z]), np.array([force(*each[:3]) for each in states]) / 0.1

    def objective(commands: np.ndarray) -> float:
        return linear.objective(np.append(commands, np.zeros(N - free)), rolled_once(commands.tobytes())[1][None])

    def slacks(commands: np.ndarray) -> np.ndarray:
        z, full, found = rolled_once(commands.tobytes())[0], np.append(commands, np.zeros(N - free)), []
        for limit in linear.limits:
            bound = limit.stated - limit.kept_back
            value = {
                "voltage": full if pole is None else z[1:N, 3],
                "command": full,
                "stroke": z[1 : N + 1, 0],
                "velocity": z[1 : N + 1, 1],
                "current": z[1 : N + 1, 2],
                "voltage_slew": np.diff(full, prepend=0.0),
            }[limit.name]
            found += [1 - value / bound, 1 + value / bound]
        return np.concatenate(found)

    return objective, slacks


class TestAgainstAGeneralOptimiser:
    def test_the_objective_is_that_of_another_integrator(self, case: tuple[NonlinearProblem, Solution]) -> None:
        problem, found = case
        objective, slacks = by_integrator(problem)
        free = found.command[: problem.linear.free_stages]
        assert objective(free) == pytest.approx(NonlinearEffect(problem, found.command).objective, rel=1e-5)
        assert slacks(free).min() >= -1e-5

    @pytest.mark.parametrize("case", ["stroke", "current", "pole"], indirect=True)
    def test_no_feasible_command_nearby_is_better(self, case: tuple[NonlinearProblem, Solution]) -> None:
        # SLSQP begins at the answer, with gradients by differences of the other integrator's motion.
        problem, found = case
        objective, slacks = by_integrator(problem)
        size, free = problem.linear.command_bound, problem.linear.free_stages
        start = found.command[:free] / size
        rival = optimize.minimize(
            lambda c: objective(c * size) * 1e2,
            start,
            method="SLSQP",
            constraints=[{"type": "ineq", "fun": lambda c: slacks(c * size)}],
            options={"maxiter": 12, "ftol": 1e-9},
        )
        assert slacks(rival.x * size).min() >= -1e-6
        assert objective(rival.x * size) >= objective(found.command[:free]) * (1 - 1e-4)

    def test_from_elsewhere_it_comes_to_the_same(self) -> None:
        problem = posed(CASES["stroke"])
        near, (far, _) = solved(problem), NonlinearProgram(problem, SolverOptions()).solve(np.zeros(20))
        assert np.abs(near.command - far.command).max() <= 1e-6 * np.abs(near.command).max()


@pytest.mark.parametrize("case", ["velocity", "pole"], indirect=True)
def test_a_coarse_stage_first_comes_to_the_same_in_few_more_iterations(
    case: tuple[NonlinearProblem, Solution],
) -> None:
    problem, found = case
    start = optimum(problem.linear, SolverOptions()).solution.command
    coarse = replace(problem, stage=replace(problem.stage, substeps=2))
    first, near = NonlinearProgram(coarse, SolverOptions()).solve(start)
    again, _ = NonlinearProgram(problem, SolverOptions(), near).solve(first.command)
    assert again.status is Status.OPTIMAL
    assert again.iterations <= 0.7 * found.iterations
    assert np.abs(again.command - found.command).max() <= 1e-6 * np.abs(found.command).max()
    posed, whole = solve(problem, start, SolverOptions())
    assert certify_nonlinear(posed, whole.command, whole.multipliers).is_stationary
    assert resolved(posed.stage, problem.linear.continued(whole.command))[1] <= 4e-7


def test_second_derivatives_are_those_that_casadi_finds_by_itself(case: tuple[NonlinearProblem, Solution]) -> None:
    problem, found = case
    program = NonlinearProgram(problem, SolverOptions())
    x, f, g = (program.nlp[name] for name in "xfg")
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
    by_itself = ca.Function("h", [x, lam_f, lam_g], [ca.triu(ca.hessian(lam_f * f + ca.dot(lam_g, g), x)[0])])
    lot = np.random.default_rng(5)
    point, by_rows = 0.3 * lot.standard_normal(x.numel()), lot.standard_normal(g.numel())
    expected = np.asarray(by_itself(point, 0.7, by_rows))
    mine = np.asarray(program.solver.get_function("nlp_hess_l")(point, [], 0.7, by_rows))
    assert np.abs(mine - expected).max() <= 1e-10 * np.abs(expected).max()
    assert problem.linear.grid.stages == found.command.size


class TestCertificate:
    def test_accepts_the_answer_as_stationary_and_claims_no_more(
        self, case: tuple[NonlinearProblem, Solution]
    ) -> None:
        problem, found = case
        certificate = certify_nonlinear(problem, found.command, found.multipliers)
        assert certificate.is_stationary
        assert certificate.relative_gap <= 1e-7
        assert certificate.lower_bound == -np.inf
        assert not certificate.accepted

    def test_gradient_is_that_of_the_lagrangian_by_differences(self, case: tuple[NonlinearProblem, Solution]) -> None:
        problem, found = case
        linear, nothing = problem.linear, Multipliers.zero(problem.linear)
        gradient = reduced_gradient(NonlinearEffect(problem, found.command), nothing)
        for k in (0, 7, linear.free_stages - 1):
            step = 1e-3 * np.eye(1, linear.grid.stages, k)[0]
            at = [NonlinearEffect(problem, found.command + by * step).objective for by in (-2, -1, 1, 2)]
            difference = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / 12e-3
            assert gradient[k] == pytest.approx(difference, rel=1e-6, abs=1e-6 * np.abs(gradient).max())

    def test_rejects_a_perturbed_command(self, case: tuple[NonlinearProblem, Solution]) -> None:
        problem, found = case
        moved = found.command.copy()
        moved[: problem.linear.free_stages] *= 0.999
        assert not certify_nonlinear(problem, moved, found.multipliers).is_stationary

    def test_rejects_multipliers_that_are_lost_or_doubled(self, case: tuple[NonlinearProblem, Solution]) -> None:
        problem, found = case
        for by in (0.0, 2.0):
            pairs = {name: (by * low, by * high) for name, (low, high) in found.multipliers.pairs.items()}
            wrong = replace(found.multipliers, pairs=pairs)
            assert not certify_nonlinear(problem, found.command, wrong).is_stationary
        silent = replace(found.multipliers, hand_over=-found.multipliers.hand_over)
        assert not certify_nonlinear(problem, found.command, silent).is_stationary

    def test_rejects_a_command_outside(self, case: tuple[NonlinearProblem, Solution]) -> None:
        problem, found = case
        beyond = found.command.copy()
        beyond[: problem.linear.free_stages] *= 1.01
        certificate = certify_nonlinear(problem, beyond, found.multipliers)
        assert certificate.excess > 1
        assert not certificate.is_stationary

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_rejects_what_is_no_number(self, bad: float) -> None:
        problem = posed(CASES["voltage"])
        found = solved(problem)
        command = found.command.copy()
        command[3] = bad
        assert not certify_nonlinear(problem, command, found.multipliers).finite
        lost = replace(found.multipliers, hand_over=np.array([bad, 0.0]))
        assert not certify_nonlinear(problem, found.command, lost).is_stationary
        assert not certify_nonlinear(problem, found.command[:-1], found.multipliers).finite

    def test_rejects_a_motion_without_a_value(self) -> None:
        problem = posed(CASES["voltage"])
        grown = np.full(20, 1e6)
        assert not certify_nonlinear(problem, grown, Multipliers.zero(problem.linear)).is_stationary


def test_parts_that_no_nonlinear_plant_can_have_are_refused() -> None:
    pressed = replace(posed(CASES["voltage"]).linear, spread=(posed(CASES["voltage"]).linear.stage,))
    with pytest.raises(InputError, match=r"robust: not with model\.nonlinear"):
        replace(posed(CASES["voltage"]), linear=pressed)
