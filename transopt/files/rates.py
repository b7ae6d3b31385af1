"""The sample rate of a file without times, as stated in its head, its remarks or its scalar variables."""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from transopt.files.names import quote
from transopt.files.units import read_unit

# What precedes and follows a number: an optional unit in brackets, a mark, and an optional unit.
_VALUE = (
    r"\s*(?:[\[(]\s*(?P<before>[a-zµ/]+)\s*[\])])?\s*[:=,;\t ]+\s*(?P<number>[-+]?\d+(?:[.,]\d+)?(?:e[-+]?\d+)?)"
    r"\s*(?P<behind>[a-zµ]+(?:/s)?)?(?![\w.:])"
)
_RATE = r"(?<![a-z])(?:(?:data|output)?[ _]*rate|sampl\w*[ _]*(?:rate|freq\w*)|fs|abtastrate|abtastfrequenz|messrate)"
_STEP = (
    r"(?<![a-z])(?:delta[ _]?[xt]|x-axis delta|dt|(?:t|x)[ _]?inc|(?:x[ _])?increment|h ?resolution|clock"
    r"|(?:time|t)[ _]?interval|sampl\w*[ _]*(?:interval|period)|abtastintervall)"
)
_STATED = {of: re.compile(names + _VALUE, re.IGNORECASE) for of, names in (("frequency", _RATE), ("time", _STEP))}
_START = re.compile(r"(?:t?start|x[ _]?0|t[ _]?0)\w* *[:=] *([-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?)", re.IGNORECASE)
_GROUPED = re.compile(r"\d{1,3},\d{3}")
_SAMPLES = re.compile(r"sp?s|sa?/s|", re.IGNORECASE)  # samples per second, or nothing after a k


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
            for each in pattern.finditer(line.replace('"', "")):
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
