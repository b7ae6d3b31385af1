"""A standing problem: its stages against those of `stage_data`, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import walled_scene
from transopt.base.signals import FloatArray
from transopt.design.context import Context
from transopt.plant.state_space import StateSpace
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers
from transopt.problem.leave_out import leave_out
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout, linear_stage
from transopt.proof.certify import certify
from transopt.recordings.recording import Recording
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers.modes import modes_of
from transopt.solvers.native import extension
from transopt.solvers.stage_data import stages
from transopt.solvers.standing import Standing, stands

pytestmark = pytest.mark.skipif(not extension.available, reason="the extension is not built")

VARIANTS = {
    "as it is": {},
    "the plain term alone": {"weights.rapid": "none"},
    "the rapid term alone": {"weights.plain": 0.0},
    "another filter": {"weights.rapid": "pacinian"},
    "no tail": {"time.stages": 1190},
    "a slow pole": {"amplifier.pole_Hz": 200.0},
    "a stiff transmission": {"transmission.stiffness_N_m": 4e6},
    "a long period": {"time.dt_s": 4e-4, "time.stages": 200, "time.lead_s": 4e-4},
}


PLANTS = {
    "real modes": np.diag([-3e1, -2e2, -1e3, -4e3]),
    "a free mass": np.diag([0.0, -2e2, -1e3, -4e3]),
    "no damping": np.kron(np.diag([3e2, 2e3]), [[0.0, 1.0], [-1.0, 0.0]]),
    "one that grows": np.array([[5.0, 3e2, 0, 0], [-3e2, 5.0, 0, 0], [0, 0, -1e2, 9.0], [0, 0, 1.0, -1e3]]),
}


def posed(scene: Scene, taps: list[Recording], speed_m_s: float, grip_N: float) -> TransientProblem:
    return Context.recorded(scene, taps).posed(speed_m_s, grip_N).problem.without("temperature")


def standing(problem: TransientProblem) -> Standing:
    return Standing(problem, leave_out(problem).problem, 1e-9, 60)


def take(standing: Standing, problem: TransientProblem) -> bool:
    cost = problem.tracking
    wanted = np.ascontiguousarray(cost.wanted)
    return standing.drive(problem.stage.plant) and standing.poses(
        wanted, cost.energy_m2_s4, cost.lost_m2_s4 / cost.energy_m2_s4
    )


def costed(arrays: dict[str, FloatArray], constant: float, moves: FloatArray) -> tuple[FloatArray, float]:
    """(N, outputs) outputs under movements of the command, and the cost of their errors."""
    x, outputs = np.zeros(arrays["A"].shape[0]), []
    for move in moves:
        outputs.append(arrays["C"] @ x)
        x = arrays["A"] @ x + arrays["A"][:, -1] * move
    after = arrays["end_gain"] @ x - arrays["end_target"]
    errors = np.array(outputs) - arrays["reference"]
    return np.array(outputs), constant + float(np.sum(arrays["weight"] * errors**2) + after @ after) / 2


def compare(made: Standing, problem: TransientProblem, seed: int) -> None:
    """Take a tap, and compare its outputs and cost with those of its stage data, under movements of the command."""
    assert take(made, problem)
    given, moves = stages(problem), np.random.default_rng(seed).normal(size=problem.grid.stages)
    outputs, cost = costed(given.arrays, given.numbers["constant"], moves)
    arrays = made._arrays | {"weight": given.arrays["weight"]}
    own, own_cost = costed(arrays, float(made._records["constant"][0]), moves)
    np.testing.assert_allclose(own, outputs, atol=1e-9 * np.abs(outputs).max())
    assert own_cost == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize("changes", VARIANTS.values(), ids=VARIANTS)
def test_its_stages_are_those_of_the_stage_data(
    scene: Scene, taps: list[Recording], changes: dict[str, float | str]
) -> None:
    changed = with_values(scene, changes) if changes else scene
    problem = posed(changed, taps, 0.4, 5.0)
    assert stands(problem)
    made = standing(problem)
    for seed, place in enumerate([(0.1, 1.0), (0.3, 3.0), (0.4, 5.0)]):
        compare(made, posed(changed, taps, *place), seed)


@pytest.mark.parametrize("A", PLANTS.values(), ids=PLANTS)
def test_any_plant_has_the_stages_of_the_stage_data(scene: Scene, taps: list[Recording], A: FloatArray) -> None:
    problem, posing = posed(scene, taps, 0.4, 5.0), Context.recorded(scene, taps).posing
    B, C, D = np.array([[1.0, 2.0, 3.0, -4.0]]).T, np.array([[3.0, -2.0, 4.0, 1.0]]), np.ones((1, 1))

    def of(share: float) -> TransientProblem:
        return replace(problem, stage=posing.stage(StateSpace(share * A, share * B, C, D)))

    made = standing(of(1.0))
    for seed in range(3):
        compare(made, of(1.0 + 0.2 * seed), seed)


@pytest.mark.parametrize("place", [(0.1, 1.0), (0.4, 5.0)], ids=["free", "limited"])
def test_its_proof_is_that_of_the_certificate(
    scene: Scene, taps: list[Recording], place: tuple[float, float]
) -> None:
    problem = posed(scene, taps, *place)
    made = standing(problem)
    assert take(made, problem)
    command = made.limited()
    assert command is not None
    proof, kept, whole = made.proven(), made._by_row, made.given
    pairs = {
        name: tuple(kept[side][:, j] * OBJECTIVE_SCALE / made._units[j] for side in (0, 1))
        for j, name in enumerate(whole.limits.kinds)
    }
    hand_over = made._by_rule * OBJECTIVE_SCALE / whole.input_scale
    judged = certify(problem, command, Multipliers(command.size, pairs, hand_over, np.zeros(command.size)))
    assert judged.accepted
    assert proof.merit == pytest.approx(judged.merit, rel=1e-10)
    assert proof.gap_by_command == pytest.approx(judged.duality_gap, abs=1e-8 * judged.merit)
    assert max(proof.excess) <= 1e-9


@pytest.mark.parametrize("cut", [0, 200])
def test_an_earlier_search_leaves_no_multipliers_behind(scene: Scene, taps: list[Recording], cut: int) -> None:
    """Neither in a short search, beyond its cut, nor in a whole one, which may end short."""
    problem = posed(scene, taps, 0.4, 5.0)
    made = standing(problem)
    assert take(made, problem)
    made._sides[:] = 1.0
    assert made.limited(cut) is not None
    assert not made._sides[:, 200:].any()
    assert made.proven().gap_by_command < 1e-9


class TestRefused:
    def test_modes_that_are_none(self, scene: Scene, taps: list[Recording]) -> None:
        """A plant with a Jordan block has no coordinates in which its states are apart."""
        problem = posed(scene, taps, 0.4, 5.0)
        made, plant = standing(problem), problem.stage.plant
        n = plant.order
        chained = StateSpace(50 * np.eye(n, k=1) - 100 * np.eye(n), plant.B, plant.C, plant.D)
        assert made.drive(chained)
        wanted = np.ascontiguousarray(problem.tracking.wanted)
        assert not made.poses(wanted, problem.tracking.energy_m2_s4, 0.0)
        assert take(made, problem)

    def test_modes_that_are_nearly_the_same(self, scene: Scene, taps: list[Recording]) -> None:
        """A pole of the amplifier beside one of the hand: `modes_of` does not use such coordinates either."""
        problem = posed(with_values(scene, {"amplifier.pole_Hz": 60.0}), taps, 0.1, 1.0)
        assert not take(standing(problem), problem)
        np.testing.assert_array_equal(modes_of(problem, linear_stage(problem)).T, np.eye(layout(problem).states))

    @pytest.mark.parametrize(("rate", "force"), [(1e8, 1.0), (1e300, 1.0), (1.0, 1e308)])
    def test_a_plant_that_grows_out_of_all_numbers(
        self, scene: Scene, taps: list[Recording], rate: float, force: float
    ) -> None:
        problem = posed(with_values(scene, {"weights.rapid": "none"}), taps, 0.4, 5.0)
        made, plant = standing(problem), problem.stage.plant
        A, B = np.diag(np.arange(1.0, plant.order + 1) / plant.order), np.ones_like(plant.B)
        grown = StateSpace(rate * A, force * B, plant.C, plant.D)
        wanted = np.ascontiguousarray(problem.tracking.wanted)
        assert not (made.drive(grown) and made.poses(wanted, 1.0, 0.0))

    def test_a_target_that_is_no_number(self, scene: Scene, taps: list[Recording]) -> None:
        problem = posed(scene, taps, 0.4, 5.0)
        made = standing(problem)
        made.drive(problem.stage.plant)
        wanted = np.ascontiguousarray(problem.tracking.wanted) * np.nan
        if made.poses(wanted, problem.tracking.energy_m2_s4, 0.0):
            assert made.limited() is None

    def test_problems_of_another_kind(self, scene: Scene, taps: list[Recording]) -> None:
        problem = posed(scene, taps, 0.4, 5.0)
        assert stands(problem)
        assert not stands(replace(problem, spread=(problem.stage,)))
        assert not stands(replace(problem, heat_price=1e-3))
        assert not stands(replace(problem, intensity=0.1))
        for other in (
            walled_scene(scene, 60.0),
            with_values(scene, {"limits.supply_V": 20.0}),
            with_values(scene, {"amplifier": "ideal"}),
        ):
            assert not stands(posed(other, taps, 0.4, 5.0))
