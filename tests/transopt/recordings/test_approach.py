"""Offset and incoming acceleration told apart, and sensors that do not read down to 0 Hz."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray, Signal, nrmse
from transopt.recordings.approach import AT_REST, SEPARATED, STATED, UNSEPARATED
from transopt.recordings.recording import Recording
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import PreparedTap, prepare
from transopt.scene.keys import with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene

INCOMING_M_S2 = (5.0, -2.0)
COUNT_M = 24.5e-6


def accelerated(recording: Recording, onset_s: float, incoming_m_s2: float) -> Recording:
    """The tap of a hand that accelerates all along: z gains a0 t^2 / 2 about the contact."""
    x, z = recording.acceleration, recording.position
    moved = z.values + 0.5 * incoming_m_s2 * (z.times_s - onset_s) ** 2
    counts = np.round(moved / COUNT_M) * COUNT_M
    return replace(
        recording, acceleration=replace(x, values=x.values + incoming_m_s2), position=replace(z, values=counts)
    )


def coupled(recording: Recording, cutoff_Hz: float) -> Recording:
    """What a sensor with a first-order high-pass would have recorded, by scipy's filter."""
    x = recording.acceleration
    b, a = butter(1, cutoff_Hz, "highpass", fs=x.rate_Hz)
    return replace(recording, acceleration=replace(x, values=lfilter(b, a, x.values - x.values[0])))


def course(tap: PreparedTap) -> np.ndarray:
    return tap.acceleration.at(np.arange(-3e-4, 60e-3, 1e-4))


class TestIncomingAcceleration:
    @pytest.mark.parametrize("incoming", INCOMING_M_S2)
    def test_the_position_tells_it_from_the_offset(
        self, scene: Scene, taps: list[Recording], incoming: float
    ) -> None:
        for recording in taps:
            steady = prepare(recording, scene.recordings)
            found = prepare(accelerated(recording, steady.onset_s, incoming), scene.recordings)
            assert found.incoming_source == SEPARATED
            assert found.incoming_acceleration_m_s2 == pytest.approx(incoming, abs=0.2)
            assert found.offset_m_s2 == pytest.approx(STANDARD_GRAVITY_M_S2, abs=0.2)
            assert np.abs(course(found) - course(steady) - incoming).max() < 0.2

    def test_a_steady_approach_has_none(self, scene: Scene, taps: list[Recording]) -> None:
        for recording in taps:
            tap = prepare(recording, scene.recordings)
            assert (tap.incoming_acceleration_m_s2, tap.incoming_source, tap.notes) == (0.0, SEPARATED, ())

    @pytest.mark.parametrize("incoming", INCOMING_M_S2)
    def test_an_accelerometer_alone_cannot_and_it_is_said(
        self, scene: Scene, taps: list[Recording], incoming: float
    ) -> None:
        steady = prepare(taps[0], scene.recordings)
        found = prepare(replace(accelerated(taps[0], steady.onset_s, incoming), position=None), scene.recordings)
        assert (found.incoming_acceleration_m_s2, found.incoming_source) == (0.0, UNSEPARATED)
        assert "not told apart without a position" in "; ".join(found.notes)
        assert found.offset_m_s2 == pytest.approx(STANDARD_GRAVITY_M_S2 + incoming, abs=0.1)

    @pytest.mark.parametrize("incoming", INCOMING_M_S2)
    def test_a_stated_offset_tells_it(self, scene: Scene, taps: list[Recording], incoming: float) -> None:
        steady = prepare(taps[0], scene.recordings)
        stated = scene.recordings.model_copy(update={"offset_m_s2": STANDARD_GRAVITY_M_S2})
        found = prepare(replace(accelerated(taps[0], steady.onset_s, incoming), position=None), stated)
        assert found.incoming_source == STATED
        assert found.incoming_acceleration_m_s2 == pytest.approx(incoming, abs=0.1)

    def test_rest_tells_it(self) -> None:
        """At rest for 60 ms, then 40 ms with -5 m/s^2 towards the surface, then a tap."""
        dt = 1e-4
        t = np.arange(0, 0.2, dt) - 0.1
        coming = (t > -0.04) & (t < 0)
        pulse = np.where((t >= 0) & (t < 4e-3), 80 * np.sin(np.pi * t / 4e-3), 0.0)
        a = np.where(coming, -5.0, pulse)
        velocity = np.cumsum(a) * dt
        z = np.cumsum(velocity) * dt
        z = np.round((z - z[t < 0][-1]) / COUNT_M) * COUNT_M
        noise = 0.2 * np.random.default_rng(1).standard_normal(t.size)
        recording = Recording("rest", "test", "", Signal(0.0, dt, a + 9.81 + noise), Signal(0.0, dt, z))
        tap = prepare(recording, Recordings(files=["unused"]))
        assert tap.incoming_source == AT_REST
        assert tap.offset_m_s2 == pytest.approx(9.81, abs=0.05)
        assert tap.incoming_acceleration_m_s2 == pytest.approx(-5.0, abs=0.2)

    @pytest.mark.parametrize("incoming", INCOMING_M_S2)
    def test_the_stylus_moves_on_with_it(self, scene: Scene, taps: list[Recording], incoming: float) -> None:
        """The stylus has a0 before contact and over the intention, so that none of it is asked of the motor."""
        onsets = [prepare(tap, scene.recordings).onset_s for tap in taps]
        moved = [accelerated(tap, at_s, incoming) for tap, at_s in zip(taps, onsets, strict=True)]
        found, steady = references_of(scene, moved).at(0.3, 3.0), references_of(scene, taps).at(0.3, 3.0)
        tau = scene.time_grid().switching_times_s
        within = tau < 30e-3 - 1e-4  # the spline through it rings where it ends
        wanted = found.incoming_acceleration_m_s2
        np.testing.assert_allclose((found.free_m_s2 - steady.free_m_s2)[within], wanted, atol=2e-2 * abs(incoming))
        # A quadratic through 10 ms of encoder counts knows it to 0.2 m/s^2.
        assert found.incoming_acceleration_m_s2 == pytest.approx(incoming, abs=0.2)

    def test_it_is_scaled_like_the_acceleration(self, scene: Scene, taps: list[Recording]) -> None:
        steady = prepare(taps[0], scene.recordings)
        scaled = scene.recordings.model_copy(update={"amplitude_scale": 0.5})
        found = prepare(accelerated(taps[0], steady.onset_s, 5.0), scaled)
        assert found.incoming_acceleration_m_s2 == pytest.approx(2.5, abs=0.1)


class TestCutOff:
    @pytest.mark.parametrize("cutoff_Hz", [0.5, 1.0, 2.0, 5.0])
    def test_the_position_completes_what_is_slower(
        self, scene: Scene, taps: list[Recording], cutoff_Hz: float
    ) -> None:
        settings = with_values(scene, {"recordings.trusted_from_Hz": cutoff_Hz}).recordings
        for recording in taps:
            whole = course(prepare(recording, scene.recordings))
            tap = prepare(coupled(recording, cutoff_Hz), settings)
            lost = nrmse(course(prepare(coupled(recording, cutoff_Hz), scene.recordings)), whole)
            assert nrmse(course(tap), whole) < 0.01 < lost
            assert tap.slow_part_known
            assert "is completed from the position" in "; ".join(tap.notes)

    @pytest.mark.parametrize("incoming", INCOMING_M_S2)
    def test_an_incoming_acceleration_is_completed_too(
        self, scene: Scene, taps: list[Recording], incoming: float
    ) -> None:
        settings = with_values(scene, {"recordings.trusted_from_Hz": 5.0}).recordings
        steady = prepare(taps[3], scene.recordings)
        tap = prepare(coupled(accelerated(taps[3], steady.onset_s, incoming), 5.0), settings)
        assert tap.incoming_acceleration_m_s2 == pytest.approx(incoming, abs=0.3)

    @pytest.mark.parametrize(("cutoff_Hz", "known"), [(0.5, True), (1.0, True), (2.0, False), (5.0, False)])
    def test_without_a_position_it_is_said(
        self, scene: Scene, taps: list[Recording], cutoff_Hz: float, known: bool
    ) -> None:
        settings = with_values(scene, {"recordings.trusted_from_Hz": cutoff_Hz}).recordings
        tap = prepare(coupled(replace(taps[0], position=None), cutoff_Hz), settings)
        assert tap.slow_part_known is known
        said = "what is slower is missing" if known else "only the rapid error is minimised"
        assert said in "; ".join(tap.notes)
        assert prepare(taps[0], scene.recordings).slow_part_known


def coming(hand: Callable[[FloatArray], FloatArray]) -> Recording:
    """A tap at 0.3 m/s of a hand with this acceleration at times (n,) from contact, recorded from 60 ms before it."""
    t = np.arange(-0.06, 0.1, 1e-4)
    own = hand(t)
    a = own + np.where((t >= 0) & (t < 4e-3), 80 * np.sin(np.pi * t / 4e-3), 0.0)
    velocity = np.cumsum(a) * 1e-4
    velocity += -0.3 - velocity[t < 0][-1]
    z = np.cumsum(velocity) * 1e-4
    z = np.round((z - z[t < 0][-1]) / COUNT_M) * COUNT_M
    noise = 0.2 * np.random.default_rng(1).standard_normal(t.size)
    return Recording("tap", "test", "", Signal(-0.06, 1e-4, a + 9.81 + noise), Signal(-0.06, 1e-4, z))


def pushed(first_s: float, last_s: float, peak_m_s2: float) -> Callable[[FloatArray], FloatArray]:
    """A smooth push within these times."""

    def hand(t: FloatArray) -> FloatArray:
        part = np.clip((t - first_s) / (last_s - first_s), 0.0, 1.0)
        return np.asarray(peak_m_s2 * np.sin(np.pi * part) ** 2)

    return hand


class TestSteady:
    """The rms of these taps is 20 m/s^2 until the hand can react."""

    def test_what_a_hand_has_done_before_is_no_offset(self) -> None:
        tap = prepare(coming(pushed(-0.055, -0.025, -8.0)), Recordings(files=["unused"]))
        assert tap.offset_m_s2 == pytest.approx(9.81, abs=0.2)
        assert (tap.incoming_acceleration_m_s2, tap.notes) == (0.0, ())

    @pytest.mark.parametrize(
        ("hand", "by_position", "alone"),
        [
            (lambda t: 0.0 * t, True, True),
            (lambda t: np.full(t.size, -2.0), True, True),
            (lambda t: 0.05 * np.sin(2 * np.pi * 10 * t), True, True),
            (lambda t: np.full(t.size, -6.0), False, True),
            (pushed(-0.045, -0.005, -15.0), False, False),
        ],
        ids=["steady", "faster and faster", "tremor", "much faster", "turned round"],
    )
    def test_a_hand_that_does_not_come_in_steadily_is_named(
        self, hand: Callable[[FloatArray], FloatArray], by_position: bool, alone: bool
    ) -> None:
        """An accelerometer alone sees changes only. Impacts of another rig have no hand."""
        recording, settings = coming(hand), Recordings(files=["unused"])
        for one, steady in ((recording, by_position), (replace(recording, position=None), alone)):
            notes = prepare(replace(one, speed_m_s=0.3), settings).notes
            assert any("no steady approach: " in note for note in notes) != steady
        scaled = settings.model_copy(update={"amplitude_scale": 0.5})
        assert "no steady approach" not in "; ".join(prepare(recording, scaled).notes)
