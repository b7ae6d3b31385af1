"""What a report says about an identified model: values, intervals, verdicts, and its error beside the design's."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from transopt.base.writing import percent, table
from transopt.design.build import Build
from transopt.design.entry import Entry
from transopt.scene.fitted import FittedPart
from transopt.scene.identified import IdentifiedModel
from transopt.scene.model_parts import MODEL_PARTS, DriveDevice, FourthOrderHand
from transopt.scene.scene import Scene

GAIN_TOLERANCE = 0.02  # of the amplifier's gain from 1; the design assumes a gain of 1
SAME_GRIP = 0.01  # part by which a mean of what a grip sensor read may differ from the grip that was held


def _use(scene: Scene, model: IdentifiedModel, name: str) -> str:
    """What the design uses of a part, in words."""
    match name:
        case "amplifier":
            assert model.amplifier is not None
            gain = model.amplifier.gain
            if abs(gain - 1) <= GAIN_TOLERANCE:
                return "pole and delay"
            return f"pole and delay; its gain of {gain:.3g} is NOT in the design: calibrate the amplifier"
        case "device" if isinstance(model.device, DriveDevice):
            return "masses, springs, dampers and force per ampere, in place of those of motor and transmission"
        case "device":
            return "the response from current to acceleration; blended between recorded grips"
        case "hand":
            chain = "stylus, skin, hand mass and arm (seed Fig. 4b)"
            alone = chain if isinstance(model.hand, FourthOrderHand) else "mass, spring and damper"
            return "not used: the device has its own" if model.device is not None else alone
        case _:
            return (
                "thermal resistances and time constants, in place of the motor's"
                if scene.motor
                else ("not used: the scene states no motor")
            )


def _value_rows(name: str, part: FittedPart) -> list[list[str]]:
    """Rows of a table: part, parameter, value, 95 % interval, standard deviation."""
    rows = []
    for j, (parameter, value) in enumerate(zip(part.parameters, part.values(), strict=True)):
        interval = part.intervals.get(parameter)
        shown = "-" if interval is None else f"{interval[0]:.4g} to {interval[1]:.4g}"
        rows.append([name, parameter, f"{value:.4g}", shown, f"{np.sqrt(part.covariance[j][j]):.2g}"])
    return rows


def _spread_words(scene: Scene) -> list[str]:
    """The devices that each command of a robust scene serves."""
    robust = scene.robust
    if robust is None:
        return []
    words = []
    if robust.grip_spread is not None:
        words.append(f"grips of +-{robust.grip_spread:.0%} around the node")
    if robust.model_uncertainty:
        words.append(
            f"{robust.samples} devices drawn from the covariance of the fit (seeded, in pairs of opposite errors, "
            "passive at every grip; the same at all nodes)"
        )
    return ["", f"Robust: each command serves the identified device and, besides, {' and '.join(words)}."]


def model_errors(build: Build) -> list[tuple[Entry, float]]:
    """Admitted entries with the expected error between prediction and device, according to the model file."""
    model = build.scene.model
    if not isinstance(model, IdentifiedModel):
        return []
    found, force = [], None if model.device is not None else build.scene.drive_at_tip().force_per_current_N_A
    for entry in build.proven:
        energy = float(np.sum(entry.predicted_m_s2**2))
        error = model.error_of(
            entry.grip_N, entry.plant_input, entry.problem.grid.dt_s, energy, force_per_current_N_A=force
        )
        if np.isfinite(error):
            found.append((entry, error))
    return found


def below_the_model(build: Build) -> list[Entry]:
    """Entries whose designed error is smaller than the expected error of their model."""
    return [entry for entry, error in model_errors(build) if entry.figures.tap_error < error]


def model_warning(build: Build) -> str:
    """One line on the model's own error, and where the design promises a smaller one; empty if none is known."""
    errors = model_errors(build)
    if not errors:
        return ""
    worst, error = max(errors, key=lambda one: one[1])
    middle, model = float(np.median([one for _, one in errors])), build.scene.model
    end = f"; {model.uncounted}" if isinstance(model, IdentifiedModel) and model.uncounted else ""
    text = (
        f"model error {percent(middle)} % of a tap (median; at most {percent(error)} %, at {worst.speed_m_s:g} m/s, "
        f"{worst.grip_N:g} N)"
    )
    below = below_the_model(build)
    if not below:
        return f"{text}{end}"
    one = min(below, key=lambda entry: entry.figures.tap_error)
    return (
        f"{text}: above the design's own in {len(below)} of {sum(1 for _ in build.all_entries())} entries, as at "
        f"{one.speed_m_s:g} m/s, {one.grip_N:g} N, where the design says {percent(one.figures.tap_error)} %: expect "
        f"the model's error on the device{end}"
    )


def uncovered_line(build: Build) -> str:
    """One line if entries need more current than the device was recorded with; empty if none does."""
    model = build.scene.model
    if not isinstance(model, IdentifiedModel) or model.device is None or model.device.error is None:
        return ""
    error, entries = model.device.error, build.proven
    beyond = [entry for entry in entries if not error.covers(entry.grip_N, entry.played.peak_input)]
    if not beyond:
        return ""
    worst = max(beyond, key=lambda entry: entry.played.peak_input / error.recorded_at(entry.grip_N))
    return (
        f"{len(beyond)} of {len(entries)} entries ask for more current than {model.file} was recorded with, up to "
        f"{worst.played.peak_input:.3g} A at {worst.place} beside {error.recorded_at(worst.grip_N):.2g} A: how the "
        "device answers that is not known; record taps too (transopt-play record sweep --tap-current) and identify "
        "again"
    )


def moving_target(scene: Scene) -> str:
    """One line if the taps to reproduce are simulated with the identified device; empty if they are not."""
    model = scene.model
    if scene.recordings.simulated is None or scene.striker is not None or not isinstance(model, IdentifiedModel):
        return ""
    return (
        f"the simulated taps are struck by the device of {model.file} and change with it: state [model] in the "
        "scene, and the file by model_file, to keep them"
    )


def _outside(scene: Scene, model: IdentifiedModel) -> list[str]:
    """A note on grips of the scene outside the recorded ones."""
    recorded = [grip for grip in model.moving.grips_N if grip > 0]
    least, most = recorded[0] * (1 - SAME_GRIP), recorded[-1] * (1 + SAME_GRIP)
    beyond = [f"{grip:g}" for grip in scene.grid.grips_N if grip > 0 and not least <= grip <= most]
    if not beyond:
        return []
    return [
        "",
        f"Outside the recorded grips, {recorded[0]:.3g} to {recorded[-1]:.3g} N, but within the tenth that is "
        f"allowed: {', '.join(beyond)} N. "
        f"The model is {'extended' if isinstance(model.moving, FittedPart) else 'held'} there.",
    ]


def identified_lines(build: Build) -> list[str]:
    """The section of report.md on an identified model; empty if the scene states the model itself."""
    scene, model = build.scene, build.scene.model
    if not isinstance(model, IdentifiedModel):
        return []
    lines = ["", "## Identified", "", f"From {model.file} (sha256 {model.sha256[:12]}):", ""]
    rows: list[list[str]] = []
    for name in MODEL_PARTS:
        part = getattr(model, name)
        if part is None:
            continue
        lines.append(f"- {name}: {_use(scene, model, name)}. {part.verdict}")
        if isinstance(part, FittedPart) and not (name == "hand" and model.device is not None):
            rows += _value_rows(name, part)
    stated = [name for name in ("amplifier", "coil") if getattr(model, name) is None]
    lines += [
        f"- {name}: as the scene states it" for name in stated if name == "amplifier" or scene.motor is not None
    ]
    if rows:
        lines += ["", *table(["part", "parameter", "value (SI)", "95 %", "deviation"], rows)[:-1]]
    lines += _outside(scene, model)
    if model.device is not None and model.device.nrmse:
        errors = ", ".join(f"{float(grip):.3g} N: {percent(value)} %" for grip, value in model.device.nrmse.items())
        lines += [
            "",
            f"Relative error of the model on single trials outside its fit, their noise included: {errors}.",
        ]
    if model.device is not None and model.device.causes:
        lines += ["", f"Found beside the model: {', '.join(model.device.causes)}."]
    if unfit := scene.unfit_model():
        lines += ["", f"**{unfit}.** It was accepted by the one who solved."]
    for warning in filter(None, (model_warning(build), uncovered_line(build))):
        lines += ["", f"**{warning[0].upper()}{warning[1:]}.**"]
    return [*lines, *_spread_words(scene)]


def identified_rows(build: Build) -> dict[str, Any] | None:
    """Content of `identified_lines` for report.json; None if the scene states the model itself."""
    model = build.scene.model
    if not isinstance(model, IdentifiedModel):
        return None
    return {
        "file": model.file,
        "sha256": model.sha256,
        "parts": {
            name: {
                "used": _use(build.scene, model, name),
                "verdict": part.verdict,
                **(_values(part) if isinstance(part, FittedPart) else {}),
            }
            for name in MODEL_PARTS
            if (part := getattr(model, name)) is not None
        },
        "model_nrmse": None if model.device is None else model.device.nrmse,
        "model_error": [[entry.speed_m_s, entry.grip_N, error] for entry, error in model_errors(build)],
        "below_the_model": [[entry.speed_m_s, entry.grip_N] for entry in below_the_model(build)],
    }


def _values(part: FittedPart) -> dict[str, Any]:
    """Values and intervals by parameter name."""
    values: Sequence[float] = part.values().tolist()
    return {"values": dict(zip(part.parameters, values, strict=True)), "intervals": part.intervals}
