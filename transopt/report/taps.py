"""A look at recordings before anything is solved, for `transopt taps`: tables, and a scene file or lines of one."""

import json
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, IndexArray
from transopt.base.tables import Table
from transopt.base.toml import toml_value
from transopt.recordings.approach import UNSEPARATED
from transopt.recordings.settings import Recordings
from transopt.recordings.speed import UNKNOWN, seen_speed
from transopt.recordings.speed_groups import speed_groups
from transopt.recordings.tap import PreparedTap
from transopt.references.references import COST, grip_groups

NO_GRAVITY_M_S2 = 0.5  # a smaller offset: the sensor is within 3 degrees of level, or reads no gravity
MOST_LINES = 3  # lines of one kind; the files of a folder usually share a fault
MOST_SPREAD = 2.0  # ratio of the peaks of taps of one speed: a hand's angle, grip and aim change less
RATE_HZ = 10_000
BEFORE_S, AFTER_S = 0.05, 0.1  # before and after contact: enough to find speed, offset and ringing
SPEED_M_S, PULSE_S = 0.2, 4e-3
BACK = 0.2  # of the incoming speed: speed with which the stylus is thrown back
REMARKS = """\
# One tap on a real object, for `transopt taps` and `transopt solve`. Lines with # are remarks, but for these two:
# speed_m_s: {speed:g}
# grip_N: 3
# The first is the incoming speed. With position_m recorded it may be left out; without an encoder state it, and leave
# the column position_m out. The second is the grip force; leave it out where nobody measured it.
# Columns in any order, each with its unit: time_s or time_ms, acceleration_g or acceleration_m_s2, position_m or
# position_mm, force_N, current_A. Time and acceleration are needed. The rows below are an invented tap: put yours
# in their place.
"""


def taps_table(taps: Sequence[PreparedTap]) -> Table:
    """One row per tap: rate, onset, offset, polarity, speed, grip, a0, peak, and what differs or is there at all."""
    sources = {tap.speed_source for tap in taps}
    shared = set(shared_notes(taps))
    clipped, noted = any(tap.clipped_samples for tap in taps), any(set(tap.notes) - shared for tap in taps)
    names = (
        "file",
        "rate kHz",
        "onset ms",
        "offset g",
        "sign",
        "speed m/s",
        *["speed from"] * (len(sources) > 1),
        "grip N",
        "a0 m/s2",
        "peak g",
        *["clipped"] * clipped,
        *["notes"] * noted,
    )
    title = f"{len(taps)} recording{'s' * (len(taps) > 1)}"
    if len(sources) == 1:
        title += f", speed source: {min(sources)}"
    title += ", no sample clipped" * (not clipped)
    table = Table.of(title, names, words=("file", "speed from", "notes"), middle=("file",))
    for tap in taps:
        table.add_row(
            tap.recording.name,
            f"{tap.recording.acceleration.rate_Hz / 1e3:.4g}",
            f"{tap.onset_s * 1e3:.2f}",
            f"{tap.offset_m_s2 / STANDARD_GRAVITY_M_S2:z.3f}",
            "+" if tap.polarity > 0 else "-",
            _speed_cell(tap),
            *[tap.speed_source] * (len(sources) > 1),
            "?" if tap.recording.grip_N is None else f"{tap.recording.grip_N:.4g}",
            "?" if tap.incoming_source == UNSEPARATED else f"{tap.incoming_acceleration_m_s2:.2f}",
            f"{tap.peak_m_s2 / STANDARD_GRAVITY_M_S2:.3g}",
            *[str(tap.clipped_samples) if tap.clipped_samples else "no"] * clipped,
            *["; ".join(note for note in tap.notes if note not in shared) or "-"] * noted,
        )
    return table


def shared_notes(taps: Sequence[PreparedTap]) -> list[str]:
    """The notes on every one of several taps, which the table of taps leaves out."""
    return [note for note in taps[0].notes if all(note in tap.notes for tap in taps)] if len(taps) > 1 else []


class Grid(NamedTuple):
    """Speeds and grips that suit a set of taps.

    Attributes
    ----------
    speeds_m_s : increasing.
    at : number of the speed of each tap; None for a tap that serves every speed, or of unknown speed.
    grips_N : groups of the stated grips, increasing.
    """

    speeds_m_s: list[float]
    at: list[int | None]
    grips_N: list[list[float]]


def grid_of(taps: Sequence[PreparedTap], settings: Recordings, speeds_m_s: Sequence[float] = ()) -> Grid:
    """The grid of a scene of these taps.

    Parameters
    ----------
    speeds_m_s : of the grid, as the user states them; empty to find them in the taps.

    Raises
    ------
    InputError : a tap is too far from every stated speed.
    """
    known = [tap.speed_m_s for tap in taps if not np.isnan(tap.speed_m_s)]
    speeds = sorted(speeds_m_s) or [_mean(group) for group in speed_groups(known, settings.speed_tolerance)]
    at = [None if np.isnan(tap.speed_m_s) else _nearest(speeds, tap.speed_m_s) for tap in taps]
    for tap, place in zip(taps, at, strict=True):
        if speeds_m_s and place is not None and abs(speeds[place] / tap.speed_m_s - 1) > settings.speed_tolerance:
            raise InputError(
                f"--speeds {','.join(f'{speed:g}' for speed in speeds)}: {tap.recording.name} has "
                f"{tap.speed_m_s:.3g} m/s, {abs(speeds[place] / tap.speed_m_s - 1):.0%} from the nearest of them, "
                f"limit {settings.speed_tolerance:.0%}: add its speed, or leave the file out"
            )
    return Grid(speeds, at, grip_groups([tap.recording.grip_N for tap in taps if tap.recording.grip_N is not None]))


def _nearest(speeds_m_s: Sequence[float], speed_m_s: float) -> int:
    return min(range(len(speeds_m_s)), key=lambda place: abs(speeds_m_s[place] / speed_m_s - 1))


def cells_table(taps: Sequence[PreparedTap], grid: Grid) -> Table | None:
    """Number of taps per speed and grip, and what replaces missing ones; None if no grip is stated."""
    if not (grid.grips_N and grid.speeds_m_s):
        return None
    table = Table.of("taps by speed and grip", ["speed m/s", *(f"{_mean(group):g} N" for group in grid.grips_N)])
    for place, speed in enumerate(grid.speeds_m_s):
        own = [tap.recording.grip_N for tap, at in zip(taps, grid.at, strict=True) if at == place]
        row = [sum(grip in group for grip in own) for group in grid.grips_N]
        known = np.flatnonzero(row)
        table.add_row(f"{speed:g}", *(_filled(n, j, known) for j, n in enumerate(row)))
    return table


def _filled(count: int, column: int, known: IndexArray) -> str:
    """Content of a cell: its own taps, interpolation between neighbours, or the outermost grip of its speed."""
    if count:
        return str(count)
    if known.size == 0:
        return "none"
    return "interpolated" if known[0] < column < known[-1] else "clamped"


def hints(taps: Sequence[PreparedTap], settings: Recordings) -> list[str]:
    """What the user may have to state about all recordings, one sentence each."""
    found = []
    silent = sum(tap.recording.grip_N is None for tap in taps)
    if silent == len(taps):
        found.append(f"no tap states its grip, so each serves every grip; state it by --grip: {COST}")
    elif silent:
        found.append(f"{silent} of {len(taps)} taps state no grip, and solve refuses such a mixture: state it")
    still = max(abs(tap.offset_m_s2) for tap in taps)
    if settings.trusted_from_Hz == 0 and still < NO_GRAVITY_M_S2:
        found.append(
            "no recording has the offset that gravity makes. Records of transopt-play and level sensors have none; "
            "if the sensor is of the IEPE type it loses 3 to 22 % of a tap: state its cut-off, as --trusted-from-Hz 2"
        )
    found += _uneven(taps, settings)
    return found


def _uneven(taps: Sequence[PreparedTap], settings: Recordings) -> list[str]:
    """A sentence on each stated speed whose taps' peaks differ as those of one speed do not."""
    found = []
    stated = [tap for tap in taps if tap.recording.speed_m_s is not None]
    for group in speed_groups([tap.speed_m_s for tap in stated], settings.speed_tolerance):
        peaks = {tap.recording.name: tap.peak_m_s2 for tap in stated if tap.speed_m_s in group}
        low, high = (choose(peaks, key=lambda name: peaks[name]) for choose in (min, max))
        if peaks[high] > MOST_SPREAD * peaks[low]:
            spread = " to ".join(f"{peaks[name] / STANDARD_GRAVITY_M_S2:.3g} g ({name})" for name in (low, high))
            seen = next(seen_speed(tap.recording, tap.onset_s) for tap in stated if tap.recording.name == low)
            speed = seen[0] if seen else _mean(group) * peaks[low] / peaks[high]
            slower = f"{{ {json.dumps(low)} = {speed:.2g} }}"
            fitted = ", or leave the speed out where a position tells it" * (seen is not None)
            found.append(
                f"{len(peaks)} taps are stated to come at {_mean(group):g} m/s, with peaks of {spread}: taps of one "
                "speed differ less, and a peak grows with the speed; state the speed of each in the scene, as "
                f"recordings.speed_by_file_m_s = {slower}{fitted}"
            )
    return found


def implausible_lines(taps: Sequence[PreparedTap]) -> list[str]:
    """Recordings that are implausible in the stated units: the first few in a line each, then how many more."""
    found = list(dict.fromkeys(f"{tap.recording.name}: {tap.implausible}" for tap in taps if tap.implausible))
    more = len(found) - MOST_LINES
    return [*found[:MOST_LINES], *([f"and {more} recordings more"] if more > 0 else [])]


def _speed_cell(tap: PreparedTap) -> str:
    if not np.isnan(tap.speed_m_s):
        return f"{round(tap.speed_m_s, 4):.4g}"
    return "?" if tap.speed_source == UNKNOWN else "any"


def _mean(cluster: Sequence[float]) -> float:
    return float(f"{np.mean(cluster):.3g}")


def _lines(
    found: Grid, paths: Sequence[Path], settings: Recordings, home: Path | None
) -> tuple[list[str], list[str]]:
    """TOML lines for the tables [grid] and [recordings] of a scene.

    Parameters
    ----------
    home : folder of the scene, to which the recordings' folder is relative; None makes it absolute.
    """
    grips = [_mean(group) for group in found.grips_N if any(group)]
    grid = [f"speeds_m_s = {found.speeds_m_s}", *([f"grips_N = {grips}"] if len(grips) > 1 else [])]
    stated = settings.model_dump(exclude_defaults=True, exclude={"folder", "files", "simulated"})
    folder = Path(os.path.commonpath([path.resolve().parent for path in paths]))
    files = [path.resolve().relative_to(folder).as_posix() for path in paths]
    if home is not None:
        with suppress(ValueError):  # Windows has no relative path to another drive
            folder = Path(os.path.relpath(folder, home.resolve()))
    # Strings, numbers and lists have the same spelling in JSON and TOML.
    lines = [f"folder = {json.dumps(folder.as_posix())}", f"files = {json.dumps(files)}"]
    return grid, [*lines, *(f"{key} = {toml_value(value)}" for key, value in stated.items())]


def scene_lines(found: Grid, paths: Sequence[Path], settings: Recordings) -> str:
    """TOML lines for the tables [grid] and [recordings] of a scene: speeds that suit the taps, and the files."""
    grid, recordings = _lines(found, paths, settings, None)
    replaced = "# in [recordings], in place of folder, files and simulated"
    keys = " and ".join(line.split(" = ")[0] for line in grid)
    return "\n".join([f"# in [grid], in place of {keys}", *grid, "", replaced, *recordings])


def scene_of_taps(template: str, found: Grid, paths: Sequence[Path], settings: Recordings, home: Path) -> str:
    """A complete scene file: these recordings on the device of a template.

    Parameters
    ----------
    template : text of the built-in scene `own_taps`.
    home : folder in which the file will be.
    """
    grid, recordings = ("\n".join(lines) for lines in _lines(found, paths, settings, home))
    device = template[template.index("motor = ") :]
    if "grips_N" in grid:
        device = re.sub(r"(?m)^grips_N = .*\n", "", device)
    text, speeds = re.subn(r"(?m)^speeds_m_s = .*$", lambda _: grid, device)
    text, files = re.subn(r"(?ms)^# Three recordings.*?^files = .*?$", lambda _: recordings, text)
    assert (speeds, files) == (1, 1)
    about = "taps of one's own on the built-in device"
    return (
        f'# Written by `transopt taps`: {about}; change what is not as yours is.\ndescription = "{about}"\n\n{text}'
    )


def template() -> str:
    """Text of a CSV file that can be read unchanged: a half sine of 4 ms between an approach and a return."""
    t = np.arange(round((BEFORE_S + AFTER_S) * RATE_HZ)) / RATE_HZ - BEFORE_S
    touching = np.clip(t / PULSE_S, 0.0, 1.0)
    peak = (1 + BACK) * SPEED_M_S * np.pi / (2 * PULSE_S)
    # z is the double integral of a from the approach on; the sensor reads +1 g where its axis points up.
    a = np.where((t > 0) & (t < PULSE_S), peak * np.sin(np.pi * touching), 0.0)
    swing = PULSE_S / np.pi * (touching * PULSE_S - PULSE_S / np.pi * np.sin(np.pi * touching))
    z = -SPEED_M_S * t + peak * (swing + 2 * PULSE_S / np.pi * np.maximum(t - PULSE_S, 0.0))
    rows = (f"{s:.4f},{x / STANDARD_GRAVITY_M_S2 + 1:.4f},{y:.7f}" for s, x, y in zip(t, a, z, strict=True))
    return "\n".join([REMARKS.format(speed=SPEED_M_S) + "time_s,acceleration_g,position_m", *rows, ""])
