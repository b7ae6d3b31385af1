"""Energies in bands: the defining sums, and an independent quadrature of the spectrum."""

import itertools

import numpy as np
import pytest
from scipy import integrate

from transopt.base.signals import FloatArray
from transopt.problem.objective.bands import EDGES_Hz, NOMINAL_Hz, band_energies, levels
from transopt.problem.objective.weighting import pacinian

DT_S = 1e-4


def tap(frequency_Hz: float, stages: int = 600, decay: float = 100.0) -> FloatArray:
    k = np.arange(stages)
    return np.asarray(np.sin(2 * np.pi * frequency_Hz * DT_S * k) * np.exp(-k / decay))


def noise(seed: int, stages: int = 600) -> FloatArray:
    return np.random.default_rng(seed).standard_normal(stages) * np.hanning(stages)


def by_quadrature(samples: FloatArray, low_Hz: float, high_Hz: float) -> float:
    """Energy between two frequencies from the spectrum itself, by adaptive quadrature."""
    k = np.arange(samples.size)

    def density(f: float) -> float:
        return float(np.abs(samples @ np.exp(-2j * np.pi * f * DT_S * k)) ** 2)

    value, _ = integrate.quad(density, low_Hz, high_Hz, limit=400, epsrel=1e-10)
    return 2 * DT_S * float(value)


@pytest.mark.parametrize("samples", [tap(80.0), noise(3), tap(1000.0, 200)])
def test_bands_equal_the_integral_of_the_spectrum(samples: FloatArray) -> None:
    edges = np.append(0.0, EDGES_Hz)
    wanted = [by_quadrature(samples, low, high) for low, high in itertools.pairwise(edges)]
    np.testing.assert_allclose(band_energies(samples, DT_S), wanted, rtol=1e-6, atol=1e-9 * float(samples @ samples))


def test_all_bands_hold_all_of_a_band_limited_tap() -> None:
    samples = tap(200.0) * np.hanning(600)
    assert band_energies(samples, DT_S).sum() == pytest.approx(float(samples @ samples), rel=1e-4)


def test_edges_are_those_of_the_standard() -> None:
    # IEC 61260-1, base ten: the band at 1 kHz reaches from 891.25 to 1122.02 Hz; neighbours share an edge.
    assert EDGES_Hz[-2:] == pytest.approx([891.251, 1122.018], abs=1e-3)
    assert EDGES_Hz.size == len(NOMINAL_Hz) + 1
    np.testing.assert_allclose(np.sqrt(EDGES_Hz[1:] * EDGES_Hz[:-1]), NOMINAL_Hz, rtol=0.02)


def test_a_movement_that_is_scaled_is_as_many_dB_off_in_every_band() -> None:
    wanted = noise(5)
    found = levels(0.5 * wanted, wanted, DT_S)
    for value in (found.broadband_dB, found.pacinian_dB, found.below_dB, *found.thirds_dB.values()):
        assert value == pytest.approx(20 * np.log10(0.5), abs=1e-6)
    assert set(found.thirds_dB) == set(NOMINAL_Hz)


def test_what_is_missing_is_found_in_its_band() -> None:
    low, high = tap(80.0, decay=200.0) * np.hanning(600), tap(400.0, decay=200.0) * np.hanning(600)
    found = levels(low + 0.3 * high, low + high, DT_S)
    assert found.lacking_Hz == pytest.approx(400.0)
    assert found.thirds_dB[400.0] == pytest.approx(20 * np.log10(0.3), abs=0.1)
    assert found.thirds_dB[80.0] == pytest.approx(0.0, abs=0.1)


def test_as_felt_is_the_energy_behind_the_filter() -> None:
    wanted, made = noise(7), noise(8)
    by = pacinian(DT_S)
    felt = 10 * np.log10(np.sum(by.apply(made) ** 2) / np.sum(by.apply(wanted) ** 2))
    assert levels(made, wanted, DT_S).pacinian_dB == pytest.approx(felt, abs=1e-9)


def test_several_devices_count_by_their_mean_energy() -> None:
    wanted = noise(9)
    both = levels(np.stack([0.5 * wanted, 1.5 * wanted]), wanted, DT_S)
    assert both.broadband_dB == pytest.approx(10 * np.log10(1.25), abs=1e-9)


def test_bands_without_a_part_of_the_tap_are_not_stated() -> None:
    wanted = tap(200.0, decay=150.0) * np.hanning(600)
    found = levels(wanted + 1e-3 * tap(900.0), wanted, DT_S)
    assert 1000.0 not in found.thirds_dB
    assert 200.0 in found.thirds_dB


def test_a_servo_rate_that_cannot_carry_vibration_goes_by_all_frequencies() -> None:
    wanted = noise(11, 60)
    found = levels(0.5 * wanted, wanted, 2e-3)
    assert np.isnan(found.pacinian_dB)
    assert found.felt_dB == pytest.approx(20 * np.log10(0.5), abs=1e-9)


def test_nothing_wanted_has_no_level() -> None:
    assert np.isnan(levels(tap(100.0), np.zeros(600), DT_S).broadband_dB)
