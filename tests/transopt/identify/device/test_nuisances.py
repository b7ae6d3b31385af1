"""What no file states of the sensors, delays, slow motion and noise is found, named and taken out."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tests.benches.identification import AMPLIFIER, DEFAULT, DT_S, Rig, mismatched, spoilt
from tests.transopt.identify.device.conftest import SETTINGS
from transopt.base.signals import FloatArray
from transopt.identify.device.chain_fit import ChainFit, fit_chain
from transopt.identify.device.cleaned import NOTICED, TAKEN_HZ, delay_samples, leakage, without_delay
from transopt.identify.device.findings import noise_findings
from transopt.identify.device.identify import identify
from transopt.identify.device.result import device_part
from transopt.identify.device.trials import instrument_of, sort_trials
from transopt.identify.findings import Finding
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
    assert result.causes == ["unstated accelerometer pole", "accelerometer or encoder gain"]
    said = " | ".join(str(finding) for finding in result.findings)
    assert "no file states it: taken out of the records" in said
    assert re.search(r"1\.2\d* times what the encoder says: either is off scale, .* 0\.8\d+ times as much", said)


@pytest.mark.parametrize(("counts", "refused"), [(1.3, True), (1 / 1.3, True), (1.2, False), (1.0, False)])
def test_an_encoder_far_off_scale_is_refused(runs: list[Measurement], counts: float, refused: bool) -> None:
    """Every mass, and what the model makes of a current, would be off by as much."""
    spoiled = [spoilt(run, "position", lambda x: counts * x) for run in runs]
    result = identify(spoiled, [], replace(SETTINGS, random_starts=0))
    assert bool(result.short) is refused
    assert device_part(result).shortfalls == result.short
    if refused:
        apart, answers = re.search(r"position: (\S+) times apart .* a current (\S+) times", result.short[0]).groups()
        assert (float(apart), float(answers)) == pytest.approx((1 / counts, counts), rel=0.01)


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


@pytest.fixture(scope="module")
def undelayed() -> list[Measurement]:
    return Rig(mismatched(0.1, 5)).sweeps((1.0, 3.0))


def late(run: Measurement, samples: int) -> Measurement:
    noise = 0.03 * np.random.default_rng(samples).standard_normal(samples)
    return spoilt(run, "acceleration", lambda x: np.append(noise, x[: x.size - samples]))


@pytest.mark.parametrize("samples", [3, 80, 2000])
def test_found_to_a_sample_by_a_device_ten_percent_off(undelayed: list[Measurement], samples: int) -> None:
    shifted = [late(run, samples) for run in undelayed]
    found = delay_samples(shifted, AMPLIFIER, DEFAULT.plant, instrument_of(shifted, AMPLIFIER))
    # Two milliseconds and less may be the device's own.
    assert abs(found - (samples if samples * DT_S > 2e-3 else 0)) <= 1


def test_taken_out_of_every_channel(undelayed: list[Measurement]) -> None:
    back = without_delay([late(undelayed[0], 500)], 500)[0]
    kept = undelayed[0].require("acceleration").values.size - 500
    for name in ("command", "current", "acceleration"):
        np.testing.assert_array_equal(back.require(name).values, undelayed[0].require(name).values[:kept])


def test_identified_behind_fifty_milliseconds(undelayed: list[Measurement]) -> None:
    result = identify([late(run, 500) for run in undelayed], [], SETTINGS)
    assert any("50 ms (500 samples) later than any device answers" in str(found) for found in result.findings)
    assert max(result.chosen.recorded.values()) < 0.02


STEP_S, N = 1e-4, 20000


def fast_lines(values: np.ndarray) -> np.ndarray:
    lines = np.fft.rfft(values)
    lines[np.fft.rfftfreq(values.size, STEP_S) <= TAKEN_HZ] = 0.0
    return np.asarray(lines)


def test_a_tremor_that_the_record_cuts_off_is_found_by_its_leakage() -> None:
    times, random = STEP_S * np.arange(N), np.random.default_rng(4)
    tremor = 0.5 * np.sin(2 * np.pi * 9.3 * times + 1.2)  # the ends do not meet
    noise = 0.02 * random.standard_normal(N)
    found, share = leakage(tremor + noise, STEP_S)
    true = fast_lines(tremor)
    assert share > NOTICED
    assert np.linalg.norm(np.fft.rfft(found) - true) < 0.15 * np.linalg.norm(true)


def test_noise_is_left_alone() -> None:
    random = np.random.default_rng(5)
    shares = [leakage(random.standard_normal(N), STEP_S)[1] for _ in range(20)]
    assert max(shares) < NOTICED


def test_lines_below_stay_as_they_are() -> None:
    values = np.cumsum(np.random.default_rng(6).standard_normal(N))
    found, _ = leakage(values, STEP_S)
    slow = np.fft.rfftfreq(N, STEP_S) <= TAKEN_HZ
    assert np.abs(np.fft.rfft(found)[slow]).max() < 1e-9 * np.abs(np.fft.rfft(values)).max()


TWO_GRIPS_N = (1.0, 3.0)
Change = Callable[[FloatArray, FloatArray, np.random.Generator], FloatArray]


def found(change: Change, seed: int = 0) -> list[Finding]:
    """The findings on sweeps whose accelerations (n,) at times (n,) have been changed."""
    random, times_s = np.random.default_rng(seed), DT_S * np.arange(100_000)
    sweeps = Rig(mismatched(0.1, 8)).sweeps(TWO_GRIPS_N)
    runs = [spoilt(run, "acceleration", lambda x: change(times_s[: x.size], x, random)) for run in sweeps]
    return noise_findings(sort_trials(runs, [], AMPLIFIER, None).grips)


def hum(times: FloatArray, values: FloatArray, random: np.random.Generator) -> FloatArray:
    return values + 0.5 * np.sin(2 * np.pi * 60.0 * times + random.uniform(0, 6.28))


def tremor(times: FloatArray, values: FloatArray, random: np.random.Generator) -> FloatArray:
    lines = random.uniform(8, 12, 6)
    return values + 0.5 * np.sin(2 * np.pi * np.outer(times, lines) + random.uniform(0, 6.28, 6)).sum(axis=1)


def steps(times: FloatArray, values: FloatArray, random: np.random.Generator) -> FloatArray:
    return 1.0 * np.round(values)


@pytest.mark.parametrize(
    ("change", "where", "says"),
    [
        (hum, "mains hum", "multiples of 60 Hz"),
        (tremor, "hand tremor", "rest the forearm"),
        (steps, "converter steps", "steps of 1 m/s^2"),
    ],
)
def test_by_name_with_a_remedy(change: Change, where: str, says: str) -> None:
    [finding] = found(change)
    assert finding.where == where
    assert says in finding.text
    assert not finding.fatal


def test_a_plain_record_has_none() -> None:
    assert found(lambda times, values, random: values) == []
