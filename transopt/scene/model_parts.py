"""The parts of a model file: amplifier, device, hand and coil of a haptic device, each identified separately.

`transopt identify` writes these parts one by one, each from its own records, and a scene builds its models on them.
Each part states its values in SI, their uncertainty, a verdict in plain words, and the files it was fitted to.
"""

from abc import abstractmethod
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from transopt.base.errors import InputError
from transopt.base.section import Finite, NonNegative, Positive, Section, Words, increasing
from transopt.base.sizes import MOST_NODES, MOST_STATES
from transopt.plant.chain import Link
from transopt.plant.drive import drive
from transopt.plant.fourth_order import fourth_order
from transopt.plant.hand import HandSection, LinearParameter
from transopt.plant.second_order import second_order
from transopt.plant.state_space import StateSpace, blended_at
from transopt.scene.fitted import FittedPart, ModelPart
from transopt.scene.model_error import ModelError, Predicted

MODEL_PARTS = ("amplifier", "device", "hand", "coil")
ModelPartName = Literal["amplifier", "device", "hand", "coil"]
OUTSIDE = 0.1  # share by which a grip may lie outside the recorded range

Matrix = Annotated[list[list[Finite]], Field(min_length=1, max_length=MOST_STATES)]


class AmplifierPart(FittedPart):
    """Current amplifier: one pole and a pure delay.

    Attributes
    ----------
    pole_Hz : frequency of -3 dB.
    delay_s : delay in addition to that of the hold, which is half a servo period.
    delay_with_hold_s : both delays together.
    gain : current over command at low frequency.
    """

    pole_Hz: Positive
    delay_s: NonNegative
    delay_with_hold_s: NonNegative
    gain: Positive


class ChainHand(HandSection):
    """Skin and arm of the `drive` chain, each parameter with its constant and its slope over grip."""

    mass_kg: LinearParameter
    skin_stiffness_N_m: LinearParameter
    skin_damping_N_s_m: LinearParameter
    arm_stiffness_N_m: LinearParameter
    arm_damping_N_s_m: LinearParameter


Grips = Annotated[list[NonNegative], Field(min_length=1, max_length=MOST_NODES)]
NrmseByGrip = dict[str, NonNegative]


def _of_grips(nrmse: NrmseByGrip) -> NrmseByGrip:
    for name in nrmse:
        try:
            grip_N = float(name)
        except ValueError:
            grip_N = np.nan
        if not 0 <= grip_N < np.inf:
            raise ValueError(f"{name!r} is not a grip in newton")
    return nrmse


def check_grip(grips_N: list[float], grip_N: float) -> None:
    """Refuse a grip outside the recorded range, where no model is known."""
    held = [grip for grip in grips_N if grip > 0]
    if grip_N == 0:
        if grips_N[0] > 0:
            raise InputError("the model file has no free device: record one at grip 0 and identify with it")
        return
    if not held:
        raise InputError("the model file has only the free device: record held grips and identify with them")
    lowest, highest = held[0], held[-1]
    if not lowest * (1 - OUTSIDE) <= grip_N * (1 + 1e-12) or not grip_N <= highest * (1 + OUTSIDE) * (1 + 1e-12):
        raise InputError(
            f"outside the recorded grips of the model file, {lowest:.3g} to {highest:.3g} N (and {OUTSIDE:.0%} "
            "beyond): record there and identify again, or keep grid.grips_N (and robust.grip_spread) inside"
        )


class RecordedDevice(ModelPart):
    """Common fields of all kinds of identified device.

    Attributes
    ----------
    grips_N : (ng,) recorded grips, increasing; 0 for the free device.
    nrmse : grip -> held-out error on trials outside the fit, their noise included.
    error : error of its response; None in files of older versions.
    predicted : predicted errors of the taps of the scene it was identified for; None without a scene.
    causes : effects found in the records that the model does not describe, by name.
    """

    grips_N: Grips
    nrmse: NrmseByGrip
    error: ModelError | None = None
    predicted: Predicted | None = None
    causes: list[Words] = Field(default_factory=list)

    _grips_ordered = field_validator("grips_N")(increasing)
    _nrmse_by_grip = field_validator("nrmse")(_of_grips)

    def error_at(self, grip_N: float) -> float:
        """Held-out error at a grip, linear between the validated grips; NaN without validation."""
        by_grip = sorted((float(name), value) for name, value in self.nrmse.items())
        if grip_N > 0:
            by_grip = [(grip, value) for grip, value in by_grip if grip > 0] or by_grip
        if not by_grip:
            return np.nan
        return float(np.interp(grip_N, [grip for grip, _ in by_grip], [value for _, value in by_grip]))


def _check_passive(part: "DriveDevice | _HeldHand") -> None:
    """Check that a part is passive at every recorded grip."""
    for grip_N in part.grips_N:
        try:
            part.plant(grip_N)
        except InputError as error:
            raise ValueError(f"at {grip_N:g} N: {error}") from None


class DriveDevice(RecordedDevice, FittedPart):
    """The `drive` chain: device parameters shared by all grips, those of the hand linear in grip.

    Attributes
    ----------
    kind : "drive".
    force_per_current_N_A : known, not fitted, since the response does not change if it and all masses, stiffnesses
        and dampings are scaled by one factor.
    moving_mass_kg : effective mass of the motor at the tip.
    stylus_mass_kg : mass of the stylus.
    transmission_stiffness_N_m : spring between motor and stylus.
    transmission_damping_N_s_m : damper between motor and stylus.
    hand : skin, hand mass and arm.
    """

    kind: Literal["drive"]
    force_per_current_N_A: Positive
    moving_mass_kg: Positive
    stylus_mass_kg: Positive
    transmission_stiffness_N_m: Positive
    transmission_damping_N_s_m: NonNegative
    hand: ChainHand

    @model_validator(mode="after")
    def _passive(self) -> Self:
        _check_passive(self)
        return self

    def plant(self, grip_N: float, *, struck: bool = False) -> StateSpace:
        """The model from motor current, or with `struck` from a force on the stylus [N], to stylus acceleration.

        Raises
        ------
        InputError : a grip that was not recorded, or parameters that are not passive there.
        """
        check_grip(self.grips_N, grip_N)
        return drive(
            grip_N,
            hand=self.hand,
            stylus_mass_kg=self.stylus_mass_kg,
            moving_mass_kg=self.moving_mass_kg,
            transmission=Link(self.transmission_stiffness_N_m, self.transmission_damping_N_s_m),
            force_per_current_N_A=1.0 if struck else self.force_per_current_N_A,
            driven=1 if struck else 0,
        )


class StateSpaceDevice(RecordedDevice):
    """A black box: one continuous-time state space per grip, from current [A] to stylus acceleration [m/s^2].

    Attributes
    ----------
    kind : "state_space".
    order : n, number of states.
    A : (ng, n, n), stable.
    B : (ng, n, 1).
    C : (ng, 1, n).
    D : (ng, 1, 1).
    """

    kind: Literal["state_space"]
    order: Annotated[int, Field(ge=1, le=MOST_STATES // 2)]
    A: Annotated[list[Matrix], Field(min_length=1)]
    B: Annotated[list[Matrix], Field(min_length=1)]
    C: Annotated[list[Matrix], Field(min_length=1)]
    D: Annotated[list[Matrix], Field(min_length=1)]

    @model_validator(mode="after")
    def _stable(self) -> Self:
        n, ng = self.order, len(self.grips_N)
        for name, rows, columns in (("A", n, n), ("B", n, 1), ("C", 1, n), ("D", 1, 1)):
            matrices = getattr(self, name)
            if len(matrices) != ng:
                raise ValueError(f"{name}: {len(matrices)} matrices for {ng} grips")
            for grip_N, matrix in zip(self.grips_N, matrices, strict=True):
                if len(matrix) != rows or any(len(row) != columns for row in matrix):
                    raise ValueError(f"{name} at {grip_N:g} N: must be {rows} by {columns} at order = {n}")
        for grip_N, matrix in zip(self.grips_N, self.A, strict=True):
            worst = float(np.linalg.eigvals(np.array(matrix)).real.max())
            if worst >= 0:
                raise ValueError(f"A at {grip_N:g} N: not stable, a pole at {worst:g} 1/s")
        return self

    def node(self, j: int) -> StateSpace:
        """The model of the recorded grip j; a black box has no position output."""
        A, B, C, D = (np.array(getattr(self, name)[j]) for name in "ABCD")
        return StateSpace(A, B, C, D)

    def plant(self, grip_N: float) -> StateSpace:
        """The model from motor current to stylus acceleration, blended linearly between recorded grips.

        Its order is 2 n where there are at least two held grips, also at a recorded one, so that all grips have the
        same order.

        Raises
        ------
        InputError : a grip that was not recorded.
        """
        check_grip(self.grips_N, grip_N)
        return blended_at(self.grips_N, [self.node(j) for j in range(len(self.grips_N))], grip_N)


class _HeldHand(FittedPart):
    """Common part of a hand that was identified on its own.

    Attributes
    ----------
    grips_N : recorded grips.
    """

    grips_N: Grips

    _grips_ordered = field_validator("grips_N")(increasing)

    @model_validator(mode="after")
    def _passive(self) -> Self:
        if self.grips_N[0] == 0:
            raise ValueError("grips_N: a hand that does not hold the stylus cannot be identified at 0 N")
        _check_passive(self)
        return self

    @abstractmethod
    def plant(self, grip_N: float, *, force_per_current_N_A: float = 1.0) -> StateSpace:
        """The model from motor current, or by default from a force [N], to stylus acceleration.

        Raises
        ------
        InputError : a grip that was not recorded, or parameters that are not passive there.
        """


class SecondOrderHand(_HeldHand):
    """The whole hand as one mass, spring and damper, linear in grip (seed Fig. 4a, Eqs. 3-5).

    Attributes
    ----------
    kind : "second_order".
    mass_kg : mass of stylus and hand.
    damping_N_s_m : damper to the hand's intended motion.
    stiffness_N_m : spring to the hand's intended motion.
    grips_N : recorded grips.
    """

    kind: Literal["second_order"]
    mass_kg: LinearParameter
    damping_N_s_m: LinearParameter
    stiffness_N_m: LinearParameter

    def plant(self, grip_N: float, *, force_per_current_N_A: float = 1.0) -> StateSpace:
        check_grip(self.grips_N, grip_N)
        return second_order(
            grip_N,
            force_per_current_N_A=force_per_current_N_A,
            mass_kg=self.mass_kg.linear(),
            damping_N_s_m=self.damping_N_s_m.linear(),
            stiffness_N_m=self.stiffness_N_m.linear(),
        )


class FourthOrderHand(_HeldHand):
    """Stylus - skin - hand mass - arm, the hand linear in grip (seed Fig. 4b).

    Attributes
    ----------
    kind : "fourth_order".
    stylus_mass_kg : mass of the stylus and of all that moves rigidly with it, a motor included.
    hand : skin, hand mass and arm.
    grips_N : recorded grips.
    """

    kind: Literal["fourth_order"]
    stylus_mass_kg: Positive
    hand: ChainHand

    def plant(self, grip_N: float, *, force_per_current_N_A: float = 1.0) -> StateSpace:
        check_grip(self.grips_N, grip_N)
        return fourth_order(
            grip_N,
            hand=self.hand,
            stylus_mass_kg=self.stylus_mass_kg,
            moving_mass_kg=0.0,
            force_per_current_N_A=force_per_current_N_A,
        )


class CoilPart(FittedPart):
    """Thermal resistances and time constants of winding and housing, and the resistance that makes the heat.

    Attributes
    ----------
    R_wh_K_W : thermal resistance from winding to housing.
    R_ha_K_W : thermal resistance from housing to ambient.
    tau_w_s : time constant of the winding.
    tau_h_s : time constant of the housing.
    R_ohm : resistance of the winding at 25 C; None in files of older versions, which leave it to the motor's.
    """

    R_wh_K_W: Positive
    R_ha_K_W: Positive
    tau_w_s: Positive
    tau_h_s: Positive
    R_ohm: Positive | None = None


DevicePart = Annotated[DriveDevice | StateSpaceDevice, Field(discriminator="kind")]
HandPart = Annotated[SecondOrderHand | FourthOrderHand, Field(discriminator="kind")]
AnyModelPart = AmplifierPart | DriveDevice | StateSpaceDevice | SecondOrderHand | FourthOrderHand | CoilPart


class ModelParts(Section):
    """The identified parts of a device; None for a part that was not identified.

    Attributes
    ----------
    amplifier : model from command to current.
    device : model from current to acceleration.
    hand : hand that holds the stylus.
    coil : thermal model of the coil.
    """

    amplifier: AmplifierPart | None = None
    device: DevicePart | None = None
    hand: HandPart | None = None
    coil: CoilPart | None = None

    @property
    def uncounted(self) -> str:
        """What the device's verdict does not count, and what to do; empty if nothing, or if there is no device."""
        if self.device is None or self.amplifier is not None:
            return ""
        return (
            "not counted: the amplifier, which is the scene's and not identified; what it is off by comes on top: "
            "identify it (transopt identify amplifier), then the device again"
        )
