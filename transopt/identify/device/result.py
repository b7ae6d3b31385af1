"""What identification found: candidates, the chosen one, what is wrong or missing, and the part of a model file."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from transopt.identify.device.black_box import BlackBox
from transopt.identify.device.chain import HAND, SHARED
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
    kind : of model.
    model : gives the plants of a grip.
    instrument : what stood between it and the records.
    transients : grip -> those of its transients that were kept out of the fit.
    between : relative error at grips that the model does not know: those with transients only, and inner held ones by
        the same kind of model fitted without them.
    error : how far its response is off.
    off : the same as a part of the answer to a current of even spectrum.
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
        """Grip -> relative error of what was kept out; NaN where nothing was."""
        return {grip: together(runs) for grip, runs in self.transients.items()}


@dataclass(frozen=True)
class DeviceResult:
    """What identification found.

    Attributes
    ----------
    grips : with their responses.
    chosen : the better candidate.
    other : the other one; None where only one kind was asked for or possible.
    chain : the fit behind the drive chain, if there is one.
    own_hands : its lack of fit by grip.
    black_box : the fit behind the state space, if there is one.
    error : how far the response of the chosen one is off, and what taps at the amplitude of use missed beyond it.
    predicted : what that makes of the scene's taps; None where no scene was named.
    uncovered : which of these taps ask for more current than was recorded, in a sentence; empty if none does.
    causes : what was found to be in the records or the device beside the model, by name.
    findings : of the records.
    advice : what to record again, where.
    short : why the result is not good enough.
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
        """Residuals of the chosen model by grip: mean square over the noise's."""
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
        """One sentence for the model file and for the user: how far the chosen model can be relied upon."""
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
            "hand": {
                name: {"constant": constant, "per_newton": slope}
                for name, (constant, slope) in zip(HAND, device.hand.tolist(), strict=True)
            },
            **known(names, covariance, intervals),
            **common,
        }
    )
