"""The differential equation that a replay integrates: plant and amplifiers under commands that are held.

It shares the plant's continuous-time matrices with the design model, and none of that model's discrete ones.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.matrices import balanced
from transopt.base.signals import FloatArray
from transopt.plant.discretise import StageModel


@dataclass(frozen=True)
class Flow:
    """Plant and amplifiers in balanced units: dx/dt = A x + B c, with p directions and m motors.

    The currents are the last states, unless the amplifier is ideal and the currents are the commands c themselves.

    Attributes
    ----------
    A : (n, n).
    B : (n, m).
    rows : (R, n) rows over the states, R = p + 2 m + further: y'', the currents, the velocities of the motor masses
        and the further outputs of the stage model.
    direct : (R, m) their direct dependence on the commands that act.
    names : names of the further outputs.
    encoder : (n,) row over the states of the motor mass's position.
    tracked : number of directions p.
    """

    A: FloatArray
    B: FloatArray
    rows: FloatArray
    direct: FloatArray
    names: tuple[str, ...]
    encoder: FloatArray
    tracked: int

    @cached_property
    def fastest_rad_s(self) -> float:
        """Largest |eigenvalue| of A."""
        return float(np.abs(np.linalg.eigvals(self.A)).max())

    @classmethod
    def of(cls, stage: StageModel) -> "Flow":
        """The flow of a stage model's continuous-time plant and amplifier; its discrete matrices are not used."""
        plant, amplifier = stage.plant, stage.amplifier
        (n, m), p = plant.B.shape, plant.tracked
        further = {name: plant.output(name).row[0] for name in stage.outputs}
        moved = np.stack([*plant.Cv, *further.values()])
        if amplifier is None:
            A, B = plant.A, plant.B
            rows, direct = np.zeros((p + m + len(moved), n)), np.zeros((p + m + len(moved), m))
            rows[:p], direct[:p], direct[p : p + m] = plant.C, plant.D, np.eye(m)
        else:
            w = amplifier.rate_rad_s * np.eye(m)
            A, B = np.block([[plant.A, plant.B], [np.zeros((m, n)), -w]]), np.concatenate([np.zeros((n, m)), w])
            rows, direct = np.zeros((p + m + len(moved), n + m)), np.zeros((p + m + len(moved), m))
            rows[:p], rows[p : p + m, n:] = np.hstack([plant.C, plant.D]), np.eye(m)
        rows[p + m :, :n] = moved
        # Balanced units (exact powers of two) keep small states above the rounding errors of large ones.
        even, units = balanced(A)
        encoder = np.append(plant.Ce[0], np.zeros(A.shape[0] - n))
        return cls(even, B / units[:, None], rows * units, direct, tuple(further), encoder * units, p)
