"""Tables and lines that commands print."""

from collections.abc import Sequence

import numpy as np
from rich.table import Table
from rich.text import Text

from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.design.build import Build
from transopt.design.entry import Entry
from transopt.design.refine_grid import Refinement
from transopt.design.verify import EntryCheck
from transopt.library.library import Library
from transopt.problem.answer import OBJECTIVE_SCALE, Status, verdict
from transopt.problem.objective.bands import JUST_NOTICED_dB, levels


def percent(value: float) -> str:
    """Percent with two decimals below ten, one above; a dash for what is not known."""
    if np.isnan(value):
        return "-"
    return f"{100 * value:.2f}" if value < 0.09995 else f"{100 * value:.1f}"


FELT_g = 1.0  # peak acceleration after the waveform, from which on a user is warned of it
WIDE_TERMINAL = 120  # columns; below, a table shows only what decides
ESSENTIAL = (0, 1, 2, 3, 7, 9, 10)  # columns of the entry table that a narrow terminal keeps
LEGEND = (
    "NRMSE: |a - r| / |r| after replay, r the motor's share of the recorded tap. floor: the same problem without its "
    "limits. seed: clipped frequency-domain inversion. clipped: the unlimited optimum, its current clipped (both "
    "keep current and command limits only). repeats: NRMSE of the recordings to their mean. verdict: weak, "
    f"strong: energy as vibration is felt, around 275 Hz, beside that of r; {JUST_NOTICED_dB:g} dB are just noticed."
)


def entry_cells(entry: Entry) -> list[str]:
    """The cells of an entry under `columns_of`; dashes and the kind of refusal for one that is refused."""
    b = entry.baselines
    if entry.status is not Status.OPTIMAL:
        return [f"{entry.speed_m_s:g}", f"{entry.grip_N:g}", *["-"] * 7, entry.status.value, entry.verdict]
    return [
        f"{entry.speed_m_s:g}",
        f"{entry.grip_N:g}",
        percent(entry.nrmse),
        percent(entry.floor),
        f"{percent(b.seed)} / {percent(b.seed_steady)}",
        f"{percent(b.clipped)} / {percent(b.clipped_steady)}",
        percent(entry.repeatability),
        f"{entry.played.peak_current_A:.3f}",
        f"{entry.solution.solve_time_s * 1e3:.1f}",
        entry.binding,
        entry.verdict,
    ]


def refusal(entry: Entry) -> str:
    """Why an entry is refused, and what would do."""
    return ": ".join(filter(None, dict.fromkeys([entry.status.value, "; ".join(entry.shortfalls)])))


def columns_of(build: Build) -> list[str]:
    """Heads of the table of entries."""
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
        table.add_column(columns_of(build)[j], justify="right" if j < 9 else "left", no_wrap=j == 10)
    for row in build.entries:
        for entry in row:
            cells = entry_cells(entry)
            # `Text` is printed as it is; a string would be searched for markup, which takes longer.
            table.add_row(
                *(Text(cells[j]) for j in shown), style="red" if entry.status is not Status.OPTIMAL else None
            )
        table.add_section()
    return table


def summary(build: Build) -> str:
    """One line: error, certificate, time per entry, time in all."""
    entries = list(build.all_entries())
    admitted = [entry for entry in entries if entry.status is Status.OPTIMAL]
    said = []
    if build.refused:
        said.append(
            f"{len(build.refused)} of {len(entries)} entries refused; no library written, an earlier one is kept"
        )
    if admitted:
        worst = max(admitted, key=lambda entry: entry.nrmse)
        over = 100 * max(worst.nrmse - worst.floor, 0)
        said.append(
            f"{len(admitted)} of {len(entries)} entries certified and replayed: NRMSE "
            f"{100 * min(entry.nrmse for entry in admitted):.2f} to {100 * worst.nrmse:.2f} % (worst at "
            f"{worst.speed_m_s:g} m/s, {worst.grip_N:g} N: {over:.2f} points over its "
            f"floor), gap <= {max(entry.certificate.relative_gap for entry in admitted):.0e}, "
            f"violation <= {max(entry.certificate.primal_violation for entry in admitted):.0e} A, V or K"
        )
    times_ms = [entry.solution.solve_time_s * 1e3 for entry in entries]
    said.append(f"{np.median(times_ms):.1f} ms per entry (median), {build.elapsed_s:.2f} s in all")
    return "; ".join(said)


def aftermath(build: Build) -> str:
    """One line where the stylus rings on after a waveform so much that it is felt; empty if nowhere."""
    loudest = max(build.all_entries(), key=lambda entry: entry.played.after_peak_m_s2)
    after_g = loudest.played.after_peak_m_s2 / STANDARD_GRAVITY_M_S2
    if loudest.status is not Status.OPTIMAL or after_g < FELT_g:
        return ""
    return (
        f"after the waveform the stylus rings on with up to {after_g:.1f} g ({loudest.speed_m_s:g} m/s, "
        f"{loudest.grip_N:g} N), which no term of the problem holds down: more hand_over_samples calm it"
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
                percent(nrmse),
                percent(floor),
                " / ".join(percent(error) for error in library.nrmse_seed[iv, ig]),
                " / ".join(percent(error) for error in library.nrmse_clipped[iv, ig]),
                f"{library.peak_current_A[iv, ig]:.3f}",
                f"{library.peak_temperature_C[iv, ig]:.2f}",
                f"{gap:.0e}",
                f"{library.solve_time_s[iv, ig] * 1e3:.0f}",
                str(library.binding[iv, ig]),
                verdict(
                    nrmse,
                    floor,
                    float("nan") if spread is None else spread,
                    levels(library.acceleration_m_s2[iv, ig], library.reference_m_s2[iv], library.meta["dt_s"]),
                ),
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
            percent(check.played.nrmse),
            f"{check.played.peak_current_A:.4f}",
            f"{check.certificate.violation('A'):.0e}",
            f"{check.certificate.relative_gap:.0e}",
            "; ".join(check.shortfalls) or "certified, replayed clean",
            style="red" if check.shortfalls else None,
        )
    return table
