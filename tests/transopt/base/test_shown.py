"""How values show themselves: briefly, and without loss of what matters."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from transopt.base.shown import LINE, LONGEST, MOST_ROWS, brief, cut, html_figure, html_table, span, summary


class Colour(Enum):
    RED = "a value that would be long"


@dataclass(frozen=True)
class Inner:
    values: Any


@dataclass(frozen=True)
class Holder:
    """Whatever it is given."""

    first: Any = None
    second: Any = None
    hidden: Any = field(default=1, repr=False)

    __repr__ = brief


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (np.linspace(-1.5, 2.0, 600), "<600, -1.5 to 2>"),
        (np.zeros((4, 3, 600)), "<4x3x600, 0>"),
        (np.array([np.nan, 1.0, 3.0]), "<3, 1 to 3>"),
        (np.array([np.nan]), "<1, none finite>"),
        (np.zeros((0, 3)), "<0x3 f>"),
        (np.array(["optimal"]), "<1 text>"),
        (np.array([True, False]), "<2 b>"),
        (1 / 3, "0.333333"),
        (np.float64(2.0), "2"),
        (float("nan"), "nan"),
        (7, "7"),
        (True, "True"),
        ("a" * 100, repr("a" * 57 + "...")),
        (Colour.RED, "Colour.RED"),
        ([0.1, 0.2], "[0.1, 0.2]"),
        ((), "()"),
        (list(range(1000)), "[1000 items]"),
        ({"a": np.zeros(9), "b": 1}, "{a, b}"),
        ({str(j): j for j in range(50)}, "{50 keys}"),
        (Inner(np.zeros(9)), "Inner(...)"),
        (len, "len(...)"),
    ],
)
def test_one_value_in_a_few_words(value: Any, said: str) -> None:
    assert summary(value) == said


def test_fields_that_are_none_or_not_for_show_are_left_out() -> None:
    assert repr(Holder(1.0)) == "Holder(first=1)"


def test_it_never_gets_long_and_says_what_is_missing() -> None:
    long = {f"field_{j}": "x" * 50 for j in range(30)}
    many = type("Many", (), {"model_fields": long, **long, "__repr__": brief})()
    text = repr(many)
    assert len(text) <= LONGEST + 40
    assert text.endswith("more)")
    assert max(map(len, text.splitlines())) <= LINE


def test_spans_and_cut_text() -> None:
    assert span([0.1, 0.2, 0.4], "m/s", "speed") == "3 speeds 0.1 to 0.4 m/s"
    assert span(np.array([0.0]), "N", "grip") == "1 grip 0 N"
    assert cut("abcdef", 5) == "ab..."
    assert cut("abcde", 5) == "abcde"


def test_a_table_is_escaped_and_cut() -> None:
    html = html_table("a < b", ["x", "y"], [[str(j), "<i>"] for j in range(MOST_ROWS + 7)])
    assert "a &lt; b" in html
    assert "<i>" not in html
    assert html.count("<tr>") == MOST_ROWS + 2
    assert "and 7 more" in html


def test_a_figure_stands_in_the_text() -> None:
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0, 1])
    assert html_figure(figure).startswith('<img alt="figure" src="data:image/png;base64,iVBOR')
