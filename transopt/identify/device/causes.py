"""What the records have beside the model, by name, and what to do about it."""

from collections.abc import Sequence
from dataclasses import astuple

import numpy as np

from transopt.identify.device.black_box import BlackBox
from transopt.identify.device.chain_fit import ChainFit
from transopt.identify.device.effects import (
    CROSSOVER,
    SHORTFALL,
    Missed,
    current_missed,
    distortion,
    named,
    named_by_lines,
)
from transopt.identify.device.result import Candidate, Kind
from transopt.identify.device.trials import BAND_HZ, Grip
from transopt.identify.findings import Fault, Finding
from transopt.identify.measurement import Measurement
from transopt.scene.model_error import ModelError

READ_LATE = 0.02  # samples, from which on it is said
RINGS, MOST_HZ = 0.3, 2000.0  # damping ratio of a resonance, and the highest that is named
DISTORTED = 0.01  # of the answer, from which on distortion is said
CLOCKS_ALIKE, CLOCKS_APART = 1e-3, 0.05  # relative: closer is one clock, farther another rate
REMEDIES = {
    "friction": "refine the library on the device (transopt-play refine), or loosen bearings and guides",
    "backlash": "preload the transmission; no library makes up for play",
    "stiffening": "record at the amplitude that is played, and refine the library on the device",
}


def two_clocks(recorded_s: float, servo_s: float | None) -> list[str]:
    """Why records cannot serve whose rate is almost, but not quite, the servo's: one of two clocks is wrong."""
    if servo_s is None or not CLOCKS_ALIKE < abs(recorded_s / servo_s - 1) < CLOCKS_APART:
        return []
    return [
        f"clock: the files state {1 / recorded_s:.6g} samples per second, the scene's servo has {1 / servo_s:.6g}: "
        f"one of the two is {100 * abs(recorded_s / servo_s - 1):.2g} % off, and with it every spring and mass; "
        "state the servo's own time in the files, or its period in the scene (time.dt_s)"
    ]


def distorted(run: Measurement) -> Finding | None:
    """What the detection lines of a periodic record say; None where they are quiet."""
    found = distortion(run)
    if found is None or found.largest < DISTORTED:
        return None
    return Finding(Fault.BESIDE, run.name, found.words(), False)


def causes_of(
    chosen: Candidate,
    chain: ChainFit | None,
    grips: Sequence[Grip],
    used: Sequence[Missed],
    error: ModelError,
    repeated: Sequence[Measurement],
) -> tuple[list[str], list[Finding]]:
    """What the records have beside the model, by name, and what to do about it."""
    found: list[tuple[str, Finding]] = []

    def say(cause: str, where: str, text: str) -> None:
        found.append((cause, Finding(Fault.BESIDE, where, text, False)))

    if chain is not None and chosen.kind is Kind.DRIVE:
        stated = next((run.accelerometer_Hz for grip in grips for run in grip.fitted), None)
        for one in chain.nuisances:
            if one.name == "accelerometer_pole":
                about = "no file states it" if stated is None else f"the files state {stated:g} Hz"
                text = f"{one.value:.4g} +- {2 * one.deviation:.2g} Hz found, {about}: taken out of the records"
                say("unstated accelerometer pole", "accelerometer pole", text)
            elif one.name == "late" and abs(one.value) > READ_LATE:
                text = f"read {one.value:+.3g} samples after the current: taken out; read both at the same tick"
                say("read delay", "acceleration", text)
            elif one.name == "gain" and abs(one.value - 1) > 0.01:
                text = (
                    f"{one.value:.4g} times what the encoder says: taken for the accelerometer's gain and taken out; "
                    "check the scales of both"
                )
                say("accelerometer gain", "acceleration", text)
        gain = chain.instrument.amplifier_gain
        if abs(gain - 1) > 0.02:
            text = f"{gain:.4g} A per A of command: correct the scale of the command or of the current monitor"
            say("monitor scale", "current_A", text)
    if chain is not None and chain.varying.any():
        most = float(np.sqrt(chain.maximum.between[: chain.coordinates.size][chain.varying].max()))
        text = (
            f"the hand differs between trials by {most:.2g} times what their noise explains: "
            "the intervals are that much wider; hold the stylus steadily, or add trials"
        )
        say("varying hand", "trials", text)
    by_lines = [] if chain is None else named_by_lines(chain, repeated)
    for cause, share in by_lines:
        told = "neither friction nor stiffening explains" if cause == "backlash" else "explains"
        text = f"{told} {100 * share:.0f} % of what sounds at lines that were not excited: {REMEDIES[cause]}"
        say(cause, "multisines", text)
    loud = [one for one, tap in zip(used, error.at_use, strict=True) if tap.excess]
    if loud:
        worst = max(tap.excess for tap in error.at_use)
        currents = [current_missed(chosen.instrument, one.run) for one in loud]
        fallen, crossover_A = (max(values) for values in zip(*map(astuple, currents), strict=True))
        if fallen > SHORTFALL:
            text = (
                f"the current falls {100 * fallen:.2g} % short of the largest command: lower limits.current_A, or "
                "raise the supply"
            )
            say("amplifier saturation", "current_A", text)
        elif crossover_A > CROSSOVER:
            text = (
                f"the amplifier follows no command below {1e3 * crossover_A:.2g} mA, so small currents lose most: "
                "identify the amplifier too, and refine the library on the device"
            )
            say("amplifier crossover", "current_A", text)
        listened = any(distortion(run) is not None for run in repeated)  # detection lines know better than taps
        if chain is not None and not listened:
            for cause, share in named(chain, loud):
                text = (
                    f"explains {100 * share:.0f} % of what taps at full current miss ({100 * worst:.2g} %): "
                    f"{REMEDIES[cause]}"
                )
                say(cause, "taps at full current", text)
    return [cause for cause, _ in found], [finding for _, finding in found]


def beyond_a_chain(box: BlackBox) -> Finding:
    """What a black box has that no chain of drive and hand makes: its resonances at the middle grip, for the user."""
    poles = np.linalg.eigvals(box.plants[len(box.plants) // 2].A)
    rings = (poles.imag > 0) & (-poles.real < RINGS * np.abs(poles))
    named_Hz = sorted(np.abs(poles[rings]) / (2 * np.pi))
    at = ", ".join(f"{value:.3g} Hz" for value in named_Hz if BAND_HZ[0] <= value <= MOST_HZ)
    text = (
        f"no chain of drive and hand makes what is recorded; resonances of the state space: {at or 'none'}; "
        "a part that swings by itself, or a hand that goes its own way with the grip: tighten what is loose"
    )
    return Finding(Fault.BESIDE, "further dynamics", text, False)
