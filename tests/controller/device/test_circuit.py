"""Circuits against a nodal analysis of their own: conductances and one equation for each operational amplifier."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.device.circuit import (
    E24,
    E96,
    Accelerometer,
    Bridge,
    Circuit,
    Converter,
    Power,
    Servo,
    Shaft,
    divider,
    of_series,
    shift,
)
from controller.device.circuit_file import CIRCUITS, block_text, load_circuit, pwm_filter, rows_of, scene_text
from tests.benches.commands import Run, assert_refused
from tests.benches.places import ROOT
from transopt.base.errors import InputError
from transopt.scene.builtin import load_scene

SUPPLY_V = 3.3
GROUND = "ground"


def nodal(
    resistors: list[tuple[str, str, complex]], sources: dict[str, complex], ideal: dict[str, tuple[str, str]]
) -> dict[str, complex]:
    """Voltages of all nodes.

    Parameters
    ----------
    resistors : two nodes and ohms each, an impedance where it is complex.
    sources : voltages by node.
    ideal : inputs of an ideal operational amplifier by the node of its output: they are at one voltage, and its
        output gives whatever current that takes.
    """
    names = sorted({node for one, other, _ in resistors for node in (one, other)} | set(sources) | set(ideal))
    at = {name: j for j, name in enumerate(name for name in names if name != GROUND)}
    A, b = np.zeros((len(at), len(at)), dtype=complex), np.zeros(len(at), dtype=complex)
    for one, other, ohm in resistors:
        for here, there in ((one, other), (other, one)):
            if here == GROUND or here in sources or here in ideal:
                continue
            A[at[here], at[here]] += 1 / ohm
            if there != GROUND:
                A[at[here], at[there]] -= 1 / ohm
    for name, volt in sources.items():
        A[at[name], at[name]], b[at[name]] = 1.0, volt
    for output, (plus, minus) in ideal.items():
        A[at[output], at[plus]] += 1.0
        A[at[output], at[minus]] -= 1.0
    return dict(zip(at, np.linalg.solve(A, b), strict=True))


def shifted(parts: dict[str, float], in_V: float) -> float:
    """Output of the amplifier of `shift` for a voltage of the converter."""
    found = nodal(
        [("out", "minus", parts["R1"]), ("minus", "ref", parts["R2"]), ("minus", GROUND, parts["R3"])],
        {"ref": SUPPLY_V, "in": in_V},
        {"out": ("in", "minus")},
    )
    return float(found["out"].real)


def divided(parts: dict[str, float], monitor_V: float) -> float:
    """Voltage at the converter for one of the monitor."""
    resistors = [("monitor", "pin", parts["R4"]), ("pin", "ref", parts["R5"])]
    resistors += [("pin", GROUND, parts["R6"])] if "R6" in parts else []
    return float(nodal(resistors, {"ref": SUPPLY_V, "monitor": monitor_V}, {})["pin"].real)


def corners(parts: dict[str, float], off: float) -> list[dict[str, float]]:
    return [
        {name: ohm * (1 + sign * off) for (name, ohm), sign in zip(parts.items(), signs, strict=True)}
        for signs in itertools.product((-1, 0, 1), repeat=len(parts))
    ]


@settings(max_examples=20)
@given(out_V=st.floats(4.0, 15.0), off=st.sampled_from([0.001, 0.01]))
def test_a_shift_is_what_its_nodes_say_at_every_corner(out_V: float, off: float) -> None:
    stage = shift(SUPPLY_V, out_V, off)
    parts = dict(stage.parts)
    for in_V in (0.0, 1.0, SUPPLY_V):
        assert shifted(parts, in_V) == pytest.approx(stage.gain * (in_V - stage.zero_V), abs=1e-9)
    # Resistors of a series come near to what is asked.
    assert stage.gain == pytest.approx(2 * out_V / SUPPLY_V, rel=0.02)
    assert stage.zero_V == pytest.approx(SUPPLY_V / 2, rel=0.01)
    gains, zeros = [], []
    for corner in corners(parts, off):
        low, high = shifted(corner, 0.0), shifted(corner, SUPPLY_V)
        gains.append((high - low) / SUPPLY_V / stage.gain - 1)
        zeros.append(-low / (high - low) * SUPPLY_V - stage.zero_V)
    # What is stated is reached, and never passed.
    assert max(np.abs(gains)) == pytest.approx(stage.gain_off, rel=1e-6)
    assert max(np.abs(zeros)) == pytest.approx(stage.zero_off_V, rel=1e-6)


@settings(max_examples=20)
@given(in_V=st.floats(0.5, 12.0), off=st.sampled_from([0.001, 0.01]))
def test_a_divider_is_what_its_nodes_say_at_every_corner(in_V: float, off: float) -> None:
    stage = divider(SUPPLY_V, in_V, off)
    parts = dict(stage.parts)
    for monitor_V in (-in_V, 0.0, in_V):
        assert divided(parts, monitor_V) == pytest.approx(stage.zero_V + stage.gain * monitor_V, abs=1e-9)
        assert -0.03 <= divided(parts, monitor_V) <= SUPPLY_V + 0.03
    seen = [divided(one, 0.0) - stage.zero_V for one in corners(parts, off)]
    assert max(np.abs(seen)) == pytest.approx(stage.zero_off_V, rel=1e-6)


@pytest.mark.parametrize("name", CIRCUITS)
def test_printed_scales_bring_a_current_there_and_back(name: str) -> None:
    """From the counts of a command through circuit and amplifier to the counts of the monitor, by the nodes alone."""
    built, _ = load_circuit(CIRCUITS[name])
    s, circuit = built.scales, built.circuit
    V_per_count = SUPPLY_V / 4096
    for wanted_A in (-4.0, -0.1, 0.0, 2.5):
        pin_V = (s.output_zero + wanted_A * s.output_per_A) * V_per_count
        if circuit.servo is not None:
            flowing_A = shifted(dict(s.command.parts), pin_V) / circuit.servo.input_V_A
            read_V = divided(dict(s.monitor.parts), flowing_A * circuit.servo.monitor_V_A)
        else:
            assert circuit.bridge is not None
            flowing_A, read_V = settled(name, pin_V)
        assert flowing_A == pytest.approx(wanted_A, abs=1e-9)
        assert (read_V / V_per_count - s.current.zero_counts) * s.current.per_count == pytest.approx(
            wanted_A, abs=1e-9
        )


def settled(name: str, pin_V: float, off: tuple[float, ...] = (0.0,) * 5) -> tuple[float, float]:
    """Current at which the PI stage of a bridge rests, and what the shunt amplifier then gives.

    It rests where no current flows into its capacitor: the summing node is at the middle, by R7 and R8 alone.

    Parameters
    ----------
    off : by which the two resistors of the middle, R7, R8, and shunt with its amplifier are off.
    """
    built, _ = load_circuit(CIRCUITS[name])
    bridge, closed = built.circuit.bridge, built.scales.loop
    assert closed is not None
    halves = [("middle", "ref", 1e4 * (1 + off[0])), ("middle", GROUND, 1e4 * (1 + off[1]))]
    middle = float(nodal(halves, {"ref": SUPPLY_V}, {})["middle"].real)
    sense_V_A = bridge.shunt_ohm * bridge.sense_gain * (1 + off[4])

    def summing(current_A: float) -> float:
        sensed = middle - sense_V_A * current_A
        resistors = [
            ("in", "sum", closed.R7_ohm * (1 + off[2])),
            ("sensed", "sum", closed.R8_ohm * (1 + off[3])),
        ]
        return float(nodal(resistors, {"in": pin_V, "sensed": sensed}, {})["sum"].real) - middle

    current_A = -summing(0.0) / (summing(1.0) - summing(0.0))
    return current_A, middle - sense_V_A * current_A


def test_tolerances_of_a_bridge_are_reached_at_a_corner_and_never_passed() -> None:
    built, _ = load_circuit(CIRCUITS["bridge_re40"])
    s, circuit = built.scales, built.circuit
    V_per_count, one = SUPPLY_V / 4096, 1.0
    sizes = (*[circuit.resistors] * 4, circuit.bridge.sense_tolerance)
    gains, zeros, read = [], [], []
    for signs in itertools.product((-1, 1), repeat=5):
        off = tuple(sign * size for sign, size in zip(signs, sizes, strict=True))
        none_A, none_V = settled("bridge_re40", s.output_zero * V_per_count, off)
        some_A, some_V = settled("bridge_re40", (s.output_zero + one * s.output_per_A) * V_per_count, off)
        gains.append((some_A - none_A) / one - 1)
        zeros.append(none_A / (some_A - none_A))  # ampere of command that bring no current
        seen = [(volt / V_per_count - s.current.zero_counts) * s.current.per_count for volt in (none_V, some_V)]
        slope = (seen[1] - seen[0]) / (some_A - none_A)
        read.append((slope - 1, (seen[0] - slope * none_A) / 1.0))
    assert max(np.abs(gains)) == pytest.approx(s.command_off, rel=1e-6)
    assert max(np.abs(zeros)) == pytest.approx(s.command_off_A, rel=1e-6)
    assert max(abs(slope) for slope, _ in read) == pytest.approx(s.monitor_off, rel=1e-6)
    assert max(abs(zero) for _, zero in read) == pytest.approx(s.monitor_off_A, rel=1e-6)


def test_the_loop_of_a_bridge_is_one_pole_where_it_says() -> None:
    """Open loop by its nodes: PI stage, bridge and winding are an integrator that crosses one at the pole."""
    built, _ = load_circuit(CIRCUITS["bridge_re40"])
    bridge, closed, motor = built.circuit.bridge, built.scales.loop, built.motor
    for part in (0.3, 1.0, 3.0):
        s = 2j * np.pi * closed.pole_Hz * part
        feedback = closed.R9_ohm + 1 / (s * closed.C1_F)
        nodes = [("sensed", "sum", closed.R8_ohm), ("sum", "out", feedback), ("sum", "in", closed.R7_ohm)]
        out = nodal(nodes, {"sensed": 1.0, "in": 0.0, "zero": 0.0}, {"out": ("zero", "sum")})["out"]
        winding_A_V = 1 / (motor.R_ohm + s * motor.L_H)
        open_loop = -out * 2 * bridge.motor_V / bridge.triangle_V * winding_A_V * bridge.shunt_ohm * bridge.sense_gain
        # C1 of E24 misses the winding's own time constant by up to 5 %.
        assert open_loop * 1j * part == pytest.approx(1.0, abs=0.06)


def test_the_filter_of_a_pwm_lets_through_what_it_says() -> None:
    built, _ = load_circuit(CIRCUITS["escon_re25"])
    R, C, ripple_A, lag_s = pwm_filter(built)

    def passed(frequency_Hz: float) -> complex:
        s = 2j * np.pi * frequency_Hz
        nodes = [
            ("in", "mid", R),
            ("mid", GROUND, 1 / (s * C)),
            ("mid", "out", 10 * R),
            ("out", GROUND, 10 / (s * C)),
        ]
        return complex(nodal(nodes, {"in": 1.0}, {})["out"])

    square_V = 2 / np.pi * SUPPLY_V
    A_per_V = 4096 / SUPPLY_V / built.scales.output_per_A
    assert abs(passed(built.circuit.converter.pwm_Hz)) * square_V * A_per_V == pytest.approx(ripple_A, rel=1e-6)
    assert -np.angle(passed(1.0)) / (2 * np.pi) == pytest.approx(lag_s, rel=1e-3)


def test_series_are_those_of_the_standard() -> None:
    assert len(E24) == 24
    assert E96[:5] == (1.0, 1.02, 1.05, 1.07, 1.1)
    assert E96[-1] == 9.76
    assert [of_series(value) for value in (9.9e3, 4321.0, 1e-9, 99.9)] == [10e3, 4320.0, 1e-9, 100.0]


def test_a_wire_that_is_off_is_told_from_a_current() -> None:
    """Equal resistors: nothing holds the pin but the reference, which is no number to the port."""
    built, _ = load_circuit(CIRCUITS["escon_re25"])
    assert "R6" not in built.scales.monitor.parts
    assert built.scales.open_A is None
    assert built.scales.current.most < 4095


def test_a_monitor_of_more_volts_is_made_narrower_and_its_open_wire_reads_a_current(tmp_path: Path) -> None:
    text = CIRCUITS["escon_re25"].read_text(encoding="utf-8")
    path = tmp_path / "circuit.toml"
    path.write_text(
        text.replace("monitor_V_A = 0.3", "monitor_V_A = 1.0").replace('output = "dac"', 'output = "pwm"')
    )
    built, _ = load_circuit(path)
    s = built.scales
    assert "R6" in s.monitor.parts
    # Nothing comes by R4 of a wire that is off.
    off_V = nodal(
        [("pin", "ref", s.monitor.parts["R5"]), ("pin", GROUND, s.monitor.parts["R6"])], {"ref": SUPPLY_V}, {}
    )
    read = (off_V["pin"].real / SUPPLY_V * 4096 - s.current.zero_counts) * s.current.per_count
    assert s.open_A == pytest.approx(read, rel=1e-9)
    said = {what for what, _, _ in rows_of(built)}
    assert {"R6", "R10, R11", "C2, C3"} <= said


def test_the_scene_is_one_and_takes_what_the_block_takes(tmp_path: Path) -> None:
    """The sketch is compiled with the block in `test_port.py`."""
    for path in CIRCUITS.values():
        built, text = load_circuit(path)
        (tmp_path / "scene.toml").write_text(text)
        scene = load_scene(tmp_path / "scene.toml")
        amplifier, coil = scene.amplifier_model(), scene.coil()
        assert scene.limits.transient_input == built.hardware.current_A
        assert amplifier.command_limit == built.hardware.command_A
        assert built.hardware.pole_least_Hz < amplifier.pole_Hz < built.hardware.pole_most_Hz
        assert (coil.R_ohm, coil.limit_C) == (built.hardware.R_ohm, built.hardware.limit_C)
        assert "static const td_hardware HARDWARE" in block_text(built, "circuit.toml")
        assert scene_text(built.circuit, "x", 1.0).count("current_A = ") == 2


def test_the_command_writes_all_three_and_says_what_to_solder(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    Path("circuit.toml").write_text(play("device", "circuit", "--example", "bridge_re40").out)
    outcome = play("device", "circuit", "circuit.toml")
    assert outcome.code == 0, outcome.err
    built, _ = load_circuit(Path("circuit.toml"))
    said = "".join(outcome.out.split())
    for what, value, _ in rows_of(built):
        assert "".join(f"{what}│{value}".split()) in said
    assert {path.name for path in Path().glob("*.[ht]*")} >= {"hardware.h", "scene.toml", "offered.toml"}
    assert play("device", "new", "device.toml", "--from", "offered.toml", "--defaults").code == 0
    assert "sensor = false" in Path("device.toml").read_text()
    assert_refused(play("device", "circuit", "circuit.toml"), "hardware.h: is there already; --force")
    assert play("device", "circuit", "circuit.toml", "--force").code == 0


@pytest.mark.parametrize("name", CIRCUITS)
def test_the_command_stays_clear_of_what_an_output_buffer_does_not_reach(name: str) -> None:
    """0.2 V from either rail."""
    built, _ = load_circuit(CIRCUITS[name])
    converter, command_A = built.circuit.converter, built.hardware.command_A
    for sign in (-1, 1):
        volts = (built.scales.output_zero + sign * command_A * built.scales.output_per_A) * (
            converter.supply_V / converter.counts
        )
        assert 0.2 <= volts <= converter.supply_V - 0.2


@pytest.mark.parametrize(("dt_s", "words"), [(4.9e-5, "equal to 0.00005"), (1.1e-3, "equal to 0.001")])
def test_a_period_that_no_device_file_takes_is_refused(tmp_path: Path, dt_s: float, words: str) -> None:
    text = CIRCUITS["escon_re25"].read_text(encoding="utf-8")
    (tmp_path / "circuit.toml").write_text(text.replace("resistors = 0.01", f"resistors = 0.01\ndt_s = {dt_s}"))
    with pytest.raises(InputError, match=f"dt_s = {dt_s}: must be .*{words}"):
        load_circuit(tmp_path / "circuit.toml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("command_A = 6.0", "command_A = 12.0", "power.command_A = 12 A: the circuit puts out up to 8.75 A"),
        ("delay_s = 68e-6", "delay_s = 5e-4", "power.delay_s = 0.5 ms: must be 0.4 ms at most, 4 servo periods"),
        ("input_V = 10.0", "input_V = 3.0", "servo.input_V = 3 V: must be 3.46 V or more"),
        (
            "current_A = 4.0",
            "current_A = 30.0",
            "power.current_A = 30: above the motor's i_peak_A = 10 A: lower it to 10 or",
        ),
        ("lines = 500", "line = 500", "encoder.line: unknown key (did you mean lines?)"),
        ("[servo]", "[servos]", "servos: unknown key (did you mean servo?)"),
        (
            "[servo]",
            "[bridge]\nmotor_V = 24\nshunt_ohm = 0.01\nsense_gain = 20\ntriangle_V = 2\n\n[servo]",
            "circuit.toml: state one amplifier",
        ),
        ("V_per_unit = 0.0627", "V_per_unit = 0.0", "a sensor that shows nothing"),
        (
            "V_per_unit = 0.0627",
            "V_per_unit = 62.7",
            "up to 0.0262 g, such sensors 5 to 1000 g: is it 0.0627 V per g?",
        ),
        (
            "range_g = 16.0",
            "range_g = 5.0",
            "accelerometer.range_g = 5 g, of which the converter reads 26.2 g: must be",
        ),
        ("V_per_unit = 0.0627", "V_per_unit = 0.135", "of which the converter reads 12.2 g: must be 13 g or more"),
        ("range_g = 16.0", "", "accelerometer.range_g: missing; add it to the file"),
        (
            "V_per_unit = 0.0537",
            "V_per_unit = 5.37e-5",
            "grip.V_per_unit = 5.37e-05 V per N: the converter reads up to",
        ),
        (
            "motors/maxon_re25_118743.toml",
            "motors/none.toml",
            "circuit.toml: motor = 'motors/none.toml': no such file in HERE/motors, ",
        ),
    ],
)
def test_a_circuit_that_cannot_be(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = CIRCUITS["escon_re25"].read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "circuit.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError) as refused:
        load_circuit(tmp_path / "circuit.toml")
    assert words.replace("HERE", str(tmp_path)) in str(refused.value)


def test_the_page_names_every_key_of_the_file() -> None:
    rows = (ROOT / "docs/howto/circuits.md").read_text(encoding="utf-8").partition("## The file")[2]
    told = {
        key
        for line in rows.splitlines()
        if line.startswith("| `")
        for key in re.findall(r"`([\w.]+)`", line.split("|")[1])
    }
    tables = {"converter": Converter, "power": Power, "servo": Servo, "bridge": Bridge, "encoder": Shaft}
    known = {name for name in Circuit.model_fields if name not in {*tables, "accelerometer", "grip", "name"}}
    known |= {key for table in (*tables.values(), Accelerometer) for key in table.model_fields}
    assert {key.rpartition(".")[2] for key in told} == known
