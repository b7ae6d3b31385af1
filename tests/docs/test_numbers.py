"""Numbers with a unit in the prose of the manual: each has a source that changes with the project.

A round number has one easily: the code names a tenth of all whole milliseconds, nearly half of all whole percents.
The source is one of these. A block of the page prints it. The page of results that its paragraph links to has it.
A claim of `test_figures` or of `COMPUTED` makes it again. A test that its sentence names states it. Or the code names
it with its unit (`stated`): a constant, a default, a bound or a value of a built-in scene. What comes from outside of
the project, and examples of what a user states, are named in `GIVEN`.
"""

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import transopt as to
from tests.benches.places import ROOT
from tests.docs.pages import fenced, named, text
from tests.docs.stated import UNITS, G, is_stated
from tests.docs.test_figures import CLAIMS, LONG, RULES, Claim, check, ends, free, scene, solved
from tests.docs.test_words import APPENDIX, SENTENCE, counted, hand_written, paragraphs
from transopt.library.drive import drive_of, driver_for
from transopt.library.drive_replay import played
from transopt.plant.coil import COPPER_PER_K
from transopt.scene.recordings import recordings_of, references_of

NAMES = "|".join(sorted(map(re.escape, UNITS), key=len, reverse=True))
FIGURE = r"\d+(?:[ ,]\d{3})*(?:\.\d+)?(?:e-?\d+)?"
WITH_UNIT = re.compile(rf"(?<![\w.\-/^])[+-]?({FIGURE})(?: (?:to|and|or|of) [+-]?({FIGURE}))? ({NAMES})(?![\w/²^])")
MATHEMATICS = re.compile(r"\$[^$]*\$")
# Page whose numbers are those of parts and data sheets of others -> whose.
OF_OTHERS = {
    "docs/howto/hardware.md": "makers of motors, amplifiers, sensors and boards",
    "docs/howto/circuits.md": "parts of a circuit, with the values that it has",
    "docs/plants/sheets.md": "makers of actuators",
}


def faster(by: float) -> float:
    """Largest current [A] of the default library, played on an amplifier with a faster pole."""
    library, own = solved(), scene()
    other = scene(amplifier__pole_Hz=by * own.amplifier.pole_Hz)
    largest = 0.0
    for ig, grip_N in enumerate(library.grips_N):
        stage = other.posing().stage(other.plant(grip_N))
        for iv in range(len(library.speeds_m_s)):
            command = library.problem(iv, ig).continued(library.command[iv, ig])
            largest = max(largest, float(np.abs(stage.rollout(command)[1]).max()))
    return largest


def over_bound(name: str) -> float:
    """Largest distance [%] of J to its lower bound, rounded up to two decimals."""
    bounds = [entry.certificate.relative_bound for entry in to.build(scene(name)).all_entries()]
    return math.ceil(1e4 * max(bounds)) / 100


def after_window(after_s: float) -> float:
    """Largest acceleration [g] after the waveform, of 0.3 m/s and 1 N."""
    own = scene(weights__after_s=after_s, grid__speeds_m_s=[0.3], grid__grips_N=[1.0])
    (entry,) = to.build(own).all_entries()
    return float(entry.figures.peak_after_m_s2 if after_s else entry.played.after_peak_m_s2) / G


def clipped() -> tuple[float, ...]:
    """Tap errors and felt errors [%] at 0.4 m/s of the optimum without limits, clipped at the limit."""
    entries = [entry for entry in to.build(scene()).all_entries() if entry.speed_m_s == 0.4]
    found = [entry.baselines.clipped for entry in entries]
    return tuple(
        100 * limit(getattr(each, name) for each in found)
        for name in ("tap_error", "felt_error")
        for limit in (min, max)
    )


def through_driver(rate_Hz: float) -> tuple[float, ...]:
    """Tap errors [%] of both clicks, played by a driver of another rate."""
    library = solved("lra_click")
    driver = driver_for(library, rate_Hz, "float")
    return tuple(
        100 * each.tap_error for each in played(library, [drive_of(library, iv, 0, driver) for iv in (0, 1)])
    )


def peaks(name: str) -> tuple[float, float]:
    """Least and largest peak [g] of the recorded taps of a scene."""
    own = scene(name)
    found = [np.abs(each.target.recorded_m_s2).max() for each in references_of(own, recordings_of(own))]
    return ends(np.array(found), 1 / G)


def continuous_A() -> tuple[float]:
    motor = scene().motor
    return (motor.i_continuous_A,)


COMPUTED = (
    *(
        Claim(
            "docs/howto/export.md",
            f"| {rate} kHz | {{:.2f}} % | {{:.2f}} % |",
            lambda rate_Hz=1e3 * rate: through_driver(rate_Hz),  # type: ignore[misc]
        )
        for rate in (48, 44.1, 24, 8, 2)
    ),
    Claim(
        "docs/explanation/problem.md",
        "over window and tail | {:.1f} to {:.1f} % |",
        lambda: ends(solved().felt_error[free(solved())]),
    ),
    Claim(
        "docs/explanation/problem.md",
        "a second tap of up to {:.1f} g in the default scene. With it at most {:.1f} g are left.",
        lambda: (after_window(0.0), after_window(0.03)),
    ),
    Claim(
        "docs/explanation/servo.md",
        "a faster amplifier passes it: {:.1f} A instead of 4 A with a pole faster by 10 %, {:.1f} A by 20 %.",
        lambda: (faster(1.1), faster(1.2)),
    ),
    Claim(
        "docs/explanation/servo.md",
        "Amplifier and monitor that are 10 % off each leave {:.0f} %.",
        lambda: (100 * (1.1 / 0.9 - 1),),
    ),
    Claim(
        "docs/explanation/temperature.md",
        "*over bound* is at most {:.2f} % in `hot_coil` and {:.2f} % in `rapid_tapping`",
        lambda: (over_bound("hot_coil"), over_bound("rapid_tapping")),
    ),
    Claim("docs/explanation/temperature.md", "that the datasheet states, {:.2f} A.", continuous_A),
    Claim("docs/howto/limits.md", "$R$ grows by {:.2f} % per kelvin", lambda: (100 * COPPER_PER_K,)),
    Claim("docs/intensity.md", "0.02 allows {:.2f} dB.", lambda: (-20 * np.log10(1 - 0.02),)),
    Claim(
        "docs/plants/datasheet.md",
        "the root of the reduced masses, which at 3 g in 100 g and in 180 g is {:.1f} %",
        lambda: (100 * (math.sqrt((3 * 180 / 183) / (3 * 100 / 103)) - 1),),
    ),
    Claim("docs/reference/scenes.md", "taps of 30 to 60 cm/s ({:.0f} to {:.0f} g)", lambda: peaks("firm_fast")),
    Claim("docs/reference/scenes.md", "{:.1f} to {:.0f} g in pulses so long", lambda: peaks("soft_rubber")),
    Claim(
        "docs/start/first_library.md",
        "| 4.000 | 25.23 | {} | felt within 1.6 dB; held back by command and current |",
        lambda: (solved().binding[3, 2],),
    ),
    Claim(
        "docs/start/everything.md",
        "Errors of {:.0f} to {:.0f} % without a binding limit",
        lambda: ends(solved().floor),
    ),
    Claim(
        "docs/start/first_library.md",
        "clipping at 4 A gives {:.0f} to {:.0f} % and {:.0f} to {:.0f} %",
        clipped,
    ),
)
# Part of a sentence -> why its number cannot become stale.
GIVEN = {
    "or 1e-6 of a limit below 1 A or 1 V": "the unit of a relative bound",
    "one tick of 1 A would heat the coil by 75 K": "the seed's equation with the seed's numbers",
    "falls to zero at a grip of 65 N": "the seed's equation",
    "(`stroke -0.02 m at 79.67 ms`)": "the form of a message",
    "(`stroke -0.00018 m of device 3 of the spread at 8.44 ms`": "the form of a message",
    "`speed fitted to the position of the 1.2 ms before contact": "the form of a message",
    "0.75 A": "the default of `--amplitude`, without a unit in its name",
    "a fault if it was held at START (over 0.6 N)": "a rule of the simulated device",
    "a fault after 0.15 A s": "the servo's `stuck_A_s`",
    "have peaks of 3 to 20 g on wood, metal and rubber": "what people measure on objects of their own",
    "approach steadily over 30 mm": "an instruction",
    "From 25 ms to 10 s long": "a rule for recordings",
    "over 40 ms within 110 ms of contact": "two bounds in one",
    "9.81 times more or less": "standard gravity",
    "9.81 or 1000 times more or less": "standard gravity",
    "0 ± 2 m/s² at rest": "the bound of a check of the device",
    "115 200 baud": "the speed of a serial line",
    "check; taps, 5 s to send each; sweeps to": "what fits on the device, and on the line",
    "check; taps of 92 in place of 160 ms": "what fits on the device, and on the line",
    "An adapter of FTDI's kind keeps bytes for 16 ms": "the data sheet of an adapter",
    "half a sine of 20 g": "an invented scene, which states m/s² only",
    "People notice 1.6 to 1.9 dB.": "literature",
    "1.414 times an rms value": "the root of two",
    "The scene makes 1.2 g at 1.8 V and 235 Hz, as the sheet says": "the data sheet of an actuator",
    "what a driver of 8 bit plays at 24 kHz": "an example of an option",
    "outside of 0.02 to 20 000 m/s² per A or V": "bounds by ampere or volt",
    "a mode of 6.5 kHz, above the servo's Nyquist frequency": "what the numbers of a scene come to",
    "an 8 mm motor, its winding 0.01 K below the limit": "what the numbers of a scene come to",
    "a measured shock-table pulse (500 g, 0.6 ms)": "recordings of others",
    "command and current, 10 to 4000 Hz": "the default of an option without a unit in its name",
}


def with_units(sentence: str) -> Iterator[tuple[str, str]]:
    """Numbers of a sentence, as written, each with its unit."""
    for found in WITH_UNIT.finditer(MATHEMATICS.sub("", sentence)):
        yield from ((number, found[3]) for number in found.group(1, 2) if number)


def rounds_to(number: str, source: str) -> bool:
    """Whether a source has this number, as written or with more digits."""
    plain = re.sub("[ ,]", "", number)
    decimals = len(plain.partition(".")[2])
    return any(f"{float(each):.{decimals}f}" == plain for each in re.findall(r"\d+\.?\d*", source))


def remade(page: Path) -> str:
    """What the claims on a page state, numbers included."""
    prose = " ".join(text(page).split())
    claims = [claim.words for claim in (*CLAIMS, *LONG, *COMPUTED) if claim.page == named(page)]
    patterns = [r"[^|]{1,80}?".join(map(re.escape, re.split(r"\{[^}]*\}", words))) for words in claims]
    return "\n".join(found for pattern in patterns for found in re.findall(pattern, prose))


def unsourced() -> Iterator[str]:
    """Sentences with numbers without a source."""
    for page in counted():
        if page.parent == APPENDIX or named(page) in OF_OTHERS:
            continue
        of_page = "\n".join([remade(page), *(block.prints or block.code for block in fenced(page))])
        for paragraph in paragraphs(hand_written(page)):
            results = [APPENDIX / name for name in re.findall(r"\]\((?:\.\./)?results/(\w+\.md)\)", paragraph)]
            for sentence in SENTENCE.split(paragraph):
                if any(part in sentence for part in (*RULES, *GIVEN)):
                    continue
                tests = [ROOT / name for name in re.findall(r"tests/[\w/]+\.py", sentence)]
                source = "\n".join([of_page, *map(text, (*results, *tests))])
                left = [
                    f"{number} {unit}"
                    for number, unit in with_units(sentence)
                    if not (rounds_to(number, source) or is_stated(float(re.sub("[ ,]", "", number)), unit))
                ]
                if left:
                    yield f"{named(page)}: {', '.join(left)}: {sentence}"


@pytest.mark.parametrize(
    "claim", [*CLAIMS, *COMPUTED], ids=lambda claim: f"{Path(claim.page).stem}: {claim.words[:40]}"
)
def test_what_is_claimed_and_what_is_computed_is_on_its_page(claim: Claim) -> None:
    check(claim)


def test_every_number_with_a_unit_has_a_source() -> None:
    assert list(unsourced()) == []


def test_what_is_given_is_on_a_page() -> None:
    """An exemption without its sentence exempts whatever comes to say it next."""
    prose = "\n".join(" ".join(hand_written(page).split()) for page in counted())
    assert [part for part in GIVEN if part not in prose] == []


def test_a_number_without_a_source_is_found() -> None:
    assert list(with_units("It takes 12.5 to 17 ms and 3 N, at $x = 4$ m/s.")) == [
        ("12.5", "ms"),
        ("17", "ms"),
        ("3", "N"),
    ]
    assert rounds_to("17.4", "| 17.412 |")
    assert not rounds_to("17.4", "| 17.5 |")
    assert is_stated(30, "ms")  # the intention
    assert not is_stated(12.347, "ms")
