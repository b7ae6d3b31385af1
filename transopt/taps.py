"""Looking at recordings before anything is solved: `transopt taps`."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from transopt.reference import Tap
from transopt.scene import Recordings
from transopt.signals import STANDARD_GRAVITY_M_S2


def taps_table(taps: Sequence[Tap]) -> Table:
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
            "any" if np.isnan(tap.speed_m_s) else f"{tap.speed_m_s:.4g}",
            tap.speed_source,
            f"{tap.peak_m_s2 / STANDARD_GRAVITY_M_S2:.3g}",
            str(tap.clipped_samples) if tap.clipped_samples else "no",
            "; ".join(tap.notes) or "-",
        )
    return table


def _grid_speeds(speeds_m_s: Sequence[float], tolerance: float) -> list[float]:
    """Nodes such that every tap lies within the tolerance of one: the mean of each cluster of sorted speeds."""
    clusters: list[list[float]] = []
    for speed in sorted(speeds_m_s):
        # The mean of a cluster is within tolerance of both its ends if they differ by no more than this.
        if clusters and speed <= clusters[-1][0] * (1 + tolerance):
            clusters[-1].append(speed)
        else:
            clusters.append([speed])
    return [float(f"{np.mean(cluster):.3g}") for cluster in clusters]


def scene_section(taps: Sequence[Tap], paths: Sequence[Path], settings: Recordings) -> str:
    """TOML to paste into a scene: the grid speeds that serve these taps, and the recordings table."""
    speeds = _grid_speeds([tap.speed_m_s for tap in taps if not np.isnan(tap.speed_m_s)], settings.speed_tolerance)
    stated = settings.model_dump(exclude_defaults=True, exclude={"folder", "files", "simulated"})
    files = json.dumps([path.resolve().as_posix() for path in paths])
    lines = ["[grid]", f"speeds_m_s = {speeds}", "", "[recordings]", f"files = {files}"]
    for key, value in stated.items():
        lines.append(f"{key} = {json.dumps(value)}")  # strings, numbers and lists are spelt alike in TOML
    return "\n".join(lines)
