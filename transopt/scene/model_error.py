"""The spectrum of an identified model's error, and the error of a tap predicted from it.

A tap's error is (G_true - G) times its current. The records give the expected square of G_true - G at every frequency
line: the misfit minus its noise, plus the uncertainty of the parameters. Weighted with the spectrum of a tap's
current it predicts the error of that tap. Effects of large currents only (friction, backlash, a stiffening skin) are
not in the response; held-out taps show them, and they are stated separately by grip and peak current.
"""

from typing import Annotated, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from transopt.base.section import NonNegative, Positive, Section, increasing
from transopt.base.signals import FloatArray
from transopt.base.sizes import MOST_NODES

MOST_BANDS = 200
COVERED = 1.1  # largest current for which the error is valid, over the largest recorded one


class AtUse(Section):
    """The error of one held-out tap at the amplitude of use beyond what the response's error explains.

    Attributes
    ----------
    grip_N : grip at which it was played.
    peak_A : its largest current.
    excess : relative error of the acceleration that is neither noise nor explained by the response's error.
    """

    grip_N: NonNegative
    peak_A: Positive
    excess: NonNegative


class ModelError(Section):
    """Expected squared error of a response, by grip and frequency band.

    Attributes
    ----------
    grips_N : (ng,) recorded grips, increasing.
    frequencies_Hz : (m,) centres of the bands, increasing.
    power : (ng, m) mean square of |G_true - G| [(m/s^2/A)^2].
    at_use : excess error of each held-out tap; empty if none was recorded.
    recorded_A : (ng,) largest recorded current at each grip; empty if the file does not state it.
    """

    grips_N: Annotated[list[NonNegative], Field(min_length=1, max_length=MOST_NODES)]
    frequencies_Hz: Annotated[list[Positive], Field(min_length=1, max_length=MOST_BANDS)]
    power: Annotated[list[list[NonNegative]], Field(min_length=1, max_length=MOST_NODES)]
    at_use: Annotated[list[AtUse], Field(max_length=MOST_NODES)] = Field(default_factory=list)
    recorded_A: Annotated[list[NonNegative], Field(max_length=MOST_NODES)] = Field(default_factory=list)

    _frequencies_ordered = field_validator("frequencies_Hz")(increasing)

    @model_validator(mode="after")
    def _shaped(self) -> Self:
        if len(self.power) != len(self.grips_N) or any(len(row) != len(self.frequencies_Hz) for row in self.power):
            raise ValueError(f"power: must be {len(self.grips_N)} by {len(self.frequencies_Hz)}, grips by bands")
        if self.recorded_A and len(self.recorded_A) != len(self.grips_N):
            raise ValueError(f"recorded_A: must be {len(self.grips_N)} currents, one for each grip")
        return self

    def recorded_at(self, grip_N: float) -> float:
        """Largest recorded current [A], interpolated between grips; infinite if it is not stated."""
        return float(self._at(grip_N, np.array(self.recorded_A))[0]) if self.recorded_A else np.inf

    def _at(self, grip_N: float, values: FloatArray) -> FloatArray:
        """Values (ng, ...) at a grip, linear between recorded ones; free device and held grips are not blended."""
        kept = [j for j, grip in enumerate(self.grips_N) if (grip > 0) == (grip_N > 0)] or range(len(self.grips_N))
        grips, rows = [self.grips_N[j] for j in kept], values[list(kept)]
        return np.array([np.interp(grip_N, grips, column) for column in rows.reshape(len(grips), -1).T])

    def covers(self, grip_N: float, peak_A: float) -> bool:
        """Whether the records cover a peak current: it exceeds the recorded ones by at most 10 %."""
        return peak_A <= COVERED * self.recorded_at(grip_N)

    def _excess(self, grip_N: float, peak_A: float) -> float:
        """Excess error of a tap, interpolated between the held-out taps over grip and peak current."""
        grips = sorted({tap.grip_N for tap in self.at_use})
        if not grips:
            return 0.0
        by_grip = []
        for grip in grips:
            taps = sorted((tap.peak_A, tap.excess) for tap in self.at_use if tap.grip_N == grip)
            by_grip.append(np.interp(peak_A, *np.array(taps).T))
        return float(np.interp(grip_N, grips, by_grip))

    def nrmse(self, grip_N: float, current_A: FloatArray, dt_s: float, energy: float) -> float:
        """Predicted relative error between the model's acceleration and the device's, for one tap.

        Parameters
        ----------
        current_A : (N,) current of the tap, sampled every `dt_s`.
        energy : sum of the squares of the tap's N samples of acceleration [(m/s^2)^2].
        """
        size = 8 * current_A.size
        lines = np.fft.rfftfreq(size, dt_s)[1:]
        power = np.interp(np.log(lines), np.log(self.frequencies_Hz), self._at(grip_N, np.array(self.power)))
        missed = 2 * float(power @ np.abs(np.fft.rfft(current_A, size)[1:]) ** 2) / size
        linear = missed / max(energy, np.finfo(float).tiny)
        return float(np.hypot(np.sqrt(linear), self._excess(grip_N, float(np.abs(current_A).max(initial=0.0)))))


class Predicted(Section):
    """Predicted relative error of the taps of a scene with this model.

    Attributes
    ----------
    speeds_m_s, grips_N : (nv,) speeds and (ng,) grips of the taps.
    nrmse : (ng, nv) relative error.
    """

    speeds_m_s: Annotated[list[Positive], Field(min_length=1, max_length=MOST_NODES)]
    grips_N: Annotated[list[NonNegative], Field(min_length=1, max_length=MOST_NODES)]
    nrmse: Annotated[list[list[NonNegative]], Field(min_length=1, max_length=MOST_NODES)]

    @property
    def worst(self) -> tuple[float, float, float]:
        """Relative error, speed and grip of the tap with the largest predicted error."""
        values = np.array(self.nrmse)
        j, i = np.unravel_index(int(np.argmax(values)), values.shape)
        return float(values[j, i]), self.speeds_m_s[i], self.grips_N[j]
