"""A scene's model that comes from a model file, and devices drawn from the uncertainty of its fit."""

from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.motor import Tip
from transopt.plant.state_space import CURRENT_INPUT, Input, StateSpace
from transopt.scene import model_parts
from transopt.scene.fitted import FittedPart, ModelPart
from transopt.scene.model_error import ModelError

SEED = 7  # fixed seed of the draws, so that a library can be reproduced
MAX_DRAWS = 200  # for each device that is wanted, until it is passive
TAP_HZ = 5.0, 600.0  # band that contains the energy of a tap
BANDS = 24  # number of frequencies in that band for an error by the covariance of a fit
RELATIVE_STEP = 1e-4  # relative change of a parameter for difference quotients of responses

Chain = model_parts.DriveDevice | model_parts.SecondOrderHand | model_parts.FourthOrderHand
"""Parts whose masses, springs and dampers were fitted, with their covariance."""


class IdentifiedModel(model_parts.ModelParts):
    """The content of a model file (`model = "MODEL.json"`), so that a library does not need the file."""

    kind: Literal["identified"]
    file: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]

    @model_validator(mode="after")
    def _moves_something(self) -> Self:
        if self.device is None and self.hand is None:
            raise ValueError(
                f"{self.file}: has neither a device nor a hand part to simulate: run `transopt identify device` "
                "into it"
            )
        return self

    @property
    def moving(
        self,
    ) -> (
        model_parts.DriveDevice
        | model_parts.StateSpaceDevice
        | model_parts.SecondOrderHand
        | model_parts.FourthOrderHand
    ):
        """The part that the current moves: the device, or the hand where only a hand was identified."""
        part = self.hand if self.device is None else self.device
        assert part is not None
        return part

    def unfit(self, *, coil: bool) -> dict[str, list[str]]:
        """Part that a design uses -> why it is not fit to design with; empty if all are fit.

        Parameters
        ----------
        coil : whether the design has a motor, and so uses the coil part.
        """
        moving = "device" if self.device is not None else "hand"
        used: dict[str, ModelPart | None] = {"amplifier": self.amplifier, moving: self.moving}
        used["coil"] = self.coil if coil else None
        return {name: part.shortfalls for name, part in used.items() if part is not None and part.shortfalls}

    @property
    def is_chain(self) -> bool:
        """Whether its states are the elongations of a chain of masses, then their rates."""
        return not isinstance(self.moving, model_parts.StateSpaceDevice)

    def tip(self) -> Tip | None:
        """The drive at the tip; None if the file has no drive chain."""
        device = self.device
        if not isinstance(device, model_parts.DriveDevice):
            return None
        return Tip(
            force_per_current_N_A=device.force_per_current_N_A,
            moving_mass_kg=device.moving_mass_kg,
            stiffness_N_m=device.transmission_stiffness_N_m,
            damping_N_s_m=device.transmission_damping_N_s_m,
        )

    def check_grip(self, grip_N: float) -> None:
        """Check that a grip is within the recorded ones."""
        model_parts.check_grip(self.moving.grips_N, grip_N)

    def error_of(
        self,
        grip_N: float,
        current_A: FloatArray,
        dt_s: float,
        energy: float,
        *,
        force_per_current_N_A: float | None = None,
    ) -> float:
        """Expected relative error between a tap as predicted and as played by the device; NaN where it is unknown.

        For a file without a spectrum of its error it is the held-out error at the grip, noise included. For a file
        with a hand only it follows from the covariance of its fit.

        Parameters
        ----------
        current_A : (N,) current of the tap, sampled every `dt_s`.
        energy : sum of the squares of its N samples of acceleration [(m/s^2)^2].
        force_per_current_N_A : that of the scene, for a file with a hand only.
        """
        if self.device is None:
            assert force_per_current_N_A is not None
            return self._hand_error.nrmse(grip_N, force_per_current_N_A * current_A, dt_s, energy)
        if self.device.error is None:
            return self.device.error_at(grip_N)
        return self.device.error.nrmse(grip_N, current_A, dt_s, energy)

    @property
    def driven_by(self) -> Input:
        """The model's input, always a current."""
        return CURRENT_INPUT

    def plant(self, grip_N: float, force_per_current_N_A: float | None, *, struck: bool = False) -> StateSpace:
        """The model from motor current, or with `struck` from a force on the stylus [N], to stylus acceleration.

        Parameters
        ----------
        force_per_current_N_A : that of the scene, for a file with a hand only.

        Raises
        ------
        InputError : a grip that was not recorded, parameters that are not passive there, a black box that is struck.
        """
        match self.moving:
            case model_parts.DriveDevice() as device:
                return device.plant(grip_N, struck=struck)
            case model_parts.StateSpaceDevice() as device:
                if struck:
                    raise InputError(
                        f"{self.file}: a state space from the motor's current has no stylus to strike with"
                    )
                return device.plant(grip_N)
            case model_parts.SecondOrderHand() | model_parts.FourthOrderHand() as hand:
                assert force_per_current_N_A is not None
                return hand.plant(grip_N, force_per_current_N_A=1.0 if struck else force_per_current_N_A)

    def drawn(self, samples: int, grips_N: Sequence[float]) -> list[Self]:
        """Models with parameters drawn around the fitted ones, passive at all recorded and given grips.

        The errors are drawn from the fit's covariance, scaled by `stretch` where the records show more error than the
        covariance explains, such as missing structure or friction at the amplitude of use. The draws are seeded and
        come in pairs of opposite errors, so that their mean is the identified model; an odd last one is single. Each
        draw is one device with the same parameters at every grip.

        Raises
        ------
        InputError : a model without covariance, or so uncertain that hardly any draw is passive.
        """
        part = self.moving
        if not isinstance(part, FittedPart) or not part.parameters:
            raise InputError(f"{self.file}: the model has no covariance to draw from")
        random, values, factor = np.random.default_rng(SEED), part.values(), self.stretch * part.factor()
        found: list[Self] = []
        for _ in range(MAX_DRAWS * samples):
            error = factor @ random.standard_normal(values.size)
            signs = (1.0, -1.0) if samples - len(found) > 1 else (1.0,)
            try:
                found += [self._with(part.with_values(values + sign * error), grips_N) for sign in signs]
            except InputError:
                continue
            if len(found) == samples:
                return found
        raise InputError(
            f"{self.file}: of {MAX_DRAWS * samples} devices drawn from the covariance of its fit fewer than "
            f"{samples} are passive: record more and identify again"
        )

    @cached_property
    def stretch(self) -> float:
        """Factor >= 1 by which the errors of devices exceed the covariance of the fit, according to its `error`.

        It is the ratio of two root mean squares over the recorded grips and the band of a tap: the error of the
        response in the records and in the taps at the amplitude of use, over the standard deviation of the response
        by the covariance, to first order.
        """
        part = self.moving
        if not isinstance(part, model_parts.DriveDevice) or part.error is None:
            return 1.0
        known = np.array(part.error.frequencies_Hz)
        inside = (known >= TAP_HZ[0]) & (known <= TAP_HZ[1])
        shown = explained = 0.0
        for grip_N, power in zip(part.error.grips_N, part.error.power, strict=True):
            if grip_N not in part.grips_N or not inside.any():
                continue
            # Relative to the response, so that a resonance does not dominate.
            scale = np.abs(part.plant(grip_N).response(known[inside])) ** 2
            beyond = max((tap.excess for tap in part.error.at_use if tap.grip_N == grip_N), default=0.0)
            shown += float(np.mean(np.array(power)[inside] / scale)) + beyond**2
            explained += float(np.mean(_variance(part, grip_N, known[inside]) / scale))
        return float(np.sqrt(max(shown / explained, 1.0))) if explained > 0 else 1.0

    @cached_property
    def _hand_error(self) -> ModelError:
        """Error of the hand's response by the covariance of its fit."""
        assert self.hand is not None
        return error_by_covariance(self.hand)

    def _with(self, part: Chain, grips_N: Sequence[float]) -> Self:
        """The model with another device or hand."""
        for grip_N in grips_N:
            part.plant(grip_N)
        return self.model_copy(update={"device" if isinstance(part, model_parts.DriveDevice) else "hand": part})


def error_by_covariance(part: Chain) -> ModelError:
    """Expected squared error of a response by the covariance of its fit, per ampere (device) or newton (hand)."""
    frequencies_Hz = np.geomspace(*TAP_HZ, BANDS)
    power = [_variance(part, grip_N, frequencies_Hz).tolist() for grip_N in part.grips_N]
    return ModelError(grips_N=part.grips_N, frequencies_Hz=frequencies_Hz.tolist(), power=power)


def known_to(part: Chain) -> dict[float, float]:
    """Recorded grip -> rms over the band of a tap of the response's relative standard deviation."""
    error, deviations = error_by_covariance(part), {}
    for grip_N, power in zip(error.grips_N, error.power, strict=True):
        size = np.abs(part.plant(grip_N).response(np.array(error.frequencies_Hz))) ** 2
        deviations[grip_N] = float(np.sqrt(np.mean(np.array(power) / size)))
    return deviations


def _variance(part: Chain, grip_N: float, frequencies_Hz: FloatArray) -> FloatArray:
    """(m,) variance of the response by the covariance of the parameters, to first order."""
    values = part.values()

    def moved(by: FloatArray) -> FloatArray:
        return part.with_values(values + by).plant(grip_N).response(frequencies_Hz)

    def slope(column: FloatArray) -> FloatArray:
        # The step is reduced until both ends are passive, as where a parameter is nearly zero at a grip.
        share = np.divide(column, values, out=np.zeros_like(values), where=values != 0)
        for step in RELATIVE_STEP / max(float(np.abs(share).max()), RELATIVE_STEP) * 4.0 ** -np.arange(20):
            try:
                return np.asarray((moved(step * column) - moved(-step * column)) / (2 * step))
            except InputError:
                continue
        return np.zeros(frequencies_Hz.size)  # on the boundary of passivity no step in both directions is possible

    return np.asarray(sum(np.abs(slope(column)) ** 2 for column in part.factor().T))
