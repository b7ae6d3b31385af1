"""Slow motion beside the current: its leakage is known from its slow part, and noise is left alone."""

import numpy as np

from transopt.identify.device.cleaned import NOTICED, TAKEN_HZ, leakage

DT_S, N = 1e-4, 20000


def fast_lines(values: np.ndarray) -> np.ndarray:
    lines = np.fft.rfft(values)
    lines[np.fft.rfftfreq(values.size, DT_S) <= TAKEN_HZ] = 0.0
    return np.asarray(lines)


def test_a_tremor_that_the_record_cuts_off_is_found_by_its_leakage() -> None:
    times, random = DT_S * np.arange(N), np.random.default_rng(4)
    tremor = 0.5 * np.sin(2 * np.pi * 9.3 * times + 1.2)  # the ends do not meet
    noise = 0.02 * random.standard_normal(N)
    found, share = leakage(tremor + noise, DT_S)
    true = fast_lines(tremor)
    assert share > NOTICED
    assert np.linalg.norm(np.fft.rfft(found) - true) < 0.15 * np.linalg.norm(true)


def test_noise_is_left_alone() -> None:
    random = np.random.default_rng(5)
    shares = [leakage(random.standard_normal(N), DT_S)[1] for _ in range(20)]
    assert max(shares) < NOTICED


def test_lines_below_stay_as_they_are() -> None:
    values = np.cumsum(np.random.default_rng(6).standard_normal(N))
    found, _ = leakage(values, DT_S)
    slow = np.fft.rfftfreq(N, DT_S) <= TAKEN_HZ
    assert np.abs(np.fft.rfft(found)[slow]).max() < 1e-9 * np.abs(np.fft.rfft(values)).max()
