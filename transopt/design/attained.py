"""What an entry attains that was asked for an intensity."""

from dataclasses import dataclass

TOLERANCE_dB = 0.01  # a hundredth of what a hand can tell apart, and more


@dataclass(frozen=True)
class Attained:
    """Energy of the tap that was asked for, and what was found.

    Attributes
    ----------
    asked_dB : energy within the window over that of r, both through the error filter, as the scene asks for it.
    energy_dB : what the entry has, the mean over its devices.
    waveform_dB, waveform_nrmse : what the optimum of J alone has, and its NRMSE.
    price : lam of the entry; 0 where the optimum of J has what is asked.
    most : the largest lam that was allowed.
    problems : how many were solved for it, that at lam = 0 among them.
    """

    asked_dB: float
    energy_dB: float
    waveform_dB: float
    waveform_nrmse: float
    price: float
    most: float
    problems: int

    @property
    def missing_dB(self) -> float:
        """How much less than asked the entry has; 0 within the tolerance."""
        missing = self.asked_dB - self.energy_dB
        return missing if missing > TOLERANCE_dB else 0.0

    @property
    def is_stray(self) -> bool:
        """Whether the energy is off what was asked for, though lam was neither at its least nor at its most."""
        off = abs(self.energy_dB - self.asked_dB) > TOLERANCE_dB
        return off and 0 < self.price < self.most

    @property
    def sentence(self) -> str:
        """What the entry is worth as an answer to what was asked."""
        found = f"intensity {self.energy_dB:+.2f} dB of {self.asked_dB:+.2f} dB asked for"
        if self.price == 0 and self.missing_dB == 0:
            return f"{found}: the optimum of the waveform has it"
        nearest = f"{found} at lam {self.price:.4g}; the nearest waveform has {self.waveform_dB:+.2f} dB"
        if self.missing_dB == 0:
            above = self.energy_dB - self.asked_dB
            return (
                nearest
                if above <= TOLERANCE_dB
                else f"{nearest}; at no lam nearer to what was asked was a proof found"
            )
        why = (
            f"lam {self.price:.4g} is the last one tried"
            if self.price >= self.most
            else f"beyond lam {self.price:.4g} none was proven"
        )
        return (
            f"{nearest}; {self.missing_dB:.2f} dB are missing, {why}, which is no proof that no command within the "
            "limits has more"
        )
