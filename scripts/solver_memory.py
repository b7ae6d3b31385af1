"""Runs the C interior-point solver and recursions under AddressSanitizer, UndefinedBehaviorSanitizer and valgrind.

    python scripts/solver_memory.py

`solver_memory.c` solves problems of the built-in scenes (saturated, with temperature, with repeating taps, over a
wall, at a rail, with an ideal amplifier, for several devices, with several motors), the same without limits, horizons
of one stage, infeasible limits, and problems with NaN. Its arrays have exact sizes, and all compiled vector widths
are tested. Every run has to be free of errors and to agree with the installed extension. `recursions_memory.c`
compares the recursions with explicit sums, `device_memory.c` the stages of a device in modal coordinates with those
in its states. Exit code 3: a tool is missing; the message names it.
"""

import os
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import problems
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.context import Context
from transopt.plant.wall import reference_course
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import pressing
from transopt.scene.keys import with_values
from transopt.scene.strikes import recordings
from transopt.solvers import stage_data
from transopt.solvers.native import extension
from transopt.solvers.stage_data import Stages, without_limits

SCENES = (
    *("wood_on_foam", "hot_coil", "rapid_tapping", "walled", "low_supply", "ideal_amplifier", "small_coil"),
    "stylus_3d",
)
WHOLE = ("rapid_tapping",)  # one tap after the other fills its horizon: a shorter one has no solution
STAGES = 80  # of the others: a run takes time in proportion, and no access to memory is another
SOURCE = Path(__file__).with_suffix(".c")
NATIVE = Path(__file__).parents[1] / "transopt/solvers/native"
METHOD = [NATIVE / "riccati.c", *sorted(NATIVE.glob("kernel_*.c"))]
APART = {name: SOURCE.with_name(f"{name}_memory.c") for name in ("recursions", "device")}
FLAGS = ("-std=c99", "-g1", "-ffp-contract=off", "-fno-math-errno", "-Wall", "-Wextra", "-Wno-psabi")
# AddressSanitizer tells of a wrong pointer when it is used: asking of each before that doubles the compilation.
SEEN_ANYWAY = "-fno-sanitize=null,object-size,pointer-overflow"
SANITIZED = ("-O0", "-fsanitize=address,undefined", SEEN_ANYWAY, "-fno-sanitize-recover=all")
TRACED = "-O1"  # as valgrind's manual advises: from -O2 on it may take what the compiler makes for uninitialised
VALGRIND = ("valgrind", "--quiet", "--leak-check=full", "--error-exitcode=9")
TOLERANCE = 1e-9  # relative, between compilations; strict IEEE makes it zero on most machines
MISSING = 3
WIDTHS = (1, 2, 4, 8)  # numbers in a register
TRACED_WIDTH = 4  # of the widths, the largest that valgrind's processor has


def hardest(name: str) -> TransientProblem:
    """The fastest tap under the firmest grip of a scene, over a horizon of `STAGES` unless it is one of `WHOLE`."""
    scene = problems.load(name)
    if name not in WHOLE:
        scene = with_values(scene, {"time.stages": STAGES})
    fastest, firmest = scene.grid.speeds_m_s[-1], scene.grid.grips_N[-1]
    problem = Context.recorded(scene, recordings(scene)).posed(fastest, firmest).problem
    if problem.wall is None:
        return problem
    return pressing(problem, reference_course(problem.grid, problem.target.continued_m_s2))


def shortened(problem: TransientProblem, stages: int) -> TransientProblem:
    return replace(
        problem,
        grid=replace(problem.grid, stages=stages),
        target=replace(problem.target, window_m_s2=problem.reference_m_s2[:stages] + 1.0),
        terms=tuple(replace(term, weights=term.weights[:stages]) for term in problem.terms),
        hand_over_samples=min(problem.hand_over_samples, stages),
    )


def moved(stages: Stages, lower: float, upper: float) -> Stages:
    """Move all limits of a problem."""
    by = {"lower": lower, "upper": upper}
    return replace(stages, arrays=stages.arrays | {name: stages.arrays[name] + value for name, value in by.items()})


def at_the_end(bounds: FloatArray) -> FloatArray:
    """(N + 1, rows) bounds with those of stage N - 1 at stage N too."""
    return np.concatenate([bounds[:-1], bounds[-2:-1]])


def cases() -> Iterator[Stages]:
    found = {name: hardest(name) for name in SCENES}
    plain = found["wood_on_foam"].without("temperature")
    for problem in found.values():
        yield stage_data.stages(problem)
        yield without_limits(problem)
    yield stage_data.stages(replace(plain, spread=(plain.stage, plain.stage)))
    for stages in (1, 2, 12):
        yield stage_data.stages(shortened(plain, stages))
        yield without_limits(shortened(plain, stages))
    tight = stage_data.stages(found["walled"])
    yield moved(tight, 2.0, 2.0)  # infeasible: the limits exclude zero, where every hand-over ends
    yield moved(tight, 0.0, -2.0)  # infeasible: upper limits below the lower ones
    # At the last instant, which no command moves any more, the limits of the one before.
    yield replace(tight, arrays=tight.arrays | {name: at_the_end(tight.arrays[name]) for name in ("lower", "upper")})
    given = stage_data.stages(plain)
    nothing = np.full_like(given.arrays["reference"], np.nan)
    yield replace(given, arrays=given.arrays | {"reference": nothing})
    idle = tuple(replace(term, weights=np.zeros(plain.grid.stages)) for term in plain.terms)
    yield without_limits(replace(plain, rho=0.0, terms=idle))


def written(stages: Stages) -> bytes:
    """A problem in the format of `solver_memory.c`."""
    integers = [stages.sizes[name] for name in stage_data.SIZES]
    numbers = [stages.numbers[name] for name in stage_data.NUMBERS]
    arrays = [stages.arrays[name] for name in stage_data.ARRAYS]
    head = struct.pack(f"={len(integers)}i{len(numbers)}d", *integers, *numbers)  # without gaps between the kinds
    lengths = struct.pack(f"{len(arrays)}q", *(array.size for array in arrays))
    return head + lengths + b"".join(array.tobytes() for array in arrays)


def solving(given: Sequence[Stages]) -> str:
    """The flag that compiles the lengths of these problems' rows only, which saves most of the compilation time."""
    sizes = sorted({tuple(stages.sizes[name] for name in ("states", "motors", "nodes")) for stages in given})
    each = ("((ld)==BLOCKS({})*PER&&(m)=={}&&(t)=={})".format(*size) for size in sizes)
    return "-DSOLVES(ld,m,t)=(" + "||".join(each) + ")"


def expected(stages: Stages) -> list[list[float]]:
    """The installed extension's result for a problem, in the driver's format, with the solution once."""
    try:
        (answer,) = extension.interior_points([stages], tolerance=1e-9, max_iterations=60)
    except InputError:
        return [[extension.NO_BOUNDS, 0, 0.0, 0.0]]
    answers, proofs = [answer], list[list[float]]()
    if not stages.sizes["nodes"] and answer.code <= extension.ACCURACY:
        proofs = [proved(stages, answer, bare=bare) for bare in (True, False)]
    if not stages.sizes["repeated"] and stages.sizes["free_stages"] > 1:
        cut = (stages.sizes["free_stages"] + 1) // 2
        answers += extension.interior_points([stages], tolerance=1e-9, max_iterations=60, cut=cut)
    if not stages.sizes["rows"] and not stages.sizes["nodes"]:
        answers += extension.linear_passes([stages], 1e-9)
    told = [
        [
            a.code,
            a.iterations if stages.sizes["rows"] else 0,
            a.objective if a.code <= extension.ACCURACY else 0.0,
            a.command.sum(),
        ]
        for a in answers
    ]
    return [told[0], *proofs, *told[1:]]


def beside(rows: Sequence[list[float]], width: int) -> list[list[float]]:
    """A problem's expected rows by the driver for this width; limits that are none are told once."""
    return [*rows[:1] * (1 if rows[0][0] == extension.NO_BOUNDS else width + 1), *rows[1:]]


def proved(stages: Stages, answer: extension.Answer, *, bare: bool) -> list[float]:
    """The installed extension's certificate of an answer; with `bare`, without multipliers of the rows."""
    N, rule = stages.sizes["stages"], -np.atleast_2d(answer.gradient).T[stages.sizes["free_stages"] :]
    own = np.ascontiguousarray([stages.arrays[name].reshape(N + 1, -1)[:N] for name in ("lower", "upper")])
    stages = replace(stages, limits=replace(stages.limits, asked=own)) if stages.sizes["rows"] else stages
    by_row = None if bare else np.stack([answer.lower[:N], answer.upper[:N]])
    excess, objective, *rest = extension.prove([stages], np.atleast_2d(answer.command).T[None], [by_row], rule[None])
    most = max(float(excess.max(initial=0.0)), 0.0)
    left = {name: float(of[0]) for name, of in zip(extension.Proofs._fields[2:], rest, strict=True)}
    of_gap = sum(left[name] for name in ("slack", "residual", "by_command", "by_movement"))
    return [0, 0, float(objective[0]), of_gap + most]


def gcc() -> str:
    return shutil.which("gcc") or shutil.which("cc") or ""


@cache
def sanitizing() -> str:
    """Clang, which takes half of gcc's time, where it links with its sanitizers; else gcc.

    Under valgrind runs what gcc has compiled: it does not read clang's debug information.
    """
    if shutil.which("clang") is None:
        return gcc()
    linked = ["clang", *SANITIZED, "-x", "c", "-", "-o", os.devnull]
    done = subprocess.run(linked, input=b"int main(void) { return 0; }", capture_output=True, check=False)
    return gcc() if done.returncode else "clang"


def sanitized_or_traced(
    name: str, sources: Sequence[Path], flags: Sequence[str], given: Sequence[Path], folder: Path
) -> str:
    """Output of a driver compiled with these flags; empty if a tool reported an error, which is printed.

    Parameters
    ----------
    name : name of the run; the run `valgrind` is executed under valgrind.
    """
    driver = str(folder / f"{sources[0].stem}, {name}")
    compiler = gcc() if name == "valgrind" else sanitizing()
    subprocess.run([compiler, *FLAGS, *flags, *map(str, sources), "-o", driver, "-lm"], check=True)
    command = [*(VALGRIND if name == "valgrind" else ()), driver, *map(str, given)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    if done.returncode:
        print(f"{sources[0].stem}, {name}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
        return ""
    return done.stdout


def agrees(said: str, wanted: Sequence[Sequence[float]]) -> bool:
    """Whether a driver's output agrees with the installed extension's.

    Where rounding ends a search, the number of steps may differ and is not compared. What a certificate leaves is
    compared as a share of the objective, whose rounding it is.
    """
    kinds, *_ = zip(*(line.split() for line in said.splitlines()), strict=True)
    found = np.array([[float(word) for word in line.split()[1:]] for line in said.splitlines()])
    expected = np.array(wanted)
    if found.shape != expected.shape or (found[:, 0] != expected[:, 0]).any():
        return False
    ended = expected[:, 0] == extension.ACCURACY
    found[ended, 1] = expected[ended, 1]
    left = np.isin(kinds, ("bare", "proof"))
    for rows in (found, expected):
        rows[left, 3] /= np.maximum(np.abs(expected[left, 2]), 1.0)
    answered = expected[:, 0] <= extension.ACCURACY
    return np.allclose(found[answered], expected[answered], rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True)


def main() -> int:
    if not gcc() or not extension.available:
        print("no C compiler, or the extension is not built: nothing to check")
        return MISSING
    given = list(cases())
    wanted = [expected(stages) for stages in given]
    sizes = solving(given)
    runs = {f"sanitizers, {width} wide": (SANITIZED, width) for width in WIDTHS}
    traced = {} if shutil.which("valgrind") is None else {"valgrind": ((TRACED,), TRACED_WIDTH)}
    runs |= traced
    with tempfile.TemporaryDirectory() as made, ThreadPoolExecutor(2) as pool:
        folder = Path(made)
        data = folder / "problems"
        data.write_bytes(struct.pack("i", len(given)) + b"".join(written(stages) for stages in given))
        solved = {
            name: pool.submit(
                sanitized_or_traced, name, [SOURCE, *METHOD], (*flags, f"-DONLY_WIDTH={width}", sizes), [data], folder
            )
            for name, (flags, width) in runs.items()
        }
        summed = {
            f"{part}, {name}": pool.submit(sanitized_or_traced, name, [source], flags, [], folder)
            for part, source in APART.items()
            for name, (flags, _) in ({"sanitizers": (SANITIZED, 1)} | traced).items()
        }
        for name, run in solved.items():
            if not run.result():
                return 1
            rows = [row for of in wanted for row in beside(of, runs[name][1])]
            if not agrees(run.result(), rows):
                print(f"{name}: other answers than the installed extension\n{run.result()}\n{rows}")
                return 1
            print(f"{name}: {len(given)} problems, {len(rows)} answers, clean")
        for name, run in summed.items():
            if not run.result():
                return 1
            print(f"{name}: {run.result().strip()} cases, clean")
    if "valgrind" not in runs:
        print("valgrind is not installed: not run")
        return MISSING
    return 0


if __name__ == "__main__":
    sys.exit(main())
