"""From a recording to a prepared tap: onset, offset, polarity, speed, filters; each alone, and all together."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benches.pulses import pulse
from transopt.base.errors import InputError
from transopt.base.signals import Signal, integral
from transopt.recordings.recording import Recording
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import check_usable, prepare, prepare_all, read_recordings
from transopt.references.references import assign
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings

SETTINGS = Recordings(files=["unused"])


SPEED_M_S = 0.2


def hand_speeding_up() -> Recording:
    """A hand with a0 = -3 m/s^2 that meets an object at t = 0 with 0.2 m/s; the sensor reads gravity besides."""
    t = np.arange(-0.06, 0.1, 1e-4)
    after = np.clip(t, 0.0, None)
    hit = np.where(t > 0, 120.0 * np.exp(-after / 2e-3) * np.sin(500.0 * after), 0.0) - 3.0
    speed = integral(hit, 1e-4)
    contact = int(np.searchsorted(t, 0.0))
    z = integral(speed - speed[contact] - SPEED_M_S, 1e-4)
    position = Signal(-0.06, 1e-4, z - z[contact])
    return Recording("tap", "", "", Signal(-0.06, 1e-4, hit + 9.80665), position=position)


class TestPrepare:
    @pytest.mark.parametrize("onset_s", [0.02, 0.02003, 0.020077])
    @pytest.mark.parametrize("rate_Hz", [10e3, 50e3])
    def test_onset_is_found_to_a_fraction_of_a_tick(self, onset_s: float, rate_Hz: float) -> None:
        tap = prepare(pulse(onset_s, rate_Hz=rate_Hz), SETTINGS)
        assert tap.onset_s == pytest.approx(onset_s, abs=1e-5)

    def test_onset_of_simulated_taps_with_noise(self, scene: Scene) -> None:
        """The contact of the simulated recordings is known: 30 ms minus the sampling phase."""
        found = [prepare(recording, scene.recordings) for recording in recordings(scene)]
        for tap in found:
            position = tap.recording.position
            # Encoder counts reach zero within one count of the contact.
            assert -24.5e-6 <= np.interp(tap.onset_s, position.times_s, position.values) <= 24.5e-6
            before = position.times_s < tap.onset_s
            line = np.polynomial.Polynomial.fit(position.times_s[before], position.values[before], 1)
            assert tap.onset_s == pytest.approx(float(line.roots()[0]), abs=1e-4)

    def test_static_offset_and_polarity(self) -> None:
        tap = prepare(pulse(offset=-9.81, polarity=-1), SETTINGS)
        plain = prepare(pulse(), SETTINGS)
        assert (tap.offset_m_s2, tap.polarity) == (pytest.approx(-9.81, abs=1e-9), -1)
        np.testing.assert_allclose(tap.acceleration.values, plain.acceleration.values, atol=1e-9)

    def test_no_baseline_is_said(self) -> None:
        tap = prepare(pulse(onset_s=0.0), SETTINGS)
        assert tap.offset_m_s2 == 0
        assert "no baseline" in tap.notes[0]

    def test_stated_onset_and_offset_are_taken(self) -> None:
        settings = SETTINGS.model_copy(update={"onset_s": 0.005, "offset_m_s2": 1.5})
        tap = prepare(pulse(), settings)
        assert (tap.onset_s, tap.offset_m_s2) == (0.005, 1.5)

    def test_speed_from_position_despite_the_hands_acceleration(self) -> None:
        t = np.arange(0, 0.08, 1e-4)
        z = -0.1 * (t - 0.02) + 0.5 * 2.0 * (t - 0.02) ** 2  # a hand that brakes with 2 m/s^2
        counts = np.round(z / 24.5e-6) * 24.5e-6
        tap = prepare(pulse(speed=None, position=Signal(0.0, 1e-4, counts)), SETTINGS)
        assert tap.speed_m_s == pytest.approx(0.1, rel=0.02)
        assert tap.speed_source == "position"

    def test_no_speed_is_refused(self) -> None:
        with pytest.raises(InputError, match=r"test: no incoming speed: the file neither states it \(`# speed_m_s"):
            assign([prepare(pulse(speed=None), SETTINGS)], [0.2], SETTINGS)

    @pytest.mark.parametrize("speed", [None, SPEED_M_S])
    def test_a_position_that_grows_towards_the_object_is_turned(self, speed: float | None) -> None:
        """Speed, a0 and offset are those of the position that is positive out of the object."""
        out = replace(hand_speeding_up(), speed_m_s=speed)
        assert out.position is not None
        as_it_should, turned = prepare_all([out, replace(out, position=out.position.scaled(-1.0))], SETTINGS)
        assert as_it_should.incoming_acceleration_m_s2 == pytest.approx(-3.0, abs=0.2)
        for name in ("speed_m_s", "incoming_acceleration_m_s2", "offset_m_s2", "peak_m_s2"):
            assert getattr(turned, name) == pytest.approx(getattr(as_it_should, name), rel=1e-9)
        assert turned.recording.position is not None
        np.testing.assert_allclose(turned.recording.position.values, out.position.values, atol=1e-15)
        assert any("its sign is turned" in note for note in turned.notes)
        assert not any("its sign is turned" in note for note in as_it_should.notes)

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_position_that_runs_ahead_where_the_acceleration_stops_is_refused(self, sign: float) -> None:
        """The stylus cannot leave the straight way to the other side than its acceleration."""
        recording = hand_speeding_up()
        assert recording.position is not None
        t, z = recording.position.times_s, recording.position.values
        ahead = np.where(t > 0, -SPEED_M_S * t - (z + SPEED_M_S * t), z)
        opposed = replace(recording, position=replace(recording.position, values=sign * ahead))
        with pytest.raises(
            InputError, match=r"tap: by the acceleration the stylus stops short by 1?\d\S* mm .* ahead"
        ):
            prepare(opposed, SETTINGS)

    def test_a_position_at_rest_tells_no_direction(self) -> None:
        recording = hand_speeding_up()
        assert recording.position is not None
        still = replace(recording.position, values=1e-9 * np.sin(np.arange(recording.position.values.size) ** 2.0))
        with pytest.raises(InputError, match="speed fitted to the position"):
            prepare(replace(recording, position=still), SETTINGS)

    def test_a_clipped_tap_is_refused_unless_it_is_accepted(self) -> None:
        recording = pulse()
        cut = replace(recording.acceleration, values=np.minimum(recording.acceleration.values, 30.0))
        clipped = replace(recording, acceleration=cut)
        tap = prepare(clipped, SETTINGS)
        with pytest.raises(InputError, match=r"clipped, \d+ samples at the end stop: the true peak is higher"):
            check_usable(tap, SETTINGS)
        check_usable(tap, SETTINGS.model_copy(update={"implausible": "accept"}))
        check_usable(prepare(recording, SETTINGS), SETTINGS)

    @pytest.mark.parametrize("counts", [8, 20, 100])
    def test_the_top_of_a_coarsely_quantised_pulse_is_not_clipped(self, counts: int) -> None:
        """An oscilloscope of 8 bits repeats the largest value of a pulse several times."""
        fine = pulse(rate_Hz=200e3)
        count = float(fine.acceleration.values.max()) / counts
        coarse = replace(fine.acceleration, values=np.round(fine.acceleration.values / count) * count)
        assert np.count_nonzero(coarse.values == coarse.values.max()) >= 3
        assert prepare(replace(fine, acceleration=coarse), SETTINGS).clipped_samples == 0

    def test_the_peak_is_that_of_the_target_whether_the_speed_is_known_or_not(self) -> None:
        known, unknown = (prepare(pulse(speed=speed), SETTINGS) for speed in (0.2, None))
        assert known.peak_m_s2 == pytest.approx(float(np.abs(known.acceleration.values).max()), rel=1e-12)
        assert unknown.peak_m_s2 == pytest.approx(known.peak_m_s2, rel=1e-12)

    @pytest.mark.parametrize(
        ("recording", "doubt"),
        [
            (pulse(height=50.0, speed=20.0), "faster than a hand taps"),
            (pulse(rate_Hz=500.0, duration_s=0.2), "sampled at 500 Hz"),
        ],
    )
    def test_unlikely_taps_are_doubted(self, recording: Recording, doubt: str) -> None:
        assert doubt in "; ".join(prepare(recording, SETTINGS).notes)

    def test_noise_alone_is_refused_and_a_weak_tap_doubted(self) -> None:
        noise = np.random.default_rng(0).standard_normal(800)
        recording = pulse(height=8.0)
        weak = replace(recording.acceleration, values=recording.acceleration.values + noise)
        assert "times the noise" in "; ".join(prepare(replace(recording, acceleration=weak), SETTINGS).notes)
        with pytest.raises(InputError, match=r"tap: highest sample .* no tap stands out"):
            prepare(replace(recording, acceleration=Signal(0.0, 1e-4, noise)), SETTINGS)

    def test_a_pulse_that_fills_half_the_recording_is_a_tap(self) -> None:
        t = np.arange(0, 0.06, 1e-4)
        slow = np.where((t > 0.01) & (t < 0.05), np.sin(np.pi * (t - 0.01) / 0.04), 0.0)
        slow = 20.0 * slow + 0.05 * np.random.default_rng(0).standard_normal(t.size)
        tap = prepare(replace(pulse(), acceleration=Signal(0.0, 1e-4, slow)), SETTINGS)
        assert tap.onset_s == pytest.approx(0.01, abs=1e-3)
        assert not any("soft" in note or "noise" in note for note in tap.notes)

    def test_a_stated_onset_admits_a_noisy_recording(self) -> None:
        noise = np.random.default_rng(0).standard_normal(800)
        settings = SETTINGS.model_copy(update={"onset_s": 0.02})
        tap = prepare(replace(pulse(), acceleration=Signal(0.0, 1e-4, noise)), settings)
        assert "times the noise" in "; ".join(tap.notes)

    def test_the_highest_peak_need_not_be_the_first(self) -> None:
        t = np.arange(0, 0.08, 1e-4)

        def bump(at: float, size: float) -> np.ndarray:
            return size * np.exp(-(((t - at) / 5e-4) ** 2))

        two = replace(pulse(), acceleration=Signal(0.0, 1e-4, bump(0.021, 30.0) + bump(0.023, 50.0)))
        one = replace(pulse(), acceleration=Signal(0.0, 1e-4, bump(0.021, 30.0)))
        # A bell has no foot: both begin where they reach a share of their peak, which is higher in the first.
        assert prepare(two, SETTINGS).onset_s == pytest.approx(prepare(one, SETTINGS).onset_s, abs=2.5e-4)

    def test_a_bump_in_the_approach_does_not_move_the_offset(self) -> None:
        recording = pulse(offset=9.81)
        bumped = recording.acceleration.values.copy()
        bumped[50:70] += 5.0
        tap = prepare(replace(recording, acceleration=Signal(0.0, 1e-4, bumped)), SETTINGS)
        assert tap.offset_m_s2 == pytest.approx(9.81, abs=1e-6)

    def test_similarity_scaling_of_time_and_amplitude(self) -> None:
        settings = SETTINGS.model_copy(update={"time_scale": 4.0, "amplitude_scale": 0.5})
        tap, plain = prepare(pulse(rate_Hz=50e3), settings), prepare(pulse(rate_Hz=50e3), SETTINGS)
        assert tap.speed_m_s == pytest.approx(0.2 * 4.0 * 0.5)
        # The velocity change is what defines the speed: it scales alike.
        change = [t.acceleration.values.sum() * t.acceleration.dt_s for t in (tap, plain)]
        assert change[0] / change[1] == pytest.approx(2.0, rel=1e-3)
        assert "similarity-scaled" in tap.speed_source

    def test_to_grid_speed_makes_the_velocity_change_match(self) -> None:
        settings = SETTINGS.model_copy(update={"time_scale": 10.0, "amplitude_scale": "to_grid_speed"})
        tap = prepare(pulse(rate_Hz=50e3, speed=0.2), settings)
        groups = assign([tap], [0.1, 0.4], settings)
        assert [factor for ((_, factor),) in groups] == [0.1, 0.4]
        plain = pulse(rate_Hz=50e3).acceleration
        change = 0.4 * tap.acceleration.values.sum() * tap.acceleration.dt_s
        assert change == pytest.approx(0.4 / 0.2 * plain.values.sum() * plain.dt_s, rel=1e-3)


class TestAllTaps:
    def test_each_is_prepared_as_alone(self) -> None:
        """Rates and lengths are mixed."""
        taps = [
            pulse(0.02 + 1e-3 * i, rate_Hz=rate_Hz, offset=i, duration_s=0.08 + 0.01 * (i % 2))
            for i, rate_Hz in enumerate([10e3, 50e3, 10e3, 2e3, 10e3])
        ]
        for tap, found in zip(taps, prepare_all(taps, SETTINGS), strict=True):
            alone = prepare(tap, SETTINGS)
            assert (found.onset_s, found.notes) == (pytest.approx(alone.onset_s, abs=1e-12), alone.notes)
            np.testing.assert_allclose(found.acceleration.values, alone.acceleration.values, rtol=0, atol=1e-9)

    def test_the_one_without_a_tap_is_named(self) -> None:
        flat = replace(pulse(name="flat"), acceleration=Signal(0.0, 1e-4, np.random.default_rng(1).normal(size=800)))
        with pytest.raises(InputError, match=r"flat: highest sample .* no tap stands out"):
            prepare_all([pulse(name="first"), flat, pulse(name="last")], SETTINGS)


def test_files_are_found_by_pattern_and_a_missing_folder_is_named(tmp_path) -> None:
    rows = "\n".join(f"{k * 1e-4:.4f},{np.sin(k)}" for k in range(50))
    for name in ("tap_b.csv", "tap_a.csv"):
        (tmp_path / name).write_text(f"# speed_m_s: 0.2\ntime_s,acceleration_g\n{rows}\n")
    found = read_recordings(Recordings(files=["tap_*.csv"], folder=str(tmp_path)))
    assert [recording.name for recording in found] == ["tap_a.csv", "tap_b.csv"]
    with pytest.raises(InputError, match=r"'\*.txt' matches no file in .*--recordings FOLDER.*\(source: the web\)"):
        read_recordings(Recordings(files=["*.txt"], folder=str(tmp_path), source="the web"))


def test_speeds_by_file_name(tmp_path) -> None:
    for name, height in (("slow", 1.0), ("fast", 2.0)):
        samples = height * np.exp(-np.arange(200) / 20.0)
        np.savez(tmp_path / f"{name}.npz", time_s=np.arange(200) * 1e-4, acceleration_g=samples)
    speeds = {"slow.npz": 0.1, "fast.npz": 0.2}
    found = read_recordings(Recordings(files=["*.npz"], folder=str(tmp_path), speed_by_file_m_s=speeds))
    assert {recording.name: recording.speed_m_s for recording in found} == speeds
    with pytest.raises(InputError, match=r"speed_by_file_m_s: 'slwo.npz' is not among the files"):
        read_recordings(Recordings(files=["*.npz"], folder=str(tmp_path), speed_by_file_m_s={"slwo.npz": 0.1}))
