"""An LRA's click, designed, beside the best pulses of overdrive and brake that a search can find.

    python -m pytest -m long -n 0 tests/campaigns/test_lra_click.py
        --campaign="[--scene lra_click] [--volts 3,8] [--generations 150] [--seed 1] [--repeats 20]
        [--json FILE] [--part FILE]"

Drivers of LRAs play two pulses: a burst that overdrives the mass, and one of the other sign that brakes it. The trade
guesses their lengths. Here the family has seven numbers, the frequency of the carrier, amplitude, length and phase of
the burst, the pause behind it, and amplitude and length of the brake, whose phase goes on from the burst; the carrier
is a sine or a square wave, both are tried. Differential evolution (scipy) seeks the least error of the family through
the same plant, over the waveform and the time after it, started from several populations. Every command of it obeys
the same voltage; the stroke is not asked of it, which favours it.

The design is that of `transopt solve`: certified, and replayed by an integration of its own. Times are of its solver,
the median of --repeats runs of the same problem on one thread.

Asked: an error at most 0.6 of the best pulses' at 3 V and 0.2 at 8 V; the energy in the 30 ms after the target's end
lower by 10 dB; certified. It fails if something is not as asked. The solver's time is told and not asked for.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
from scipy.optimize import differential_evolution
from scipy.signal import fftconvolve

from tests.campaigns.harness import (
    JsonFile,
    PartFile,
    Seed,
    at_least,
    long_form,
    numbers_of,
    show,
    write_json,
    write_part,
)
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.design.build import build_library
from transopt.design.entry import Entry
from transopt.problem.answer import Status
from transopt.problem.problem import TransientProblem
from transopt.scene import builtin
from transopt.scene.keys import with_values
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

RING_S = 30e-3  # after the target's end
SHARE = {3.0: 0.6, 8.0: 0.2}  # of the best pulses' error that the design may have, by voltage
QUIETER_dB = 10.0
STARTS = 3  # populations of each carrier
POPULATION = 20  # times the seven numbers


@dataclass(frozen=True)
class Found:
    """One click at one voltage.

    Attributes
    ----------
    error, pulses_error : |y'' - r| / |r| of the design and of the best pulses, over waveform and tail.
    ring, pulses_ring : energy in the 30 ms after the target's end over that of the target.
    solve_ms : of the solver, median.
    certified : whether the design is proven optimal and its replay keeps every limit.
    carrier : of the best pulses. numbers : theirs, see `pulses`.
    """

    target: str
    voltage_V: float
    error: float
    pulses_error: float
    ring: float
    pulses_ring: float
    solve_ms: float
    certified: bool
    carrier: str
    numbers: list[float]

    @property
    def share(self) -> float:
        return self.error / self.pulses_error

    @property
    def quieter_dB(self) -> float:
        return 10 * float(np.log10(self.pulses_ring / self.ring))


def pulses(numbers: FloatArray, times_s: FloatArray, limit: float, carrier: str) -> FloatArray:
    """(N,) overdrive and brake of one carrier, clipped at the limit."""
    frequency_Hz, drive, length_s, phase, pause_s, brake, brake_s = numbers
    wave = np.sin(2 * np.pi * frequency_Hz * times_s + phase)
    if carrier == "square":
        wave = np.sign(wave)
    begins = length_s + pause_s
    size = np.where(times_s < length_s, drive, 0.0)
    size = np.where((times_s >= begins) & (times_s < begins + brake_s), -brake, size)
    return np.clip(limit * size * wave, -limit, limit)


def best_pulses(
    problem: TransientProblem, frequency_Hz: float, generations: int, seed: int
) -> tuple[float, str, FloatArray]:
    """Least error of the family over waveform and tail, its carrier and its numbers."""
    grid = problem.grid
    times = grid.dt_s * np.arange(grid.stages)
    impulse = problem.stage.rollout(np.eye(1, grid.stages + grid.after_stages)[0])[0]
    wanted = problem.target.continued_m_s2
    energy = float(wanted @ wanted)
    limit = problem.limits.input_limit
    bounds = [
        (0.4 * frequency_Hz, 2.5 * frequency_Hz),
        (0.05, 1.5),
        (0.3 / frequency_Hz, 4.0 / frequency_Hz),
        (0.0, 2 * np.pi),
        (0.0, 1.0 / frequency_Hz),
        (0.0, 1.5),
        (0.0, 4.0 / frequency_Hz),
    ]

    def error(numbers: FloatArray, carrier: str) -> float:
        command = pulses(numbers, times, limit, carrier)
        command[problem.free_stages :] = 0.0
        made = fftconvolve(command, impulse)[: impulse.size]
        return float(np.sum((made - wanted) ** 2)) / energy

    found = [
        (run.fun, carrier, run.x)
        for carrier in ("sine", "square")
        for start in range(STARTS)
        for run in [
            differential_evolution(
                error, bounds, args=(carrier,), maxiter=generations, popsize=POPULATION, rng=seed + start, tol=1e-8
            )
        ]
    ]
    least, carrier, numbers = min(found, key=lambda each: each[0])
    return float(np.sqrt(least)), carrier, np.asarray(numbers)


def ringing(problem: TransientProblem, command: FloatArray, ends_s: float) -> tuple[float, float]:
    """Error over waveform and tail, and the energy in the 30 ms after the target's end over that of the target."""
    made = problem.accelerations(command)[0]
    wanted = problem.target.continued_m_s2
    times = problem.grid.switching_times_s[0] + problem.grid.dt_s * np.arange(made.size)
    after = (times > ends_s) & (times <= ends_s + RING_S)
    energy = float(wanted @ wanted)
    return float(np.sqrt(np.sum((made - wanted) ** 2) / energy)), float(made[after] @ made[after]) / energy


@one_blas_thread()
def compared(entry: Entry, frequency_Hz: float, ends_s: float, generations: int, seed: int, repeats: int) -> Found:
    """The design of an entry beside the best pulses."""
    problem = entry.problem
    _, carrier, numbers = best_pulses(problem, frequency_Hz, generations, seed)
    rival = pulses(numbers, problem.grid.dt_s * np.arange(problem.grid.stages), problem.limits.input_limit, carrier)
    rival[problem.free_stages :] = 0.0
    error, ring = ringing(problem, entry.solution.command, ends_s)
    pulses_error, pulses_ring = ringing(problem, rival, ends_s)
    times = [solve(problem, SolverOptions()).solve_time_s for _ in range(repeats)]
    return Found(
        target=entry.target,
        voltage_V=problem.limits.input_limit,
        error=error,
        pulses_error=pulses_error,
        ring=ring,
        pulses_ring=pulses_ring,
        solve_ms=1e3 * float(np.median(times)),
        certified=entry.status is Status.OPTIMAL,
        carrier=carrier,
        numbers=numbers.tolist(),
    )


def short_of(found: Sequence[Found]) -> list[str]:
    """What is not as asked."""
    said = []
    for each in found:
        where, share = f"{each.target} at {each.voltage_V:g} V", SHARE.get(each.voltage_V, 1.0)
        if not each.certified:
            said.append(f"{where}: not certified")
        if each.share > share:
            said.append(f"{where}: error {each.share:.2f} of the best pulses', asked {share:g}")
        if each.quieter_dB < QUIETER_dB:
            said.append(f"{where}: rings {each.quieter_dB:.1f} dB less than the best pulses, asked {QUIETER_dB:g}")
    return said


HEAD = ["click", "V", "error %", "best pulses %", "share", "ring dB", "pulses dB", "quieter dB", "ms", "carrier"]


def cells(each: Found) -> list[str]:
    """A row under `HEAD`."""
    ring, pulses_ring = (10 * np.log10(value) for value in (each.ring, each.pulses_ring))
    return [
        each.target,
        f"{each.voltage_V:g}",
        f"{100 * each.error:.2f}",
        f"{100 * each.pulses_error:.1f}",
        f"{each.share:.2f}",
        f"{ring:.1f}",
        f"{pulses_ring:.1f}",
        f"{each.quieter_dB:.1f}",
        f"{each.solve_ms:.1f}",
        each.carrier,
    ]


def main(
    scene: str = "lra_click",
    volts: str = "3,8",
    generations: Annotated[int, at_least(1)] = 150,
    seed: Seed = 1,
    repeats: Annotated[int, at_least(1, "solves of which the median time is stated")] = 20,
    json: JsonFile = None,
    part: PartFile = None,
) -> int:
    found = []
    for voltage in numbers_of(volts):
        varied = {"limits.voltage_V": voltage, "limits.steady_voltage_V": None}
        stated = with_values(builtin.load_scene(scene), varied)
        for target, (entry,) in zip(stated.targets, build_library(stated, []).entries, strict=True):
            assert target.frequency_Hz is not None
            found.append(compared(entry, target.frequency_Hz, target.lasts_s, generations, seed, repeats))
    short = short_of(found)
    lines = [*show(HEAD, [cells(each) for each in found]), *(short or ["All as asked."])]
    print("\n".join(short) or "all as asked")
    write_json([asdict(each) for each in found], json)
    write_part(part, lines)
    return 1 if short else 0


test_long_form = long_form(main)
