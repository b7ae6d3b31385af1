"""Moving-coil actuators: a mass on a spring and a damper, relative to the ground or to a case.

Let x be the displacement of the moving part of mass m relative to its support, the ground or a case of mass M, and
F = BL i - k x - c dx/dt the force between them. Then

    x'' = F / mu,   mu = m M / (m + M) with a case, mu = m on the ground,
    L di/dt = u - R i - BL dx/dt   if a voltage u is the input.

The tracked acceleration is x'' of the moving part on the ground, or F / M of the case. Both are positive for a
positive input: the case's is counted in the direction in which F pushes it, opposite to x. With a voltage input and
no inductance i = (u - BL dx/dt) / R, which damps the motion. Outputs: "position" x and "velocity" dx/dt, and
"current" if a voltage drives a coil with an inductance.

If an external force f strikes the part whose acceleration is tracked, with open terminals,

    x'' = F / mu + f / m on the ground;  x'' = F / mu + f / M with a case, whose acceleration is (F + f) / M.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import model_validator

from transopt.base.arithmetic import Formula
from transopt.base.errors import InputError
from transopt.base.section import NonNegative, Positive
from transopt.plant.coil import Circuit
from transopt.plant.kind import PlantKind
from transopt.plant.motor import Tip, Winding
from transopt.plant.nonlinear import VARIABLES, Nonlinear, NonlinearCoil
from transopt.plant.state_space import CURRENT_INPUT, POSITION, VELOCITY, VOLTAGE_INPUT, Input, Output, StateSpace

CURRENT = "current"  # output of the coil's current, where a voltage drives it through an inductance


@dataclass(frozen=True)
class Mechanics:
    """The mechanical part of a moving-coil actuator.

    Attributes
    ----------
    moving_mass_kg : m.
    case_mass_kg : M; None where the support is the ground.
    stiffness_N_m, damping_N_s_m : k and c of the suspension.
    """

    moving_mass_kg: float
    case_mass_kg: float | None
    stiffness_N_m: float
    damping_N_s_m: float

    @property
    def reduced_kg(self) -> float:
        """mu, the reduced mass for the relative motion."""
        m, M = self.moving_mass_kg, self.case_mass_kg
        return m if M is None else m * M / (m + M)

    @property
    def accelerated_kg(self) -> float:
        """Mass whose acceleration is tracked: the case's, or the moving one on the ground."""
        return self.moving_mass_kg if self.case_mass_kg is None else self.case_mass_kg


class MovingCoil(PlantKind):
    """Common part of the actuators with a moving coil or magnet: coil and driver.

    Attributes
    ----------
    input : quantity that the driver sets, a current or a voltage.
    force_factor_N_A : BL: force per ampere, and back-EMF per m/s.
    R_ohm : resistance of the coil, required for a voltage input.
    L_H : inductance of the coil; with 0 the current follows the voltage without lag.
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
        """Masses and suspension."""

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
        """Resistance between a voltage input and the coil's current; None for a current input."""
        return self.R_ohm if self.input == "voltage" else None

    @abstractmethod
    def produced(self, resonance: float, quality: float) -> Self:
        """Another specimen from production, with resonance and quality multiplied by these factors."""

    def circuit(self) -> Circuit | None:
        # In SI the back-EMF per m/s equals the force per ampere.
        return None if self.R_ohm is None else Circuit(self.R_ohm, self.L_H, self.force_factor_N_A)


def moving_coil(
    held: Mechanics,
    *,
    force_factor_N_A: float,
    R_ohm: float | None,
    L_H: float,
    struck: bool = False,
) -> StateSpace:
    """The state space of a moving-coil actuator; outputs "position" x, "velocity" dx/dt and, if a state, "current".

    Parameters
    ----------
    R_ohm : resistance of the coil; None for a current input.
    struck : whether the input is an external force on the part whose acceleration is tracked [N].
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
        # An external force accelerates one of the two masses only; the coil's force acts between them.
        B = np.array([0.0, gain / (accelerated_kg if struck else reduced_kg)])
    n = B.size
    # The nominal motion carries a case and its mass along, so it adds nothing to their relative displacement x.
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


class Inertial(MovingCoil):
    """A mass on a spring that shakes its case, such as an LRA, by f0, Q, moving mass, force factor, R and L.

    f0 and Q are those of the mounted actuator with open terminals: k = mu (2 pi f0)^2 and c = mu 2 pi f0 / Q.
    Datasheets state them on a jig of some 100 g, which is then the case.

    Attributes
    ----------
    resonance_Hz : f0 with open terminals, in the stated case.
    quality : mechanical Q with open terminals.
    moving_mass_kg : mass that moves inside the case.
    case_mass_kg : mass of the case and of what is mounted on it, which shall shake.
    """

    kind: Literal["inertial"]
    resonance_Hz: Positive
    quality: Positive
    moving_mass_kg: Positive
    case_mass_kg: Positive

    def produced(self, resonance: float, quality: float) -> Self:
        return self.model_copy(
            update={"resonance_Hz": resonance * self.resonance_Hz, "quality": quality * self.quality}
        )

    @property
    def mechanics(self) -> Mechanics:
        w = 2 * np.pi * self.resonance_Hz
        reduced_kg = self.moving_mass_kg * self.case_mass_kg / (self.moving_mass_kg + self.case_mass_kg)
        return Mechanics(self.moving_mass_kg, self.case_mass_kg, reduced_kg * w**2, reduced_kg * w / self.quality)


class VoiceCoil(MovingCoil):
    """A coil in a magnet, by moving mass, suspension, force factor BL, R and L; in a case if one is stated.

    The coil's temperature is modelled if `winding` is stated and the input is a current.

    Attributes
    ----------
    moving_mass_kg : mass that moves relative to the ground or the case.
    case_mass_kg : mass of the case, which shall shake; without it the support is the ground.
    stiffness_N_m : spring of the suspension.
    damping_N_s_m : damper of the suspension.
    winding : table of the coil's thermal data.
    """

    kind: Literal["voice_coil"]
    moving_mass_kg: Positive
    case_mass_kg: Positive | None = None
    stiffness_N_m: NonNegative = 0.0
    damping_N_s_m: NonNegative
    winding: Winding | None = None

    @property
    def known_winding(self) -> Winding | None:
        return self.winding

    def produced(self, resonance: float, quality: float) -> Self:
        # w0^2 = k / mu, Q = sqrt(k mu) / c.
        return self.model_copy(
            update={
                "stiffness_N_m": resonance**2 * self.stiffness_N_m,
                "damping_N_s_m": resonance / quality * self.damping_N_s_m,
            }
        )

    @property
    def mechanics(self) -> Mechanics:
        return Mechanics(self.moving_mass_kg, self.case_mass_kg, self.stiffness_N_m, self.damping_N_s_m)
