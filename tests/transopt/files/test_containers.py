"""Cells of a workbook as the text that its program would export."""

from datetime import date, datetime

from transopt.files.containers import _cell


def test_an_instant_at_midnight_is_one_of_the_others() -> None:
    """A workbook's date has no type of its own: the reader hands out a day where the time of day is zero."""
    assert _cell(date(2024, 3, 5)) == str(datetime(2024, 3, 5)) == "2024-03-05 00:00:00"
    assert _cell(datetime(2024, 3, 5, 0, 0, 0, 200)) == "2024-03-05 00:00:00.000200"
