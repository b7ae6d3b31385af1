"""Names of columns in files: the project's own names, names that instruments write, and their units.

A name in a file is understood in one of three ways:

- `acceleration_g`, quantity and unit in one word, as in the project's own names, or `acc_g`, `acc1 g`, `ai0_g`;
- `acc [g]`, `time (ms)`, `Force/N`: a common name of the quantity followed by its unit;
- `acc` with a unit that the user states (`--units acc=g`, or `units = { acc = "g" }` in a scene).

If a required quantity has none of these names, a column counts that has one of its units, such as `Dev1/ai0 [g]`, or
one of its common names among its words, such as `field.linear_acceleration.x`.

A unit is never guessed from the values: g and m/s^2, both common for an acceleration, differ by a factor of 9.81.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

from transopt.base.errors import InputError
from transopt.files.units import RATIOS, Unit, is_electrical, is_exact, is_unit, read_unit

SKIPPED = "-"
LONGEST_NAME = 200  # characters; in a longer name no unit is looked for
MOST_CHOICES = 8  # most choices offered among columns of one quantity
SMALLEST = "min"  # after a name not the unit minutes, but a minimum
# A unit after a name: in brackets, after a slash, or after "in". A number in brackets is an element's index.
_WITH_UNIT = (
    re.compile(r"(?P<base>[^\[\](){}]+?)\s*[\[({](?!\d+[\])}])(?P<unit>([^\[\](){}]|\([^()]*\))*)[\])}]"),
    re.compile(r"(?P<base>[^\[\](){}/]+?)\s*(?:/|\sin\s)\s*(?P<unit>\S+)"),
)
# A bracket followed by a note, such as "Time (s) Run #1", or a unit before a note, such as "Accel, g (sensor 101)".
_NOTED = (
    re.compile(r"(?P<base>[^\[\](){}]+?)\s*[\[({](?P<unit>[^\[\](){}]+)[\])}]\s*(?P<note>.+)"),
    re.compile(r"(?P<base>.+?)\s+(?P<unit>\S+)\s*(?P<note>\(.*\))"),
)
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-zäöüß]+|\d+")  # one word of a name, also in camel case
# Names of times that imply their unit, in programs, in LabVIEW's text, and of a processor's counters.
NAMED_UNITS = {
    **dict.fromkeys(("second", "seconds", "sec", "seconds elapsed", "x value", "in s"), "s"),
    **dict.fromkeys(("millis", "milliseconds", "ms"), "ms"),
    **dict.fromkeys(("micros", "microseconds", "us"), "us"),
}
STEMS = ("linear acceleration", "acceleration", "accelerometer", "accel", "acc", "a", "gf")
INITIALS = {"a": "acceleration"}  # mean a quantity only beside its unit; a channel A in volts may be any
LOADS = ("load", "load cell", "loadcell", "weight", "thrust")  # mean a force only beside a unit of force
# Words in the name of a column in g that suggest grams, a weight, rather than an acceleration.
WEIGHED = frozenset(
    ("load", "loadcell", "cell", "weight", "mass", "scale", "balance", "gram", "grams", "force", "thrust", "hx")
) | frozenset(("last", "gewicht", "masse", "waage", "kraft", "gramm"))
# Names of one of three axes, such as accel_x or ay; an underscore counts as a blank.
AXES = tuple(f"{stem}{mark}{axis}" for stem in STEMS for mark in ("", " ") for axis in "xyz")
# Quantity -> its other names, in lower case.
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
    "acceleration": (*STEMS[:-2], "beschleunigung", *AXES),
    "velocity": ("vel", "geschwindigkeit"),
    "position": ("pos", "displacement", "travel", "z", "weg", "auslenkung", "verschiebung"),
    "force": ("f", "hammer", "kraft"),
    "grip": ("grip force", "grasp", "grasp force", "griff", "griffkraft"),
    "current": ("i", "strom"),
    "command": ("cmd",),
    "voltage": ("u", "v", "spannung"),
    **dict.fromkeys(("winding", "housing", "ambient"), ()),
    "frequency": ("freq", "f", "frequenz"),
    "magnitude": ("mag", "abs", "amplitude", "gain", "betrag", "accelerance"),
    "real": ("re", "realteil"),
    "imaginary": ("imag", "im", "imaginaerteil"),
    "phase": ("angle", "arg"),
}


@dataclass(frozen=True)
class Scalar:
    """A number in the head of a file.

    Attributes
    ----------
    quantity : such as "speed".
    factor : from the file's unit to SI.
    unit : the file's unit, as in messages.
    zero : whether zero is allowed.
    """

    quantity: str
    factor: float
    unit: str
    zero: bool = False


class Meaning(NamedTuple):
    """Meaning of a column of a file.

    Attributes
    ----------
    quantity : such as "acceleration".
    unit : the file's unit; SI by default.
    stated : the unit as stated by user or file; empty if neither states it.
    note : one sentence if the user states another unit than the file; empty if both agree.
    """

    quantity: str
    unit: Unit = Unit(1.0)
    stated: str = ""
    note: str = ""


@dataclass(frozen=True)
class Vocabulary:
    """The columns and scalars that a reader's files may hold.

    Attributes
    ----------
    columns : the project's own names, quantity and unit in one word; a name without unit is in SI.
    header : name in the file -> scalar.
    required : quantities that every file must have.
    step_s : shortest and longest median time step [s].
    called : name of a column without its unit -> quantity, as the user states it.
    """

    columns: Sequence[str]
    header: Mapping[str, Scalar]
    required: tuple[str, ...]
    step_s: tuple[float, float]
    called: Mapping[str, str] = field(default_factory=dict)

    def knowing(self, units: Mapping[str, str]) -> "Vocabulary":
        """This vocabulary with the user's own names whose stated unit fits one quantity only."""
        # A column in N is a force unless its name says grip.
        by_unit = [of for of in self.quantities if of != "grip"]
        own = {name: [of for of in by_unit if read_unit(unit, of)] for name, unit in units.items()}
        # A unit of a response is that of its magnitude; `formats` splits a complex array into real and imaginary
        # part.
        clear = {name: of[0] for name, of in own.items() if len(of) == 1 or (of and set(of) <= set(RATIOS))}
        called = {name: of for name, of in clear.items() if self.quantity_of(name) is None}
        return replace(self, called=called) if called else self

    def quantity_of(self, name: str) -> str | None:
        """The quantity that a column's name means, with or without a unit; None if it means none."""
        base, unit = apart(name)
        beside = INITIALS.get(base.lower()) if unit and not is_electrical(unit) else None
        if unit and _small(base) in LOADS and read_unit(unit, "force"):
            beside = "force"
        if beside in self.quantities:
            return beside
        return self.called.get(base) or _quantity_called(base, self.quantities)

    def absent(self, names: Iterable[str]) -> list[str]:
        """Required quantities that none of the names means; an acceleration may be the slope of a velocity."""
        present = {self.quantity_of(name) for name in names}
        slope = {"acceleration"} if "velocity" in present else set()
        return [of for of in self.required if of not in present | slope]

    def without_times(self) -> "Vocabulary":
        """This vocabulary for files whose times follow from a rate: times are not required."""
        return replace(self, required=tuple(of for of in self.required if of != "time"))

    def labelled(self, names: Sequence[str]) -> "Vocabulary":
        """This vocabulary with names for missing required quantities, found by unit or by one of their words."""
        absent = self.absent(names)
        own = [apart(name) for name in names if self.quantity_of(name) is None and not is_weighed(name)]
        called = {base: of for of in absent for base, unit in own if unit and read_unit(unit, of)}
        for base, unit in own:
            spoken = [of for of in absent if _words(base) & {of, *ALIASES[of]}]
            if len(spoken) == 1 and base not in called and not (unit and is_unit(unit)):
                called[base] = spoken[0]
        return replace(self, called={**self.called, **called}) if called else self

    @cached_property
    def quantities(self) -> tuple[str, ...]:
        """Every quantity that a column may have, without repetition."""
        return tuple(
            dict.fromkeys(filter(None, (_quantity_called(apart(name)[0], ALIASES) for name in self.columns)))
        )

    def names_of(self, quantity: str) -> list[str]:
        """The project's own names of a quantity."""
        return [name for name in self.columns if self.quantity_of(name) == quantity]

    def is_meant(self, name: str) -> bool:
        """Whether a name ends in a unit, so that it must mean a quantity, even if misspelt."""
        tails = [name[at + 1 :] for at, mark in enumerate(name[:LONGEST_NAME]) if mark == "_"]
        known = {scalar.unit for scalar in self.header.values() if scalar.unit}
        return name in self.columns or any(
            tail in known or (tail != SMALLEST and any(read_unit(tail, of) for of in self.quantities))
            for tail in tails
        )


@dataclass(frozen=True)
class Layout:
    """What a user states about files that the files do not state themselves.

    Attributes
    ----------
    columns : names of the file's columns, "-" for one to skip. In text they replace the header row; in NPZ and MAT
        they choose the variables.
    units : unit of a column, by its name or by its quantity.
    full_scale_m_s2 : acceleration at full scale of WAV files [m/s^2].
    channel : number of the channel in a file with several, counted from 1.
    rate_Hz : sample rate of all files but WAV; it overrides a column of times.
    axis : how the axes of an accelerometer are joined, see `axes.joined`; empty for the default.
    """

    columns: Sequence[str] = ()
    units: Mapping[str, str] | None = None
    full_scale_m_s2: float | None = None
    channel: int | None = None
    rate_Hz: float | None = None
    axis: str = ""


def with_axes(names: Sequence[str]) -> list[str]:
    """The names, with x, y and z marked as axes of an acceleration if all three occur by their letters alone."""
    alone = [_small(apart(name)[0]) for name in names]
    are_axes = set(alone) >= set("xyz") and not any(read_unit(apart(name)[1] or "", "position") for name in names)
    return [
        f"acc {name}" if are_axes and base in set("xyz") else name for name, base in zip(names, alone, strict=True)
    ]


def _small(base: str) -> str:
    """A name in lower case with blanks for underscores, without a trailing "axis"."""
    return base.strip().lower().replace("_", " ").removesuffix("-axis").removesuffix(" axis")


def _words(base: str) -> set[str]:
    """The words of a name, in lower case."""
    return set(map(str.lower, _WORD.findall(base)))


def is_weighed(name: str) -> bool:
    """Whether the name of a column in g suggests grams, a weight, rather than an acceleration."""
    base, unit = apart(name)
    found = _words(base)
    return unit in ("g", "mg") and not WEIGHED.isdisjoint(found) and found.isdisjoint(STEMS)


def stated_units(text: str) -> dict[str, str]:
    """Units from a command line, `time=ms,acc=g`, by name of the column or quantity.

    Raises
    ------
    InputError : the text has another form.
    """
    pairs = [pair.partition("=") for pair in text.split(",") if pair.strip()]
    for name, mark, unit in pairs:
        if not (name.strip() and mark and unit.strip()):
            raise InputError(f"--units {text}: {name.strip()!r} has no unit; write --units time=s,acceleration=g")
    return {name.strip(): unit.strip() for name, _, unit in pairs}


def split_names(line: str, *, by_blanks: bool = True) -> list[str]:
    """The names in a header row, with any delimiter; a unit in brackets belongs to the name before it.

    Parameters
    ----------
    by_blanks : whether blanks separate the names of a row without other delimiters.
    """
    mark = next((mark for mark in (";", ",", "\t") if mark in line.strip(" \t;,")), None)
    if mark is None and not by_blanks:
        return [line.strip(" \t;,")]
    if mark is None:
        line = re.sub(r"(?<!\s)\s+(?=[\[({])", "", line.strip())
    return [cell.strip() for cell in line.rstrip(";, \t").split(mark)]


def _quantity_called(base: str, quantities: Iterable[str]) -> str | None:
    spelt = {base.strip().lower().replace("_", " "), _small(base)}
    return next((of for of in quantities if spelt & {of, *ALIASES[of]}), None)


def is_frequency(name: str) -> bool:
    """Whether a column's name is that of a frequency, over which a response is measured."""
    return _quantity_called(apart(name)[0], ("frequency",)) is not None


def axis_of(name: str) -> str:
    """The axis in the name of an acceleration, as in accel_x, ay_g or acc[0]; empty if none."""
    base = apart(name)[0]
    if _small(base) in AXES:
        return _small(base)[-1]
    found = _words(base) & set("xyz") or {"xyz"[int(at)] for at in re.findall(r"\[([012])\]$", base)}
    return min(found) if len(found) == 1 else ""


def spared(names: Sequence[str], words: Vocabulary, notes: list[str]) -> list[str]:
    """The names with columns of no meaning skipped, if the others suffice.

    A name that ends in a unit may be a misspelt quantity: it is kept, and later refused.

    Parameters
    ----------
    notes : receives a sentence that names the columns skipped.
    """
    idle = [name for name in names if words.quantity_of(name) is None and not words.is_meant(name)]
    idle = [name for name in idle if name != SKIPPED]
    if not idle or words.absent(names):
        return list(names)
    plural = "s" if len(idle) > 1 else ""
    notes.append(f"column{plural} {quote(', '.join(idle))} not used: nothing here goes by such a name")
    return [SKIPPED if name in idle else name for name in names]


def stated_for(name: str, words: Vocabulary, units: Mapping[str, str]) -> bool:
    """Whether the user states a unit for a name with a known quantity."""
    quantity = words.quantity_of(name)
    return quantity is not None and stated_unit(name, quantity, units) is not None


def apart(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit or None."""
    if len(name) > LONGEST_NAME:
        return name, None
    found = next(filter(None, (pattern.fullmatch(name.strip()) for pattern in _WITH_UNIT)), None)
    small = name.strip().lower().replace("_", " ")
    if found is None and (unit := NAMED_UNITS.get(small, "g" if small[:2] == "gf" and small in AXES else None)):
        return name, unit
    if found is None or not is_unit(found["unit"]):
        noted = (each for pattern in _NOTED if (each := pattern.fullmatch(name.strip())) and is_unit(each["unit"]))
        found = next(noted, found)
    if found is None:
        return _unit_in_word(name) or (name, None)
    return found["base"].strip(), found["unit"].strip() or None


def _unit_in_word(name: str) -> tuple[str, str] | None:
    """The beginning of a name and the unit at its end, as in acc_g, acc1 g or ai0_mps2; None without a unit.

    Behind a quantity's name the unit is one of that quantity. Behind any other name it is spelt exactly and follows
    an underscore, because Channel A is no current. What a quantity's name has in Hz is a property of its sensor.
    """
    marks = [at for at, mark in enumerate(name) if mark in "_ "]
    parted = [(name[:at].strip(" _"), name[at + 1 :].strip(), name[at]) for at in marks]
    for base, unit, _ in parted:
        small, words = base.lower().replace("_", " "), _words(base)
        of = (
            quantity
            for quantity, names in ALIASES.items()
            if small in (quantity, *names)
            or INITIALS.get(small) == quantity
            or (quantity == "force" and small in LOADS)
            or not words.isdisjoint({quantity, *filter(_is_word, names)})
        )
        if base and any(read_unit(unit, quantity) for quantity in of):
            return base, unit
    behind = ((base, unit) for base, unit, mark in parted if base and mark == "_" and unit != SMALLEST)
    exact = ((base, unit) for base, unit in behind if is_exact(unit))
    return next(
        (each for each in exact if not (read_unit(each[1], "frequency") and _quantity_called(each[0], ALIASES))), None
    )


def _is_word(name: str) -> bool:
    """Whether a name of a quantity has enough letters to mean it among other words."""
    return len(name) > len("ms")


def stated_unit(name: str, quantity: str, units: Mapping[str, str]) -> str | None:
    """The unit that the user states for a column; None if the user states none."""
    return next((units[key] for key in (*keys_of(name), quantity) if key in units), None)


def keys_of(name: str) -> tuple[str, ...]:
    """Keys by which the user may name a column: full name, name without unit, without axis, axis alone."""
    base, axis = apart(name)[0], axis_of(name)
    return (name, base, base.removesuffix(axis).strip(" _"), axis) if axis else (name, base)


def lacks_unit(name: str, words: Vocabulary, units: Mapping[str, str]) -> bool:
    quantity = None if apart(name)[1] or name in words.columns else words.quantity_of(name)
    return quantity is not None and stated_unit(name, quantity, units) is None


def labelled(name: str, unit: object) -> str:
    """A name with its unit in brackets, if there is one."""
    return f"{name} [{unit}]" if isinstance(unit, str) and unit.strip() else name


def quote(text: str) -> str:
    """The text in quotes, on one line, at most 120 characters of it."""
    line = " ".join(text.split())
    return repr(line if len(line) <= 120 else line[:117] + "...")
