"""The data that a device plays from: configuration and image, of a library's transients or of one excitation."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from controller.device.device_file import BUILT_IN, DeviceFile
from controller.device.stated import assumed_grip_N, library_numbers, servo_numbers
from controller.host.pulses import measured_numbers, pulse_numbers
from controller.protocol.capacity import LONGEST_S, Capacity
from controller.protocol.configuration import configuration_of
from controller.protocol.image import bank_of, image_of, too_large
from controller.protocol.messages import HelloReply
from controller.record.excitation import sweep_command
from controller.servo.settings import AMPLIFIER, RE_25, Settings
from controller.waveforms.bank import Bank, Method, bank
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.writing import rounded_down
from transopt.library.library import Library
from transopt.library.proven import load_proven
from transopt.plant.coil import CoilModel
from transopt.problem.warm_coil import WarmCoil, currents, norms
from transopt.scene.scene import Scene

EXCITATION_LIMIT_A = 1.25  # for a device without a coil model: the continuous current of the built-in motor
TRIAL_HZ, TRIAL_S, TRIAL_A = (20.0, 500.0), 0.5, 0.5  # sweep of the bring-up check, before its gain
ROUNDED = 1e-9  # relative rounding error allowed in a limit
# Disables the stuck-sensor check: a blocked rotor stands still, and a held stylus moves by less than a count at high
# frequencies.
NEVER_STUCK: dict[str, Any] = {"stuck_A_s": 1e3, "stuck_s": LONGEST_S}


def load_playable(path: str | Path) -> Library:
    """Read and prove a library, and check that a device of this kind can play it.

    Raises
    ------
    InputError : `load_proven` refuses it, or it is a library of voltages, of places or of named targets.
    """
    library = load_proven(path)
    if library.axes.targets or library.axes.places or library.driven_by.unit != "A":
        raise InputError(
            f"{path}: has {library.axes.in_words} and commands in {library.driven_by.unit}; a stylus on a motor "
            "plays currents over speeds and grips: `transopt export` writes the waveforms of this one"
        )
    return library


@dataclass(frozen=True)
class Load:
    """Settings with their configuration (`configuration_of`) and the image to play (`image_of`), in bytes."""

    settings: Settings
    configuration: bytes
    image: bytes


@dataclass(frozen=True)
class Payload(Load):
    """A load with its library and its device."""

    library: Library
    device: DeviceFile = BUILT_IN


AnyLoad = TypeVar("AnyLoad", bound=Load)


def fitted(given: AnyLoad, capacity: Capacity) -> tuple[AnyLoad, str]:
    """The load reduced to the capacity of a device, and a phrase on what is lost; empty if all of it fits.

    Cool commands, those for a hot coil, are stored in 8 bits if 16 do not fit, and left out if 8 do not fit either.
    An image that is too large even without cool commands is returned unchanged.
    """
    table, head = bank_of(given.image)
    if table.cool_command_A is None or too_large(given.image, capacity) is None:
        return given, ""
    s = given.settings
    for bits, words in (
        (8, "keeps the cool commands in 8 bit, so that taps of a hot coil are up to 1 % of their peak off"),
        (0, "has no room for the cool commands: taps of a hot coil are scaled down instead of made cooler"),
    ):
        image = image_of(table, s.dt_s, s.lead_s, head["tail_samples"], cool_bits=bits, amplifier=s.amplifier)
        if too_large(image, capacity) is None:
            return replace(given, image=image), f"this device {words}"
    return given, ""


def payload(path: Path, device: DeviceFile = BUILT_IN) -> Payload:
    """
    Raises
    ------
    InputError : the file is no library, or the device cannot play it.
    """
    return payload_of(load_proven(path), device=device)


def payload_of(
    library: Library, table: Bank | None = None, *, device: DeviceFile = BUILT_IN, **settings: Any
) -> Payload:
    """
    Parameters
    ----------
    device : the device to play it on.
    table : waveforms of another method than the library's own; they get the same number of trailing zeros.
    settings : overrides of the settings by library and device, see `Settings`.

    Raises
    ------
    InputError : the device cannot play the library.
    """
    numbers = {**library_numbers(device, library), **pulse_numbers(device, library)}
    stated = Settings.of(library, **{**numbers, **settings})
    tail = library.hand_over_samples
    table = bank(library, Method.BILINEAR) if table is None else _with_tail(table, tail)
    image = image_of(table, stated.dt_s, stated.lead_s, tail, amplifier=stated.amplifier)
    return Payload(stated, configured(stated), image, library, device)


def _with_tail(table: Bank, samples: int) -> Bank:
    """The table with `samples` zeros appended to each waveform."""
    room = ((0, 0), (0, 0), (0, samples))
    cool = None if table.cool_command_A is None else np.pad(table.cool_command_A, room)
    return replace(table, command_A=np.pad(table.command_A, room), cool_command_A=cool)


def excitation_settings(
    hello: HelloReply, library: Path | None, device: DeviceFile = BUILT_IN, pushed: float | None = None
) -> Settings:
    """Settings for excitations that the host starts.

    They do not depend on the excitation, so a configuration that has passed the check serves all excitations.

    Parameters
    ----------
    hello : the device's reply to HELLO, with the limits of its hardware.
    library : file whose limits, amplifier and coil apply. None takes those of the device: its own limit if it has a
        coil model, else 1.25 A and the built-in coil; and the built-in pole, clipped to the hardware's range.
    device : device file with encoder and sensors.
    pushed : measured response to a test pulse [m/s^2 per A], its prediction without a library.

    Raises
    ------
    InputError : the file is no library.
    """
    if library is not None:
        loaded = load_proven(library)
        numbers = {**library_numbers(device, loaded), **pulse_numbers(device, loaded), **NEVER_STUCK}
        return Settings.of(loaded, **{**numbers, "lead_s": 0.0, "wall": None, "host_starts": True})
    part = device.amplifier.part
    pole_Hz = min(max(AMPLIFIER.pole_Hz, hello.pole_least_Hz), hello.pole_most_Hz)
    command_A = min(AMPLIFIER.command_limit, hello.command_A * part)
    return Settings(
        dt_s=hello.dt_s,
        lead_s=0.0,
        current_limit_A=_excitation_limit_A(hello, device),
        amplifier=replace(AMPLIFIER, pole_Hz=pole_Hz, command_limit=command_A),
        coil=_coil(hello),
        host_starts=True,
        assumed_grip_N=assumed_grip_N(device, ()),
        **({} if pushed is None else measured_numbers(device, hello.dt_s, pushed)),
        **{**servo_numbers(device, hello.dt_s), **NEVER_STUCK},
    )


def need_hardware(settings: Settings, hello: HelloReply) -> None:
    """Check the settings against the device's hardware and name the field; the device itself reports the value only.

    Raises
    ------
    InputError : a setting exceeds the hardware's range.
    """
    s, amplifier = settings, settings.amplifier
    scale, monitor = (min(abs(part), 1.0) for part in (s.amplifier_scale, s.monitor_scale))
    asked = [
        ("limits.current_A", s.current_limit_A / scale, 0.0, hello.current_A, "A"),
        ("amplifier.command_limit_A", s.command_limit_A / scale, 0.0, hello.command_A, "A"),
        ("measured current", s.over_current * s.current_limit_A / monitor, 0.0, hello.over_current_A, "A"),
    ]
    if amplifier is not None:
        for off in (-s.amplifier_tolerance, s.amplifier_tolerance):
            pole_Hz = amplifier.pole_Hz * (1 + off)
            asked.append(("amplifier.pole_Hz", pole_Hz, hello.pole_least_Hz, hello.pole_most_Hz, "Hz"))
    if hello.has_coil and settings.coil is not None:
        asked.append(("motor.winding_max_C", settings.coil.limit_C, 0.0, hello.limit_C, "C"))
    for name, value, low, high, unit in asked:
        if not low <= value <= high * (1 + ROUNDED):
            allowed = f"up to {high:g}" if low == 0 else f"{low:g} to {high:g}"
            raise InputError(
                f"{name} = {value:g} {unit}: more than the hardware allows, {allowed} {unit} by the port's "
                "hardware.h: lower it in the scene, or state it in the circuit file and flash the new hardware.h"
            )


def heat_in_words(settings: Settings, hello: HelloReply) -> str:
    """A sentence on settings without a coil on a device that knows its own; empty otherwise.

    The device scales nothing for a warm coil then: its hardware's estimate ends what is played with a fault.
    """
    if settings.coil is not None or not hello.has_coil:
        return ""
    return (
        "no coil is stated for what is played, nothing is scaled for a warm one: the device's own estimate cuts at "
        f"{hello.limit_C:g} C (OVER_TEMPERATURE): state [motor] in the scene, or pause between taps"
    )


def _excitation_limit_A(hello: HelloReply, device: DeviceFile) -> float:
    """Current limit without a library: the hardware's if a coil model limits the heat, else a conservative one."""
    if not hello.has_coil:
        return min(EXCITATION_LIMIT_A, hello.current_A * device.amplifier.part)
    read_A = hello.over_current_A * min(abs(device.amplifier.monitor_scale), 1.0) / Settings.over_current
    return min(hello.current_A * device.amplifier.part, read_A)


def _coil(hello: HelloReply) -> CoilModel:
    """The coil model of the device at its highest ambient; the built-in one if the device has none."""
    if not hello.has_coil:
        return RE_25
    warm_C = hello.ambient_C
    return CoilModel(
        hello.R_ohm,
        hello.R_wh_K_W,
        hello.R_ha_K_W,
        hello.tau_w_s,
        hello.tau_h_s,
        hello.limit_C,
        ambient_C=warm_C,
        start_winding_C=warm_C,
        start_housing_C=warm_C,
    )


def excitation_settings_of(scene: Scene, amplifier_tolerance: float, device: DeviceFile = BUILT_IN) -> Settings:
    """Settings for the device of a scene, with a relative tolerance of its amplifier."""
    coil = scene.coil()
    return Settings(
        dt_s=scene.time.dt_s,
        lead_s=0.0,
        current_limit_A=scene.limits.transient_input,
        amplifier=scene.amplifier_model(),
        amplifier_tolerance=amplifier_tolerance,
        coil=None if coil is None else coil.on_a_device(),
        host_starts=True,
        assumed_grip_N=assumed_grip_N(device, ()),
        **{**servo_numbers(device, scene.time.dt_s), **NEVER_STUCK},
    )


def trial_sweep(
    hello: HelloReply, library: Path | None, device: DeviceFile = BUILT_IN, pushed: float | None = None
) -> Load:
    """The short sweep of the bring-up check, under the settings of all excitations; see `excitation_settings`.

    Raises
    ------
    InputError : the file is no library.
    """
    settings = excitation_settings(hello, library, device, pushed)
    size_A = min(TRIAL_A, 0.5 * settings.current_limit_A)
    return excitation(settings, sweep_command(*TRIAL_HZ, TRIAL_S, size_A, settings.dt_s), hello)


def excitation(settings: Settings, command_A: FloatArray, hello: HelloReply) -> Load:
    """The load for a command (N,) [A] that the host starts; its last sample is zero.

    Raises
    ------
    InputError : more samples than the device holds, more current than the settings allow, or more heat than the coil
        takes from its start temperatures.
    """
    s, N = settings, command_A.size
    room = min(hello.capacity_waveform_samples, hello.capacity_samples)
    if room < N:
        raise InputError(
            f"sweep: {N * s.dt_s:g} s at {1e-3 / s.dt_s:g} kHz are {N} samples, the device holds {room}: "
            f"--seconds {rounded_down(room * s.dt_s, 6):g} would fit"
        )
    current = currents(command_A[None, None], s.amplifier, s.dt_s)
    for what, peak, limit in (
        ("current", float(np.abs(current).max()), s.current_limit_A),
        ("command", float(np.abs(command_A).max()), s.command_limit_A),
    ):
        if peak > limit * (1 + 1e-9):
            raise InputError(
                f"sweep: the {what} reaches {peak:.3g} A, the limit is {limit:g} A: lower --amplitude, --offset "
                "or --tap-current, or take other limits (on a port --library, simulated --true-device)"
            )
    size = norms(current, s.amplifier, s.dt_s)
    if s.coil is not None:
        warm = WarmCoil.of(s.coil, s.dt_s, s.withhold_K, s.least_scale)
        winding_C, housing_C = s.coil.start_winding_C, s.coil.start_housing_C
        rise = warm.rise(winding_C, housing_C, float(size[0, 0]), 0.0, N + 1, 1.0)
        left = warm.play_limit_C - winding_C
        if rise > left:
            raise InputError(
                f"sweep: may heat the coil by {rise:.3g} K, {left:.3g} K are left below its limit: "
                "lower --amplitude, --offset or --seconds"
            )
    table = Bank(
        method=Method.BILINEAR,
        speeds_m_s=[1.0],
        grips_N=[0.0],
        command_A=command_A[None, None],
        transient_A=size.tolist(),
        feedback_A=[[0.0]],
        grip_min_N=0.0,
        by_grip=False,
        nearest=False,
    )
    return Load(s, configured(s), image_of(table, s.dt_s, s.lead_s, 1))


def configured(settings: Settings) -> bytes:
    """The configuration of these settings without the surface, which is sent separately.

    So the surface may move, by `zero` or by drift, without invalidating the evidence under the configuration.
    """
    return configuration_of(replace(settings, surface_counts=0.0))
