"""What the stress suite made necessary: the least widening of limits, exact thermal steps, named walls."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from problems.stress.cases import StressCase
from problems.stress.draw import drawn
from problems.stress.judge import played
from problems.stress.parts import Coil, Current, Demand, DrawnDevice, Horizon, Surface
from transopt.base.errors import InputError
from transopt.design.context import Context
from transopt.design.explain import PRECISION, infeasibility
from transopt.design.optimum import optimum
from transopt.plant.coil import COPPER_PER_K, RESISTANCE_REFERENCE_C, CoilModel
from transopt.plant.wall import earlier_by
from transopt.problem.answer import Multipliers, Status
from transopt.problem.limits import hand_over, limits_of
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import encoder_course, silence
from transopt.proof.admit import unstable_wall
from transopt.proof.continuous import AGREEMENT
from transopt.proof.effect import boxes, inside
from transopt.recordings.recording import Recording
from transopt.scene.keys import with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.solvers.choose import solve_certified
from transopt.solvers.feasibility import alone, can_widen, least_widening
from transopt.solvers.options import SolverOptions
from transopt.solvers.riccati import can_solve

SHORT = Horizon(stages=40)


def walled(limit: float) -> TransientProblem:
    case = StressCase("wall", current=Current(limit_A=limit, slew=0.05), horizon=SHORT, surface=Surface(2000.0))
    return case.problem()


def test_the_least_widening_is_the_least() -> None:
    problem = walled(0.3)
    everything = ("current", "command", "slew")
    found = least_widening(problem, everything)
    assert found[0] > 1.1
    for factor, feasible in ((1.001 * found[0], True), (0.999 * found[0], False)):
        wide = replace(problem, limits=limits_of(*(limit.wider(factor) for limit in problem.limits)))
        assert [limit.name for limit in wide.limits] == list(everything)
        again = least_widening(wide, everything)
        assert (again[0] == 1.0) == feasible
        # From above a command within the limits, from below a ray that proves that there is none.
        (answer, proof, _) = solve_certified([wide], SolverOptions())[0]
        assert (proof.excess <= 1) == feasible
        assert (answer.status is Status.INFEASIBLE) != feasible


@pytest.mark.parametrize(("limit", "enough"), [(0.3, set()), (2.2, {"current"}), (2.8, {"current", "slew"})])
def test_no_limit_is_enough_alone_but_those_to_blame(limit: float, enough: set[str]) -> None:
    problem, everything = walled(limit), ["current", "command", "slew"]
    found = least_widening(problem, everything)
    assert found is not None
    assert {name for name in everything if least_widening(problem, [name]) is not None} == enough
    assert found.blamed == {"current", "slew"}


@pytest.mark.parametrize("limit", [0.3, 2.2, 2.8, 100.0])
def test_the_widening_together_tells_that_of_each_alone(limit: float) -> None:
    problem, everything = walled(limit), ["current", "command", "slew"]
    together = least_widening(problem, everything)
    for name in everything:
        told, searched = alone(problem, name, together), least_widening(problem, [name])
        assert (told is None) == (searched is None)
        assert told is None or told.factor == pytest.approx(searched.factor, rel=1e-5)


def test_one_limit_to_blame_whose_widening_keeps_the_others_takes_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Alone the search for this slew rate of 0.13 A/s finds no step, although a rate 51 times as high is enough."""
    problem = drawn(31337, 254).problem()
    together = least_widening(problem, ["current", "slew"])
    assert together.blamed == {"slew"}
    monkeypatch.setattr("transopt.solvers.feasibility.interior_points", None)
    told = alone(problem, "slew", together)
    monkeypatch.undo()
    for factor, feasible in ((1.01 * told.factor, True), (0.99 * told.factor, False)):
        wide = problem.replaced(problem.limits["slew"].wider(factor)).without(*problem.nonlinear)
        (answer, proof, _) = solve_certified([wide], SolverOptions())[0]
        assert (proof.excess <= 1) == feasible
        assert (answer.status is Status.INFEASIBLE) != feasible


@pytest.mark.parametrize("surface", [Surface(2000.0), Surface(2e4, 5.0, latency_ticks=2)])
def test_a_window_without_a_free_command_has_the_excess_of_the_only_one(surface: Surface) -> None:
    horizon = Horizon(stages=10, lead_s=0.0, hand_over=10)
    problem = StressCase(
        "ruled", current=Current(limit_A=0.01, command=1.0), horizon=horizon, surface=surface
    ).problem()
    assert problem.free_stages == 0
    found = least_widening(problem, ("current", "command"))
    assert found is not None
    motion = problem.stage.motion(found.command)
    assert np.abs(hand_over.residual(problem, found.command, motion)).max() < 1e-9 * np.abs(found.command).max()
    values = boxes(problem, found.command, motion, Multipliers.zero(problem))
    assert found.factor > 100
    assert found.factor == pytest.approx(1 + max(box.excess.max() / box.limit.stated for box in values), rel=1e-6)


def test_limits_a_million_times_too_narrow_have_a_least_width() -> None:
    """The search from rest finds no step: a second one begins where the limits are wide."""
    problem = drawn(27112026, 722).problem()
    found = least_widening(problem, ("current", "command", "supply"))
    assert found is not None
    assert found.factor == pytest.approx(799460.68, rel=1e-5)


def test_devices_whose_filters_are_too_many_for_a_solve_are_widened_for(scene: Scene, taps: list[Recording]) -> None:
    """Twelve hands need 98 states with their filters; what they need has no excess and is no less than one needs."""
    spread = {"robust.grip_spread": 0.3, "robust.samples": 12, "time.stages": 100, "weights.after_s": 0.0}
    short = with_values(scene, {**spread, "limits.stroke_m": 1e-3})
    reference = next(r for r in references_of(short, taps) if r.speed_m_s == 0.4)
    problem = Context(short).posed_as(reference, 5.0).problem
    assert not can_solve(problem)
    assert can_widen(problem)
    found, of_one = (least_widening(each, ["stroke"]) for each in (problem, problem.alone()))
    wide = problem.replaced(problem.limits["stroke"].wider(found.factor * (1 + 1e-6)))
    assert inside(wide.without(*wide.nonlinear), found.command)
    assert found.factor >= of_one.factor > 1


def test_bisection_finds_the_same_where_the_extension_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, options = walled(2.2), SolverOptions()
    (own,) = infeasibility(problem, options)
    monkeypatch.setattr("transopt.design.explain.can_widen", lambda _: False)
    (bisected,) = infeasibility(problem, options)
    assert (own.split()[0], own.split()[-5:]) == (bisected.split()[0], bisected.split()[-5:])
    assert float(bisected.split()[1]) == pytest.approx(float(own.split()[1]), abs=2 * PRECISION * 2.2)
    assert infeasibility(StressCase("plain", horizon=SHORT).problem(), options) == []


def test_a_feasible_problem_needs_no_wider_limits() -> None:
    problem = StressCase("plain", horizon=SHORT).problem()
    found = least_widening(problem, ("current", "command"))
    assert found[0] == 1.0


@pytest.mark.parametrize("tau_w_s", [1e-5, 1e-2, 12.0, 1e4])
@pytest.mark.parametrize("nodes", [1, 2])
def test_thermal_steps_are_exact_however_short_the_time_constant(tau_w_s: float, nodes: int) -> None:
    coil = CoilModel(2.18, 3.1, 14.0, tau_w_s, 612.0, 100.0, 25.0, 70.0, 60.0, nodes)
    heat, step_s = 4.0, 1e-3
    flow, inflow = coil.flow()
    n = inflow.size
    power = coil.R_ohm * heat
    held = np.zeros((n + 1, n + 1))
    held[:n, :n] = flow
    held[:n, 0] += inflow * power * COPPER_PER_K
    held[:n, n] = inflow * power * (1 + COPPER_PER_K * (coil.rest_C - RESISTANCE_REFERENCE_C))
    start = np.append(np.array([70.0, 60.0])[:n] - coil.rest_C, 1.0)
    expected = (linalg.expm(held * step_s) @ start)[:n] + coil.rest_C
    winding, housing = coil.simulate(np.full((1, 1), heat), np.array([step_s]))
    np.testing.assert_allclose(np.array([winding[0, 1], housing[0, 1]])[:n], expected, rtol=1e-11)


def test_a_coil_of_one_node_has_a_steady_state_over_taps_that_repeat() -> None:
    coil = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0, 25.0, 60.0, 60.0, 1)
    winding, housing = coil.steady_course(np.full((1, 10), 1.0), np.full(10, 1e-3), 0.05, np.zeros(1))
    assert np.all(np.isfinite(winding))
    assert np.all(housing == 60.0)
    assert winding[0, 0] > 60.0


def test_taps_that_overlap_are_refused() -> None:
    with pytest.raises(InputError, match=r"tap_rate_Hz = .* a tap takes"):
        StressCase("repeated", coil=Coil(below_K=20.0, tap_share=0.999)).problem()


class TestWhatCancelsAtTheSwitchingInstants:
    """A mass whose link decays 80 time constants within one tick: link and current forces leave only rounding."""

    CASE = StressCase(
        "defective",
        DrawnDevice("defective", stylus_kg=1.4e-6, mode_Hz=18.4e3),
        Current(limit_A=1.8, command=1.0, pole_Hz=12.4e3, delay_samples=2.999),
        Horizon(dt_s=7.4e-4, stages=40, lead_s=1e-4),
    )

    def test_is_held_to_its_rounding_and_no_more(self) -> None:
        # Nothing that is commanded moves the mass: which command is the optimum is any method's own choice.
        problem = self.CASE.problem()
        command = np.where(np.arange(problem.grid.stages) < problem.free_stages, 0.5, 0.0)
        run, (predicted, current) = played(problem, command), problem.stage.rollout(command)
        added = np.abs(problem.stage.plant.D[0, 0] * current).max()
        assert np.abs(run.acceleration_m_s2).max() < 1e-14 * added
        # Both forces are alike, and each of the two counts.
        rounding = AGREEMENT * run.scale_m_s2
        assert rounding == pytest.approx(16 * np.finfo(float).eps * 2 * added, rel=1e-6)
        assert run.shortfalls(problem, command, predicted) == []
        off = run.shortfalls(problem, command, predicted + 1.1 * rounding)
        assert len(off) == 1
        assert "differs from the predicted" in off[0]


def test_a_wall_that_grows_by_itself_is_named() -> None:
    shaky = StressCase("wall", DrawnDevice(moving_kg=1e-4), surface=Surface(2000.0, 50.0, latency_ticks=5)).problem()
    assert hand_over.growth(shaky) > 1
    assert optimum(drawn(77, 723).problem(), SolverOptions()).solution.status is Status.UNSTABLE_WALL
    assert "latency_ticks = 5" in unstable_wall(shaky)
    for surface, stated in (
        (
            Surface(1e5, 50.0, latency_ticks=0),
            "with feedback.stiffness_N_m = 100000 N/m, feedback.damping_N_s_m = 50 N s/m",
        ),
        (
            Surface(0.0, 50.0, latency_ticks=5),
            "with feedback.damping_N_s_m = 50 N s/m, feedback.latency_ticks = 5",
        ),
    ):
        remark = unstable_wall(StressCase("wall", DrawnDevice(moving_kg=1e-4), surface=surface).problem())
        assert remark.endswith(stated)
    calm = StressCase("wall", surface=Surface(200.0)).problem()
    assert hand_over.growth(calm) < 1
    assert unstable_wall(calm) == ""


def test_silence_over_a_wall_is_the_walls_own_command() -> None:
    """Tick by tick or all at once: with that command no transient is left."""
    problem, command = silence(StressCase("wall", surface=Surface(200.0)).problem())
    assert np.abs(command).max() > 0.01
    law = problem.wall
    feedback = law.feedback(encoder_course(problem, command), problem.grid.dt_s)
    assert np.array_equal(feedback > 0, law.pressing)
    assert np.abs(problem.transient_command(command)).max() <= 1e-12


def test_a_zero_reference_over_a_wall_leaves_it_alone() -> None:
    case = StressCase("wall", demand=Demand("denormal", speed_m_s=0.1), surface=Surface(200.0))
    designed = optimum(case.problem(), SolverOptions())
    assert designed.solution.status is Status.OPTIMAL
    assert designed.certificate.accepted
    assert np.abs(designed.solution.command).max() > 0.01


def test_a_delay_longer_than_the_horizon() -> None:
    np.testing.assert_array_equal(earlier_by(2, np.array([1.0, 2.0, 3.0])), [3.0, 0.0, 0.0])
    np.testing.assert_array_equal(earlier_by(5, np.array([1.0, 2.0, 3.0])), np.zeros(3))
