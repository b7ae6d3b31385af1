"""Supply rail and slew limit: voltages against an independent integration, solvers against each other, refusals."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from problems.stress.judge import played
from tests.benches.limits import supply_of, with_rail
from tests.conftest import is_stationary
from transopt.design.context import Context
from transopt.design.design import design
from transopt.design.explain import infeasibility
from transopt.design.optimum import optimum
from transopt.plant.discretise import Motion
from transopt.problem.answer import Status
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import binding_limits, certify
from transopt.proof.designed import Designed
from transopt.proof.effect import inside
from transopt.references.reference import Reference
from transopt.scene.scene import Scene
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

SOLVERS = ("casadi-piqp", "casadi-ipopt")
# Problems without an answer keep an interior-point method busy until its last iteration.
SHORT = SolverOptions(max_iterations=60)
Maker = Callable[..., TransientProblem]


def varied(scene: Scene, limits: dict[str, Any], feedback: dict[str, Any] | None = None) -> Scene:
    data = scene.model_dump()
    data["limits"].update(limits)
    data["feedback"] = feedback
    return Scene.model_validate(data)


@pytest.fixture(scope="module")
def entry(scene: Scene, references: list[Reference]) -> Maker:
    def make(
        speed_m_s: float = 0.4, grip_N: float = 5.0, feedback: dict[str, Any] | None = None, **limits: float
    ) -> TransientProblem:
        other = varied(scene, limits, feedback)
        reference = next(r for r in references if r.speed_m_s == speed_m_s)
        return Context(other).posed_as(reference, grip_N).problem

    return make


def cut(problem: TransientProblem, stages: int) -> TransientProblem:
    """The first stages of a problem, without its temperature."""
    wall, limits = problem.wall, problem.limits.without("temperature")
    if "supply" in limits:
        supply = supply_of(problem)
        limits = limits.replaced(replace(supply, nominal_m_s=supply.nominal_m_s[:stages]))
    if wall is not None:
        wall = replace(wall, nominal_m=wall.nominal_m[:stages], pressing=wall.pressing[:stages])
    return replace(
        problem,
        grid=replace(problem.grid, stages=stages, after_stages=0),
        target=Target(problem.reference_m_s2[:stages]),
        terms=(ErrorTerm("plain", np.ones(stages)),),
        limits=limits,
        wall=wall,
    )


def flow_of(problem: TransientProblem) -> np.ndarray:
    """Rate matrix of plant, current and the command felt, from the plant's matrices and the amplifier's pole."""
    plant, w = problem.stage.plant, 2 * np.pi * 1050.0
    n = plant.order
    flow = np.zeros((n + 2, n + 2))
    flow[:n, :n], flow[:n, n : n + 1] = plant.A, plant.B
    flow[n, n], flow[n, n + 1] = -w, w
    return flow


def voltages(
    problem: TransientProblem, command: np.ndarray, scene: Scene, copper_C: float = 25.0
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) R i + L di/dt + k_e w just before and after tau_k, di/dt by one-sided differences of the current."""
    motor, transmission = scene.motor, scene.transmission
    plant, flow, h = problem.stage.plant, flow_of(problem), 1e-7
    n, nominal_m_s = plant.order, supply_of(problem).nominal_m_s
    period, onward, back = expm(flow * 1e-4), expm(flow * h), expm(-flow * h)
    # Shaft speed in rad/s times V s/rad, and k_e = k_t in SI.
    emf = motor.kt_Nm_A * transmission.ratio_1_m
    R_ohm = motor.R_ohm * (1 + 0.0039 * (copper_C - 25.0))
    x = np.zeros(n + 2)
    before, after = np.zeros(command.size), np.zeros(command.size)
    for k, c in enumerate(command):
        for side, felt, step, sign in ((before, x[n + 1], back, -1), (after, c, onward, 1)):
            x[n + 1] = felt
            near = step @ x
            i = [x[n], near[n], (step @ near)[n]]
            rate = sign * (-3 * i[0] + 4 * i[1] - i[2]) / (2 * h)
            speed = float((plant.Ce @ plant.A)[0] @ x[:n]) + nominal_m_s[k]
            side[k] = R_ohm * i[0] + motor.L_H * rate + emf * speed
        x = period @ x
    return before, after


def stated(problem: TransientProblem, motion: Motion, command: np.ndarray) -> list[np.ndarray]:
    """(N,) voltages just before and just after the switching instants, with cold copper and then with hot."""
    return [row.value(motion, command) for row in supply_of(problem).rows(problem)]


class TestVoltage:
    def test_against_differences_of_an_integrated_current(self, entry: Maker, scene: Scene) -> None:
        """Measured 1.9e-6 V, which is what the differences are good for."""
        problem = entry(supply_V=9.0)
        command = np.random.default_rng(1).uniform(-5, 5, problem.grid.stages)
        values = stated(problem, problem.stage.motion(command), command)
        for (before, after), copper_C in zip((values[:2], values[2:]), (25.0, 100.0), strict=True):
            expected_before, expected_after = voltages(problem, command, scene, copper_C)
            assert np.abs(expected_after).max() > 9
            np.testing.assert_allclose(before, expected_before, rtol=0, atol=1e-5)
            np.testing.assert_allclose(after, expected_after, rtol=0, atol=1e-5)

    def test_nominal_motion_comes_in_at_the_stated_speed(self, entry: Maker) -> None:
        for speed in (0.1, 0.4):
            supply = supply_of(entry(speed, supply_V=9.0))
            assert supply.nominal_m_s[0] == pytest.approx(-speed, rel=1e-2)
            assert supply.nominal_V[0] == pytest.approx(-1.25 * speed, rel=1e-2)


@pytest.fixture(scope="module")
def nine_volts(entry: Maker) -> Designed:
    return optimum(entry(supply_V=9.0), SolverOptions())


class TestBinding:
    @pytest.mark.parametrize("limit", [{"supply_V": 9.0}, {"supply_V": 5.0}, {"slew_A_per_s": 5000.0}])
    def test_three_methods_agree_and_are_certified(self, entry: Maker, limit: dict[str, float]) -> None:
        """Measured 2e-11 at most."""
        problem = entry(**limit).without("temperature")
        proofs = []
        for solver in SOLVERS:
            answer = solve(problem, SolverOptions(solver))
            assert (answer.solver, answer.status) == (solver, Status.OPTIMAL)
            proofs.append(certify(problem, answer.command, answer.multipliers))
        assert all(proof.accepted for proof in proofs)
        assert np.ptp([proof.objective for proof in proofs]) <= 1e-8 * proofs[0].objective
        free = problem.without("supply", "slew")
        without = solve(free)
        assert not inside(problem, without.command), "it does not bind: the test shows nothing"
        unbound = certify(free, without.command, without.multipliers).objective
        assert proofs[0].objective > unbound * (1 + 1e-4)

    def test_the_rail_is_met_and_kept(self, nine_volts: Designed, scene: Scene) -> None:
        """Before, after and, by the replay, all the time: measured excess over 9 V 1e-14."""
        problem, command = nine_volts.problem, nine_volts.solution.command
        assert nine_volts.certificate.accepted
        assert nine_volts.certificate.violation("V") <= 1e-9
        before, after = voltages(problem, command, scene, copper_C=100.0)
        peak = max(np.abs(before).max(), np.abs(after).max())
        assert peak == pytest.approx(9, abs=1e-5)
        assert played(problem, command).reached["supply"] == pytest.approx(9, abs=1e-9)

    @pytest.mark.parametrize("supply_V", [5.0, 7.0])
    def test_lower_rails_are_kept_between_the_instants_too(self, entry: Maker, supply_V: float) -> None:
        """There the back-EMF is left to itself, 1e-3 of the limit being allowed; measured 2e-6."""
        problem = entry(supply_V=supply_V)
        command = optimum(problem, SolverOptions()).solution.command
        assert supply_V * (1 - 1e-6) <= played(problem, command).reached["supply"] <= supply_V * (1 + 1e-5)

    def test_binding_says_so(self, nine_volts: Designed) -> None:
        text = binding_limits(nine_volts.problem, nine_volts.solution.command, nine_volts.solution.multipliers)
        assert "supply +9 V with the copper at 100 C at " in text

    def test_slew_is_kept(self, entry: Maker) -> None:
        problem = entry(slew_A_per_s=5000.0)
        designed = optimum(problem, SolverOptions())
        assert designed.certificate.accepted
        movement = np.abs(np.diff(designed.solution.command, prepend=0.0))
        assert movement.max() == pytest.approx(0.5, abs=1e-9)
        text = binding_limits(problem, designed.solution.command, designed.solution.multipliers)
        assert "slew +0.5 A/tick" in text


class TestInfeasible:
    def test_a_rail_below_the_incoming_hands_back_emf(self, scene: Scene, references: list[Reference]) -> None:
        """At 0.4 m/s the motor generates 0.5 V before anything is commanded: 0.3 V cannot hold that."""
        low = varied(scene, {"supply_V": 0.3})
        (entry,) = design([Context(low).posed_as(references[-1], 5.0)])
        assert entry.status is not Status.OPTIMAL
        (reason,) = entry.shortfalls
        assert reason == "supply 0.2 V over its limit 0.3 V at -0.2 ms by the back-EMF of the incoming stylus alone"

    def test_a_rail_that_no_command_keeps_is_refused_by_name(self, entry: Maker) -> None:
        designed = optimum(cut(entry(supply_V=0.02), 30), SolverOptions())
        assert designed.solution.status is Status.INFEASIBLE
        assert any(text.startswith("supply ") for text in designed.remarks), designed.remarks

    def test_what_the_supplys_sentence_says_is_true(self, entry: Maker) -> None:
        problem = cut(entry(supply_V=0.02), 30)
        (reason,) = infeasibility(problem, SHORT)
        assert reason.startswith("supply ")
        assert " V over its limit 0.02 V at " in reason
        assert reason.endswith(" ms at the least")
        least = 0.02 + float(reason.split(" ")[1])
        for limit, status in ((1.02 * least, True), (0.98 * least, False)):
            moved = with_rail(problem, limit)
            assert is_stationary(moved, solve(moved, SHORT)) is status

    def test_a_slew_that_cannot_follow_the_wall_is_refused_by_name(self, entry: Maker) -> None:
        """The hand-over asks for the wall's command, which moves faster than 50 A/s."""
        wall = {"stiffness_N_m": 500.0, "damping_N_s_m": 5.0}
        designed = optimum(cut(entry(0.4, 3.0, feedback=wall, slew_A_per_s=50.0), 100), SolverOptions())
        assert designed.solution.status is Status.INFEASIBLE
        assert any(text.startswith("slew ") for text in designed.remarks), designed.remarks
