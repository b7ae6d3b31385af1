"""Units in the spellings of instruments and people: what each means, and what none is."""

import math

import pytest

from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.files.units import UNITS, Unit, known_units, parts, read_unit, with_input

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
