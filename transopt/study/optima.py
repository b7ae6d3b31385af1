"""Optima at any speed and grip of a scene, for studies of libraries between their nodes."""

from collections.abc import Sequence
from dataclasses import dataclass

from transopt.design.context import Context
from transopt.design.refine_grid import Errors
from transopt.problem.answer import Certificate, Status
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.solvers.options import SolverOptions
from transopt.study.rows import ADMITTED


def errors_of(scene: Scene) -> Errors:
    """Optima, blends and replays at any speed and grip of a scene with simulated recordings."""
    return Errors(Context.recorded(scene, recordings(scene)), SolverOptions())


@dataclass(frozen=True)
class Proven:
    """One optimum that a study rests on, with its certificate.

    Attributes
    ----------
    device : name of the device it was solved for.
    status : name of a `Status`.
    relative_gap, relative_bound : duality gap and global bound over max(J, 1e-3).
    violation_A, violation_V, violation_K : largest excess over a limit, by unit.
    """

    device: str
    speed_m_s: float
    grip_N: float
    status: str
    relative_gap: float
    relative_bound: float
    violation_A: float
    violation_V: float
    violation_K: float

    @classmethod
    def of(cls, device: str, place: tuple[float, float], status: Status, proof: Certificate) -> "Proven":
        """An optimum at a speed and a grip."""
        violations = [proof.violation(unit) for unit in ("A", "V", "K")]
        return cls(device, *place, status.name, proof.relative_gap, proof.relative_bound, *violations)


def proven(device: str, errors: Errors) -> list[Proven]:
    """Every optimum solved so far."""
    return [Proven.of(device, point, *proof) for point, proof in sorted(errors.proofs.items())]


def proven_sentence(optima: Sequence[Proven]) -> str:
    """Number of optima, number of certified ones, and their worst gap."""
    certified = [one for one in optima if one.status in ADMITTED]
    worst = max((one.relative_gap for one in certified), default=float("nan"))
    return f"{len(certified)} of {len(optima)} optima certified (rows.csv), worst gap {worst:.0e}"
