"""References: one for each tap, and those of a grid."""

import itertools
import pickle
import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from controller.sim.simulator import Simulator
from controller.sim.true_device import device_of
from controller.sim.user import TapUser
from tests.benches.pulses import pulse
from transopt.base.errors import InputError
from transopt.base.filters import highpass
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray, Signal, nrmse
from transopt.plant.time_grid import TimeGrid
from transopt.recordings.onset import find_onsets
from transopt.recordings.recording import Recording
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import prepare
from transopt.references.reference import COURSES, Free, Reference, TimeAxis, build_reference
from transopt.references.references import References, assign, grip_groups
from transopt.scene.keys import with_values
from transopt.scene.recordings import references_of, sampled_again
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings, strike

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

    @pytest.mark.parametrize(("speed_m_s", "a0_m_s2"), [(0.3, 0.0), (0.37, 0.0), (0.3, 3.0), (0.37, 3.0)])
    @pytest.mark.parametrize("grip_N", [1.0, 4.0])
    def test_without_current_the_stylus_moves_as_in_the_hand_at_the_grip(
        self, scene: Scene, gripped: list[Recording], grip_N: float, speed_m_s: float, a0_m_s2: float
    ) -> None:
        """The simulator is the judge. The hand of the recordings, at 3 N, would be 1.3 of 5.6 m/s^2 off at 1 N."""
        yielding = with_values(scene, {"hand.yields": "brakes"})
        made = some(yielding, gripped, lambda speed, grip: grip == 3.0)
        came = [
            replace(cell, taps=tuple(replace(tap, incoming_acceleration_m_s2=a0_m_s2) for tap in cell.taps))
            for cell in made
        ]
        found = pickle.loads(pickle.dumps(sampled_again(yielding, replace(made, cells=tuple(came)))))
        cell, grid, w = found.at(speed_m_s, grip_N), yielding.time_grid(), (speed_m_s - 0.3) / 0.1
        slow, fast = (each.incoming_acceleration_m_s2 / each.speed_m_s for each in found.cells[2:])
        hand = yielding.hand.intention()
        user = TapUser(speed_m_s, grip_N, 0.1, hand, incoming_m_s2=speed_m_s * ((1 - w) * slow + w * fast))
        simulator = Simulator(device_of(yielding), user, grid.dt_s, trace=True)
        for _ in range(round((0.1 + grid.end_s) / grid.dt_s)):
            simulator.advance(0.0)
        trace = simulator.trace()
        truth = np.interp(grid.switching_times_s, trace.times_s - 0.1, trace.acceleration_m_s2)
        np.testing.assert_allclose(cell.free_m_s2, truth, atol=0.02 * np.abs(truth).max())
        # z_nom follows it, at the switching instants and at the ticks.
        for z_m in (cell.nominal_position_m, cell.nominal_position_at_ticks_m[: grid.stages]):
            bent = np.diff(z_m, 2) / grid.dt_s**2
            np.testing.assert_allclose(bent, truth[1:-1], atol=0.1 * np.abs(truth).max())

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


GRID = TimeGrid(1e-4, 300, 3e-4, 68e-6)
SETTINGS = Recordings(files=["unused"])


def steady(speed_m_s: float, grip_N: float, incoming_m_s2: float) -> Callable[[FloatArray], FloatArray]:
    """A hand that goes on as it came."""
    return np.zeros_like


def braking(speed_m_s: float, grip_N: float, incoming_m_s2: float) -> Callable[[FloatArray], FloatArray]:
    """A hand that brakes evenly over 60 ms from contact on."""
    return lambda times_s: np.where((times_s >= 0) & (times_s < 60e-3), speed_m_s / 60e-3, 0.0)


class TestAssign:
    def test_a_tap_goes_to_its_speed_scaled(self) -> None:
        taps = [prepare(pulse(speed=v), SETTINGS) for v in (0.19, 0.42)]
        groups = assign(taps, [0.2, 0.4], SETTINGS)
        assert [factor for ((_, factor),) in groups] == [pytest.approx(0.2 / 0.19), pytest.approx(0.4 / 0.42)]

    def test_too_far_from_every_grid_speed(self) -> None:
        taps = [prepare(pulse(speed=v, name=f"tap_{v}"), SETTINGS) for v in (0.2, 0.3)]
        with pytest.raises(InputError, match=r"tap_0.3: speed 0.3 m/s is 33% from .* 0.2 m/s, limit 15%"):
            assign(taps, [0.2], SETTINGS)

    def test_a_grid_speed_without_a_tap(self) -> None:
        with pytest.raises(InputError, match=r"grid.speeds_m_s: no recording within 15% of 0.4 m/s"):
            assign([prepare(pulse(speed=0.2), SETTINGS)], [0.2, 0.4], SETTINGS)


class TestReference:
    def reference(self, *taps: Recording, free: Free = steady) -> Reference:
        prepared = [prepare(tap, SETTINGS) for tap in taps]
        return build_reference(0.2, 3.0, prepared, np.ones(len(prepared)), TimeAxis(GRID, free))

    def test_nothing_of_a_recording_is_taken_away(self) -> None:
        """What is tracked is the prepared tap itself, less how the stylus moves by itself."""
        tap = prepare(pulse(), SETTINGS)
        found, yielding = self.reference(pulse()), self.reference(pulse(), free=braking)
        recorded = tap.acceleration.at(GRID.switching_times_s)
        np.testing.assert_allclose(found.recorded_m_s2, recorded, rtol=0, atol=1e-12 * recorded.max())
        np.testing.assert_array_equal(found.target.window_m_s2, found.recorded_m_s2)
        np.testing.assert_array_equal(yielding.recorded_m_s2, found.recorded_m_s2)
        np.testing.assert_allclose(yielding.target.window_m_s2, yielding.recorded_m_s2 - yielding.free_m_s2)

    def test_nominal_motion_is_the_free_one(self) -> None:
        """z_nom'' = a_free with z_nom = 0, dz_nom/dt = -v at contact."""
        reference, tau = self.reference(pulse(), free=braking), GRID.switching_times_s
        z, late = reference.nominal_position_m, tau > 1e-3
        np.testing.assert_allclose(z[late], (-0.2 * tau + 0.2 / 60e-3 * tau**2 / 2)[late], atol=1e-6)
        np.testing.assert_allclose(reference.nominal_velocity_m_s[late], (-0.2 + 0.2 / 60e-3 * tau)[late], atol=1e-4)
        straight = self.reference(pulse())
        np.testing.assert_allclose(straight.nominal_position_m, -0.2 * tau, atol=1e-9)

    def test_the_incoming_acceleration_is_the_taps_mean(self) -> None:
        def carried(speed_m_s: float, grip_N: float, incoming_m_s2: float) -> Callable[[FloatArray], FloatArray]:
            return lambda times_s: (10 * speed_m_s + grip_N * incoming_m_s2) * np.ones_like(times_s)

        taps = [replace(prepare(pulse(), SETTINGS), incoming_acceleration_m_s2=a0) for a0 in (2.0, 4.0)]
        found = build_reference(0.2, 3.0, taps, np.array([1.0, 0.5]), TimeAxis(GRID, carried))
        np.testing.assert_allclose(found.free_m_s2, 10 * 0.2 + 3.0 * 2.0)

    def test_one_axis_serves_cells_of_any_speed_and_grip(self) -> None:
        """What it keeps of one cell changes no other."""

        def carried(speed_m_s: float, grip_N: float, incoming_m_s2: float) -> Callable[[FloatArray], FloatArray]:
            return lambda times_s: grip_N * (speed_m_s + incoming_m_s2) * np.cos(40 * times_s)

        taps, one = [replace(prepare(pulse(), SETTINGS), incoming_acceleration_m_s2=2.0)], TimeAxis(GRID, carried)
        for speed_m_s, grip_N in ((0.2, 3.0), (0.4, 3.0), (0.2, 5.0)):
            found = build_reference(speed_m_s, grip_N, taps, np.ones(1), one)
            alone = build_reference(speed_m_s, grip_N, taps, np.ones(1), TimeAxis(GRID, carried))
            tau = GRID.switching_times_s
            np.testing.assert_allclose(found.nominal_position_m, alone.nominal_position_m, atol=1e-15)
            moved = grip_N * (speed_m_s + 2.0) * (1 - np.cos(40 * tau)) / 40**2 - speed_m_s * tau
            np.testing.assert_allclose(found.nominal_position_m, moved, atol=1e-9)

    def test_reference_is_sampled_at_the_switching_instants(self) -> None:
        """Half a tick of error would be 4 % NRMSE; the delay shifts the axis, not the tap."""
        early = self.reference(pulse())
        later = build_reference(
            0.2,
            3.0,
            [prepare(pulse(), SETTINGS)],
            np.ones(1),
            TimeAxis(replace(GRID, delay_s=GRID.delay_s + 1e-4), steady),
        )
        np.testing.assert_allclose(later.recorded_m_s2[:-1], early.recorded_m_s2[1:], atol=1e-6)

    def test_no_current_is_asked_before_contact(self) -> None:
        """Only the zero-phase low-pass reaches back, by less than the lead."""
        reference = self.reference(pulse())
        assert np.abs(reference.recorded_m_s2[0]) <= 0.01 * reference.recorded_m_s2.max()

    def test_repeats_are_aligned(self) -> None:
        shifted = [pulse(0.02 + s, name=f"tap{s}") for s in (0.0, 3e-4, -2e-4)]
        settings = SETTINGS.model_copy(update={"onset_s": 0.02})
        prepared = [prepare(tap, settings) for tap in shifted]
        reference = build_reference(0.2, 3.0, prepared, np.ones(3), TimeAxis(GRID, steady))
        assert reference.repeatability < 0.01
        assert reference.repeatability_unaligned > 0.05

    def test_alignment_does_not_move_the_contact(self) -> None:
        settings = SETTINGS.model_copy(update={"onset_s": 0.02})
        prepared = [prepare(pulse(0.02 + s), settings) for s in (-2e-4, 2e-4)]
        reference = build_reference(0.2, 3.0, prepared, np.ones(2), TimeAxis(GRID, steady))
        single = self.reference(pulse(0.02))
        assert nrmse(reference.recorded_m_s2, single.recorded_m_s2) < 0.02

    def test_one_tap_has_no_repeatability(self) -> None:
        assert np.isnan(self.reference(pulse()).repeatability)

    def test_a_recording_shorter_than_the_window(self) -> None:
        with pytest.raises(InputError, match=r"tap: ends 19.9 ms after contact, the window needs 29.7 ms"):
            self.reference(pulse(duration_s=0.04))


LASTING = TimeGrid(1e-4, 300, 3e-4, 68e-6, after_stages=200)  # to 49.8 ms


class TestBesideTheWindow:
    """What comes before the first command can act, and after the last one."""

    def reference(self, grid: TimeGrid, *taps: Recording) -> Reference:
        prepared = [prepare(tap, SETTINGS) for tap in taps]
        return build_reference(0.2, 3.0, prepared, np.ones(len(prepared)), TimeAxis(grid, steady))

    def test_it_goes_on_as_recorded(self) -> None:
        """A longer window has the same in it."""
        found = self.reference(LASTING, pulse())
        longer = self.reference(replace(LASTING, stages=500, after_stages=0), pulse())
        np.testing.assert_allclose(found.target.continued_m_s2, longer.recorded_m_s2, atol=1e-9)
        np.testing.assert_allclose(found.nominal_position_at_ticks_m, longer.nominal_position_at_ticks_m, atol=1e-12)

    def test_where_the_recording_has_ended_it_is_zero(self) -> None:
        ends_s = 35e-3
        found = self.reference(LASTING, pulse(duration_s=0.02 + ends_s))
        after_s = LASTING.after_times_s
        late = after_s > ends_s
        assert 100 < late.sum() < 200
        np.testing.assert_array_equal(found.recorded_after_m_s2[late], 0.0)
        # Before it is as if the recording went on.
        whole = self.reference(LASTING, pulse())
        recorded = after_s < ends_s - 1e-3  # the low-pass sees 1 ms ahead
        np.testing.assert_allclose(
            found.recorded_after_m_s2[recorded], whole.recorded_after_m_s2[recorded], atol=1e-3
        )

    def test_a_repeat_that_ends_leaves_the_mean_to_those_that_go_on_without_a_step(self) -> None:
        """One of two courses that stay 2 m/s^2 apart ends within the tail: r was zero from there on."""

        def level(a_m_s2: float, recorded_s: float) -> Recording:
            values = pulse(duration_s=recorded_s).acceleration.values
            later = np.arange(values.size) * 1e-4 > 0.03
            name = f"{a_m_s2:g} m/s^2 for {recorded_s:g} s"
            return replace(pulse(), name=name, acceleration=Signal(0.0, 1e-4, values + a_m_s2 * later))

        long, ends_s = level(-6.0, 0.1), 35e-3
        found = self.reference(LASTING, long, level(-4.0, 0.02 + ends_s))
        alone, both = self.reference(LASTING, long), self.reference(LASTING, long, level(-4.0, 0.1))
        r, since_s = found.recorded_after_m_s2, LASTING.after_times_s - ends_s
        assert found.missing_s == alone.missing_s
        gone, yet = since_s > 1e-3, since_s < -6e-3  # the taps are shifted by less than 1 ms to be alike
        np.testing.assert_allclose(r[gone], alone.recorded_after_m_s2[gone], atol=1e-2)
        np.testing.assert_allclose(r[yet], both.recorded_after_m_s2[yet], atol=1e-2)
        assert np.abs(np.diff(r)).max() < 0.1
        assert r.min() > -6.1
        assert r.max() < -4.9

    def test_a_file_has_to_reach_the_windows_end_and_no_further(self) -> None:
        needed_s = 0.02 + LASTING.switching_times_s[-1]
        assert self.reference(LASTING, pulse(duration_s=needed_s + 2e-4)).recorded_after_m_s2.shape == (200,)
        with pytest.raises(InputError, match=r"the window needs 29\.7 ms"):
            self.reference(LASTING, pulse(duration_s=needed_s - 2e-4))

    @pytest.mark.parametrize(
        ("delay_s", "lead_s", "lost"), [(1e-3, 3e-4, 7), (68e-6, 3e-4, 0), (3e-4, 3e-4, 0), (9e-3, 0, 90)]
    )
    def test_what_no_command_can_reach_counts_from_contact_on(self, delay_s: float, lead_s: float, lost: int) -> None:
        grid = TimeGrid(1e-4, 300, lead_s, delay_s)
        found = self.reference(grid, pulse())
        assert found.recorded_before_m_s2.shape == (lost,)
        if not lost:
            return
        # A waveform that starts so much earlier has the same instants within its window.
        early = self.reference(TimeGrid(1e-4, 300, lead_s + lost * 1e-4, delay_s), pulse())
        np.testing.assert_allclose(found.recorded_before_m_s2, early.recorded_m_s2[:lost], atol=1e-9)

    def test_between_speeds_all_of_it_is_blended(self) -> None:
        grid = TimeGrid(1e-4, 300, 0.0, 1e-3, after_stages=50)
        slow, fast = (
            replace(self.reference(grid, pulse(height=h)), speed_m_s=v) for h, v in ((50.0, 0.2), (90.0, 0.4))
        )
        found = References((slow, fast)).at(0.3, 3.0)
        for name in ("recorded_before_m_s2", "recorded_after_m_s2", "nominal_position_at_ticks_m"):
            wanted = 0.3 * (0.5 * getattr(slow, name) / 0.2 + 0.5 * getattr(fast, name) / 0.4)
            np.testing.assert_allclose(getattr(found, name), wanted, rtol=1e-12)


class TestSoftPulses:
    def soft(self, toe_s: float, noise: float = 0.0, toe: float = 4.0) -> Recording:
        """A toe that creeps up to 4 m/s^2, then a half sine of 8 ms and 50 m/s^2; it begins at 30 ms."""
        t = np.arange(0, 0.15, 1e-4) - 0.03
        steep = 50 * np.sin(np.pi * np.clip((t - toe_s) / 8e-3, 0, 1))
        values = np.where((t > 0) & (t < toe_s + 8e-3), np.maximum(toe * np.clip(t / toe_s, 0, 1), steep), 0.0)
        values += noise * np.random.default_rng(3).standard_normal(t.size)
        return replace(pulse(), acceleration=Signal(0.0, 1e-4, values))

    @pytest.mark.parametrize("noise", [0.0, 0.1])
    @pytest.mark.parametrize("toe_s", [3e-3, 8e-3])
    def test_contact_is_where_the_pulse_begins(self, toe_s: float, noise: float) -> None:
        """The energy of the pulse is played: none of it lies before tau_0."""
        recording = self.soft(toe_s, noise)
        (steep,) = find_onsets(recording.acceleration, recording.acceleration.values[None])
        tap = prepare(recording, SETTINGS)
        assert steep == pytest.approx(0.03 + toe_s, abs=2e-4)
        assert tap.onset_s == pytest.approx(0.03, abs=1.2e-3)
        assert "a soft pulse" in "; ".join(tap.notes)
        r = highpass(tap.acceleration, 8.0)
        energy = r.values**2
        toe = (r.times_s < GRID.switching_times_s[0]) & (r.times_s > -1e-3 - toe_s)
        assert energy[toe].sum() < 3e-4 * energy.sum()

    def test_a_stated_onset_stays_and_the_toe_is_said(self) -> None:
        tap = prepare(self.soft(8e-3), SETTINGS.model_copy(update={"onset_s": 0.038}))
        assert tap.onset_s == 0.038
        assert "recordings.onset_s, of which only the waveform's lead is played" in "; ".join(tap.notes)

    def test_a_hand_that_slows_down_is_no_toe(self) -> None:
        """0.1 g for 30 ms before a hard pulse: the user's own motion."""
        recording = pulse(0.06, duration_s=0.12)
        braking = recording.acceleration.values + np.where(np.arange(1200) < 600, np.linspace(0, 1.0, 1200), 0.0)
        tap = prepare(replace(recording, acceleration=Signal(0.0, 1e-4, braking)), SETTINGS)
        assert tap.onset_s == pytest.approx(0.06, abs=2e-4)
        assert not any("soft" in note or "noise" in note for note in tap.notes)

    def test_the_built_in_taps_are_hard_enough(self, scene: Scene, taps: list[Recording]) -> None:
        assert not any("soft" in note for tap in taps for note in prepare(tap, scene.recordings).notes)


class TestSimulatedTaps:
    def test_peaks_are_those_of_design(self, scene: Scene) -> None:
        target = scene.recordings.simulated
        assert target is not None
        _, acceleration, _ = strike(scene.plant(3.0, struck=True), target, np.array([0.1, 0.2, 0.3, 0.4]), 0.03)
        peaks = acceleration.max(axis=1) / STANDARD_GRAVITY_M_S2
        np.testing.assert_allclose(peaks, [2.8, 5.6, 8.7, 12.0], atol=0.05)

    def test_looking_further_after_the_waveform_changes_no_sample(self, scene: Scene, taps: list[Recording]) -> None:
        for after_s in (0.0, 0.1):
            others = recordings(with_values(scene, {"weights.after_s": after_s}))
            for tap, other in zip(taps, others, strict=True):
                own, its = tap.acceleration.values, other.acceleration.values
                assert its.size - own.size == round((after_s - 0.03) / 1e-4)
                both = min(own.size, its.size)
                np.testing.assert_array_equal(its[:both], own[:both])
                np.testing.assert_array_equal(other.position.values[:both], tap.position.values[:both])

    def test_a_lead_changes_no_sample(self, scene: Scene, taps: list[Recording]) -> None:
        for tap, other in zip(taps, recordings(with_values(scene, {"time.lead_s": 1e-3})), strict=True):
            np.testing.assert_array_equal(other.acceleration.values, tap.acceleration.values)

    def test_repeats_serve_every_grid_speed(self, scene: Scene, taps: list[Recording]) -> None:
        built = references_of(scene, taps)
        assert [len(reference.taps) for reference in built] == [3] * 12
        assert all(0 < reference.repeatability < 0.03 for reference in built)
