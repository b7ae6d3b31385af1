"""What the columns of a file are called: names that the project knows, names that instruments write, and their units.

A name in a file is understood in one of three ways:

- `acceleration_g`, a name of the project's own: quantity and unit in one word;
- `acc [g]`, `time (ms)`, `Force/N`: a usual name of the quantity with its unit behind it;
- `acc` with a unit that the user states (`--units acc=g`, or `units = { acc = "g" }` in a scene).

A unit is never guessed: 9.81 lies between the two that are usual for an acceleration.
"""

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2

SKIPPED = "-"
LONGEST_SHOWN = 300  # characters of all names together, which a message repeats
# An unknown name that ends like this is more likely a misspelt quantity than something of the user's own.
UNIT_SUFFIX = re.compile(r"_([mc]?m_s2?|[mcu]?m|m?g|m?N|m?A|[mu]?s)$", re.IGNORECASE)
_WITH_UNIT = re.compile(r"(?P<base>[^\[\](){}/]+?)\s*(?:[\[({](?P<inside>[^\[\](){}]*)[\])}]|/\s*(?P<behind>\S+))")
_G = STANDARD_GRAVITY_M_S2
_TEMPERATURE = {"C": 1.0, "degC": 1.0, "°C": 1.0}
# In the place of a factor: a magnitude of so many dB is 10^(dB / 20), re 1 m/s^2 per A or V.
LEVEL = math.nan
_PER_INPUT = {f"{a}/{u}": factor for a, factor in (("m/s^2", 1.0), ("m/s2", 1.0), ("g", _G)) for u in "AV"}
# Quantity -> unit as instruments write it -> factor to SI. `_plain` spells a superscript or a dot as the table does.
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "acceleration": {
        "m/s^2": 1.0,
        "m/s2": 1.0,
        "m/s/s": 1.0,
        "m s-2": 1.0,
        "m_s2": 1.0,
        "g": _G,
        "gn": _G,
        "mg": 1e-3 * _G,
    }
    | {"mm/s^2": 1e-3, "mm/s2": 1e-3},
    "position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "current": {"A": 1.0, "mA": 1e-3},
    "command": {"A": 1.0, "mA": 1e-3},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "winding": _TEMPERATURE,
    "housing": _TEMPERATURE,
    "ambient": _TEMPERATURE,
    "frequency": {"Hz": 1.0, "kHz": 1e3, "rad/s": 1 / (2 * math.pi)},
    "magnitude": {**_PER_INPUT, "dB": LEVEL},
    "real": _PER_INPUT,
    "imaginary": _PER_INPUT,
    "phase": {"deg": math.pi / 180, "°": math.pi / 180, "rad": 1.0},
}
# Quantity -> what else it is called, in small letters.
ALIASES: Mapping[str, tuple[str, ...]] = {
    "time": ("t", "zeit", "times"),
    "acceleration": ("acc", "accel", "a", "beschleunigung"),
    "position": ("pos", "displacement", "z"),
    "force": ("f", "hammer", "kraft"),
    "current": ("i", "strom"),
    "command": ("cmd",),
    "voltage": ("u", "v"),
    "frequency": ("freq", "f", "frequenz"),
    "magnitude": ("mag", "abs", "amplitude", "gain", "betrag"),
    "real": ("re", "realteil"),
    "imaginary": ("imag", "im", "imaginaerteil"),
    "phase": ("angle", "arg"),
}


@dataclass(frozen=True)
class Scalar:
    """A number in the file's head.

    Attributes
    ----------
    quantity : what it is, "speed" for example.
    factor : from the file's unit to SI.
    unit : the file's unit, as messages write it.
    zero : whether it may be zero.
    """

    quantity: str
    factor: float
    unit: str
    zero: bool = False


@dataclass(frozen=True)
class Vocabulary:
    """What a reader's files may hold.

    Attributes
    ----------
    columns : name in the file -> (quantity, factor to SI); "time" is one of the quantities.
    header : name in the file -> scalar.
    required : quantities that every file has.
    step_s : shortest and longest median time step [s].
    unit_suffix : how names end that are meant for a quantity, known or misspelt; others are the user's own.
    """

    columns: Mapping[str, tuple[str, float]]
    header: Mapping[str, Scalar]
    required: tuple[str, ...]
    step_s: tuple[float, float]
    unit_suffix: re.Pattern[str] = UNIT_SUFFIX

    @property
    def quantities(self) -> tuple[str, ...]:
        """Every quantity that a column may have, once."""
        return tuple(dict.fromkeys(of for of, _ in self.columns.values()))


@dataclass(frozen=True)
class Layout:
    """What a user states about files that do not state it themselves.

    Attributes
    ----------
    columns : names of the file's columns, "-" for one to skip. In text they replace the header row, in NPZ and MAT
        they choose the variables; WAV ignores them.
    units : unit of a column, by its name or by its quantity.
    full_scale_m_s2 : acceleration of full scale [m/s^2], needed by WAV and ignored by the others.
    channel : of a WAV file with several, counted from 1.
    """

    columns: Sequence[str] = ()
    units: Mapping[str, str] | None = None
    full_scale_m_s2: float | None = None
    channel: int | None = None


def stated_units(text: str) -> dict[str, str]:
    """The units of a command line, `time=ms,acc=g`, by name of the column or quantity.

    Raises
    ------
    InputError : something else.
    """
    pairs = [pair.partition("=") for pair in text.split(",") if pair.strip()]
    for name, mark, unit in pairs:
        if not (name.strip() and mark and unit.strip()):
            raise InputError(f"--units {text}: {name.strip()!r} has no unit; write --units time=s,acceleration=g")
    return {name.strip(): unit.strip() for name, _, unit in pairs}


def split_names(line: str) -> list[str]:
    """The names in a header row, whatever stands between them; a unit in brackets belongs to the name before it."""
    mark = next((mark for mark in (";", ",", "\t") if mark in line.strip(" \t;,")), None)
    if mark is None:
        line = re.sub(r"\s+(?=[\[({])", "", line.strip())
    return [cell.strip() for cell in line.rstrip(";, \t").split(mark)]


def _plain(unit: str) -> str:
    """A unit without the signs that keyboards lack."""
    plain = unit.strip().replace("²", "^2").replace("**", "^").replace("µ", "u").replace("μ", "u")
    return plain.replace("⁻", "-").replace("·", " ").replace("*", " ")


def factor_of(unit: str, quantity: str) -> float | None:
    """What makes SI of a unit as instruments write it; None for a unit that this quantity does not have."""
    table = UNITS[quantity]
    return table.get(unit.strip(), table.get(_plain(unit)))


def _quantity(base: str, words: Vocabulary) -> str | None:
    """The quantity that a name without unit means, None if none."""
    small = base.strip().lower()
    named = (q for q in words.quantities if small == q or small in ALIASES.get(q, ()))
    return next(named, None)


def _quantity_of(name: str, words: Vocabulary) -> str | None:
    """The quantity that a column means by its name, with or without a unit; None if none."""
    return words.columns[name][0] if name in words.columns else _quantity(_apart(name)[0], words)


def looks_known(name: str, words: Vocabulary) -> bool:
    """Whether a name means a quantity, with or without its unit."""
    return _quantity_of(name, words) is not None


def stated_for(name: str, words: Vocabulary, units: Mapping[str, str]) -> bool:
    """Whether a user states a unit for a name that means a quantity."""
    quantity = _quantity(_apart(name)[0], words)
    return quantity is not None and (name in units or quantity in units)


def _apart(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit."""
    found = _WITH_UNIT.fullmatch(name.strip())
    if found is None:
        return name, None
    return found["base"].replace("_", " ").strip(), (found["inside"] or found["behind"] or "").strip() or None


def _stated_unit(name: str, quantity: str, units: Mapping[str, str]) -> str | None:
    """The unit of a column, as a user or the file states it; None if neither does."""
    base, stated = _apart(name)
    return next((units[key] for key in (name, base, quantity) if key in units), stated)


def _lacks_unit(name: str, words: Vocabulary, units: Mapping[str, str]) -> bool:
    quantity = _quantity(_apart(name)[0], words)
    return name not in words.columns and quantity is not None and _stated_unit(name, quantity, units) is None


def meaning(name: str, words: Vocabulary, units: Mapping[str, str], names: Sequence[str]) -> tuple[str, float]:
    """Quantity and factor to SI of a column.

    Parameters
    ----------
    units : as a user states them, see `Layout`; they take the place of the unit in the file.
    names : of all columns, in order, for the message that says how to skip this one.

    Raises
    ------
    InputError : a name that means nothing here, or a unit that is none of the quantity.
    """
    quantity = _quantity_of(name, words)
    if quantity is None:
        known = ", ".join(words.columns)
        usual = "time [s], acc [g] and the like"
        kept = "time_s,-,..."
        if sum(map(len, names)) < LONGEST_SHOWN:
            kept = ",".join(SKIPPED if _quantity_of(each, words) is None else each for each in names)
        remedy = f"rename it, or skip it: --columns {shlex.quote(kept)} (in a scene recordings.columns)"
        raise InputError(f"unknown column {quote(name)}; known: {known}, or {usual}; {remedy}")
    unit = _stated_unit(name, quantity, units)
    if unit is None and name in words.columns:
        return words.columns[name]
    factor = UNITS[quantity].get(_plain(unit or ""))
    if factor is None:
        known = ", ".join(UNITS[quantity])
        hint = (
            "; divide a sensor's voltage by its sensitivity first" if _plain(unit or "") in UNITS["voltage"] else ""
        )
        raise InputError(f"column {quote(name)}: {quote(unit or '')} is no unit of {quantity}; known: {known}{hint}")
    return quantity, factor


def meanings(
    names: Sequence[str], words: Vocabulary, units: Mapping[str, str], found: Sequence[str] = ()
) -> dict[str, tuple[str, float]]:
    """Quantity and factor of all columns but the skipped ones.

    Parameters
    ----------
    found : the variables that a file has, where the columns are chosen from them.

    Raises
    ------
    InputError : see `meaning`; a quantity twice, or a required one not at all.
    """
    present = quote(", ".join(found or names))
    used = [name for name in names if name != SKIPPED]
    said, without = {}, [name for name in used if _lacks_unit(name, words, units)]
    if without:
        wanted = [_quantity(_apart(name)[0], words) or name for name in without]
        stated = [f"{quantity}={next(iter(UNITS[quantity]))}" for quantity in wanted]
        in_scene = ", ".join(f'{quantity} = "{next(iter(UNITS[quantity]))}"' for quantity in wanted)
        known = "; ".join(f"{quantity} in {', '.join(UNITS[quantity])}" for quantity in wanted)
        raise InputError(
            f"no unit stated in the column{'s' * (len(without) > 1)} {quote(', '.join(without))}; state it, for "
            f"example --units {','.join(stated)} (in a scene recordings.units = {{ {in_scene} }}); known: {known}"
        )
    for name in used:
        said[name] = meaning(name, words, units, names)
        if found and name not in found:
            raise InputError(f"no variable {name}; found: {present}; correct the name")
    for quantity in words.quantities:
        count = sum(said[name][0] == quantity for name in used)
        if count > 1 or (count == 0 and quantity in words.required):
            choice = " or ".join(name for name, (of, _) in words.columns.items() if of == quantity)
            raise InputError(f"{count} {quantity} columns in {present}: must be 1; name one {choice}")
    own = {*said, *(_apart(name)[0] for name in said), *words.quantities}
    unused = [key for key in units if key not in own]
    if unused:
        raise InputError(f"--units {unused[0]}: no column of that name; the file has {present}")
    return said


def quote(text: str) -> str:
    """The text in quotes, on one line, at most 120 characters of it."""
    line = " ".join(text.split())
    return repr(line if len(line) <= 120 else line[:117] + "...")
