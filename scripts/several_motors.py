"""Measures an arm with three motors: solver against PIQP, blends against optima, full arm against the linear one.

python scripts/several_motors.py [--page docs/results/several_motors.md]
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
import piqp
import scipy
from common.command import Seed, at_least, run
from common.measuring import on_one_thread
from common.page import PageFile, write_part

from transopt.base.signals import FloatArray
from transopt.base.writing import percent, table
from transopt.design.context import Context
from transopt.design.optimum import optimum
from transopt.design.solve import solve
from transopt.library.library import Library
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import linear_stage
from transopt.proof.arm_replay import replay_on_arm
from transopt.proof.certify import certify
from transopt.proof.replay import replayed
from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.recordings import recordings_of
from transopt.scene.scene import Scene
from transopt.solvers import modes
from transopt.solvers.native.extension import interior_points
from transopt.solvers.options import SolverOptions
from transopt.solvers.program import state_program
from transopt.solvers.shape import program_shape
from transopt.solvers.sparse_kkt import pattern
from transopt.solvers.stage_data import Stages, stages
from transopt.solvers.statement import state

SCENE = "stylus_3d"
TOLERANCE = 1e-9  # of all methods, in the statement's units
SPEEDS_M_S = [0.1, 0.2, 0.3, 0.4]
ROUNDED = 1e-6  # of a limit: what a certificate tolerates


BESIDE = 8  # times that the problem is solved side by side with itself: a whole register of it


def saturated(scene: Scene) -> TransientProblem:
    """The fastest tap at the first grip, normal and posture."""
    context = Context.recorded(scene, recordings_of(scene))
    return context.posed(scene.grid.speeds_m_s[-1], scene.grid.grips_N[0], place=(1, 1)).problem


def multistage(problem: TransientProblem) -> tuple[piqp.SparseSolver, FloatArray]:
    """PIQP's stage-structured solver, set up with the CasADi statement's data, and its lower bounds."""
    statement = state(problem)
    shape = program_shape(problem)
    data = state_program(shape).qp_data(p=statement.p)
    H, A = (
        scipy.sparse.csc_matrix((np.asarray(data[name].nonzeros()), *pattern(shape, name)), shape=data[name].shape)
        for name in ("H", "A")
    )
    solver = piqp.SparseSolver()
    settings = solver.settings
    settings.kkt_solver = piqp.KKTSolver.sparse_multistage
    settings.eps_abs, settings.eps_rel = TOLERANCE, 0.0
    settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = TOLERANCE, 0.0
    solver.setup(
        H, np.asarray(data["q"]).ravel(), A, statement.lower_g, None, None, None, statement.lower_x, statement.upper_x
    )
    return solver, statement.lower_x


@dataclass(frozen=True)
class Speed:
    """Processor times of one method [ms], its J and its iterations."""

    method: str
    ms: FloatArray
    objective: float
    iterations: int


def dense(scene: Scene) -> Stages:
    """Stage data of the saturated tap in the plant's own states in place of its modes."""
    most, modes.MOST_CONDITION = modes.MOST_CONDITION, 0.0
    try:
        return stages(saturated(scene))
    finally:
        modes.MOST_CONDITION = most


def speeds(scene: Scene, runs: int) -> list[Speed]:
    """The compiled method in modes, alone and in a batch, and dense, and PIQP, on data that are there, in turns."""
    problem = saturated(scene)
    given = stages(problem)
    own = {
        "own, in modes": [given],
        f"own, in modes, one of {BESIDE} side by side": [given] * BESIDE,
        "own, dense": [dense(scene)],
    }
    solver, _ = multistage(problem)
    methods: dict[str, Callable[[], object]] = {
        name: partial(interior_points, some, tolerance=TOLERANCE, max_iterations=100) for name, some in own.items()
    }
    times = in_turns(runs, **methods, piqp=solver.solve)
    found = []
    for name, some in own.items():
        answer = interior_points(some, tolerance=TOLERANCE, max_iterations=100)[0]
        multipliers = some[0].multipliers(answer.upper - answer.lower, answer.gradient)
        proof = certify(problem, some[0].command(answer.command), multipliers)
        assert proof.accepted
        found.append(Speed(name, times[name] / len(some), proof.objective, answer.iterations))
    point = state(problem).command(np.asarray(solver.result.x))
    objective = problem.objective(point, problem.accelerations(point))
    found.append(Speed("PIQP, multistage", times["piqp"], objective, solver.result.info.iter))
    return found


def in_turns(runs: int, **methods: Callable[[], object]) -> dict[str, FloatArray]:
    """(runs,) processor times [ms] of each method, taking turns: other work on the machine counts little in them."""
    times: dict[str, list[float]] = {name: [] for name in methods}
    for _ in range(runs):
        for name, method in methods.items():
            start = time.process_time()
            method()
            times[name].append(1e3 * (time.process_time() - start))
    return {name: np.array(values) for name, values in times.items()}


def blends(library: Library, count: int, seed: int) -> tuple[float, float]:
    """Largest current over its limit and largest command over its own, of random blends [shares of the limits]."""
    lot, stage = np.random.default_rng(seed), library.stage(0)
    limit, amplifier = library.input_limit, library.amplifier()
    assert amplifier is not None
    current = command = 0.0
    for first in range(0, count, 1000):
        taps = [library.at(*place).command for place in places(library, lot, min(1000, count - first))]
        made = np.stack(taps)
        # The currents follow from the commands alone, whichever node's device they are rolled out on.
        current = max(current, float(np.abs(stage.motion(made).plant_input).max()) / limit)
        command = max(command, float(np.abs(made).max()) / amplifier.command_limit)
    return current, command


def places(library: Library, lot: np.random.Generator, count: int) -> Iterator[tuple[float, float, float, float]]:
    """Random places within the grid."""
    v, g, (_, *most) = library.speeds_m_s, library.grips_N, library.axes.sizes
    low, high = (v[0], g[0], 1.0, 1.0), (v[-1], g[-1], *most)
    for place in lot.uniform(low, high, (count, 4)).tolist():
        yield tuple(place)


@dataclass(frozen=True)
class Between:
    """A blend at a place between the nodes, played on the device there, beside the optimum there."""

    blended: float
    optimum: float


def between(scene: Scene, library: Library, count: int, seed: int, along: tuple[int, ...]) -> list[Between]:
    """Tap errors of blends and optima at random places between the nodes of some axes; the others stay at a node.

    Parameters
    ----------
    along : 0 speed, 1 grip, 2 normal, 3 posture.
    """
    lot, context = np.random.default_rng(seed), Context.recorded(scene, recordings_of(scene))
    numbered = (np.arange(1.0, size + 1) for size in library.axes.sizes[1:])
    nodes = [library.speeds_m_s, library.grips_N, *numbered]
    found = []
    for place in places(library, lot, count):
        at = [x if axis in along else float(lot.choice(nodes[axis])) for axis, x in enumerate(place)]
        problem = context.posed(at[0], at[1], place=(at[2], at[3])).problem
        best = optimum(problem, SolverOptions()).solution.command
        commands = np.stack([library.at(*at).command, best])
        found.append(Between(*(played.figures.tap_error for played in replayed([problem] * 2, commands))))
    return found


def linearised(scene: Scene) -> Iterator[list[str]]:
    """Every speed: how far the full arm is from the linear one over the intention, and what that does to errors."""
    context = Context.recorded(scene, recordings_of(scene))
    arm, grid = scene.arm(), scene.time_grid()
    grip = scene.grid.grips_N[0]
    for speed in scene.grid.speeds_m_s:
        worst = [0.0] * 4
        for at in arm.places:
            problem = context.posed(speed, grip, place=at).problem
            command = optimum(problem, SolverOptions()).solution.command
            full = replay_on_arm(arm, arm.place(*at), grip, speed, grid, problem.stage.amplifier, command)
            linear = problem.accelerations(command)
            tau = grid.switching_times_s
            first = np.flatnonzero((tau >= 0) & (tau < problem.intention_s))
            off = np.linalg.norm((full.acceleration_m_s2 - linear)[:, first]) / np.linalg.norm(linear[:, first])
            told = [problem.figures(each) for each in (linear, full.acceleration_m_s2)]
            moved = 1e3 * full.moved_m[first[-1]]
            points = [abs(getattr(told[1], n) - getattr(told[0], n)) for n in ("tap_error", "felt_error")]
            worst = [max(*pair) for pair in zip(worst, (moved, off, *points), strict=True)]
        yield [
            f"{speed:g} m/s",
            f"{worst[0]:.1f} mm",
            f"{100 * worst[1]:.2f} %",
            *(f"{100 * x:.2f}" for x in worst[2:]),
        ]


def main(
    page: PageFile = None,
    runs: Annotated[int, at_least(1, "timed runs of each method")] = 15,
    count: Annotated[int, at_least(1, "random blends whose limits are looked at")] = 100_000,
    off_nodes: Annotated[int, at_least(1, "random places whose optimum is solved, per axis")] = 12,
    seed: Seed = 1,
) -> int:
    on_one_thread()
    scene = load_scene(SCENE)
    problem = saturated(scene)
    timed_methods = speeds(scene, runs)
    piqp_ms = float(np.median(timed_methods[-1].ms))
    lines = [
        f"One saturated tap of `{SCENE}`: {linear_stage(problem).units.size} states, {problem.stage.motors} motors, "
        f"{problem.grid.stages} stages, on data that are already there; processor time:",
        "",
        *table(
            ("method", "median ms", "quartiles", "iterations", "J", "PIQP takes"),
            [
                [
                    each.method,
                    f"{np.median(each.ms):.1f}",
                    " to ".join(f"{q:.1f}" for q in np.percentile(each.ms, (25, 75))),
                    each.iterations,
                    f"{each.objective:.10f}",
                    f"{piqp_ms / np.median(each.ms):.1f} times as long",
                ]
                for each in timed_methods
            ],
        ),
        "",
    ]
    library = solve(scene)
    current, command = blends(library, count, seed)
    over = max(current, command) > 1 + ROUNDED
    lines += [
        f"Of {count} random blends over speed, grip, normal and posture {'some are' if over else '0 are'} over a "
        f"limit: the largest current is {current:.9f} of its limit, the largest command {command:.9f}.",
        "",
    ]
    rows = []
    for name, along in (("speed", (0,)), ("grip", (1,)), ("normal", (2,)), ("posture", (3,)), ("all", (0, 1, 2, 3))):
        found = between(scene, library, off_nodes, seed, along)
        excess = [each.blended - each.optimum for each in found]
        rows.append(
            [name, percent(max(e.optimum for e in found)), f"{100 * np.mean(excess):.2f}", f"{100 * max(excess):.2f}"]
        )
    lines += [
        f"Blends at {off_nodes} random places between the nodes, played there, beside the optimum there:",
        "",
        *table(("between nodes of", "largest optimum, %", "blend above it, mean points", "largest, points"), rows),
        "",
        "The full arm beside the linear one, the largest over all normals and postures at 1 N:",
        "",
        *table(
            ("speed", "moved in 30 ms", "off the linear plant", "tap error, points", "felt error, points"),
            list(linearised(with_values(scene, {"grid.speeds_m_s": SPEEDS_M_S}))),
        ),
    ]
    print("\n".join(lines))
    write_part(page, lines)
    return 1 if over else 0


if __name__ == "__main__":
    run(main)
