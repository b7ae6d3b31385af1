"""Units of numbers, from the endings of their names, and the largest plausible number of each unit.

A name such as `stiffness_N_m` states its unit. Larger numbers are errors of the unit or damaged data. They are
refused when they are read, so that no computation with them overflows or does not end.
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

# Three to six orders of magnitude above the values of real devices.
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
LEAST_kg = 1e-9  # least mass; a lighter one beside ordinary ones is too stiff a system for double precision
LARGEST_PLAIN = 1e30  # largest number without a unit; its cube is still finite in double precision


@lru_cache(maxsize=2048)  # the keys of scenes are looked up again at every change of a scene
def unit_of(path: str) -> str:
    """Unit of a number by its dotted path, from the ending of the last name."""
    *tables, name = path.rsplit(".", 1)
    if tables and name in ("constant", "per_newton"):
        return unit_of(tables[0]) + ("/N" if name == "per_newton" else "")
    if len(name) == 1:
        return ""  # a matrix, such as A of a state space, and not a number in ampere
    return next((unit for ending, unit in UNITS.items() if name == ending or name.endswith(f"_{ending}")), "")


def words_of(name: str) -> str:
    """The words of a key's last name without its unit: "current" for "current_A"."""
    ending = next((each for each in UNITS if name.endswith(f"_{each}")), "")
    return name.removesuffix(f"_{ending}").replace("_", " ").replace(".", " ")


def largest(unit: str) -> float:
    """The largest absolute value of a number with this unit; a slope over grip ("kg/N") has that of the number."""
    return LARGEST.get(unit, LARGEST.get(unit.removesuffix("/N"), LARGEST_PLAIN))


@lru_cache(maxsize=2048)
def _bound_of(name: str) -> tuple[str, float]:
    """Unit of a number, from its name, and its largest absolute value."""
    unit = unit_of(name)
    return unit, largest(unit)


def beyond(name: str, value: Any) -> str:
    """An error message for the first number in `value` that is too large; empty if there is none.

    Parameters
    ----------
    name : name of the value; its ending is the unit of all numbers in it.
    value : a number, or lists and tables of numbers; other values are ignored.
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
