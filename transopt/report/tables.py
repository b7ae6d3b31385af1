"""Tables and lines that commands print."""

from collections.abc import Sequence

import numpy as np
from rich.table import Table
from rich.text import Text

from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.sizes import LONGEST_LEAD_S
from transopt.design.build import Build
from transopt.design.entry import Entry
from transopt.design.refine_grid import Refinement
from transopt.design.verify import EntryCheck
from transopt.library.library import Library
from transopt.problem.answer import OBJECTIVE_SCALE, Status, verdict
from transopt.problem.objective.bands import JUST_NOTICED_dB, levels
from transopt.scene.scene import Scene
from transopt.scene.sections import covering_lead_s


def percent(value: float) -> str:
    """Percent with two decimals below ten, one above; a dash for what is not known."""
    if np.isnan(value):
        return "-"
    return f"{100 * value:.2f}" if value < 0.09995 else f"{100 * value:.1f}"


FELT_g = 1.0  # peak error after the waveform, from which on a user is warned of it
LOST = 1e-3  # share of a tap's energy before the first command can act, from which on a user is warned of it
WIDE_TERMINAL = 120  # columns; below, a table shows only what decides
ESSENTIAL = (0, 1, 7, 9, 10)  # columns behind those of the place that a narrow terminal keeps of the entry table
RIGHT = 9  # so many of them hold numbers
_LEGEND = (
    "NRMSE: |a - r| / |r| after replay, r {wanted}. floor: the same "
    "problem without its limits. after %: |a - r| when the waveform is over, relative to the same |r|; after g: the "
    "largest |a - r| there. seed: clipped frequency-domain inversion. clipped: the unlimited optimum, its {input} "
    "clipped (both keep {input} and command limits only). repeats: NRMSE of the recordings to their mean. "
    "verdict: weak, strong: energy as vibration is felt, around 275 Hz, beside that of r; "
    f"{JUST_NOTICED_dB:g} dB are just noticed."
)


def legend(scene: Scene) -> str:
    """What the columns of the table of entries mean."""
    wanted = "the target" if scene.targets else "the motor's share of the recorded tap from contact on"
    return _LEGEND.format(wanted=wanted, input=scene.driven_by.name)


def after_cells(nrmse_after: float, peak_after_m_s2: float, samples: int) -> list[str]:
    """Error and largest error [g] after the waveform; dashes where a scene does not look at what comes after it."""
    if samples == 0:
        return ["-", "-"]
    return [percent(nrmse_after), f"{peak_after_m_s2 / STANDARD_GRAVITY_M_S2:.3f}"]


def entry_cells(entry: Entry) -> list[str]:
    """The cells of an entry under `columns_of`; dashes and the kind of refusal for one that is refused."""
    b = entry.baselines
    if entry.status is not Status.OPTIMAL:
        return [*entry.cells, *["-"] * 9, entry.status.value, entry.verdict]
    return [
        *entry.cells,
        percent(entry.nrmse),
        percent(entry.floor),
        *after_cells(entry.played.nrmse_after, entry.played.error_peak_after_m_s2, entry.problem.grid.after_stages),
        f"{percent(b.seed)} / {percent(b.seed_steady)}",
        f"{percent(b.clipped)} / {percent(b.clipped_steady)}",
        percent(entry.repeatability),
        f"{entry.played.peak_input:.3f}",
        f"{entry.solution.solve_time_s * 1e3:.1f}",
        entry.binding,
        entry.verdict,
    ]


def refusal(entry: Entry) -> str:
    """Why an entry is refused, and what would do."""
    return ": ".join(filter(None, dict.fromkeys([entry.status.value, "; ".join(entry.shortfalls)])))


def columns_of(build: Build) -> list[str]:
    """Heads of the table of entries."""
    limit, steady = build.scene.limits.transient_input, build.scene.limits.steady_input
    unit = build.scene.driven_by.unit
    return [
        *build.scene.axes.columns,
        "NRMSE %",
        "floor %",
        "after %",
        "after g",
        f"seed % at {limit:g} / {steady:g} {unit}",
        f"clipped % at {limit:g} / {steady:g} {unit}",
        "repeats %",
        f"peak {unit}",
        "ms",
        "what binds",
        "verdict",
    ]


def build_table(build: Build, width: int) -> Table:
    """The table that `transopt solve` prints into `width` columns."""
    columns = columns_of(build)
    places = len(build.scene.axes.columns)
    shown = range(len(columns)) if width >= WIDE_TERMINAL else [*range(places), *(places + j for j in ESSENTIAL)]
    table = Table(title=": ".join(filter(None, (build.scene.name, build.scene.description))), show_lines=False)
    for j in shown:
        # Only what binds may be long; a verdict stays in one piece.
        table.add_column(
            columns[j], justify="right" if places <= j < places + RIGHT else "left", no_wrap=j == len(columns) - 1
        )
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
            f"{worst.place}: {over:.2f} points over its "
            f"floor), gap <= {max(entry.certificate.relative_gap for entry in admitted):.0e}, "
            f"violation <= {max(entry.certificate.primal_violation for entry in admitted):.0e} A, V or K"
        )
    times_ms = [entry.solution.solve_time_s * 1e3 for entry in entries]
    said.append(f"{np.median(times_ms):.1f} ms per entry (median), {build.elapsed_s:.2f} s in all")
    return "; ".join(said)


def aftermath(build: Build) -> str:
    """One line where the error after a waveform is so large that it is felt; empty if nowhere.

    Where the scene does not look at what comes after the waveform, it is what the stylus rings on with.
    """
    looked = build.scene.time_grid().after_stages > 0

    def after_m_s2(entry: Entry) -> float:
        return entry.played.error_peak_after_m_s2 if looked else entry.played.after_peak_m_s2

    admitted = [entry for entry in build.all_entries() if entry.status is Status.OPTIMAL]
    loudest = max(admitted, key=after_m_s2, default=None)
    if loudest is None or after_m_s2(loudest) < FELT_g * STANDARD_GRAVITY_M_S2:
        return ""
    after_g = after_m_s2(loudest) / STANDARD_GRAVITY_M_S2
    where = f"({loudest.place})"
    if looked:
        return (
            f"after the waveform the error still reaches {after_g:.1f} g {where}: more time.stages or "
            "hand_over_samples calm it"
        )
    return (
        f"after the waveform the stylus rings on with up to {after_g:.1f} g {where}, which no term of the problem "
        "holds down: weights.after_s = 0.03 calms it"
    )


def lost_start(build: Build) -> str:
    """One line where too much of a tap is over before the first command acts, with the lead that would do."""
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
        f"{100 * share:.2g} % of the energy of {worst.said} is over before the first command can "
        f"act, and counts as error: the waveform starts {scene.lead_s * 1e3:g} ms before it, the amplifier "
        f"delays it by {scene.delay_s * 1e3:g} ms; {remedy}"
    )


def warnings(build: Build) -> list[str]:
    """What deserves a second look in a build, one line each."""
    return [said for said in (lost_start(build), aftermath(build)) if said]


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


def library_verdict(library: Library, iv: int, ig: int) -> str:
    """How good an entry of a file is, see `transopt.problem.answer.verdict`.

    The floor of a library whose plant is nonlinear is that of another plant, the one at rest, and is no measure here.
    """
    spread = library.meta["repeatability"][iv]
    return verdict(
        float(library.nrmse[iv, ig]),
        float("nan") if library.nonlinear else float(library.floor[iv, ig]),
        float("nan") if spread is None else spread,
        levels(library.acceleration_m_s2[iv, ig], library.reference_m_s2[iv], library.meta["dt_s"]),
    )


def library_table(library: Library, name: str) -> Table:
    """The table that `transopt show` prints, from the file alone.

    Of a nonlinear plant it has the linear design's error beside, and says below what is proven.
    """
    axes, unit = library.axes, library.driven_by.unit
    at = f"at {library.input_limit:g} / {library.steady_input:g} {unit}"
    columns = [*axes.columns, "NRMSE %", "floor %", "after %", "after g", f"seed % {at}", f"clipped % {at}"]
    columns += ["linear % promised / played"] * library.nonlinear + [f"peak {unit}", "winding C"]
    samples = library.reference_after_m_s2.shape[1]
    table = Table(title=name, caption=library.claim or None)
    for column in (*columns, "gap", "ms"):
        table.add_column(column, justify="right", overflow="fold")
    for column in ("what binds", "verdict"):
        table.add_column(column, overflow="fold")
    for iv in range(library.speeds_m_s.size):
        for ig in range(library.grips_N.size):
            promised, linear = library.nrmse_promised[iv, ig], library.nrmse_linear[iv, ig]
            gap = library.duality_gap[iv, ig] / max(library.objective[iv, ig], OBJECTIVE_SCALE)
            table.add_row(
                *axes.cells(iv, ig),
                percent(library.nrmse[iv, ig]),
                percent(library.floor[iv, ig]),
                *after_cells(library.nrmse_after[iv, ig], library.peak_after_m_s2[iv, ig], samples),
                " / ".join(percent(error) for error in library.nrmse_seed[iv, ig]),
                " / ".join(percent(error) for error in library.nrmse_clipped[iv, ig]),
                *([f"{percent(promised)} / {percent(linear)}"] if library.nonlinear else []),
                f"{library.peak_input[iv, ig]:.3f}",
                "-" if np.isnan(library.peak_temperature_C[iv, ig]) else f"{library.peak_temperature_C[iv, ig]:.2f}",
                f"{gap:.0e}",
                f"{library.solve_time_s[iv, ig] * 1e3:.0f}",
                str(library.binding[iv, ig]),
                library_verdict(library, iv, ig),
            )
        table.add_section()
    return table


def verify_table(checks: Sequence[EntryCheck], name: str) -> Table:
    """The table that `transopt verify` prints."""
    table = Table(title=name)
    unit = checks[0].unit
    for column in (*checks[0].columns, "NRMSE %", f"peak {unit}", f"violation {unit}", "gap", "result"):
        table.add_column(column, justify="left" if column == "result" else "right", overflow="fold")
    for check in checks:
        table.add_row(
            *check.cells,
            percent(check.played.nrmse),
            f"{check.played.peak_input:.4f}",
            f"{check.certificate.violation(unit):.0e}",
            f"{check.certificate.relative_gap:.0e}",
            "; ".join(check.shortfalls) or "certified, replayed clean",
            style="red" if check.shortfalls else None,
        )
    return table
