"""What is named as off, from ratios of seen to expected; and the ratios of a hand's motion."""

import numpy as np
import pytest

from controller.host.diagnosis import Ratios, diagnosis, sound
from controller.host.motion import shaken

DT_S = 1e-4
FACTORS = (-1.0, 0.3, 0.5, 2.0, 3.0, 8.0)
WORDS = {
    "amplifier": "the amplifier gives",
    "monitor": "the current monitor reads",
    "motor": "the motor pushes",
    "encoder": "the encoder reads",
    "accelerometer": "the accelerometer reads",
}


def seen(**off: float) -> Ratios:
    """What a device shows whose parts are off by these factors."""
    part = {**dict.fromkeys(WORDS, 1.0), **off}
    return Ratios(
        current=part["amplifier"] * part["monitor"],
        acceleration=part["amplifier"] * part["motor"] * part["accelerometer"],
        ruler=part["encoder"],
        motion=part["encoder"] / part["accelerometer"],
    )


def test_a_sound_device_has_nothing_to_be_named() -> None:
    assert diagnosis(Ratios()) == []
    assert diagnosis(seen()) == []
    assert diagnosis(seen(motor=1.15, encoder=0.9)) == []


@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize("part", ["amplifier", "monitor", "motor", "encoder"])
def test_one_error_is_named_alone_and_by_its_size(part: str, factor: float) -> None:
    [words] = diagnosis(seen(**{part: factor}))
    assert words.startswith(WORDS[part])
    assert ("the opposite of" if factor < 0 else f"{factor:.2g} times") in words


@pytest.mark.parametrize("factor", FACTORS)
def test_an_accelerometer_is_named_first(factor: float) -> None:
    """The check goes no further, but if it did its pulses would be off too."""
    first, *_ = diagnosis(seen(accelerometer=factor))
    assert first.startswith(WORDS["accelerometer"])


def test_dead_parts() -> None:
    assert "is it enabled" in diagnosis(Ratios(current=0.01, acceleration=0.0))[0]
    assert diagnosis(Ratios(current=1.0, acceleration=0.0)) == [
        "the motor pushes with nothing of the force that the library's model says"
    ]
    assert diagnosis(Ratios(ruler=0.0, motion=0.0)) == ["the encoder reads nothing of the way that the stylus goes"]
    [words] = diagnosis(Ratios(ruler=1.0, motion=float("inf")))
    assert words.startswith("the accelerometer reads nothing of")


def test_two_errors_never_cancel() -> None:
    random = np.random.default_rng(1)
    for _ in range(300):
        one, other = random.choice(list(WORDS), 2, replace=False)
        assert diagnosis(seen(**{str(one): random.choice(FACTORS), str(other): random.choice(FACTORS)}))


def test_the_trial_tap_and_its_speed() -> None:
    assert "the trial tap was 1.5 times the one that" in diagnosis(Ratios(trial=1.5))[0]
    assert "the encoder reads 2 times the motion" in diagnosis(Ratios(speed=2.0))[0]
    assert sound(0.8)
    assert not sound(1.25)
    assert not sound(float("nan"))


@pytest.mark.parametrize(("encoder", "accelerometer"), [(1.0, 1.0), (-1.0, 1.0), (3.0, 1.0), (1.0, -0.5)])
def test_a_shake_tells_the_ratio_of_two_sensors(encoder: float, accelerometer: float) -> None:
    """The ratio is found with a coarse encoder, noise, gravity, and a tremor beside the shake."""
    random, times = np.random.default_rng(2), np.arange(0, 2.5, DT_S)
    path = 5e-3 * np.sin(2 * np.pi * 3 * times) + 1e-4 * np.sin(2 * np.pi * 7 * times)
    felt = np.gradient(np.gradient(path, DT_S), DT_S) + 9.81 + 0.5 * random.standard_normal(times.size)
    counts = np.floor(encoder * path / 1e-4) * 1e-4
    found = shaken(DT_S, counts, accelerometer * felt)
    assert found.enough
    assert found.ratio == pytest.approx(encoder / accelerometer, rel=0.06)


def test_a_sensor_that_gives_nothing_and_a_hand_that_does_not_shake() -> None:
    times = np.arange(0, 2.5, DT_S)
    path = 5e-3 * np.sin(2 * np.pi * 3 * times)
    felt = np.gradient(np.gradient(path, DT_S), DT_S)
    still = np.zeros_like(times)
    assert shaken(DT_S, path, still).ratio == float("inf")
    assert shaken(DT_S, still, felt).ratio == 0.0
    assert not shaken(DT_S, 1e-3 * path, 1e-3 * felt).enough
    assert not shaken(DT_S, path[:100], felt[:100]).enough
    assert np.isnan(shaken(DT_S, path, np.roll(felt, 800)).ratio)
