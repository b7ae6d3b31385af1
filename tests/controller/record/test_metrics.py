"""Figures of merit of a played tap, on signals whose figures are known."""

import numpy as np
import pytest
from scipy import signal

from controller.record.metrics import align, band_levels_dB, rate_hardness_N_m, spectral_error_dB
from transopt.base.signals import FloatArray

DT = 1e-4


def pulse(times_s: FloatArray) -> FloatArray:
    """A tap-like transient, smooth everywhere: 80 m/s^2, ringing at 250 Hz."""
    t = times_s - 2e-3
    return np.asarray(80 * np.exp(-((t / 1.2e-3) ** 2)) * np.cos(2 * np.pi * 250 * t))


class TestLatency:
    @pytest.mark.parametrize("shift_s", [0.0, 1e-6, -37.3e-6, 431.7e-6, -0.95e-3, 0.99e-3])
    def test_found_to_a_microsecond_between_uneven_samples(self, shift_s: float) -> None:
        at = np.arange(-3, 597) * DT + 68e-6
        steps = np.tile([34e-6, 34e-6, 16e-6, 16e-6], 800)
        times = -8e-3 + np.append(0.0, np.cumsum(steps))
        found = align(times, pulse(times - shift_s), at, pulse(at))
        assert found.latency_s == pytest.approx(shift_s, abs=1e-6)
        assert found.nrmse < 1e-3

    def test_noise_and_scale_do_not_move_it(self) -> None:
        at = np.arange(-3, 597) * DT
        times = np.arange(-60, 700) * DT
        noise = np.random.default_rng(0).normal(0, 0.3, times.size)
        found = align(times, 0.7 * pulse(times - 120e-6) + noise, at, pulse(at))
        assert found.latency_s == pytest.approx(120e-6, abs=4e-6)
        assert found.nrmse == pytest.approx(0.3, abs=0.02)

    def test_beyond_a_millisecond_the_nearest_end_is_taken(self) -> None:
        at, times = np.arange(-3, 597) * DT, np.arange(-60, 700) * DT
        found = align(times, pulse(times - 1.3e-3), at, pulse(at))
        assert 0.9e-3 < found.latency_s <= 1e-3


class TestSpectralError:
    def test_gain_is_its_decibels(self) -> None:
        x = pulse(np.arange(600) * DT)
        assert spectral_error_dB(x, x, DT) == 0.0
        wide = signal.lfilter([1, -0.99], [1, -0.9], np.eye(1, 600, 5)[0])  # something in every band
        assert spectral_error_dB(2 * wide, wide, DT) == pytest.approx(20 * np.log10(2), abs=1e-9)

    def test_bands_hold_their_sinusoid(self) -> None:
        t = np.arange(6000) * DT
        for frequency in (12.6, 100.0, 794.0):
            tone = np.sin(2 * np.pi * frequency * t) * np.hanning(t.size)
            loudest = int(np.argmax(band_levels_dB(tone, DT)))
            assert 10.0 ** ((10 + loudest) / 10) == pytest.approx(frequency, rel=0.01)

    def test_silence_is_forty_decibels_below(self) -> None:
        x = pulse(np.arange(600) * DT)
        assert 20 < spectral_error_dB(np.zeros(600), x, DT) <= 40

    def test_what_lies_below_the_floor_is_not_compared(self) -> None:
        t = np.arange(600) * DT
        x = pulse(t)
        assert spectral_error_dB(x + 1e-4 * np.sin(2 * np.pi * 900 * t), x, DT) < 0.1


class TestRateHardness:
    def test_of_a_spring_it_is_the_stiffness(self) -> None:
        times = np.arange(-0.01, 0.02, 1e-5)
        force = 5000.0 * np.maximum(0.3 * times, 0.0)
        assert rate_hardness_N_m(times, force, 0.3) == pytest.approx(5000.0)

    def test_a_later_rise_does_not_count(self) -> None:
        times = np.arange(-0.01, 0.03, 1e-5)
        force = 1000.0 * 0.3 * np.maximum(times, 0.0) + 1e5 * np.maximum(times - 8e-3, 0.0)
        assert rate_hardness_N_m(times, force, 0.3) == pytest.approx(1000.0)

    @pytest.mark.parametrize(("begins_s", "share"), [(-1e-3, 1.0), (-1.5e-3, 0.5), (-3e-3, 0.0)])
    def test_a_rise_in_the_millisecond_before_contact_counts(self, begins_s: float, share: float) -> None:
        """A rendered force may lead; each of these rises for a millisecond and then stays."""
        times = np.arange(-0.01, 0.02, 1e-5)
        force = 2000.0 * 0.3 * np.clip(times - begins_s, 0.0, 1e-3)
        assert rate_hardness_N_m(times, force, 0.3) == pytest.approx(share * 2000.0, abs=1e-6)
