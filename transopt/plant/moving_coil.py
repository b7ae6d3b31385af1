"""What a coil in a magnet does: a moving mass on a spring and a damper, against the ground or against a case.

With x the displacement of the moving part, of mass m, against what holds it, the ground or a case of mass M, and
F = BL i - k x - c dx/dt the force between them,

    x'' = F / mu,   mu = m M / (m + M), and m where nothing but the ground holds it,
    L di/dt = u - R i - BL dx/dt   where a voltage u is the input.

The acceleration that matters is x'' of the moving part against the ground, or F / M of the case. Both are positive
for a positive input: that of the case is counted in the direction in which F pushes it, against that of x. A voltage
on a coil without inductance sees i = (u - BL dx/dt) / R, which damps the motion.

Struck by a force f from outside on the part whose acceleration that is, its terminals open, the actuator does

    x'' = F / mu + f / m,  and with a case  x'' = F / mu + f / M,  where (F + f) / M is the acceleration of the case.
"""

from abc import abstractmethod
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import model_validator

from transopt.base.section import NonNegative, Positive
from transopt.plant.circuit import Circuit
from transopt.plant.kind import PlantKind
from transopt.plant.state_space import CURRENT_INPUT, POSITION, VELOCITY, VOLTAGE_INPUT, Input, Output, StateSpace

CURRENT = "current"  # of the coil, an output where a voltage drives it through an inductance


class MovingCoil(PlantKind):
    """What the actuators with a moving coil or magnet have in common: the coil, and what drives it."""

    driven_at_tip: ClassVar[bool] = False
    held_by_hand: ClassVar[bool] = False

    input: Literal["current", "voltage"] = "voltage"
    force_factor_N_A: Positive
    R_ohm: Positive | None = None
    L_H: NonNegative = 0.0

    @model_validator(mode="after")
    def _resisted(self) -> Self:
        if self.input == "voltage" and self.R_ohm is None:
            raise ValueError('R_ohm: missing; a voltage drives the coil (input = "voltage")')
        return self

    @property
    def driven_by(self) -> Input:
        return VOLTAGE_INPUT if self.input == "voltage" else CURRENT_INPUT

    @property
    def resistance_in_the_way_ohm(self) -> float | None:
        """Between the input and the coil's current: none where that is the input."""
        return self.R_ohm if self.input == "voltage" else None

    @abstractmethod
    def produced(self, resonance: float, quality: float) -> Self:
        """Another specimen: resonance and quality times these factors, as production spreads them."""

    def circuit(self) -> Circuit | None:
        # The back-EMF per m/s is the force per ampere.
        return None if self.R_ohm is None else Circuit(self.R_ohm, self.L_H, self.force_factor_N_A)


def moving_coil(
    *,
    moving_mass_kg: float,
    case_mass_kg: float | None,
    stiffness_N_m: float,
    damping_N_s_m: float,
    force_factor_N_A: float,
    R_ohm: float | None,
    L_H: float,
    struck: bool = False,
) -> StateSpace:
    """The state space of such an actuator; outputs are "position" x, "velocity" dx/dt and "current" if it is a state.

    Parameters
    ----------
    case_mass_kg : None where the ground holds the coil or the magnet.
    R_ohm : of the coil; None where a current is the input.
    struck : the input is a force on the part whose acceleration it is, the moving one or the case [N] instead.
    """
    reduced_kg = (
        moving_mass_kg if case_mass_kg is None else moving_mass_kg * case_mass_kg / (moving_mass_kg + case_mass_kg)
    )
    accelerated_kg = reduced_kg if case_mass_kg is None else case_mass_kg
    k, c, BL = stiffness_N_m, damping_N_s_m, force_factor_N_A
    by_voltage = R_ohm is not None and not struck
    if by_voltage and L_H > 0:
        # States x, dx/dt, i.
        force = np.array([-k, -c, BL])
        A = np.array([[0.0, 1.0, 0.0], force / reduced_kg, [0.0, -BL / L_H, -(R_ohm or 0.0) / L_H]])
        B, direct = np.array([0.0, 0.0, 1 / L_H]), 0.0
    else:
        gain = 1.0 if struck else BL
        if by_voltage:
            assert R_ohm is not None
            gain, c = BL / R_ohm, c + BL**2 / R_ohm
        force, direct = np.array([-k, -c]), gain
        A = np.array([[0.0, 1.0], force / reduced_kg])
        # A force from outside has no counterpart in the coil: it accelerates one of the two masses only.
        B = np.array([0.0, gain / (accelerated_kg if struck else reduced_kg)])
    n = B.size
    # The nominal motion of a stylus takes a case and the mass in it along: x is what one moves against the other.
    grounded = case_mass_kg is None
    outputs = {
        POSITION: Output(np.eye(1, n, 0), "m", POSITION if grounded else ""),
        VELOCITY: Output(np.eye(1, n, 1), "m/s", VELOCITY if grounded else ""),
        **({CURRENT: Output(np.eye(1, n, 2), "A")} if n > 2 else {}),
    }
    return StateSpace(
        A=A,
        B=B[:, None],
        C=force[None] / accelerated_kg,
        D=np.array([[direct / accelerated_kg]]),
        outputs=outputs,
        driven_by=VOLTAGE_INPUT if by_voltage else CURRENT_INPUT,
    )
