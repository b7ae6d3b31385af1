"""Tables and lines that commands print."""

from collections.abc import Sequence

import numpy as np
from rich.text import Text

from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray, median
from transopt.base.sizes import LONGEST_LEAD_S
from transopt.base.tables import Table
from transopt.base.writing import percent
from transopt.design.build import Build
from transopt.design.entry import Entry
from transopt.design.refine_grid import Refinement
from transopt.library.columns import COLUMNS, FULL, EntryTable, TableRow
from transopt.library.library import Library
from transopt.report.first import named_limits, stated_limit
from transopt.scene.plausible import implausible
from transopt.scene.scene import Scene
from transopt.scene.sections import covering_lead_s

FELT_g = 1.0  # peak error after the waveform from which on the user is warned
LOST = 1e-3  # share of a tap's energy before the first command acts, from which on the user is warned
MOST_REFUSED = 3  # refused entries that get a line each


def legend(shown: EntryTable, scene: Scene) -> str:
    """Explanation of the columns of a table of entries."""
    return shown.legend(scene.driven_by.name, named=bool(scene.targets))


def printed(
    shown: EntryTable,
    title: str,
    *,
    caption: str | None = None,
    striking: Sequence[str | None] = (),
    columns: int = 0,
) -> Table:
    """A table of entries for the terminal.

    Parameters
    ----------
    striking : a style or None for each row.
    columns : number of rows after which a line is drawn; 0 for no lines.
    """
    own = zip(shown.names, shown.heads[len(shown.places) :], strict=True)
    words = [head for name, head in own if not COLUMNS[name].is_number]
    table = Table.of(title, shown.heads, words=words, caption=caption, keys=len(shown.places))
    styles = striking or [None] * len(shown.rows)
    for number, (row, style) in enumerate(zip(shown.cells, styles, strict=True), start=1):
        # `Text` is printed unchanged; a string would be parsed for markup, which takes longer.
        table.add_row(*map(Text, row), style=style, end_section=columns > 0 and number % columns == 0)
    return table


def refusal(entry: Entry) -> str:
    """Why an entry is refused, and what would help."""
    return ": ".join(filter(None, dict.fromkeys([entry.status.value, "; ".join(entry.shortfalls)])))


def refused_lines(build: Build) -> list[str]:
    """Why entries are refused: the first few in a line each, then the number of others."""
    found = [f"refused: {entry.place}: {refusal(entry)}" for entry in build.refused]
    more = len(found) - MOST_REFUSED
    return [*found[:MOST_REFUSED], *([f"and {more} more, see refused.md"] if more > 0 else [])]


def entry_table(source: Build | Library, title: str) -> tuple[Table, str]:
    """Every entry with its figures, for a nonlinear plant also the linear design's; explanation of the columns."""
    scene = source.scene if isinstance(source, Build) else source.scene()
    linear = ("linear",) if scene.nonlinear else ()
    shown = source.table([name for name in COLUMNS if name in (*FULL, *linear)])
    caption = source.claim or None if isinstance(source, Library) else None
    striking = ["red" if row.refusal else None for row in shown.rows]
    table = printed(shown, title, caption=caption, striking=striking, columns=len(scene.axes.grips_N))
    return table, legend(shown, scene)


def certificate_table(source: Build | Library, title: str) -> Table:
    """What is proven of every entry: its largest violation of a limit and its largest distance from the optimum."""
    return printed(source.table(("violation", "gap", "ms", "binding")), title)


def summary(build: Build) -> str:
    """One line: error, certificate, time per entry, total time."""
    entries = list(build.all_entries())
    admitted = build.proven
    sentences = []
    if build.refused:
        sentences.append(
            f"{len(build.refused)} of {len(entries)} entries refused; no library written, an earlier one is kept"
        )
    if admitted:
        worst = max(admitted, key=lambda entry: entry.figures.tap_error)
        felt = [entry.figures.felt_error for entry in admitted if np.isfinite(entry.figures.felt_error)]
        heard = f"felt error {percent(min(felt))} to {percent(max(felt))} %, " if felt else ""
        sentences.append(
            f"{len(admitted)} of {len(entries)} entries certified and replayed: tap error "
            f"{percent(min(entry.figures.tap_error for entry in admitted))} to {percent(worst.figures.tap_error)} % "
            f"(worst at {worst.place}), {heard}"
            f"gap <= {max(entry.certificate.relative_gap for entry in admitted):.0e}, "
            f"violation <= {max(entry.certificate.primal_violation for entry in admitted):.0e} A, V or K"
        )
    times_ms = [entry.solution.solve_time_s * 1e3 for entry in entries]
    sentences.append(f"{median(np.array(times_ms)):.1f} ms per entry (median), {build.elapsed_s:.2f} s in all")
    return "; ".join(sentences)


def aftermath(build: Build) -> str:
    """One line if the error after a waveform is large enough to be felt; empty if it is nowhere.

    If the scene has no samples after the waveform, the error is the ringing of the stylus.
    """
    looked = build.scene.time_grid().after_stages > 0

    def after_m_s2(entry: Entry) -> float:
        return entry.figures.peak_after_m_s2 if looked else entry.played.after_peak_m_s2

    admitted = build.proven
    loudest = max(admitted, key=after_m_s2, default=None)
    if loudest is None or after_m_s2(loudest) < FELT_g * STANDARD_GRAVITY_M_S2:
        return ""
    after_g = after_m_s2(loudest) / STANDARD_GRAVITY_M_S2
    where = f"({loudest.place})"
    if looked:
        held = [*dict.fromkeys(map(stated_limit, loudest.held))]
        why = f": {named_limits(held)} bind{'' if len(held) > 1 else 's'}" if held else ""
        return f"after the waveform the error still reaches {after_g:.1f} g {where}{why}"
    return (
        f"after the waveform the stylus rings on with up to {after_g:.1f} g {where}, which no term of the problem "
        "holds down: weights.after_s is 0, by default it is 0.03"
    )


def lost_start(build: Build) -> str:
    """One line if too much of a tap precedes the first command's effect, with the lead that would help."""
    worst = max(build.references, key=lambda reference: reference.target.lost_share)
    share, scene = worst.target.lost_share, build.scene
    if share <= LOST:
        return ""
    lead_s = covering_lead_s(scene.time.dt_s, scene.delay_s)
    remedy = (
        f"time.lead_s = {lead_s:g} would do"
        if lead_s <= LONGEST_LEAD_S
        else f"no lead up to {LONGEST_LEAD_S * 1e3:g} ms covers that delay: take a faster amplifier"
    )
    return (
        f"{100 * share:.2g} % of the energy of {worst.in_words} is over before the first command can "
        f"act, and counts as error: the waveform starts {scene.lead_s * 1e3:g} ms before it, the amplifier "
        f"delays it by {scene.delay_s * 1e3:g} ms; {remedy}"
    )


def warnings(build: Build) -> list[str]:
    """Points of a build that deserve a second look, one line each."""
    odd = implausible(build.scene.model_dump(exclude_none=True))
    accepted = [f"accepted as it is: {sentence}" for sentence in odd]
    return [*accepted, *(sentence for sentence in (lost_start(build), aftermath(build)) if sentence)]


def cool_summary(library: Library) -> str:
    """One line on the cool commands, which cause less heat; empty if the library has none."""
    cool = library.cool
    if cool is None:
        return ""
    warm = library.heat_A2_s > 0
    if not warm.any():
        return "cool commands: nothing heats the coil"
    share = cool.heat_A2_s[warm] / library.heat_A2_s[warm]
    least, most = np.nanmin(cool.felt_dB), np.nanmax(cool.felt_dB)
    return (
        f"cool commands, for a warm coil: {_span(share)} % of the heat, tap error {_span(cool.tap_error)} %, "
        f"felt error {_span(cool.felt_error)} %, felt {least:.2f} to {most:.2f} dB"
    )


def _span(shares: FloatArray) -> str:
    """Smallest and largest of some shares in percent, or one number if they print alike; NaN is ignored."""
    known = shares[np.isfinite(shares)]
    if not known.size:
        return "-"
    ends = [f"{100 * end:.0f}" for end in (known.min(), known.max())]
    return " to ".join(dict.fromkeys(ends))


def refinement_summary(refinement: Refinement) -> str:
    """One line: excess of the blend between the nodes over the optimum before and after, or the shortfall."""
    if refinement.is_one_point:
        return "grid: one speed and one grip, nothing lies between the nodes"
    if refinement.shortfall:
        return refinement.shortfall
    before = max(refinement.points, key=lambda p: p.excess_before)
    after = max(refinement.points, key=lambda p: p.excess_after)
    left = max(p.after_beyond for p in refinement.points)
    beyond = f"; blends leave a limit by up to {100 * left:.2g} %" if left > 0 else ""
    return (
        f"between the nodes: {100 * after.excess_after:.2f} % above the optimum at the worst of "
        f"{len(refinement.points)} points, tolerance {100 * refinement.tolerance:g} % (grid of the scene: "
        f"{100 * before.excess_before:.2f} %); {refinement.recorded_entries} -> {refinement.entries} entries in "
        f"{refinement.rounds} round{'' if refinement.rounds == 1 else 's'}, {refinement.elapsed_s:.1f} s{beyond}"
    )


def verify_table(checked: Sequence[Entry], name: str) -> Table:
    """The table that `transopt verify` prints; entries that fall short show their figures as well."""
    names = ("tap", "peak", "violation", "gap", "result")
    unit = checked[0].unit
    rows = []
    for entry in checked:
        values = {column: entry.value(column) for column in ("tap", "peak", "gap")}
        values |= {"violation": entry.certificate.violation(unit)}
        values |= {"result": "; ".join(entry.shortfalls) or "certified, replayed clean"}
        rows.append(TableRow(entry.cells, values))
    shown = EntryTable(checked[0].columns, names, rows, unit)
    return printed(shown, name, striking=["red" if entry.shortfalls else None for entry in checked])
