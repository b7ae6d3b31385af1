"""Units as instruments and people write them, and what makes SI of each: one table for all readers.

A unit means what it says whatever signs, words or capitals spell it: m/s², M/S^2, m/sec**2 and m s-2 are one unit. A
capital that changes the meaning counts: MV is no millivolt. A response has an acceleration, a velocity or a
position over an input, g/V for example; its parts are looked up in the rows of these quantities. What a sensor gives
before anybody has divided by its sensitivity is written with it: "mV @ 100 mV/g", "counts @ 3.9 mg/count".
"""

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from transopt.base.signals import STANDARD_GRAVITY_M_S2

# In the place of a factor: a magnitude of so many dB is 10^(dB / 20), re 1 m/s^2 per A or V.
LEVEL = math.nan
INPUTS: Mapping[str, str] = {"current": "A", "voltage": "V"}  # quantity that may drive an actuator -> its SI unit
_CURRENT = {"A": 1.0, "mA": 1e-3, "uA": 1e-6}
_TEMPERATURE = {"C": 1.0, "degC": 1.0, "°C": 1.0}
# Quantity -> unit -> factor to SI; other spellings are found by `_plain`.
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
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
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
RATIOS = ("magnitude", "real", "imaginary")  # quantities that are an acceleration over an input
MOST_LIKELY = {"time": 4, "acceleration": 4}  # units that are usual for these
SENSITIVITIES = ("100 mV/g", "10 mV/g", "500 mV/g", "1000 mV/g", "300 mV/g", "50 mV/g", "1 mV/g")
# Converters of 16 bits with ranges of 2, 4, 8 and 16 g; ADXL345 and ADXL375.
RESOLUTIONS = ("16384 LSB/g", "8192 LSB/g", "4096 LSB/g", "2048 LSB/g", "3.9 mg/LSB", "49 mg/LSB")
_COUNTS = ("count", "counts", "LSB", "digit", "digits")  # of a converter
_AMOUNT = re.compile(r"\s*(?P<number>\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)?\s*(?P<unit>\S.*?)\s*")
_SIGNS = str.maketrans({"²": "2", "⁻": "-", "µ": "u", "μ": "u", "·": " ", "*": " ", "^": None})
_WORD = re.compile(
    r"(?<![a-z])(?P<prefix>milli|micro|nano|kilo|[munk])?"
    r"(?P<stem>sec|volt|amp|hertz|newton|met|deg|rad|g)(?:onds?|eres?|ers?|res?|rees?|ians?|'?s)?(?![a-z])",
    re.IGNORECASE,
)
_SYMBOLS = {"sec": "s", "volt": "V", "amp": "A", "hertz": "Hz", "newton": "N", "met": "m"}
_SPELT = {"gn": "g", "g_n": "g", "g0": "g"}
_BRACKETS = re.compile(r"\(([^()]*)\)")
_PER_SECOND_TWICE = re.compile(r"(/s/s|[ _]?s-2|_s2)$", re.IGNORECASE)
_PER_SECOND = re.compile(r"_s$", re.IGNORECASE)


class Unit(NamedTuple):
    """What a unit means.

    Attributes
    ----------
    factor : to SI; `LEVEL` for a level in dB.
    per : what a response is to, "current" or "voltage"; empty where the unit does not say it.
    slopes : how often a response is differentiated to be an acceleration's: once a velocity's, twice a position's.
    """

    factor: float
    per: str = ""
    slopes: int = 0

    def means(self, other: "Unit") -> bool:
        """Whether another unit is the same, however it is spelled."""
        levels = math.isnan(self.factor), math.isnan(other.factor)
        same = (self.per, self.slopes) == (other.per, other.slopes)
        return same and (all(levels) or math.isclose(self.factor, other.factor))


def _symbol(word: re.Match[str]) -> str:
    prefix, stem = word["prefix"] or "", word["stem"].lower()
    short = "u" if prefix.lower() == "micro" else prefix[:1]
    return (short.lower() if len(prefix) > 1 or word[0].isupper() else short) + _SYMBOLS.get(stem, stem)


def _plain(unit: str) -> str:
    """One spelling of a unit's many: no superscripts, words or signs that keyboards lack."""
    plain = " ".join(_BRACKETS.sub(r"\1", unit).replace("**", "").translate(_SIGNS).split())
    return _PER_SECOND.sub("/s", _PER_SECOND_TWICE.sub("/s2", _WORD.sub(_symbol, plain)))


_EXACT = {of: {_plain(unit): factor for unit, factor in table.items()} for of, table in UNITS.items()}
_SMALL = {of: {unit.lower(): factor for unit, factor in table.items()} for of, table in _EXACT.items()}


def _factor(unit: str, quantity: str) -> float | None:
    """What makes SI of a unit; None for one that this quantity does not have."""
    if "@" in unit:
        return _sensed(unit, quantity)
    plain, exact = _SPELT.get(_plain(unit), _plain(unit)), _EXACT[quantity]
    if plain in exact:
        return exact[plain]
    if plain[:1] == "M" and plain[1:] in exact:
        return None  # mega, which small letters would make milli
    return _SMALL[quantity].get(plain.lower())


def _sensed(unit: str, quantity: str) -> float | None:
    """What makes SI of a sensor's volts or counts by its sensitivity, which may be written either way up."""
    signal, _, sensitivity = unit.partition("@")
    read, pieces = _electrical(signal), sensitivity.split("/")
    for at in range(1, len(pieces) if read else 0):
        amounts = [_AMOUNT.fullmatch("/".join(part).strip(" ()")) for part in (pieces[:at], pieces[at:])]
        told = [(float(found["number"] or 1), found["unit"]) for found in amounts if found]
        for (by, electrical), (of, sensed) in (told, told[::-1]) if len(told) == 2 else ():
            given, factor = _electrical(electrical), _factor(sensed, quantity)
            if given and read and factor is not None and given[0] == read[0] and min(by, of) > 0:
                return factor * of * read[1] / (by * given[1])
    return None


def _electrical(unit: str) -> tuple[str, float] | None:
    """Kind and size of what a sensor gives, in volts or counts; None for something else."""
    if unit.strip() in _COUNTS:
        return "counts", 1.0
    factor = _factor(unit.strip(), "voltage")
    return None if factor is None else ("voltage", factor)


def sensed(unit: str) -> list[str]:
    """A unit of volts or counts with the sensitivities of usual sensors."""
    return [f"{unit} @ {by}" for by in (RESOLUTIONS if unit in _COUNTS else SENSITIVITIES)]


def is_electrical(unit: str) -> bool:
    """Whether a unit is what a sensor gives, volts or counts."""
    return _electrical(unit) is not None


def is_sensed(stated: str, label: str) -> bool:
    """Whether a unit with a sensitivity reads the volts or counts that a file's label says."""
    read, mark, _ = stated.partition("@")
    return bool(mark) and (not label or _electrical(label) == _electrical(read))


def parts(unit: str) -> tuple[str, str]:
    """The unit of an acceleration and that of an input, of a unit like g/V; the second is empty where it has none."""
    above, _, below = re.sub(r"\s+per\s+", "/", unit).rpartition("/")
    if above and any(_factor(below, per) is not None for per in INPUTS):
        return above.strip(" ()"), below
    return unit, ""


def input_unit(unit: str) -> Unit | None:
    """What one over a unit of an input means in a response; None for a unit that is none of an input."""
    factors = {per: _factor(unit, per) for per in INPUTS}
    return next((Unit(1 / factor, per) for per, factor in factors.items() if factor is not None), None)


def with_input(unit: str, other: str) -> str:
    """A unit of an acceleration over the input that another unit has, where it has none itself."""
    below = parts(other)[1]
    is_bare = any(_factor(unit, of) is not None for of in ("acceleration", "velocity", "position"))
    return f"{unit}/{below}" if is_bare and below else unit


def read_unit(unit: str, quantity: str) -> Unit | None:
    """The meaning of a unit as instruments write it; None for one that this quantity does not have."""
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


def remedy_of(unit: str) -> str:
    """What to do with a column in a unit of another quantity than the wanted one; empty where that is not known."""
    above = parts(unit)[0]
    if _factor(above, "velocity") is not None:
        return "; that is a velocity: name the column so, velocity for example"
    return ""


def known_units(quantity: str) -> list[str]:
    """Units of a quantity, for messages; the first is that in SI."""
    ratios = [f"{unit}/{per}" for unit in ("m/s^2", "g", "mm/s^2") for per in INPUTS.values()]
    return (ratios if quantity in RATIOS else []) + list(UNITS[quantity])


def likely_units(quantity: str) -> list[str]:
    """Units that a column without one is likely in; of an acceleration also volts and counts of usual sensors."""
    sensors = [*sensed("V")[:3], *sensed("mV")[:3], *sensed("LSB")] if quantity == "acceleration" else []
    return [*known_units(quantity)[: MOST_LIKELY.get(quantity, 6)], *sensors]
