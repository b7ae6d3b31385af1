"""Speed against the named peers, in one run on one machine (DESIGN 10).

    python scripts/benchmark.py --json FILE

Prints machine, versions, and per row the median and quartiles of the solve, the set-up, the objective gap to the
certified lower bound and the limit violation, both recomputed from the rolled-out command. Ratios bind, milliseconds
need the calibration row.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path

import numpy as np
from measuring import elapsed_ms, machine, timed, versions
from peers import commonly_written

import problems
from controller.bank import bank
from controller.loop import run as play
from controller.prediction import scene_of
from controller.servo import Servo
from controller.settings import Settings
from controller.simulator import Imperfections, Simulator
from controller.truth import device_of
from controller.user import RepeatedTaps
from problems.simulate import recordings
from transopt import transcribe
from transopt.build import build_library
from transopt.certify import certify
from transopt.discretise import discretise
from transopt.files import whole_file
from transopt.heat import Budget, thermal_limit
from transopt.library import Library
from transopt.problem import Multipliers, Solution, TransientProblem
from transopt.reference import build_references
from transopt.report import without_nan
from transopt.scene import Scene
from transopt.scene_file import load_scene
from transopt.signals import FloatArray
from transopt.solvers import (
    SolverOptions,
    casadi_fatrop,
    casadi_ipopt,
    casadi_piqp,
    riccati,
    riccati_lq,
    solve,
    sparse_kkt,
    unlimited,
)


@dataclass(frozen=True)
class Row:
    """One method on one case; gap relative to max(J, 1e-3), violation in A, NaN where it has no meaning."""

    case: str
    method: str
    version: str
    options: str
    threads: int
    stages: int
    setup_ms: float
    median_ms: float
    q25_ms: float
    q75_ms: float
    runs: int
    objective_gap: float
    violation: float


def row(
    case: str,
    method: str,
    options: str,
    stages: int,
    times_ms: FloatArray,
    *,
    setup_ms: float = 0.0,
    gap: float = float("nan"),
    violation: float = float("nan"),
) -> Row:
    q25, median, q75 = np.percentile(times_ms, [25, 50, 75])
    version = metadata.version("casadi") if method.startswith(("casadi", "opti")) else metadata.version("transopt")
    return Row(case, method, version, options, 1, stages, setup_ms, median, q25, q75, times_ms.size, gap, violation)


def entry(scene: Scene, speed_m_s: float, grip_N: float, stages: int) -> TransientProblem:
    """One entry of the scene; a longer horizon goes on with nothing to do."""
    references = build_references(recordings(scene), scene.grid.speeds_m_s, scene.time_grid(), scene.recordings)
    wanted = references[scene.grid.speeds_m_s.index(speed_m_s)].motor_m_s2
    return TransientProblem(
        stage=discretise(scene.plant(grip_N), scene.amplifier_model(), scene.time.dt_s),
        grid=replace(scene.time_grid(), stages=stages),
        reference_m_s2=np.concatenate([wanted, np.zeros(max(0, stages - wanted.size))])[:stages],
        tracking_weights=np.ones(stages),
        rho=scene.weights.rho,
        limits=scene.current_limits(),
        hand_over_samples=scene.hand_over_samples,
    )


@dataclass(frozen=True)
class Peer:
    """A method ready to be timed: what one run does, what preparing it took, and what its answer is worth."""

    name: str
    options: str
    run: Callable[[], object]
    setup_ms: float
    gap: float
    violation: float


def project_solver(problem: TransientProblem, solver: str) -> Peer:
    """A solver of the project, its object reused; set-up is what a first call with nothing cached takes longer."""
    options = SolverOptions(solver)
    transcribe.state_program.cache_clear()
    for module in (casadi_piqp, casadi_fatrop, casadi_ipopt):
        module.solver_object.cache_clear()
    first, second = (elapsed_ms(lambda: solve(problem, options)) for _ in range(2))
    solution = solve(problem, options)
    proof = certify(problem, solution.command_A, solution.multipliers)
    return Peer(
        name=solver,
        options=f"tol {options.tolerance:g}, object reused",
        run=lambda: solve(problem, options),
        setup_ms=max(first - second, 0.0),
        gap=proof.relative_gap,
        violation=proof.primal_violation,
    )


def unlimited_solver(
    name: str, options: str, method: Callable[[TransientProblem], Solution], problem: TransientProblem
) -> Peer:
    for cached in (transcribe.state_program, riccati_lq.recursions, sparse_kkt.pattern):
        cached.cache_clear()
    first, second = (elapsed_ms(lambda: method(problem)) for _ in range(2))
    solution = method(problem)
    proof = certify(problem, solution.command_A, solution.multipliers)
    return Peer(
        name=name,
        options=f"{options}: {solution.message}",
        run=lambda: method(problem),
        setup_ms=max(first - second, 0.0),
        gap=proof.relative_gap,
        violation=proof.primal_violation,
    )


def opti_ipopt(problem: TransientProblem, lower_bound: float) -> Peer:
    """The usual way of writing it, with IPOPT's defaults."""
    start = time.perf_counter()
    opti, commands = commonly_written(problem)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    found = np.asarray(opti.solve().value(commands)).ravel()
    setup_and_first = 1e3 * (time.perf_counter() - start)

    def again() -> None:
        opti.set_initial(opti.x, 0)
        opti.solve()

    proof = certify(problem, found, Multipliers.zero(problem))
    return Peer(
        name="opti-ipopt",
        options="as commonly written, IPOPT defaults, object reused",
        run=again,
        setup_ms=max(setup_and_first - elapsed_ms(again), 0.0),
        gap=(proof.objective - lower_bound) / max(proof.objective, 1e-3),
        violation=proof.primal_violation,
    )


@dataclass(frozen=True)
class Case:
    """One peer on one case."""

    name: str
    stages: int
    peer: Peer


def compare(runs: int, *cases: Case) -> list[Row]:
    """Rows of cases that take turns."""
    times = timed(runs, **{f"{case.name} {case.peer.name}": case.peer.run for case in cases})
    return [
        row(
            case.name,
            case.peer.name,
            case.peer.options,
            case.stages,
            times[f"{case.name} {case.peer.name}"],
            setup_ms=case.peer.setup_ms,
            gap=case.peer.gap,
            violation=case.peer.violation,
        )
        for case in cases
    ]


def calibration() -> Row:
    """A fixed workload: 200 products and factorisations of 200 x 200 matrices."""
    matrix = np.random.default_rng(0).standard_normal((200, 200))
    spd = matrix @ matrix.T + 200 * np.eye(200)

    def work() -> None:
        for _ in range(200):
            np.linalg.cholesky(spd)
            matrix @ matrix

    return row("calibration", "numpy", "200 x (product + Cholesky) of 200 x 200", 0, timed(7, work=work)["work"])


def cold_start(runs: int) -> tuple[Row, float]:
    """README's first command from an installed environment, figures included; and its peak memory [MB]."""
    resource = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL); "
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)"
    )
    times, memory = [], 0.0
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            command = [sys.executable, "-c", "from transopt.cli import main; main()", "solve", "--out", folder]
            done = subprocess.run(
                [sys.executable, "-c", resource, *command], check=True, capture_output=True, text=True
            )
            times.append(1e3 * (time.perf_counter() - start))
            memory = max(memory, float(done.stdout))
    return row("command", "transopt solve", "cold process, figures included", 600, np.array(times)), memory


def online(library: Library, runs: int) -> Row:
    """A virtual second of random taps: servo, plant, sensors, hand; other taps in every run, so none is known."""
    settings, table = Settings.of(library), bank(library)
    device, ticks = device_of(scene_of(library)), round(1 / settings.dt_s)
    seeds = iter(range(runs + 1))

    def second() -> None:
        seed = next(seeds)
        servo = Servo(settings, table)
        servo.arm()
        imperfections = Imperfections(mismatch=0.1)
        # Without friction the motion is exact in any step; one before and one after the delay's end.
        simulator = Simulator(
            device, RepeatedTaps(seed), settings.dt_s, imperfections=imperfections, seed=seed, steps=1
        )
        play(simulator, servo, ticks, settings.dt_s)

    times = timed(runs, online=second)["online"]
    return row("online", "servo + simulator", "one virtual second of random taps, two steps per tick", ticks, times)


def own(case: str, problem: TransientProblem) -> list[Case]:
    """The project's own method, where it is built."""
    return [Case(case, problem.grid.stages, project_solver(problem, "riccati"))] if riccati.available else []


def measure(runs: int) -> tuple[list[Row], float]:
    scene = load_scene(problems.scene_path("wood_on_foam"))
    rows = [calibration()]
    saturated = entry(scene, 0.4, 5.0, 600)
    reference = solve(saturated, SolverOptions("casadi-ipopt"))
    proof = certify(saturated, reference.command_A, reference.multipliers)
    # Ten saturated taps in a row: ten times the work, nothing of it idle.
    long = replace(entry(scene, 0.4, 5.0, 6000), reference_m_s2=np.tile(saturated.reference_m_s2, 10))
    free = entry(scene, 0.2, 3.0, 600)
    coil = scene.coil()
    assert coil is not None
    budget = Budget(headroom_K=0.05)
    hot = replace(saturated, thermal=thermal_limit(coil, scene.amplifier_model(), saturated.grid, budget))
    rows += compare(
        runs,
        *own("saturated", saturated),
        Case("saturated", 600, project_solver(saturated, "casadi-piqp")),
        Case("saturated", 600, project_solver(saturated, "casadi-ipopt")),
        Case("saturated", 600, opti_ipopt(saturated, proof.objective - proof.duality_gap)),
        Case("saturated", 600, project_solver(saturated, "casadi-fatrop")),
        *own("thermal", hot),
        Case("thermal", 600, project_solver(hot, "casadi-fatrop")),
        Case("thermal", 600, project_solver(hot, "casadi-ipopt")),
        *own("horizon", long),
        Case("horizon", 6000, project_solver(long, "casadi-piqp")),
        Case("unsaturated", 600, unlimited_solver("riccati-pass", "judged by its gradient", unlimited.solve, free)),
        Case("unsaturated", 600, unlimited_solver("sparse-kkt", "pattern reused", unlimited.solve_sparse_kkt, free)),
        Case("unsaturated", 600, project_solver(free, "casadi-piqp")),
    )

    taps = recordings(scene)
    times = timed(max(runs // 3, 3), library=lambda: build_library(scene, taps))["library"]
    rows.append(row("library", "transopt", "12 entries solved, certified, replayed, baselines", 600, times))
    library = build_library(scene, taps).library
    assert library is not None
    rows.append(online(library, runs))
    cold, memory = cold_start(3)
    return [*rows, cold], memory


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="also write the rows here")
    parser.add_argument("--runs", type=int, default=15, help="timed runs of each method")
    arguments = parser.parse_args()
    rows, memory_MB = measure(arguments.runs)
    result = {
        "machine": machine(),
        "versions": versions("casadi", "numpy", "scipy", "transopt"),
        "default_solver": SolverOptions().solver,
        "peak_memory_MB": round(memory_MB, 1),
        "rows": [asdict(r) for r in rows],
    }
    print(json.dumps({key: result[key] for key in ("machine", "versions", "default_solver", "peak_memory_MB")}))
    print(
        f"{'case':12} {'method':15} {'N':>5} {'setup ms':>9} {'median ms':>10} {'quartiles':>17} "
        f"{'gap':>9} {'violation':>9}"
    )
    for r in rows:
        spread = f"{r.q25_ms:.1f} to {r.q75_ms:.1f}"
        print(
            f"{r.case:12} {r.method:15} {r.stages:5d} {r.setup_ms:9.1f} {r.median_ms:10.2f} {spread:>17} "
            f"{r.objective_gap:9.0e} {r.violation:9.0e}  {r.options}"
        )
    by = {(r.case, r.method): r.median_ms for r in rows}
    fast = by["saturated", "casadi-piqp"]
    print(f"\nopti-ipopt / casadi-piqp, saturated: {by['saturated', 'opti-ipopt'] / fast:.1f}")
    pass_ms = by["unsaturated", "riccati-pass"]
    print(f"sparse-kkt / riccati-pass, unsaturated: {by['unsaturated', 'sparse-kkt'] / pass_ms:.1f}")
    print(
        f"casadi-ipopt / casadi-fatrop, thermal: {by['thermal', 'casadi-ipopt'] / by['thermal', 'casadi-fatrop']:.1f}"
    )
    print(f"casadi-ipopt / casadi-piqp, saturated: {by['saturated', 'casadi-ipopt'] / fast:.1f}")
    print(f"wall clock / virtual time, servo + simulator: {by['online', 'servo + simulator'] / 1e3:.2f}")
    print(f"6000 stages / 600 stages, casadi-piqp: {by['horizon', 'casadi-piqp'] / fast:.1f}")
    if riccati.available:
        mine = by["saturated", "riccati"]
        for peer in ("casadi-piqp", "casadi-fatrop", "casadi-ipopt", "opti-ipopt"):
            print(f"{peer} / riccati, saturated: {by['saturated', peer] / mine:.1f}")
        for peer in ("casadi-fatrop", "casadi-ipopt"):
            print(f"{peer} / riccati, thermal: {by['thermal', peer] / by['thermal', 'riccati']:.1f}")
        print(f"6000 stages / 600 stages, riccati: {by['horizon', 'riccati'] / mine:.1f}")
    if arguments.json is not None:
        with whole_file(arguments.json) as file:
            file.write(json.dumps(without_nan(result), indent=1).encode())


if __name__ == "__main__":
    main()
