"""An answer with its certificate, before the replay."""

from dataclasses import dataclass

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.problem.answer import Certificate, Solution, Status
from transopt.problem.nonlinear import NonlinearProblem
from transopt.problem.problem import TransientProblem
from transopt.proof.effect import Box, Effect, farthest_out

TOLERANCE_dB = 0.01  # accepted error of the energy, below a hundredth of the just noticeable difference


@dataclass(frozen=True)
class Attained:
    """The required energy of the tap, and the energy that was attained.

    Attributes
    ----------
    asked_dB : energy that the scene requires within the window over that of r, both through the error filter.
    energy_dB : energy of the entry, the mean over its devices.
    waveform_dB, waveform_tap_error : energy and tap error of the optimum of J alone.
    price : lam of the entry; 0 if the optimum of J has the required energy.
    most : largest permitted lam.
    problems : number of problems solved, that at lam = 0 included.
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
        """Energy that the entry lacks; 0 within the tolerance."""
        missing = self.asked_dB - self.energy_dB
        return missing if missing > TOLERANCE_dB else 0.0

    @property
    def is_stray(self) -> bool:
        """Whether the energy misses the required one although lam is strictly between 0 and `most`."""
        off = abs(self.energy_dB - self.asked_dB) > TOLERANCE_dB
        return off and 0 < self.price < self.most

    @property
    def sentence(self) -> str:
        """The attained and the required energy, in words."""
        found = f"intensity {self.energy_dB:+.2f} dB of {self.asked_dB:+.2f} dB asked for"
        if self.price == 0 and self.missing_dB == 0:
            return f"{found}: the optimum of the waveform has it"
        nearest = f"{found} at lam {self.price:.4g}; the nearest waveform has {self.waveform_dB:+.2f} dB"
        if self.missing_dB == 0:
            above = self.energy_dB - self.asked_dB
            return (
                nearest
                if above <= TOLERANCE_dB
                else f"{nearest}; no optimum with an energy nearer to that was proven"
            )
        why = (
            f"lam {self.price:.4g} is the last one tried"
            if self.price >= self.most
            else f"beyond lam {self.price:.4g} none was proven"
        )
        return (
            f"{nearest}; {self.missing_dB:.2f} dB are missing, {why}, which does not prove that no command within "
            "the limits has more"
        )


@dataclass(frozen=True)
class Designed:
    """The answer to one problem with its certificate; it has not been replayed.

    Attributes
    ----------
    problem : the problem with all limits of the scene, and with the wall's ticks of the answer. For a nonlinear plant
        it is the problem linearised at rest, with the objective and limits of `nonlinear`.
    solution : command and multipliers.
    certificate : certificate of the answer for `problem`.
    effect : motion under the answer's command, on the nonlinear plant if there is one.
    unlimited_command : (N,) the optimum without limits.
    floor : tap error of that optimum against the problem's target.
    free_peak : its largest plant input [A or V].
    unlimited_objective : its J.
    left_out : part -> why the solved problem does not have it.
    solved : the problem passed to a solver; None where one linear solve was sufficient.
    remarks : why there is no answer.
    attained : required and attained energy; None if the scene requires none.
    nonlinear : the problem on the nonlinear plant; None for a linear one.
    linear : the answer for the plant linearised at rest; None for a linear plant.
    """

    problem: TransientProblem
    solution: Solution
    certificate: Certificate
    effect: Effect
    unlimited_command: FloatArray
    floor: float
    free_peak: float
    unlimited_objective: float
    left_out: dict[str, str]
    solved: TransientProblem | None
    remarks: list[str]
    attained: Attained | None = None
    nonlinear: NonlinearProblem | None = None
    linear: "Designed | None" = None

    __repr__ = brief

    @property
    def is_proven(self) -> bool:
        """Whether it is a certified stationary point; a global bound is not required where the temperature binds."""
        return self.solution.status is Status.OPTIMAL and self.certificate.is_stationary

    @property
    def is_accepted(self) -> bool:
        """Whether it is the certified optimum, or a certified stationary point under a user's own nonlinear limit."""
        return self.is_proven and (self.certificate.accepted or bool(self.problem.own_nonlinear))

    @property
    def missed(self) -> list[Box]:
        """The row farthest out of each limit that the answer leaves by more than its tolerance."""
        rows = [farthest_out(self.effect, limit) for limit in self.problem.limits]
        return [row for row in rows if row.most > row.limit.tolerance]
