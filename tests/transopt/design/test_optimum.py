"""The search for an entry's optimum finds the same for many problems side by side as for each alone."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from tests.benches.limits import with_limit
from tests.conftest import ProblemMaker, WalledMaker
from transopt.design.optimum import at_their_instants
from transopt.problem.answer import Status
from transopt.problem.heat import Budget
from transopt.problem.limits.temperature import temperature_limit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify, under_further_limits
from transopt.proof.effect import Effect, free_optima
from transopt.scene.scene import Scene
from transopt.solvers.choose import solve
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions

OPTIONS = SolverOptions()


def heated(problem: TransientProblem, scene: Scene, headroom_K: float) -> TransientProblem:
    """The problem with a coil that one tap may warm by so much."""
    coil = scene.coil()
    assert coil is not None
    amplifier = problem.stage.amplifier
    return with_limit(problem, temperature_limit(coil, amplifier, problem.grid, Budget(headroom_K=headroom_K)))


def test_problems_are_freed_with_their_last_user(make_problem: ProblemMaker) -> None:
    """A cycle through what is known of them would hold them until a collection: a study grew by 40 kB an entry."""
    problem, alive = make_problem(0.4, 5.0), list[weakref.ref[TransientProblem]]()
    gc.disable()
    try:
        for _ in range(5):
            (found,) = at_their_instants([replace(problem)], OPTIONS)
            alive.append(weakref.ref(found.problem))
            del found
        assert sum(each() is not None for each in alive) <= 1  # that of the stage data, which are kept
    finally:
        gc.enable()


@pytest.mark.skipif(not extension.available, reason="the extension is not built")
def test_side_by_side_as_alone(make_problem: ProblemMaker, walled: WalledMaker, scene: Scene) -> None:
    taps = [make_problem(0.1, 1.0), make_problem(0.4, 5.0), make_problem(0.4, 3.0), make_problem(0.2, 1.0)]
    asked = [
        taps[0],  # inside all limits
        taps[1],
        heated(taps[1], scene, 20.0),  # stays cool
        heated(taps[2], scene, 0.02),  # has to be cooled
        walled(200.0, 0.2),
        replace(taps[3], rho=2 * taps[3].rho),
    ]
    together = at_their_instants(asked, OPTIONS)
    for problem, found in zip(asked, together, strict=True):
        (alone,) = at_their_instants([problem], OPTIONS)
        assert found.problem is problem
        assert found.effect.problem is problem
        assert found.solution.status is alone.solution.status is Status.OPTIMAL
        assert found.solution.solver == alone.solution.solver
        assert found.left_out == alone.left_out
        assert found.certificate.accepted
        assert found.certificate.objective == pytest.approx(alone.certificate.objective, rel=1e-9)
        bound = 1e-8 * problem.limits.input_limit
        np.testing.assert_allclose(found.solution.command, alone.solution.command, rtol=0, atol=bound)
        assert found.floor == pytest.approx(alone.floor, rel=1e-9)
    assert [found.solved is None for found in together[:2]] == [True, False]
    assert "temperature" in together[2].left_out
    assert "temperature" not in together[3].left_out


@pytest.mark.parametrize("headroom_K", [20.0, 0.02])
def test_a_proof_holds_under_further_limits_as_far_as_they_are_met(
    make_problem: ProblemMaker, scene: Scene, headroom_K: float
) -> None:
    whole = heated(make_problem(0.4, 5.0), scene, headroom_K)
    small = whole.without("temperature", "slew")
    solution = solve(small)
    known = certify(small, solution.command, solution.multipliers)
    effect = Effect(whole, solution.command)
    found = under_further_limits(known, effect, small)
    again = certify(whole, solution.command, solution.multipliers, effect=effect)
    assert known.accepted
    assert found.excess == pytest.approx(again.excess, rel=1e-9, abs=1e-9)
    assert found.violations == pytest.approx(again.violations, rel=1e-9, abs=1e-12)
    assert found.is_stationary == again.is_stationary
    assert found.is_stationary == (found.excess <= 1)
    assert (found.violation("K") > 0) == (headroom_K < 1)
    # What the command leaves of the known limits stays in the proof.
    left = under_further_limits(replace(known, violations={"A": 0.5, "K": 9.0}, excess=1e9), effect, small)
    assert (left.violation("A"), left.violation("K"), left.excess) == (0.5, 9.0, 1e9)
    assert not left.is_stationary


def test_figures_without_limits_side_by_side_are_those_of_each_tap(make_problem: ProblemMaker) -> None:
    asked = [make_problem(), make_problem(0.2), make_problem(stages=300), make_problem(0.2, 1.0)]
    asked.append(asked[0].aiming_at(asked[1].target))
    random = np.random.default_rng(0)
    commands = [0.5 * i * random.standard_normal(problem.grid.stages) for i, problem in enumerate(asked)]
    for problem, (effect, free) in zip(asked, free_optima([*zip(asked, commands, strict=True)]), strict=True):
        (made,), motion = problem.accelerations(free.command), problem.stage.motion(free.command)
        assert effect.problem is problem
        assert free.floor == pytest.approx(problem.yardstick.tap_error(problem.target, made), rel=1e-12)
        assert free.objective == pytest.approx(problem.objective(free.command, made[None]), rel=1e-12)
        assert free.peak == pytest.approx(np.abs(motion.plant_input).max(), rel=1e-12)
