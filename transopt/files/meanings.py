"""Meanings of a file's columns, from their names and from units in the file or stated by the user.

This module reads no file: a reader passes the names it found. It gets a meaning for each, or an error that says what
is missing, with answers to try.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.files.names import (
    MOST_CHOICES,
    SKIPPED,
    Meaning,
    Vocabulary,
    apart,
    axis_of,
    is_frequency,
    is_weighed,
    keys_of,
    lacks_unit,
    quote,
    stated_unit,
)
from transopt.files.unclear import RATES_HZ, UnclearError, guesses, times_in, usual_first
from transopt.files.units import (
    Unit,
    is_electrical,
    is_sensed,
    known_units,
    likely_units,
    parts,
    read_unit,
    remedy_of,
    sensed,
    with_input,
)

MOST_ANSWERS = 40
SAME_SPAN = 0.01  # relative difference in length up to which two columns of times span the same record
Seen = Callable[[], Mapping[str, FloatArray]]


def meaning(name: str, words: Vocabulary, units: Mapping[str, str]) -> Meaning:
    """Quantity and unit of a column whose name has a known meaning.

    Parameters
    ----------
    units : units that the user states, see `Layout`; they override the unit in the file.

    Raises
    ------
    InputError : the unit is not one of the quantity.
    """
    quantity = words.quantity_of(name)
    assert quantity is not None
    user, label = stated_unit(name, quantity, units), apart(name)[1] or ""
    own = read_unit(label, quantity) if label or name not in words.columns else Unit(1.0)
    if user is None and own is not None:
        return Meaning(quantity, own, label)
    stated = with_input(user, label) if user else label
    unit = read_unit(stated, quantity)
    if unit is None:
        problem = f"column {quote(name)}: {quote(stated)} is no unit of {quantity}"
        if is_electrical(stated):
            answers = [{"units": {apart(name)[0]: each}} for each in sensed(stated)]
            raise UnclearError(f"{problem} without the sensitivity of the sensor", answers)
        problem = f"{problem}; known: {', '.join(known_units(quantity))}{remedy_of(stated)}"
        if user is None and not remedy_of(stated):  # a range such as X (100g), or a unit such as "g rms"
            likely, below = likely_units(quantity, label), parts(label)[1]
            of_input = [each for each in likely if below and parts(each)[1] == below]
            raise UnclearError(problem, [{"units": {quantity: each}} for each in of_input or likely])
        raise InputError(problem)
    # A file whose unit is of an acceleration without an input does not contradict a stated input.
    compared = unit if own is None or own.per else read_unit(parts(stated)[0], quantity)
    agrees = own is not None and compared is not None and compared.means(own)
    note = f"the file's column is {quote(name)}, --units says {stated}, which is taken"
    contradicts = bool(label) and not (agrees or is_sensed(stated, label))
    return Meaning(quantity, unit, stated, note if contradicts else "")


def _unknown(names: Sequence[str], words: Vocabulary, seen: Seen) -> InputError:
    """The question about columns without a meaning, or about a missing quantity, with possible answers.

    A frequency response leaves no question open: it is no record over time, however its columns are read.
    """
    unknown = [name for name in names if name != SKIPPED and words.quantity_of(name) is None]
    electrical = {base: unit for base, unit in map(apart, unknown) if unit and is_electrical(unit)}
    acceleration = "acceleration" in words.quantities
    if electrical and acceleration:
        first = next(name for name in unknown if apart(name)[0] in electrical)
        problem = f"column {quote(first)} is what a sensor gives, and its sensitivity is not stated"
        return UnclearError(
            problem, [{"units": {base: each}} for base, unit in electrical.items() for each in sensed(unit)]
        )
    absent = words.absent(names)
    over = next((name for name in unknown if is_frequency(name)), None)
    if over is not None and "time" in absent:
        return InputError(
            f"column {quote(over)}: a frequency response, and no record over time; a plant is fitted to it by "
            "`transopt plant fit FILE --order 2 --out plant.npz`"
        )
    weighed = [apart(name) for name in unknown if is_weighed(name)]
    if weighed and acceleration and "acceleration" in absent:
        problem = f"column {quote(weighed[0][0])} may hold grams of a load cell, and no other is an acceleration's"
        return UnclearError(problem, [{"units": {base: unit}} for base, unit in weighed])
    problem = (
        f"unknown column {quote(unknown[0])}; known: {', '.join(words.columns)}, or time [s], acc [g] and the like"
    )
    if not absent:
        return UnclearError(problem, [{"columns": [SKIPPED if name in unknown else name for name in names]}])
    if acceleration:
        table = {apart(name)[0]: values for name, values in seen().items() if name in unknown}
        likely = likely_units("acceleration") if "acceleration" in absent else []
        if answers := guesses(table, likely, is_named=True, needs_time="time" in absent):
            return UnclearError(problem, answers)
    if absent == ["time"]:
        return _untimed(names, words)
    return UnclearError(problem, [{"columns": [*words.required, SKIPPED]}])


def _untimed(names: Sequence[str], words: Vocabulary) -> UnclearError:
    """The question for the sample rate of a file without times."""
    choice = " or ".join(words.names_of("time"))
    problem = f"0 time columns in {quote(', '.join(names))}: must be 1; name one {choice}, or state the sample rate"
    return UnclearError(problem, [{"rate_Hz": rate} for rate in RATES_HZ])


def meanings(
    names: Sequence[str],
    words: Vocabulary,
    units: Mapping[str, str],
    found: Sequence[str] = (),
    seen: Seen = dict,
) -> dict[str, Meaning]:
    """Meanings of all columns except skipped ones.

    Parameters
    ----------
    found : all variables of the file, if the columns are chosen from variables.
    seen : reads the columns as numbers, to propose answers.

    Raises
    ------
    InputError : see `meaning`; a name without a meaning; a quantity that occurs twice, or a required one that is
        missing.
    """
    present = quote(", ".join(found or names))
    used = [name for name in names if name != SKIPPED]
    _refuse_rivals(used, names, present, words)
    own = {*words.quantities, *(key for name in used for key in keys_of(name))}
    unused = [key for key in units if key not in own]
    if unused:
        raise InputError(f"--units {unused[0]}: no column of that name; the file has {present}")
    if any(words.quantity_of(name) is None for name in used):
        raise _unknown(used if found else names, words, seen)
    for quantity in words.absent(used):
        if quantity == "time":
            raise _untimed(found or names, words)
        choice = " or ".join(words.names_of(quantity))
        problem = f"0 {quantity} columns in {present}: must be 1; name one {choice}"
        others = {name: values for name, values in seen().items() if name not in used} if found else {}
        if answers := guesses(others, likely_units(quantity), is_named=True, needs_time=False):
            raise UnclearError(problem, answers)
        raise InputError(problem)
    _refuse_unstated([name for name in used if lacks_unit(name, words, units)], words, seen)
    known = {}
    for name in used:
        known[name] = meaning(name, words, units)
        if found and name not in found:
            raise InputError(f"no variable {name}; found: {present}; correct the name")
    return known


def one_clock(
    names: Sequence[str],
    words: Vocabulary,
    units: Mapping[str, str],
    column: Callable[[int], FloatArray],
    notes: list[str],
) -> list[str]:
    """The names with all columns of times skipped but the one of finest resolution, if they span the same time.

    Only columns of times with a known unit are compared.

    Parameters
    ----------
    column : returns the numbers (n,) of a column by its index.
    notes : receives a sentence that names the column kept.
    """
    rivals = [at for at, name in enumerate(names) if words.quantity_of(name) == "time"]
    factors = dict[int, float]()
    for at in rivals if len(rivals) > 1 else ():
        with suppress(InputError):
            factors[at] = meaning(names[at], words, units).unit.factor
    times = {at: factor * column(at) for at, factor in factors.items()}
    spans = [float(each[-1] - each[0]) for each in times.values() if each.size]
    if not spans or not spans[0] > 0 or not np.allclose(spans, spans[0], rtol=SAME_SPAN):
        return list(names)
    kept = max(times, key=lambda at: np.unique(times[at]).size)
    notes.append(f"of {len(rivals)} columns of times {quote(names[kept])} is used")
    return [SKIPPED if at in rivals and at != kept else name for at, name in enumerate(names)]


def _refuse_unstated(without: Sequence[str], words: Vocabulary, seen: Seen) -> None:
    """Ask for the units of columns that lack one, quantity by quantity."""
    wanted = list(dict.fromkeys(words.quantity_of(name) or name for name in without))
    if wanted:
        table = seen()
        of = {words.quantity_of(name): values for name in without if (values := table.get(name)) is not None}
        likely = {quantity: usual_first(likely_units(quantity), of.get(quantity, np.zeros(1))) for quantity in wanted}
        if "time" in of:
            likely["time"] = times_in(of["time"]) or likely["time"]
        known = "; ".join(f"{quantity} in {', '.join(known_units(quantity))}" for quantity in wanted)
        combined = itertools.product(*likely.values())
        raise UnclearError(
            f"no unit stated in the column{'s' * (len(without) > 1)} {quote(', '.join(without))}; known: {known}",
            [{"units": dict(zip(wanted, units, strict=True))} for units in itertools.islice(combined, MOST_ANSWERS)],
        )


def _refuse_rivals(used: Sequence[str], names: Sequence[str], present: str, words: Vocabulary) -> None:
    """Refuse several columns of one quantity, except the axes of a sensor; the error lists the choices."""
    for quantity in words.quantities:
        rivals = [at for at, name in enumerate(names) if name in used and words.quantity_of(name) == quantity]
        several = {axis_of(names[at]) for at in rivals}
        if len(rivals) > 1 and ("" in several or len(several) < len(rivals)):
            kept = [
                [SKIPPED if at in rivals and at != one else name for at, name in enumerate(names)] for one in rivals
            ]
            problem = f"{len(rivals)} {quantity} columns in {present}: must be 1; choose one"
            raise UnclearError(problem, [{"columns": columns} for columns in kept[:MOST_CHOICES]])
