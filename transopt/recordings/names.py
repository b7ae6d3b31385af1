"""What the columns of a file are called: names that the project knows, names that instruments write, and their units.

A name in a file is understood in one of three ways:

- `acceleration_g`, quantity and unit in one word, as the project's own names are, or `acc_g`;
- `acc [g]`, `time (ms)`, `Force/N`: a usual name of the quantity with its unit behind it;
- `acc` with a unit that the user states (`--units acc=g`, or `units = { acc = "g" }` in a scene).

A unit is never guessed: 9.81 lies between the two that are usual for an acceleration.
"""

import re
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from transopt.base.errors import InputError
from transopt.recordings.units import (
    RATIOS,
    Unit,
    is_electrical,
    is_sensed,
    known_units,
    parts,
    read_unit,
    remedy_of,
    with_input,
)

SKIPPED = "-"
MOST_CHOICES = 3  # among columns of one quantity, which a message lists
LONGEST_SHOWN = 300  # characters of all names together, which a message repeats
# An unknown name that ends like this is more likely a misspelt quantity than something of the user's own.
UNIT_SUFFIX = re.compile(r"_([mc]?m_s2?|[mcu]?m|m?g|m?N|m?A|[mu]?s)$", re.IGNORECASE)
_WITH_UNIT = re.compile(
    r"(?P<base>[^\[\](){}/]+?)\s*(?:[\[({](?P<inside>([^\[\](){}]|\([^()]*\))*)[\])}]|/\s*(?P<behind>\S+))"
)
# One of three axes, as in accel_x or ay; an underscore is read as a blank.
AXES = tuple(
    f"{stem}{mark}{axis}" for stem in ("acceleration", "accel", "acc", "a") for mark in ("", " ") for axis in "xyz"
)
# Quantity -> what else it is called, in small letters.
ALIASES: Mapping[str, tuple[str, ...]] = {
    "time": ("t", "zeit", "times"),
    "acceleration": ("acc", "accel", "a", "beschleunigung", *AXES),
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
        called = {name: of for name, of in clear.items() if _quantity(name, self) is None}
        return replace(self, called=called) if called else self

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


def _quantity(base: str, words: Vocabulary) -> str | None:
    """The quantity that a name without unit means, None if none."""
    small = base.strip().lower().replace("_", " ")
    if base in words.called:
        return words.called[base]
    named = (q for q in words.quantities if small == q or small in ALIASES.get(q, ()))
    return next(named, None)


def _quantity_of(name: str, words: Vocabulary) -> str | None:
    """The quantity that a column means by its name, with or without a unit; None if none."""
    return words.columns[name][0] if name in words.columns else _quantity(apart(name)[0], words)


def axis_of(name: str) -> str:
    """The axis that a column's name ends in before its unit, as accel_x or ay_g; empty where it names none."""
    small = apart(name)[0].lower().replace("_", " ")
    return small[-1] if small in AXES else ""


def means_acceleration(name: str, words: Vocabulary) -> bool:
    """Whether a column holds an acceleration, with or without a unit."""
    return _quantity_of(name, words) == "acceleration"


def means_time(name: str, words: Vocabulary) -> bool:
    """Whether a column holds the times of the rows, with or without a unit."""
    return _quantity_of(name, words) == "time"


def looks_known(name: str, words: Vocabulary) -> bool:
    """Whether a name means a quantity, with or without its unit."""
    return _quantity_of(name, words) is not None


def spared(names: Sequence[str], words: Vocabulary) -> tuple[list[str], str]:
    """Columns without those that mean nothing here, where the others suffice; and a sentence that names these.

    A name that ends in a unit may be a misspelt quantity: it stays, and is refused.
    """
    idle = [name for name in names if not looks_known(name, words) and not words.unit_suffix.search(name)]
    idle = [name for name in idle if name != SKIPPED]
    present = {_quantity_of(name, words) for name in names}
    if not idle or _lacking(present, words):
        return list(names), ""
    plural = "s" if len(idle) > 1 else ""
    said = f"column{plural} {quote(', '.join(idle))} not used: nothing here goes by such a name"
    return [SKIPPED if name in idle else name for name in names], said


def _lacking(present: Collection[str | None], words: Vocabulary) -> list[str]:
    """Required quantities that are absent; a velocity stands for the acceleration, which is its slope."""
    lacking = [of for of in words.required if of not in present]
    return [of for of in lacking if of != "acceleration" or "velocity" not in present]


def stated_for(name: str, words: Vocabulary, units: Mapping[str, str]) -> bool:
    """Whether a user states a unit for a name that means a quantity."""
    quantity = _quantity(apart(name)[0], words)
    return quantity is not None and _stated_unit(name, quantity, units) is not None


def apart(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit."""
    found = _WITH_UNIT.fullmatch(name.strip())
    if found is None:
        return next(
            filter(None, (_unit_in_word(name, at) for at, mark in enumerate(name) if mark == "_")), (name, None)
        )
    return found["base"].strip(), (found["inside"] or found["behind"] or "").strip() or None


def _unit_in_word(name: str, at: int) -> tuple[str, str] | None:
    """Quantity and unit of a name like acc_g or pos_mm, parted at an underscore; None if they are none."""
    base, unit = name[:at].strip(), name[at + 1 :].strip()
    small = base.lower().replace("_", " ")
    of = (quantity for quantity, names in ALIASES.items() if small in (quantity, *names))
    return (base, unit) if any(read_unit(unit, quantity) for quantity in of) else None


def _stated_unit(name: str, quantity: str, units: Mapping[str, str]) -> str | None:
    """The unit of a column as a user states it; None if no user does."""
    return next((units[key] for key in (*_keys(name), quantity) if key in units), None)


def _keys(name: str) -> tuple[str, ...]:
    """What a user may call a column by: its name, that without the unit, and that without the axis."""
    base = apart(name)[0]
    return (name, base, base[:-1].strip(" _")) if axis_of(name) else (name, base)


def _lacks_unit(name: str, words: Vocabulary, units: Mapping[str, str]) -> bool:
    base, label = apart(name)
    quantity = None if label or name in words.columns else _quantity(base, words)
    return quantity is not None and _stated_unit(name, quantity, units) is None


def meaning(name: str, words: Vocabulary, units: Mapping[str, str]) -> Meaning:
    """Quantity and unit of a column whose name means something.

    Parameters
    ----------
    units : as a user states them, see `Layout`; they take the place of the unit in the file.

    Raises
    ------
    InputError : a unit that is none of the quantity.
    """
    quantity = _quantity_of(name, words)
    assert quantity is not None
    user, label = _stated_unit(name, quantity, units), apart(name)[1] or ""
    own: Unit | None
    if name in words.columns:
        own = Unit(words.columns[name][1])
        label = label if _quantity(name, words) else name  # a name of the project's own, which has its unit
    else:
        own = read_unit(label, quantity)
    if user is None and own is not None:
        return Meaning(quantity, own.factor, own.per, label, slopes=own.slopes)
    stated = with_input(user, label) if user else label
    if read_unit(stated, quantity) is None:
        known = ", ".join(known_units(quantity)) + remedy_of(stated)
        raise InputError(f"column {quote(name)}: {quote(stated)} is no unit of {quantity}; known: {known}")
    said = "" if is_sensed(stated, label) else label and f"column is {quote(name)}"
    return settled(quantity, stated, own, said)


def _unknown(name: str, words: Vocabulary, names: Sequence[str]) -> str:
    """What to do about a column that means nothing here."""
    if is_electrical(label := apart(name)[1] or "") and "acceleration" in words.quantities:
        sensor = shlex.quote(f"{apart(name)[0]}={label} @ 100 mV/g")
        return (
            f"column {quote(name)} is what a sensor gives: state its quantity with the sensor's sensitivity, here of "
            f"100 mV/g: --units {sensor} (in a scene recordings.units)"
        )
    known = ", ".join(words.columns)
    usual = "time [s], acc [g] and the like"
    kept = [SKIPPED if _quantity_of(each, words) is None else each for each in names]
    short = sum(map(len, names)) < LONGEST_SHOWN
    skip = "rename it, or skip it"
    if not (short and all(any(_quantity_of(each, words) == of for each in kept) for of in words.required)):
        skip, kept = "name the columns in their order, - for one to skip", [*words.required, SKIPPED]
    remedy = f"{skip}: --columns {shlex.quote(','.join(kept))} (in a scene recordings.columns)"
    return f"unknown column {quote(name)}; known: {known}, or {usual}; {remedy}"


def settled(quantity: str, stated: str, own: Unit | None, said: str) -> Meaning:
    """What a column means by the unit that a user states, and a note where the file states another.

    Parameters
    ----------
    stated : a unit of the quantity.
    own, said : the file's unit, None where it is not known, and what the file says; empty where it says nothing.
    """
    unit = read_unit(stated, quantity)
    assert unit is not None
    # A file that states an acceleration alone says nothing against any input.
    compared = unit if own is None or own.per else read_unit(parts(stated)[0], quantity)
    agrees = own is not None and compared is not None and compared.means(own)
    note = f"the file's {said}, --units says {stated}, which is taken" if said and not agrees else ""
    return Meaning(quantity, unit.factor, unit.per, stated, note, unit.slopes)


def meanings(
    names: Sequence[str], words: Vocabulary, units: Mapping[str, str], found: Sequence[str] = ()
) -> dict[str, Meaning]:
    """What all columns but the skipped ones mean.

    Parameters
    ----------
    found : the variables that a file has, where the columns are chosen from them.

    Raises
    ------
    InputError : see `meaning`; a name that means nothing here; a quantity twice, or a required one not at all.
    """
    present = quote(", ".join(found or names))
    used = [name for name in names if name != SKIPPED]
    _refuse_rivals(used, names, present, words)
    unknown = [name for name in used if not looks_known(name, words)]
    if unknown:
        likeliest = next((name for name in unknown if is_electrical(apart(name)[1] or "")), unknown[0])
        raise InputError(_unknown(likeliest, words, names))
    for quantity in _lacking({_quantity_of(name, words) for name in used}, words):
        choice = " or ".join(name for name, (of, _) in words.columns.items() if of == quantity)
        rate = ", or state the sample rate, --rate-Hz 10000" if quantity == "time" else ""
        raise InputError(f"0 {quantity} columns in {present}: must be 1; name one {choice}{rate}")
    said, without = {}, [name for name in used if _lacks_unit(name, words, units)]
    if without:
        wanted = list(dict.fromkeys(_quantity(apart(name)[0], words) or name for name in without))
        stated = [f"{quantity}={known_units(quantity)[0]}" for quantity in wanted]
        in_scene = ", ".join(f'{quantity} = "{known_units(quantity)[0]}"' for quantity in wanted)
        known = "; ".join(f"{quantity} in {', '.join(known_units(quantity))}" for quantity in wanted)
        raise InputError(
            f"no unit stated in the column{'s' * (len(without) > 1)} {quote(', '.join(without))}; state it, for "
            f"example --units {','.join(stated)} (in a scene recordings.units = {{ {in_scene} }}); known: {known}"
        )
    for name in used:
        said[name] = meaning(name, words, units)
        if found and name not in found:
            raise InputError(f"no variable {name}; found: {present}; correct the name")
    own = {*words.quantities, *(key for name in said for key in _keys(name))}
    unused = [key for key in units if key not in own]
    if unused:
        raise InputError(f"--units {unused[0]}: no column of that name; the file has {present}")
    return said


def _refuse_rivals(used: Sequence[str], names: Sequence[str], present: str, words: Vocabulary) -> None:
    """Refuse several columns of one quantity but for the axes of a sensor, with the choices that there are."""
    for quantity in words.quantities:
        rivals = [at for at, name in enumerate(names) if name in used and _quantity_of(name, words) == quantity]
        several = {axis_of(names[at]) for at in rivals}
        if len(rivals) > 1 and ("" in several or len(several) < len(rivals)):
            choices = [
                ",".join(SKIPPED if at in rivals and at != kept else name for at, name in enumerate(names))
                for kept in rivals[:MOST_CHOICES]
            ]
            listed = " or ".join(map(shlex.quote, choices)) if len(choices[0]) < LONGEST_SHOWN else "time_s,-,..."
            raise InputError(
                f"{len(rivals)} {quantity} columns in {present}: must be 1; choose one: --columns {listed} (in a "
                "scene recordings.columns)"
            )


def quote(text: str) -> str:
    """The text in quotes, on one line, at most 120 characters of it."""
    line = " ".join(text.split())
    return repr(line if len(line) <= 120 else line[:117] + "...")
