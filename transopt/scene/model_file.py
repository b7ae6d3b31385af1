"""The model file: what `transopt identify` found out about a device, and what a scene builds on (DESIGN 3.1).

JSON with `schema`, `versions` and up to four parts, each with its uncertainty, its verdict and its sources. SI
throughout, units in the names. Covariances are in raw SI units, in the order of the part's `parameters`; a parameter
that was held fixed is not among them. Intervals are of 95 %.
"""

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Annotated, Literal, NoReturn, Self

import numpy as np
from pydantic import Field, JsonValue, ValidationError, field_validator, model_validator

from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.section import Finite, NonNegative, Positive, Section
from transopt.plant import chain as models
from transopt.scene.fitted import Fitted, Part, complaint
from transopt.scene.sections import LinearParameter

SCHEMA = 1
PARTS = ("amplifier", "device", "hand", "coil")
PartName = Literal["amplifier", "device", "hand", "coil"]
OUTSIDE = 0.1  # a grip may leave the recorded ones by this share of the nearest of them

Matrix = Annotated[list[list[Finite]], Field(min_length=1)]


class AmplifierPart(Fitted):
    """Current amplifier: one pole and a pure delay, without the hold's half sample and with it."""

    pole_Hz: Positive
    delay_s: NonNegative
    delay_with_hold_s: NonNegative
    gain: Positive


class ChainHand(Section):
    """Skin and arm of the `drive` chain, linear in grip."""

    mass_kg: LinearParameter
    skin_stiffness_N_m: LinearParameter
    skin_damping_N_s_m: LinearParameter
    arm_stiffness_N_m: LinearParameter
    arm_damping_N_s_m: LinearParameter

    def hand(self) -> models.Hand:
        return models.Hand(**{name: getattr(self, name).linear() for name in type(self).model_fields})


Grips = Annotated[list[NonNegative], Field(min_length=1)]
NrmseByGrip = dict[str, NonNegative]


def _increasing(grips_N: list[float]) -> list[float]:
    if sorted(set(grips_N)) != grips_N:
        raise ValueError("must be strictly increasing, without duplicates")
    return grips_N


def _of_grips(nrmse: NrmseByGrip) -> NrmseByGrip:
    for name in nrmse:
        try:
            grip_N = float(name)
        except ValueError:
            grip_N = np.nan
        if not 0 <= grip_N < np.inf:
            raise ValueError(f"{name!r} is no grip in newton")
    return nrmse


def check_grip(grips_N: list[float], grip_N: float) -> None:
    """Refuse a grip that was not recorded: no model is known there.

    Raises
    ------
    InputError : with the recorded range.
    """
    held = [grip for grip in grips_N if grip > 0]
    if grip_N == 0:
        if grips_N[0] > 0:
            raise InputError("the model file knows no free device: record one at grip 0 and identify with it")
        return
    if not held:
        raise InputError("the model file knows only the free device: record held grips and identify with them")
    lowest, highest = held[0], held[-1]
    if not lowest * (1 - OUTSIDE) <= grip_N * (1 + 1e-12) or not grip_N <= highest * (1 + OUTSIDE) * (1 + 1e-12):
        raise InputError(
            f"outside the recorded grips of the model file, {lowest:g} to {highest:g} N (and {OUTSIDE:.0%} beyond): "
            "record there and identify again, or keep grid.grips_N (and robust.grip_spread) inside"
        )


def _error_at(nrmse: NrmseByGrip, grip_N: float) -> float:
    """Held-out NRMSE of the model at a grip, between those where it was validated linear; NaN without validation."""
    by_grip = sorted((float(name), value) for name, value in nrmse.items())
    if grip_N > 0:
        by_grip = [(grip, value) for grip, value in by_grip if grip > 0] or by_grip
    if not by_grip:
        return np.nan
    return float(np.interp(grip_N, [grip for grip, _ in by_grip], [value for _, value in by_grip]))


class DriveDevice(Fitted):
    """The `drive` chain: device parameters shared by all grips, those of the hand linear in grip.

    Attributes
    ----------
    force_per_current_N_A : known, not fitted: the response does not change if it and all masses, stiffnesses and
        dampings are scaled alike.
    grips_N : recorded, 0 for the free device.
    nrmse : grip -> held-out NRMSE on trials outside the fit.
    """

    kind: Literal["drive"]
    force_per_current_N_A: Positive
    moving_mass_kg: Positive
    stylus_mass_kg: Positive
    transmission_stiffness_N_m: Positive
    transmission_damping_N_s_m: NonNegative
    hand: ChainHand
    grips_N: Grips
    nrmse: NrmseByGrip

    _grips_ordered = field_validator("grips_N")(_increasing)
    _nrmse_by_grip = field_validator("nrmse")(_of_grips)

    @model_validator(mode="after")
    def _passive(self) -> Self:
        for grip_N in self.grips_N:
            try:
                self.plant(grip_N)
            except InputError as error:
                raise ValueError(f"at {grip_N:g} N: {error}") from None
        return self

    def plant(self, grip_N: float, *, struck: bool = False) -> models.StateSpace:
        """Motor current, or with `struck` a force on the stylus [N], to stylus acceleration.

        Raises
        ------
        InputError : a grip that was not recorded, parameters that are not passive there.
        """
        check_grip(self.grips_N, grip_N)
        return models.drive(
            grip_N,
            hand=self.hand.hand(),
            stylus_mass_kg=self.stylus_mass_kg,
            moving_mass_kg=self.moving_mass_kg,
            transmission=models.Link(self.transmission_stiffness_N_m, self.transmission_damping_N_s_m),
            force_per_current_N_A=1.0 if struck else self.force_per_current_N_A,
            driven=1 if struck else 0,
        )

    def error_at(self, grip_N: float) -> float:
        return _error_at(self.nrmse, grip_N)


class StateSpaceDevice(Part):
    """A black box: one continuous-time state space per grip, from current [A] to stylus acceleration [m/s^2].

    Attributes
    ----------
    A, B, C, D : (ng, n, n), (ng, n, 1), (ng, 1, n), (ng, 1, 1), n = `order`, real and stable.
    """

    kind: Literal["state_space"]
    order: Annotated[int, Field(ge=1)]
    grips_N: Grips
    A: Annotated[list[Matrix], Field(min_length=1)]
    B: Annotated[list[Matrix], Field(min_length=1)]
    C: Annotated[list[Matrix], Field(min_length=1)]
    D: Annotated[list[Matrix], Field(min_length=1)]
    nrmse: NrmseByGrip

    _grips_ordered = field_validator("grips_N")(_increasing)
    _nrmse_by_grip = field_validator("nrmse")(_of_grips)

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

    def node(self, j: int) -> models.StateSpace:
        """The model of a recorded grip. A black box knows no encoder: its row is zero."""
        A, B, C, D = (np.array(getattr(self, name)[j]) for name in "ABCD")
        return models.StateSpace(A, B, C, D, np.zeros((1, self.order)))

    def plant(self, grip_N: float) -> models.StateSpace:
        """Motor current to stylus acceleration; between recorded grips their outputs are blended, linearly.

        Of order 2 n wherever there are two held grips to blend, also at a node, so that all grips share one order.

        Raises
        ------
        InputError : a grip that was not recorded.
        """
        check_grip(self.grips_N, grip_N)
        first = 1 if self.grips_N[0] == 0 else 0
        held = self.grips_N[first:]
        if grip_N == 0:
            return self.node(0)
        if len(held) == 1:
            return self.node(first)
        grip = min(max(grip_N, held[0]), held[-1])
        j = min(int(np.searchsorted(held, grip, side="right")) - 1, len(held) - 2)
        share = (grip - held[j]) / (held[j + 1] - held[j])
        return models.blended(self.node(first + j), self.node(first + j + 1), share)

    def error_at(self, grip_N: float) -> float:
        return _error_at(self.nrmse, grip_N)


class HandPart(Fitted):
    """The whole hand as one mass, spring and damper, linear in grip (seed Eqs. 3-5).

    `fourth_order` is the other fit, with the hand's unmeasured state (seed Fig. 4b), as its author found it.
    """

    mass_kg: LinearParameter
    damping_N_s_m: LinearParameter
    stiffness_N_m: LinearParameter
    grips_N: Grips
    fourth_order: dict[str, JsonValue] | None = None

    _grips_ordered = field_validator("grips_N")(_increasing)

    @model_validator(mode="after")
    def _passive(self) -> Self:
        if self.grips_N[0] == 0:
            raise ValueError("grips_N: a hand that does not hold the stylus cannot be identified at 0 N")
        for grip_N in self.grips_N:
            try:
                self.plant(grip_N, force_per_current_N_A=1.0)
            except InputError as error:
                raise ValueError(f"at {grip_N:g} N: {error}") from None
        return self

    def plant(self, grip_N: float, *, force_per_current_N_A: float) -> models.StateSpace:
        """Motor current to stylus acceleration.

        Raises
        ------
        InputError : a grip that was not recorded, parameters that are not passive there.
        """
        check_grip(self.grips_N, grip_N)
        return models.second_order(
            grip_N,
            force_per_current_N_A=force_per_current_N_A,
            mass_kg=self.mass_kg.linear(),
            damping_N_s_m=self.damping_N_s_m.linear(),
            stiffness_N_m=self.stiffness_N_m.linear(),
        )


class CoilPart(Fitted):
    """Thermal resistances winding to housing to ambient, and the time constants of both."""

    R_wh_K_W: Positive
    R_ha_K_W: Positive
    tau_w_s: Positive
    tau_h_s: Positive


DevicePart = Annotated[DriveDevice | StateSpaceDevice, Field(discriminator="kind")]
AnyPart = AmplifierPart | DriveDevice | StateSpaceDevice | HandPart | CoilPart


class Parts(Section):
    """What was identified; None for what was not."""

    amplifier: AmplifierPart | None = None
    device: DevicePart | None = None
    hand: HandPart | None = None
    coil: CoilPart | None = None


class ModelFile(Parts):
    """A model file."""

    # Named as in the file; pydantic's own deprecated method of that name is none of ours.
    schema_: Annotated[Literal[1], Field(alias="schema")]
    versions: dict[str, str]


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number")


def parse_model(source: Path | str, content: bytes) -> ModelFile:
    """The model file of a file's bytes; `source` names it in messages.

    Raises
    ------
    InputError : one line: file, field, value, what to do.
    """
    advice = "give a file written by `transopt identify`, or identify again into another file"
    try:
        parsed = json.loads(content.decode("utf-8"), parse_constant=_refuse_constant)
    except UnicodeDecodeError:
        raise InputError(f"{source}: not a text file, so no model file; {advice}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source}: damaged or no model file ({error}); {advice}") from None
    if not isinstance(parsed, dict) or "schema" not in parsed:
        raise InputError(f"{source}: no model file (schema is missing); {advice}")
    try:
        return ModelFile.model_validate(parsed)
    except ValidationError as error:
        raise InputError(f"{source}: {complaint(error)}; {advice}") from None


def read_model(path: Path) -> bytes:
    """A model file's bytes, unchecked.

    Raises
    ------
    InputError : no such file, or one that cannot be read.
    """
    advice = "`transopt identify device FILES... --out MODEL.json` writes one"
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {advice}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {advice}") from None


def load_model(path: Path) -> ModelFile:
    """Read and check a model file.

    Raises
    ------
    InputError : one line: file, field, value, what to do.
    """
    return parse_model(path, read_model(path))


def save_part(path: Path, name: PartName, part: AnyPart) -> None:
    """Put one part into a model file in place of the one it had; the other parts stay as they are.

    Raises
    ------
    InputError : an existing file that is damaged or no model file (it stays as it is); a place that cannot be
        written.
    """
    expected = {
        "amplifier": AmplifierPart,
        "device": DriveDevice | StateSpaceDevice,
        "hand": HandPart,
        "coil": CoilPart,
    }[name]
    if not isinstance(part, expected):
        raise TypeError(f"{name}: a {type(part).__name__} is none")
    content = load_model(path).model_dump(by_alias=True, mode="json") if path.exists() else {}
    content = {
        "schema": SCHEMA,
        "versions": {
            **{package: metadata.version(package) for package in ("transopt", "numpy", "scipy")},
            "python": platform.python_version(),
        },
        **{other: content[other] for other in PARTS if content.get(other) is not None},
        name: part.model_dump(mode="json"),
    }
    text = json.dumps(content, indent=1, allow_nan=False)
    with whole_file(path) as file:
        file.write(f"{text}\n".encode())
