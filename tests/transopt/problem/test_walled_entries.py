"""Entries on a virtual wall: refusals by name, the ticks at which it pushes, libraries."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate

from tests.benches.libraries import proven_again, under
from tests.benches.limits import with_numbers
from tests.benches.tails import without_tail
from tests.conftest import WalledMaker, walled_scene
from tests.transopt.plant.test_wall import plain_feedback, plain_prefilter
from transopt.design.build import build_library
from transopt.design.context import Context
from transopt.design.design import design
from transopt.design.optimum import optimum
from transopt.design.verify import verify_library
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.problem.answer import Status
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import pressing
from transopt.recordings.recording import Recording
from transopt.references.reference import Reference
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

DT_S = 1e-4


class TestRefusal:
    def weak(self, problem: TransientProblem) -> TransientProblem:
        """A motor that can neither hold the stylus up nor push back what the wall asks for."""
        return with_numbers(problem, current_A=0.3)

    def test_names_the_hand_over(self, walled: WalledMaker, references: list[Reference]) -> None:
        designed = optimum(self.weak(walled(2000, 0.4)), SolverOptions())
        assert designed.solution.status is Status.HAND_OVER
        (reason,) = designed.remarks
        assert reason.endswith(" below the surface, where the reference goes, limit 0.3 A")
        # The deepest point of the recorded motion from the hand-over on: the wall pushes on after the waveform.
        problem = walled(2000, 0.4)
        fast, target = references[-1], problem.target
        recorded = target.lasting(target.recorded_m_s2)
        velocity = -fast.speed_m_s + integrate.cumulative_trapezoid(recorded, dx=DT_S, initial=0)
        course = integrate.cumulative_trapezoid(velocity, dx=DT_S, initial=0)
        depth_mm = -1e3 * float(course[problem.free_stages :].min())
        said = re.match(r"hand-over: K_p z / k_f = (\S+) A at (\S+) mm", reason)
        assert [float(number) for number in said.groups()] == pytest.approx([2 * depth_mm / 1.25, depth_mm], rel=0.03)

    def test_a_wall_that_holds_the_stylus_up_itself_is_no_reason(self, walled: WalledMaker) -> None:
        """The reference would go 2.7 mm deep, where 2000 N/m ask for 4.4 A; the answer does not go there."""
        designed = optimum(walled(2000, 0.4), SolverOptions())
        assert designed.solution.status is Status.OPTIMAL
        assert designed.certificate.accepted
        assert np.abs(designed.solution.command[-10:]).max() < 4

    def test_a_refused_entry_says_so_in_the_design(self, scene: Scene, references: list[Reference]) -> None:
        data = walled_scene(scene, 2000.0).model_dump()
        data["limits"].update(beta=None, current_A=0.3)
        (entry,) = design([Context(Scene.model_validate(data)).posed_as(references[-1], 3.0)])
        assert entry.status is Status.HAND_OVER
        assert "limit 0.3 A" in entry.shortfalls[0]


class TestMask:
    def test_is_taken_anew_from_the_answers_motion(self, walled: WalledMaker) -> None:
        """A hand that lets the stylus come back to the surface just where the reference and the answer part.

        At 0.4 m/s and 5 N the answer saturates, so that its motion is not the reference's.
        """
        problem = without_tail(walled(500, 0.4, 5.0, damping_N_s_m=0.0))
        # Close to the surface the wall asks for next to nothing, so the answer is nearly that without a wall.
        plain = optimum(replace(problem, wall=None), SolverOptions())
        answer = plain.problem.feedback.course(plain.problem.stage.motion(plain.solution.command))
        t, r = problem.grid.switching_times_s, problem.reference_m_s2
        velocity = np.append(0.0, np.cumsum((r[1:] + r[:-1]) / 2) * DT_S)
        intended = np.interp(
            problem.grid.issue_times_s, t, np.append(0.0, np.cumsum((velocity[1:] + velocity[:-1]) / 2) * DT_S)
        )
        apart = np.abs(answer - intended)[-10:].min()
        assert apart > 1e-5
        nominal = problem.wall.nominal_m.copy()
        nominal[-80:] = -(answer + intended)[-80:] / 2
        designed = optimum(replace(problem, wall=replace(problem.wall, nominal_m=nominal)), SolverOptions())
        assert designed.solution.status is Status.OPTIMAL
        assert designed.certificate.accepted
        final = designed.problem
        first_guess = pressing(final, intended).wall
        course = final.feedback.course(final.stage.motion(designed.solution.command))
        last = pressing(final, course).wall
        tail = slice(final.free_stages - 1, None)
        np.testing.assert_array_equal(final.wall.pressing[tail], last.pressing[tail])
        assert np.any(first_guess.pressing[tail] != last.pressing[tail]), "the mask did not change"


@pytest.fixture(scope="module")
def walled_library(scene: Scene, taps: list[Recording]) -> Library:
    data = walled_scene(scene, 200.0).model_dump()
    data["grid"] = {"speeds_m_s": [0.3, 0.4], "grips_N": [3.0]}
    # The loaded file's references come from these taps alone.
    chosen = [tap for tap in taps if tap.speed_m_s is None or tap.speed_m_s > 0.25]
    built = build_library(Scene.model_validate(data), chosen)
    assert built.library is not None, [entry.shortfalls for entry in built.refused]
    return built.library


class TestLibrary:
    def test_stores_what_is_left_of_the_command(self, walled_library: Library) -> None:
        """From the file's own arrays: transient = command - prefilter(feedback of the predicted motion)."""
        lib, wall = walled_library, walled_library.wall()
        assert wall is not None
        for iv, speed in enumerate(lib.speeds_m_s):
            problem = lib.problem(iv, 0)
            deviation = problem.feedback.course(problem.stage.motion(lib.command[iv, 0]))
            law = plain_feedback(wall, lib.nominal_position_at_ticks_m[iv, 0] + deviation, speed)
            assert law.max() > 0.3
            expected = lib.command[iv, 0] - plain_prefilter(law)
            np.testing.assert_allclose(lib.transient_command[iv, 0], expected, atol=1e-8)
            assert not lib.transient_command[iv, 0, -10:].any()

    def test_round_trip_and_verify(self, walled_library: Library, tmp_path: Path) -> None:
        loaded = proven_again(walled_library, tmp_path)
        assert loaded.wall() == walled_library.wall()
        assert loaded.command.shape[:2] == (2, 1)

    def test_a_tampered_transient_is_noticed(self, walled_library: Library, tmp_path: Path) -> None:
        transient = walled_library.transient_command.copy()
        transient[1, 0, 100] += 0.01
        replace(walled_library, transient_command=transient).save(tmp_path / "library.npz")
        clean, tampered = verify_library(load_library(tmp_path / "library.npz"))
        assert clean.shortfalls == []
        assert any("transient_command" in text for text in tampered.shortfalls)
        assert any("wall's feedback the command differs" in text for text in tampered.shortfalls)

    def test_another_wall_than_the_designs_is_noticed(self, walled_library: Library) -> None:
        softer = under(walled_library, {"feedback.stiffness_N_m": 450.0})
        assert all(check.shortfalls for check in verify_library(softer))
