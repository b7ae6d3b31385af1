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
from dataclasses import dataclass
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import model_validator

from transopt.base.arithmetic import Formula
from transopt.base.errors import InputError
from transopt.base.section import NonNegative, Positive
from transopt.plant.circuit import Circuit
from transopt.plant.kind import PlantKind
from transopt.plant.motor import Tip
from transopt.plant.nonlinear import VARIABLES, Nonlinear, NonlinearCoil
from transopt.plant.state_space import CURRENT_INPUT, POSITION, VELOCITY, VOLTAGE_INPUT, Input, Output, StateSpace

CURRENT = "current"  # of the coil, an output where a voltage drives it through an inductance


@dataclass(frozen=True)
class Mechanics:
    """What moves, and what holds it.

    Attributes
    ----------
    case_mass_kg : None where the ground holds the coil or the magnet.
    """

    moving_mass_kg: float
    case_mass_kg: float | None
    stiffness_N_m: float
    damping_N_s_m: float

    @property
    def reduced_kg(self) -> float:
        """mu, what the force between the two accelerates them against each other by."""
        m, M = self.moving_mass_kg, self.case_mass_kg
        return m if M is None else m * M / (m + M)

    @property
    def accelerated_kg(self) -> float:
        """What the acceleration that matters is of."""
        return self.moving_mass_kg if self.case_mass_kg is None else self.case_mass_kg


class MovingCoil(PlantKind):
    """What the actuators with a moving coil or magnet have in common: the coil, and what drives it.

    Attributes
    ----------
    input : what the driver sets.
    force_factor_N_A : BL: force per ampere, and back-EMF per m/s.
    R_ohm : resistance of the coil, which a voltage needs.
    L_H : inductance of the coil; at 0 the current follows the voltage at once.
    nonlinear : table of formulas in place of constants.
    """

    driven_at_tip: ClassVar[bool] = False
    held_by_hand: ClassVar[bool] = False

    input: Literal["current", "voltage"] = "voltage"
    force_factor_N_A: Positive
    R_ohm: Positive | None = None
    L_H: NonNegative = 0.0
    nonlinear: Nonlinear | None = None

    @model_validator(mode="after")
    def _resisted(self) -> Self:
        if self.input == "voltage" and self.R_ohm is None:
            raise ValueError('R_ohm: missing; a voltage drives the coil (input = "voltage")')
        return self

    @property
    @abstractmethod
    def mechanics(self) -> Mechanics:
        """What moves, and what holds it."""

    def plant(self, grip_N: float, tip: Tip | None, *, struck: bool = False) -> StateSpace:
        return moving_coil(
            self.mechanics,
            force_factor_N_A=self.force_factor_N_A,
            R_ohm=self.resistance_in_the_way_ohm,
            L_H=self.L_H,
            struck=struck,
        )

    def nonlinear_plant(self) -> NonlinearCoil | None:
        """The plant with the formulas of `nonlinear`; None without them.

        Raises
        ------
        InputError : formulas that contradict the linear model at rest.
        """
        if self.nonlinear is None:
            return None
        held = self.mechanics
        constants = (("BL", self.force_factor_N_A), ("K", held.stiffness_N_m), ("C", held.damping_N_s_m))
        formulas = {
            key: None if text is None else Formula(text, VARIABLES, constants)
            for key, text in self.nonlinear.model_dump().items()
        }
        return NonlinearCoil(
            linear=self.plant(0.0, None),
            moved_kg=held.reduced_kg,
            accelerated_kg=held.accelerated_kg,
            force_factor_N_A=self.force_factor_N_A,
            stiffness_N_m=held.stiffness_N_m,
            damping_N_s_m=held.damping_N_s_m,
            R_ohm=self.resistance_in_the_way_ohm,
            L_H=self.L_H,
            **formulas,
        )

    @model_validator(mode="after")
    def _linear_at_rest(self) -> Self:
        try:
            self.nonlinear_plant()
        except InputError as error:
            raise ValueError(str(error).removeprefix("model.")) from None
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
    held: Mechanics,
    *,
    force_factor_N_A: float,
    R_ohm: float | None,
    L_H: float,
    struck: bool = False,
) -> StateSpace:
    """The state space of such an actuator; outputs are "position" x, "velocity" dx/dt and "current" if it is a state.

    Parameters
    ----------
    R_ohm : of the coil; None where a current is the input.
    struck : the input is a force on the part whose acceleration it is, the moving one or the case [N] instead.
    """
    reduced_kg, accelerated_kg = held.reduced_kg, held.accelerated_kg
    k, c, BL = held.stiffness_N_m, held.damping_N_s_m, force_factor_N_A
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
    grounded = held.case_mass_kg is None
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
