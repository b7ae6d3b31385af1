"""Cool commands with less heat: what they are worth beside an independent program, and how a library keeps them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from pydantic import ValidationError

import transopt as to
from tests.benches.dense import Program, responses
from tests.benches.libraries import proven_again
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.resolve import resolve
from transopt.design.verify import verify_library
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.library.proven import doubts
from transopt.problem.problem import TransientProblem
from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

SHARE = 0.36


@pytest.fixture(scope="module")
def cooled(scene: Scene) -> Library:
    """Two speeds, of which one saturates, and two grips, over 20 ms."""
    small = {"grid.speeds_m_s": [0.2, 0.4], "grid.grips_N": [1.0, 5.0], "time.stages": 200, "weights.after_s": 0.01}
    return to.solve(with_values(scene, {**small, "grid.cool_share": SHARE}))


def cool(library: Library) -> Library:
    assert library.cool is not None
    return library.cool


def least_under(problem: TransientProblem, most_heat_A2: float) -> float:
    """J of the best command with no more heat, by condensing and an interior-point method for nonlinear programs."""
    program, N, free = Program.of(problem), problem.grid.stages, problem.free_stages
    current = responses(problem).current[:N, :free]
    H, g = program.quadratic()
    c, made = ca.MX.sym("c", free), ca.DM(current)
    i = made @ c
    program_of = {"x": c, "f": 0.5 * ca.dot(c, ca.DM(H[:free, :free]) @ c) + ca.dot(g[:free], c)}
    program_of["g"] = ca.vertcat(i, ca.dot(i, i))
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}}
    solver = ca.nlpsol("least", "ipopt", program_of, options)
    limit, most = problem.limits["current"].stated, problem.limits["command"].stated
    high = np.append(np.full(N, limit), most_heat_A2)
    answer = solver(x0=0, lbx=-most, ubx=most, lbg=-high, ubg=high)
    assert solver.stats()["success"]
    return program.merits(np.append(np.asarray(answer["x"]).ravel(), np.zeros(N - free)))[0]


class TestOptimum:
    def test_each_has_the_share_of_heat_that_is_asked_for(self, cooled: Library) -> None:
        share = cool(cooled).heat_A2_s / cooled.heat_A2_s
        assert np.all(share <= SHARE)
        assert np.all(share > 0.997 * SHARE)
        assert np.all(cool(cooled).heat_price > 0)
        assert np.all(cooled.heat_price == 0)

    @pytest.mark.parametrize("place", [(0, 0), (1, 1)])
    def test_no_admissible_command_with_as_little_heat_is_better(
        self, cooled: Library, place: tuple[int, int]
    ) -> None:
        own = replace(cool(cooled).problem(*place), heat_price=0.0)
        command = cool(cooled).command[place]
        current = responses(own).current[: own.grid.stages] @ command
        reached = Program.of(own).merits(command)[0]
        assert reached == pytest.approx(least_under(own, float(current @ current)), rel=1e-5)

    def test_what_is_felt_is_kept_where_a_weaker_first_command_loses_it(self, cooled: Library) -> None:
        scaled_dB = 10 * np.log10(SHARE)  # of the command, whose amplitude falls by the root of the heat
        assert np.all(cool(cooled).felt_dB > cooled.felt_dB + 0.5 * scaled_dB)

    def test_beside_a_wall_the_least_heat_is_taken_that_its_hand_over_leaves(self, scene: Scene) -> None:
        values = {"grid.speeds_m_s": [0.2], "grid.grips_N": [3.0], "hand.yields": "brakes", "grid.cool_share": 0.01}
        wall = {"feedback": {"stiffness_N_m": 300.0, "damping_N_s_m": 1.0}}
        library = to.solve(with_values(scene, {**values, **wall}))
        assert 0.01 < cool(library).heat_A2_s[0, 0] / library.heat_A2_s[0, 0] < 0.02
        assert not list(doubts(library))

    @pytest.mark.parametrize("name", ["hot_coil", "rapid_tapping", "free_stylus", "walled"])
    def test_scenes_of_every_kind_have_them(self, name: str) -> None:
        library = to.solve(with_values(load_scene(name), {"grid.cool_share": 0.5}))
        share = cool(library).heat_A2_s / library.heat_A2_s
        assert np.all(share <= 0.5)
        assert np.all(share > 0.997 * 0.5)
        assert not list(doubts(library))


class TestLibrary:
    def test_it_is_read_back_as_it_was_written(self, cooled: Library, tmp_path: Path) -> None:
        loaded = proven_again(cooled, tmp_path)
        for name in cool(cooled).stored():
            np.testing.assert_array_equal(cool(loaded).array(name), cool(cooled).array(name))
        assert cool(loaded).meta["left_out"] == cool(cooled).meta["left_out"]
        assert len(verify_library(loaded)) == 8  # the first commands and the cool ones

    def test_a_part_that_is_missing_is_named(self, cooled: Library, tmp_path: Path) -> None:
        replace(cooled, cool=None).save(tmp_path / "halved.npz")
        with pytest.raises(InputError, match="array cool_command is missing"):
            load_library(tmp_path / "halved.npz")

    def test_one_that_its_scene_does_not_ask_for_is_refused(self, cooled: Library, tmp_path: Path) -> None:
        scene = {**cooled.meta["scene"], "grid": {**cooled.meta["scene"]["grid"], "cool_share": None}}
        replace(cooled, meta={**cooled.meta, "scene": scene}).save(tmp_path / "unasked.npz")
        with pytest.raises(InputError, match=r"meta\.cool does not go with its scene's grid\.cool_share"):
            load_library(tmp_path / "unasked.npz")

    @pytest.mark.parametrize(
        ("changed", "said"),
        [
            (lambda own: {"command": 1.001 * own.command}, "cool command of entry 0.2 m/s, 1 N"),
            (lambda own: {"heat_price": 0.9 * own.heat_price}, "cool command of entry 0.2 m/s, 1 N"),
            (lambda own: {"felt_error": 0.5 * own.felt_error}, "felt_error says"),
            (lambda own: {"heat_A2_s": 3 * own.heat_A2_s}, "cool_heat_A2_s is above"),
            (lambda own: {"heat_price": -own.heat_price}, "cool_heat_price falls to"),
        ],
    )
    def test_one_that_was_changed_is_not_believed(
        self, cooled: Library, changed: Callable[[Library], dict[str, FloatArray]], said: str
    ) -> None:
        own = cool(cooled)
        assert said in next(doubts(replace(cooled, cool=replace(own, **changed(own)))))

    def test_a_first_command_may_not_have_another_price_than_its_scene(self, cooled: Library) -> None:
        warm = replace(cooled, heat_price=cooled.heat_price + 1e-5)
        assert "heat_price reaches" in next(doubts(warm))
        # Nor may the cool command stand in for the first.
        assert any("heat_price reaches" in said for said in doubts(replace(cool(cooled), cool=None)))

    def test_both_follow_a_correction(self, cooled: Library, tmp_path: Path) -> None:
        asked = {(0, 1): 0.1 * cooled.uncorrected(0, 1).window_m_s2}
        refined, kept = resolve(cooled, asked, {"rounds": []})
        assert not kept
        loaded = proven_again(refined, tmp_path)
        for of, before in ((loaded, cooled), (cool(loaded), cool(cooled))):
            assert np.abs(of.command[0, 1] - before.command[0, 1]).max() > 0.01
            np.testing.assert_array_equal(of.command[0, 0], before.command[0, 0])


class TestScene:
    @pytest.mark.parametrize(
        ("name", "values"),
        [
            ("lra_click", {}),
            ("wood_on_foam", {"weights.objective": "intensity"}),
        ],
    )
    def test_where_no_price_on_a_current_finds_it_it_is_refused(self, name: str, values: dict[str, object]) -> None:
        with pytest.raises((InputError, ValidationError), match=r"grid\.cool_share"):
            with_values(load_scene(name), {**values, "grid.cool_share": SHARE})

    @pytest.mark.parametrize("share", [0.0, 1.0, -0.1, float("nan")])
    def test_a_share_lies_between_none_and_all(self, scene: Scene, share: float) -> None:
        with pytest.raises((InputError, ValidationError), match="cool_share"):
            with_values(scene, {"grid.cool_share": share})
