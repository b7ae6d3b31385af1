"""Responses that no actuator has in the units that are stated, and the unit that is to be checked."""

import numpy as np
import pytest

from transopt.scene.plausible_response import against_sheet, implausible_response


class TestResponse:
    f = np.geomspace(20, 1000, 80)

    def accelerance(self, gain: float = 0.6, f0: float = 150.0) -> np.ndarray:
        s, w = 2j * np.pi * self.f, 2 * np.pi * f0
        return gain * s**2 / (s**2 + s * w / 8 + w**2)

    def said(self, response: np.ndarray, frequency: float = 1.0, f0: float = 150.0) -> str:
        return implausible_response(frequency * self.f, response, [frequency * f0], "V")

    @pytest.mark.parametrize("gain", [0.3, 3.0, 30.0, 300.0])
    def test_actuators_pass(self, gain: float) -> None:
        assert not self.said(self.accelerance(gain))
        assert not self.said(self.accelerance(gain), f0=1e5)  # a pole of the fit where nothing was measured
        assert not implausible_response(self.f, np.full(self.f.size, gain + 0j), [], "A")

    @pytest.mark.parametrize(
        ("factor", "frequency", "words"),
        [
            (1e-3, 1.0, "1000: mm/s^2, mg or mV?"),
            (1e6, 1.0, "1000: mm/s^2, mg or mV?"),
            (1.0, 1e-3, "1000: kHz?"),
            (1.0, 1e3, "1000: kHz?"),
            (1.0, 40.0, "6.283: rad/s called Hz?"),
        ],
    )
    def test_a_wrong_unit_is_named_with_its_factor(self, factor: float, frequency: float, words: str) -> None:
        assert words in self.said(factor * self.accelerance(), frequency)

    def test_a_velocity_and_a_displacement_are_told_from_an_acceleration(self) -> None:
        w = 2 * np.pi * self.f
        assert "as a velocity, no acceleration: state its unit, or multiply it by 2 pi f" in self.said(
            1e3 * self.accelerance() / w
        )
        assert "as a displacement" in self.said(1e6 * self.accelerance() / w**2)

    def test_exchanged_columns_are_told_by_how_the_response_begins(self) -> None:
        assert "are the columns exchanged?" in implausible_response(self.f, 1 / self.accelerance(), [9.0], "V")
        above = self.f > 155  # a band that begins on the far side of a resonance falls as steeply
        assert not implausible_response(self.f[above], self.accelerance()[above], [150.0], "V")

    @pytest.mark.parametrize(
        ("ratio", "words"), [(9.81, "g and m/s^2"), (1 / 9.81, "g and m/s^2"), (1e3, "milli"), (6.28, "rad/s and Hz")]
    )
    def test_against_its_sheet(self, ratio: float, words: str) -> None:
        assert words in against_sheet(150 * ratio, 150, "resonance", "Hz")
        assert not against_sheet(1.2 * 150, 150, "resonance", "Hz")
