"""What an entry asks of its recordings: its grip's cell, and no plain error where the slow part is unknown."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import problems
from tests.benches.libraries import proven_again
from transopt.base.errors import InputError
from transopt.design.build import build_library
from transopt.design.context import Context
from transopt.recordings.recording import Recording
from transopt.references.reference import COURSES
from transopt.references.references import TARGETS, References
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings


def test_every_grip_is_asked_for_its_own_tap(scene: Scene, taps: list[Recording], recorded: References) -> None:
    context = Context.recorded(scene, taps)
    for speed_m_s, grip_N in ((0.1, 1.0), (0.4, 5.0), (0.25, 2.2)):
        wanted = recorded.at(speed_m_s, grip_N).target
        asked = context.posed(speed_m_s, grip_N).problem.target
        np.testing.assert_allclose(asked.window_m_s2, wanted.window_m_s2, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(asked.after_m_s2, wanted.after_m_s2, rtol=1e-12, atol=1e-12)


def test_cells_are_the_references_of_the_grid_in_common_arrays(scene: Scene, recorded: References) -> None:
    between = with_values(scene, {"grid.speeds_m_s": [0.1, 0.15, 0.4], "grid.grips_N": [1.0, 2.0, 5.0]})
    cells = Context(between, recorded).cells
    for i, row in enumerate(cells.rows):
        for j, cell in enumerate(row):
            wanted = recorded.at(between.grid.speeds_m_s[i], between.grid.grips_N[j])
            assert (cell.speed_m_s, cell.grip_N, cell.taps) == (wanted.speed_m_s, wanted.grip_N, wanted.taps)
            of_target = zip(TARGETS, ("before_m_s2", "window_m_s2", "after_m_s2"), strict=True)
            named = [(name, cell, wanted, name) for name in COURSES]
            named += [(name, cell.target, wanted.target, part) for name, part in of_target]
            assert {name for name, *_ in named} == set(cells.courses)
            for name, own, expected, part in named:
                course = cells.courses[name][i, j]
                np.testing.assert_allclose(course, getattr(expected, part), rtol=1e-12, atol=1e-15)
                assert np.shares_memory(course, getattr(own, part)) or course.size == 0


@pytest.fixture(scope="module")
def one() -> Scene:
    """One entry, struck with a sensor that loses what is slower than 5 Hz."""
    values = {"grid.speeds_m_s": [0.2], "grid.grips_N": [3.0], "recordings.trusted_from_Hz": 5.0}
    return with_values(problems.load("wood_on_foam"), values)


class TestSlowPart:
    def test_without_a_position_the_rapid_error_alone_is_minimised(self, one: Scene, tmp_path: Path) -> None:
        blind = [replace(tap, position=None) for tap in recordings(one)]
        assert [term.name for term in Context.recorded(one, blind).posed(0.2, 3.0).problem.terms] == ["rapid"]
        assert not proven_again(build_library(one, blind).library, tmp_path).wanted_of(0, 0).slow_part_known

    def test_with_one_both_are(self, one: Scene) -> None:
        context = Context.recorded(one, recordings(one))
        assert [term.name for term in context.posed(0.2, 3.0).problem.terms] == ["plain", "rapid"]

    def test_without_either_nothing_is_left(self, one: Scene) -> None:
        blind = [replace(tap, position=None) for tap in recordings(one)]
        with pytest.raises(InputError, match="no error term is left"):
            Context.recorded(with_values(one, {"weights.rapid": "none"}), blind).posed(0.2, 3.0)
