"""An answer with its proof: what a problem's solution is worth before anything is played."""

from dataclasses import dataclass

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.problem.answer import Certificate, Solution, Status
from transopt.problem.nonlinear import NonlinearProblem
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import Effect

TOLERANCE_dB = 0.01  # a hundredth of what a hand can tell apart, and more


@dataclass(frozen=True)
class Attained:
    """Energy of the tap that was asked for, and what was found.

    Attributes
    ----------
    asked_dB : energy within the window over that of r, both through the error filter, as the scene asks for it.
    energy_dB : what the entry has, the mean over its devices.
    waveform_dB, waveform_tap_error : what the optimum of J alone has, and its tap error.
    price : lam of the entry; 0 where the optimum of J has what is asked.
    most : the largest lam that was allowed.
    problems : how many were solved for it, that at lam = 0 among them.
    """

    asked_dB: float
    energy_dB: float
    waveform_dB: float
    waveform_tap_error: float
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


@dataclass(frozen=True)
class Designed:
    """The answer to one problem, proven; nothing of it has been replayed.

    Attributes
    ----------
    problem : with every limit of the scene, and the wall pushing where the answer makes it push. If the plant is
        nonlinear it is the problem of the plant at rest, whose objective and limits are those of `nonlinear`.
    certificate : of the answer for that whole problem.
    effect : what the answer's command does in it, on the nonlinear plant where there is one.
    unlimited_command : (N,) the optimum without limits.
    floor : tap error of that optimum against the problem's target.
    free_peak : its largest plant input [A or V].
    left_out : part -> why the problem that was solved does not have it.
    solved : the problem that a program was made of; None where one linear solve was enough.
    remarks : why there is no answer.
    attained : what was found of the energy that was asked for; None where none is.
    nonlinear : the problem on the nonlinear plant; None for a linear one.
    linear : the answer for the plant at rest, beside that for a nonlinear plant.
    """

    problem: TransientProblem
    solution: Solution
    certificate: Certificate
    effect: Effect
    unlimited_command: FloatArray
    floor: float
    free_peak: float
    left_out: dict[str, str]
    solved: TransientProblem | None
    remarks: list[str]
    attained: Attained | None = None
    nonlinear: NonlinearProblem | None = None
    linear: "Designed | None" = None

    __repr__ = brief

    @property
    def is_proven(self) -> bool:
        """Certified, but for the global bound where the temperature binds."""
        return self.solution.status is Status.OPTIMAL and self.certificate.is_stationary
