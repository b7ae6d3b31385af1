"""The peers and cases of `benchmark.py`: what is timed, and how its answer is judged."""

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import numpy as np
from precision.methods import Setting
from precision.qp import project_multipliers, quadratic_program
from precision.wheels import piqp_multistage

import problems
from common.measuring import elapsed_ms, forget, timed
from common.peers import commonly_written
from controller.firmware.core_servo import CoreServo
from controller.host.payload import payload_of
from controller.sim.played_tap import run as play
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import TapsInTurn
from transopt.base.signals import FloatArray
from transopt.design.build import build_library
from transopt.design.context import Context
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.library.library import Library
from transopt.library.online import Online
from transopt.problem.answer import Multipliers, Solution
from transopt.problem.limits import limits_of
from transopt.problem.limits.command import CommandLimit
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify
from transopt.scene.keys import with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.solvers import riccati, unlimited
from transopt.solvers.choose import solve
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions
from transopt.solvers.stage_data import without_limits

WIDE = {
    "speeds_m_s": np.linspace(0.1, 0.4, 20).round(6).tolist(),
    "grips_N": np.linspace(1.0, 5.0, 10).round(6).tolist(),
}
REPEATS = "recordings.simulated.repeats"
ONLINE_TAPS = 1000
TWELVE, TWO_HUNDRED = "transopt", "transopt, 20 x 10"  # libraries of as many entries
STAGES = 800  # of the default scene
BESIDE = 8  # entries: as many as the widest registers take


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
    package = "piqp" if method == "piqp" else "casadi" if method.startswith(("casadi", "opti")) else "transopt"
    version = metadata.version(package)
    return Row(case, method, version, options, 1, stages, setup_ms, median, q25, q75, times_ms.size, gap, violation)


def entry(scene: Scene, speed_m_s: float, grip_N: float) -> TransientProblem:
    """One entry of the scene, its window alone, within the limits of current and command."""
    problem = Context.recorded(scene, recordings(scene)).posed(speed_m_s, grip_N).problem
    amplifier = scene.amplifier_model()
    assert amplifier is not None
    nothing = np.zeros(0)
    return replace(
        problem,
        grid=replace(problem.grid, after_stages=0),
        target=replace(problem.target, after_m_s2=nothing, free_after_m_s2=nothing),
        limits=limits_of(CurrentLimit(scene.limits.transient_input), CommandLimit(amplifier.command_limit)),
    )


@dataclass(frozen=True)
class Peer:
    """A method ready to be timed: one run, its set-up time, and the gap and violation of its answer."""

    name: str
    options: str
    run: Callable[[], object]
    setup_ms: float
    gap: float
    violation: float


def reused(name: str, options: str, method: Callable[[], Solution], problem: TransientProblem) -> Peer:
    """A method of the project; its set-up time is the excess of a first call without caches."""
    forget()
    first, second = (elapsed_ms(method) for _ in range(2))
    solution = method()
    proof = certify(problem, solution.command, solution.multipliers)
    said = options or f"tol {SolverOptions().tolerance:g}, object reused"
    return Peer(name, said, method, max(first - second, 0.0), proof.relative_gap, proof.primal_violation)


def designed_entry(name: str, scene: Scene, speed_m_s: float, grip_N: float, after_s: float) -> Peer:
    """The design of a library's entry, from its reference to its prices, with a tail of so many seconds."""
    weights = scene.weights.model_copy(update={"after_s": after_s})
    scene = scene.model_copy(update={"weights": weights})
    wanted, options = references_of(scene, recordings(scene)).at(speed_m_s, grip_N), SolverOptions()

    def run() -> Entry:
        return design([Context(scene).posed_as(wanted, grip_N)], options=options)[0]

    first, second = (elapsed_ms(run) for _ in range(2))
    proof = run().certificate
    said = f"{1e3 * after_s:g} ms after the window"
    return Peer(name, said, run, max(first - second, 0.0), proof.relative_gap, proof.primal_violation)


def project_solver(problem: TransientProblem, solver: str) -> Peer:
    return reused(solver, "", lambda: solve(problem, SolverOptions(solver)), problem)


def unlimited_solver(
    name: str, options: str, method: Callable[[TransientProblem], Solution], problem: TransientProblem
) -> Peer:
    return reused(name, f"{options}: {method(problem).message}", lambda: method(problem), problem)


def direct_piqp(problem: TransientProblem) -> Peer:
    """PIQP called directly, on a QP that is already set up."""
    start = time.perf_counter()
    qp = quadratic_program("saturated", problem)
    run = piqp_multistage(qp, Setting("", SolverOptions().tolerance))
    point = run()
    setup_ms = max(1e3 * (time.perf_counter() - start) - elapsed_ms(run), 0.0)
    assert point.y is not None
    proof = certify(problem, qp.command(point.x), project_multipliers(problem, qp, point.y))
    return Peer("piqp", "sparse_multistage, direct", run, setup_ms, proof.relative_gap, proof.primal_violation)


def side_by_side(problem: TransientProblem) -> Peer:
    """The project's method on eight entries at once."""
    several = [problem] * BESIDE

    def run() -> list[Solution]:
        return riccati.solve(several, SolverOptions())

    answer = run()[0]
    proof = certify(problem, answer.command, answer.multipliers)
    return Peer(
        f"riccati, {BESIDE} side by side", "all of them", run, 0.0, proof.relative_gap, proof.primal_violation
    )


def opti_ipopt(problem: TransientProblem, lower_bound: float) -> Peer:
    """The problem in CasADi's Opti, solved by IPOPT with its defaults."""
    start = time.perf_counter()
    opti, commands = commonly_written(problem)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    found = np.asarray(opti.solve().value(commands)).ravel()
    setup_and_first = 1e3 * (time.perf_counter() - start)

    def again() -> None:
        opti.set_initial(opti.x, 0)
        opti.solve()

    proof = certify(problem, found, Multipliers.zero(problem))
    setup_ms = max(setup_and_first - elapsed_ms(again), 0.0)
    gap = (proof.objective - lower_bound) / max(proof.objective, 1e-3)
    options = "as commonly written, IPOPT defaults, object reused"
    return Peer("opti-ipopt", options, again, setup_ms, gap, proof.primal_violation)


@dataclass(frozen=True)
class Case:
    """One peer on one case."""

    name: str
    stages: int
    peer: Peer


def compare(runs: int, *cases: Case) -> list[Row]:
    """Rows of the cases, whose runs take turns."""
    times = timed(runs, **{f"{case.name} {case.peer.name}": case.peer.run for case in cases})
    found = []
    for case in cases:
        peer, own = case.peer, times[f"{case.name} {case.peer.name}"]
        worth = {"setup_ms": peer.setup_ms, "gap": peer.gap, "violation": peer.violation}
        found.append(row(case.name, peer.name, peer.options, case.stages, own, **worth))
    return found


def calibration() -> Row:
    """A fixed workload: 200 products and factorisations of 200 x 200 matrices."""
    matrix = np.random.default_rng(0).standard_normal((200, 200))
    spd = matrix @ matrix.T + 200 * np.eye(200)

    def work() -> None:
        for _ in range(200):
            np.linalg.cholesky(spd)
            matrix @ matrix

    return row("calibration", "numpy", "200 x (product + Cholesky) of 200 x 200", 0, timed(7, work=work)["work"])


def cold_start(runs: int, *arguments: str) -> tuple[FloatArray, float]:
    """(runs,) times [ms] of `transopt solve` in a fresh process, figures included; and its peak memory [MB].

    It may keep its bytecode, as an installed program does; otherwise most of the time would be that of the compiler.
    """
    keeping = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    resource = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL); "
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)"
    )
    times, memory = [], 0.0
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            solving = [sys.executable, "-c", "from transopt.cli.main import main; main()", "solve", *arguments]
            command = [sys.executable, "-c", resource, *solving, "--out", folder]
            done = subprocess.run(command, check=True, capture_output=True, text=True, env=keeping)
            times.append(1e3 * (time.perf_counter() - start))
            memory = max(memory, float(done.stdout))
    return np.array(times), memory


def wide(scene: Scene) -> Scene:
    """The scene on 20 speeds and 10 grips, tapped once at each."""
    return with_values(scene, {**{f"grid.{key}": values for key, values in WIDE.items()}, REPEATS: 1})


def wide_scene_file(folder: Path) -> Path:
    """wood_on_foam on the same grid, as a file."""
    text = problems.scene_path("wood_on_foam").read_text(encoding="utf-8")
    for key, values in WIDE.items():
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {values}", text)
    text = re.sub(r"(?m)^repeats = .*$", "repeats = 1", text)
    file = folder / "wide.toml"
    file.write_text(text, encoding="utf-8")
    return file


def libraries(scene: Scene, runs: int) -> tuple[list[Row], Library]:
    """The scene's own library and the wide one, warm and from process start."""
    taps, taps_of_wide = recordings(scene), recordings(wide(scene))

    def read() -> None:
        for each in build_library(scene, taps).all_entries():
            each.prices, each.baselines  # noqa: B018, made when they are read

    times = timed(
        runs,
        library=lambda: build_library(scene, taps),
        read=read,
        wide=lambda: build_library(wide(scene), taps_of_wide),
    )
    told = "solved, certified, replayed"
    library = build_library(scene, taps).library
    assert library is not None
    found = [
        row("library", TWELVE, f"12 entries {told}", STAGES, times["library"]),
        row("library", "transopt, all read", f"12 entries {told}, priced, with baselines", STAGES, times["read"]),
        row("library", TWO_HUNDRED, f"200 entries {told}", STAGES, times["wide"]),
    ]
    with tempfile.TemporaryDirectory() as folder:
        for included, options in {"report": ("--no-figures",), "report and figures": ()}.items():
            cold, _ = cold_start(3, str(wide_scene_file(Path(folder))), *options)
            told = f"cold, {included} included"
            found.append(row("library", " ".join(("transopt solve, 20 x 10", *options)), told, STAGES, cold))
    return found, library


def anew(library: Library) -> list[Row]:
    """Rows of `library.online` at random speeds, grips and temperatures, with certificates; second near the limit."""
    solver, coil = Online(library, library.scene().plant), library.coil()
    assert coil is not None
    found = []
    for name, coldest_C in (("riccati", coil.ambient_C), ("riccati, coil binds", coil.limit_C - 0.1)):
        random, times, gaps = np.random.default_rng(1), [], []
        for _ in range(ONLINE_TAPS):
            speed = random.uniform(library.speeds_m_s[0], library.speeds_m_s[-1])
            grip = random.uniform(library.grips_N[0], library.grips_N[-1])
            tap = solver.solve(speed, grip, random.uniform(coldest_C, coil.limit_C))
            assert tap.certificate is not None, tap.remark
            times.append(1e3 * tap.elapsed_s)
            gaps.append(tap.certificate.relative_gap)
        told = (
            f"random taps, certified; 99 % within {np.percentile(times, 99):.2f} ms, all within {max(times):.2f} ms"
        )
        found.append(row("online", name, told, library.command.shape[2], np.array(times), gap=max(gaps)))
    return found


@dataclass(frozen=True)
class Iterations:
    """Times of an iteration of the project's method and of a linear pass, both in C [ms].

    Attributes
    ----------
    linear_pass : one factorisation, backward and forward with its gains, and backward for the proof; without rows.
    """

    count: int
    each: float
    linear_pass: float

    @property
    def ratio(self) -> float:
        """Ratio of an iteration, which has two vector solves and the rows, to a linear pass; the bound is 2."""
        return self.each / self.linear_pass


def iterations(problem: TransientProblem, runs: int) -> Iterations:
    given, bare = riccati.stages(problem), without_limits(problem)

    def whole() -> extension.Answer:
        return extension.interior_points([given], tolerance=1e-9, max_iterations=250)[0]

    times = timed(runs, whole=whole, linear=lambda: extension.linear_passes([bare], unlimited.GAP))
    whole_ms, linear_ms = (float(np.median(times[name])) for name in ("whole", "linear"))
    count = whole().iterations
    return Iterations(count, whole_ms / count, linear_ms)


def servo_and_simulator(library: Library, runs: int) -> Row:
    """A simulated second of random taps (servo, plant, sensors, hand), new in every run, so that none is cached."""
    given = payload_of(library)
    device, dt_s = device_of(library.scene()), given.settings.dt_s
    ticks = round(1 / dt_s)
    seeds = iter(range(runs + 1))

    def second() -> None:
        seed = next(seeds)
        servo = CoreServo(given.settings, given.image)
        servo.arm()
        imperfections = Imperfections(mismatch=0.1)
        # Without friction the motion is exact in any step; one before and one after the delay's end.
        random = np.random.default_rng([seed, 4])
        user = TapsInTurn([(random.uniform(0.05, 1.0), random.uniform(0.0, 10.0)) for _ in range(4)])
        simulator = Simulator(device, user, dt_s, imperfections=imperfections, seed=seed, steps=1)
        play(simulator, servo, ticks)

    times = timed(runs, online=second)["online"]
    return row("online", "servo + simulator", "one virtual second of random taps, two steps per tick", ticks, times)


def own(case: str, problem: TransientProblem) -> list[Case]:
    """The project's compiled method, if it is built."""
    return [Case(case, problem.grid.stages, project_solver(problem, "riccati"))] if riccati.available else []
