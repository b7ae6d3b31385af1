"""report.md of a constraint study."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from transopt.base.machine import machine, versions
from transopt.base.tables import Table
from transopt.base.units import unit_of
from transopt.base.writing import percent, table
from transopt.library.columns import EntryTable, TableRow
from transopt.problem.answer import AT_FLOOR, Status
from transopt.scene.scene import Scene
from transopt.study.axes import label
from transopt.study.inverse import Answer
from transopt.study.plan import Plan
from transopt.study.rows import (
    ADMITTED,
    REFUSED,
    Row,
    entry_name,
    is_admitted,
    number,
)
from transopt.study.rows import entry_cells as place_cells
from transopt.study.store import LIBRARIES

MOST_ROWS = 120  # rows of the table; rows.csv has all
MOST_VALUES = 24  # values of a key shown on the terminal


def provenance(command: str, elapsed_s: float) -> list[str]:
    """Lines with command, time, machine and versions."""
    computer = machine()
    names = ", ".join(f"{name} {version}" for name, version in versions(*LIBRARIES).items())
    return [
        f"`{command}`: {elapsed_s:.0f} s on {computer['cpu']}, {computer['cores']} cores, {computer['system']}; "
        f"{names}.",
        "",
    ]


def binding_names(row: Row) -> str:
    """The binding limits without their times."""
    names = [part.split(" at ")[0] for part in row["binding"].split("; ")] if row["binding"] else []
    return ", ".join(names) or "-"


def shown_row(row: Row) -> TableRow:
    """The row as the table shows it."""
    refused = row["status"] == REFUSED
    values = {
        "tap": number(row, "tap_error"),
        "floor": number(row, "floor"),
        "peak": number(row, "peak_input"),
        "winding": number(row, "peak_temperature_C"),
        "largest_multiplier": row["largest_multiplier"] or "-",
        "gap": number(row, "relative_gap"),
        "ms": 1e-3 * number(row, "solve_ms"),
        "binding": binding_names(row) if is_admitted(row) else f"{row['status']}: {row['reason']}",
    }
    return TableRow(place_cells(row), values, row["reason"] if refused else "")


COLUMNS = ("tap", "floor", "peak", "winding", "largest_multiplier", "gap", "ms", "binding")


def rows_table(rows: Sequence[Row], keys: Sequence[str], unit: str) -> list[str]:
    """The table of rows; `unit` is that of the commands."""
    varied = list(keys)
    places = ["target"] if rows and rows[0]["target"] else ["speed m/s", "grip N"]
    shown = EntryTable(places, COLUMNS, [shown_row(row) for row in rows], unit)
    cells = [[*(row[key] for key in keys), *own] for row, own in zip(rows, shown.cells, strict=True)]
    return table([*varied, *shown.heads], cells)


def legend(scene: Scene) -> str:
    """Explanation of the columns of the table of rows."""
    return EntryTable((), COLUMNS, ()).legend(scene.driven_by.name, named=bool(scene.targets))


def summary(rows: Sequence[Row]) -> str:
    """One line: numbers of outcomes, and the worst gap and violation of the certificates."""
    counts = Counter(row["status"] for row in rows)
    there = [row for row in rows if is_admitted(row)]
    others = ", ".join(f"{count} {name}" for name, count in sorted(counts.items()) if name not in ADMITTED)
    text = f"{len(there)} of {len(rows)} entries certified and replayed clean" + (f"; {others}" if others else "")
    if there:
        gap = max(number(row, "relative_gap") for row in there)
        violation = max(number(row, "violation") for row in there)
        times = [number(row, "solve_ms") for row in there]
        text += f"; worst gap {gap:.0e}, violation {violation:.0e}; solver {np.median(times):.0f} ms in the median"
    if any(row["status"] == Status.STATIONARY.name for row in rows):
        text += (
            "; no bound says that there is no better command than a stationary one, and with a nonlinear plant "
            "floor is of the plant as it is at rest"
        )
    return text


@dataclass(frozen=True)
class Point:
    """A point of a study: its varied values, and its entry with the largest tap error.

    Attributes
    ----------
    settings : the values in words.
    labels : key -> label of its value.
    worst : largest tap error of its entries; NaN if an entry has no certified optimum.
    place : name of that entry; if `worst` is NaN, the entry without optimum and the reason.
    """

    settings: str
    labels: Mapping[str, str]
    worst: float
    place: str


def points_of(plan: Plan, rows: Sequence[Row]) -> list[Point]:
    """The points of a study in their order."""
    of: dict[int, list[Row]] = {}
    for row in rows:
        of.setdefault(int(row["point"]), []).append(row)
    found = []
    for number_of, own in sorted(of.items()):
        labels = plan.labels(number_of)
        settings = ", ".join(f"{key} = {value} {unit_of(key)}".strip() for key, value in labels.items())
        failed = next((row for row in own if not is_admitted(row)), None)
        worst = max(own, key=lambda row: number(row, "tap_error")) if failed is None else failed
        place = (
            entry_name(worst) if failed is None else f"{entry_name(failed)}: {failed['reason'] or failed['status']}"
        )
        found.append(Point(settings, labels, number(worst, "tap_error") if failed is None else np.nan, place))
    return found


def study_answer(plan: Plan, rows: Sequence[Row]) -> list[str]:
    """The finding of a study in a few sentences: worst and best values, and where no further gain begins."""
    points = points_of(plan, rows)
    known = [point for point in points if not np.isnan(point.worst)]
    lines = []
    if known:
        # Points that differ by rounding only count as equal; the first one represents them.
        least = min(point.worst for point in known)
        best = next(point for point in known if point.worst <= least + AT_FLOOR)
        worst = max(known, key=lambda point: point.worst)
        whose = f"The {'target' if plan.scene.targets else 'tap'} farthest off, {worst.place},"
        if worst.worst - best.worst <= AT_FLOOR:
            where = (
                "whatever is varied" if len(known) == len(points) else "wherever each entry has a certified optimum"
            )
            lines.append(f"{whose} has an error of {percent(worst.worst)} % {where}.")
        else:
            after = known[known.index(best) + 1 :]
            ordered = len(plan.axes) == 1 and plan.axes[0].numeric and plan.sample is None
            beyond = ""
            if ordered and after:
                flat = all(point.worst <= best.worst + AT_FLOOR for point in after)
                beyond = ", beyond which nothing is gained" if flat else ", beyond which it rises again"
            lines.append(
                f"{whose} has an error of {percent(worst.worst)} % with {worst.settings}; at best no entry has more "
                f"than {percent(best.worst)} %, with {best.settings}{beyond}."
            )
    without = [point for point in points if np.isnan(point.worst)]
    if without:
        lines.append(
            f"{len(without)} of {len(points)} points have an entry without a certified optimum: with "
            f"{without[0].settings}, {without[0].place}."
        )
    return lines


def study_table(plan: Plan, rows: Sequence[Row]) -> Table | None:
    """The largest tap error at each value of one or two keys; None for samples, more keys or many values."""
    if plan.sample is not None or not 1 <= len(plan.axes) <= 2 or max(plan.shape) > MOST_VALUES:
        return None
    heads = [axis.key for axis in plan.axes]  # a key's name includes its unit
    points, title = points_of(plan, rows), "largest tap error of a point, %"
    if len(plan.axes) == 1:
        shown = Table.of(title, [*heads, "tap %", "at"], words=("at",))
        for point in points:
            shown.add_row(*point.labels.values(), percent(point.worst), point.place)
        return shown
    across = plan.axes[1].labels
    shown = Table.of(title, [heads[0], *(f"{heads[1]} = {value}" for value in across)])
    for first, value in enumerate(plan.axes[0].labels):
        shown.add_row(value, *(percent(point.worst) for point in points[first * len(across) :][: len(across)]))
    return shown


def refusal_lines(rows: Sequence[Row]) -> list[str]:
    """Every reason for a refusal once, with its count."""
    reasons = Counter(f"{row['status']}: {row['reason']}" for row in rows if not is_admitted(row))
    if not reasons:
        return []
    lines = ["## Not certified", "", *(f"- {count} x {reason}" for reason, count in reasons.most_common(20))]
    more = len(reasons) - 20
    return [*lines, *([f"- and {more} more reasons"] if more > 0 else []), ""]


def spread_lines(plan: Plan, rows: Sequence[Row]) -> list[str]:
    """Per entry the least, median and largest tap error over all points, and the values of the least."""
    lines = []
    axes = plan.entry_axes
    for iv in range(len(plan.speeds_m_s)):
        for ig in range(len(plan.grips_N)):
            place = axes.cells(iv, ig)
            own = [row for row in rows if place_cells(row) == place and is_admitted(row)]
            if not own:
                lines.append([*place, "0", "-", "-", "-", "-"])
                continue
            errors = [number(row, "tap_error") for row in own]
            best = next(row for row in own if number(row, "tap_error") <= min(errors) + AT_FLOOR)
            at = ", ".join(f"{axis.key} = {best[axis.key]}" for axis in plan.axes)
            if max(errors) - min(errors) <= AT_FLOOR:
                at = "any"
            cells = [percent(value) for value in (min(errors), float(np.median(errors)), max(errors))]
            lines.append([*place, str(len(own)), *cells, at])
    head = [*axes.columns, "certified", "least tap error %", "median %", "largest %", "least at"]
    return table(head, lines)


def study_markdown(plan: Plan, rows: Sequence[Row], figure: str, head: Sequence[str]) -> str:
    """report.md of a study. `head` : command, machine and versions."""
    keys = [axis.key for axis in plan.axes]
    how = "all combinations" if plan.sample is None else f"Latin hypercube of {plan.sample}, seed {plan.seed}"
    lines = [f"# {plan.scene.name}: {', '.join(keys) or 'as it is'}", "", *head]
    lines += [f"{plan.points} points ({how}), {plan.entries_per_point} entries each. {summary(rows)}.", ""]
    for axis in plan.axes:
        ends = axis.labels if len(axis.labels) <= 12 else (*axis.labels[:3], "...", *axis.labels[-3:])
        lines.append(f"- `{axis.key}` {unit_of(axis.key)}: {', '.join(ends)}")
    lines += [
        "",
        *study_answer(plan, rows),
        "",
        f"![tap error]({figure})",
        "",
        "## Entries over all points",
        "",
        *spread_lines(plan, rows),
    ]
    lines += refusal_lines(rows)
    lines += ["## Rows", ""]
    if len(rows) > MOST_ROWS:
        lines += [f"The first {MOST_ROWS} of {len(rows)}; all are in rows.csv.", ""]
    lines += [*rows_table(rows[:MOST_ROWS], keys, plan.scene.driven_by.unit), legend(plan.scene), ""]
    prices = [f"- row {row['index']}: {row['price']}" for row in rows[:MOST_ROWS] if row["price"]]
    return "\n".join([*lines, *(["## Prices", "", *prices, ""] if prices else [])])


def answer_markdown(scene: Scene, found: Answer, head: Sequence[str]) -> str:
    """report.md of the inverse question."""
    question = found.question
    key, unit = question.key.path, unit_of(question.key.path)
    lines = [f"# {scene.name}: {'greatest' if question.greatest else 'least'} {key}", "", *head, *found.sentences, ""]
    cells = []
    for tried in found.tried:
        row = found.worst(tried)
        outcome = "met" if tried.met else "missed"
        figures = [f"{each.scale * number(row, each.measure):.6g}" for each in question.requirements]
        cells.append(
            [
                label(tried.value),
                outcome,
                entry_name(row),
                *figures,
                row["status"],
                f"{number(row, 'relative_gap'):.0e}",
            ]
        )
    measures = [f"{each.measure} {each.unit}".rstrip() for each in question.requirements]
    lines += ["![answer](answer.png)", "", "## Every value tried, with the entry that decides", ""]
    lines += table([f"{key} {unit}".strip(), "", "entry", *measures, "status", "gap"], cells)
    for name, side in (("where it is met", found.met), ("where it is missed", found.missed)):
        if side is not None:
            rows = rows_table(side.rows, [key], scene.driven_by.unit)
            lines += [f"## Evidence {name}: {key} = {label(side.value)}", "", *rows]
    return "\n".join([*lines, legend(scene), ""])
