"""What the columns of a file are called: names that the project knows, names that instruments write, and their units.

A name in a file is understood in one of three ways:

- `acceleration_g`, quantity and unit in one word, as the project's own names are, or `acc_g`;
- `acc [g]`, `time (ms)`, `Force/N`: a usual name of the quantity with its unit behind it;
- `acc` with a unit that the user states (`--units acc=g`, or `units = { acc = "g" }` in a scene).

A unit is never guessed: 9.81 lies between the two that are usual for an acceleration.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from transopt.base.errors import InputError
from transopt.recordings.units import (
    RATIOS,
    read_unit,
)

SKIPPED = "-"
MOST_CHOICES = 8  # among columns of one quantity
# An unknown name that ends like this is more likely a misspelt quantity than something of the user's own.
UNIT_SUFFIX = re.compile(r"_([mc]?m_s2?|[mcu]?m|m?g|m?N|m?A|[mu]?s)$", re.IGNORECASE)
# A unit behind a name: in brackets, behind a stroke, or behind "in".
_WITH_UNIT = (
    re.compile(r"(?P<base>[^\[\](){}]+?)\s*[\[({](?P<unit>([^\[\](){}]|\([^()]*\))*)[\])}]"),
    re.compile(r"(?P<base>[^\[\](){}/]+?)\s*(?:/|\sin\s)\s*(?P<unit>\S+)"),
)
# Names of times that say their unit: of programs, of LabVIEW's text, of a processor's counters.
NAMED_UNITS = {
    **dict.fromkeys(("second", "seconds", "sec", "seconds elapsed", "x value", "in s"), "s"),
    **dict.fromkeys(("millis", "milliseconds"), "ms"),
    **dict.fromkeys(("micros", "microseconds"), "us"),
}
STEMS = ("linear acceleration", "acceleration", "accelerometer", "accel", "acc", "a", "gf")
# One of three axes, as in accel_x or ay; an underscore is read as a blank.
AXES = tuple(f"{stem}{mark}{axis}" for stem in STEMS for mark in ("", " ") for axis in "xyz")
# Quantity -> what else it is called, in small letters.
ALIASES: Mapping[str, tuple[str, ...]] = {
    "time": (
        *(
            "t",
            "zeit",
            "times",
            "timestamp",
            "timestamps",
            "time stamp",
            "elapsed time",
            "time since start",
            "x-axis",
        ),
        *NAMED_UNITS,
    ),
    "acceleration": (*STEMS[:-1], "beschleunigung", *AXES),
    "velocity": ("vel", "geschwindigkeit"),
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


class Meaning(NamedTuple):
    """What a column of a file means.

    Attributes
    ----------
    quantity : "acceleration" for example.
    factor : from the file's unit to SI; `units.LEVEL` for a level in dB.
    per : what a response is to, "current" or "voltage"; empty where nobody states it.
    stated : the unit as user or file state it; empty where neither does.
    note : that the user states another unit than the file, in one sentence; empty where both agree.
    slopes : see `units.Unit`.
    """

    quantity: str
    factor: float
    per: str = ""
    stated: str = ""
    note: str = ""
    slopes: int = 0


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
    called : name of a column without its unit -> quantity, as a user states it.
    """

    columns: Mapping[str, tuple[str, float]]
    header: Mapping[str, Scalar]
    required: tuple[str, ...]
    step_s: tuple[float, float]
    unit_suffix: re.Pattern[str] = UNIT_SUFFIX
    called: Mapping[str, str] = field(default_factory=dict)

    def knowing(self, units: Mapping[str, str]) -> "Vocabulary":
        """The words, and a user's own names whose stated unit only one quantity has, as CH1 in "V @ 0.1 V/g"."""
        own = {name: [of for of in self.quantities if read_unit(unit, of)] for name, unit in units.items()}
        # A response's unit is that of its magnitude; a complex array is parted into its two parts.
        clear = {name: of[0] for name, of in own.items() if len(of) == 1 or (of and set(of) <= set(RATIOS))}
        called = {name: of for name, of in clear.items() if called_quantity(name, self) is None}
        return replace(self, called=called) if called else self

    def lacks(self, names: Iterable[str]) -> bool:
        """Whether a required quantity is among none of the names."""
        return bool(lacking({quantity_of(name, self) for name in names}, self))

    def labelled(self, names: Sequence[str]) -> "Vocabulary":
        """The words, and names that mean nothing here but have a unit of a required quantity that no other has."""
        present = {quantity_of(name, self) for name in names}
        own = [pair for name in names if quantity_of(name, self) is None and (pair := apart(name))[1]]
        called = {base: of for of in lacking(present, self) for base, unit in own if read_unit(unit or "", of)}
        return replace(self, called={**self.called, **called}) if called else self

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
        they choose the variables.
    units : unit of a column, by its name or by its quantity.
    full_scale_m_s2 : acceleration of full scale of WAV files [m/s^2].
    channel : of a WAV file with several, counted from 1.
    rate_Hz : sample rate of all files but WAV, which goes before what a column of times says.
    axis : how several axes of an accelerometer become one signal, see `axes.joined`; empty for the default.
    """

    columns: Sequence[str] = ()
    units: Mapping[str, str] | None = None
    full_scale_m_s2: float | None = None
    channel: int | None = None
    rate_Hz: float | None = None
    axis: str = ""


def with_axes(names: Sequence[str]) -> list[str]:
    """Names of columns in which x, y and z, alone in a name and together, are the axes of an accelerometer."""
    alone = {apart(name)[0].lower() for name in names}
    is_axis = [alone >= set("xyz") and apart(name)[0].lower() in set("xyz") for name in names]
    return [f"acc {name}" if axis else name for name, axis in zip(names, is_axis, strict=True)]


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


def called_quantity(base: str, words: Vocabulary) -> str | None:
    """The quantity that a name without unit means, None if none."""
    small = base.strip().lower().replace("_", " ")
    if base in words.called:
        return words.called[base]
    named = (q for q in words.quantities if small == q or small in ALIASES.get(q, ()))
    return next(named, None)


def quantity_of(name: str, words: Vocabulary) -> str | None:
    """The quantity that a column means by its name, with or without a unit; None if none."""
    return words.columns[name][0] if name in words.columns else called_quantity(apart(name)[0], words)


def axis_of(name: str) -> str:
    """The axis that a column's name ends in before its unit, as accel_x or ay_g; empty where it names none."""
    small = apart(name)[0].lower().replace("_", " ")
    return small[-1] if small in AXES else ""


def means_acceleration(name: str, words: Vocabulary) -> bool:
    """Whether a column holds an acceleration, with or without a unit."""
    return quantity_of(name, words) == "acceleration"


def means_time(name: str, words: Vocabulary) -> bool:
    """Whether a column holds the times of the rows, with or without a unit."""
    return quantity_of(name, words) == "time"


def looks_known(name: str, words: Vocabulary) -> bool:
    """Whether a name means a quantity, with or without its unit."""
    return quantity_of(name, words) is not None


def spared(names: Sequence[str], words: Vocabulary) -> tuple[list[str], str]:
    """Columns without those that mean nothing here, where the others suffice; and a sentence that names these.

    A name that ends in a unit may be a misspelt quantity: it stays, and is refused.
    """
    idle = [name for name in names if not looks_known(name, words) and not words.unit_suffix.search(name)]
    idle = [name for name in idle if name != SKIPPED]
    present = {quantity_of(name, words) for name in names}
    if not idle or lacking(present, words):
        return list(names), ""
    plural = "s" if len(idle) > 1 else ""
    said = f"column{plural} {quote(', '.join(idle))} not used: nothing here goes by such a name"
    return [SKIPPED if name in idle else name for name in names], said


def lacking(present: Collection[str | None], words: Vocabulary) -> list[str]:
    """Required quantities that are absent; a velocity stands for the acceleration, which is its slope."""
    lacking = [of for of in words.required if of not in present]
    return [of for of in lacking if of != "acceleration" or "velocity" not in present]


def stated_for(name: str, words: Vocabulary, units: Mapping[str, str]) -> bool:
    """Whether a user states a unit for a name that means a quantity."""
    quantity = called_quantity(apart(name)[0], words)
    return quantity is not None and stated_unit(name, quantity, units) is not None


def apart(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit."""
    found = next(filter(None, (pattern.fullmatch(name.strip()) for pattern in _WITH_UNIT)), None)
    small = name.strip().lower().replace("_", " ")
    if found is None and (unit := NAMED_UNITS.get(small, "g" if small[:2] == "gf" and small in AXES else None)):
        return name, unit
    if found is None:
        return next(
            filter(None, (_unit_in_word(name, at) for at, mark in enumerate(name) if mark == "_")), (name, None)
        )
    return found["base"].strip(), found["unit"].strip() or None


def _unit_in_word(name: str, at: int) -> tuple[str, str] | None:
    """Quantity and unit of a name like acc_g or pos_mm, parted at an underscore; None if they are none."""
    base, unit = name[:at].strip(), name[at + 1 :].strip()
    small = base.lower().replace("_", " ")
    of = (quantity for quantity, names in ALIASES.items() if small in (quantity, *names))
    return (base, unit) if any(read_unit(unit, quantity) for quantity in of) else None


def stated_unit(name: str, quantity: str, units: Mapping[str, str]) -> str | None:
    """The unit of a column as a user states it; None if no user does."""
    return next((units[key] for key in (*keys_of(name), quantity) if key in units), None)


def keys_of(name: str) -> tuple[str, ...]:
    """What a user may call a column by: its name, that without unit, that without axis, and the axis alone."""
    base = apart(name)[0]
    return (name, base, base[:-1].strip(" _"), base[-1]) if axis_of(name) else (name, base)


def lacks_unit(name: str, words: Vocabulary, units: Mapping[str, str]) -> bool:
    base, label = apart(name)
    quantity = None if label or name in words.columns else called_quantity(base, words)
    return quantity is not None and stated_unit(name, quantity, units) is None


def quote(text: str) -> str:
    """The text in quotes, on one line, at most 120 characters of it."""
    line = " ".join(text.split())
    return repr(line if len(line) <= 120 else line[:117] + "...")
