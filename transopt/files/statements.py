"""What a file states in words: lines of a name, a value and a unit above, below and beside its numbers.

They hold the scalars of a header, such as `# speed_m_s: 0.21`, units and sources of columns, such as
`Vertical Units,V`, and the sample rate of a file without times.
"""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from transopt.files.names import Vocabulary, apart, labelled, quote
from transopt.files.units import is_unit, read_unit

REMARKS: tuple[str, ...] = ("#", "*", "%", "//")
DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")  # a single number contains no other comma
# No pattern here may match one run of characters by two of its parts: it would then try all divisions of a long run.
_STATEMENT = re.compile(r"[#*%/;\"\s]*(?P<name>[A-Za-z]\w*(?:[ -]+\w+)*)(?P<mark>[\s\":=,;]+)(?P<value>.*)")
_UNITS_OF_VALUES = ("verticalunits", "yunitlabel", "yunits", "vunit", "units", "unitname")  # as instruments call them
_UNITS_OF_TIMES = ("horizontalunits", "xunits", "hunit", "interval")  # LabChart: 0.001 s
# What precedes and follows a number in a line with single blanks: an optional unit in brackets, a mark, and an
# optional unit.
_VALUE = (
    r" ?(?:[\[(] ?(?P<before>[a-zµ/]+) ?[\])])?[:=,; ]+(?P<number>[-+]?\d+(?:[.,]\d+)?(?:e[-+]?\d+)?)"
    r" ?(?P<behind>[a-zµ]+(?:/s)?)?(?![\w.:])"
)
_RATE = (
    r"(?<![a-z])(?:(?:data|output)?[ _]?rate|sampl\w{0,20}[ _]?(?:rate|freq\w*)|fs"
    r"|abtastrate|abtastfrequenz|messrate)"
)
_STEP = (
    r"(?<![a-z])(?:delta[ _]?[xt]|x-axis delta|dt|(?:t|x)[ _]?inc|(?:x[ _])?increment|h ?resolution|clock"
    r"|(?:time|t)[ _]?interval|sampl\w{0,20}[ _]?(?:interval|period)|abtastintervall)"
)
_STATED = {of: re.compile(names + _VALUE, re.IGNORECASE) for of, names in (("frequency", _RATE), ("time", _STEP))}
_START = re.compile(r"(?:t?start|x[ _]?0|t[ _]?0)\w* *[:=] *([-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?)", re.IGNORECASE)
_NUMBER = re.compile(r"[-+]?[.,]?\d")
_GROUPED = re.compile(r"\d{1,3},\d{3}")
_SAMPLES = re.compile(r"sp?s|sa?/s|", re.IGNORECASE)  # samples per second, or nothing after a k


def stated_in(line: str, words: Vocabulary) -> dict[str, str]:
    """The scalar that a line states, by its name; also one of a remark that must mean a scalar but is unknown.

    Remarks use a colon or an equals sign, because they may hold commas; metadata lines use delimiters as well. A
    number loses its decimal comma, and the delimiters that spreadsheets pad rows with.
    """
    found = _STATEMENT.fullmatch(line)
    mark = found["mark"].strip(' "') if found else ""
    is_remark = line.startswith((*REMARKS, ";"))
    if not (found and mark) or (is_remark and mark.strip()[:1] not in (":", "=")):
        return {}
    key, value = found["name"], found["value"].rstrip(";, \t")
    is_meant = words.is_meant(key) or _is_scalar(key, value, words)
    if not (key in words.header or (is_remark and is_meant)):
        return {}
    return {key: value.replace(",", ".") if DECIMAL_COMMA.fullmatch(value) else value}


def _is_scalar(key: str, value: str, words: Vocabulary) -> bool:
    """Whether a remark must mean a scalar that goes by another name: `grip: 3` or `grip_kg: 0.3`."""
    first = key.lower().partition("_")[0]
    return first in {scalar.quantity for scalar in words.header.values()} and bool(_NUMBER.match(value))


def described(names: Sequence[str], width: int, notes: Sequence[str]) -> list[str]:
    """The column names, with sources and units that an instrument notes elsewhere in the file.

    Parameters
    ----------
    width : number of cells in a row of numbers.
    notes : lines such as `Vertical Units,V`.
    """
    stated = {
        re.sub(r"[\s_-]", "", found["name"].lower()): _values(found["value"])
        for found in filter(None, map(_STATEMENT.fullmatch, notes))
        if found["mark"].strip(' "')
    }
    units = next((stated[key] for key in _UNITS_OF_VALUES if key in stated), [])
    sources = [each for key in ("source", "tracename", "channeltitle") for each in stated.get(key, []) if each]
    of_times = next((stated[key][0].rpartition(" ")[2] for key in _UNITS_OF_TIMES if key in stated), "")
    if not names and sources and width in (len(sources), len(sources) + 1):
        names = [*["TIME"] * (width - len(sources)), *sources]
    elif not names and units and width == 1:
        names = ["values"]
    found, used = list[str](), 0
    for at, name in enumerate(names):
        is_time = at == 0 and width > 1
        unit = of_times if is_time else ""
        if not is_time and used < len(units) and name != "X_Value":  # LabVIEW repeats it for each channel
            unit, used = units[used].rpartition(":")[2], used + 1
        called = sources[at - 1] if name == "Value" and 0 < at <= len(sources) else name
        found.append(labelled(called, unit) if is_unit(unit) and not is_unit(apart(called)[1] or "") else called)
    return found


def _values(text: str) -> list[str]:
    """The values in a note; an empty one stands between two commas or semicolons, not between two tabs."""
    cells = re.split("[,;]", text.replace('"', ""))
    return [value for cell in cells for value in [each.strip() for each in cell.split("\t") if each.strip()] or [""]]


class Rate(NamedTuple):
    """A sample rate that a file states.

    Attributes
    ----------
    step_s, start_s : time step and time of the first sample.
    line : the line of text that states the rate; empty if it comes from the user or from a field of the format.
    """

    step_s: float
    start_s: float = 0.0
    line: str = ""

    @property
    def note(self) -> str:
        """A sentence that says where the times of the rows come from; empty if no line of text states the rate."""
        if not self.line:
            return ""
        rate = f"the sample rate of {1 / self.step_s:g} Hz is that of the file's line {quote(self.line)}"
        return f"no column of times; {rate}"


def rate_of(lines: Sequence[str], told: Sequence[str] = ()) -> Rate | None:
    """The sample rate that the lines state; None if none or several different rates are stated.

    Parameters
    ----------
    told : lines that may also state the time of the first sample, which is 0 otherwise.
    """
    found: list[tuple[float, str]] = []
    for line in (*lines, *told):
        for of, pattern in _STATED.items():
            for each in pattern.finditer(" ".join(line.replace('"', "").split())):
                if of == "frequency" and _GROUPED.fullmatch(each["number"]):
                    return None  # 10,000 Hz means 10 kHz to some and 10 Hz to others
                factor = _factor(each["before"] or each["behind"] or "", of)
                if factor is not None and (value := factor * float(each["number"].replace(",", "."))) > 0:
                    found.append((1 / value if of == "frequency" else value, line.strip()))
    if not found or not all(math.isclose(step, found[0][0], rel_tol=1e-6) for step, _ in found):
        return None
    start = next((float(stated[1]) for line in told if (stated := _START.fullmatch(line))), 0.0)
    return Rate(found[0][0], start, found[0][1])


def _factor(unit: str, quantity: str) -> float | None:
    """Factor to SI of a rate or step unit, such as kHz, kS/s, ksps or k alone; 1 if there is no unit."""
    if quantity == "frequency" and unit[:1] in "kM" and _SAMPLES.fullmatch(unit[1:]):
        return {"": 1.0, "k": 1e3, "M": 1e6}[unit[:1]]
    if quantity == "frequency" and _SAMPLES.fullmatch(unit):
        return 1.0
    known = read_unit(unit or "s", quantity)
    return None if known is None else known.factor
