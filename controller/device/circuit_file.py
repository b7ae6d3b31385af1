"""A circuit file read, and what is written from it: the sketch's hardware block, a scene, a device file."""

import math
import re
import tempfile
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path

from controller.device import circuit as parts
from controller.device.circuit import Circuit, Scale, Scales
from controller.device.device_file import Accelerometer, DeviceFile, Encoder, Grip
from controller.device.reading import as_text
from controller.protocol.capacity import Hardware
from transopt.base.errors import InputError
from transopt.base.toml import read_section
from transopt.plant.motor import Motor
from transopt.scene.builtin import FOLDER, scene_path
from transopt.scene.file import read_scene
from transopt.scene.scene import Scene

ADVICE = "a circuit file is TOML; `transopt-play device circuit --example escon_re25` prints one"
BLOCK, SCENE, OFFERED = "hardware.h", "scene.toml", "offered.toml"
SOURCE = "wood_on_foam"  # of what the scene states beside the device
WINDOW_S = 0.08
CIRCUITS = {path.stem: path for path in sorted((Path(__file__).parent / "circuits").glob("*.toml"))}
AS_A_SCENE = """\
# The device of {file}; `transopt-play device circuit` wrote it. Targets are those of the built-in scene {source}:
# put your own taps in the place of [recordings.simulated]. What moves is taken from a model file by --model.
"""


@dataclass(frozen=True)
class Electronics:
    """A circuit with everything that follows from it; `hardware` is what the port is compiled with."""

    circuit: Circuit
    motor: Motor
    scales: Scales
    hardware: Hardware


def read_circuit(path: Path) -> Circuit:
    """
    Raises
    ------
    InputError : the file cannot be read, or says what no circuit can be.
    """
    return read_section(path, Circuit, ADVICE)[0]


def scene_text(circuit: Circuit, file: str, continuous_A: float) -> str:
    """A copy of the built-in scene with the motor, the amplifier and the limits of a circuit."""
    power, text = circuit.power, scene_path(SOURCE).read_text(encoding="utf-8")
    text = text[text.index("description") :]
    for key, value in (
        ("description", f'"{circuit.name}"'),
        ("motor", f'"{circuit.motor}"'),
        ("transmission", f'"{circuit.transmission}"'),
        ("dt_s", f"{circuit.dt_s!r}"),
        ("stages", f"{round(WINDOW_S / circuit.dt_s)}"),
        ("pole_Hz", f"{power.pole_Hz!r}"),
        ("delay_s", f"{power.delay_s!r}"),
        ("command_limit_A", f"{power.command_A!r}"),
        ("steady_current_A", f"{min(continuous_A, power.current_A)!r}"),
        ("beta", f"{power.current_A!r}"),
    ):
        text, found = re.subn(
            rf"^{key} *=.*$", f"{'current_A' if key == 'beta' else key} = {value}", text, flags=re.M
        )
        assert found == 1, key
    return AS_A_SCENE.format(file=file, source=SOURCE) + text


def electronics_of(circuit: Circuit, scene: Scene) -> Electronics:
    """Scales and hardware of a circuit, whose motor and transmission the scene has read."""
    motor, transmission, power = scene.motor, scene.transmission, circuit.power
    if motor is None or transmission is None:
        raise InputError(f"{circuit.name}: state motor and transmission, by which counts become a way")
    found = parts.scales(circuit, motor, transmission.ratio_1_m)
    pole_Hz = power.pole_Hz if found.loop is None else found.loop.pole_Hz
    hardware = Hardware(
        dt_s=circuit.dt_s,
        current_A=power.current_A,
        command_A=power.command_A,
        pole_least_Hz=pole_Hz / parts.POLE_ROOM,
        pole_most_Hz=pole_Hz * parts.POLE_ROOM,
        over_current_A=parts.OVER_CURRENT * power.current_A,
        has_coil=True,
        R_ohm=motor.R_ohm,
        R_wh_K_W=motor.R_wh_K_W,
        R_ha_K_W=motor.R_ha_K_W,
        tau_w_s=motor.tau_w_s,
        tau_h_s=motor.tau_h_s,
        limit_C=motor.winding_max_C,
        ambient_C=power.ambient_C,
    )
    return Electronics(circuit, motor, found, hardware)


def load_circuit(path: Path) -> tuple[Electronics, str]:
    """A circuit file with what follows from it, and the text of its scene, which has been read as one.

    Raises
    ------
    InputError : the file, or a motor or a transmission that it names, cannot be read or cannot be.
    """
    circuit = read_circuit(path)
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / SCENE
        trial.write_text(scene_text(circuit, path.name, circuit.power.current_A), encoding="utf-8")
        try:
            scene = read_scene(trial, search=(path.parent, FOLDER))
        except InputError as error:
            said = str(error).replace(str(trial), str(path)).replace("limits.current_A", "power.current_A")
            raise InputError(re.sub(rf"{re.escape(folder)}[^,]*, ", "", said)) from None
    built = electronics_of(circuit, scene)
    return built, scene_text(circuit, path.name, built.motor.i_continuous_A)


def block_text(built: Electronics, file: str) -> str:
    """The header that a port includes, in C and C++: period, hardware, scales."""
    s, h = built.scales, built.hardware
    rows = "".join(f"    {_number(value)},\n" for value in astuple(h))
    inputs = {"CURRENT_A": s.current, "ACCELERATION_M_S2": s.acceleration}
    if s.grip is not None:
        inputs["GRIP_N"] = s.grip
    lines = [f"static const td_scale {name} = {{{_scale(scale)}}};" for name, scale in inputs.items()]
    return f"""\
/* {built.circuit.name}: written by `transopt-play device circuit {file}`. Change that file, not this one.
 *
 * Amplifier and motor are good for this: a host may only ask for less. Current and command limits hold for every pole
 * of the amplifier between the two. */
#ifndef TRANSOPT_HARDWARE_H
#define TRANSOPT_HARDWARE_H
#include <transopt_device.h>

#ifndef COMMAND_BY_DAC
#define COMMAND_BY_DAC {int(built.circuit.converter.output == "dac")}
#endif
#define HAS_GRIP {int(s.grip is not None)}
#define CONVERTER_BITS {built.circuit.converter.bits}

/* value = (counts - zero_counts) * per_count; outside least..most counts there is no number, since a sensor at the
 * rail is a broken wire or a short. */
typedef struct {{
    float per_count, zero_counts;
    int least, most;
}} td_scale;

/* In the order of td_hardware: servo period [s]; current, command, test pulse [A] and its length [s]; slowest and
 * fastest pole [Hz]; over-current [A]; whether the coil is known, winding at 25 C [ohm], thermal resistances [K/W],
 * time constants [s], limit of the winding and warmest surroundings [C]. */
static const td_hardware HARDWARE = {{
{rows}}};
{chr(10).join(lines)}
/* The command: counts = OUTPUT_ZERO + A * OUTPUT_PER_A. */
static const int OUTPUT_MOST = {built.circuit.converter.counts - 1};
static const float OUTPUT_ZERO = {_single(s.output_zero)};
static const float OUTPUT_PER_A = {_single(s.output_per_A)};
static const float PWM_HZ = {_single(built.circuit.converter.pwm_Hz)};
#endif
"""


def _number(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(float(value))


def _single(value: float) -> str:
    text = f"{value:.7g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


def _scale(scale: Scale) -> str:
    return f"{_single(scale.per_count)}, {_single(scale.zero_counts)}, {scale.least}, {scale.most}"


def device_of(built: Electronics) -> DeviceFile:
    """What the circuit says of a device file; the rest is asked for, or measured."""
    circuit = built.circuit
    return DeviceFile(
        name=circuit.name,
        encoder=Encoder(count_m=built.scales.count_m, direction=circuit.encoder.direction),
        grip=Grip(sensor=circuit.grip is not None),
        accelerometer=Accelerometer(
            bandwidth_Hz=circuit.accelerometer.bandwidth_Hz,
            rest_m_s2=9.81,
            range_g=round(built.scales.range_g, 2),
        ),
    )


def write_files(built: Electronics, scene: str, path: Path, *, force: bool) -> list[Path]:
    """Header, scene and offered device file beside the circuit file.

    Raises
    ------
    InputError : one is there already, or cannot be written.
    """
    texts = {
        BLOCK: block_text(built, path.name),
        SCENE: scene,
        OFFERED: as_text(
            device_of(built), f"From {path.name}: `transopt-play device new device.toml --from {OFFERED}`."
        ),
    }
    places = [path.with_name(name) for name in texts]
    for place in places:
        if place.exists() and not force:
            raise InputError(f"{place}: is there already; --force writes it anew")
    try:
        for place, text in zip(places, texts.values(), strict=True):
            place.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path.parent}: cannot be written ({error.strerror}); choose another place") from None
    return places


def rows_of(built: Electronics) -> Iterator[tuple[str, str, str]]:
    """What a person solders and checks: name, value, remark."""
    s, c = built.scales, built.circuit
    for stage in (s.command, s.monitor):
        for name, ohm in ({} if stage is None else stage.parts).items():
            yield name, f"{ohm:g} ohm", f"E96, {100 * c.resistors:g} %"
    if s.loop is not None:
        for name, ohm in (("R7", s.loop.R7_ohm), ("R8", s.loop.R8_ohm), ("R9", s.loop.R9_ohm)):
            yield name, f"{ohm:g} ohm", f"E96, {100 * c.resistors:g} %"
        yield "C1", f"{1e9 * s.loop.C1_F:g} nF", f"E24; loop's pole {s.loop.pole_Hz:.0f} Hz"
    if c.converter.output == "pwm":
        R, C, ripple_A, lag_s = pwm_filter(built)
        yield "R10, R11", f"{R:g}, {10 * R:g} ohm", "filter of the PWM, before the circuit"
        yield "C2, C3", f"{1e9 * C:g}, {1e8 * C:g} nF", f"{ripple_A:.2g} A of ripple; {1e6 * lag_s:.0f} µs later"
    command = f"± {100 * s.command_off:.2g} %, ± {s.command_off_A:.2g} A at zero, by the resistors"
    yield "OUTPUT_PER_A", f"{s.output_per_A:.4f} counts/A", command
    yield "OUTPUT_ZERO", f"{s.output_zero:.2f} counts", "trim it until no current flows"
    monitor = f"± {100 * s.monitor_off:.2g} %, ± {s.monitor_off_A:.2g} A at zero, by the resistors"
    yield "CURRENT_A", _in_words(s.current, "A"), monitor
    if s.monitor is None:
        yield "R6", "1 Mohm", "from the monitor to ground, so that a wire that is off reads a rail"
    wire = "reads a rail, which is a fault" if s.open_A is None else f"reads {s.open_A:+.2g} A"
    yield "", "", f"a monitor's wire that is off {wire}"
    yield (
        "ACCELERATION_M_S2",
        _in_words(s.acceleration, "m/s²"),
        f"pole {c.accelerometer.bandwidth_Hz:g} Hz, range {s.range_g:.3g} g",
    )
    if s.grip is not None:
        open_N = (s.grip.least - s.grip.zero_counts) * s.grip.per_count
        yield "GRIP_N", _in_words(s.grip, "N"), f"a wire at ground reads {open_N:.2g} N; a fault below -1 N"
    yield "encoder.count_m", f"{1e6 * s.count_m:.3f} µm", f"{c.encoder.lines} lines, four edges each"


def _in_words(scale: Scale, unit: str) -> str:
    return f"(counts - {scale.zero_counts:.2f}) * {scale.per_count:.6g} {unit}"


def pwm_filter(built: Electronics) -> tuple[float, float, float, float]:
    """Two RC stages before the circuit, the second of ten times the resistance: R [ohm], C [F], ripple, lag.

    Returns
    -------
    Resistor and capacitor of the first stage; amplitude of what is left of the PWM's fundamental at half duty, as a
    current [A]; lag [s], the first moment of the impulse response.
    """
    converter = built.circuit.converter
    R = 1e3
    C = parts.of_series(1 / (2 * math.pi * converter.pwm_Hz / 12 * R), parts.E24)
    s = 2j * math.pi * converter.pwm_Hz * R * C
    # R into C, then 10 R into C / 10.
    passed = abs(1 / (1 + 2.1 * s + s * s))
    amplitude_V = 2 / math.pi * converter.supply_V
    counts_per_V = converter.counts / converter.supply_V
    return R, C, passed * amplitude_V * counts_per_V / built.scales.output_per_A, 2.1 * R * C
