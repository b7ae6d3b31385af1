"""Tables, report and figure of a library of an arm."""

import re
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from transopt.base.tables import Table
from transopt.base.terminal import make_folder
from transopt.base.writing import percent, table, write_text
from transopt.design.arm import ArmBuild, ArmCheck
from transopt.library.arm import ArmLibrary
from transopt.problem.answer import held_back
from transopt.report.first import HELD, MOST_LIMITS, MOST_ROWS, POOR, chosen, named_limits, stated_limit
from transopt.report.publish import publish

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LIBRARY, REPORT, REFUSED, DRAWN = "library.npz", "report.md", "refused.md", "transients.png"

Node = tuple[int, int, int, int]  # speed, grip, normal, posture
WORST = ("tap_error", "felt_error", "tangential_error", "floor")  # what is said of the worst entry
OF_A_MOTOR = re.compile(r" of motor \d+")
HEADS = ("entry", "tap error %", "tangential %", "off normal deg", "felt %", "felt dB", "floor %", "binds")
LEGEND = (
    "tap error: acceleration along the normal against the recorded one, over the intention, nothing filtered. "
    "tangential: what goes across the normal, over the same size. off normal: angle of the two sizes. "
    "felt: along the normal in 120 to 620 Hz. floor: tap error without limits, as the waveform ends while the hand "
    "pushes."
)


def rows(library: ArmLibrary) -> list[list[str]]:
    """What a table shows of every entry, in the columns of `HEADS`."""
    arrays, found = library.arrays, []
    for node in library.nodes:
        errors = [percent(float(arrays[name][node])) for name in ("tap_error", "tangential_error")]
        felt = [percent(float(arrays["felt_error"][node])), f"{arrays['felt_dB'][node]:.2f}"]
        angle = f"{np.degrees(arrays['direction_rad'][node]):.1f}"
        floor = percent(float(arrays["floor"][node]))
        found.append([library.place(node), *errors, angle, *felt, floor, str(arrays["binding"][node])])
    return found


def first_look(library: ArmLibrary, proof: str) -> list[str]:
    """What was designed, the tap error over speed and grip at the worst normal and posture, the worst entry.

    Parameters
    ----------
    proof : what is proven of all entries, as "proven optimal and replayed".
    """
    arrays, held = library.arrays, {node: _held(library, node) for node in library.nodes}
    errors, (o, q) = arrays["tap_error"], library.command.shape[2:4]
    poor = int((errors >= POOR).sum())
    every = (
        f"{poor} of {errors.size} taps are poor, half of each is missing; all" if poor else f"{errors.size} taps, all"
    )
    lines = [f"{library.meta['scene']['name']}: {every} {proof}."]
    lines += [f"tap error %, the worst of {o} normals and {q} postures", *_matrix(library, held)]
    names = Counter(name for found in held.values() for name in found)
    if names:
        lines.append(f"{HELD} held back by {named_limits([name for name, _ in names.most_common(MOST_LIMITS)])}")
    node = library.nodes[int(errors.argmax())]
    error, felt, across, floor = (percent(float(arrays[name][node])) for name in WORST)
    at = library.place(node)
    lines.append(f"Worst: {at}: {error} % (felt {felt} %), {across} % across the normal; without limits {floor} %.")
    return lines


def _matrix(library: ArmLibrary, held: Mapping[Node, list[str]]) -> list[str]:
    """Largest tap error over normals and postures, by speed and grip; a mark where a limit holds one of them back."""
    errors, (v, g, o, q) = library.arrays["tap_error"], library.command.shape[:4]
    down = chosen(v, MOST_ROWS, int(errors.argmax() // (g * o * q)))
    table = [["", *(f"{grip:g} N " for grip in library.arrays["grips_N"])]]
    for iv in down:
        marks = [HELD if any(held[iv, ig, io, iq] for io, iq in np.ndindex(o, q)) else " " for ig in range(g)]
        cells = [percent(float(errors[iv, ig].max())) + mark for ig, mark in enumerate(marks)]
        table.append([f"{library.arrays['speeds_m_s'][iv]:g} m/s", *cells])
    first, *widths = (max(map(len, column)) for column in zip(*table, strict=True))
    lines = [
        f"{row[0]:<{first}}" + "".join(f"{text:>{n + 2}}" for text, n in zip(row[1:], widths, strict=True))
        for row in table
    ]
    if v > len(down):
        lines.append(f"({len(down)} of {v} speeds, the worst among them; --table has all)")
    return [line.rstrip() for line in lines]


def _held(library: ArmLibrary, node: Node) -> list[str]:
    """The limits that hold an entry back, each once, whichever motors they hold."""
    error, floor = (float(library.arrays[name][node]) for name in ("tap_error", "floor"))
    found = held_back(error, floor, str(library.arrays["binding"][node]))
    return list(dict.fromkeys(stated_limit(OF_A_MOTOR.sub("", text)) for text in found))


def refusals(build: ArmBuild) -> list[str]:
    """Why entries are refused, one line each."""
    scene, found = build.scene, []
    for entry in build.entries:
        if not entry.admitted:
            iv, ig, io, iq = entry.node
            tap = f"{scene.grid.speeds_m_s[iv]:g} m/s, {scene.grid.grips_N[ig]:g} N"
            why = "; ".join(entry.shortfalls) or entry.status.value
            found.append(f"{tap}, normal {io + 1}, posture {iq + 1}: {why}")
    return found


def write_arm(build: ArmBuild, folder: Path, *, figures: bool = True) -> list[str]:
    """Write `library.npz`, `report.md` and `transients.png`, all or none; of a refused build `refused.md` alone.

    Returns
    -------
    Names of the files.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    make_folder(folder)
    library, text = build.library, arm_markdown(build)
    files: dict[str, Callable[[Path], object]] = {}
    if library is None:
        files[REFUSED] = lambda path: write_text(text, path)
    else:
        files = {LIBRARY: library.save, REPORT: lambda path: write_text(text, path)}
        if figures:
            from transopt.base.plotting import save_figure

            files[DRAWN] = lambda path: save_figure(arm_figure(library), path)
    stale = [] if library is None else [name for name in (REFUSED, DRAWN) if name not in files]
    publish(folder, files, stale)
    return list(files)


def entries_table(library: ArmLibrary, title: str) -> Table:
    """Every entry, for a terminal."""
    return _printed(title, HEADS, rows(library))


def checks_table(checks: list[ArmCheck], title: str) -> Table:
    """Entry, gap, tap error and what speaks against it, of each check, for a terminal."""
    found = [
        [check.place, f"{check.gap:.1e}", percent(check.tap_error), "; ".join(check.shortfalls) or "clean"]
        for check in checks
    ]
    return _printed(title, ("entry", "gap", "tap error %", "result"), found)


def _printed(title: str, heads: tuple[str, ...], cells: list[list[str]]) -> Table:
    made = Table(title=title)
    for head in heads:
        made.add_column(
            head, justify="right" if "%" in head or head in ("gap", "felt dB", "off normal deg") else "left"
        )
    for row in cells:
        made.add_row(*row)
    return made


def arm_markdown(build: ArmBuild) -> str:
    """The report of a solved scene."""
    scene, library = build.scene, build.library
    lines = [f"# {scene.name}", "", scene.description, "", str(build), ""]
    if library is not None:
        lines += [*table(HEADS, rows(library)), "", LEGEND, ""]
        gaps = library.arrays["duality_gap"] / np.maximum(library.arrays["objective"], 1e-3)
        lines += [
            f"Largest duality gap, relative to max(J, 1e-3): {gaps.max():.1e}. Every blend of these commands over "
            "speed, grip, normal and posture keeps the limits of all motors.",
            "",
        ]
    return "\n".join([*lines, *(f"- refused: {said}" for said in refusals(build)), ""])


def arm_figure(library: ArmLibrary) -> "Figure":
    """Fastest tap at the first grip, a row for each normal and posture: accelerations beside the target, currents."""
    from transopt.base.plotting import Drawing

    grid = library.posing.grid
    times_ms = grid.switching_times_s * 1e3
    places = [*np.ndindex(*library.command.shape[2:4])]
    figure = Drawing(figsize=(9.0, 2.4 * len(places)), layout="constrained")
    axes = figure.subplots(len(places), 2, squeeze=False, sharex=True)
    limit = float(library.posing.asked["current_A"])
    for row, (io, iq) in zip(axes, places, strict=True):
        node = (library.command.shape[0] - 1, 0, io, iq)
        target = library.problem(node).target
        made = library.arrays["acceleration_m_s2"][node] + target.of_window(target.free_m_s2)
        row[0].plot(times_ms, target.of_window(target.recorded_m_s2)[0], color="0.6", label="recorded, normal")
        for course, label in zip(made, ("normal", "tangent 1", "tangent 2"), strict=True):
            row[0].plot(times_ms, course, label=label, linewidth=1.0)
        for j, current in enumerate(library.arrays["plant_input"][node]):
            row[1].plot(times_ms, current, label=f"motor {j + 1}", linewidth=1.0)
        for bound in (-limit, limit):
            row[1].axhline(bound, color="0.6", linestyle=":")
        row[0].set_ylabel("m/s$^2$")
        row[1].set_ylabel("A")
        row[0].set_title(library.place(node), fontsize=9)
    axes[0][0].legend(fontsize=7)
    axes[0][1].legend(fontsize=7)
    for last in axes[-1]:
        last.set_xlabel("time after contact [ms]")
    return figure
