"""Rows as text."""

import csv

from transopt.base.writing import csv_text
from transopt.study.rows import exit_code, row_of


def test_cells_are_read_back_exactly_and_stay_on_one_line() -> None:
    place = {"index": 7, "speed_m_s": 0.1 + 0.2, "grip_N": 1.0, "target": ""}
    said = 'with "quotes", a comma\nand a new line'
    outcome = {**place, "status": "OPTIMAL", "tap_error": 1e-7 / 3, "reason": said}
    row = row_of(outcome, 3, {"limits.current_A": "1.5", "motor": "two\nlines"})
    text = csv_text(list(row), [row.values()])
    assert text.count("\n") == 2
    [again] = csv.DictReader(text.splitlines())
    assert again == row
    assert (float(again["speed_m_s"]), float(again["tap_error"])) == (outcome["speed_m_s"], outcome["tap_error"])
    assert (again["index"], again["point"], again["motor"]) == ("7", "3", "two lines")
    assert again["floor"] == ""  # nothing to say
    assert again["reason"] == 'with "quotes", a comma and a new line'


def test_exit_code() -> None:
    def code(*statuses: str) -> int:
        return exit_code([{"status": status} for status in statuses])

    assert code("OPTIMAL", "REFUSED", "INFEASIBLE") == code("STATIONARY") == 0
    assert code("REFUSED") == code("OPTIMAL", "NOT_CERTIFIED") == code() == 1
