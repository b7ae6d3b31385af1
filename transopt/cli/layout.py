"""What a command line states about files that do not state it themselves: their columns and units."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from transopt.recordings.names import Layout

COLUMNS_HELP = 'Names of the files\' columns, in order, "-" skips one: time_s,-,acceleration_g or time,force,acc.'
UNITS_HELP = "Units of columns that state none: time=s,acc=g,force=N."


def split_columns(columns: str) -> list[str]:
    """The names of `--columns`."""
    return [name.strip() for name in columns.split(",") if name.strip()]


def layout(columns: str, units: str) -> "Layout":
    """How the files of a command are to be read.

    Raises
    ------
    InputError : units that are none.
    """
    from transopt.recordings.names import Layout, stated_units

    return Layout(split_columns(columns), stated_units(units))
