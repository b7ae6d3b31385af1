"""Files that `transopt solve` writes for a scene with `[model.nonlinear]`: figures of both designs, and commands."""

import json
from dataclasses import asdict
from typing import Any

from transopt.base.files import without_nan
from transopt.base.writing import csv_text, table
from transopt.design.build import Build
from transopt.design.entry import Entry
from transopt.library.columns import EntryTable, TableRow
from transopt.library.posed import NONLINEAR_CLAIM
from transopt.report.write import LIBRARY, Files, text

REPORT, FIGURES, COMMANDS, DRAWN = "nonlinear.md", "nonlinear.json", "nonlinear.csv", "nonlinear.png"


def nonlinear_files(design: Build, *, figures: bool = True) -> Files:
    """The library, `nonlinear.md`, `.json` and `.png`, and the proven commands in `nonlinear.csv`, if any are."""
    files = {REPORT: text(nonlinear_markdown(design)), FIGURES: text(nonlinear_json(design))}
    if design.library is not None:
        files[LIBRARY] = design.library.save
    if design.proven:
        files[COMMANDS] = text(commands_csv(design))
    if figures:
        from transopt.base.plotting import save_figure
        from transopt.report.figures import nonlinear_figure

        files[DRAWN] = lambda path: save_figure(nonlinear_figure(list(design.all_entries())), path, design.scene.name)
    return files


def nonlinear_markdown(design: Build) -> str:
    """The report in Markdown."""
    shown = nonlinear_table(design)
    lines = [
        f"# {design.scene.name}",
        "",
        *filter(None, [design.scene.description]),
        "",
        "Each target is designed for the plant of `[model.nonlinear]`, and beside it for the plant as it is at rest. "
        "`linear, promised` is what the linear plant would have; all other errors are of the command played on the "
        "nonlinear plant in continuous time. The status is `stationary`: the gradient of the Lagrangian vanishes "
        "within the tolerance (`gap`); no lower bound follows, since the problem is not convex.",
        *(["", f"`{LIBRARY}`: {NONLINEAR_CLAIM}."] if design.library is not None else []),
        "",
        *table(shown.heads, shown.cells),
    ]
    for entry in design.all_entries():
        lines += [f"## {entry.target}", "", f"- binds: {entry.binding}"]
        lines += [f"- the linear design leaves on this plant: {sentence}" for sentence in entry.linear_leaves]
        lines += [f"- {part}: {reason}" for part, reason in entry.designed.left_out.items()]
        lines += [f"- refused: {sentence}" for sentence in refusals(entry)] + [""]
    return "\n".join(lines)


def nonlinear_json(design: Build) -> str:
    """The figures of a nonlinear design as JSON; a missing value is null."""
    content = {
        "scene": design.scene.name,
        "elapsed_s": design.elapsed_s,
        "entries": [_figures(entry) for entry in design.all_entries()],
    }
    return json.dumps(without_nan(content), indent=1)


def _figures(entry: Entry) -> dict[str, Any]:
    c = entry.certificate
    return {
        "target": entry.target,
        "status": entry.status.name.lower(),
        "shortfalls": refusals(entry),
        **asdict(entry.figures),
        "linear_promised": entry.linear_promised,
        "linear_tap_error": entry.linear_tap_error,
        "linear_error_after": entry.value("linear_after"),
        "linear_leaves": entry.linear_leaves,
        "objective": c.objective,
        "relative_gap": c.relative_gap,
        "excess": c.excess,
        "off_replay": entry.off_replay,
        "substeps": None if entry.designed.nonlinear is None else entry.designed.nonlinear.stage.substeps,
        "iterations": entry.solution.iterations,
        "solve_s": entry.solution.solve_time_s,
        "binding": entry.binding,
        "left_out": entry.designed.left_out,
    }


def refusals(entry: Entry) -> list[str]:
    """Why an entry is not proven, one sentence each; empty if it is proven."""
    return [] if entry.admitted else entry.shortfalls or [entry.status.value]


def nonlinear_table(design: Build) -> EntryTable:
    """All targets with the errors of the linear design too; refused entries show their figures as well."""
    names = ("linear", "tap", "linear_after", "after", "ms", "gap", "result")
    rows = [TableRow(e.cells, {name: e.value(name) for name in names}) for e in design.all_entries()]
    return EntryTable(design.scene.axes.columns, names, rows, design.scene.driven_by.unit)


def commands_csv(design: Build) -> str:
    """The proven commands, one column per target, with the time at which each held value is issued [s]."""
    grid = design.scene.time_grid()
    unit = design.scene.driven_by.unit
    issued_s = [k * grid.dt_s - grid.lead_s for k in range(grid.stages)]
    columns = [entry.solution.command for entry in design.proven]
    head = ["issued_s", *(f"{entry.target}_{unit}" for entry in design.proven)]
    return csv_text(head, zip(map(repr, issued_s), *(map(repr, c.tolist()) for c in columns), strict=True))
