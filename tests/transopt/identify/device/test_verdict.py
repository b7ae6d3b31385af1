"""The verdict is what the device will show, and intervals hold the truth as often as they say."""

import numpy as np
import pytest

from tests.benches.identification import AMPLIFIER, DEFAULT, Rig, mismatched
from tests.transopt.identify.device.conftest import INSTRUMENT, SETTINGS, Respond
from transopt.base.signals import FloatArray
from transopt.identify.device.chain import SHARED, DriveChain
from transopt.identify.device.chain_fit import fit_chain, response_variance
from transopt.identify.device.identify import identify
from transopt.identify.device.response import sampled_response
from transopt.identify.device.result import device_part
from transopt.identify.device.validation import (
    Taps,
    model_error,
    not_covered,
    predict_taps,
    relative,
    short_of,
    verdict,
)
from transopt.plant.amplifier import Amplifier
from transopt.scene.model_error import ModelError, Predicted
from transopt.scene.model_parts import DriveDevice

GRIPS_N = (1.0, 3.0, 5.0)


def true_and_predicted(respond: Respond, truth: DriveChain, seed: int) -> tuple[float, float]:
    """Mean square of the fitted response's error over 5 to 600 Hz and over the response's own, true and expected."""
    random = np.random.default_rng(seed)
    measured = [respond(truth.plant(grip), grip, random=random) for grip in GRIPS_N]
    fit = fit_chain(measured, INSTRUMENT, DEFAULT, random_starts=0)
    error = model_error(measured, fit.device, fit.instrument, lambda one: response_variance(fit, one))
    parts = []
    for one in measured:
        f = one.estimate.frequencies_Hz
        f = f[(f >= 5) & (f <= 600)]
        found, right = (sampled_response(d.plant(one.grip_N), INSTRUMENT, f)[0] for d in (fit.device, truth))
        width = np.gradient(f)
        parts.append(np.abs(found - right) ** 2 @ width / (np.abs(right) ** 2 @ width))
    return float(np.sqrt(np.mean(parts))), relative(error, measured)


def test_where_the_model_is_right_the_predicted_error_is_the_true_one(respond: Respond) -> None:
    found = np.array([true_and_predicted(respond, mismatched(0.2, seed), seed) for seed in range(8)])
    true, predicted = np.sqrt(np.mean(found**2, axis=0))
    assert true < 1e-3
    assert 0.6 < predicted / true < 1.7


def test_where_the_hand_is_no_line_over_grip_the_predicted_error_is_the_true_one(respond: Respond) -> None:
    class Bent(DriveChain):
        def hand_at(self, grip_N: float) -> np.ndarray:
            straight = super().hand_at(grip_N)
            return np.asarray(straight * np.array([1.0, 1.0 - 0.3 * (grip_N == 3.0), 1.0, 1.0, 1.0]))

    bent = Bent(DEFAULT.force_per_current_N_A, DEFAULT.shared, DEFAULT.hand)
    true, predicted = true_and_predicted(respond, bent, 1)
    assert true > 0.01
    assert 0.8 < predicted / true < 1.25


def predicted(worst: float) -> Predicted:
    return Predicted(speeds_m_s=[0.1, 0.4], grips_N=[1.0, 5.0], nrmse=[[0.001, 0.001], [0.001, worst]])


def test_the_words_say_model_error_and_noise_apart() -> None:
    text = verdict(predicted(0.004), {1.0: 0.017, 5.0: 0.016, 3.0: float("nan")})
    assert text == (
        "model error 0.1 % of a tap (worst 0.4 %, at 0.4 m/s, 5 N): design errors below that are the model's; one "
        "recorded trial misses 1.7 %, its noise included"
    )
    assert verdict(predicted(0.7), {}).startswith("supports no design: predicted to miss 70 % of the tap at 0.4 m/s")
    assert "--scene" in verdict(None, {})


def test_taps_beyond_what_was_recorded_are_said_with_the_record_that_lacks() -> None:
    error = ModelError(
        grips_N=[0.0, 1.0, 5.0],
        frequencies_Hz=[10.0, 100.0],
        power=[[1e-6, 1e-6]] * 3,
        recorded_A=[0.7, 0.8, 2.8],
    )
    for peak_A, said in ((0.85, ""), (1.9, ""), (2.2, "taps reach 2.2 A at 3 N, 1.8 A were recorded")):
        taps = Taps((0.3,), (3.0,), np.full((1, 1, 5), -peak_A), np.ones((1, 1)), 1e-4)
        found = not_covered(error, taps)
        assert (said in found) if said else found == ""
    assert found.endswith("add taps (record sweep --tap-current 2.2)")
    assert verdict(predict_taps(error, taps), {}, found).endswith(found)
    # Held grips tell nothing of the free device.
    assert error.recorded_at(0.0) == pytest.approx(0.7)
    assert not error.covers(0.0, 0.8)
    # A file that does not say what it was recorded with is not doubted for it.
    assert error.model_copy(update={"recorded_A": []}).covers(3.0, 1e3)


def test_what_falls_short_names_the_grip_and_the_tap() -> None:
    assert short_of(predicted(0.04)) == []
    (said,) = short_of(predicted(0.06))
    assert said.startswith("5 N: predicted to miss 6 % of the tap at 0.4 m/s, limit 5 %")
    assert short_of(None) == []


FRESH = 7000


def z_of(seed: int) -> FloatArray:
    """(14,) errors of the parameters of one recording, in units of their standard deviations."""
    off = 1 + np.random.default_rng([seed, 6]).uniform(-0.1, 0.1, 2)
    amplifier = Amplifier(AMPLIFIER.pole_Hz * off[0], AMPLIFIER.delay_s * off[1], 6.0)
    rig = Rig(mismatched(0.1, seed), amplifier, crossover_A=0.01, count_m=24.5e-6)
    result = identify(rig.sweeps((1.0, 3.0, 5.0), seed=seed), [], SETTINGS)
    part = device_part(result)
    assert isinstance(part, DriveDevice)
    truth = np.concatenate([rig.device.shared, rig.device.hand.ravel()])
    return np.asarray((part.values() - truth) / np.sqrt(np.diag(part.covariance)))


@pytest.mark.parametrize(
    ("recordings", "transmission", "each", "pooled"),
    [
        # At 95 % one in 10^4 such tests would see fewer than 21 of 28 hold the truth.
        (2, (0.0, 1.0), (0.0, 1.0), (0.75, 1.0)),
        pytest.param(
            300, (0.91, 0.99), (0.91, 1.0), (0.93, 0.98), marks=(pytest.mark.long, pytest.mark.timeout(7200))
        ),
    ],
)
def test_intervals_hold_the_truth(
    recordings: int, transmission: tuple[float, float], each: tuple[float, float], pooled: tuple[float, float]
) -> None:
    inside = np.abs([z_of(FRESH + j) for j in range(recordings)]) < 1.96
    share = inside.mean(axis=0)
    for shares, (least, most) in ((share[: len(SHARED)], transmission), (share, each), (share.mean(), pooled)):
        assert np.all((least <= shares) & (shares <= most)), share
