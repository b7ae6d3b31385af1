"""Benefit of cool commands on a warm coil, compared with first commands that are scaled down.

    python scripts/heat_axis.py [--minutes 20] [--blends 1000000] [--page docs/results/heat.md] [--figure FILE.png]

There are three parts, on the default scene: the error of a tap for each share of the heat; whether random blends of
the stored commands over speed, grip and coil temperature keep the limits on current and command; and minutes of taps
on a coil that starts 10 K below its limit, with and without cool commands.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from common.command import run
from common.page import PageFile, write_part
from matplotlib.figure import Figure
from typer import Option

import problems
import transopt as to
from controller.firmware.core_servo import CoreServo
from controller.host.payload import payload_of
from controller.protocol.image import bank_of, image_of
from controller.servo.settings import Settings
from controller.sim.simulator import Coil
from controller.waveforms.bank import Bank, bank
from transopt.base.errors import InputError
from transopt.base.plotting import LABEL_PT, SMALL_PT, save_figure
from transopt.base.signals import FloatArray
from transopt.base.writing import table
from transopt.library.library import Library
from transopt.plant.coil import effective_square
from transopt.problem.objective.bands import JUST_NOTICED_dB
from transopt.problem.objective.figures import FELT_Hz, Figures
from transopt.problem.objective.weighting import bandpass
from transopt.problem.warm_coil import WarmCoil, currents
from transopt.scene.keys import with_values

SCENE, SHARE, SPEED_M_S = "wood_on_foam", 0.36, 0.3
SHARES = (0.8, 0.6, 0.36, 0.2, 0.1)
HOT = {"thermal.start_winding_C": 90.0, "thermal.start_housing_C": 85.0}
TAPS_A_SECOND, LEAST_PAUSE_S = 8.0, 0.02  # twice as many as the coil stands for ever; between two of them
BLOCK = 4000  # blends at once


@dataclass(frozen=True)
class Left:
    """A tap with a share of the heat, by scaling and by the optimum."""

    share: float
    grip_N: float
    scaled: Figures
    optimum: Figures


@lru_cache(maxsize=len(SHARES) + 1)
def cooled(share: float) -> Library:
    """The library of the default scene on a warm coil, with cool commands."""
    return to.solve(with_values(problems.load(SCENE), {**HOT, "grid.cool_share": share}))


def cool_of(library: Library) -> Library:
    """The cool commands of a library that has them."""
    assert library.cool is not None
    return library.cool


def left(library: Library, share: float) -> list[Left]:
    """Taps with a share of the heat, at a speed at which a limit binds at the firmest grip only."""
    iv = int(np.searchsorted(library.speeds_m_s, SPEED_M_S))
    found = []
    for ig, grip in enumerate(library.grips_N):
        target, (accelerations, _) = library.uncorrected(iv, ig), library.lasting(iv, ig)
        scaled = library.yardstick.figures(target, share**0.5 * accelerations)
        found.append(Left(share, float(grip), scaled, cool_of(library).figures(iv, ig)))
    return found


def shares_table(found: Sequence[Left]) -> list[str]:
    """Lines of a Markdown table: tap error, felt error and felt dB by share and grip."""

    def cells(figures: Figures) -> str:
        return f"{100 * figures.tap_error:.1f} / {100 * figures.felt_error:.1f} / {figures.felt_dB:+.2f}"

    rows = [[f"{100 * x.share:g} %", f"{x.grip_N:g} N", cells(x.scaled), cells(x.optimum)] for x in found]
    return table(["heat", "grip", "scaled: tap % / felt % / dB", "cool command: the same"], rows)


def shares_figure(found: Sequence[Left]) -> Figure:
    """Felt error and level over the share of the heat, for both methods, grip by grip."""
    drawn = Figure(figsize=(8.0, 3.4), layout="constrained")
    error, level = drawn.subplots(1, 2)
    grips = sorted({each.grip_N for each in found})
    for grip, shade in zip(grips, (0.55, 0.3, 0.0), strict=False):
        own = sorted((each for each in found if each.grip_N == grip), key=lambda each: each.share)
        heat = [100 * each.share for each in own]
        for way, style, colour in (("scaled", "--", (0.85, shade, 0.1)), ("optimum", "-", (0.0, shade, 0.65))):
            figures = [getattr(each, way) for each in own]
            name = {"scaled": "first, scaled", "optimum": "second"}[way]
            line = {"linestyle": style, "color": colour, "marker": "o", "markersize": 3, "linewidth": 1.4}
            error.plot(heat, [100 * each.felt_error for each in figures], label=f"{name}, {grip:g} N", **line)
            level.plot(heat, [each.felt_dB for each in figures], **line)
    level.axhline(-JUST_NOTICED_dB, color="0.4", linewidth=0.9, linestyle=":")
    level.annotate("just noticed", (30.0, -JUST_NOTICED_dB), va="top", fontsize=SMALL_PT)
    for axes, label in ((error, "felt error, %"), (level, "felt level, dB")):
        axes.set_xlabel("heat, % of the first command's", fontsize=LABEL_PT)
        axes.set_ylabel(label, fontsize=LABEL_PT)
        axes.tick_params(labelsize=SMALL_PT)
        axes.grid(color="0.9", linewidth=0.6)
    error.legend(fontsize=SMALL_PT)
    drawn.suptitle(f"{SCENE}, {SPEED_M_S:g} m/s", fontsize=LABEL_PT)
    return drawn


@dataclass(frozen=True)
class Blended:
    """Random blends of stored commands.

    Attributes
    ----------
    bits : resolution of a stored sample of a cool command.
    blends : number of blends.
    over : number of blends that exceed a limit by more than one count.
    current_A, command_A : largest current and command of all blends.
    """

    bits: int
    blends: int
    over: int
    current_A: float
    command_A: float


def blended(library: Library, bits: int, blends: int, seed: int) -> Blended:
    """Blend stored commands at random speeds, grips and coil temperatures, and evaluate currents and commands."""
    settings, random = Settings.of(library), np.random.default_rng(seed)
    amplifier, tail = library.amplifier(), library.hand_over_samples
    image = image_of(bank(library), library.dt_s, library.lead_s, tail, cool_bits=bits, amplifier=amplifier)
    stored, head = bank_of(image)
    assert stored.cool_command_A is not None
    commands = np.stack([stored.command_A, stored.cool_command_A])
    nv, ng, N = stored.command_A.shape
    made = currents(commands, amplifier, library.dt_s).reshape(2 * nv * ng, N + 1)
    commands = commands.reshape(2 * nv * ng, N)
    count_A = max(head["scale_A"], float(np.abs(stored.cool_command_A).max()) / (2 ** (bits - 1) - 1))
    limits_A = np.array([settings.current_limit_A, settings.command_limit_A]) + count_A
    over, largest = 0, np.zeros(2)
    for first in range(0, blends, BLOCK):
        weights = _weights(nv, ng, min(BLOCK, blends - first), random)
        reached = np.stack([np.abs(weights @ each).max(axis=1) for each in (made, commands)], axis=1)
        over += int(np.count_nonzero((reached > limits_A).any(axis=1)))
        largest = np.maximum(largest, reached.max(axis=0))
    return Blended(bits, blends, over, *largest.tolist())


def _weights(nv: int, ng: int, count: int, random: np.random.Generator) -> FloatArray:
    """(count, 2 nv ng) weights of the corners of random cells, split at random between first and cool commands."""
    weights, rows = np.zeros((count, 2, nv, ng)), np.arange(count)
    iv, ig = (random.integers(0, max(nodes - 1, 1), count) for nodes in (nv, ng))
    y, x, m = random.uniform(size=(3, count))
    for dv, by_v in ((0, 1 - y), (1, y)):
        for dg, by_g in ((0, 1 - x), (1, x)):
            for second, by_m in ((0, 1 - m), (1, m)):
                place = (rows, second, np.minimum(iv + dv, nv - 1), np.minimum(ig + dg, ng - 1))
                np.add.at(weights, place, by_v * by_g * by_m)
    return weights.reshape(count, -1)


@dataclass(frozen=True)
class Minutes:
    """Taps on a warm coil.

    Attributes
    ----------
    contacts : number of contacts.
    played : numbers of transients that were played whole, blended, scaled or withheld.
    mean_dB, worst_dB : level of the played transients in the felt band, over the recorded one.
    hottest_C : highest temperature of a coil that is integrated independently of the guard's estimate.
    """

    contacts: int
    played: Counter[str]
    mean_dB: float
    worst_dB: float
    hottest_C: float


def taps_for(library: Library, stored: Bank, minutes: float, seed: int) -> Minutes:
    """Random taps at the nodes, as the servo decides on each, beside the coil's true temperature."""
    coil, given = library.coil(), payload_of(library)
    assert coil is not None
    settings = replace(given.settings, coil=coil)
    dt_s, N = library.dt_s, library.command.shape[2]
    guard, true = CoreServo(settings, given.image), Coil(coil)
    warm = WarmCoil.of(coil, dt_s, settings.withhold_K, settings.least_scale)
    random, hottest = np.random.default_rng(seed), coil.start_winding_C
    played, levels = Counter[str](), []
    commands = np.stack([library.transient_command, cool_of(library).transient_command])
    made = currents(commands, library.amplifier(), dt_s)
    heard = _heard(library)
    until_s, now_s = 60 * minutes, 0.0
    while now_s < until_s:
        iv, ig = (int(random.integers(0, nodes)) for nodes in library.command.shape[:2])
        cool_A = stored.cool_transient_A[iv][ig] if stored.cool_transient_A else np.inf
        norms_A = stored.transient_A[iv][ig], cool_A, stored.feedback_A[iv][ig]
        scale, second = warm.allowed(*guard.coil_C(), *norms_A, N + 1)
        word = "withheld" if scale <= 0 else "scaled" if scale < 1 else "blended" if second > 0 else "whole"
        played[word] += 1
        if scale > 0:
            levels.append(_level_dB(heard[iv, ig], scale, second))
        current = scale * ((1 - second) * made[0, iv, ig] + second * made[1, iv, ig])
        spare_s = 1 / TAPS_A_SECOND - N * dt_s - LEAST_PAUSE_S
        pause = np.zeros(round((LEAST_PAUSE_S + random.exponential(spare_s)) / dt_s))
        course = np.concatenate([current, pause])
        guard.heat(course, course.size)
        squares = effective_square(course)
        for part in np.array_split(squares, max(course.size // 100, 1)):
            true.step(float(part.mean()), part.size * dt_s)
            hottest = max(hottest, true.winding_C)
        now_s += course.size * dt_s
    contacts = sum(played.values())
    return Minutes(contacts, played, float(np.mean(levels)), float(np.min(levels)), hottest)


def _heard(library: Library) -> dict[tuple[int, int], FloatArray]:
    """Node -> (4, samples) felt band of r, of a_free, and of what the first and the cool command add."""
    (by,) = bandpass(*FELT_Hz, library.dt_s, 1)
    found = {}
    for iv, ig in np.ndindex(library.command.shape[:2]):
        target = library.uncorrected(iv, ig)
        free, recorded = target.lasting(target.free_m_s2), target.lasting(target.recorded_m_s2)
        made = [each.lasting(iv, ig)[0] for each in (library, cool_of(library))]
        found[iv, ig] = by.apply(np.stack([recorded, free, *made]))
    return found


def _level_dB(heard: FloatArray, scale: float, second: float) -> float:
    recorded, free, first, other = heard
    made = free + scale * ((1 - second) * first + second * other)
    return float(10 * np.log10((made @ made) / (recorded @ recorded)))


def minutes_table(found: Sequence[tuple[str, Minutes]]) -> list[str]:
    """Lines of a Markdown table: how the taps were played, with cool commands and without."""
    head = ["taps at 90 C", "contacts", "whole", "blended", "scaled", "withheld", "felt dB: mean, least", "hottest C"]
    rows = [
        [
            words,
            str(x.contacts),
            *(str(x.played[word]) for word in ("whole", "blended", "scaled", "withheld")),
            f"{x.mean_dB:+.2f}, {x.worst_dB:+.2f}",
            f"{x.hottest_C:.2f}",
        ]
        for words, x in found
    ]
    return table(head, rows)


def main(
    minutes: Annotated[float, Option(min=0.01, help="of taps")] = 20.0,
    blends: Annotated[int, Option(min=1, help="at random, for each of 16 and 8 bit")] = 1_000_000,
    seed: int = 1,
    figure: Annotated[Path | None, Option(help="Draw felt error and level over the heat into this PNG.")] = None,
    page: PageFile = None,
) -> int:
    found = [each for share in SHARES for each in left(cooled(share), share)]
    library = cooled(SHARE)
    tried = [blended(library, bits, blends, seed) for bits in (16, 8)]
    stored = bank(library)
    alone = replace(stored, cool_command_A=None, cool_transient_A=[])
    played = [
        ("first commands alone", taps_for(library, alone, minutes, seed)),
        (f"with cool commands of {100 * SHARE:g} %", taps_for(library, stored, minutes, seed)),
    ]
    rows = [
        [f"{x.bits} bit", str(x.blends), str(x.over), f"{x.current_A:.4f} A", f"{x.command_A:.4f} A"] for x in tried
    ]
    lines = [
        *shares_table(found),
        *table(["cool commands of", "blends", "over a limit", "largest current", "largest command"], rows),
        *minutes_table(played),
    ]
    print("\n".join(lines))
    if figure is not None:
        save_figure(shares_figure(found), figure)
    write_part(page, lines)
    (_, without), (_, both) = played
    if any(x.over for x in tried) or both.played["withheld"] > without.played["withheld"]:
        raise InputError("heat axis: a blend is over a limit, or a contact lost its transient")
    return 0


if __name__ == "__main__":
    run(main)
