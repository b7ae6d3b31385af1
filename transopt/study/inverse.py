"""The inverse question: the least or greatest value of one key at which every entry meets all requirements.

The error need not be monotone in a key, so the range is scanned first. The outermost crossing towards the wanted end
is then bisected over certified outcomes. The answer says whether the scan saw other crossings.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from transopt.base.errors import InputError, did_you_mean
from transopt.base.units import unit_of, words_of
from transopt.scene.keys import Key, check_value, find_key
from transopt.scene.scene import Scene
from transopt.study.axes import Axis, label
from transopt.study.plan import Plan
from transopt.study.rows import MEASURES, SHARES, Row, entry_name, is_admitted, number

SCAN = 9
AS_NEAR = 0.01  # part by which more may be missed before one value is nearer than another
TOLERANCE = 1e-3  # of the range, unless the user states one


@dataclass(frozen=True)
class Requirement:
    """A bound on a measure: measure <= bound, or measure >= bound."""

    measure: str
    at_most: bool
    bound: float

    @property
    def unit(self) -> str:
        """Unit in which bound and measure are shown: percent for a share."""
        return "%" if self.measure in SHARES else unit_of(self.measure)

    @property
    def scale(self) -> float:
        """Factor from the stored number to the shown one."""
        return 100.0 if self.unit == "%" else 1.0

    def shown(self, value: float, digits: int = 6) -> str:
        """A value of the measure with its unit."""
        return f"{self.scale * value:.{digits}g} {self.unit}".rstrip()

    @property
    def text(self) -> str:
        return f"{self.measure} {'<=' if self.at_most else '>='} {self.shown(self.bound)}"

    @property
    def in_words(self) -> str:
        """The requirement for a figure: "tap error of at most 30 %"."""
        return f"{words_of(self.measure)} of at {'most' if self.at_most else 'least'} {self.shown(self.bound)}"

    def excess(self, row: Row) -> float:
        """Amount by which a row misses the bound, <= 0 if it is met; infinite without a certified answer."""
        value = number(row, self.measure) if is_admitted(row) else math.nan
        missed = value - self.bound if self.at_most else self.bound - value
        return math.inf if math.isnan(missed) else missed


def parse_requirement(text: str) -> Requirement:
    """Parse a requirement such as `tap_error<=10%` or `tap_error<=0.10`.

    Raises
    ------
    InputError : the measure is unknown, the text has another form, or a share without % is above 1.
    """
    found = re.fullmatch(r"\s*(\w+)\s*(<=|>=)\s*([^\s%]+)\s*(%?)\s*", text)
    try:
        bound = float(found[3]) if found else math.nan
    except ValueError:
        bound = math.nan
    if found is None or not math.isfinite(bound):
        raise InputError(f"--require {text}: must be MEASURE<=NUMBER or MEASURE>=NUMBER, as tap_error<=10%")
    if found[1] not in MEASURES:
        raise InputError(
            f"--require {text}: {found[1]}: no such measure{did_you_mean(found[1], MEASURES)}; "
            f"one of {', '.join(MEASURES)}"
        )
    asked = Requirement(found[1], found[2] == "<=", bound)
    if found[4]:
        if asked.unit != "%":
            raise InputError(f"--require {text}: {found[1]} is no share: state it in {asked.unit or 'its own unit'}")
        return replace(asked, bound=bound / 100)
    if asked.unit == "%" and bound > 1:
        raise InputError(
            f"--require {text}: {bound:g} is {100 * bound:g} %, at most 1 without %: write "
            f"{found[1]}{found[2]}{bound:g}% or {found[1]}{found[2]}{bound / 100:g}"
        )
    return asked


@dataclass(frozen=True)
class Question:
    """A question for the least (or greatest) value of a key that meets all requirements.

    Attributes
    ----------
    key : the key to solve for.
    low, high : ends of the range searched, in the key's unit.
    tolerance : width of the final interval, in the key's unit.
    greatest : whether the greatest value is wanted.
    requirements : all must be met at every entry.
    """

    key: Key
    low: float
    high: float
    tolerance: float
    greatest: bool
    requirements: tuple[Requirement, ...]

    @property
    def log(self) -> bool:
        return self.low > 0 and self.high / self.low >= 30

    def rounded(self, value: float) -> float:
        return round(value) if self.key.integer else float(f"{value:.12g}")

    def scan(self) -> list[float]:
        space = np.geomspace if self.log else np.linspace
        return list(dict.fromkeys(self.rounded(float(value)) for value in space(self.low, self.high, SCAN)))

    def middle(self, one: float, other: float) -> float:
        """A value between two values; one of them if there is none between."""
        value = math.sqrt(one * other) if self.log else (one + other) / 2
        # Rounded to a tenth of the tolerance: finer digits have no meaning in an answer.
        return self.rounded(round(value, 1 - math.floor(math.log10(self.tolerance))))

    def excess(self, row: Row) -> float:
        return max(requirement.excess(row) for requirement in self.requirements)


def parse_question(scene: Scene, text: str, requirements: Sequence[str], *, greatest: bool) -> Question:
    """Parse KEY=LOW:HIGH[:TOLERANCE].

    Raises
    ------
    InputError : the key is no number of the scene, or the range is invalid.
    """
    path, equals, span = (part.strip() for part in text.partition("="))
    try:
        numbers = [float(part) for part in span.split(":")]
    except ValueError:
        numbers = []
    if not equals or len(numbers) not in (2, 3) or not all(math.isfinite(value) for value in numbers):
        raise InputError(f"--solve-for {text}: give KEY=LOW:HIGH or KEY=LOW:HIGH:TOLERANCE")
    key = find_key(scene, path)
    if path.startswith("grid.") or not key.number:
        raise InputError(f"--solve-for {path}: not a number that can be solved for")
    low, high = numbers[:2]
    if not low < high:
        raise InputError(f"--solve-for {text}: LOW must be below HIGH")
    tolerance = numbers[2] if len(numbers) == 3 else TOLERANCE * (high - low)
    if not 0 < tolerance <= high - low:
        raise InputError(f"--solve-for {text}: TOLERANCE must be above 0 and at most HIGH - LOW = {high - low:g}")
    if key.integer:
        low, high, tolerance = round(low), round(high), max(1.0, tolerance)
    for value in (low, high):
        check_value(scene, path, value)
    return Question(key, low, high, tolerance, greatest, tuple(parse_requirement(each) for each in requirements))


@dataclass(frozen=True)
class Tried:
    """One value of the key with its rows, and the amount by which the worst row misses the requirements."""

    value: float
    rows: tuple[Row, ...]
    excess: float

    @property
    def met(self) -> bool:
        return self.excess <= 0


@dataclass(frozen=True)
class Answer:
    """The answer to a question.

    Attributes
    ----------
    question : the question, with its range and requirements.
    tried : every value tried, in order.
    met : the answer; None if no value of the scan meets the requirements.
    missed : the nearest value beyond it that does not meet them; None if `met` is the end of the range.
    crossings : how often the scan changed between met and missed.
    """

    question: Question
    tried: tuple[Tried, ...]
    met: Tried | None
    missed: Tried | None
    crossings: int

    def worst(self, tried: Tried) -> Row:
        """The entry that decides: the one that misses most, or has the smallest margin."""
        return max(tried.rows, key=self.question.excess)

    @property
    def sentences(self) -> list[str]:
        q, unit = self.question, unit_of(self.question.key.path)
        wanted = " and ".join(requirement.text for requirement in q.requirements)
        span = f"{q.low:g} to {q.high:g} {unit}".strip()
        if self.met is None:
            enough = (1 + AS_NEAR) * min(tried.excess for tried in self.tried)
            alike = [tried for tried in self.tried if tried.excess <= enough]
            best = alike[-1 if q.greatest else 0]
            place = "nearest is" if math.isfinite(best.excess) else "each has an entry without a certified answer, as"
            return [
                f"No {q.key.path} of {len(self.tried)} tried from {span} meets {wanted} at every entry; {place} "
                f"{label(best.value)} {unit}: {self._entry(best)}."
            ]
        extreme = "greatest" if q.greatest else "least"
        lines = [
            f"The {extreme} {q.key.path} from {span} with {wanted} at every entry: {label(self.met.value)} {unit}."
        ]
        lines.append(f"There {self._entry(self.met)} has least left.")
        if self.missed is None:
            lines.append("That is the end of the range itself: beyond it nothing was tried.")
        else:
            lines.append(f"At {label(self.missed.value)} {unit} it is missed: {self._entry(self.missed)}.")
        if self.crossings > 1:
            lines.append(
                f"The scan of {len(q.scan())} values crossed the requirement {self.crossings} times: the error is "
                "not monotone, and values inside the range beyond this one miss it again."
            )
        else:
            lines.append(
                f"The scan of {len(q.scan())} values saw {self.crossings} crossing{'s' * (self.crossings != 1)}."
            )
        return lines

    def _entry(self, tried: Tried) -> str:
        row = self.worst(tried)
        name = entry_name(row)
        if not is_admitted(row):
            return f"{name} ({row['status']}: {row['reason']})"
        measures = {requirement.measure: requirement for requirement in self.question.requirements}
        figures = [f"{measure} = {each.shown(number(row, measure), 5)}" for measure, each in measures.items()]
        return f"{name} ({', '.join(figures)})"


def answer(question: Question, solve: Callable[[list[float]], list[list[Row]]]) -> Answer:
    """Scan, then bisect.

    Parameters
    ----------
    solve : returns, for each of some values, the rows of every entry.
    """
    tried: dict[float, Tried] = {}

    def at(values: list[float]) -> list[Tried]:
        new = [value for value in values if value not in tried]
        for value, rows in zip(new, solve(new) if new else [], strict=True):
            tried[value] = Tried(value, tuple(rows), max(question.excess(row) for row in rows))
        return [tried[value] for value in values]

    scanned = at(question.scan())
    crossings = sum(a.met != b.met for a, b in pairwise(scanned))
    towards = scanned[::-1] if question.greatest else scanned
    first = next((j for j, one in enumerate(towards) if one.met), None)
    met = missed = None
    if first is not None:
        met = towards[first]
        missed = towards[first - 1] if first else None
    while met is not None and missed is not None and abs(met.value - missed.value) > question.tolerance:
        value = question.middle(met.value, missed.value)
        if value in (met.value, missed.value):
            break
        [middle] = at([value])
        met, missed = (middle, missed) if middle.met else (met, middle)
    return Answer(question, tuple(tried[value] for value in sorted(tried)), met, missed, crossings)


def plan_at(plan: Plan, question: Question, values: Sequence[float]) -> Plan:
    """The plan with the question's key at these values."""
    return replace(plan, axes=(Axis(question.key.path, tuple(values), tuple(map(label, values))),))
