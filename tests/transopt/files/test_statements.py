"""Cells, units, rates and scalars as instruments write them; long runs keep nobody waiting."""

import math
from datetime import date, datetime
from pathlib import Path

import numpy as np
import pytest

from tests.benches.tap_formats import workbook
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.files.containers import _cell, sheet_as_text
from transopt.files.statements import described, rate_of, stated_in
from transopt.files.units import UNITS, Unit, known_units, parts, read_unit, with_input
from transopt.recordings.recording import VOCABULARY, load_recording


def test_an_instant_at_midnight_is_one_of_the_others() -> None:
    """A workbook's date has no type of its own: the reader hands out a day where the time of day is zero."""
    assert _cell(date(2024, 3, 5)) == str(datetime(2024, 3, 5)) == "2024-03-05 00:00:00"
    assert _cell(datetime(2024, 3, 5, 0, 0, 0, 200)) == "2024-03-05 00:00:00.000200"


def test_a_unit_merged_over_columns_is_that_of_each_and_a_title_is_none(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    times_s = np.arange(2000) * 1e-4
    ring = np.where(times_s > 0.1, 50 * np.exp(-80 * (times_s - 0.1)) * np.sin(1e3 * (times_s - 0.1)), 0.0)
    rows = zip(times_s.tolist(), (0.1 * ring).tolist(), (0.2 * ring).tolist(), ring.tolist(), strict=True)
    head = [("Plate 3", "", "", ""), ("time", "acc x", "acc y", "acc z"), ("s", "m/s^2", "", "")]
    data = workbook([*head, *rows], merged="A1:D1 B3:D3")
    assert sheet_as_text(data, []).startswith(b"Plate 3;;;\ntime;acc x;acc y;acc z\ns;m/s^2;m/s^2;m/s^2\n")
    (tmp_path / "taps.xlsx").write_bytes(data)
    recording = load_recording(tmp_path / "taps.xlsx")
    whole = np.sqrt(0.1**2 + 0.2**2 + 1)  # the three directions are one motion
    assert np.abs(recording.acceleration.values).max() == pytest.approx(whole * np.abs(ring).max(), rel=1e-6)


@pytest.mark.parametrize(
    ("line", "stated"),
    [
        ("# speed_m_s: 0.21", {"speed_m_s": "0.21"}),
        ("% grip_N = 3;;", {"grip_N": "3"}),
        ("speed_m_s,0.21", {"speed_m_s": "0.21"}),
        ("speed_m_s;0,21", {"speed_m_s": "0.21"}),
        ("# speed_m_s, grip_N", {}),  # a remark may hold commas
        ("# speed of the hand: 0.2", {}),
        ("# sped_m_s: 0.21", {"sped_m_s": "0.21"}),  # must mean a scalar, and is refused
    ],
)
def test_a_scalar_of_a_line(line: str, stated: dict[str, str]) -> None:
    assert stated_in(line, VOCABULARY) == stated


def test_units_between_tabs_leave_out_the_cells_of_times() -> None:
    names = ["X_Value", "Acceleration", "X_Value", "Force", "Comment"]
    found = described(names, len(names), ["Y_Unit_Label\tg\t\tN\t"])
    assert found == ["X_Value", "Acceleration [g]", "X_Value", "Force [N]", "Comment"]


def test_an_empty_unit_between_commas_keeps_its_place() -> None:
    found = described(["t", "a", "b", "c"], 4, ['Vertical Units,"g",,N'])
    assert found == ["t", "a [g]", "b", "c [N]"]


@pytest.mark.parametrize(
    "line", ["Sample Rate        1000 Hz", "rate\t\t[Hz]\t1000", "Sampling  Interval :    0.001   s", "Fs =    1 kHz"]
)
def test_columns_of_blanks_do_not_hide_a_rate(line: str) -> None:
    found = rate_of([line])
    assert found.step_s == pytest.approx(1e-3, rel=1e-12)


LONG = 20_000
ROWS = "".join(f"{k * 1e-4:.4f},{0.1 * (k % 7):.1f}\n" for k in range(100))
RUNS = [
    "rate" + LONG * " " + "Hz",
    "a" + LONG * " " + "x",
    LONG * "sampl_",
    LONG * "a_",
    "acc" + LONG * "/",
    LONG * "ab",
]
PLACES = {
    "remark": "# {}\ntime_s,acc_g\n" + ROWS,
    "metadata": "{}\ntime_s,acc_g\n" + ROWS,
    "name": "time_s,{}\n" + ROWS,
    "row": "time_s,acc_g\n" + ROWS + "{}\n" + ROWS,
    "footer": "time_s,acc_g\n" + ROWS + "{}\n",
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("run", RUNS, ids=lambda run: run[:5].strip())
def test_a_long_run_ends(run: str, place: str, tmp_path: Path) -> None:
    path = tmp_path / "tap.csv"
    path.write_text(PLACES[place].format(run))
    said = ""
    try:
        load_recording(path)
    except InputError as refused:
        said = str(refused)
    assert "\n" not in said


SPELLINGS = {
    ("acceleration", 1.0): "m/s^2,m/s2,m/s²,M/S^2,m/sec^2,m/s**2,m/s/s,m s-2,m·s⁻²,m_s2,meters/second^2,metres/sec²",
    ("acceleration", 1e-3): "mm/s^2,mm/s²,MM/S2,mm/sec^2",
    ("acceleration", G): "g,G,gn,Gs,g's",
    ("acceleration", 1e-3 * G): "mg,MG",
    ("frequency", 1.0): "Hz,HZ,hz,Hertz,HERTZ",
    ("frequency", 1e3): "kHz,KHZ,kilohertz",
    ("frequency", 1 / (2 * math.pi)): "rad/s,rad/sec,RAD/S,radians/second",
    ("voltage", 1.0): "V,v,Volt,Volts,VOLTS",
    ("voltage", 1e-3): "mV,mVolt,millivolts",
    ("current", 1.0): "A,Amp,Amps,Ampere",
    ("current", 1e-6): "uA,µA,μA,microamps",
    ("time", 1.0): "s,S,sec,Seconds",
    ("time", 1e-3): "ms,MS,msec,milliseconds",
    ("time", 1e-6): "us,µs,usec,microseconds",
    ("force", 1.0): "N,Newton,newtons",
    ("force", 1e-3 * G): "gf,gram-force,gram force",
    ("force", G): "kgf,kp,kilogram-force",
    ("phase", math.pi / 180): "deg,DEG,°,degrees",
}


@pytest.mark.parametrize(("quantity", "factor"), SPELLINGS)
def test_every_spelling_of_a_unit_is_that_unit(quantity: str, factor: float) -> None:
    for spelling in SPELLINGS[quantity, factor].split(","):
        found = read_unit(spelling, quantity)
        assert found is not None, spelling
        assert found.factor == pytest.approx(factor, rel=1e-12), spelling


@pytest.mark.parametrize("quantity", UNITS)
def test_every_unit_that_a_message_names_is_read(quantity: str) -> None:
    assert all(read_unit(unit, quantity) is not None for unit in known_units(quantity))


@pytest.mark.parametrize(
    ("quantity", "units"),
    [
        ("voltage", "MV,A,megavolts,,ohm"),
        ("current", "MA,kV"),
        ("force", "MN,g,kg,mgf"),
        ("acceleration", "gf,kgf"),
        ("frequency", "MHz,mHz,rpm"),
        ("acceleration", "m/s,furlong,g/V,m/s^3,Mg"),
        ("magnitude", "s/V,g/N,g/MV,V,/V,g/"),
        ("real", "dB"),
    ],
)
def test_what_is_no_unit_of_a_quantity_is_none(quantity: str, units: str) -> None:
    """A capital M is mega, which is a billion times milli."""
    assert [unit for unit in units.split(",") if read_unit(unit, quantity) is not None] == []


@pytest.mark.parametrize(
    ("unit", "factor", "per"),
    [
        ("g/V", G, "voltage"),
        ("G/Volt", G, "voltage"),
        ("m/s^2/V", 1.0, "voltage"),
        ("(m/s²)/mV", 1e3, "voltage"),
        ("m/s/s per A", 1.0, "current"),
        ("mg/uA", 1e3 * G, "current"),
        ("m/s2", 1.0, ""),
    ],
)
def test_a_response_is_an_acceleration_over_an_input(unit: str, factor: float, per: str) -> None:
    found = read_unit(unit, "magnitude")
    assert found.per == per
    assert found.factor == pytest.approx(factor, rel=1e-12)


def test_a_minus_turns_the_sign_of_what_has_one() -> None:
    for quantity, unit, factor in (("position", "-mm", -1e-3), ("acceleration", "-g", -G), ("force", "-N", -1.0)):
        found = read_unit(unit, quantity)
        assert found is not None
        assert found.factor == pytest.approx(factor, rel=1e-12)
    assert read_unit("-s", "time") is None
    assert read_unit("-dB", "magnitude") is None
    assert read_unit("-", "position") is None


def test_units_are_compared_by_meaning() -> None:
    assert Unit(1.0, "voltage").means(Unit(1.0 + 1e-15, "voltage"))
    assert not Unit(1.0, "voltage").means(Unit(1.0, "current"))
    assert not Unit(1.0).means(Unit(G))
    assert Unit(math.nan).means(Unit(math.nan))
    assert not Unit(math.nan).means(Unit(1.0))


def test_a_unit_of_the_acceleration_takes_the_input_of_another() -> None:
    assert parts("m/s^2/mV") == ("m/s^2", "mV")
    assert with_input("g", "furlong/mV") == "g/mV"
    assert with_input("g/A", "m/s^2/V") == "g/A"
    assert with_input("dB", "g/V") == "dB"
    assert with_input("ms", "s") == "ms"
