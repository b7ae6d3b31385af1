"""What a device is given to play: configuration and image, of a library's transients or of one excitation."""

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

EXCITATION_LIMIT_A = 1.25  # of a device that knows no coil: what the built-in motor bears continuously
TRIAL_HZ, TRIAL_S, TRIAL_A = (20.0, 500.0), 0.5, 0.5  # of the bring-up check, at its gain
ROUNDED = 1e-9  # of a limit
# A blocked rotor stands still, and a held stylus moves less than a count at high frequencies.
NEVER_STUCK: dict[str, Any] = {"stuck_A_s": 1e3, "stuck_s": LONGEST_S}


def load_playable(path: str | Path) -> Library:
    """Read, prove and look at a library before anything of it is played.

    Raises
    ------
    InputError : what `load_proven` refuses; a library of voltages or of named targets.
    """
    library = load_proven(path)
    if library.axes.targets or library.axes.places or library.driven_by.unit != "A":
        raise InputError(
            f"{path}: has {library.axes.said} and commands in {library.driven_by.unit}; a stylus on a motor plays "
            "currents over speeds and grips: `transopt export` writes the waveforms of this one"
        )
    return library


@dataclass(frozen=True)
class Load:
    """Bytes of `configuration_of` these settings, and of `image_of` what they play."""

    settings: Settings
    configuration: bytes
    image: bytes


@dataclass(frozen=True)
class Payload(Load):
    """Load with the library that it was made of, and the device that it was made for."""

    library: Library
    device: DeviceFile = BUILT_IN


AnyLoad = TypeVar("AnyLoad", bound=Load)


def fitted(given: AnyLoad, capacity: Capacity) -> tuple[AnyLoad, str]:
    """What a device of this capacity is given, and what that costs in words; empty where all of it fits.

    Cool commands, those for a hot coil, go to 8 bit where 16 do not fit, and stay behind where 8 do not either.
    An image whose first waveforms alone are too large comes back as it is.
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
    InputError : no library, or one that this device cannot play.
    """
    return payload_of(load_proven(path), device=device)


def payload_of(
    library: Library, table: Bank | None = None, *, device: DeviceFile = BUILT_IN, **settings: Any
) -> Payload:
    """
    Parameters
    ----------
    device : what it is to be played on.
    table : of another method than the library's own; its waveforms are followed by as many zeros as the library's.
    settings : other than library and device say, see `Settings`.

    Raises
    ------
    InputError : one that this device cannot play.
    """
    numbers = {**library_numbers(device, library), **pulse_numbers(device, library)}
    stated = Settings.of(library, **{**numbers, **settings})
    tail = library.hand_over_samples
    table = bank(library, Method.BILINEAR) if table is None else _with_tail(table, tail)
    image = image_of(table, stated.dt_s, stated.lead_s, tail, amplifier=stated.amplifier)
    return Payload(stated, configured(stated), image, library, device)


def _with_tail(table: Bank, samples: int) -> Bank:
    """A table whose waveforms are followed by so many zeros."""
    room = ((0, 0), (0, 0), (0, samples))
    cool = None if table.cool_command_A is None else np.pad(table.cool_command_A, room)
    return replace(table, command_A=np.pad(table.command_A, room), cool_command_A=cool)


def excitation_settings(
    hello: HelloReply, library: Path | None, device: DeviceFile = BUILT_IN, pushed: float | None = None
) -> Settings:
    """Settings under which the host starts what plays.

    They say nothing of the excitation, so that a configuration that has passed the check is good for all of them.

    Parameters
    ----------
    hello : of the device; asked for nothing beyond its hardware.
    library : whose limits, amplifier and coil hold. Without one those that the device says it has: its own limit
        where it knows its coil, else 1.25 A and the built-in coil; the built-in pole as far as the hardware has it.
    device : its encoder and sensors.
    pushed : what a test pulse was measured to do [m/s^2 per A], its prediction where no library has one.

    Raises
    ------
    InputError : no library.
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
    """Name the first number that the device refuses as beyond its hardware, which it says by its value alone.

    Raises
    ------
    InputError : there is one.
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
    for name, value, low, high, unit in asked:
        if not low <= value <= high * (1 + ROUNDED):
            allowed = f"up to {high:g}" if low == 0 else f"{low:g} to {high:g}"
            raise InputError(
                f"{name} = {value:g} {unit}: more than the hardware allows, {allowed} {unit} by the port's "
                "hardware.h: lower it in the scene, or state it in the circuit file and flash the new hardware.h"
            )


def _excitation_limit_A(hello: HelloReply, device: DeviceFile) -> float:
    """Most current without a library: the hardware's where a known coil stops the heat, else a careful one."""
    if not hello.has_coil:
        return min(EXCITATION_LIMIT_A, hello.current_A * device.amplifier.part)
    read_A = hello.over_current_A * min(abs(device.amplifier.monitor_scale), 1.0) / Settings.over_current
    return min(hello.current_A * device.amplifier.part, read_A)


def _coil(hello: HelloReply) -> CoilModel:
    """The coil that the device says it has, at its warmest surroundings; the built-in one where it says nothing."""
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
    """Settings for a scene's own device, whose amplifier may be off by this part."""
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
    """A short one for the bring-up check, under the settings of all others; see `excitation_settings`.

    Raises
    ------
    InputError : no library.
    """
    settings = excitation_settings(hello, library, device, pushed)
    size_A = min(TRIAL_A, 0.5 * settings.current_limit_A)
    return excitation(settings, sweep_command(*TRIAL_HZ, TRIAL_S, size_A, settings.dt_s), hello)


def excitation(settings: Settings, command_A: FloatArray, hello: HelloReply) -> Load:
    """What a device needs to play a command (N,) [A] at the host's word; the last sample is zero.

    Raises
    ------
    InputError : more samples than the device holds, more current than the settings allow, more heat than the coil
        takes from its start.
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
    """The configuration of these settings without its surface, which is sent apart.

    So the surface may move, by `zero` or by drift, and what the device has seen under the configuration stands.
    """
    return configuration_of(replace(settings, surface_counts=0.0))
