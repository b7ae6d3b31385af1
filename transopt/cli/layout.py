"""What a command line states about files that do not state it themselves: their columns and units."""

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from transopt.files.names import Layout
    from transopt.files.unclear import Answer

LEAST_RATE_HZ = 0.01  # a logger's reading every hundred seconds
COLUMNS_HELP = 'Names of the files\' columns, in order, "-" skips one: time_s,-,acceleration_g or time,force,acc.'
UNITS_HELP = "Units of columns that state none: time=s,acc=g; of a sensor with its sensitivity: CH1=mV @ 100 mV/g."
RATE_HELP = "Sample rate of files that have no times, or none to go by."
RateHz = Annotated[float | None, typer.Option("--rate-Hz", metavar="<float>", help=RATE_HELP, min=LEAST_RATE_HZ)]


def split_columns(columns: str) -> list[str]:
    """The names of `--columns`."""
    return [name.strip() for name in columns.split(",") if name.strip()]


def layout(columns: str, units: str, rate_Hz: float | None = None, answer: "Answer | None" = None) -> "Layout":
    """How the files of a command are to be read, by its options and by what a person answers.

    Raises
    ------
    InputError : units that are none.
    """
    from transopt.files.names import Layout, stated_units
    from transopt.files.unclear import joined

    stated = {"columns": split_columns(columns), "units": stated_units(units), "rate_Hz": rate_Hz}
    return Layout(**joined(stated, answer or {}))
