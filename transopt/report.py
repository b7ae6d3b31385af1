"""What a build says about itself: table, Markdown, JSON."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.table import Table

from transopt.build import Build
from transopt.design import Entry
from transopt.library import Library
from transopt.problem import OBJECTIVE_SCALE, Status, verdict
from transopt.reference import Reference
from transopt.refine import Refinement
from transopt.signals import STANDARD_GRAVITY_M_S2
from transopt.verify import EntryCheck


def _percent(value: float) -> str:
    """Percent with two decimals below ten, one above; a dash for what is not known."""
    if np.isnan(value):
        return "-"
    return f"{100 * value:.2f}" if value < 0.09995 else f"{100 * value:.1f}"


WIDE_TERMINAL = 120  # columns; below, a table shows only what decides
ESSENTIAL = (0, 1, 2, 3, 7, 9, 10)  # columns of the entry table that a narrow terminal keeps
LEGEND = (
    "NRMSE: |a - r| / |r| after replay, r the motor's share of the recorded tap. floor: the same problem without its "
    "limits. seed: clipped frequency-domain inversion. clipped: the unlimited optimum, its current clipped (both "
    "keep current and command limits only). repeats: NRMSE of the recordings to their mean. 20 %: a just noticeable "
    "difference of amplitude."
)


def _entry_cells(entry: Entry) -> list[str]:
    b = entry.baselines
    if entry.status is not Status.OPTIMAL:
        return [f"{entry.speed_m_s:g}", f"{entry.grip_N:g}", *["-"] * 7, refusal(entry), entry.verdict]
    return [
        f"{entry.speed_m_s:g}",
        f"{entry.grip_N:g}",
        _percent(entry.nrmse),
        _percent(entry.floor),
        f"{_percent(b.seed)} / {_percent(b.seed_steady)}",
        f"{_percent(b.clipped)} / {_percent(b.clipped_steady)}",
        _percent(entry.repeatability),
        f"{entry.played.peak_current_A:.3f}",
        f"{entry.solution.solve_time_s * 1e3:.0f}",
        entry.binding,
        entry.verdict,
    ]


def refusal(entry: Entry) -> str:
    """Why an entry is refused, and the remedy, once each."""
    return ": ".join(dict.fromkeys(["; ".join(entry.shortfalls), entry.status.value]))


def _columns(build: Build) -> list[str]:
    limit, steady = build.scene.limits.transient_current_A, build.scene.limits.steady_current_A
    return [
        "speed m/s",
        "grip N",
        "NRMSE %",
        "floor %",
        f"seed % at {limit:g} / {steady:g} A",
        f"clipped % at {limit:g} / {steady:g} A",
        "repeats %",
        "peak A",
        "ms",
        "what binds",
        "verdict",
    ]


def build_table(build: Build, width: int) -> Table:
    """The table that `transopt solve` prints into `width` columns."""
    shown = range(11) if width >= WIDE_TERMINAL else ESSENTIAL
    table = Table(title=f"{build.scene.name}: {build.scene.description}", show_lines=False)
    for j in shown:
        # Only what binds may be long; a verdict stays in one piece.
        table.add_column(_columns(build)[j], justify="right" if j < 9 else "left", no_wrap=j == 10)
    for row in build.entries:
        for entry in row:
            cells = _entry_cells(entry)
            table.add_row(*(cells[j] for j in shown), style="red" if entry.status is not Status.OPTIMAL else None)
        table.add_section()
    return table


def summary(build: Build) -> str:
    """One line: error, certificate, time per entry, time in all."""
    entries = list(build.all_entries())
    times_ms = [entry.solution.solve_time_s * 1e3 for entry in entries]
    if build.refused:
        return f"{len(build.refused)} of {len(entries)} entries refused; no library written, an earlier one is kept"
    worst = max(entries, key=lambda entry: entry.nrmse)
    return (
        f"{len(entries)} entries certified and replayed: NRMSE {100 * min(e.nrmse for e in entries):.2f} to "
        f"{100 * worst.nrmse:.2f} % (worst at {worst.speed_m_s:g} m/s, {worst.grip_N:g} N), "
        f"gap <= {max(e.certificate.relative_gap for e in entries):.0e}, "
        f"violation <= {max(e.certificate.primal_violation_A for e in entries):.0e} A; "
        f"{np.median(times_ms):.0f} ms per entry (median), {build.elapsed_s:.2f} s in all"
    )


def refinement_summary(refinement: Refinement) -> str:
    """One line: what the blend between the nodes loses against the optimum, before and after; or what is missing."""
    if refinement.entries == 1:
        return "grid: one speed and one grip, nothing lies between the nodes"
    if refinement.shortfall:
        return refinement.shortfall
    before = max(refinement.points, key=lambda p: p.excess_before)
    after = max(refinement.points, key=lambda p: p.excess_after)
    return (
        f"between the nodes: {100 * after.excess_after:.2f} % above the optimum at the worst of "
        f"{len(refinement.points)} points, tolerance {100 * refinement.tolerance:g} % (grid of the scene: "
        f"{100 * before.excess_before:.2f} %); {refinement.recorded_entries} -> {refinement.entries} entries in "
        f"{refinement.rounds} round{'' if refinement.rounds == 1 else 's'}, {refinement.elapsed_s:.1f} s"
    )


def _between_lines(refinement: Refinement) -> list[str]:
    lines = ["## Between the nodes", "", refinement_summary(refinement), ""]
    if refinement.entries == 1:
        return lines
    lines += [
        "| grid | speeds | grips | entries | worst excess % | at m/s, N | NRMSE / optimum % | median excess % |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, grid, excess, blended in (
        ("of the scene", refinement.recorded, "excess_before", "before"),
        ("refined", refinement.grid, "excess_after", "after"),
    ):
        points = refinement.off(grid)
        worst = max(points, key=lambda p: float(getattr(p, excess)))
        speeds, grips = len(grid.speeds_m_s), len(grid.grips_N)
        lines.append(
            f"| {name} | {speeds} | {grips} | {speeds * grips} | {100 * getattr(worst, excess):.2f} | "
            f"{worst.speed_m_s:.4g}, {worst.grip_N:.4g} | {_percent(getattr(worst, blended))} / "
            f"{_percent(worst.optimum)} | {100 * np.median([getattr(p, excess) for p in points]):.2f} |"
        )
    return [
        *lines,
        "",
        "excess: NRMSE of the bilinear blend of the node commands, replayed, less that of the optimum solved exactly "
        f"there; at {len(refinement.points)} points: nodes and midpoints of the refined grid, quarter points where "
        "it errs most. `grid_error.png` shows it.",
    ]


def _recorded_lines(references: Sequence[Reference]) -> list[str]:
    derived = [f"{r.speed_m_s:g}" for r in references if r.between_m_s is not None]
    references = [r for r in references if r.between_m_s is None]
    lines = [
        "| speed m/s | taps | scaled by | repeats %, aligned / not | user's share % | peak g | speed from |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in references:
        factors = f"{r.scalings.min():.3g}" + (f" to {r.scalings.max():.3g}" if r.scalings.size > 1 else "")
        sources = ", ".join(sorted({tap.speed_source for tap in r.taps}))
        lines.append(
            f"| {r.speed_m_s:g} | {len(r.taps)} | {factors} | {_percent(r.repeatability)} / "
            f"{_percent(r.repeatability_unaligned)} | {_percent(r.user_share)} | "
            f"{r.raw_m_s2.max() / STANDARD_GRAVITY_M_S2:.2f} | {sources} |"
        )
    notes = {f"{tap.recording.name}: {note}" for r in references for tap in r.taps for note in tap.notes}
    shown = sorted(notes)
    more = [f"- and {len(shown) - 10} more"] if shown[10:] else []
    if derived:
        rule = "r = v ((1 - w) r_1 / v_1 + w r_2 / v_2), w = (v - v_1) / (v_2 - v_1)"
        more.append(f"- not recorded but derived from the two neighbours: {', '.join(derived)} m/s, by {rule}")
    return [*lines, "", *(f"- {note}" for note in shown[:10]), *more]


def _origin(build: Build) -> str:
    simulated = build.scene.recordings.simulated
    if simulated is not None:
        return (
            f"The recordings are **simulated**: the undriven device at {simulated.grip_N:g} N strikes the object of "
            f"the scene, {simulated.repeats} repeats per speed, accelerometer noise "
            f"{simulated.noise_g_rtHz * 1e6:g} ug/sqrt(Hz), range +-{simulated.range_g:g} g."
        )
    settings = build.scene.recordings
    scaling = ""
    if settings.time_scale != 1 or settings.amplitude_scale != 1:
        scaling = f" Similarity-scaled: time x {settings.time_scale:g}, amplitude {settings.amplitude_scale}."
    return f"The recordings are files{': ' + settings.source if settings.source else ''}.{scaling}"


def _left_out_lines(entries: Sequence[Entry]) -> list[str]:
    """Each reason once; what differs from entry to entry behind its colon stands in report.json."""
    holders: dict[tuple[str, str], int] = {}
    for entry in entries:
        for part, reason in entry.left_out.items():
            shared = reason.split(":")[0]
            holders[part, shared] = holders.get((part, shared), 0) + 1
    return [
        f"- {part}: {reason}" + ("" if count == len(entries) else f" ({count} of {len(entries)} entries)")
        for (part, reason), count in holders.items()
    ]


def build_markdown(build: Build) -> str:
    """report.md."""
    entries = list(build.all_entries())
    columns = _columns(build)
    lines = [f"# {build.scene.name}", "", build.scene.description, "", _origin(build), "", summary(build), ""]
    lines += ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    lines += ["| " + " | ".join(_entry_cells(entry)) + " |" for entry in entries]
    lines += [
        "",
        LEGEND,
        "",
        "## Certificates",
        "",
        "| speed m/s | grip N | J | gap / max(J, 1e-3) | violation A | to r_raw % | winding C | after g | solver |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    shares = {r.speed_m_s: 1 / _raw_over_motor(r) for r in build.references}
    for e in entries:
        c = e.certificate
        lines.append(
            f"| {e.speed_m_s:g} | {e.grip_N:g} | {c.objective:.6e} | {c.relative_gap:.1e} | "
            f"{c.primal_violation_A:.1e} | {_percent(e.nrmse * shares[e.speed_m_s])} | {e.played.winding_C:.3f} | "
            f"{e.played.after_peak_m_s2 / STANDARD_GRAVITY_M_S2:.2f} | {e.solution.solver} |"
        )
    lines += [
        "",
        "after: peak acceleration in the 20 ms after the waveform, which no term of the problem holds down.",
    ]
    if build.refinement is not None:
        lines += ["", *_between_lines(build.refinement)]
    lines += ["", "## Left out", "", *_left_out_lines(entries)]
    lines += ["", "## Recordings", "", *_recorded_lines(build.references), ""]
    return "\n".join(lines)


def _raw_over_motor(reference: Reference) -> float:
    motor = float(np.linalg.norm(reference.motor_m_s2))
    return float(np.linalg.norm(reference.raw_m_s2)) / motor if motor > 0 else float("inf")


def build_json(build: Build) -> str:
    """report.json: the report's numbers, with units in their names; NaN becomes null."""
    shares = {r.speed_m_s: 1 / _raw_over_motor(r) for r in build.references}
    rows = [
        {
            "speed_m_s": e.speed_m_s,
            "grip_N": e.grip_N,
            "status": e.status.value,
            "shortfalls": e.shortfalls,
            "verdict": e.verdict,
            "nrmse": e.nrmse,
            "nrmse_to_raw": e.nrmse * shares[e.speed_m_s],
            "floor": e.floor,
            "baselines": asdict(e.baselines),
            "repeatability": e.repeatability,
            "peak_current_A": e.played.peak_current_A,
            "free_peak_current_A": e.free_peak_A,
            "after_peak_m_s2": e.played.after_peak_m_s2,
            "winding_C": e.played.winding_C,
            "housing_C": e.played.housing_C,
            "binding": e.binding,
            "certificate": {**asdict(e.certificate), "relative_gap": e.certificate.relative_gap},
            "replay_step_error": e.played.step_error,
            "solver": e.solution.solver,
            "solver_message": e.solution.message,
            "solve_time_s": e.solution.solve_time_s,
            "left_out": e.left_out,
        }
        for e in build.all_entries()
    ]
    content = {
        "scene": build.scene.name,
        "simulated_recordings": build.scene.recordings.simulated is not None,
        "solver": build.solver,
        "elapsed_s": build.elapsed_s,
        "entries": rows,
        "refinement": None if build.refinement is None else _refinement_rows(build.refinement),
        "references": [
            {
                "speed_m_s": r.speed_m_s,
                "between_m_s": r.between_m_s,
                "taps": [tap.recording.name for tap in r.taps],
                "scaling": r.scalings.tolist(),
                "repeatability": r.repeatability,
                "repeatability_unaligned": r.repeatability_unaligned,
                "user_share": r.user_share,
            }
            for r in build.references
        ],
    }
    return json.dumps(without_nan(content), indent=1)


def _refinement_rows(refinement: Refinement) -> dict[str, Any]:
    return {
        "tolerance": refinement.tolerance,
        "shortfall": refinement.shortfall,
        "rounds": refinement.rounds,
        "elapsed_s": refinement.elapsed_s,
        "scene_grid": refinement.recorded.model_dump(),
        "points": [asdict(point) for point in refinement.points],
    }


def without_nan(value: Any) -> Any:
    """The same with null for every number that JSON cannot hold."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def library_table(library: Library, name: str) -> Table:
    """The table that `transopt show` prints, from the file alone."""
    limits = library.meta["limits"]
    at = f"at {limits['current_A']:g} / {limits['steady_current_A']:g} A"
    columns = ["speed m/s", "grip N", "NRMSE %", "floor %", f"seed % {at}", f"clipped % {at}", "peak A", "winding C"]
    table = Table(title=name)
    for column in (*columns, "gap", "ms"):
        table.add_column(column, justify="right", overflow="fold")
    for column in ("what binds", "verdict"):
        table.add_column(column, overflow="fold")
    for iv, speed in enumerate(library.speeds_m_s):
        spread = library.meta["repeatability"][iv]
        for ig, grip in enumerate(library.grips_N):
            gap = library.duality_gap[iv, ig] / max(library.objective[iv, ig], OBJECTIVE_SCALE)
            nrmse, floor = library.nrmse[iv, ig], library.floor[iv, ig]
            table.add_row(
                f"{speed:g}",
                f"{grip:g}",
                _percent(nrmse),
                _percent(floor),
                " / ".join(_percent(error) for error in library.nrmse_seed[iv, ig]),
                " / ".join(_percent(error) for error in library.nrmse_clipped[iv, ig]),
                f"{library.peak_current_A[iv, ig]:.3f}",
                f"{library.peak_temperature_C[iv, ig]:.2f}",
                f"{gap:.0e}",
                f"{library.solve_time_s[iv, ig] * 1e3:.0f}",
                str(library.binding[iv, ig]),
                verdict(nrmse, floor, float("nan") if spread is None else spread),
            )
        table.add_section()
    return table


def verify_table(checks: Sequence[EntryCheck], name: str) -> Table:
    """The table that `transopt verify` prints."""
    table = Table(title=name)
    for column in ("speed m/s", "grip N", "NRMSE %", "peak A", "violation A", "gap", "result"):
        table.add_column(column, justify="left" if column == "result" else "right", overflow="fold")
    for check in checks:
        table.add_row(
            f"{check.speed_m_s:g}",
            f"{check.grip_N:g}",
            _percent(check.played.nrmse),
            f"{check.played.peak_current_A:.4f}",
            f"{check.certificate.primal_violation_A:.0e}",
            f"{check.certificate.relative_gap:.0e}",
            "; ".join(check.shortfalls) or "certified, replayed clean",
            style="red" if check.shortfalls else None,
        )
    return table
