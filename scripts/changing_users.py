"""Quality of a library in the hands of other users: nominal, robust, and calibrated from three taps.

    python scripts/changing_users.py [--hands 20] [--seed 101] [--page docs/results/users.md] [--figure FILE.png]

Hands are drawn from the built-in population, with a seed on which nothing was tuned. Each taps three times on the
simulated device, which plays the nominal library, and a library is calibrated from these taps. Then all libraries are
played in that hand by independent equations (`played/motion.py`) and compared with two references: the tap of this
hand on the real object, by the same equations, and the recorded tap of the scene's hand. The baseline is the optimum
for the hand's true parameters, from its own recorded taps for the first reference, and from those of the library for
the second.

It fails if a calibrated library exceeds this baseline by more than 4 points of tap error or 2 of felt error in the
mean over the entries of a hand.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
from common.command import Seed, at_least, run
from common.page import PageFile, write_part
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from played.figures import as_recorded, told
from played.motion import Hand as MovingHand
from played.motion import Tap, Taps
from typer import Option

import transopt as to
from controller.cli.bench import simulated_bench
from controller.cli.port import connected
from controller.cli.refine_taps import SimulatedHand
from controller.cli.refine_taps import Taps as Rounds
from controller.device.device_file import BUILT_IN
from controller.host.payload import payload_of
from controller.refine.heard import Node
from controller.refine.new_hand import TAPS, calibrated, nodes_to_tap, save_model
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections
from controller.sim.true_device import TrueDevice, device_of
from controller.sim.user import Tremor
from transopt.base.plotting import LABEL_PT, SMALL_PT, save_figure
from transopt.base.signals import FloatArray
from transopt.base.writing import table
from transopt.design.another_model import built_on
from transopt.design.build import build_library
from transopt.identify.calibration import Calibration
from transopt.library.library import Library
from transopt.library.recorded import references_of_library
from transopt.plant.hand import HandSection
from transopt.scene.builtin import POPULATION
from transopt.scene.keys import with_values
from transopt.scene.population import Population, load_population
from transopt.scene.scene import Scene

SCENE, SAMPLES = "wood_on_foam", 8
MOST_TAP, MOST_FELT = 0.04, 0.02  # largest excess of calibrated errors over the known hand's, mean over a hand
OTHERS = 2  # every so many hands are tested under the further conditions
DRIVE_OFF = 0.03  # largest relative error of the drive's parameters
STRAIGHT = MovingHand("straight")
OWN, RECORDED = "in this hand", "as recorded"  # the two truths
NOMINAL, MEAN, WORST = "nominal", "robust, mean", "robust, worst"
CALIBRATED, KNOWN = "calibrated", "knows the hand"
CALIBRATED_RECORDED, KNOWN_RECORDED = "calibrated, --as-recorded", "knows the hand, --as-recorded"
PAIRS = {OWN: (CALIBRATED, KNOWN), RECORDED: (CALIBRATED_RECORDED, KNOWN_RECORDED)}
Found = dict[str, dict[str, FloatArray]]
"""Truth -> library -> (entries, 2) tap error and felt error."""


@dataclass(frozen=True)
class Condition:
    """The condition under which a hand is calibrated.

    Attributes
    ----------
    wider : factor on the population's deviations when hands are drawn; the prior does not change.
    taps : number of taps used, of the three.
    drive_off : largest relative error of the drive's parameters.
    tremor_m : amplitude of a tremor at 10 Hz during calibration.
    """

    wider: float = 1.0
    taps: int = TAPS
    drive_off: float = 0.0
    tremor_m: float = 0.0


CONDITIONS = {
    "three taps": Condition(),
    "hands drawn 1.5 times as wide": Condition(wider=1.5),
    "one tap, at the lowest grip": Condition(taps=1),
    "drive off by up to 3 %": Condition(drive_off=DRIVE_OFF),
    "hand trembles, 50 um at 10 Hz": Condition(tremor_m=50e-6),
}


class Trembling(SimulatedHand):
    """The simulated hand of a condition, with its tremor."""

    def __init__(self, device: TrueDevice, seed: int, tremor_m: float) -> None:
        super().__init__(device, Imperfections(), seed)
        self._tremor_m = tremor_m

    def tap(self, library: Library, number: int, node: Node, n: int) -> SimulatedTap:
        made = super().tap(library, number, node, n)
        phase = float(np.random.default_rng([made.seed, 9]).uniform(0, 2 * np.pi))
        return replace(made, tremor=Tremor(self._tremor_m, phase_rad=phase)) if self._tremor_m else made


@lru_cache(maxsize=1)
def designed() -> tuple[Scene, Population, dict[str, Library]]:
    """Scene, population, and the libraries that do not depend on the hand."""
    scene, population = to.load_scene(SCENE), load_population(POPULATION)
    recordings = to.recordings_of(scene)
    libraries = {NOMINAL: to.solve(scene, recordings)}
    for name, minimise in ((MEAN, "mean"), (WORST, "worst")):
        robust = {"population": population.model_dump(), "samples": SAMPLES, "minimise": minimise}
        libraries[name] = to.solve(with_values(scene, {"robust": robust}), recordings)
    return scene, population, libraries


def true_device(scene: Scene, condition: Condition, seed: int) -> TrueDevice:
    """The device in the hand of a scene, with the drive of a condition."""
    own = device_of(scene)
    if not condition.drive_off:
        return own
    off = own.mismatched(condition.drive_off, np.random.default_rng([seed, 11]))
    skin = own.skin or 0
    masses, joints = (
        (*off.masses_kg[: skin + 1], *own.masses_kg[skin + 1 :]),
        (*off.joints[:skin], *own.joints[skin:]),
    )
    return replace(off, masses_kg=masses, joints=joints)


def by_taps(
    library: Library, device: TrueDevice, population: Population, condition: Condition, seed: int
) -> Calibration:
    """The hand as calibrated by the command, from taps over the simulated link."""
    hand = Trembling(device, seed, condition.tremor_m)
    given = payload_of(library)
    bench, hand.hand = simulated_bench(given, device, (), tapped=hand.tapped)
    nodes, taps = nodes_to_tap(library, BUILT_IN)
    with connected(bench.port, None) as port, hand:
        play = Rounds(port, bench, hand, BUILT_IN, Path(), taps, None)
        contacts, settings = play.contacts(library, 0, nodes)
    return calibrated(contacts[: condition.taps], settings, library, population, BUILT_IN.accelerometer, [])[0]


def libraries_of(hand: HandSection, condition: Condition, seed: int) -> tuple[dict[str, Library], TrueDevice]:
    """All libraries to compare in a hand, and the device in it."""
    scene, population, known = designed()
    truth, nominal = scene.in_hand(hand), known[NOMINAL]
    device = true_device(truth, condition, seed)
    found = by_taps(nominal, device, population, condition, seed)
    with TemporaryDirectory() as folder:
        model = Path(folder) / "model.json"
        save_model(model, scene, found.device)
        own = {
            name: built_on(nominal, model, as_recorded=recorded).library
            for name, recorded in ((CALIBRATED, False), (CALIBRATED_RECORDED, True))
        }
    own[KNOWN] = to.solve(truth, to.recordings_of(truth))
    own[KNOWN_RECORDED] = build_library(truth, references_of_library(nominal)).library
    shared = known if condition == Condition() else {}
    return {**shared, **{name: library for name, library in own.items() if library is not None}}, device


def played(libraries: dict[str, Library], device: TrueDevice) -> Found:
    """Tap error and felt error of all entries of all libraries, relative to both references."""
    scene, _, known = designed()
    nominal, grid, target = known[NOMINAL], scene.time_grid(), scene.recordings.simulated
    assert target is not None
    lost = nominal.recorded_before_m_s2.shape[-1]
    times = grid.switching_times_s[0] + grid.dt_s * np.arange(-lost, grid.stages + grid.after_stages)
    (nv, ng), speeds, grips = nominal.command.shape[:2], nominal.speeds_m_s, nominal.grips_N
    nodes = [(iv, ig) for iv in range(nv) for ig in range(ng)]
    taps = [Tap(speeds[iv], grips[ig], STRAIGHT) for iv, ig in nodes]
    for library in libraries.values():
        taps += [Tap(speeds[iv], grips[ig], STRAIGHT, np.append(library.command[iv, ig], 0.0)) for iv, ig in nodes]
    switching = np.append(grid.switching_times_s, grid.end_s)
    courses = Taps(device, target, taps, scene.hand.intention_s).courses(times, switching).acceleration_m_s2
    real, *felt = courses.reshape(1 + len(libraries), len(nodes), -1)
    parts = (nominal.recorded_before_m_s2, nominal.recorded_m_s2, nominal.recorded_after_m_s2)
    truths = {
        OWN: [as_recorded(course, 1 / grid.dt_s) for course in real],
        RECORDED: [np.concatenate([part[place] for part in parts]) for place in nodes],
    }

    def errors(wanted: Sequence[FloatArray], made: FloatArray) -> FloatArray:
        each = [told(times, w, a, 0.0, scene.hand.intention_s) for w, a in zip(wanted, made, strict=True)]
        return np.array([[one.tap, one.felt] for one in each])

    return {
        truth: {name: errors(wanted, made) for name, made in zip(libraries, felt, strict=True)}
        for truth, wanted in truths.items()
    }


def met(hands: int, seed: int, condition: Condition, tell: Callable[[str], None] = lambda _: None) -> list[Found]:
    """Results of all hands under a condition."""
    scene, population, _ = designed()
    drawn = population.drawn(hands, seed, scene.grid.grips_N, condition.wider)
    found = []
    for number, hand in enumerate(drawn):
        found.append(played(*libraries_of(hand, condition, seed + number)))
        tap, felt = 100 * (found[-1][OWN][CALIBRATED] - found[-1][OWN][KNOWN]).mean(axis=0)
        tell(f"hand {number + 1}: calibrated less who knows the hand: tap {tap:+.2f}, felt {felt:+.2f} points")
    return found


def worth(found: Sequence[Found], truth: str) -> list[str]:
    """Table of libraries: means over hands and entries, and the worst hand and entry."""
    rows = []
    for name in found[0][truth]:
        each = 100 * np.array([one[truth][name] for one in found])  # hands, entries, figures
        mean, hand, entry = each.mean(axis=(0, 1)), each.mean(axis=1).max(axis=0), each.max(axis=(0, 1))
        rows.append([name, *(f"{figures[j]:.1f}" for j in range(2) for figures in (mean, hand, entry))])
    head = ("library", "tap %, mean", "worst hand", "worst entry", "felt %, mean", "worst hand", "worst entry")
    return table(head, rows)


def behind(found: Sequence[Found], truth: str) -> FloatArray:
    """(hands, entries, 2) excess of the calibrated library's errors over those of the known hand."""
    ours, theirs = PAIRS[truth]
    return np.array([one[truth][ours] - one[truth][theirs] for one in found])


def behind_row(words: str, found: Sequence[Found], truth: str) -> list[str]:
    """A condition's row: mean over all, worst hand in the mean of its entries, worst entry of all; tap, then felt."""
    off = 100 * behind(found, truth)
    each = (off.mean(axis=(0, 1)), off.mean(axis=1).max(axis=0), off.max(axis=(0, 1)))
    return [words, truth, *(f"{figures[j]:+.2f}" for j in range(2) for figures in each)]


def users_figure(found: Sequence[Found]) -> Figure:
    """Tap error and felt error of each hand, mean over its entries, relative to the object in that hand."""
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    order = np.argsort([one[OWN][NOMINAL][:, 1].mean() for one in found])
    # Okabe and Ito's colours, and a mark of its own for each library.
    looks = {NOMINAL: ("#D55E00", "s"), MEAN: ("#E69F00", "^"), CALIBRATED: ("#0072B2", "o"), KNOWN: ("0.15", "_")}
    for j, (axes, words) in enumerate(zip(figure.subplots(1, 2), ("tap error", "felt error"), strict=True)):
        for name, (colour, mark) in looks.items():
            each = [100 * found[hand][OWN][name][:, j].mean() for hand in order]
            size = 9 if mark == "_" else 4
            axes.plot(
                np.arange(len(each)) + 1,
                each,
                mark,
                color=colour,
                markersize=size,
                label=name,
                markeredgewidth=1.5 if mark == "_" else 0,
            )
        axes.set_xlabel("hand, by the felt error of the nominal library", fontsize=LABEL_PT)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylabel(f"{words}, mean over 12 taps [%]", fontsize=LABEL_PT)
        axes.tick_params(labelsize=SMALL_PT)
        axes.set_ylim(0, None)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=SMALL_PT)
    return figure


def main(
    hands: Annotated[int, at_least(1, "hands of each condition")] = 20,
    seed: Seed = 101,
    figure: Annotated[Path | None, Option(metavar="FILE.png", help="where the figure is written")] = None,
    page: PageFile = None,
) -> int:
    rows, lines, good = [], list[str](), True
    for name, condition in CONDITIONS.items():
        usual = condition == Condition()
        found = met(hands if usual else -(-hands // OTHERS), seed, condition, lambda said: print(said, flush=True))
        rows += [behind_row(f"{name}, {len(found)} hands", found, truth) for truth in PAIRS]
        print(*rows[-2], sep="  ", flush=True)
        if usual:
            lines += ["Beside the tap that the object gives this very hand:", "", *worth(found, OWN), ""]
            lines += ["Beside the recorded tap, of the hand of the scene:", "", *worth(found, RECORDED), ""]
            worst = [behind(found, truth).mean(axis=1).max(axis=0) for truth in PAIRS]
            good = all(tap <= MOST_TAP and felt <= MOST_FELT for tap, felt in worst)
            if figure is not None:
                save_figure(users_figure(found), figure)
    head = ("calibrated less who knows the hand, points", "truth", "tap: mean", "worst hand", "worst entry")
    lines += ["What three taps leave:", "", *table((*head, "felt: mean", "worst hand", "worst entry"), rows)]
    write_part(page, lines)
    print("\n".join(lines))
    return 0 if good else 1


if __name__ == "__main__":
    run(main)
