"""What no file states of the accelerometer is found, named and taken out; what is stated truly is left alone."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tests.benches.identification import AMPLIFIER, DEFAULT, Rig, mismatched, spoilt
from tests.transopt.identify.device.conftest import SETTINGS
from transopt.identify.device.chain_fit import ChainFit, fit_chain
from transopt.identify.device.identify import identify
from transopt.identify.device.trials import sort_trials
from transopt.identify.measurement import Measurement

GRIPS_N = (1.0, 3.0, 5.0)
TRUE_POLE_HZ = 2500.0
Spoil = Callable[[Measurement], Measurement]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(mismatched(0.2, 11), count_m=24.5e-6)


@pytest.fixture(scope="module")
def runs(rig: Rig) -> list[Measurement]:
    return rig.sweeps(GRIPS_N, seed=4)


def later(run: Measurement) -> Measurement:
    return spoilt(run, "acceleration", lambda x: np.append(0.0, x[:-1]))


def louder(run: Measurement) -> Measurement:
    return spoilt(run, "acceleration", lambda x: 1.2 * x)


def unstated(run: Measurement) -> Measurement:
    return replace(run, accelerometer_Hz=None)


def misstated(run: Measurement) -> Measurement:
    return replace(run, accelerometer_Hz=4000.0)


def fitted(runs: list[Measurement]) -> ChainFit:
    records = sort_trials(runs, [], AMPLIFIER, None)
    return fit_chain([grip.response for grip in records.grips], records.instrument, DEFAULT)


FOUND: dict[str, tuple[Spoil, dict[str, tuple[float, float]]]] = {
    "nothing": (lambda run: run, {}),
    "unstated": (unstated, {"accelerometer_pole": (TRUE_POLE_HZ, 0.01 * TRUE_POLE_HZ)}),
    "misstated": (misstated, {"accelerometer_pole": (TRUE_POLE_HZ, 0.01 * TRUE_POLE_HZ)}),
    "late": (later, {"late": (1.0, 0.01)}),
    "louder": (louder, {"gain": (1.2, 0.005 * 1.2)}),
    "all three": (
        lambda run: unstated(later(louder(run))),
        {"accelerometer_pole": (TRUE_POLE_HZ, 0.03 * TRUE_POLE_HZ), "late": (1.0, 0.03), "gain": (1.2, 0.006)},
    ),
}


@pytest.mark.parametrize("case", FOUND)
def test_a_nuisance_is_found_and_the_device_is_that_without_it(case: str, rig: Rig, runs: list[Measurement]) -> None:
    spoil, expected = FOUND[case]
    fit = fitted([spoil(run) for run in runs])
    assert {one.name for one in fit.nuisances} == set(expected)
    for one in fit.nuisances:
        value, within = expected[one.name]
        assert one.value == pytest.approx(value, abs=within)
        assert abs(one.value - value) < 5 * one.deviation
    np.testing.assert_allclose(fit.device.shared, rig.device.shared, rtol=0.02)
    for grip in GRIPS_N:
        np.testing.assert_allclose(fit.device.hand_at(grip), rig.device.hand_at(grip), rtol=0.05)
    assert fit.scatter < 1.3


def test_what_was_found_is_named_with_what_to_do(runs: list[Measurement]) -> None:
    result = identify([unstated(louder(run)) for run in runs], [], SETTINGS)
    assert result.causes == ["unstated accelerometer pole", "accelerometer gain"]
    said = " | ".join(str(finding) for finding in result.findings)
    assert "no file states it: taken out of the records" in said
    assert "times what the encoder says" in said


def test_the_drift_of_a_second_clock_is_found_and_taken_out(rig: Rig, runs: list[Measurement]) -> None:
    """An accelerometer whose samples are 20 ppm farther apart looks like one with another pole."""

    def by_its_own_clock(x: np.ndarray) -> np.ndarray:
        ticks = np.arange(x.size)
        return CubicSpline(ticks, x)(np.minimum(ticks * (1 + 20e-6), x.size - 1))

    spoiled = [spoilt(run, "acceleration", by_its_own_clock) for run in runs if run.grip_N != GRIPS_N[1]]
    result = identify(spoiled, [], replace(SETTINGS, random_starts=0))
    assert result.causes == ["two clocks"]
    [said] = [str(finding) for finding in result.findings if finding.cause]
    ppm, width = map(float, re.findall(r"([-+\d.]+) \+- (\S+) ppm", said)[0])
    assert ppm == pytest.approx(20, abs=2 * width)
    assert width < 1
    assert result.chain is not None
    fit = result.chain
    off = (fit.unknowns - fit.coordinates.of(rig.device)) / np.sqrt(np.diag(fit.covariance))
    assert np.abs(off).max() < 4


def test_a_gain_that_no_encoder_contradicts_is_not_sought(runs: list[Measurement]) -> None:
    fit = fitted([replace(louder(run), position=None) for run in runs])
    assert fit.nuisances == ()
    assert fit.instrument.gain == pytest.approx(1.0)


def test_hands_that_vary_from_trial_to_trial_widen_the_intervals_and_are_named(rig: Rig) -> None:
    """Each trial with springs and dampers of the hand 10 % off: what is found lies within what is claimed."""
    runs, random = [], np.random.default_rng(3)
    for number in range(4):
        hand = rig.device.hand * (1 + 0.1 * random.uniform(-1, 1, (5, 1)))
        runs += Rig(replace(rig.device, hand=hand)).sweeps(GRIPS_N, trials=number + 1)[number :: number + 1]
    steady = fitted(rig.sweeps(GRIPS_N, seed=4))
    varying = fitted(runs)
    hand_of = slice(4, None)
    wider = np.sqrt(np.diag(varying.covariance) / np.diag(steady.covariance))[hand_of]
    assert np.median(wider) > 5
    off = np.abs(varying.unknowns - varying.coordinates.of(rig.device)) / np.sqrt(np.diag(varying.covariance))
    assert np.median(off) < 2
    assert "varying hand" in identify(runs, [], SETTINGS).causes
