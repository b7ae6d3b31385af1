"""No figure in the prose of the manual is stale: what it claims of a scene is measured again, and has a source.

A sentence outside of the appendix that tells how large an error, a floor or an intensity came out is one of `CLAIMS`,
which `test_numbers` makes again; or its figures stand in what a block of the page prints, or on the page of results
that its paragraph links to; or it is one of `RULES`, which state a bound or an example and measure nothing.
"""

import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import transopt as to
from tests.docs.pages import fenced, named, text
from tests.docs.test_words import APPENDIX, SENTENCE, counted, hand_written, paragraphs
from transopt.base.signals import FloatArray
from transopt.design.context import Context
from transopt.design.design import design
from transopt.library.library import Library
from transopt.scene.builtin import load_scene
from transopt.scene.keys import Value, with_values
from transopt.scene.recordings import recordings_of
from transopt.scene.scene import Scene

WOOD = "wood_on_foam"
OUTCOME = re.compile(r"\b(?:error|errors|floor|felt|points?|weak)\b")
PERCENT = re.compile(r"(?<![\w.\-/])\d+(?:[.,]\d+)*(?: (?:to|and|or) \d+(?:\.\d+)?)? (?:%|dB|points?)(?![\w/])")
FIGURE = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.]*\d)")


class Claim(NamedTuple):
    """A part of a page, its figures in braces, and what they are measured to be."""

    page: str
    words: str
    measured: Callable[[], tuple[float, ...]]


def scene(name: str = WOOD, **changes: Value) -> Scene:
    """A built-in scene with other values, a key's dot written as two underscores."""
    return with_values(load_scene(name), {key.replace("__", "."): value for key, value in changes.items()})


@cache
def solved(name: str = WOOD, **changes: Value) -> Library:
    return to.solve(scene(name, **changes))


def ends(values: FloatArray, by: float = 100.0) -> tuple[float, float]:
    return by * float(values.min()), by * float(values.max())


def free(library: Library) -> FloatArray:
    """Whether no limit binds, entry by entry."""
    return np.asarray(library.binding == "none")


def walled() -> tuple[float, ...]:
    """Tap errors with a wall and without one at the two grips, and by how much more heat it takes."""
    wall, plain = solved("walled"), solved()
    rows = np.searchsorted(plain.speeds_m_s, wall.speeds_m_s)
    columns = np.searchsorted(plain.grips_N, wall.grips_N)
    without, unbound = plain.tap_error[rows][:, columns], free(wall)
    heat = wall.heat_A2_s / plain.heat_A2_s[rows][:, columns]
    made = [100 * float(each[unbound[:, j], j].mean()) for each in (wall.tap_error, without) for j in range(2)]
    return (*made, *ends(heat[unbound], 1.0))


def at_other_grip(share: float) -> float:
    """Mean tap error [%] of the default library in a hand of another grip."""
    library, own, errors = solved(), scene(), []
    for iv in range(len(library.speeds_m_s)):
        for ig, grip_N in enumerate(library.grips_N):
            problem = library.problem(iv, ig)
            stage = own.posing().stage(own.plant(share * grip_N))
            played, _ = stage.rollout(problem.continued(library.command[iv, ig]))
            errors.append(problem.yardstick.tap_error(problem.target, played))
    return 100 * float(np.mean(errors))


def at_one_grip_for_all(speed_m_s: float, grip_N: float) -> tuple[float, float]:
    """Felt error [%] of a tap for its own grip, and of one that was designed for the tap recorded at 3 N."""
    context = Context.recorded(scene(), recordings_of(scene()))
    posed = [context.posed_as(context.reference(speed_m_s, of_N), grip_N) for of_N in (grip_N, 3.0)]
    own, other = design(posed)
    played = own.problem.figures(other.designed.effect.lasting.acceleration_m_s2)
    return 100 * own.figures.felt_error, 100 * played.felt_error


def calmed() -> tuple[float, ...]:
    """What calm costs an LRA's click of 150 Hz in tap error, and what moves behind its end without and with it."""
    plain, calm = (solved("lra_click", weights__calm=value) for value in (1.0, 30.0))

    def behind(library: Library) -> float:
        made = np.append(library.acceleration_m_s2[0, 0], library.acceleration_after_m_s2[0, 0])
        grid = library.time_grid()
        times_s = np.append(grid.switching_times_s, grid.after_times_s)
        return float(np.abs(made[times_s > library.target_ends_s.ravel()[0]]).max())

    return 100 * float(calm.tap_error[0, 0] - plain.tap_error[0, 0]), behind(plain), behind(calm)


def worst_of_production() -> tuple[float, ...]:
    """Worst error [%] of 15 devices before and after it is made least, of both clicks."""
    spread: dict[str, Value] = {"robust.resonance_spread": 0.04, "robust.quality_spread": 0.25}
    spread |= {"robust.samples": 5, "robust.minimise": "worst"}  # 14 devices beside the own one
    own = with_values(load_scene("lra_click"), spread)
    context = Context.recorded(own, [])
    entries = design([context.posed(0.0, 0.0, target) for target in own.axes.targets])
    found = [entry.spread for entry in entries]
    assert all(each is not None for each in found)
    return tuple(100 * value for each in found if each for value in (each.nominal_worst, each.robust_worst))


def gained_by_a_spread() -> tuple[float]:
    """Largest fall [%], in parts of itself, of the error over a spread of grips by the spread in the problem."""
    own = with_values(scene(), {"robust.grip_spread": 0.2})
    context = Context.recorded(own, recordings_of(own))
    entries = design([context.posed(v, grip) for v in (0.1, 0.4) for grip in own.grid.grips_N])
    found = [each.spread for each in entries]
    return (100 * max(1 - each.robust_rms / each.nominal_rms for each in found if each),)


def lost_by_blending() -> tuple[float]:
    """Largest distance [points] of a blend along the grip to the optimum that is solved there."""
    points = to.build(scene()).between_nodes([(0.4, grip) for grip in np.linspace(1, 5, 9)])
    return (100 * max(point.after - point.optimum for point in points),)


def felt_dB(current_A: float) -> float:
    return -float(solved(limits__current_A=current_A).felt_dB.mean())


CLAIMS = (
    Claim(
        "docs/explanation/problem.md",
        "the *floor*: {:.0f} to {:.0f} % at 80 ms, up to {:.0f} % in a firm hand",
        lambda: (*ends(solved().floor), 100 * float(solved("firm_fast").floor.max())),
    ),
    Claim(
        "docs/explanation/wall.md",
        "In `walled` the tap error is {:.0f} % at 1 N and {:.0f} % at 5 N where nothing binds, in place of {:.0f} "
        "and {:.0f} %. It takes {:.1f} to {:.1f} times the heat",
        walled,
    ),
    Claim(
        "docs/explanation/temperature.md",
        "at 36 % of the heat every acceleration is {:.0f} % of what it was, {:.1f} dB below",
        lambda: (100 * 0.36**0.5, -10 * np.log10(0.36)),
    ),
    Claim(
        "docs/howto/device_file.md",
        "20 % more grip takes the tap error from {:.0f} to {:.0f} % in the mean",
        lambda: (at_other_grip(1.0), at_other_grip(1.2)),
    ),
    Claim("docs/howto/grid.md", "Along the grip three nodes keep it within {:.1f} points.", lost_by_blending),
    Claim(
        "docs/howto/limits.md",
        "`low_supply` has a tap error of {:.0f} % in place of {:.0f} % at 0.4 m/s and 1 N",
        lambda: (
            100 * float(solved("low_supply", thermal__headroom_K=5.0).tap_error[1, 0]),
            100 * float(solved("low_supply").tap_error[1, 0]),
        ),
    ),
    Claim(
        "docs/howto/recordings.md",
        "the felt error at 0.2 m/s rises from {:.1f} to {:.1f} % at 1 N and from {:.1f} to {:.1f} % at 5 N",
        lambda: (*at_one_grip_for_all(0.2, 1.0), *at_one_grip_for_all(0.2, 5.0)),
    ),
    Claim(
        "docs/howto/robust.md",
        "At +-20 % grip on the default device the error over the spread falls by at most {:.1f} % of itself.",
        gained_by_a_spread,
    ),
    Claim(
        "docs/howto/targets.md",
        "The error of {:.0f} to {:.0f} % is mostly that swing, and the floor {:.0f} to {:.0f} %.",
        lambda: (*ends(solved("shaker_pulse").tap_error), *ends(solved("shaker_pulse").floor)),
    ),
    Claim(
        "docs/howto/targets.md",
        "a factor of 30 costs the click of 150 Hz {:.1f} points of error, and what still moves falls from {:.2f} to "
        "{:.2f} m/s²",
        calmed,
    ),
    Claim(
        "docs/howto/troubleshooting.md",
        "tap error of {:.0f} to {:.0f} % without a `*`",
        lambda: ends(solved().floor),
    ),
    Claim(
        "docs/intensity.md",
        "the felt energy is {:.1f} dB short in the mean at 4 A, {:.1f} dB at 2.5 A and {:.1f} dB at 1.25 A",
        lambda: (felt_dB(4.0), felt_dB(2.5), felt_dB(1.25)),
    ),
    Claim(
        "docs/intensity.md",
        "at 1.25 A taps from 0.3 m/s on then have tap errors of {:.0f} to {:.0f} %",
        lambda: ends(solved(limits__current_A=1.25, weights__objective="intensity").tap_error[2:]),
    ),
    Claim(
        "docs/reference/scenes.md",
        "from 0.6 m/s on taps are too weak, by up to {:.1f} dB",
        lambda: (-float(solved("firm_fast").felt_dB.min()),),
    ),
    Claim(
        "docs/reference/scenes.md",
        "the floor is {:.0f} to {:.0f} % |",
        lambda: ends(solved("soft_rubber").floor),
    ),
    Claim(
        "docs/results/lra_click.md",
        "is {:.2f} % at 150 Hz and {:.2f} % at 250 Hz and 3 V",
        lambda: tuple(100 * float(error) for error in solved("lra_click").tap_error[:, 0]),
    ),
    Claim(
        "docs/start/first_library.md",
        "the optimum under 4 A has a tap error of {:.0f} to {:.0f} % and a felt error of {:.1f} to {:.1f} %;",
        lambda: (*ends(solved().tap_error[3]), *ends(solved().felt_error[3])),
    ),
)
# Made again by `-m long`: it takes minutes.
LONG = (
    Claim(
        "docs/howto/robust.md",
        "the worst of 15 devices falls from {:.0f} to {:.0f} % (150 Hz) and from {:.0f} to {:.0f} % (250 Hz)",
        worst_of_production,
    ),
)
# Part of a sentence -> why it has no figure that a change of the project could make stale.
RULES = {
    "smaller beyond chance (1 %)": "a bound that the code tests",
    "floor of 26 % and more": "a row of symptoms: where a person looks",
    "above some 10 % at gain 1": "a rule of thumb",
    "felt within 1.6 dB": "the words of a verdict",
    "so that the floor is below 0.1 %": "a bound",
    "`transopt solve measured_impacts": "recordings that are not part of this package",
    "81 simulated taps": "asserted by the test that the sentence names",
    "keeps an error that no voltage removes": "an example, not a scene",
}


def check(claim: Claim) -> None:
    said = " ".join(text(claim.page).split())
    measured = claim.words.format(*claim.measured())
    assert measured in said, f"{claim.page}: measured today: {measured}"


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("claim", LONG, ids=lambda claim: f"{Path(claim.page).stem}: {claim.words[:40]}")
def test_what_takes_long_is_measured(claim: Claim) -> None:
    check(claim)


def unsourced() -> Iterator[str]:
    """Sentences that tell an outcome without a source."""
    claimed = {(claim.page, tuple(re.split(r"\{[^}]*\}", claim.words))) for claim in (*CLAIMS, *LONG)}
    for page in counted():
        if page.parent == APPENDIX:
            continue
        printed = "\n".join(block.prints or block.code * (block.language == "text") for block in fenced(page))
        for paragraph in paragraphs(hand_written(page)):
            linked = "\n".join(
                text(APPENDIX / name) for name in re.findall(r"\]\((?:\.\./)?results/(\w+\.md)\)", paragraph)
            )
            for sentence in SENTENCE.split(paragraph):
                if not (OUTCOME.search(sentence) and PERCENT.search(sentence)):
                    continue
                figures = FIGURE.findall(" ".join(PERCENT.findall(sentence)))
                known = any(
                    name == named(page) and any(len(p) > 12 and p in sentence for p in parts)
                    for name, parts in claimed
                )
                stated = any(part in sentence for part in RULES)
                if not (known or stated or all(figure in printed or figure in linked for figure in figures)):
                    yield f"{named(page)}: {sentence}"


def test_a_sentence_that_tells_an_outcome_has_a_source() -> None:
    assert list(unsourced()) == []
