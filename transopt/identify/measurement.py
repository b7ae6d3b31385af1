"""A run recorded on a device to identify it: its signals, and the conditions that its file states."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from transopt.base.errors import InputError
from transopt.base.signals import Signal
from transopt.files.names import Layout, Scalar, Vocabulary
from transopt.recordings.axes import read_signals
from transopt.recordings.plausible import implausible_grip
from transopt.recordings.split import pieces

WORDS = Vocabulary(
    columns=(
        *("time_s", "time_ms"),
        *("command_A", "current_A", "voltage_V"),
        *("acceleration_m_s2", "acceleration_g"),
        *("position_m", "position_mm", "force_N"),
        *("winding_C", "housing_C", "ambient_C"),
    ),
    header={
        "speed_m_s": Scalar("speed", 1.0, "m/s"),
        "grip_N": Scalar("grip", 1.0, "N", zero=True),
        "accelerometer_Hz": Scalar("accelerometer", 1.0, "Hz"),
        "period_s": Scalar("period", 1.0, "s"),
        "held_out": Scalar("held_out", 1.0, "", zero=True),
    },
    required=("time",),
    step_s=(1e-7, 60.0),  # a logger of temperatures may read once a minute, since heating takes half an hour
)
BY_NAME = "name all columns by --columns, - skips one"  # where a column may go by a name that nobody knows


@dataclass(frozen=True)
class Measurement:
    """One run of a device: a sweep, a tap or a heating, in SI units.

    All signals share one uniform time grid. A signal that was not recorded is None.

    Attributes
    ----------
    name : name in messages and reports: the file's name.
    source : path of the file.
    sha256 : of the file's bytes.
    command : sample k is issued at its instant and held to the next one [A].
    current : in the coil [A].
    voltage : across it [V].
    acceleration : of the stylus, positive out of the object [m/s^2], behind one pole at `accelerometer_Hz` if stated.
    position : of the motor at the tip [m].
    force : of the surface on the stylus, pushing out [N].
    winding, housing, ambient : temperatures [C].
    grip_N : >= 0, 0 for a device that nobody holds; None if the file does not state it.
    speed_m_s : incoming speed of a tap.
    accelerometer_Hz : bandwidth of the accelerometer; None for one to be taken as ideal.
    period_s : period of the excitation, after a first period from rest; None if it does not repeat.
    held_out : whether the run is held out for validation and must not be fitted.
    off_grid : rms deviation of the time stamps from the uniform grid, in steps, before resampling to it.
    missing : which samples were interpolated, in one sentence; empty if none was missing.
    notes : what of the file was left out or not used, and a grip that no hand has; one sentence each.
    """

    name: str
    source: str
    sha256: str
    command: Signal | None = None
    current: Signal | None = None
    voltage: Signal | None = None
    acceleration: Signal | None = None
    position: Signal | None = None
    force: Signal | None = None
    winding: Signal | None = None
    housing: Signal | None = None
    ambient: Signal | None = None
    grip_N: float | None = None
    speed_m_s: float | None = None
    accelerometer_Hz: float | None = None
    period_s: float | None = None
    held_out: bool = False
    off_grid: float = 0.0
    missing: str = ""
    notes: tuple[str, ...] = ()

    def require(self, quantity: str) -> Signal:
        """The signal of a quantity.

        Raises
        ------
        InputError : the file has none; the message names the column that holds it.
        """
        found = getattr(self, quantity)
        if found is None:
            raise InputError(f"{self.name}: no column {WORDS.names_of(quantity)[0]}; record it too, or {BY_NAME}")
        assert isinstance(found, Signal)
        return found

    def changed(self, change: Callable[[str, Signal], Signal]) -> "Measurement":
        """A copy in which each signal x of a quantity is replaced by `change(quantity, x)`."""
        recorded = {quantity: getattr(self, quantity) for quantity in WORDS.quantities if quantity != "time"}
        made: dict[str, Any] = {quantity: change(quantity, x) for quantity, x in recorded.items() if x is not None}
        return replace(self, **made)

    def part(self, first: int, end: int) -> "Measurement":
        """A copy with the samples from `first` up to, but not including, `end`."""
        return self.changed(lambda _, x: x.part(first, end))


def load_measurements(paths: Sequence[Path], layout: Layout | None = None) -> list[Measurement]:
    """Load several runs, each file once: a duplicate would count twice in a fit and would not validate anything.

    Raises
    ------
    InputError : see `load_measurement`; or two files with the same content.
    """
    runs, sources = [], dict[str, str]()
    for path in paths:
        run = load_measurement(path, layout)
        if run.sha256 in sources:
            same = f"the same record as {sources[run.sha256]}" if str(path) != sources[run.sha256] else "given twice"
            raise InputError(f"{path}: {same}; give every record once, and none of the fit to validate with")
        sources[run.sha256] = str(path)
        runs.append(run)
    return runs


def sources(runs: Sequence[Measurement]) -> list[dict[str, str]]:
    """The files of these runs as a model file lists them; a file with several runs is one source."""
    return [
        {"file": source, "sha256": sha256}
        for source, sha256 in dict.fromkeys((run.source, run.sha256) for run in runs)
    ]


def split_taps(runs: Sequence[Measurement], wanted: Sequence[int] = ()) -> list[Measurement]:
    """The taps in runs with a recorded surface force, one run per tap, even where a file holds several taps in a row.

    Parameters
    ----------
    wanted : numbers of the taps to take from a file with several, counted from 1; all if empty.

    Raises
    ------
    InputError : a wanted tap is not in the file, or the file has no force.
    """
    found = []
    for run in runs:
        for tap in pieces(run.name, run.require("force"), {"*": wanted} if wanted else {}):
            found.append(replace(run.part(tap.first, tap.end), name=tap.name))
    return found


def load_measurement(path: Path, layout: Layout | None = None) -> Measurement:
    """Read one run: CSV, TXT, NPZ or MAT.

    Columns: `WORDS.columns`; scalars as comment lines `# grip_N: 3` or as variables of one number.

    Parameters
    ----------
    layout : columns and units that the user states for the file.

    Raises
    ------
    InputError : the file is not readable as a run; the message is one line and names the file first.
    """
    if path.suffix.lower() == ".wav":
        raise InputError(
            f"{path}: a WAV file holds one signal; record command, current and acceleration as CSV or NPZ"
        )
    table = read_signals(path, WORDS, layout or Layout())
    if not table.signals:
        idle = "".join(f"; {note}" for note in table.notes)
        known = ", ".join(WORDS.columns)
        raise InputError(f"{path}: no column but time; known: {known}{idle}; {BY_NAME}, as 'time [ms],voltage [V],-'")
    return Measurement(
        name=path.name,
        source=str(path),
        sha256=table.sha256,
        grip_N=table.scalars.get("grip"),
        speed_m_s=table.scalars.get("speed"),
        accelerometer_Hz=table.scalars.get("accelerometer"),
        period_s=table.scalars.get("period"),
        held_out=bool(table.scalars.get("held_out", 0.0)),
        off_grid=table.off_grid,
        missing=table.missing,
        notes=(*table.notes, *filter(None, [implausible_grip(table.scalars.get("grip", 0.0))])),
        **table.signals,
    )
