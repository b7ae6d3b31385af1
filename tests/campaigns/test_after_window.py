"""What a tap does when its waveform is over, by several ways to end it, played on devices that are not the model.

    python -m pytest -m long -n 0 tests/campaigns/test_after_window.py
        --campaign="[SCENE...] [--devices 1] [--wrong 0.1] [--seed N] [--json FILE] [--part FILE]"

Every way is a library of the scene: as if the window were all (`window`), with 30 samples of hand-over in place of 10
(`long`), with the error after the window in the problem (`tail`), and with both. Every entry is played by the servo
on devices of its own, the same for all ways, whose masses, springs, dampers, force, pole and delay are off by up to
the share `--wrong`; what the model's own device does, the model tells. Printed are the tap error, the error after the
window as a share of the same energy, the largest error after it, and the kick: the largest change of the command from
one tick to the next in the last 5 ms. Without a scene all built-in ones that have masses and no wall. It fails if the
term makes the largest error after the window of a scene's taps larger.
"""

from dataclasses import asdict, dataclass, replace
from typing import Annotated

import numpy as np
import typer

import problems
from controller.sim.played_tap import play_tap
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.true_device import device_of
from tests.benches.compiled import servo_of
from tests.campaigns.harness import JsonFile, PartFile, Seed, at_least, long_form, write_json, write_part
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.writing import table
from transopt.design.build import build_library
from transopt.library.library import Library
from transopt.references.references import References
from transopt.scene.recordings import recordings_of, references_of
from transopt.scene.scene import Scene

LAST_S = 5e-3  # of the window, in which the kick is looked for
AFTER_S = 30e-3  # that is looked at, whatever the problem looks at
LOOKED_S = AFTER_S + 2e-3  # that is simulated, with room for what is played late
SAME = 1.05  # of a peak, where the term has nothing to calm
WORDS = {
    "window": "as if it were all",
    "long": "30 samples of hand-over",
    "tail": "the term",
    "both": "both",
}
HEAD = (
    "scene",
    "way",
    "tap error by the model %",
    "tap error played %",
    "error after %",
    "peak error after, model g",
    "played g",
    "kick A",
)
WAYS = {"window": (0.0, 10), "long": (0.0, 30), "tail": (AFTER_S, 10), "both": (AFTER_S, 30)}


@dataclass(frozen=True)
class Ended:
    """One tap.

    Attributes
    ----------
    tap_error, after, peak_after_m_s2 : figures after the one shift that aligns played and predicted; the last two of
        the error after the window.
    kick_A : largest change of the command in the last 5 ms of the window.
    predicted, predicted_peak_m_s2 : tap error and largest error after the window by the model.
    """

    scene: str
    way: str
    speed_m_s: float
    grip_N: float
    tap_error: float
    after: float
    peak_after_m_s2: float
    kick_A: float
    predicted: float
    predicted_peak_m_s2: float


def ended_so(scene: Scene, after_s: float, hand_over_samples: int) -> Library | None:
    """The library of a scene that ends in one of the ways; None where an entry has no answer."""
    weights = scene.weights.model_copy(update={"after_s": after_s})
    varied = scene.model_copy(update={"weights": weights, "hand_over_samples": hand_over_samples})
    return build_library(varied, recordings_of(varied)).library


def lasting_references(scene: Scene) -> References:
    """What is recorded, through the window and `AFTER_S` after it."""
    weights = scene.weights.model_copy(update={"after_s": AFTER_S})
    lasting = scene.model_copy(update={"weights": weights})
    return references_of(lasting, recordings_of(lasting))


def played(
    scene: Scene, way: str, library: Library, references: References, devices: int, wrong: float, seed: int
) -> list[Ended]:
    """Every entry on devices of its own."""
    grid, truth = library.time_grid(), device_of(scene)
    yardstick = replace(library.yardstick, grid=replace(grid, after_stages=round(AFTER_S / grid.dt_s)))
    late = grid.issue_times_s >= grid.issue_times_s[-1] - LAST_S
    found = []
    for iv, ig in np.ndindex(library.tap_error.shape):
        speed, grip = float(library.speeds_m_s[iv]), float(library.grips_N[ig])
        target = references.at(speed, grip).target
        free = target.lasting(target.free_m_s2)
        times = grid.switching_times_s[0] + grid.dt_s * np.arange(free.size)
        lasting = np.append(library.command[iv, ig], np.zeros(free.size - grid.stages))
        model = yardstick.figures(target, library.stage(ig).rollout(lasting)[0])
        kick = float(np.abs(np.diff(library.command[iv, ig], prepend=0.0))[late].max())
        for number in range(devices):
            device = truth.mismatched(wrong, np.random.default_rng([seed, number, iv, ig]))
            tap = SimulatedTap(speed, grip, seed=number)
            once = play_tap(library, servo_of(library), tap, device=device, after_s=LOOKED_S)
            if not once.played or once.faults:
                continue
            whole = np.interp(times + once.latency_s, once.times_s, once.acceleration_m_s2)
            told = yardstick.figures(target, whole - free)
            found.append(
                Ended(
                    scene=scene.name,
                    way=way,
                    speed_m_s=speed,
                    grip_N=grip,
                    tap_error=told.tap_error,
                    after=told.error_after,
                    peak_after_m_s2=told.peak_after_m_s2,
                    kick_A=kick,
                    predicted=model.tap_error,
                    predicted_peak_m_s2=model.peak_after_m_s2,
                )
            )
    return found


def figures_of(taps: list[Ended]) -> tuple[float, ...]:
    """Mean errors of one way in one scene in % by model, played and after; worst peaks in g, worst kick in A."""
    mean = [100 * float(np.mean([getattr(tap, key) for tap in taps])) for key in ("tap_error", "after", "predicted")]
    peak, of_model = (
        max(getattr(tap, key) for tap in taps) / STANDARD_GRAVITY_M_S2
        for key in ("peak_after_m_s2", "predicted_peak_m_s2")
    )
    return mean[2], mean[0], mean[1], of_model, peak, max(tap.kick_A for tap in taps)


def in_cells(figures: tuple[float, ...]) -> list[str]:
    """Printed cells: percent and amperes with two decimals, g with three."""
    return [f"{value:.{digits}f}" for value, digits in zip(figures, (2, 2, 2, 3, 3, 2), strict=True)]


def main(
    scenes: Annotated[
        list[str] | None, typer.Argument(help="built-in scenes; all that can be played without them")
    ] = None,
    devices: Annotated[int, at_least(1, "devices that play each entry")] = 1,
    wrong: Annotated[float, at_least(0, "share by which every parameter of a device may be off")] = 0.1,
    seed: Seed = 1,
    json: JsonFile = None,
    part: PartFile = None,
) -> int:
    found: list[Ended] = []
    rows: list[list[str]] = []
    louder: list[str] = []
    print("                                model   played    after    model     peak     kick")
    print("scene            way      taps   tap %    tap %        %   peak g        g        A")
    for name in scenes or problems.scene_names():
        scene = problems.load(name)
        try:
            references = lasting_references(scene)
            device_of(scene)
        except InputError as error:
            print(f"{name:16s} left out: {error}")
            continue
        if scene.feedback is not None:
            print(f"{name:16s} left out: over a wall another user would be needed for every way")
            continue
        peaks: dict[str, float] = {}
        for way, (after_s, hand_over_samples) in WAYS.items():
            library = ended_so(scene, after_s, hand_over_samples)
            if library is None:
                print(f"{name:16s} {way:7s} an entry has no answer")
                continue
            taps = played(scene, way, library, references, devices, wrong, seed)
            if not taps:
                print(f"{name:16s} {way:7s} the servo plays none of it: the coil is too warm to begin with")
                continue
            peaks[way] = max(tap.peak_after_m_s2 for tap in taps)
            cells = in_cells(figures_of(taps))
            print(f"{name:16s} {way:7s} {len(taps):5d} {' '.join(f'{cell:>8s}' for cell in cells)}", flush=True)
            rows.append([name if not rows or name not in (row[0] for row in rows) else "", WORDS[way], *cells])
            found += taps
        if peaks.get("tail", 0.0) > SAME * peaks.get("window", np.inf):
            louder.append(name)
    write_json([asdict(tap) for tap in found], json)
    write_part(part, table(HEAD, rows))
    print(f"louder with the term: {', '.join(louder) or 'none'}")
    return 1 if louder else 0


test_long_form = long_form(main)
