"""A scene's model where it comes from a model file, and other devices that the uncertainty of the fit allows."""

from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.motor import Tip
from transopt.plant.state_space import CURRENT_INPUT, Input, StateSpace
from transopt.scene.fitted import FittedPart, ModelPart
from transopt.scene.model_error import ModelError
from transopt.scene.model_parts import (
    DriveDevice,
    FourthOrderHand,
    ModelParts,
    SecondOrderHand,
    StateSpaceDevice,
    check_grip,
)

SEED = 7  # of the draws, always the same, so that a library can be made again
TRIES = 200  # for one draw or pair of draws
TAP_HZ = 5.0, 600.0  # where a tap has its energy
BANDS = 24  # of that range, of an error that only the covariance of a fit tells
SMALL = 1e-4  # relative change of a parameter by which responses are differentiated

Chain = DriveDevice | SecondOrderHand | FourthOrderHand
"""What has masses, springs and dampers that were fitted, with their covariance."""


class IdentifiedModel(ModelParts):
    """The content of a model file (`model = "MODEL.json"`), so that a library needs the file no more."""

    kind: Literal["identified"]
    file: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]

    @model_validator(mode="after")
    def _moves_something(self) -> Self:
        if self.device is None and self.hand is None:
            raise ValueError(
                f"{self.file}: has neither a device nor a hand part, so nothing that moves: run `transopt identify "
                "device` into it"
            )
        return self

    @property
    def moving(self) -> DriveDevice | StateSpaceDevice | SecondOrderHand | FourthOrderHand:
        """What a current moves: the device, or where only a hand was identified, that as a whole."""
        part = self.hand if self.device is None else self.device
        assert part is not None
        return part

    def unfit(self, *, coil: bool) -> dict[str, list[str]]:
        """Why the parts that a design takes are not fit to design with, by part; empty where all are.

        Parameters
        ----------
        coil : whether the design has a motor, and with it a coil that gets warm.
        """
        moving = "device" if self.device is not None else "hand"
        used: dict[str, ModelPart | None] = {"amplifier": self.amplifier, moving: self.moving}
        used["coil"] = self.coil if coil else None
        return {name: part.shortfalls for name, part in used.items() if part is not None and part.shortfalls}

    @property
    def is_chain(self) -> bool:
        """Whether its states are the elongations of a chain of masses, then their velocities."""
        return not isinstance(self.moving, StateSpaceDevice)

    def tip(self) -> Tip | None:
        """The drive at the tip; None where the file has no drive chain."""
        device = self.device
        if not isinstance(device, DriveDevice):
            return None
        return Tip(
            force_per_current_N_A=device.force_per_current_N_A,
            moving_mass_kg=device.moving_mass_kg,
            stiffness_N_m=device.transmission_stiffness_N_m,
            damping_N_s_m=device.transmission_damping_N_s_m,
        )

    def check_grip(self, grip_N: float) -> None:
        """
        Raises
        ------
        InputError : a grip that was not recorded.
        """
        check_grip(self.moving.grips_N, grip_N)

    def error_of(
        self,
        grip_N: float,
        current_A: FloatArray,
        dt_s: float,
        energy: float,
        *,
        force_per_current_N_A: float | None = None,
    ) -> float:
        """Relative error between a tap as the model predicts it and as the device does it; NaN where it is unknown.

        A file that states no spectrum of its error has the held-out error of the grip, noise included. A hand on its
        own has what the covariance of its fit makes of the tap.

        Parameters
        ----------
        current_A : (N,) of the tap, sampled every `dt_s`.
        energy : sum of the squares of its N samples of acceleration [(m/s^2)^2].
        force_per_current_N_A : of the scene, for a file with a hand only.
        """
        if self.device is None:
            assert force_per_current_N_A is not None
            return self._hand_error.nrmse(grip_N, force_per_current_N_A * current_A, dt_s, energy)
        if self.device.error is None:
            return self.device.error_at(grip_N)
        return self.device.error.nrmse(grip_N, current_A, dt_s, energy)

    @property
    def driven_by(self) -> Input:
        """What its input is: models are identified from currents."""
        return CURRENT_INPUT

    def plant(self, grip_N: float, force_per_current_N_A: float | None, *, struck: bool = False) -> StateSpace:
        """Motor current, or with `struck` a force on the stylus [N], to stylus acceleration.

        The force per current is the scene's where the model file has a hand only.

        Raises
        ------
        InputError : a grip that was not recorded, parameters that are not passive there, a black box that is struck.
        """
        match self.moving:
            case DriveDevice() as device:
                return device.plant(grip_N, struck=struck)
            case StateSpaceDevice() as device:
                if struck:
                    raise InputError(
                        f"{self.file}: a state space from the motor's current has no stylus to strike with"
                    )
                return device.plant(grip_N)
            case SecondOrderHand() | FourthOrderHand() as hand:
                assert force_per_current_N_A is not None
                return hand.plant(grip_N, force_per_current_N_A=1.0 if struck else force_per_current_N_A)

    def drawn(self, samples: int, grips_N: Sequence[float]) -> list[Self]:
        """Models with parameters drawn around those of the fit, passive at all recorded and given grips.

        Their errors have the shape of the fit's covariance and the size of the file's own verdict: where the records
        show more error than the covariance explains (a structure that the model lacks, friction at the amplitude of
        use), they are that much larger (`stretch`). Seeded; in pairs of opposite errors, so that the mean over the
        spread is the identified model (an odd last one stands alone). One draw is one device: it has the same
        parameters at every grip.

        Raises
        ------
        InputError : a model without covariance, or so uncertain that hardly any draw is passive.
        """
        part = self.moving
        if not isinstance(part, FittedPart) or not part.parameters:
            raise InputError(f"{self.file}: the model has no covariance to draw from")
        random, values, factor = np.random.default_rng(SEED), part.values(), self.stretch * part.factor()
        found: list[Self] = []
        for _ in range(TRIES * samples):
            error = factor @ random.standard_normal(values.size)
            signs = (1.0, -1.0) if samples - len(found) > 1 else (1.0,)
            try:
                found += [self._with(part.with_values(values + sign * error), grips_N) for sign in signs]
            except InputError:
                continue
            if len(found) == samples:
                return found
        raise InputError(
            f"{self.file}: of {TRIES * samples} devices drawn from the covariance of its fit fewer than {samples} "
            "are passive: record more and identify again"
        )

    @cached_property
    def stretch(self) -> float:
        """How many times as far devices are off as the covariance of the fit says, by its `error`; at least 1.

        The ratio of two root mean squares over the recorded grips and the band of a tap: of the response's error as
        the records and the taps at the amplitude of use show it, and of what one standard deviation of the parameters
        makes of the response, to first order.
        """
        part = self.moving
        if not isinstance(part, DriveDevice) or part.error is None:
            return 1.0
        known = np.array(part.error.frequencies_Hz)
        inside = (known >= TAP_HZ[0]) & (known <= TAP_HZ[1])
        shown = explained = 0.0
        for grip_N, power in zip(part.error.grips_N, part.error.power, strict=True):
            if grip_N not in part.grips_N or not inside.any():
                continue
            # Relative to the response, so that a resonance counts no more than what lies beside it.
            scale = np.abs(part.plant(grip_N).response(known[inside])) ** 2
            beyond = max((tap.excess for tap in part.error.at_use if tap.grip_N == grip_N), default=0.0)
            shown += float(np.mean(np.array(power)[inside] / scale)) + beyond**2
            explained += float(np.mean(_variance(part, grip_N, known[inside]) / scale))
        return float(np.sqrt(max(shown / explained, 1.0))) if explained > 0 else 1.0

    @cached_property
    def _hand_error(self) -> ModelError:
        """Error of the hand's response, by the covariance of its fit."""
        assert self.hand is not None
        return error_by_covariance(self.hand)

    def _with(self, part: Chain, grips_N: Sequence[float]) -> Self:
        """The model with another device or hand, refused by an InputError where that is not passive at a grip."""
        for grip_N in grips_N:
            part.plant(grip_N)
        return self.model_copy(update={"device" if isinstance(part, DriveDevice) else "hand": part})


def error_by_covariance(part: Chain) -> ModelError:
    """Expected square of the error of a response where nothing but the covariance of its fit is known of it.

    Per ampere of a device, per newton of a hand.
    """
    frequencies_Hz = np.geomspace(*TAP_HZ, BANDS)
    power = [_variance(part, grip_N, frequencies_Hz).tolist() for grip_N in part.grips_N]
    return ModelError(grips_N=part.grips_N, frequencies_Hz=frequencies_Hz.tolist(), power=power)


def known_to(part: Chain) -> dict[float, float]:
    """Recorded grip -> rms over the band of a tap of the relative standard deviation of the response there."""
    error, found = error_by_covariance(part), {}
    for grip_N, power in zip(error.grips_N, error.power, strict=True):
        size = np.abs(part.plant(grip_N).response(np.array(error.frequencies_Hz))) ** 2
        found[grip_N] = float(np.sqrt(np.mean(np.array(power) / size)))
    return found


def _variance(part: Chain, grip_N: float, frequencies_Hz: FloatArray) -> FloatArray:
    """(m,) E|.|^2 of the response by the covariance of the parameters, to first order."""
    values = part.values()

    def moved(by: FloatArray) -> FloatArray:
        return part.with_values(values + by).plant(grip_N).response(frequencies_Hz)

    def slope(column: FloatArray) -> FloatArray:
        # The response is linear in a step so small; smaller still where a parameter all but vanishes at a grip.
        share = np.divide(column, values, out=np.zeros_like(values), where=values != 0)
        for step in SMALL / max(float(np.abs(share).max()), SMALL) * 4.0 ** -np.arange(20):
            try:
                return np.asarray((moved(step * column) - moved(-step * column)) / (2 * step))
            except InputError:
                continue
        return np.zeros(frequencies_Hz.size)  # at the end of what is passive nothing moves both ways

    return np.asarray(sum(np.abs(slope(column)) ** 2 for column in part.factor().T))
