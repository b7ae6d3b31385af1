"""The amplifier from its sweeps: exact records in, pole, delay and crossover out, with intervals that mean it."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from scipy.stats import binom
from typer.testing import CliRunner

from controller.record.trial_file import write_measurement
from tests.benches.sweeps import DELAY_S, DT_S, POLE_HZ, amplifier_trial, device_columns, save_amplifier_trial
from transopt.base.errors import InputError
from transopt.base.signals import Signal
from transopt.cli.main import app
from transopt.identify.amplifier import AmplifierFit, check_alike, estimate_crossover, fit_amplifier
from transopt.identify.amplifier_response import sampled, simulate_current
from transopt.identify.spectrum import Trial, estimate_transfer
from transopt.report.fits import amplifier_figure, prefilter_response
from transopt.scene.model_file import load_model

FINE = 100  # steps of a microsecond in a servo period


def finely_simulated(command: np.ndarray, pole_Hz: float, delay_s: float) -> np.ndarray:
    """The current by stepping the differential equation every microsecond, a delayed command held."""
    held = np.repeat(command, FINE)
    late = round(delay_s / DT_S * FINE)
    held = np.concatenate([np.zeros(late), held])[: held.size]
    keep = np.exp(-2 * np.pi * pole_Hz * DT_S / FINE)
    current, i = np.empty(command.size), 0.0
    for k, c in enumerate(held):
        if k % FINE == 0:
            current[k // FINE] = i
        i = keep * i + (1 - keep) * c
    return current


@pytest.mark.parametrize("delay_us", [0, 1, 68, 100, 268])
def test_the_simulated_current_is_the_differential_equation_s(delay_us: int) -> None:
    command = np.random.default_rng(delay_us).standard_normal(300)
    found = simulate_current(command, POLE_HZ, 1e-6 * delay_us, DT_S)
    np.testing.assert_allclose(found, finely_simulated(command, POLE_HZ, 1e-6 * delay_us), atol=1e-12)


@pytest.mark.parametrize("delay_s", [0.0, 30e-6, 99.9999e-6, 100e-6, 231e-6])
def test_the_sampled_response_is_that_of_the_simulated_current(delay_s: float) -> None:
    impulse = np.zeros(4096)
    impulse[0] = 1.0
    answer = np.fft.rfft(simulate_current(impulse, POLE_HZ, delay_s, DT_S))
    lines = np.fft.rfftfreq(impulse.size, DT_S)
    np.testing.assert_allclose(sampled(lines, POLE_HZ, delay_s, DT_S)[0], answer, atol=1e-12)


@pytest.mark.parametrize("delay_s", [3e-6, 68e-6, 231e-6])
def test_the_slopes_are_those_of_the_response(delay_s: float) -> None:
    f, step = np.geomspace(10, 4500, 40), 1e-6
    _, (by_pole, by_delay) = sampled(f, POLE_HZ, delay_s, DT_S)
    up, down = (sampled(f, POLE_HZ * np.exp(move), delay_s, DT_S)[0] for move in (step, -step))
    np.testing.assert_allclose(by_pole, (up - down) / (2 * step), atol=1e-8)
    up, down = (sampled(f, POLE_HZ, delay_s + move * DT_S, DT_S)[0] for move in (step, -step))
    np.testing.assert_allclose(by_delay * DT_S, (up - down) / (2 * step), atol=1e-8)


def test_a_current_that_the_end_of_the_record_cuts_off_is_no_bias() -> None:
    trials = [
        amplifier_trial(j, offset_A=1.0, sign=(-1) ** j, crossover_A=0.0, pole_Hz=500.0, noise_A=0.0, seconds=0.4)
        for j in range(2)
    ]
    assert abs(trials[0].output.values[-1]) > 0.05  # of 1.5 A, not at rest
    fit = fit_amplifier(trials)
    assert fit.gain == pytest.approx(1.0, abs=2e-5)
    assert fit.pole_Hz == pytest.approx(500.0, rel=2e-5)


@pytest.mark.parametrize(
    ("pole_Hz", "delay_s"), [(300.0, 137e-6), (300.0, 0.0), (1050.0, 68e-6), (2500.0, 100e-6), (2500.0, 420e-6)]
)
def test_without_noise_everything_is_recovered(pole_Hz: float, delay_s: float) -> None:
    trial = amplifier_trial(0, crossover_A=0.0, pole_Hz=pole_Hz, delay_s=delay_s, noise_A=0.0, seconds=1.0)
    fit = fit_amplifier([trial])
    assert fit.pole_Hz == pytest.approx(pole_Hz, rel=1e-4)
    assert fit.delay_s == pytest.approx(delay_s, abs=2e-8)
    assert fit.gain == pytest.approx(1.0, rel=1e-4)
    assert fit.delay_with_hold_s == fit.delay_s + 0.5 * DT_S
    assert not fit.crossover.shows
    assert fit.misfit_dB < 0.01
    assert fit.shortfalls() == []


SETS = {
    "through zero": [{"amplitude_A": 1.0}, {"amplitude_A": 1.0, "sign": -1}],
    "with offset": [{"offset_A": 1.0}, {"offset_A": 1.0, "sign": -1}],
}
SEEDS, LONG_SEEDS = 8, 50


@cache
def repeated(name: str, seeds: int) -> list[AmplifierFit]:
    return [
        fit_amplifier([amplifier_trial(1000 * seed + j, seconds=0.4, **one) for j, one in enumerate(SETS[name])])
        for seed in range(seeds)
    ]


@pytest.fixture(params=[SEEDS, pytest.param(LONG_SEEDS, marks=pytest.mark.long)])
def fits(request: pytest.FixtureRequest) -> Callable[[str], list[AmplifierFit]]:
    """Fit so many repeated experiments: a few by default, the full number with `-m long`."""
    return lambda name: repeated(name, request.param)


Fits = Callable[[str], list[AmplifierFit]]


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", SETS)
def test_pole_and_delay_at_realistic_noise_over_many_seeds(name: str, fits: Fits) -> None:
    for fit in fits(name):
        assert fit.pole_Hz == pytest.approx(POLE_HZ, rel=0.02)
        assert fit.delay_s == pytest.approx(DELAY_S, abs=3e-6)
        assert fit.shortfalls() == []
    assert np.mean([fit.pole_Hz for fit in fits(name)]) == pytest.approx(POLE_HZ, rel=1e-3)
    assert np.mean([fit.delay_s for fit in fits(name)]) == pytest.approx(DELAY_S, abs=1e-7)


@pytest.mark.timeout(300)
def test_intervals_hold_the_truth_as_often_as_they_say(fits: Fits) -> None:
    truth = {"pole_Hz": POLE_HZ, "delay_s": DELAY_S, "gain": 1.0}

    def share(name: str, key: str) -> float:
        return float(np.mean([fit.intervals[key][0] <= truth[key] <= fit.intervals[key][1] for fit in fits(name)]))

    def least(experiments: int) -> float:
        """One in 200 such series holds the truth less often."""
        return float(binom.ppf(5e-3, experiments, 0.95)) / experiments

    seeds = len(fits("through zero"))
    for key in ("pole_Hz", "delay_s"):
        assert np.mean([share(name, key) for name in SETS]) >= least(seeds * len(SETS))
    assert share("through zero", "gain") >= least(seeds)
    errors = np.array([[fit.pole_Hz - POLE_HZ, fit.delay_s - DELAY_S] for fit in fits("through zero")])
    stated = np.mean([fit.covariance for fit in fits("through zero")], axis=0)[:2, :2]
    scale = np.sqrt(np.diag(stated))
    # A covariance of so few experiments is itself uncertain.
    np.testing.assert_allclose(
        np.cov(errors.T) / np.outer(scale, scale),
        stated / np.outer(scale, scale),
        atol=0.45 if seeds >= LONG_SEEDS else 1.0,
    )


@pytest.mark.timeout(300)
def test_the_crossover_is_found_where_the_records_hold_it(fits: Fits) -> None:
    widths = np.array([fit.crossover.half_width_A for fit in fits("through zero")])
    deviations = [fit.crossover.deviation_A for fit in fits("through zero")]
    assert widths.mean() == pytest.approx(0.01, abs=1e-4)
    assert 0.6 < widths.std() / np.mean(deviations) < 1.5


def test_gains_through_zero_and_beyond_the_crossover_are_the_describing_function_s() -> None:
    trials = [amplifier_trial(0), amplifier_trial(1, sign=-1), amplifier_trial(2, offset_A=1.0)]
    describing = 1 - 4 * 0.01 / (np.pi * 0.5)
    np.testing.assert_allclose(fit_amplifier(trials).trial_gains, [describing, describing, 1.0], atol=2e-3)


@pytest.mark.parametrize("crossover_A", [0.0, 0.05])
def test_a_crossover_is_neither_invented_nor_missed(crossover_A: float) -> None:
    trials = [amplifier_trial(j, crossover_A=crossover_A, sign=(-1) ** j) for j in range(2)]
    found = estimate_crossover(trials, POLE_HZ, DELAY_S)
    assert found.shows == (crossover_A > 0)
    assert abs(found.half_width_A - crossover_A) < 4 * found.deviation_A


def test_the_crossover_is_as_far_off_in_red_noise_as_its_deviation_says() -> None:
    """Noise of the current monitor below 50 Hz, as a supply makes it, is not white."""
    share, found = np.exp(-2 * np.pi * 50 * DT_S), []
    for seed in range(16):
        trial, random = amplifier_trial(seed, crossover_A=0.05, seconds=0.5), np.random.default_rng([seed, 1])
        white = random.standard_normal(trial.output.values.size) * np.sqrt(1 - share**2)
        red = replace(trial.output, values=trial.output.values + 0.02 * signal.lfilter([1], [1, -share], white))
        found.append(estimate_crossover([replace(trial, output=red)], POLE_HZ, DELAY_S))
    off = np.array([(each.half_width_A - 0.05) / each.deviation_A for each in found])
    assert 0.5 < np.sqrt(np.mean(off**2)) < 1.5


def test_an_amplifier_that_is_no_single_pole_is_told() -> None:
    resonant = amplifier_trial(1, crossover_A=0.0)
    echo = resonant.output.values + 0.4 * np.roll(resonant.output.values, 20)
    fit = fit_amplifier([Trial("echo", resonant.input, Signal(0.0, DT_S, echo))])
    found = fit.shortfalls()
    assert any("the amplifier has further dynamics" in line for line in found)
    assert fit.verdict().startswith("not fit to design with: ")


SPOILT = {
    "a tick late": (
        lambda x: np.roll(x, 1),
        "trial 2: samples shifted: the current comes [+](0.9|1.0). samples later",
    ),
    "in mA": (lambda x: 1e3 * x, "trial 2: current off scale: the gain from command to current is 1.*e[+]03 times"),
    "dead": (
        lambda x: np.random.default_rng(2).normal(0, 5e-3, x.size),
        "trial 2: coherence low: the current does not follow the command",
    ),
}


@pytest.mark.parametrize("case", SPOILT)
def test_a_file_that_is_not_like_the_others_is_named(case: str) -> None:
    spoil, message = SPOILT[case]
    trials = [amplifier_trial(j, offset_A=0.7 * (j // 2), sign=(-1) ** j, seconds=1.0) for j in range(4)]
    each = [estimate_transfer([trial]) for trial in trials]
    names = [trial.name for trial in trials]
    assert check_alike(names, each) == []
    output = replace(trials[2].output, values=np.asarray(spoil(trials[2].output.values)))
    each[2] = estimate_transfer([replace(trials[2], output=output)])
    (finding,) = check_alike(names, each)
    assert finding.fatal
    assert re.match(message, str(finding))


def test_sweeps_of_a_device_are_alike_though_they_end_in_noise() -> None:
    """They tell of the amplifier too; above 2 kHz, where they end, a bin's phase is off by up to a radian."""
    each = []
    for seed in range(16):
        columns = device_columns(3.0, seed, sign=(-1) ** seed)
        signals = (Signal(0.0, DT_S, columns[name]) for name in ("command_A", "current_A"))
        each.append(estimate_transfer([Trial("", *signals)]))
    assert check_alike([f"trial {seed}" for seed in range(16)], each) == []


def test_records_too_short_are_said_to_be_that() -> None:
    short = estimate_transfer([amplifier_trial(0, seconds=0.012, low_Hz=100.0)])
    (finding,) = check_alike(["short"], [short])
    assert str(finding).startswith("short: too few cycles: resolves ")


def test_the_prefilter_flattens_the_response() -> None:
    fit = fit_amplifier([amplifier_trial(1)])
    f = np.array([100.0, 500.0, 1000.0])
    flat = np.abs(fit.response(f) * prefilter_response(fit, f))
    assert np.all(flat > 0.93)
    assert abs(fit.response(np.array([1000.0]))[0]) < 0.75
    magnitude, phase = amplifier_figure(fit).axes
    assert magnitude.get_ylabel() == "magnitude [dB]"
    assert phase.get_ylabel() == "phase [deg]"
    assert {line.get_label() for line in magnitude.get_lines()} >= {"command to current, 95 % band"}


# ------------------------------------------------------------------------------------------------- command line


def files(folder: Path) -> list[str]:
    trials = [amplifier_trial(j, sign=(-1) ** j, offset_A=0.5 * (j // 2), seconds=1.0) for j in range(4)]
    return [str(save_amplifier_trial(folder / f"sweep{j}.npz", trial)) for j, trial in enumerate(trials)]


def test_the_command_writes_model_and_figure_and_says_so(tmp_path: Path) -> None:
    model = tmp_path / "arm.json"
    wide = {"COLUMNS": "200"}
    result = CliRunner().invoke(app, ["identify", "amplifier", *files(tmp_path), "--out", str(model)], env=wide)
    assert result.exit_code == 0, result.output
    for said in ("pole", "delay beyond the hold", "delay with the hold's half sample", "crossover", "95 % interval"):
        assert said in result.output
    assert "fit to design with" in result.output
    part = load_model(model).amplifier
    assert part.pole_Hz == pytest.approx(POLE_HZ, rel=0.01)
    assert part.delay_s == pytest.approx(DELAY_S, abs=1e-6)
    assert part.delay_with_hold_s == pytest.approx(part.delay_s + 5e-5)
    assert part.parameters == ["pole_Hz", "delay_s"]
    assert len(part.sources) == 4
    assert (tmp_path / "arm_amplifier.png").read_bytes().startswith(b"\x89PNG")
    assert set(json.loads(model.read_text())) == {"schema", "versions", "amplifier"}


def test_a_fit_that_falls_short_is_written_with_its_verdict_and_exits_with_1(tmp_path: Path) -> None:
    trial = amplifier_trial(1, seconds=1.0)
    halved = Trial("t", trial.input, trial.output.scaled(0.5))
    path = save_amplifier_trial(tmp_path / "half.npz", halved)
    result = CliRunner().invoke(app, ["identify", "amplifier", str(path), "--out", str(tmp_path / "m.json")])
    assert result.exit_code == 1
    part = load_model(tmp_path / "m.json").amplifier
    assert part.verdict.startswith("not fit to design with: the gain")


def test_bad_records_end_in_one_line_and_write_nothing(tmp_path: Path) -> None:
    trial = amplifier_trial(1, seconds=0.5)
    save_amplifier_trial(tmp_path / "turned.npz", Trial("t", trial.input, trial.output.scaled(-1.0)))
    write_measurement(tmp_path / "half.npz", {"time_s": trial.input.times_s, "command_A": trial.input.values}, {})
    out = tmp_path / "m.json"

    def refused(name: str, target: Path = out) -> str:
        result = CliRunner().invoke(app, ["identify", "amplifier", str(tmp_path / name), "--out", str(target)])
        assert isinstance(result.exception, InputError)
        assert "\n" not in str(result.exception)
        assert not target.exists()
        return str(result.exception)

    assert "turned.npz: wrong polarity: from command to current: phase" in refused("turned.npz")
    assert refused("half.npz").startswith("half.npz: no column current_A; record it too")
    assert "a model file ends in .json" in refused("half.npz", tmp_path / "m.txt")
