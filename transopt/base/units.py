"""The unit that a name ends in, and the largest number of each unit that any device comes near.

A name such as `stiffness_N_m` states its unit. Numbers beyond these bounds are slips of a unit or damage: they are
refused where they are read, so that nothing that is computed from them overflows or takes for ever.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

# The ending of a name is its unit; longer endings come first.
UNITS = {
    "A_per_s": "A/s",
    "V_per_s": "V/s",
    "V_A": "V/A",
    "m_s2": "m/s^2",
    "N_s_m": "N s/m",
    "V_s_m": "V s/m",
    "Nm_A": "N m/A",
    "kg_m2": "kg m^2",
    "g_rtHz": "g/sqrt(Hz)",
    "m_s": "m/s",
    "N_m": "N/m",
    "N_A": "N/A",
    "K_W": "K/W",
    "1_m": "1/m",
    "s_m": "s/m",
    **{
        name: name
        for name in ("Hz", "dB", "ohm", "kg", "A", "V", "C", "K", "N", "s", "m", "g", "H", "ticks", "samples")
    },
}

# Three to six orders of magnitude above what laboratories and factories have.
LARGEST = {
    "A": 1e4,
    "A or V": 1e6,
    "A/s": 1e10,
    "V/s": 1e13,
    "V/A": 1e6,
    "m/s^2": 1e7,
    "N s/m": 1e8,
    "V s/m": 1e5,
    "N m/A": 1e3,
    "kg m^2": 1e3,
    "g/sqrt(Hz)": 1e3,
    "m/s": 1e4,
    "N/m": 1e10,
    "N/A": 1e5,
    "K/W": 1e6,
    "1/m": 1e7,
    "s/m": 1e6,
    "Hz": 1e8,
    "dB": 1e3,
    "ohm": 1e6,
    "kg": 1e5,
    "V": 1e6,
    "C": 1e4,
    "K": 1e4,
    "N": 1e6,
    "s": 1e8,
    "m": 1e4,
    "g": 1e5,
    "H": 1e4,
    "ticks": 1e6,
    "samples": 1e6,
}
LEAST_kg = 1e-9  # of a mass: lighter ones move faster than any arithmetic follows beside the others
LARGEST_PLAIN = 1e30  # of a number without a unit: its cube still fits double precision


@lru_cache(maxsize=2048)  # the keys of scenes, asked again for every change of one
def unit_of(path: str) -> str:
    """Unit of a number by its dotted path, from the ending of the last name."""
    *tables, name = path.rsplit(".", 1)
    if tables and name in ("constant", "per_newton"):
        return unit_of(tables[0]) + ("/N" if name == "per_newton" else "")
    if len(name) == 1:
        return ""  # a matrix, as A of a state space, and no ampere
    return next((unit for ending, unit in UNITS.items() if name == ending or name.endswith(f"_{ending}")), "")


def largest(unit: str) -> float:
    """The largest size of a number of this unit; of a slope over grip ("kg/N") that of the number itself."""
    return LARGEST.get(unit, LARGEST.get(unit.removesuffix("/N"), LARGEST_PLAIN))


@lru_cache(maxsize=2048)
def _bound_of(name: str) -> tuple[str, float]:
    """Unit of a number by its name, and its largest size."""
    unit = unit_of(name)
    return unit, largest(unit)


def beyond(name: str, value: Any) -> str:
    """What is wrong with the first number in `value` that no device comes near; empty where none is.

    Parameters
    ----------
    name : of the value, which tells the unit of all numbers in it.
    value : a number, or lists and tables of them; what is no number is passed over.
    """
    if value is None or isinstance(value, str):
        return ""
    unit, most = _bound_of(name)
    if unit == "kg" and isinstance(value, int | float) and 0 < value < LEAST_kg:
        return f"must be at least {LEAST_kg:g} kg, which is a microgram; check its unit"
    for number in (value,) if isinstance(value, float) else _numbers(value):
        if not abs(number) <= most:
            return f"must be finite and at most {most:g} {unit}".rstrip() + " in size; check its unit"
    return ""


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, bool):
        return
    if isinstance(value, int | float):
        yield value
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from _numbers(each)
    elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
        for each in value:
            yield from _numbers(each)
