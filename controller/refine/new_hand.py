"""Calibration of a new user's hand from played taps: choice of taps, their records, comparison of libraries."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller.device.device_file import Accelerometer, DeviceFile
from controller.device.rail import why_at_rail
from controller.record.played import height_m, met_surface, played_tap, why_not_steady
from controller.record.recorder import Contact
from controller.refine.heard import Node, node_near
from controller.servo.settings import Settings
from controller.waveforms.prediction import predict
from transopt.base.errors import InputError
from transopt.identify.calibration import Calibration, PlayedRecord, calibrate
from transopt.identify.device.response import Instrument
from transopt.library.library import Library
from transopt.plant.drive import Drive
from transopt.scene.fitted import Source
from transopt.scene.identified import IdentifiedModel
from transopt.scene.model_file import save_part
from transopt.scene.model_parts import DriveDevice
from transopt.scene.population import Population
from transopt.scene.scene import Scene

TAPS = 3
BEFORE_S = 0.05  # approach before contact, from which the hand's own motion is estimated
NEAR_S = 0.01  # largest time between first command and contact; a longer one belongs to another contact
FIRM = 1.1  # least grip of a node over the least grip that plays, so that a hand reliably exceeds the latter
LEAST_NOISE = 1e-3  # least noise assumed of the accelerometer, over the range of its readings
LEAST_GAIN, MOST_LOSS = (
    0.005,
    0.01,
)  # change of tap or felt error: a smaller gain counts as none, a larger loss as worse


def nodes_to_tap(library: Library, device: DeviceFile) -> tuple[list[Node], int]:
    """Nodes at which taps tell most about a hand, and the number of taps at each: outermost and middle grips.

    With one grip only, or without a grip sensor, outermost and middle speeds.
    """
    (nv, ng), middle = library.command.shape[:2], (library.command.shape[0] - 1) // 2

    def three(count: int) -> list[int]:
        return sorted(set(np.linspace(0, count - 1, TAPS).round().astype(int).tolist()))

    firm = np.flatnonzero(library.grips_N > FIRM * library.grip_min_N)
    if device.grip.sensor and firm.size > 1:
        nodes = [(middle, int(firm[j])) for j in three(firm.size)]
    elif device.grip.sensor:
        nodes = [(iv, ng - 1) for iv in three(nv)]
    else:
        nodes = [(iv, int(np.argmin(np.abs(library.grips_N - device.grip.assumed_grip_N)))) for iv in three(nv)]
    return nodes, -(-TAPS // len(nodes))


def drive_of(scene: Scene) -> DriveDevice:
    """The drive of a scene, with its own hand, as a model file states it.

    Raises
    ------
    InputError : the device is not a motor, transmission and stylus in a hand.
    """
    grips = [grip for grip in scene.grid.grips_N if grip > 0]
    if not grips:
        raise InputError(f"{scene.name}: its library is of the free device, which nobody holds: solve held grips")
    served = sorted({round(each, 9) for grip in grips for each in (grip, *scene.spread_grips_N(grip))})
    model = scene.model
    if isinstance(model, IdentifiedModel) and isinstance(model.device, DriveDevice):
        return model.device.model_copy(update={"grips_N": served})
    if not isinstance(model, Drive):
        raise InputError(
            f"{scene.name}: model.kind = {model.kind}: a hand is calibrated on a known drive: give a library of a "
            "scene of kind drive, or of a device that `transopt identify device` found as a drive chain"
        )
    tip = scene.drive_at_tip()
    lines = {name: vars(model.hand.line(name)) for name in type(model.hand).model_fields}
    return DriveDevice.model_validate(
        {
            "kind": "drive",
            "force_per_current_N_A": tip.force_per_current_N_A,
            "moving_mass_kg": tip.moving_mass_kg,
            "stylus_mass_kg": model.stylus_mass_kg,
            "transmission_stiffness_N_m": tip.stiffness_N_m,
            "transmission_damping_N_s_m": tip.damping_N_s_m,
            "hand": lines,
            "grips_N": served,
            "nrmse": {},
            "intervals": {},
            "parameters": [],
            "covariance": [],
            "verdict": f"the drive of {scene.name}, as its scene states it",
            "sources": [],
        }
    )


def record_of(
    contact: Contact, library: Library, settings: Settings, accelerometer: Accelerometer
) -> PlayedRecord | str:
    """The record of a played tap for the calibration; or the reason why it does not count.

    Parameters
    ----------
    library : the one that was played; its hand continues its approach for a while from contact on.
    accelerometer : as the device file describes it.
    """
    intention_s = library.scene().hand.intention_s
    if contact.spoilt:
        return contact.spoilt
    met_s = met_surface(contact, settings)[0]
    times = (contact.ticks - contact.tick) * contact.dt_s
    if not np.any(contact.command_A):
        return "nothing was played: hold the stylus more firmly, or tap faster"
    if not (abs(met_s) < NEAR_S and times[0] <= -BEFORE_S and times[-1] >= met_s + intention_s):
        return "not all of it was recorded, from 50 ms before the contact until the hand can react"
    if why := why_not_steady(contact, settings, predict(library, contact.speed_m_s, contact.grip_N)):
        return why
    taken = (times >= -BEFORE_S) & (times < met_s + intention_s)
    first = int(np.argmax(times[taken] > -contact.dt_s / 2))
    acceleration = contact.acceleration_m_s2[taken]
    if why := why_at_rail(times[taken] - met_s, acceleration, accelerometer, library):
        return why
    largest = float(np.ptp(acceleration))
    if largest == 0:
        return "the accelerometer reads nothing: without one no hand is calibrated"
    return PlayedRecord(
        grip_N=contact.grip_N,
        dt_s=contact.dt_s,
        command_A=contact.command_A[taken],
        current_A=contact.current_A[taken],
        acceleration_m_s2=acceleration,
        position_m=height_m(contact, settings)[taken],
        first=first,
        acceleration_noise_m_s2=max(float(acceleration[:first].std(ddof=1)), LEAST_NOISE * largest),
        position_noise_m=settings.count_m / np.sqrt(12),
    )


def calibrated(
    contacts: Sequence[Contact],
    settings: Settings,
    library: Library,
    population: Population,
    accelerometer: Accelerometer,
    sources: Sequence[Source],
) -> tuple[Calibration, list[str]]:
    """The hand calibrated from taps of a library, and the reasons for taps that do not count.

    Raises
    ------
    InputError : no tap counts, or the library's device is not a drive in a hand.
    """
    scene = library.scene()
    drive, found = drive_of(scene), [record_of(each, library, settings, accelerometer) for each in contacts]
    instrument = Instrument(library.dt_s, library.amplifier(), accelerometer.bandwidth_Hz)
    records = [one for one in found if isinstance(one, PlayedRecord)]
    complaints = [
        f"tap {contact.number} does not count: {why}"
        for contact, why in zip(contacts, found, strict=True)
        if isinstance(why, str)
    ]
    if complaints and not records:
        raise InputError(f"calibrate: no tap counts: {complaints[0]}")
    return calibrate(records, drive, instrument, population, sources), complaints


def save_model(path: Path, scene: Scene, device: DriveDevice) -> None:
    """Save a model file with the device in its new hand and the other parts of the scene's own model file."""
    path.unlink(missing_ok=True)
    if isinstance(scene.model, IdentifiedModel):
        if scene.model.amplifier is not None:
            save_part(path, "amplifier", scene.model.amplifier)
        if scene.model.coil is not None:
            save_part(path, "coil", scene.model.coil)
    save_part(path, "device", device)


@dataclass(frozen=True)
class Tried:
    """Errors of a node played with two libraries, both against the tap that the new one tracks; NaN if no tap counts.

    Attributes
    ----------
    before, after : tap error and felt error, means over the taps, with the old and with the new library.
    """

    node: Node
    before: tuple[float, float]
    after: tuple[float, float]


def tried(
    nodes: Sequence[Node],
    library: Library,
    before: Sequence[Contact],
    after: Sequence[Contact],
    settings: tuple[Settings, Settings],
    accelerometer: Accelerometer,
) -> list[Tried]:
    """Errors of the new and of the old library at each node, measured by the device's own sensors.

    Parameters
    ----------
    library : the new library. before, after : taps played with the old and with the new library.
    """

    def means(contacts: Sequence[Contact], known: Settings, node: Node) -> tuple[float, float]:
        own = [each for each in contacts if node_near(library, each.speed_m_s, each.grip_N) == node]
        compared = [played_tap(each, library, known, 1.0, accelerometer).compared for each in own]
        figures = np.array([[each.tap_error, each.felt_error] for each in compared]).reshape(-1, 2)
        known_ones = figures[np.isfinite(figures).all(axis=1)]
        return tuple(known_ones.mean(axis=0).tolist()) if len(known_ones) else (np.nan, np.nan)

    return [Tried(node, means(before, settings[0], node), means(after, settings[1], node)) for node in nodes]


def judged(each: Sequence[Tried]) -> tuple[str, bool]:
    """A sentence that compares the new library with the old one, and whether the new one may be used."""
    pairs = np.array([[one.before, one.after] for one in each])
    pairs = pairs[np.isfinite(pairs).all(axis=(1, 2))]
    if not len(pairs):
        return "no node was played with both libraries: whether the new one is better is not known", False
    (tap, felt), (new_tap, new_felt) = pairs.mean(axis=0)
    said = (
        f"tap error {100 * tap:.1f} -> {100 * new_tap:.1f} %, felt error {100 * felt:.1f} -> {100 * new_felt:.1f} %"
    )
    gains = np.array([tap - new_tap, felt - new_felt])
    if gains.min() < -MOST_LOSS and gains.max() < -2 * gains.min():
        return f"worse than the library that was played: {said}: keep that one", False
    if gains.max() < LEAST_GAIN:
        return f"no better than the library that was played, whose hand this one is like: {said}", True
    return f"better than the library that was played: {said}", True
