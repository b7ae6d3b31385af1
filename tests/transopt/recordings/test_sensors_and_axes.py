"""What sensors, loggers and analysers hand over: volts, counts, three axes, velocities, structures, sheets."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benches.recording_files import DT_S, TAP_M_S2, TIMES_S, load, mat, npz, refusal, text
from tests.benches.tap_formats import hdf5, tdms, universal, workbook
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.base.signals import FloatArray
from transopt.files import containers
from transopt.files.names import Layout, stated_units
from transopt.files.unclear import UnclearError
from transopt.files.units import UNITS, read_unit
from transopt.identify.measured_response import read_response
from transopt.recordings.axes import joined, without_turning
from transopt.recordings.recording import load_recording

FREQUENCIES_Hz = np.linspace(20.0, 500.0, 60)
ACCELERANCE = 4.0 * (2j * np.pi * FREQUENCIES_Hz) ** 2 / (np.square(2 * np.pi * 150) + 2j * np.pi * FREQUENCIES_Hz)


def proposed(message: str, option: str) -> str:
    """The value that a message proposes for an option."""
    found = re.search(rf"--{option} (?:'([^']*)'|(\S+))", message)
    assert found is not None, message
    return found[1] or found[2]


# ---- volts and counts -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("mV @ 100 mV/g", G / 100),
        ("V @ 0.1 V/g", 10 * G),
        ("V @ 100 mV/g", 10 * G),
        ("mV @ 10.2 mV/(m/s^2)", 1 / 10.2),
        ("mV @ 0.098 m/s^2/mV", 0.098),
        ("counts @ 3.9 mg/count", 3.9e-3 * G),
        ("LSB @ 16384 LSB/g", G / 16384),
        ("counts @ 16 g/32768 counts", 16 * G / 32768),
        ("mV @ -100 mV/g", -G / 100),
    ],
)
def test_a_sensitivity_may_be_written_either_way_up(unit: str, size: float) -> None:
    found = read_unit(unit, "acceleration")
    assert found.factor == pytest.approx(size, rel=1e-12)


@pytest.mark.parametrize(
    "unit", ["V @ 10", "@", "mV @@ /g", "V @ --1 V/g", "V @ 0 V/g", "g @ 1 mV/g", "counts @ 1 V/g", "MV @ 1 mV/g"]
)
def test_no_sensitivity_can_be_read_from_less(unit: str) -> None:
    assert read_unit(unit, "acceleration") is None


@pytest.mark.parametrize(
    ("head", "size"),
    [
        ("Time,Channel A,Channel B\n(ms),(mV),(mV)\n\n", (1e3, 1e3 / G * 0.1)),
        ("Time (ms);Channel A (V);Remark (V)\n", (1e3, 0.1 / G)),
        ("Time [ms],Channel A [counts],Channel B [counts]\n", (1e3, 1 / (0.1 * G))),
    ],
)
def test_a_scopes_channel_is_asked_for_its_sensitivity(tmp_path: Path, head: str, size: tuple[float, float]) -> None:
    mark = ";" if ";" in head else ","
    rows = text(size[0] * TIMES_S, size[1] * TAP_M_S2, 0 * TIMES_S, delimiter=mark)
    said = refusal(tmp_path, head + rows)
    assert "is what a sensor gives, and its sensitivity is not stated; state it" in said
    stated = proposed(said, "units")
    assert stated.startswith("Channel A=")
    # What is proposed reads the file; the sensitivity itself is the user's to know.
    own = {
        "Channel A": "counts @ 0.1 g/count"
        if "counts" in head
        else stated.partition("=")[2].replace("100 mV", "0.1 V")
    }
    for units in (stated_units(stated), own):
        recording = load(tmp_path, head + rows, units=units) if "counts" not in head or units is own else None
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    assert len(recording.notes) == 1
    assert "not used" in recording.notes[0]


def test_other_volts_than_the_files_are_named(tmp_path: Path) -> None:
    content = "t [s],CH1 [mV]\n" + text(TIMES_S, 100 / G * TAP_M_S2)
    recording = load(tmp_path, content, units={"CH1": "V @ 0.1 V/g"})
    assert recording.notes == ("the file's column is 'CH1 [mV]', --units says V @ 0.1 V/g, which is taken",)
    np.testing.assert_allclose(recording.acceleration.values, 1e3 * TAP_M_S2, rtol=1e-9)


def test_a_column_that_is_named_keeps_the_unit_of_the_file(tmp_path: Path) -> None:
    content = "clock [ms],what [g]\n" + text(1e3 * TIMES_S, TAP_M_S2 / G)
    recording = load(tmp_path, content, columns=["time", "acceleration"])
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)


def test_numbers_below_names_are_no_units(tmp_path: Path) -> None:
    """A scope writes start and step of its samples into the row of units."""
    rows = "".join(f"{k},{value:.9g},,\n" for k, value in enumerate(0.1 / G * TAP_M_S2))
    content = f"X,CH1,Start,Increment,\nSequence,Volt,-5.0e-03,{DT_S:e}\n{rows}"
    recording = load(tmp_path, content, units=stated_units(proposed(refusal(tmp_path, content), "units")))
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-6)
    assert recording.acceleration.start_s == pytest.approx(-5e-3)
    assert recording.acceleration.dt_s == pytest.approx(DT_S)


# ---- axes -------------------------------------------------------------------------------------------------


def three(direction: FloatArray, gravity: FloatArray) -> FloatArray:
    """(3, n) what the axes of a sensor read of the tap along a direction."""
    return np.outer(direction, TAP_M_S2) + gravity[:, None]


@pytest.mark.parametrize("seed", range(4))
def test_the_taps_direction_is_found(seed: int) -> None:
    random = np.random.default_rng(seed)
    direction = random.standard_normal(3)
    direction /= np.linalg.norm(direction)
    gravity = G * random.standard_normal(3)
    noise = 0.05 * random.standard_normal((3, TIMES_S.size))
    made, said = joined(dict(zip("xyz", three(direction, gravity) + noise, strict=True)), "main")
    nearest = int(np.argmax(np.abs(direction)))
    sign = np.sign(direction[nearest])
    np.testing.assert_allclose(made - np.median(made), sign * TAP_M_S2, atol=0.5)
    off = np.degrees(np.arccos(abs(direction[nearest])))
    stated = re.search(r"(\d+) degrees off ([xyz]); (\d+\.\d) %", said)
    assert abs(float(stated[1]) - off) < 1.5
    assert stated[2] == "xyz"[nearest]
    assert float(stated[3]) < 1


def test_dft321_keeps_the_energy_of_all_axes() -> None:
    random = np.random.default_rng(3)
    axes = random.standard_normal((3, 400))
    made, _ = joined(dict(zip("xyz", axes, strict=True)), "dft321")
    moved = axes - np.median(axes, axis=1, keepdims=True)
    np.testing.assert_allclose(
        np.sum(made**2), np.sum(moved**2), rtol=1e-2
    )  # the line of the highest frequency is real
    spectra = np.abs(np.fft.rfft(moved))
    np.testing.assert_allclose(np.abs(np.fft.rfft(made))[1:-1], np.linalg.norm(spectra, axis=0)[1:-1], rtol=1e-9)


@pytest.mark.parametrize(
    ("head", "units"),
    [
        ("t_s,ax_g,ay_g,az_g", {}),
        ("Time [s],Acc X [g],Acc Y [g],Acc Z [g]", {}),
        ("#time,accel_x,accel_y,accel_z", {"time": "s", "acceleration": "g"}),
        ("t,acc_x,acc_y,acc_z", {"t": "s", "acc": "g"}),
    ],
)
@pytest.mark.parametrize("axis", ["", "z", "dft321"])
def test_three_axes_of_a_file(tmp_path: Path, head: str, units: dict[str, str], axis: str) -> None:
    rows = text(TIMES_S, *three(np.array([0.0, 0.0, 1.0]), G * np.array([0.1, 0.2, 0.0])) / G)
    recording = load(tmp_path, f"{head}\n{rows}", units=units, axis=axis)
    np.testing.assert_allclose(
        np.abs(recording.acceleration.values), np.abs(TAP_M_S2), atol=1e-6 if axis != "dft321" else 2
    )
    assert recording.notes[0].startswith(
        "axis z of x, y, z is used alone" if axis == "z" else "axes x, y, z are joined "
    )


def test_axes_that_are_not_there(tmp_path: Path) -> None:
    content = "t_s,ax_g,az_g\n" + text(TIMES_S, 0 * TIMES_S, TAP_M_S2 / G)
    assert refusal(tmp_path, content, axis="y").startswith(
        "--axis y (in a scene recordings.axis): the file has x, z; "
    )
    one = "t_s,az_g\n" + text(TIMES_S, TAP_M_S2 / G)
    assert "the file has one acceleration; leave it out" in refusal(tmp_path, one, axis="z")
    twice = "t_s,az_g,az_g\n" + text(TIMES_S, TAP_M_S2, TAP_M_S2)
    assert refusal(tmp_path, twice).startswith("2 acceleration columns in ")


# ---- arrays and structures --------------------------------------------------------------------------------


@pytest.mark.parametrize("pack", [npz, mat])
@pytest.mark.parametrize("turned", [False, True])
def test_an_array_of_three_axes(tmp_path: Path, pack: Any, turned: bool) -> None:
    table = three(np.array([0.6, 0.0, 0.8]), np.zeros(3)) / G
    content = pack(t_ms=1e3 * TIMES_S, acc_g=table if turned else table.T)
    recording = load(tmp_path, content, ".npz" if pack is npz else ".mat")
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
    assert "37 degrees off z" in recording.notes[0]


@pytest.mark.parametrize("compressed", [False, True])
def test_fields_of_a_structure(tmp_path: Path, compressed: bool) -> None:
    log = {"rig": "A7", "sensor": {"time": TIMES_S, "acc": TAP_M_S2 / G}}
    content = mat(log=log, do_compression=compressed)
    said = refusal(tmp_path, content, ".mat")
    assert said.startswith("no unit stated in the columns 'time, acc'; known: time in s, ms")
    recording = load(tmp_path, content, ".mat", units={"time": "s", "acc": "g"})
    np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)


@pytest.mark.parametrize("pack", [npz, mat])
def test_a_complex_response(tmp_path: Path, pack: Any) -> None:
    path = tmp_path / ("frf.npz" if pack is npz else "frf.mat")
    path.write_bytes(pack(freq=FREQUENCIES_Hz, frf=ACCELERANCE / G))
    with pytest.raises(InputError, match="variable frf is complex, as a response is") as caught:
        read_response(path)
    asked = stated_units(proposed(str(caught.value), "units").rstrip(","))
    np.testing.assert_allclose(read_response(path, Layout(units=asked)).response, ACCELERANCE / G, rtol=1e-9)
    found = read_response(path, Layout(units={"freq": "Hz", "frf": "g/V"}))
    np.testing.assert_allclose(found.response, ACCELERANCE, rtol=1e-9)
    assert found.driven_by == "voltage"


# ---- velocities and positions -----------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "slopes", "size"), [("mm/s/V", 1, 1e3), ("um/V", 2, 1e6), ("m/s^2/V", 0, 1.0)])
def test_mobility_and_receptance_become_accelerance(tmp_path: Path, unit: str, slopes: int, size: float) -> None:
    measured = size * ACCELERANCE / (2j * np.pi * FREQUENCIES_Hz) ** slopes
    path = tmp_path / "ldv.csv"
    rows = text(FREQUENCIES_Hz, np.abs(measured), np.degrees(np.angle(measured)))
    path.write_text(f"Frequency (Hz),Magnitude ({unit}),Phase (deg)\n{rows}")
    np.testing.assert_allclose(read_response(path).response, ACCELERANCE, rtol=1e-6)


def test_the_slope_of_a_velocity_is_an_acceleration(tmp_path: Path) -> None:
    times_s = np.arange(2000) * 1e-5
    phase = 2 * np.pi * 200 * times_s
    content = "t [s],velocity [mm/s]\n" + text(times_s, 1e3 * np.sin(phase))
    recording = load(tmp_path, content)
    np.testing.assert_allclose(recording.acceleration.values, 2 * np.pi * 200 * np.cos(phase), atol=0.02)
    assert recording.notes == ("the acceleration is the slope of the velocity",)
    message = refusal(tmp_path, content.replace("velocity", "acc"))
    assert message.endswith("that is a velocity: name the column so, velocity for example")


# ---- load cells -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "newton"),
    [
        ("load [gf]", 1e-3 * G),
        ("load_gf", 1e-3 * G),
        ("Load cell (kgf)", G),
        ("thrust (N)", 1.0),
        ("Force [kp]", G),
    ],
)
def test_a_load_cell_gives_a_force_beside_a_unit_of_force(tmp_path: Path, name: str, newton: float) -> None:
    path = tmp_path / "tap.csv"
    path.write_text(f"time_s,acc_g,{name}\n" + text(TIMES_S, TAP_M_S2 / G, 5 + TAP_M_S2))
    found = load_recording(path).force
    np.testing.assert_allclose(found.values, newton * (5 + TAP_M_S2), rtol=1e-6)


@pytest.mark.parametrize(("label", "meant"), [("g", "gf"), ("kg", "kgf")])
def test_a_force_in_a_unit_of_mass_is_asked_about_and_its_weight_comes_first(
    tmp_path: Path, label: str, meant: str
) -> None:
    path = tmp_path / "tap.csv"
    path.write_text(f"time_s,acc_g,force [{label}]\n" + text(TIMES_S, TAP_M_S2 / G, 5 + TAP_M_S2))
    with pytest.raises(UnclearError, match=f"'{label}' is no unit of force") as refused:
        load_recording(path)
    assert refused.value.answers[0] == {"units": {"force": meant}}
    found = load_recording(path, Layout(**refused.value.answers[0])).force
    np.testing.assert_allclose(found.values, UNITS["force"][meant] * (5 + TAP_M_S2), rtol=1e-6)


def test_a_load_in_grams_is_no_force_and_said_so(tmp_path: Path) -> None:
    path = tmp_path / "tap.csv"
    path.write_text("time_s,acc_g,load [g]\n" + text(TIMES_S, TAP_M_S2 / G, 5 + TAP_M_S2))
    found = load_recording(path)
    assert found.force is None
    assert any("'load [g]' not used" in note for note in found.notes)


# ---- files of other programs ------------------------------------------------------------------------------


def sheet() -> bytes:
    numbers = [(float(t), float(a)) for t, a in zip(1e3 * TIMES_S, TAP_M_S2 / G, strict=True)]
    return workbook([("Logger X7", ""), ("Time [ms]", "Acc [g]"), *numbers])


def logger(user_block: int = 0) -> bytes:
    return hdf5({"log/time_s": (TIMES_S[None], ""), "log/acc": (TAP_M_S2[None] / G, "g")}, user_block)


def waveform(**more: object) -> bytes:
    return tdms({"acc": (TAP_M_S2 / G, "g")}, {"wf_increment": DT_S, **more})


FILES = {".xlsx": sheet, ".h5": logger, ".tdms": waveform, ".mat": lambda: logger(512)}


def test_a_waveform_keeps_its_start(tmp_path: Path) -> None:
    recording = load(tmp_path, waveform(wf_start_offset=-3e-3), ".tdms")
    assert recording.acceleration.start_s == pytest.approx(-3e-3)


def test_a_channel_that_nothing_is_known_of_is_passed_over_and_may_be_named(tmp_path: Path) -> None:
    """An acquisition card has more channels than a tap needs."""
    channels = {
        "Mod1/ai0": (TAP_M_S2 / G, "g"),
        "Mod1/ai1": (-200.0 * TIMES_S, "mm"),
        "Mod1/ai2": (0 * TIMES_S, "bar"),
    }
    file = tdms(channels, {"wf_increment": DT_S})
    found = load(tmp_path, file, ".tdms")
    assert "columns 'Mod1/ai1 [mm], Mod1/ai2 [bar]' not used: nothing here goes by such a name" in found.notes
    np.testing.assert_allclose(found.acceleration.values, TAP_M_S2, rtol=1e-12)
    named = load(tmp_path, file, ".tdms", units={"Mod1/ai1": "mm"})
    assert named.position is not None
    np.testing.assert_allclose(named.position.values, -0.2 * TIMES_S, rtol=1e-12)


def test_a_workbook_of_several_taps_says_which_is_read(tmp_path: Path) -> None:
    head, rows = ("Time [s]", "Acc [m/s^2]"), zip(TIMES_S.tolist(), TAP_M_S2.tolist(), strict=True)
    remarks: list[tuple[object, ...]] = [("Operator", "A"), ("Sensor", "B")]
    shorter, longer = [head, *rows], [head, *((1e-3 * k, float(np.sin(k))) for k in range(2 * TIMES_S.size))]
    alone = load(tmp_path, workbook(remarks, shorter), ".xlsx")
    assert not any("sheets" in note for note in alone.notes)
    found = load(tmp_path, workbook(shorter, remarks, longer), ".xlsx")
    assert "of 2 sheets the longest, 'tap3', is read; save each as a file to use the others" in found.notes
    assert found.acceleration.values.size == 2 * alone.acceleration.values.size


@pytest.mark.parametrize("suffix", FILES)
def test_a_library_that_is_not_there_is_named(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(containers, "import_module", missing)
    said = refusal(tmp_path, FILES[suffix](), suffix)
    assert said.endswith("which is not installed: pip install 'transopt[formats]', or export the file as CSV")


@pytest.mark.parametrize(("suffix", "count"), [(".xlsx", 100), (".tdms", 100), (".h5", 4)])
def test_damaged_files_are_read_or_refused(
    tmp_path: Path, suffix: str, count: int, capfd: pytest.CaptureFixture[str]
) -> None:
    random, whole = np.random.default_rng(5), FILES[suffix]()
    for _ in range(count):
        damaged = bytearray(whole)
        for at in random.integers(len(damaged), size=3):
            damaged[at] = random.integers(256)
        try:
            recording = load(tmp_path, bytes(damaged[: random.integers(len(damaged))]), suffix)
        except InputError:
            continue  # one line, as the tests of other damaged files see
        assert np.isfinite(recording.acceleration.values).all()
    assert capfd.readouterr() == ("", "")


# ---- files as they were brought ---------------------------------------------------------------------------


@pytest.mark.parametrize("binary", [False, True])
def test_time_responses_of_universal_files(tmp_path: Path, binary: bool) -> None:
    content = universal(("g", "12"), values=TAP_M_S2 / G, binary=binary)
    for rate_Hz in (None, 5000.0):
        recording = load(tmp_path, content, ".uff", rate_Hz=rate_Hz)
        np.testing.assert_allclose(recording.acceleration.values, TAP_M_S2, atol=1e-9)
        assert recording.acceleration.rate_Hz == pytest.approx(rate_Hz or 10_000.0)
    two = content + universal(("V", "0"), values=TAP_M_S2, binary=binary)
    assert "1 'tap 1', 2 'tap 1'" in refusal(tmp_path, two, ".uff")
    loud = load(tmp_path, two, ".uff", channel=2, units={"acceleration": "V @ 1 V/g"})
    np.testing.assert_allclose(loud.acceleration.values, G * TAP_M_S2, atol=1e-9)
    assert "choose 1 to 2" in refusal(tmp_path, two, ".uff", channel=3)


# ---- a sensor that turns --------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("axis", ["main", "z", "dft321"])
def test_gravity_of_a_sensor_that_turns_is_taken_off(seed: int, axis: str, tmp_path: Path) -> None:
    """A sensor that turns by 25 degrees while it records reads the same tap as one that stays."""
    random = np.random.default_rng(seed)
    t = np.arange(6000) * 1e-4
    hit = np.where((t > 0.25) & (t < 0.254), 80 * np.sin(np.pi * (t - 0.25) / 4e-3), 0.0)
    start = random.uniform(-1, 1)
    angle = start + np.radians(25) * t / t[-1]
    noise = 0.02 * random.standard_normal((3, t.size))
    field = G * np.array([np.sin(angle) * np.cos(1.0), np.sin(angle) * np.sin(1.0), np.cos(angle)])
    still = field[:, 2500:2501] + 0 * field
    found = []
    for each in (field, still):
        rows = text(t, *(np.array([[0.0], [0.0], [1.0]]) * hit + each + noise))
        recording = load(tmp_path, f"t_s,ax_m_s2,ay_m_s2,az_m_s2\n{rows}", axis="" if axis == "main" else axis)
        values = recording.acceleration.values
        found.append(values - np.median(values))
        assert any("turned by" in note for note in recording.notes) == (each is field)
    away = found[0] - found[1]
    assert np.abs(away - np.median(away)).max() < (0.4 if axis != "dft321" else 1.5)  # 3.7 as it is


def test_a_sensor_that_reads_no_gravity_is_left_alone() -> None:
    values = {axis: np.sin(20 * np.arange(5000) * 1e-4 + k) for k, axis in enumerate("xyz")}
    kept, said = without_turning(values, 1e-4)
    assert said == ""
    assert all(np.array_equal(kept[axis], values[axis]) for axis in "xyz")
