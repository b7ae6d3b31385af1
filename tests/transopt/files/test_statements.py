"""Lines that state a scalar, a unit or a rate, as instruments and loggers write them."""

import pytest

from transopt.files.statements import described, rate_of, stated_in
from transopt.recordings.recording import VOCABULARY


@pytest.mark.parametrize(
    ("line", "stated"),
    [
        ("# speed_m_s: 0.21", {"speed_m_s": "0.21"}),
        ("% grip_N = 3;;", {"grip_N": "3"}),
        ("speed_m_s,0.21", {"speed_m_s": "0.21"}),
        ("speed_m_s;0,21", {"speed_m_s": "0.21"}),
        ("# speed_m_s, grip_N", {}),  # a remark may hold commas
        ("# speed of the hand: 0.2", {}),
        ("# sped_m_s: 0.21", {"sped_m_s": "0.21"}),  # must mean a scalar, and is refused
    ],
)
def test_a_scalar_of_a_line(line: str, stated: dict[str, str]) -> None:
    assert stated_in(line, VOCABULARY) == stated


def test_units_between_tabs_leave_out_the_cells_of_times() -> None:
    names = ["X_Value", "Acceleration", "X_Value", "Force", "Comment"]
    found = described(names, len(names), ["Y_Unit_Label\tg\t\tN\t"])
    assert found == ["X_Value", "Acceleration [g]", "X_Value", "Force [N]", "Comment"]


def test_an_empty_unit_between_commas_keeps_its_place() -> None:
    found = described(["t", "a", "b", "c"], 4, ['Vertical Units,"g",,N'])
    assert found == ["t", "a [g]", "b", "c [N]"]


@pytest.mark.parametrize(
    "line", ["Sample Rate        1000 Hz", "rate\t\t[Hz]\t1000", "Sampling  Interval :    0.001   s", "Fs =    1 kHz"]
)
def test_columns_of_blanks_do_not_hide_a_rate(line: str) -> None:
    found = rate_of([line])
    assert found.step_s == pytest.approx(1e-3, rel=1e-12)
