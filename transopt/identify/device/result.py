"""The result of identification: candidates, the chosen one, findings, and the part of a model file."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from transopt.identify.device.black_box import BlackBox
from transopt.identify.device.chain import SHARED, hand_table
from transopt.identify.device.chain_fit import ChainFit, GripFit
from transopt.identify.device.response import Instrument
from transopt.identify.device.trials import Grip
from transopt.identify.device.validation import Model, Transient, together, verdict
from transopt.identify.findings import Finding
from transopt.identify.fit import known
from transopt.identify.measurement import sources
from transopt.scene.model_error import ModelError, Predicted
from transopt.scene.model_parts import DriveDevice, StateSpaceDevice


class Kind(StrEnum):
    """Which model to fit; AUTO fits both and keeps the better one."""

    AUTO = "auto"
    DRIVE = "drive"
    STATE_SPACE = "state_space"


@dataclass(frozen=True)
class Candidate:
    """One kind of model, fitted and validated.

    Attributes
    ----------
    kind : kind of model.
    model : gives the plants at a grip.
    instrument : amplifier and accelerometer of the records.
    transients : grip -> its held-out transients, measured and predicted.
    between : grip -> relative error at grips not fitted: those with transients only, and inner held ones with the
        same kind of model fitted without them.
    error : expected error of its response.
    off : that error relative to the response, for a current with a flat spectrum.
    """

    kind: Kind
    model: Model
    instrument: Instrument
    transients: dict[float, list[Transient]]
    between: dict[float, float]
    error: ModelError
    off: float

    @property
    def recorded(self) -> dict[float, float]:
        """Grip -> relative error of its held-out transients; NaN if it has none."""
        return {grip: together(runs) for grip, runs in self.transients.items()}


@dataclass(frozen=True)
class DeviceResult:
    """The result of identification.

    Attributes
    ----------
    grips : recorded grips with their responses.
    chosen : the better candidate.
    other : the other candidate; None if only one kind was asked for or possible.
    chain : fit of the drive chain; None if there is none.
    own_hands : lack of fit of the chain's hand by grip.
    black_box : fit of the state space; None if there is none.
    error : expected error of the chosen model's response, and the excess that taps at the amplitude of use show.
    predicted : predicted errors of the scene's taps; None without a scene.
    uncovered : one sentence on taps that need more current than was recorded; empty if none does.
    causes : names of effects found in the records or the device beside the model.
    findings : findings about the records.
    advice : what to record again, and where.
    short : shortfalls: why the result is not fit to design with.
    """

    grips: list[Grip]
    chosen: Candidate
    other: Candidate | None
    chain: ChainFit | None
    own_hands: list[GripFit]
    black_box: BlackBox | None
    error: ModelError
    predicted: Predicted | None
    causes: list[str]
    findings: list[Finding]
    advice: list[str]
    short: list[str]
    uncovered: str = ""

    @property
    def residuals(self) -> list[float]:
        """Mean square of the chosen model's residuals over the noise, by grip."""
        if self.chosen.kind is Kind.STATE_SPACE:
            assert self.black_box is not None
            return [float(value) for value in self.black_box.scatter]
        assert self.chain is not None
        maximum = self.chain.maximum
        return [
            float(squares.sum() / points.sum())
            for squares, points in zip(maximum.chi_square, maximum.points, strict=True)
        ]

    @property
    def verdict(self) -> str:
        """One sentence for the model file and the user: how far the chosen model can be relied upon."""
        words = [verdict(self.predicted, self.chosen.recorded, self.uncovered)]
        if self.chosen.kind is Kind.DRIVE and self.chain is not None:
            words += self.chain.meaningless()
        return "; ".join(words)


def device_part(result: DeviceResult) -> DriveDevice | StateSpaceDevice:
    """The chosen model as a model file holds it."""
    runs = [run for grip in result.grips for run in (*grip.fitted, *grip.kept)]
    nrmse = {f"{grip:.6g}": error for grip, error in result.chosen.recorded.items() if np.isfinite(error)}
    common: dict[str, Any] = {
        "grips_N": [grip.grip_N for grip in result.grips],
        "nrmse": nrmse,
        "sources": sources(runs),
        "verdict": "; ".join([result.verdict, *result.short]),
        "shortfalls": list(result.short),
        "causes": list(result.causes),
        "error": result.error.model_dump(),
        "predicted": None if result.predicted is None else result.predicted.model_dump(),
    }
    if result.chosen.kind is Kind.STATE_SPACE:
        assert result.black_box is not None
        matrices = {
            part: [getattr(plant, part).tolist() for plant in result.black_box.plants]
            for part in ("A", "B", "C", "D")
        }
        return StateSpaceDevice.model_validate(
            {"kind": "state_space", "order": result.black_box.order, **matrices, **common}
        )
    assert result.chain is not None
    device = result.chain.device
    names, _, covariance, intervals = result.chain.stated()
    return DriveDevice.model_validate(
        {
            "kind": "drive",
            "force_per_current_N_A": device.force_per_current_N_A,
            **dict(zip(SHARED, device.shared.tolist(), strict=True)),
            "hand": hand_table(device.hand),
            **known(names, covariance, intervals),
            **common,
        }
    )
