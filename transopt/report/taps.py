"""A look at recordings before anything is solved, for `transopt taps`: a table, and a scene file or lines for one."""

import json
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from rich.table import Table

from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.recordings.settings import Recordings
from transopt.recordings.speed import UNKNOWN
from transopt.recordings.tap import PreparedTap

MOST_LINES = 3  # of one kind; a whole folder is wrong in the same way
CLUSTER_WIDTH = 0.1  # relative; well within the 15 % by which a tap may be scaled to its grid speed


def taps_table(taps: Sequence[PreparedTap]) -> Table:
    """Per file: rate, onset, offset, polarity, speed and its source, peak, clipping, notes."""
    table = Table(title=f"{len(taps)} recordings")
    names = (
        "file",
        "rate kHz",
        "onset ms",
        "offset g",
        "polarity",
        "speed m/s",
        "speed from",
        "peak g",
        "clipped",
        "notes",
    )
    for name in names:
        table.add_column(
            name, overflow="fold", justify="left" if name in ("file", "speed from", "notes") else "right"
        )
    for tap in taps:
        table.add_row(
            tap.recording.name,
            f"{tap.recording.acceleration.rate_Hz / 1e3:.4g}",
            f"{tap.onset_s * 1e3:.3f}",
            f"{tap.offset_m_s2 / STANDARD_GRAVITY_M_S2:.3f}",
            "+" if tap.polarity > 0 else "-",
            _speed_cell(tap),
            tap.speed_source,
            f"{tap.peak_m_s2 / STANDARD_GRAVITY_M_S2:.3g}",
            str(tap.clipped_samples) if tap.clipped_samples else "no",
            "; ".join(tap.notes) or "-",
        )
    return table


def implausible_lines(taps: Sequence[PreparedTap]) -> list[str]:
    """What cannot be a tap in the units that are stated: the first few in a line each, then how many more."""
    found = list(dict.fromkeys(f"{tap.recording.name}: {tap.implausible}" for tap in taps if tap.implausible))
    more = len(found) - MOST_LINES
    return [*found[:MOST_LINES], *([f"and {more} recordings more"] if more > 0 else [])]


def _speed_cell(tap: PreparedTap) -> str:
    if not np.isnan(tap.speed_m_s):
        return f"{tap.speed_m_s:.4g}"
    return "?" if tap.speed_source == UNKNOWN else "any"


def _grid_speeds(speeds_m_s: Sequence[float]) -> list[float]:
    """The mean of each cluster of sorted speeds, a cluster being no wider than a tenth."""
    clusters: list[list[float]] = []
    for speed in sorted(speeds_m_s):
        if clusters and speed <= clusters[-1][0] * (1 + CLUSTER_WIDTH):
            clusters[-1].append(speed)
        else:
            clusters.append([speed])
    return [float(f"{np.mean(cluster):.3g}") for cluster in clusters]


def _lines(
    taps: Sequence[PreparedTap], paths: Sequence[Path], settings: Recordings, home: Path | None
) -> tuple[list[str], list[str]]:
    """TOML lines for the [grid] and the [recordings] table of a scene.

    Parameters
    ----------
    home : folder of the scene, from which the recordings' folder counts; None names it whole.
    """
    speeds = _grid_speeds([tap.speed_m_s for tap in taps if not np.isnan(tap.speed_m_s)])
    stated = settings.model_dump(exclude_defaults=True, exclude={"folder", "files", "simulated"})
    folder = Path(os.path.commonpath([path.resolve().parent for path in paths]))
    files = [path.resolve().relative_to(folder).as_posix() for path in paths]
    if home is not None:
        with suppress(ValueError):  # another drive of Windows has no relative path
            folder = Path(os.path.relpath(folder, home.resolve()))
    # Strings, numbers and lists are spelt alike in JSON and TOML.
    lines = [f"folder = {json.dumps(folder.as_posix())}", f"files = {json.dumps(files)}"]
    return [f"speeds_m_s = {speeds}"], [*lines, *(f"{key} = {_toml(value)}" for key, value in stated.items())]


def _toml(value: object) -> str:
    """A value as TOML spells it: as JSON, but for the pairs of a table."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{json.dumps(key)} = {_toml(one)}' for key, one in value.items())} }}"
    return json.dumps(value)


def scene_lines(taps: Sequence[PreparedTap], paths: Sequence[Path], settings: Recordings) -> str:
    """TOML lines for the [grid] and [recordings] tables of a scene: speeds that serve these taps, and the files."""
    grid, recordings = _lines(taps, paths, settings, None)
    replaced = "# in [recordings], in place of folder, files and simulated"
    return "\n".join(["# in [grid]", *grid, "", replaced, *recordings])


def scene_of_taps(
    template: str, taps: Sequence[PreparedTap], paths: Sequence[Path], settings: Recordings, home: Path
) -> str:
    """A whole scene file: these recordings on the device of a template.

    Parameters
    ----------
    template : text of the built-in scene `own_taps`.
    home : folder that the file is for.
    """
    grid, recordings = ("\n".join(lines) for lines in _lines(taps, paths, settings, home))
    device = template[template.index("motor = ") :]
    text, speeds = re.subn(r"(?m)^speeds_m_s = .*$", lambda _: grid, device)
    text, files = re.subn(r"(?ms)^# Three recordings.*?^files = .*?$", lambda _: recordings, text)
    assert (speeds, files) == (1, 1)
    about = "taps of one's own on the built-in device"
    return (
        f'# Written by `transopt taps`: {about}; change what is not as yours is.\ndescription = "{about}"\n\n{text}'
    )
