"""The experimental transfer-function estimate: discrete systems known exactly, noise known exactly."""

import numpy as np
import pytest
from scipy import signal

from controller.record.excitation import sweep_command
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray, Signal
from transopt.identify.condensed import condense
from transopt.identify.spectrum import TransferEstimate, Trial, estimate_transfer, transfer

DT_S = 1e-4
NUMERATOR, DENOMINATOR = signal.butter(2, [300, 500], btype="bandpass", fs=1 / DT_S)


def truth(frequencies_Hz: FloatArray) -> np.ndarray:
    return np.asarray(signal.freqz(NUMERATOR, DENOMINATOR, frequencies_Hz, fs=1 / DT_S)[1])


def trial(
    name: str, command: FloatArray, random: np.random.Generator, noise: float, gain: float = 1.0, dt_s: float = DT_S
) -> Trial:
    answer = gain * signal.lfilter(NUMERATOR, DENOMINATOR, command) + noise * random.standard_normal(command.size)
    return Trial(name, Signal(0.0, dt_s, command), Signal(0.0, dt_s, answer))


def trials(seconds: list[float], noise: float, seed: int = 0) -> list[Trial]:
    random = np.random.default_rng(seed)
    return [
        trial(f"{j}", (-1) ** j * sweep_command(1, 2000, length, 0.75, DT_S), random, noise)
        for j, length in enumerate(seconds)
    ]


def relative_error(estimate: TransferEstimate) -> FloatArray:
    wanted = truth(estimate.frequencies_Hz)
    return np.asarray(np.abs(estimate.response - wanted) / np.abs(wanted))


@pytest.mark.parametrize("seconds", [[2.0], [2.0, 2.0], [1.5, 2.0, 2.2], [2.0] * 4, [1.0] * 9])
def test_without_noise_the_response_is_recovered(seconds: list[float]) -> None:
    estimate = estimate_transfer(trials(seconds, 0.0))
    inside = (estimate.frequencies_Hz > 100) & (estimate.frequencies_Hz < 1800)
    assert relative_error(estimate)[inside].max() < 2e-4
    assert estimate.coherence[inside].min() > 1 - 1e-6
    assert estimate.frequencies_Hz[0] < 2.5
    assert 1950 < estimate.frequencies_Hz[-1] < 2100
    assert estimate.trial_responses.shape == (len(seconds), estimate.frequencies_Hz.size)
    assert estimate.trials == len(seconds)


def test_an_answer_that_the_end_of_the_record_cuts_off_is_no_bias() -> None:
    late = 40
    command = sweep_command(10, 4000, 1.0, 1.0, DT_S)
    answer = np.concatenate([np.zeros(late), command[:-late]])
    trial = Trial("cut", Signal(0.0, DT_S, command), Signal(0.0, DT_S, answer))
    estimate = estimate_transfer([trial]).between(50, 3500)
    turned = estimate.response * np.exp(2j * np.pi * estimate.frequencies_Hz * late * DT_S)
    missing = np.abs(np.fft.rfft(command[-late:])).max() / np.abs(np.fft.rfft(command)[3500])
    assert missing > 0.05  # of the spectrum there: what an estimate without transient would be off by
    assert np.abs(turned - 1).max() < 0.02


@pytest.mark.parametrize("seeds", [15, pytest.param(40, marks=pytest.mark.long)])
@pytest.mark.parametrize("seconds", [[2.0], [1.0] * 4, [1.0, 1.1, 1.3]])
def test_bands_hold_the_truth_as_often_as_they_say(seconds: list[float], seeds: int) -> None:
    disc, real, magnitude, phase = [], [], [], []
    for seed in range(seeds):
        estimate = estimate_transfer(trials(seconds, 0.05, seed)).between(150, 1000)
        wanted = truth(estimate.frequencies_Hz)
        error = estimate.response - wanted
        disc.append(np.mean(np.abs(error) <= estimate.radius()))
        real.append(np.mean(np.abs(error.real) <= estimate.half_width()))
        low, high = estimate.magnitude_band()
        magnitude.append(np.mean((low <= np.abs(wanted)) & (np.abs(wanted) <= high)))
        turned = np.degrees(np.angle(estimate.response / wanted))
        phase.append(np.mean(np.abs(turned) <= estimate.phase_half_width_deg()))
    # 15 x 66 bins: the standard deviation of the count is 0.7 %, of 40 x 66 bins 0.4 %.
    for shares in (disc, real, magnitude, phase):
        assert 0.93 < np.mean(shares) < 0.97


def test_coherence_is_the_share_of_the_signal_in_the_output() -> None:
    noise = 0.5
    estimates = [estimate_transfer(trials([2.0] * 4, noise, seed)).between(200, 800) for seed in range(10)]
    frequencies = estimates[0].frequencies_Hz
    command = sweep_command(1, 2000, 2.0, 0.75, DT_S)
    lines = np.fft.rfftfreq(command.size, DT_S)
    power = np.interp(frequencies, lines, np.abs(np.fft.rfft(command)) ** 2 / command.size)
    ratio = power * np.abs(truth(frequencies)) ** 2 / noise**2
    found = np.mean([estimate.coherence for estimate in estimates], axis=0)
    np.testing.assert_allclose(found, ratio / (1 + ratio), atol=0.05)
    assert found.min() < 0.1  # both ends of the scale were tried
    assert found.max() > 0.6


def test_distortion_of_even_order_cancels_between_polarities() -> None:
    command = sweep_command(5, 2000, 2.0, 0.75, DT_S)

    def bent(sign: int) -> Trial:
        given = sign * command
        return Trial(f"{sign}", Signal(0.0, DT_S, given), Signal(0.0, DT_S, given + 0.4 * given**2))

    both, one = (estimate_transfer(pair).between(10, 1500) for pair in ([bent(1), bent(-1)], [bent(1), bent(1)]))
    assert np.abs(both.response - 1).max() < 1e-9
    assert np.abs(one.response - 1).max() > 1e-3


def test_trials_that_differ_widen_the_band() -> None:
    gains = np.random.default_rng(7).normal(1.0, 0.1, (20, 5))
    command = sweep_command(1, 2000, 1.0, 0.75, DT_S)
    held = []
    for seed, row in enumerate(gains):
        random = np.random.default_rng(seed)
        estimate = estimate_transfer([trial(f"{g:g}", command, random, 0.01, g) for g in row]).between(300, 500)
        held.append(np.abs(estimate.response[3] - truth(estimate.frequencies_Hz)[3]) <= estimate.radius()[3])
        assert np.all(estimate.degrees == 8)
    # One true mean, twenty experiments of five trials; without the scatter between them hardly one would hold it.
    assert np.mean(held) > 0.85


def test_a_response_over_another_output_is_that_from_the_other_as_input() -> None:
    """What the two outputs have in common, be it noise of the first, is no noise of their ratio."""
    command = sweep_command(1, 2000, 2.0, 0.75, DT_S)
    errors, same, noise = [], [], 0.01
    for seed in range(10):
        random = np.random.default_rng(seed)
        currents = [command + 0.1 * random.standard_normal(command.size) for _ in range(3)]
        answers = [signal.lfilter(NUMERATOR, DENOMINATOR, one) for one in currents]
        answers = [one + noise * random.standard_normal(one.size) for one in answers]
        both = [np.stack(pair) for pair in zip(currents, answers, strict=True)]
        ratio = transfer(condense([command] * 3, both, DT_S), 1, over=0).between(250, 700)
        direct = transfer(condense(currents, [one[None] for one in answers], DT_S)).between(250, 700)
        errors.append(np.abs(ratio.response - truth(ratio.frequencies_Hz)) <= ratio.radius())
        same.append(ratio.deviation / direct.deviation)
        one = ratio.over(ratio.response)
        np.testing.assert_allclose(one.response, 1.0)
        np.testing.assert_allclose(one.deviation, ratio.deviation / np.abs(ratio.response))
    assert 0.9 < np.mean(errors) < 0.98
    assert 0.9 < np.mean(same) < 1.1


@pytest.mark.parametrize("seeds", [25, pytest.param(60, marks=pytest.mark.long)])
def test_bins_share_no_line_and_their_errors_do_not_correlate(seeds: int) -> None:
    errors = []
    for seed in range(seeds):
        estimate = estimate_transfer(trials([1.0] * 4, 0.05, seed)).between(200, 800)
        errors.append((estimate.response - truth(estimate.frequencies_Hz)).real / estimate.deviation)
    neighbours = np.mean(np.array(errors)[:, 1:] * np.array(errors)[:, :-1])
    assert abs(neighbours) < 0.08


def test_a_band_may_be_named() -> None:
    estimate = estimate_transfer(trials([2.0], 0.0)).between(100, 500)
    assert estimate.frequencies_Hz[0] >= 100
    assert estimate.frequencies_Hz[-1] <= 500
    with pytest.raises(InputError, match=r"no excitation from 600 to 700 Hz, only .* sweep further"):
        estimate.between(600, 700)


def test_bad_trials_are_refused_in_one_line() -> None:
    command = sweep_command(10, 1000, 1.0, 1.0, DT_S)
    at_rest = Signal(0.0, DT_S, np.zeros(command.size))
    good = Signal(0.0, DT_S, command)
    with pytest.raises(InputError, match="a: the input stays at 0: no excitation; play the sweep"):
        Trial("a", at_rest, good)
    with pytest.raises(InputError, match="a: input 10000 samples at 10000 Hz, output 10000 at 5000 Hz"):
        Trial("a", good, Signal(0.0, 2 * DT_S, command))
    with pytest.raises(InputError, match="no trial at all"):
        estimate_transfer([])
    slow = Signal(0.0, 2 * DT_S, command)
    with pytest.raises(InputError, match="b: rates that differ: 5000 Hz, a 10000 Hz: must be one rate"):
        estimate_transfer([Trial("a", good, good), Trial("b", slow, slow)])
    short = Signal(0.0, DT_S, command[:4])
    with pytest.raises(InputError, match=r"records of 0.0004 s are too short"):
        estimate_transfer([Trial("a", short, short)])
