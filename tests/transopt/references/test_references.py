"""The grip axis of references: cells by speed and grip, blends between them, and mixtures that are refused."""

import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from transopt.base.errors import InputError
from transopt.base.signals import nrmse
from transopt.recordings.recording import Recording
from transopt.references.reference import COURSES, Reference
from transopt.references.references import References, grip_groups
from transopt.scene.keys import with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings

GRIPS_N = (1.0, 3.0, 5.0)
Chosen = Callable[[float, float], bool]


@pytest.fixture(scope="module")
def gripped(scene: Scene) -> list[Recording]:
    """Taps of four speeds at three grips."""
    return of_grips(scene, GRIPS_N)


def of_grips(scene: Scene, grips_N: Sequence[float]) -> list[Recording]:
    return recordings(with_values(scene, {"grid.grips_N": list(grips_N)}))


@pytest.fixture(scope="module")
def whole(scene: Scene, gripped: list[Recording]) -> References:
    return references_of(scene, gripped)


def some(scene: Scene, taps: Sequence[Recording], chosen: Chosen) -> References:
    """References of the taps whose node speed and grip are chosen."""

    def node(recording: Recording) -> float:
        assert recording.speed_m_s is not None
        return min(scene.grid.speeds_m_s, key=lambda v: abs(v - recording.speed_m_s))

    return references_of(scene, [tap for tap in taps if chosen(node(tap), tap.grip_N or 0.0)])


def assert_alike(found: Reference, wanted: Reference) -> None:
    for name in COURSES:
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-12, atol=1e-15)


def test_a_recording_that_ends_within_the_tail_is_told_with_what_mends_it(
    scene: Scene, taps: list[Recording]
) -> None:
    """Unknown is not zero: 10 ms of the tail are missing at one speed."""
    whole = references_of(scene, taps)
    assert not whole.remarks([3.0])
    grid = scene.time_grid()
    needed_s = float(grid.after_times_s[-1])

    def shortened(recording: Recording) -> Recording:
        of = next(tap for cell in whole for tap in cell.taps if tap.recording.name == recording.name)
        x = recording.acceleration
        cut = round((of.acceleration.end_s - needed_s + 10e-3) / x.dt_s)
        return replace(recording, acceleration=replace(x, values=x.values[:-cut]))

    last = scene.grid.speeds_m_s[-1]
    short = [shortened(tap) if abs((tap.speed_m_s or 0) - last) < 0.02 else tap for tap in taps]
    (said,) = references_of(scene, short).remarks([3.0])
    found = re.fullmatch(rf"{last:g} m/s: recordings end up to (\S+) ms before .*: record longer, or lower .*", said)
    assert found is not None, said
    missing_s = 1e-3 * float(found.group(1))
    assert missing_s == pytest.approx(10e-3, abs=2e-3)
    mended = with_values(scene, {"weights.after_s": scene.weights.after_s - missing_s})
    assert not references_of(mended, short).remarks([3.0])


class TestCells:
    def test_each_speed_and_grip_has_its_own_taps(self, whole: References) -> None:
        assert (whole.speeds_m_s, whole.grips_N) == ((0.1, 0.2, 0.3, 0.4), GRIPS_N)
        assert len(whole) == 12
        for cell in whole:
            assert len(cell.taps) == 3
            assert {tap.recording.grip_N for tap in cell.taps} == {cell.grip_N}
            assert whole.at(cell.speed_m_s, cell.grip_N) is cell

    def test_a_grip_of_more_than_three_digits_has_its_own_taps(self, scene: Scene) -> None:
        grips_N = [1.0, 1.444444, 5.0]
        stated = with_values(scene, {"grid.grips_N": grips_N})
        found = references_of(stated, recordings(stated))
        for speed, grip in itertools.product(scene.grid.speeds_m_s, grips_N):
            cell = found.at(speed, grip)
            assert (cell.grip_N, cell.of_grips_N) == (grip, (grip,))
            assert {tap.recording.grip_N for tap in cell.taps} == {grip}

    def test_grips_are_not_alike(self, whole: References) -> None:
        """They differ by more than ten times what repeats do: averaged, no grip would have its tap."""
        own, other = whole.at(0.3, 1.0), whole.at(0.3, 3.0)
        assert nrmse(other.recorded_m_s2, own.recorded_m_s2) > 10 * own.repeatability

    def test_grips_that_a_sensor_cannot_tell_apart_are_one(self, scene: Scene, taps: list[Recording]) -> None:
        held = [replace(tap, grip_N=2.951 + 0.1 * (k % 2)) for k, tap in enumerate(taps)]
        found = references_of(scene, held)
        assert len(found) == 4
        assert found.grips_N == pytest.approx((3.0,))
        assert "taps of 2.951 to 3.051 N are taken as of one grip, 3 N" in found.remarks([3.0])[0]
        assert grip_groups([1.0, 1.04, 1.06, 3.0]) == [[1.0, 1.04], [1.06], [3.0]]


class TestMissing:
    def test_a_missing_cell_is_interpolated_within_its_speed(
        self, scene: Scene, gripped: list[Recording], whole: References
    ) -> None:
        found = some(scene, gripped, lambda v, F: (v, F) != (0.1, 3.0))
        cell = found.at(0.1, 3.0)
        low, high = whole.at(0.1, 1.0), whole.at(0.1, 5.0)
        for name in COURSES:
            np.testing.assert_allclose(
                getattr(cell, name), 0.5 * (getattr(low, name) + getattr(high, name)), rtol=1e-12, atol=1e-15
            )
        assert (cell.grip_N, cell.of_grips_N) == (3.0, (1.0, 5.0))
        assert nrmse(cell.recorded_m_s2, whole.at(0.1, 3.0).recorded_m_s2) < 0.05
        assert found.remarks(GRIPS_N) == ["0.1 m/s, 3 N: blended from the taps of 1 and 5 N"]

    def test_beyond_its_grips_the_nearest_serves(
        self, scene: Scene, gripped: list[Recording], whole: References
    ) -> None:
        found = some(scene, gripped, lambda v, F: (v, F) != (0.4, 5.0))
        cell = found.at(0.4, 5.0)
        assert (cell.grip_N, cell.of_grips_N) == (5.0, (3.0,))
        assert_alike(cell, whole.at(0.4, 3.0))
        (said,) = found.remarks(GRIPS_N)
        assert "0.4 m/s, 5 N: taps of 1 and 3 N only" in said

    def test_grips_of_the_scene_need_not_be_recorded(self, whole: References) -> None:
        found = whole.at(0.2, 2.0)
        low, high = whole.at(0.2, 1.0), whole.at(0.2, 3.0)
        np.testing.assert_allclose(found.recorded_m_s2, 0.5 * (low.recorded_m_s2 + high.recorded_m_s2), rtol=1e-12)
        assert whole.remarks([0.5, 2.0, 6.0]) == [
            "0.1, 0.2, 0.3 and 0.4 m/s, 0.5 and 6 N: taps of 1, 3 and 5 N only, that of the nearest grip serves",
            "0.1, 0.2, 0.3 and 0.4 m/s, 2 N: blended from the taps of 1, 3 and 5 N",
        ]

    def test_a_speed_without_any_tap_is_refused(self, scene: Scene, gripped: list[Recording]) -> None:
        with pytest.raises(InputError, match=r"grid.speeds_m_s: no recording within 15% of 0.4 m/s"):
            some(scene, gripped, lambda v, F: v < 0.35)

    def test_between_speeds_the_shape_is_blended_at_the_grip(self, whole: References) -> None:
        found, slow, fast = whole.at(0.25, 2.0), whole.at(0.2, 2.0), whole.at(0.3, 2.0)
        for name in COURSES:
            wanted = 0.25 * (0.5 * getattr(slow, name) / 0.2 + 0.5 * getattr(fast, name) / 0.3)
            np.testing.assert_allclose(getattr(found, name), wanted, rtol=1e-9, atol=1e-15)
        assert (found.speed_m_s, found.grip_N, found.between_m_s) == (0.25, 2.0, (0.2, 0.3))
        assert found.of_grips_N == (1.0, 3.0)
        assert len(found.taps) == len(found.factors) == 12

    @pytest.mark.parametrize("grip_N", [0.5, 2.0, 3.0])
    def test_those_of_one_grip_give_the_same_at_any_speed(self, whole: References, grip_N: float) -> None:
        of_grip = whole.of_grip(grip_N)
        for speed_m_s in (0.1, 0.13, 0.3, 0.35):
            found, wanted = of_grip.at(speed_m_s, grip_N), whole.at(speed_m_s, grip_N)
            assert_alike(found, wanted)
            assert (found.grip_N, found.between_m_s, found.of_grips_N, found.taps) == (
                wanted.grip_N,
                wanted.between_m_s,
                wanted.of_grips_N,
                wanted.taps,
            )

    def test_repeatability_and_taps_are_those_of_both_neighbours(self, references: list[Reference]) -> None:
        slow, fast = references[2:]
        between = References(tuple(references)).at(0.36, 3.0)
        assert between.repeatability == max(slow.repeatability, fast.repeatability)
        assert between.taps == slow.taps + fast.taps
        np.testing.assert_allclose(between.factors[:3], 1.2 * slow.factors)
        np.testing.assert_allclose(between.factors[3:], 0.9 * fast.factors)
        once = replace(slow, repeatability=float("nan"))
        assert np.isnan(References((once, fast)).at(0.36, 3.0).repeatability)

    @pytest.mark.parametrize("speed_m_s", [0.05, 0.41, 0.5, float("nan")])
    def test_outside_of_the_speeds_nothing_is_known(self, whole: References, speed_m_s: float) -> None:
        with pytest.raises(
            InputError, match=rf"speed {speed_m_s:g} m/s: references are known from 0.1 to 0.4 m/s only"
        ):
            whole.at(speed_m_s, 3.0)
        with pytest.raises(InputError, match="no speed"):
            References().at(0.2, 3.0)


class TestWithoutGrip:
    def test_they_serve_every_grip_and_it_is_said(self, scene: Scene, taps: list[Recording]) -> None:
        found = references_of(scene, [replace(tap, grip_N=None) for tap in taps])
        for grip in (1.0, 2.2, 5.0, 9.0):
            np.testing.assert_allclose(
                found.at(0.3, grip).recorded_m_s2, found.at(0.3, 3.0).recorded_m_s2, rtol=1e-12, atol=1e-12
            )
        (said,) = found.remarks(scene.grid.grips_N)
        assert "serve every grip" in said
        assert "3.6 to 13.0 %" in said
        assert not found.remarks([3.0])

    def test_a_mixture_is_refused_by_name(self, scene: Scene, taps: list[Recording]) -> None:
        mixed = [replace(taps[0], grip_N=None), *taps[1:]]
        with pytest.raises(InputError, match=rf"{taps[0].name}: states no grip, as 1 of {len(taps)} taps"):
            references_of(scene, mixed)

    def test_slow_parts_have_to_be_known_of_all(self, scene: Scene, taps: list[Recording]) -> None:
        settings = scene.recordings.model_copy(update={"trusted_from_Hz": 5.0})
        coupled = scene.model_copy(update={"recordings": settings})
        blind = [replace(tap, position=None) if k == 0 else tap for k, tap in enumerate(taps)]
        found = references_of(coupled, blind)
        known = [found.at(v, 1.0).slow_part_known for v in (0.1, 0.15, 0.2, 0.3)]
        assert known == [False, False, True, True]


def test_other_courses_have_a_target_of_their_own(whole: References) -> None:
    """Whether the hand accelerates the stylus is asked anew of courses that replace others."""
    cell = whole.cells[0]
    assert cell.aims_at_recorded
    part, _ = cell.within_stacked["free_m_s2"]
    courses = cell.stacked.copy()
    courses[part] += 1.0
    moved = cell.with_courses(courses)
    np.testing.assert_allclose(moved.target.window_m_s2, cell.recorded_m_s2 - 1.0, rtol=1e-12, atol=1e-12)


def test_a_blend_has_a_target_of_its_own(whole: References) -> None:
    for cell in whole:
        assert cell.target is cell.target  # kept with the cell, from which a blend must not take it
    for found in (whole.at(0.25, 3.0), whole.at(0.2, 2.0)):
        np.testing.assert_array_equal(found.target.window_m_s2, found.recorded_m_s2 - found.free_m_s2)
        np.testing.assert_array_equal(found.target.free_m_s2[found.target.lost :][:3], found.free_m_s2[:3])
