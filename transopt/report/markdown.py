"""The text of report.md: what a person reads of a build."""

from collections.abc import Sequence

import numpy as np

from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.writing import percent, table
from transopt.design.build import Build
from transopt.design.entry import Entry
from transopt.design.refine_grid import Refinement
from transopt.library.columns import COLUMNS, FIGURES, FULL, RIVALS
from transopt.library.trade import trade_figures
from transopt.problem.limits.limit import Limit
from transopt.report import tables
from transopt.report.identified import identified_lines
from transopt.report.trade import TRADE_COLUMNS, TRADE_LEGEND, trade_cells
from transopt.report.trade_off import attained_lines, trade_off_lines
from transopt.solvers.options import FALLBACK, default_solver

CERTIFICATE_LEGEND = (
    "gap: to the optimum by the multipliers, rigorous unless the coil binds. over bound: how far J is above a lower "
    "bound, of max(J, 1e-3), rigorous always (with a wall, for the ticks at which it pushes): J less its gap or, "
    "where the coil binds, the least J of a convex problem that every admissible command meets. violation: the "
    "largest, in A, V or K. winding: the hottest of the replay{}. states, variables, rows: of the "
    "program that was solved, per stage, in all, and of its constraints; dashes where one linear solve was enough."
)


def _between_lines(refinement: Refinement) -> list[str]:
    """The section on the loss of the blend between the nodes."""
    lines = ["## Between the nodes", "", tables.refinement_summary(refinement), ""]
    if refinement.is_one_point:
        return lines
    head = ["grid", "speeds", "grips", "entries", "worst excess %", "at m/s, N", "tap error / optimum %"]
    rows = list[list[object]]()
    for name, grid, excess, blended in (
        ("of the scene", refinement.recorded, "excess_before", "before"),
        ("refined", refinement.grid, "excess_after", "after"),
    ):
        points = refinement.off(grid)
        worst = max(points, key=lambda p: float(getattr(p, excess)))
        speeds, grips = len(grid.speeds_m_s), len(grid.grips_N)
        rows.append(
            [
                name,
                speeds,
                grips,
                speeds * grips,
                f"{100 * getattr(worst, excess):.2f}",
                f"{worst.speed_m_s:.4g}, {worst.grip_N:.4g}",
                f"{percent(getattr(worst, blended))} / {percent(worst.optimum)}",
                f"{100 * np.median([getattr(p, excess) for p in points]):.2f}",
                f"{min(getattr(p, f'{blended}_dB') for p in points):+.2f}",
            ]
        )
    return [
        *lines,
        *table([*head, "median excess %", "weakest dB"], rows),
        "excess: tap error of the bilinear blend of the node commands, replayed, less that of the optimum solved "
        "exactly there, or the share of amplitude that the blend lacks beside that optimum, or of a limit "
        "by which it leaves it, whichever is largest; "
        "weakest: its energy over that optimum's, where it is least. "
        f"At {len(refinement.points)} points: nodes and midpoints of the refined grid, quarter points where it errs "
        "most. `grid_error.png` shows it, where figures are drawn.",
    ]


def _recorded_lines(build: Build) -> list[str]:
    """The table of references with notes on their taps, or the named targets."""
    references, axes = build.references, build.scene.axes
    if axes.targets:
        rows = [
            [r.name, f"{1e3 * r.ends_s:.4g}", f"{r.peak_m_s2 / STANDARD_GRAVITY_M_S2:.3g}", r.sha256[:12] or "-"]
            for r in references
        ]
        return table(["target", "lasts ms", "peak g", "SHA-256 of its file"], rows)
    heads = [
        "speed m/s",
        "grip N",
        "taps",
        "scaled by",
        "repeats %, aligned / not",
        "peak g",
        "a0 m/s2",
        "speed from",
    ]
    rows = [
        [
            f"{r.speed_m_s:g}",
            f"{r.grip_N:g}" if r.of_grips_N else f"any, taken as {r.grip_N:g}",
            f"{len(r.taps)}",
            f"{r.scalings.min():.3g}" + (f" to {r.scalings.max():.3g}" if r.scalings.size > 1 else ""),
            f"{percent(r.repeatability)} / {percent(r.repeatability_unaligned)}",
            f"{r.recorded_m_s2.max() / STANDARD_GRAVITY_M_S2:.2f}",
            f"{r.incoming_acceleration_m_s2:.2f}",
            ", ".join(sorted({tap.speed_source for tap in r.taps})),
        ]
        for r in references
    ]
    notes = {f"{tap.recording.name}: {note}" for r in references for tap in r.taps for note in tap.notes}
    doubts = {f"**{tap.recording.name}: {tap.implausible}**" for r in references for tap in r.taps if tap.implausible}
    shown = [*sorted(doubts), *sorted(notes)]
    more = [f"- and {len(shown) - 10} more"] if shown[10:] else []
    derived = [f"{v:g}" for v in axes.speeds_m_s if v not in references.speeds_m_s]
    if derived:
        rule = "r = v ((1 - w) r_1 / v_1 + w r_2 / v_2), w = (v - v_1) / (v_2 - v_1)"
        more.append(f"- not recorded but derived from the two neighbours: {', '.join(derived)} m/s, by {rule}")
    return [*table(heads, rows), "", *(f"- {note}" for note in [*build.recorded_remarks, *shown[:10]]), *more]


def _origin(build: Build) -> str:
    """Origin of the recordings in words."""
    if build.scene.targets:
        return f"What it shall make is stated by name: {build.scene.axes.in_words}."
    simulated = build.scene.recordings.simulated
    if simulated is not None:
        whose = "" if build.scene.striker is None else " (the scene's own device, not that of the model file)"
        grip = "each grip of the scene" if simulated.grip_N is None else f"{simulated.grip_N:g} N"
        striking = f"the undriven device{whose}"
        return (
            f"The recordings are **simulated**: {striking} at {grip} strikes the object of "
            f"the scene, {simulated.repeats} repeats per speed and grip, accelerometer noise "
            f"{simulated.noise_g_rtHz * 1e6:g} ug/sqrt(Hz), range +-{simulated.range_g:g} g."
        )
    settings = build.scene.recordings
    scaling = ""
    if settings.time_scale != 1 or settings.amplitude_scale != 1:
        scaling = f" Similarity-scaled: time x {settings.time_scale:g}, amplitude {settings.amplitude_scale}."
    return f"The recordings are files{': ' + settings.source if settings.source else ''}.{scaling}"


def _left_out_lines(entries: Sequence[Entry]) -> list[str]:
    """The reasons why parts of the problem were left out, each once; report.json has the numbers per entry."""
    holders: dict[tuple[str, str], int] = {}
    for entry in entries:
        for part, reason in entry.left_out.items():
            shared = reason.split(":")[0]
            holders[part, shared] = holders.get((part, shared), 0) + 1
    return [
        f"- {part}: {reason}" + ("" if count == len(entries) else f" ({count} of {len(entries)} entries)")
        for (part, reason), count in holders.items()
    ]


def _size_cells(entry: Entry) -> list[str]:
    """States, variables and rows of the program that was solved for an entry; dashes if there was none."""
    if entry.size is None:
        return ["-", "-", "-"]
    return [str(entry.size.states), str(entry.size.variables), str(entry.size.rows)]


def _kept_back_lines(entries: Sequence[Entry]) -> list[str]:
    """The margins that the problems keep from their limits; empty if there are none."""
    widest: dict[str, Limit] = {}
    for limit in (limit for entry in entries for limit in entry.problem.limits if limit.kept_back > 0):
        known = widest.get(limit.name)
        if known is None or limit.kept_back > known.kept_back:
            widest[limit.name] = limit
    if not widest:
        return []
    margins = ", ".join(f"{each.label} {each.kept_back:.2g} {each.step_unit}" for each in widest.values())
    return ["", f"Of these limits the problem keeps so much back, for what happens between its instants: {margins}."]


def priced_entries(build: Build, *, full: bool) -> list[Entry]:
    """Entries whose prices are reported: all, or the one farthest above its floor."""
    return build.proven if full else sorted(build.proven, key=lambda each: each.floor - each.figures.tap_error)[:1]


def _price_lines(build: Build, *, full: bool) -> list[str]:
    """The section on binding limits and the gain from wider ones."""
    priced = [(entry, price) for entry in priced_entries(build, full=full) for price in entry.prices]
    if not priced:
        return []
    other = ""
    if any(len(entry.problem.terms) > 1 or entry.problem.spread for entry, _ in priced):
        other = (
            " What a wider limit lowers is the error that the design minimises; the tap error need not fall with it."
        )
    head = ["limit", "tap %", "raised by", "tap % then", "would not bind from", "tap % there"]
    rows = [
        [
            *entry.cells,
            price.stated,
            percent(price.tap_error),
            price.more,
            _solved_percent(price.then, price.then),
            price.free_from,
            _solved_percent(price.there, price.enough),
        ]
        for entry, price in priced
    ]
    return [
        "",
        "## What binds, and what more would buy",
        "",
        *table([*build.scene.axes.columns, *head], rows),
        "Each figure is of an optimum that was solved and certified, with that limit alone wider and the others as "
        "they are; none is extrapolated. would not bind from: the least limit, to the digits printed, at which it "
        "does not bind any more."
        + other
        + ("" if full else " It is the entry farthest above its floor; `solve --full` has all."),
    ]


def _solved_percent(error: float, of: float) -> str:
    """A tap error that was solved for, or "not certified"."""
    return "not certified" if np.isnan(of) else percent(error)


def _trade_lines(build: Build) -> list[str]:
    """The section on the haptics trade's figures; empty for taps, and if there is no library."""
    library = build.library
    if library is None or not build.scene.targets:
        return []
    rows = [
        [*entry.cells, percent(entry.figures.tap_error), *trade_cells(trade_figures(library, iv, ig))]
        for iv, row in enumerate(build.entries)
        for ig, entry in enumerate(row)
    ]
    head = [*build.scene.axes.columns, "tap %", *TRADE_COLUMNS]
    return ["", "## The figures of the trade", "", *table(head, rows), TRADE_LEGEND]


def _spread_lines(build: Build) -> list[str]:
    """The section on the error over the spread of devices; empty if the scene is not robust."""
    spreads = [(entry, entry.spread) for entry in build.all_entries() if entry.spread is not None]
    if not spreads:
        return []
    head = ["made for the node: there / rms / worst %", "for the spread: there / rms / worst %"]
    rows = [
        [
            *e.cells,
            f"{percent(s.nominal)} / {percent(s.nominal_rms)} / {percent(s.nominal_worst)}",
            f"{percent(s.robust)} / {percent(s.robust_rms)} / {percent(s.robust_worst)}",
        ]
        for e, s in spreads
    ]
    lines = ["", "## Robust against the spread", "", *table([*build.scene.axes.columns, *head], rows)]
    if build.scene.posing().worst:
        minimised = "Worst: the largest over the spread, which is what the design minimises"
        gains = [100 * (1 - s.robust_worst / s.nominal_worst) for _, s in spreads]
    else:
        minimised = "Rms: root of the mean square over the spread, which is what the design minimises"
        gains = [100 * (1 - s.robust_rms / s.nominal_rms) for _, s in spreads]
    least, most = (round(gain, 1) + 0.0 for gain in (min(gains), max(gains)))  # no -0.0
    return [
        *lines,
        "Each error is the root of what a device loses in J: within the window and after it, weighed as the scene "
        f"weighs them, over |r|. {minimised}; it falls by {least:.1f} to {most:.1f} % of itself. What remains is the "
        "difference between the devices: one command gives each its own acceleration, and only their mean can be "
        "moved onto the reference.",
    ]


def _cool_lines(build: Build) -> list[str]:
    """The section on the cool commands, which cause less heat; empty if there are none."""
    library = build.library
    if library is None or library.cool is None:
        return []
    shown = library.cool.table((*FIGURES, "peak", "binding"))
    sentence = tables.cool_summary(library)
    return ["", "## Cool commands", "", *table(shown.heads, shown.cells), f"{sentence[0].upper()}{sentence[1:]}."]


def build_markdown(build: Build, *, full: bool = True) -> str:
    """The text of report.md.

    Parameters
    ----------
    full : whether to include the prices and the cost of intensity of all entries; else the prices of one entry.
    """
    entries = list(build.all_entries())
    lines = [f"# {build.scene.name}", ""]
    for paragraph in filter(None, (build.scene.description, _origin(build), tables.summary(build))):
        lines += [paragraph, ""]
    for warning in tables.warnings(build):
        lines += [f"**{warning[0].upper()}{warning[1:]}.**", ""]
    if default_solver() == FALLBACK:
        lines += [
            f"The project's own solver is not built here, or out of date (no C compiler?): {FALLBACK} takes over.",
            "",
        ]
    shown = build.table([name for name in COLUMNS if name in FULL or (full and name in RIVALS)])
    lines += [*table(shown.heads, shown.cells), tables.legend(shown, build.scene), ""]
    if build.refused:
        lines += ["## Refused", ""]
        lines += [f"- {each.place}: {tables.refusal(each)}" for each in build.refused]
        lines += [""]
    head = ["J", "gap / max(J, 1e-3)", "over bound", "violation", "winding C", "states", "variables"]
    head += ["rows", "solver"]
    rows = [
        [
            *e.cells,
            f"{e.certificate.objective:.6e}",
            f"{e.certificate.relative_gap:.1e}",
            f"{e.certificate.relative_bound:.1e}",
            f"{e.certificate.primal_violation:.1e}",
            "-" if np.isnan(e.played.winding_C) else f"{e.played.winding_C:.3f}",
            *_size_cells(e),
            e.solution.solver,
        ]
        for e in build.all_entries()
    ]
    lines += [
        "## Certificates",
        "",
        *table([*build.scene.axes.columns, *head], rows),
        CERTIFICATE_LEGEND.format(", in the steady state of tapping" if build.scene.thermal.tap_rate_Hz else ""),
        *_kept_back_lines(entries),
        *_price_lines(build, full=full),
        *(trade_off_lines(build) if full else []),
        *attained_lines(entries),
        *_spread_lines(build),
        *_cool_lines(build),
    ]
    lines += [*_trade_lines(build), *identified_lines(build)]
    if build.refinement is not None:
        lines += ["", *_between_lines(build.refinement)]
    lines += ["", "## Left out", "", *_left_out_lines(entries)]
    lines += [
        "",
        "## Targets" if build.scene.targets else "## Recordings",
        "",
        *_recorded_lines(build),
        "",
    ]
    return "\n".join(lines)
