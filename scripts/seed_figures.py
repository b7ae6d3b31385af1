"""The seed's experiment: its Figs. 1, 5, 6, 7 and 10 and the comparisons of its text, from models and simulator.

    python scripts/seed_figures.py --out DIR [--devices 20] [--jobs 2]

Writes seed.md, which shows figures and tables, the figures themselves, and CSV files: taps.csv and off_nodes.csv (one
row per tap), methods.csv (one per method), limits.csv (one per condition). Nine minutes on two shared cores.
"""

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import seed.device as seed_device
from common.command import at_least, run
from common.page import PageFile, write_part
from seed.comparison import NOMINAL, Condition, Kit, compare, kit, midpoints, nodes, result, summarise
from seed.plots import Series, blind_line, method_figure, optimum_line, steady_line, tap_grid
from seed.report import (
    Compared,
    ahead_of_all,
    felt_table,
    how_measured,
    limit_felt_table,
    limit_table,
    limit_words,
    method_table,
    real_tap_table,
    shape_table,
)
from typer import Option

import problems
from controller.sim.played_tap import Played
from controller.waveforms.bank import Method
from transopt.base.errors import InputError
from transopt.base.machine import machine, versions
from transopt.base.plotting import save_figure
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.terminal import make_folder
from transopt.base.writing import table, write_csv, write_text
from transopt.design.build import build_library
from transopt.identify.hand.lines import HandFit
from transopt.library.library import Library
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.solvers import unlimited

SCENE = "wood_on_foam"
# From the optimum to what came before the seed.
METHODS = (
    Method.BILINEAR,
    Method.NEAREST,
    Method.CLIPPED_OPTIMUM,
    Method.SEED_INVERSION,
    Method.BLIND,
    Method.FIXED_WIDTH_PULSE,
    Method.DECAYING_SINUSOID,
    Method.MOMENTUM_CANCELLATION,
    Method.PROPORTIONAL,
)
AS_THE_SEED = seed_device.Recorded()


@dataclass(frozen=True)
class Experiment:
    """What is tapped.

    Attributes
    ----------
    library, steady : of one scene, at the transient limit and at the steady one. conditions : nodes of both.
    methods : the bilinear optimum has to be among them. devices : mismatched ones.
    """

    library: Library
    steady: Library
    conditions: Sequence[Condition]
    methods: Sequence[Method]
    devices: int
    jobs: int

    @property
    def scene(self) -> Scene:
        return self.library.scene()

    @property
    def limits_A(self) -> tuple[float, float]:
        return self.library.input_limit, self.steady.input_limit


def libraries(scene: Scene) -> tuple[Library, Library]:
    """The scene's library, and one that keeps the motor's steady current at all times."""
    limits = scene.limits.model_copy(update={"beta": 1.0, "current_A": None})
    made = [
        build_library(one, recordings(scene)).library for one in (scene, scene.model_copy(update={"limits": limits}))
    ]
    if made[0] is None or made[1] is None:
        raise InputError(f"{scene.name}: entries refused, no library to play")
    return made[0], made[1]


# ------------------------------------------------------------------------------------------------ device


def device_figures(
    scene: Scene, conditions: Sequence[Condition], recorded: seed_device.Recorded, out: Path
) -> list[str]:
    """Figs. 1, 5, 6 and 7 into `out`; their part of seed.md."""
    speeds, grips = (list(dict.fromkeys(c[j] for c in conditions)) for j in (0, 1))
    grip_N, speed_m_s = grips[len(grips) // 2], speeds[len(speeds) // 2]
    by_speed = [seed_device.real_tap(scene, v, grip_N) for v in speeds]
    by_grip = [seed_device.real_tap(scene, speed_m_s, F) for F in (seed_device.SOFT_N, seed_device.FIRM_N)]
    save_figure(seed_device.real_taps_figure(by_speed, by_grip, scene.name), out / "fig01_real_taps.png")

    hand = seed_device.hand_fit(scene, recorded)
    save_figure(seed_device.hand_figure(hand, scene.name), out / "fig05_hand.png")

    amplifier = scene.amplifier_model()
    assert amplifier is not None
    sweeps = seed_device.amplifier_sweeps(scene, recorded)
    drawn = seed_device.amplifier_figure(amplifier, sweeps, scene.time.dt_s, scene.name)
    save_figure(drawn, out / "fig06_amplifier.png")

    measured = {F: seed_device.sweep_response(scene, F, recorded) for F in recorded.grips_N}
    off = [seed_device.deviation(scene, F, found, max(5.0, found.frequencies_Hz[0])) for F, found in measured.items()]
    save_figure(seed_device.family_figure(scene, measured), out / "fig07_grips.png")
    shapes = [seed_device.shape(scene, F) for F in recorded.grips_N]
    return [
        "## Fig. 1: real taps",
        "",
        "![Fig. 1](fig01_real_taps.png)",
        "",
        f"The undriven stylus strikes the scene's real object, by speed (left) and grip (right): {_alike(by_grip)}",
        "",
        *real_tap_table([*by_speed, *by_grip]),
        "## Fig. 5: the hand",
        "",
        "![Fig. 5](fig05_hand.png)",
        "",
        *hand_words(hand),
        "",
        "## Fig. 6: the amplifier before and after the prefilter",
        "",
        "![Fig. 6](fig06_amplifier.png)",
        "",
        *amplifier_words(sweeps),
        "",
        "## Fig. 7: the grips",
        "",
        "![Fig. 7](fig07_grips.png)",
        "",
        f"{recorded.trials} sweeps of {seed_device.SWEEP_A:g} A and {recorded.sweep_s:g} s at each grip, every other "
        "one of the other polarity, as the amplifier's monitor and the noisy accelerometer read them, beside the "
        f"models: at most {max(size for size, _ in off):.2f} dB and {max(turned for _, turned in off):.1f} degrees "
        "rms apart from 5 Hz on (the free device from 20 Hz on). The grip acts below 100 Hz.",
        "",
        *shape_table(shapes),
    ]


def _alike(taps: Sequence[seed_device.RealTap]) -> str:
    """Acceleration and force of the soft and the firm tap, in a sentence."""
    soft, firm = taps
    return (
        f"at {soft.grip_N:g} and {firm.grip_N:g} N accelerations of {soft.peak_g:.2f} and {firm.peak_g:.2f} g, "
        f"forces of {soft.peak_N:.1f} and {firm.peak_N:.1f} N. The seed finds the accelerations alike, "
        "the forces apart."
    )


def hand_words(hand: HandFit) -> list[str]:
    """The lines over grip beside those of the seed."""
    rows = []
    for line in hand.lines:
        constant, slope = seed_device.SEED_LINES[line.quantity]
        own = f"{line.line.constant:.4g} {line.line.per_newton:+.3g} F"
        rows.append([seed_device.HAND_WORDS[line.quantity], own, f"{constant:g} {slope:+g} F"])
    return [
        f"Mass, damper and spring of {len(hand.fits)} real taps with random speeds, each by the least squares of the "
        f"seed's Eq. 2; {100 * hand.unexplained:.1f} % of the force is left unexplained. F is the grip in newtons. "
        "The hands are not the same: what moves in the seed's weighs five times as much.",
        "",
        *table(["quantity", "its line over grip", "seed, Eqs. 3 to 5"], rows),
    ]


def amplifier_words(sweeps: Sequence[seed_device.Swept]) -> list[str]:
    """Up to which frequency the current follows within 3 dB, before and after the prefilter."""
    rows = [
        [f"{each.offset_A:+g} A", f"{seed_device.widest(each.before):.0f}", f"{seed_device.widest(each.after):.0f}"]
        for each in sweeps
    ]
    return [
        "Swept sines around three offsets through the simulated amplifier; only around 0 A is its dead band passed. "
        "Up to these frequencies the current stays within 3 dB of what was asked for:",
        "",
        *table(["around", "before, Hz", "after the prefilter, Hz"], rows),
    ]


# ------------------------------------------------------------------------------------------------ taps


def _compared(experiment: Experiment, condition: Condition, taps: dict[str, Played]) -> Compared:
    library, (_, low) = experiment.library, experiment.limits_A
    iv, ig = library.speeds_m_s.tolist().index(condition[0]), library.grips_N.tolist().index(condition[1])
    problem = library.problem(iv, ig)
    _, current = problem.stage.rollout(unlimited.solve([problem])[0].command)
    told = {name: result(library, played, Method.BILINEAR, NOMINAL) for name, played in taps.items()}
    own, g = taps["optimum"], STANDARD_GRAVITY_M_S2
    return Compared(
        speed_m_s=condition[0],
        grip_N=condition[1],
        needed_A=float(np.abs(current).max()),
        over_ms=1e3 * library.dt_s * int(np.sum(np.abs(current) > low)),
        reference_g=float(np.abs(own.prediction.recorded_m_s2).max()) / g,
        peak_g=own.peak_m_s2 / g,
        peak_steady_g=taps["optimum_steady"].peak_m_s2 / g,
        playback_error=own.playback_error,
        latency_s=own.latency_s,
        **{name: each.tap_error for name, each in told.items()},
        **{f"{name}_felt": each.felt_error for name, each in told.items()},
        **{f"{name}_speed": each.speed for name, each in told.items()},
    )


def played_figures(experiment: Experiment, out: Path) -> list[str]:
    """Fig. 10 with its comparisons, nominal device, into `out`; its part of seed.md."""
    own = kit(experiment.library, (Method.BILINEAR, Method.BLIND, Method.SEED_INVERSION))
    low = kit(experiment.steady, (Method.BILINEAR, Method.SEED_INVERSION))
    ways: dict[str, tuple[Kit, Method]] = {
        "optimum": (own, Method.BILINEAR),
        "optimum_steady": (low, Method.BILINEAR),
        "seed": (own, Method.SEED_INVERSION),
        "seed_steady": (low, Method.SEED_INVERSION),
        "blind": (own, Method.BLIND),
    }
    taps = {
        name: {condition: with_kit.play(method, NOMINAL, condition) for condition in experiment.conditions}
        for name, (with_kit, method) in ways.items()
    }
    high_A, low_A = experiment.limits_A
    optimum = Series(f"played, {high_A:g} A", taps["optimum"], optimum_line())
    steady = Series(f"optimum at {low_A:g} A", taps["optimum_steady"], steady_line())
    blind = Series("blind grip", taps["blind"], blind_line())
    save_figure(tap_grid([optimum], [high_A], predicted=True), out / "fig10_played.png")
    other = Series(f"optimum at {high_A:g} A", taps["optimum"], optimum_line())
    save_figure(tap_grid([other, steady, blind], [high_A, low_A], predicted=False), out / "fig10_compared.png")
    compared = [
        _compared(experiment, condition, {name: played[condition] for name, played in taps.items()})
        for condition in experiment.conditions
    ]
    write_csv(compared, out / "limits.csv")
    return [
        "## Fig. 10: taps as played",
        "",
        "![Fig. 10](fig10_played.png)",
        "",
        "Closed loop on the nominal device: recorded tap, the library's prediction, and what was played.",
        "",
        f"## Fig. 10 again: {high_A:g} A against {low_A:g} A, compensated against blind grip",
        "",
        "![Fig. 10, compared](fig10_compared.png)",
        "",
        *limit_words(compared, experiment.limits_A),
        "Tap error in % after the shift, nominal device; *needed* is the peak of the unlimited optimum.",
        "",
        *limit_table(compared, experiment.limits_A),
        "Felt error in %, speed and peak acceleration of the same taps.",
        "",
        *limit_felt_table(compared, experiment.limits_A),
    ]


def method_comparison(experiment: Experiment, out: Path) -> list[str]:
    """Every method on every device into `out`; its part of seed.md."""
    own = kit(experiment.library, experiment.methods)
    started = time.perf_counter()
    last_told = 0.0

    def tell(done: int, total: int) -> None:
        nonlocal last_told
        if done == total or time.perf_counter() - last_told > 10.0:
            last_told = time.perf_counter()
            print(f"{done} of {total} taps, {last_told - started:.0f} s", file=sys.stderr, flush=True)

    devices = range(NOMINAL, experiment.devices + 1)
    results = compare(own, experiment.conditions, devices, jobs=experiment.jobs, progress=tell)
    off_nodes = compare(own, midpoints(experiment.library), [NOMINAL], jobs=experiment.jobs)
    elapsed_s = time.perf_counter() - started
    summaries = summarise(results)
    write_csv(results, out / "taps.csv")
    write_csv(summaries, out / "methods.csv")
    write_csv(off_nodes, out / "off_nodes.csv")
    save_figure(method_figure(results, summaries), out / "methods.png")
    count = len(results) + len(off_nodes)
    return [
        "## All methods",
        "",
        "![Tap error, felt error and speed by method](methods.png)",
        "",
        f"Tap error in % by method over {len(experiment.conditions)} conditions.",
        "",
        *method_table(summaries, summarise(off_nodes)),
        "Felt error in %, and speed, means over the same taps.",
        "",
        *felt_table(summaries, summarise(off_nodes)),
        *ahead_of_all(summaries),
        *how_measured(experiment.devices),
        f"{count} taps in {elapsed_s:.0f} s with {experiment.jobs} processes, "
        f"{1e3 * elapsed_s * experiment.jobs / count:.0f} ms per tap and process.",
        "",
    ]


def write_all(
    experiment: Experiment,
    out: Path,
    command: str,
    *,
    recorded: seed_device.Recorded = AS_THE_SEED,
    page: Path | None = None,
) -> None:
    """Every file of the command into the folder `out`, each whole, and what was found by the methods into a page."""
    started = time.perf_counter()
    methods, played = method_comparison(experiment, out), played_figures(experiment, out)
    figures = [line for line in methods if not line.startswith(("## ", "!["))]
    write_part(page, [*figures, *(line for line in played if line.startswith("- "))])
    parts = [
        *methods,
        *played,
        *device_figures(experiment.scene, experiment.conditions, recorded, out),
    ]
    computer, installed = machine(), versions("transopt", "numpy", "scipy", "casadi", "matplotlib")
    head = [
        "# The seed's experiment",
        "",
        "Figures and comparisons of Fiene, Kuchenbecker and Niemeyer, *Event-Based Haptic Tapping with Grip Force "
        f"Compensation* (2006), from the scene `{experiment.scene.name}` on the simulator.",
        "",
        f"`{command}`: {time.perf_counter() - started:.0f} s on {computer['cpu']}, {computer['cores']} cores, "
        f"{computer['system']}; {', '.join(f'{name} {version}' for name, version in installed.items())}.",
        "",
    ]
    write_text("\n".join([*head, *parts]), out / "seed.md")


def main(
    out: Annotated[Path, Option(help="folder for everything that is written")],
    devices: Annotated[int, at_least(1, "random mismatched devices")] = 20,
    jobs: Annotated[int, at_least(1, "processes")] = min(os.cpu_count() or 1, 2),
    page: PageFile = None,
) -> None:
    make_folder(out)
    library, steady = libraries(problems.load(SCENE))
    experiment = Experiment(library, steady, nodes(library), METHODS, devices, jobs)
    write_all(
        experiment, out, f"python scripts/seed_figures.py --out DIR --devices {devices} --jobs {jobs}", page=page
    )
    print(out / "seed.md")


if __name__ == "__main__":
    run(main)
