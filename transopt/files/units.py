"""Units as instruments and people write them, with their factors to SI: one table for all readers.

The spelling of a unit does not matter: m/s², M/S^2, m/sec**2 and m s-2 are one unit. A capital that changes the
meaning does: MV is not a millivolt. A response has the unit of an acceleration, velocity or position over that of an
input, g/V for example; both parts are looked up in the table. A sensor's raw reading is written with its sensitivity:
"mV @ 100 mV/g", "counts @ 3.9 mg/count". A minus in front, "-mm" or "-deg" or "mV @ -100 mV/g", turns the sign.
"""

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from transopt.base.signals import STANDARD_GRAVITY_M_S2

# In place of a factor: a level L in dB is the magnitude 10^(L / 20), re 1 m/s^2 per A or V.
LEVEL = math.nan
INPUTS: Mapping[str, str] = {"current": "A", "voltage": "V"}  # quantity that may drive an actuator -> its SI unit
_CURRENT = {"A": 1.0, "mA": 1e-3, "uA": 1e-6}
_FORCE = {
    **{"N": 1.0, "mN": 1e-3, "kN": 1e3},
    **{"gf": 1e-3 * STANDARD_GRAVITY_M_S2, "kgf": STANDARD_GRAVITY_M_S2},  # weights of a gram and a kilogram
}
_TEMPERATURE = {"C": 1.0, "degC": 1.0, "°C": 1.0}
# Quantity -> unit -> factor to SI; `_plain` maps other spellings to these.
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "acceleration": {
        "m/s^2": 1.0,
        "g": STANDARD_GRAVITY_M_S2,
        "mg": 1e-3 * STANDARD_GRAVITY_M_S2,
        "mm/s^2": 1e-3,
        "cm/s^2": 1e-2,
        "gal": 1e-2,
        "ug": 1e-6 * STANDARD_GRAVITY_M_S2,
        "ft/s^2": 0.3048,
        "in/s^2": 0.0254,
    },
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "um/s": 1e-6},
    "position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "force": _FORCE,
    "grip": _FORCE,
    "current": _CURRENT,
    "command": _CURRENT,
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6},
    "winding": _TEMPERATURE,
    "housing": _TEMPERATURE,
    "ambient": _TEMPERATURE,
    "frequency": {"Hz": 1.0, "kHz": 1e3, "rad/s": 1 / (2 * math.pi)},
    "magnitude": {"dB": LEVEL},
    "real": {},
    "imaginary": {},
    "phase": {"deg": math.pi / 180, "°": math.pi / 180, "rad": 1.0},
}
SIGNED = ("acceleration", "velocity", "position", "force", "grip", "current", "phase")  # a minus turns these
TURNED = "-"  # before a unit, for the other sign
RATIOS = ("magnitude", "real", "imaginary")  # quantities that are an acceleration over an input
LONGEST_UNIT = 100  # characters, of a sensor's with its sensitivity
MOST_LIKELY = {"time": 4, "acceleration": 4}  # number of common units of these quantities
SENSITIVITIES = ("100 mV/g", "10 mV/g", "500 mV/g", "1000 mV/g", "300 mV/g", "50 mV/g", "1 mV/g")
# 16-bit converters with ranges of 2, 4, 8 and 16 g; ADXL345 and ADXL375.
RESOLUTIONS = ("16384 LSB/g", "8192 LSB/g", "4096 LSB/g", "2048 LSB/g", "3.9 mg/LSB", "49 mg/LSB")
_COUNTS = ("count", "counts", "LSB", "digit", "digits")  # units of a converter's reading
_AMOUNT = re.compile(r"\s*(?P<number>-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)?\s*(?P<unit>\S.*?)\s*")
_SIGNS = str.maketrans({"²": "2", "⁻": "-", "µ": "u", "μ": "u", "·": " ", "*": " ", "^": None})
_WORD = re.compile(
    r"(?<![a-z])(?P<prefix>milli|micro|nano|kilo|[munk])?"
    r"(?P<stem>sec|volt|amp|hertz|newton|met|deg|rad|g)(?:onds?|eres?|ers?|res?|rees?|ians?|'?s)?(?![a-z])",
    re.IGNORECASE,
)
_SYMBOLS = {"sec": "s", "volt": "V", "amp": "A", "hertz": "Hz", "newton": "N", "met": "m"}
_SPELT = {
    **dict.fromkeys(("gn", "g_n", "g0"), "g"),
    **dict.fromkeys(("mps2", "mpss", "ms2"), "m/s2"),
    **dict.fromkeys(("mmps2", "mms2"), "mm/s2"),
    **{"mps": "m/s", "mmps": "mm/s"},
    **dict.fromkeys(("gram-force", "gram force", "g-f"), "gf"),
    **dict.fromkeys(("kilogram-force", "kilogram force", "kg-f", "kp"), "kgf"),
}
_BRACKETS = re.compile(r"\(([^()]*)\)")
_PER_SECOND_TWICE = re.compile(r"(/s/s|[ _]?s-2|_s2)$", re.IGNORECASE)
_PER_SECOND = re.compile(r"_s$", re.IGNORECASE)


class Unit(NamedTuple):
    """Meaning of a unit.

    Attributes
    ----------
    factor : to SI; `LEVEL` for a level in dB.
    per : input of a response, "current" or "voltage"; empty if the unit does not state it.
    slopes : number of derivatives that make the response one of acceleration: 1 for a velocity, 2 for a position.
    """

    factor: float
    per: str = ""
    slopes: int = 0

    def means(self, other: "Unit") -> bool:
        """Whether another unit has the same meaning."""
        levels = math.isnan(self.factor), math.isnan(other.factor)
        same = (self.per, self.slopes) == (other.per, other.slopes)
        return same and (all(levels) or math.isclose(self.factor, other.factor))


def _symbol(word: re.Match[str]) -> str:
    prefix, stem = word["prefix"] or "", word["stem"].lower()
    short = "u" if prefix.lower() == "micro" else prefix[:1]
    return (short.lower() if len(prefix) > 1 or word[0].isupper() else short) + _SYMBOLS.get(stem, stem)


def _plain(unit: str) -> str:
    """The normal spelling of a unit, without superscripts, words or special characters."""
    plain = " ".join(_BRACKETS.sub(r"\1", unit).replace("**", "").translate(_SIGNS).split())
    return _PER_SECOND.sub("/s", _PER_SECOND_TWICE.sub("/s2", _WORD.sub(_symbol, plain)))


_EXACT = {of: {_plain(unit): factor for unit, factor in table.items()} for of, table in UNITS.items()}
_SMALL = {of: {unit.lower(): factor for unit, factor in table.items()} for of, table in _EXACT.items()}


def _factor(unit: str, quantity: str) -> float | None:
    """Factor of a unit to SI; None if the quantity does not have this unit."""
    if len(unit) > LONGEST_UNIT:
        return None
    if "@" in unit:
        return _sensed(unit, quantity)
    if unit[:1] == TURNED:
        factor = _factor(unit[1:], quantity) if quantity in SIGNED else None
        return None if factor is None else -factor
    plain, exact = _SPELT.get(_plain(unit), _plain(unit)), _EXACT[quantity]
    if plain in exact:
        return exact[plain]
    if plain[:1] == "M" and plain[1:] in exact:
        return None  # mega, which lower case would turn into milli
    return _SMALL[quantity].get(plain.lower())


def _sensed(unit: str, quantity: str) -> float | None:
    """Factor to SI of a sensor's volts or counts, from its sensitivity, which may be written either way up."""
    signal, _, sensitivity = unit.partition("@")
    read, pieces = _electrical(signal), sensitivity.split("/")
    for at in range(1, len(pieces) if read else 0):
        amounts = [_AMOUNT.fullmatch("/".join(part).strip(" ()")) for part in (pieces[:at], pieces[at:])]
        told = [(float(found["number"] or 1), found["unit"]) for found in amounts if found]
        for (by, electrical), (of, sensed) in (told, told[::-1]) if len(told) == 2 else ():
            given, factor = _electrical(electrical), _factor(sensed, quantity)
            if given and read and factor is not None and given[0] == read[0] and by != 0 != of:
                return factor * of * read[1] / (by * given[1])
    return None


def _electrical(unit: str) -> tuple[str, float] | None:
    """Kind and size of a sensor's electrical unit, volts or counts; None for any other unit."""
    if unit.strip() in _COUNTS:
        return "counts", 1.0
    factor = _factor(unit.strip(), "voltage")
    return None if factor is None else ("voltage", factor)


def sensed(unit: str) -> list[str]:
    """A unit of volts or counts with the sensitivities of common sensors."""
    return [f"{unit} @ {by}" for by in (RESOLUTIONS if unit in _COUNTS else SENSITIVITIES)]


def is_electrical(unit: str) -> bool:
    """Whether a unit is a sensor's electrical unit, volts or counts."""
    return _electrical(unit) is not None


def is_sensed(stated: str, label: str) -> bool:
    """Whether a stated unit with a sensitivity applies to the volts or counts of the file's label."""
    read, mark, _ = stated.partition("@")
    return bool(mark) and (not label or _electrical(label) == _electrical(read))


def parts(unit: str) -> tuple[str, str]:
    """Split a unit such as g/V into that of the acceleration and that of the input; the second may be empty."""
    if len(unit) > LONGEST_UNIT:
        return unit, ""
    above, _, below = re.sub(r"\s+per\s+", "/", unit).rpartition("/")
    if above and any(_factor(below, per) is not None for per in INPUTS):
        return above.strip(" ()"), below
    return unit, ""


def input_unit(unit: str) -> Unit | None:
    """Meaning of 1 / (unit of an input) in a response; None if the unit is not that of an input."""
    factors = {per: _factor(unit, per) for per in INPUTS}
    return next((Unit(1 / factor, per) for per, factor in factors.items() if factor is not None), None)


def with_input(unit: str, other: str) -> str:
    """A unit without an input, such as g, over the input of another unit; unchanged if it has an input itself."""
    below = parts(other)[1]
    is_bare = any(_factor(unit, of) is not None for of in ("acceleration", "velocity", "position"))
    return f"{unit}/{below}" if is_bare and below else unit


def read_unit(unit: str, quantity: str) -> Unit | None:
    """Meaning of a unit as instruments write it; None if the quantity does not have this unit."""
    factor = _factor(unit, quantity)
    if factor is not None or quantity not in RATIOS:
        return None if factor is None else Unit(factor)
    above, below = parts(unit)
    by = input_unit(below) if below else Unit(1.0)
    if by is None:
        return None
    found = enumerate(_factor(above, of) for of in ("acceleration", "velocity", "position"))
    return next((Unit(factor * by.factor, by.per, k) for k, factor in found if factor is not None), None)


def is_unit(text: str) -> bool:
    """Whether a text is a unit of any quantity."""
    return any(read_unit(text, quantity) is not None for quantity in UNITS)


def is_exact(text: str) -> bool:
    """Whether a text is a unit of any quantity in its usual spelling, capital and small letters included."""
    plain = _SPELT.get(_plain(text), _plain(text))
    return any(plain in table for table in _EXACT.values())


def remedy_of(unit: str) -> str:
    """Remedy for a column in the unit of another quantity than expected; empty if none is known."""
    above = parts(unit)[0]
    if _factor(above, "velocity") is not None:
        return "; that is a velocity: name the column so, velocity for example"
    return ""


def known_units(quantity: str) -> list[str]:
    """Units of a quantity, for messages; the first is SI."""
    ratios = [f"{unit}/{per}" for unit in ("m/s^2", "g", "mm/s^2") for per in INPUTS.values()]
    return (ratios if quantity in RATIOS else []) + list(UNITS[quantity])


def likely_units(quantity: str, label: str = "") -> list[str]:
    """Likely units of a column, for an acceleration also volts and counts of common sensors.

    Parameters
    ----------
    label : what the file says in place of a unit; a mass is likely the force of its weight.
    """
    sensors = [*sensed("V")[:3], *sensed("mV")[:3], *sensed("LSB")] if quantity == "acceleration" else []
    units = [*known_units(quantity)[: MOST_LIKELY.get(quantity, 6)], *sensors]
    return sorted(units, key=lambda unit: unit != f"{label}f")
