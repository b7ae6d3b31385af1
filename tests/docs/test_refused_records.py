"""Every line that the page on records names as a refusal is provoked, and what the page tells to do is done."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tests.benches.brought_files import FILES
from tests.benches.commands import Outcome, assert_refused, captured
from tests.benches.recording_files import wav
from tests.benches.tap_formats import SPEED_M_S, TAP_M_S2, TIMES_S, rows, universal
from tests.docs.pages import DOCS
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G

PAGE = (DOCS / "howto/recordings.md").read_text(encoding="utf-8")
LINES = re.findall(r"^\| (.*?) \| .* \|$", PAGE.partition("## What is refused")[2], re.MULTILINE)[1:]
IN_G = TAP_M_S2 / G
GOOD = "time_s,acc_g\n" + rows(TIMES_S, IN_G)
SPEED = f"--speed {SPEED_M_S}"
ELSEWHERE = {
    "`is read by ..., which is not installed`": "tests/transopt/recordings/test_sensors_and_axes.py",
    "`clipped` (`identify`)": "tests/transopt/identify",
}


class Refused(NamedTuple):
    """A file that is refused with a line of the page.

    Attributes
    ----------
    file, content : its name, and what stands in it.
    said : words of the line.
    remedy : options that read it, of what the line itself proposes or of the user's own.
    mended : content that is read in its place.
    options : of the command that is refused.
    """

    file: str
    content: str | bytes
    said: str
    remedy: Callable[[str], str] = lambda _: ""
    mended: str = ""
    options: str = SPEED


def proposed(line: str) -> str:
    """The first options that a line says were tried."""
    return re.split(r" \((?=[\d.e+]+ k?Hz)", line.partition("the right one: ")[2])[0]


def _of(name: str) -> str:
    return next(file.data.decode() for file in FILES if file.name == name)


STEPS = np.concatenate([TIMES_S[:900], TIMES_S[903:]])
LOST = "time_s,acc_g\n" + rows(STEPS, np.concatenate([IN_G[:900], IN_G[903:]]))
JITTERED = TIMES_S + 0.37e-4 * np.where(np.arange(TIMES_S.size) % 2, 1, -1)
POSITION = np.where(TIMES_S < 0.1, -SPEED_M_S * (TIMES_S - 0.1), 0.0)
AHEAD = 3 * SPEED_M_S * (TIMES_S - 0.1)  # further into the object than the stylus came
LATE = TIMES_S >= 0.0985
COARSE = np.round(POSITION / 1e-4) * 1e-4
THREE = np.concatenate([IN_G] * 3)
BESIDE = "time [s];acc [g]\n" + "".join(
    f"{t:.4f};{a + 5:.3f}\n".replace(".", ",", 1) for t, a in zip(TIMES_S, IN_G, strict=True)
)
CASES = {
    "`no unit stated in the columns ...`": [Refused("a.csv", "time,acc\n" + rows(TIMES_S, IN_G), "", proposed)],
    "`unknown column ...`": [
        Refused("a.csv", "time_s,positon_mm,acc_g\n" + rows(TIMES_S, IN_G, IN_G), "", proposed),
        Refused("a.csv", "time_s,x\n" + rows(TIMES_S, IN_G), "", proposed),
    ],
    "`has no row of names above it`": [Refused("a.csv", rows(TIMES_S, IN_G), "", proposed)],
    "`70000 characters, at most 65536`": [Refused("a.csv", "# " + "x" * 69_998 + "\n" + GOOD, "70001", mended=GOOD)],
    "`the times repeat, in groups`": [Refused("a.csv", _of("fifo.csv"), "", proposed)],
    "`1.069 stands beside decimal commas`": [
        Refused("a.csv", BESIDE, "5.000 stands beside", mended=BESIDE.replace(".", ","))
    ],
    "`2 acceleration columns in ...`": [Refused("a.csv", _of("two_sensors.csv"), "", proposed)],
    "`may hold grams of a load cell`": [Refused("a.csv", _of("load.csv"), "", proposed)],
    "`is what a sensor gives`": [Refused("a.csv", _of("picoscope.csv"), "", proposed)],
    "`2 channels`, `2 time responses`, `and which is ... is not stated`": [
        Refused(
            "a.wav",
            wav(np.stack([TAP_M_S2 / 500, TAP_M_S2 / 500], axis=1).astype("f4")),
            "2 channels",
            proposed,
            options=f"{SPEED} --full-scale 500",
        ),
        Refused("a.unv", universal(("m/s^2", "12"), ("m/s^2", "12")), "2 time responses", proposed),
    ],
    "`3 samples dropped; at most 1 in a row is interpolated`": [
        Refused("a.csv", LOST, "", mended="time_s,acc_g\n" + rows(STEPS[900:], IN_G[903:]))
    ],
    "`time stamps lie 0.4 steps (rms) off a uniform grid`": [
        Refused("a.csv", "time_s,acc_g\n" + rows(JITTERED, IN_G), "steps (rms) off a uniform grid", mended=GOOD)
    ],
    "`tap 4 is not there, the file has 3 taps`": [
        Refused(
            "a.csv",
            "time_s,acc_g\n" + rows(np.arange(THREE.size) * 1e-4, THREE),
            "",
            lambda _: f"{SPEED} --tap 2",
            options=f"{SPEED} --tap 4",
        )
    ],
    "`no incoming speed`": [
        Refused("a.csv", GOOD, "", lambda _: SPEED, options=""),
        Refused("a.csv", GOOD, "", mended=f"# speed_m_s: {SPEED_M_S}\n{GOOD}", options=""),
        Refused("a.csv", GOOD, "", mended="time_s,acc_g,position_m\n" + rows(TIMES_S, IN_G, POSITION), options=""),
    ],
    "`check the unit of the time`, `of the acceleration`, ...": [
        Refused("a.csv", "time_ms,acc_g\n" + rows(TIMES_S, IN_G), "check the unit of the time", proposed),
        Refused("a.csv", "time_s,acc_mg\n" + rows(TIMES_S, IN_G), "check the unit of the acceleration", proposed),
    ],
    "`speed fitted to the position of the 1.2 ms before contact: 0.2 +- 0.1 m/s`": [
        Refused(
            "a.csv",
            "time_s,acc_g,position_m\n" + rows(TIMES_S[LATE], IN_G[LATE], COARSE[LATE]),
            "speed fitted to the position of the 1.5 ms before contact",
            mended="time_s,acc_g,position_m\n" + rows(TIMES_S, IN_G, POSITION),
            options="",
        ),
    ],
    "`by the acceleration the stylus stops short ..., by the position it runs ... ahead`": [
        Refused(
            "a.csv",
            "time_s,acc_g,position_m\n" + rows(TIMES_S, IN_G, np.where(TIMES_S < 0.1, POSITION, -AHEAD)),
            "by the acceleration the stylus stops short",
            mended="time_s,acc_g,position_m\n" + rows(TIMES_S, IN_G, POSITION),
            options="",
        ),
        Refused(
            "a.csv",
            "time_s,acc_g,position_m\n" + rows(TIMES_S, IN_G, np.where(TIMES_S < 0.1, POSITION, -AHEAD)),
            "by the acceleration the stylus stops short",
            lambda _: f"{SPEED} --columns time_s,acc_g,-",
            options="",
        ),
    ],
    "`no tap stands out`, `no contact`": [
        Refused(
            "a.csv",
            "time_s,acc_g\n" + rows(TIMES_S, np.random.default_rng(1).standard_normal(TIMES_S.size)),
            "no tap stands out",
            mended=GOOD,
        )
    ],
}


def test_every_line_of_the_page_is_here() -> None:
    assert {*CASES, *ELSEWHERE} == set(LINES)
    assert len(LINES) == len(set(LINES)) >= 18


@pytest.mark.parametrize("line", CASES)
def test_it_is_refused_so_and_the_remedy_reads_it(line: str, tmp_path: Path) -> None:
    for case in CASES[line]:
        path = tmp_path / case.file
        refused = looked_at(path, case.content, case.options)
        assert_refused(refused, case.said or line.strip("`").rstrip(". "))
        options = case.remedy(refused.err.strip())
        stated = options if SPEED in options else f"{case.options} {options}"
        again = looked_at(path, case.mended or case.content, stated)
        assert again.code == 0, again.err


def looked_at(path: Path, content: str | bytes, options: str) -> Outcome:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return captured("transopt", "taps", path, *shlex.split(options))
