"""Options of a solver that a user may set."""

from dataclasses import dataclass, field
from typing import ClassVar

from transopt.base.errors import InputError
from transopt.problem.objective.target import Target
from transopt.solvers.native import extension

FALLBACK = "casadi-piqp"
LEAST_TIME_S, TIME_PER_STAGE_S = 4.0, 2e-3  # processor time; a solve normally takes tenths of a second


def most_time_s(stages: int) -> float:
    """Time limit [s] of a solver from a library (IPOPT or PIQP)."""
    return LEAST_TIME_S + TIME_PER_STAGE_S * stages


def default_solver() -> str:
    """The project's own method, or the fallback where its extension is missing or of another version."""
    return "riccati" if extension.available else FALLBACK


@dataclass(frozen=True)
class SolverOptions:
    """Attributes
    ----------
    solver : name, the same in files, on the command line and in reports.
    tolerance : absolute tolerance on residuals and gap, in units's objective scale of 1e-3 and of
        the limit current. The default leaves three digits to the certificate's tolerance.
    max_iterations : at least 1.
    brief : whether only this solver is tried, and no reason is searched for if it fails.
    """

    brief: ClassVar[bool] = False

    solver: str = field(default_factory=default_solver)
    tolerance: float = 1e-10
    max_iterations: int = 250

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1:
            raise InputError(f"--solver-tolerance {self.tolerance:g}: must be between 0 and 1; 1e-10 is usual")
        if self.max_iterations < 1:
            raise InputError(f"max_iterations = {self.max_iterations}: must be at least 1")


@dataclass(frozen=True)
class TrialOptions(SolverOptions):
    """Options of a trial: if the solver fails, no other solver is tried and no reason is searched for.

    Attributes
    ----------
    spans : for each target, limit on the input -> stages up to which limits bound in the last trial with it; the next
        search begins there. Solvers write it; it changes the time of a trial, and its answer by less than the
        tolerance.
    """

    brief: ClassVar[bool] = True

    spans: dict[int, tuple[Target, dict[float, int]]] = field(default_factory=dict, compare=False, repr=False)
