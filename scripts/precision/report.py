"""Markdown and CSV of `error_against_runtime.py`."""

from collections.abc import Sequence

import numpy as np
from common.measuring import threads

from precision.cases import AGREEMENT, SOLVED, Case
from precision.methods import TIME_LIMIT_S, Kind, Level
from precision.periods import BASE_Hz, FINE_Hz
from precision.run import Row
from precision.summary import NEARLY, SHIFT_MS, Summary, summarise
from precision.wheels import PIP_LINE
from transopt.base.machine import machine, versions
from transopt.base.writing import table

CITATION = """@software{transopt,
  author  = {{The transopt developers}},
  title   = {transopt: optimal motor-current transients for event-based haptics},
  version = {0.1.0},
  year    = {2026},
  license = {BSD-3-Clause}
}"""


def number(value: float) -> str:
    """Two significant digits of an error; a dash for none, "failed" for infinity."""
    if np.isnan(value):
        return "-"
    return "failed" if np.isinf(value) else f"{value:.0e}" if value else "0"


def milliseconds(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.1f}" if value < 99.95 else f"{value:.0f}"


def summary_table(summaries: Sequence[Summary]) -> list[str]:
    head = [
        "method",
        "settings",
        f"solved to {SOLVED:g}",
        "run time, best = 1.0",
        f"solved to {NEARLY:g}",
        "run time, best = 1.0",
        "worst error",
    ]
    cells = [
        [
            s.method,
            f"{s.level}: {s.options}" if not s.options.startswith(s.level) else s.options,
            f"{100 * s.scores[SOLVED].success:.0f} %",
            f"{s.scores[SOLVED].relative:.1f} ({milliseconds(s.scores[SOLVED].mean_ms)} ms)",
            f"{100 * s.scores[NEARLY].success:.0f} %",
            f"{s.scores[NEARLY].relative:.1f} ({milliseconds(s.scores[NEARLY].mean_ms)} ms)",
            "reference" if s.reference else number(s.worst),
        ]
        for s in summaries
    ]
    return table(head, cells)


def _groups(cases: Sequence[Case]) -> list[tuple[str, list[str]]]:
    """QPs, which all solvers can take, apart from NLPs."""
    quadratic = [case.name for case in cases if case.qp is not None]
    other = [case.name for case in cases if case.qp is None]
    named = (("QP", quadratic), ("NLP", other))
    return [(f"{len(names)} {word}{'s' if len(names) > 1 else ''}", names) for word, names in named if names]


def summaries_of(cases: Sequence[Case], rows: Sequence[Row]) -> list[str]:
    lines = []
    for title, names in _groups(cases):
        lines += [f"### {title}: {', '.join(names)}", "", *summary_table(summarise(rows, names))]
    return lines


def answer(cases: Sequence[Case], rows: Sequence[Row]) -> str:
    """Run time and worst error of the best method on the QPs, and how far behind the next method is."""
    best, *others = summarise(rows, [case.name for case in cases if case.qp is not None])
    after = next((s for s in others if s.method != best.method), best)
    return (
        f"{milliseconds(best.scores[SOLVED].mean_ms)} ms at an error of {number(best.worst)}, "
        f"{after.scores[SOLVED].relative:.1f} times as fast as `{after.method}`, the next of those compared."
    )


def _across(cases: Sequence[Case], rows: Sequence[Row], kind: Kind, cell: str, first: str) -> list[str]:
    """One line per method of a kind, one column per case."""
    chosen = [row for row in rows if row.kind == kind.value]
    names = list(dict.fromkeys(row.method for row in chosen))
    by = {(row.method, row.case): row for row in chosen}

    def content(name: str, case: Case) -> str:
        row = by.get((name, case.name))
        if row is None:
            return "-"
        value = getattr(row, cell)
        return f"failed ({row.status})" if np.isinf(value) else f"{number(value)}, {milliseconds(row.solve_ms)} ms"

    return table(
        [first, *(case.name for case in cases)], [[name, *(content(name, case) for case in cases)] for name in names]
    )


def _reference_table(cases: Sequence[Case]) -> list[str]:
    return table(
        [
            "case",
            "entry",
            "binds",
            "J",
            "found by",
            "confirmed by",
            "J apart, relative",
            "command apart A",
            "gap proven",
        ],
        [
            [
                case.name,
                case.entry,
                case.binding,
                f"{case.optimum.objective:.6e}",
                case.optimum.found_by,
                case.optimum.confirmed_by,
                f"{case.optimum.agreement:.0e}",
                f"{case.optimum.apart_A:.0e}",
                f"{case.optimum.certificate.relative_gap:.0e}",
            ]
            for case in cases
        ],
    )


def _row_table(rows: Sequence[Row]) -> list[str]:
    head = ["method", "options", "iterations", "status", "set-up ms", "ms", "quartiles", "runs"]
    head += ["gap", "violation", "tap error excess", "own certificate"]
    return table(
        head,
        [
            [
                row.method,
                f"{row.options} ({row.level})" if row.level == Level.HIGH.value else row.options,
                row.iterations if row.iterations >= 0 else "-",
                row.status.replace("|", "/"),
                milliseconds(row.setup_ms),
                milliseconds(row.solve_ms),
                f"{milliseconds(row.q25_ms)} to {milliseconds(row.q75_ms)}",
                row.runs,
                "reference" if row.reference else number(row.gap),
                number(row.violation),
                "reference" if row.reference else number(row.tap_error_excess),
                number(row.certificate),
            ]
            for row in rows
        ],
    )


def how_measured(reading_ms: float) -> list[str]:
    plural = "" if threads() == 1 else "s"
    text = f"""## How it was measured

- **Cases**: of each scene the entry that its limits cost most. `hot_coil` limits the temperature, which is not
  quadratic in the current: an NLP, which QP solvers cannot take.
- **Error**: the larger of |J - J*| / max(J*, 1e-3) and the largest excess over a limit, relative to that limit
  (temperature: to the headroom), both from the command's rollout through the exact model; a J below the reference's,
  bought outside the limits, counts by its size. A QP's point is first turned into a command by moving it into the
  command's range and to zero over the hand-over.
- **Reference**: two methods at their tightest tolerance, which have to agree to {AGREEMENT:g}; the grey band of the
  figure is their difference, below which errors mean nothing. Their own rows are marked *reference*: what they differ
  by from themselves, or from each other, is no error measured; their own certificates, by multipliers, are.
- **Run time**: median of several runs in turns, linear algebra on {threads()} thread{plural}, each run without the
  answer of an earlier one; what is done once for a shape of problem is apart, as set-up. To the
  project's solvers each run is a new tap of a known device: `riccati` computes its stage data within that time,
  `casadi-*` read their numbers from the CasADi statement ({reading_ms:.1f} ms). The others find P, q, A, l, u ready.
  DAQP is dense: condensing is part of its run. A run longer than {TIME_LIMIT_S:g} s is a failure.
- **Summary**: as in qpbenchmark, the shifted geometric mean of the run time (shift {SHIFT_MS:g} ms) with failures
  charged {TIME_LIMIT_S:g} s, the best 1.0. The recomputed error decides what is a failure, not the solver.
- `riccati` is the project's own solver and its default; `casadi-piqp` and `casadi-ipopt` are CasADi's
  plugins under the project's adapters. *The default tolerance* is the project's, for all three; IPOPT with
  its own defaults is what `opti-ipopt` runs. HPIPM's status 1 is its iteration limit: it asks for more digits than
  there are, and its answer is right all the same.
- **Own certificate**: relative duality gap by the method's own multipliers (`proof.certify`); needs no reference.
- **Discretisations**: plant and amplifier by one step of the method per servo period, solved by the project's first
  choice; the command is judged through the exact model like any other.
- **Servo rates** are other problems and have no error: their commands are replayed on a grid of {FINE_Hz / 1e3:g} kHz
  against the same recorded tap, and compared with the optimum of a {BASE_Hz / 1e3:g} kHz servo there. No optimum
  minimises the tap error alone, so that of a slower servo can be smaller.
"""
    return [*text.splitlines(), ""]


def markdown(
    cases: Sequence[Case],
    rows: Sequence[Row],
    *,
    command: str,
    elapsed_s: float,
    missing: Sequence[str],
    reading_ms: float,
) -> str:
    """error_against_runtime.md, whole."""
    computer, installed = machine(), versions("transopt", "casadi", "numpy", "scipy")
    lines = [
        "# Error against run time",
        "",
        f"`{command}`: {elapsed_s:.0f} s on {computer['cpu']}, {computer['cores']} cores, {computer['system']}; "
        f"{', '.join(f'{name} {version}' for name, version in installed.items())}.",
        "",
    ]
    if missing:
        lines += [f"Left out because they are not installed: {', '.join(missing)}; `{PIP_LINE}` adds them.", ""]
    lines += ["![Work-precision diagrams](work_precision.png)", "", "## Summary", "", *summaries_of(cases, rows)]
    lines += ["## Reference solutions", "", *_reference_table(cases)]
    lines += ["## Baselines", "", "Error and run time.", ""]
    lines += _across(cases, rows, Kind.BASELINE, "error", "baseline")
    lines += ["## Discretisations", "", "Error and run time.", ""]
    lines += _across(cases, rows, Kind.DISCRETISATION, "error", "one step a tick")
    if any(row.kind == Kind.PERIOD.value for row in rows):
        lines += ["## Servo rates", "", f"Tap error less that of a {BASE_Hz / 1e3:g} kHz servo, and run time.", ""]
        lines += _across(cases, rows, Kind.PERIOD, "tap_error_excess", "servo rate")
    lines += how_measured(reading_ms)
    for case in cases:
        lines += [f"## {case.name}", "", *_row_table([row for row in rows if row.case == case.name])]
    lines += ["## How to cite", "", "```bibtex", CITATION, "```", ""]
    return "\n".join(lines)
