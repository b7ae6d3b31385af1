"""Compares the speed of the project's solvers with that of named peers, in one run on one machine.

    python scripts/benchmark.py --json FILE

Prints machine, versions, and per row the median and quartiles of the solve, the set-up, the objective gap to the
certified lower bound and the limit violation, both recomputed from the rolled-out command, as one table under the
ratios. Compare machines by the ratios; milliseconds need the calibration row. All methods use one thread.
"""

from dataclasses import asdict, replace
from typing import Annotated

import numpy as np
from common.benchmark_cases import (
    BESIDE,
    STAGES,
    TWELVE,
    TWO_HUNDRED,
    Case,
    Iterations,
    Row,
    anew,
    calibration,
    cold_start,
    compare,
    designed_entry,
    direct_piqp,
    entry,
    iterations,
    libraries,
    opti_ipopt,
    own,
    project_solver,
    row,
    servo_and_simulator,
    side_by_side,
    unlimited_solver,
)
from common.command import JsonFile, at_least, run, write_json
from common.measuring import on_one_thread
from common.page import PageFile, write_answer, write_part

import problems
from transopt.base.files import without_nan
from transopt.base.machine import machine, versions
from transopt.base.writing import table
from transopt.problem.heat import Budget
from transopt.problem.limits import limits_of
from transopt.problem.limits.temperature import temperature_limit
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify
from transopt.solvers import riccati, unlimited
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

LONG, LONGEST = 10 * STAGES, 25 * STAGES


def in_a_row(problem: TransientProblem, stages: int) -> TransientProblem:
    """The tap repeated over so many stages, to scale the work without idle stages."""
    times = -(-stages // problem.grid.stages)
    return replace(
        problem,
        grid=replace(problem.grid, stages=stages, after_stages=0),
        target=Target(np.tile(problem.reference_m_s2, times)[:stages]),
        terms=tuple(replace(term, weights=np.tile(term.weights, times)[:stages]) for term in problem.terms),
    )


def measure(runs: int) -> tuple[list[Row], Iterations | None, float]:
    """All rows, times of an iteration at `STAGES` (if compiled), and the peak memory of `transopt solve` [MB]."""
    scene = problems.load("wood_on_foam")
    rows = [calibration()]
    saturated, free = entry(scene, 0.4, 5.0), entry(scene, 0.2, 3.0)
    reference = solve(saturated, SolverOptions("casadi-ipopt"))
    proof = certify(saturated, reference.command, reference.multipliers)
    long = in_a_row(saturated, LONG)
    coil = scene.coil()
    assert coil is not None
    budget = Budget(headroom_K=0.05)
    winding = temperature_limit(coil, scene.amplifier_model(), saturated.grid, budget)
    hot = replace(saturated, limits=limits_of(*saturated.limits.without(winding.name), winding))
    unsaturated = [
        unlimited_solver("riccati-pass", "judged by its gradient", lambda given: unlimited.solve([given])[0], free),
        unlimited_solver("sparse-kkt", "pattern reused", unlimited.solve_sparse, free),
        project_solver(free, "casadi-piqp"),
    ]
    rows += compare(
        runs,
        *own("saturated", saturated),
        *([Case("saturated", STAGES, side_by_side(saturated))] if riccati.available else []),
        Case("saturated", STAGES, direct_piqp(saturated)),
        Case("saturated", STAGES, project_solver(saturated, "casadi-piqp")),
        Case("saturated", STAGES, project_solver(saturated, "casadi-ipopt")),
        Case("saturated", STAGES, opti_ipopt(saturated, proof.objective - proof.duality_gap)),
        *own("thermal", hot),
        Case("thermal", STAGES, project_solver(hot, "casadi-ipopt")),
        *own("horizon", long),
        Case("horizon", LONG, project_solver(long, "casadi-piqp")),
        *(Case("unsaturated", STAGES, peer) for peer in unsaturated),
        Case("entry", STAGES, designed_entry("window alone", scene, 0.4, 5.0, 0.0)),
        Case("entry", STAGES, designed_entry("with its tail", scene, 0.4, 5.0, scene.weights.after_s)),
    )
    taken = None
    if riccati.available:
        longest = in_a_row(saturated, LONGEST)
        rows += compare(max(runs // 3, 3), *own("horizon", longest))
        taken = iterations(saturated, 5 * runs)
    built, library = libraries(scene, max(runs // 3, 3))
    rows += built
    if riccati.available:
        rows += anew(library)
    rows.append(servo_and_simulator(library, runs))
    cold, memory = cold_start(3)
    return [*rows, row("command", "transopt solve", "cold process, figures included", STAGES, cold)], taken, memory


def ratios(rows: list[Row], taken: Iterations | None) -> list[str]:
    """One sentence per ratio, with the required bounds of the project's method in brackets."""
    by = {(r.case, r.method, r.stages): r.median_ms for r in rows}

    def ratio(case: str, one: str, other: str, bound: str = "") -> str:
        value = by[case, one, STAGES] / by[case, other, STAGES]
        return f"{one} / {other}, {case}: {value:.{1 if value > 2 else 2}f}{bound and f' ({bound})'}"

    found = [
        ratio("saturated", "opti-ipopt", "casadi-piqp"),
        ratio("saturated", "casadi-ipopt", "casadi-piqp"),
        ratio("unsaturated", "sparse-kkt", "riccati-pass"),
        ratio("entry", "with its tail", "window alone", "at most 1.1"),
        f"wall clock / virtual time, servo + simulator: {by['online', 'servo + simulator', 10000] / 1e3:.2f}",
        f"{LONG} stages / {STAGES} stages, casadi-piqp: "
        f"{by['horizon', 'casadi-piqp', LONG] / by['saturated', 'casadi-piqp', STAGES]:.1f}",
    ]
    if taken is None:
        return found
    beside = by["saturated", f"riccati, {BESIDE} side by side", STAGES]
    piqp_ms = by["saturated", "piqp", STAGES]
    twelve, two_hundred = (by["library", name, STAGES] / piqp_ms for name in (TWELVE, TWO_HUNDRED))
    found += [
        f"12 entries / piqp on one tap: {twelve:.1f} (at most 2), 200 entries: {two_hundred:.1f} (at most 15)",
        f"piqp / riccati on eight entries, each: {BESIDE * piqp_ms / beside:.1f} (at least 35)",
        ratio("saturated", "piqp", "riccati", "at least 10"),
        ratio("saturated", "casadi-piqp", "riccati", "at least 6"),
        ratio("saturated", "opti-ipopt", "riccati", "at least 120"),
        ratio("saturated", "casadi-ipopt", "riccati"),
        ratio("thermal", "casadi-ipopt", "riccati", "at least 50"),
        f"{LONGEST} stages / {LONG} stages, riccati: "
        f"{by['horizon', 'riccati', LONGEST] / by['horizon', 'riccati', LONG]:.1f} (at most {LONGEST / LONG:g})",
        f"an iteration / a linear pass, {STAGES} stages: {taken.ratio:.2f} (at most 2); "
        f"{taken.each:.3f} ms / {taken.linear_pass:.3f} ms",
    ]
    return found


def answer(rows: list[Row]) -> str:
    """How fast the solver is, in one sentence with two of the ratios."""
    by = {r.method: r.median_ms for r in rows if r.case == "saturated"}
    piqp, opti = (by[name] / by["riccati"] for name in ("piqp", "opti-ipopt"))
    return f"{piqp:.1f} times as fast as the PIQP wheel on a saturated tap, {opti:.1f} times as Opti and IPOPT."


def cells(rows: list[Row]) -> list[list[str]]:
    """Cells of the table, row by row; the name of a case only in its first row."""
    found, before = [], ""
    for r in rows:
        case = r.case if r.stages in (0, STAGES) or r.case == "online" else f"{r.case}, {r.stages} stages"
        gap = "" if np.isnan(r.objective_gap) else f"{r.objective_gap:.0e}"
        violation = "" if np.isnan(r.violation) else f"{r.violation:.0e}".replace("0e+00", "0")
        method = r.method if r.case not in ("library", "online", "command") else f"{r.method}: {r.options}"
        shown = f"{r.median_ms:.3g}" if r.median_ms < 1000 else f"{r.median_ms:.0f}"
        spread = f"{r.q25_ms:.3g} to {r.q75_ms:.3g}"
        found.append([case if case != before else "", method, shown, spread, f"{r.setup_ms:.1f}", gap, violation])
        before = case
    return found


HEAD = ("case", "method", "median ms", "quartiles ms", "set-up ms", "gap / max(J, 1e-3)", "violation A, V or K")


def main(
    runs: Annotated[int, at_least(1, "timed runs of each method")] = 15, json: JsonFile = None, page: PageFile = None
) -> None:
    rows, taken, memory_MB = measure(runs)
    about = {
        "machine": machine(),
        "versions": versions("casadi", "numpy", "scipy", "transopt"),
        "default_solver": SolverOptions().solver,
        "peak_memory_MB": round(memory_MB, 1),
    }
    text = [*table(HEAD, cells(rows)), *(f"- {ratio}" for ratio in ratios(rows, taken))]
    print(about, "", *text, sep="\n")
    write_part(page, text)
    if taken is not None:
        write_answer(page, answer(rows))
    if json is not None:
        write_json(without_nan({**about, "rows": [asdict(r) for r in rows]}), json)


if __name__ == "__main__":
    on_one_thread()
    run(main)
