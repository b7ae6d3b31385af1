"""What commands print into a terminal of any width from 60 columns: no number cut or split, first looks short."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.benches.places import ROOT

if sys.platform == "win32":
    pytest.skip("has no pseudo-terminals of this kind", allow_module_level=True)

WIDTHS = (60, 80, 100, 120, 160)
WIDE = 400  # where everything stands in one line
FIRST = 14  # lines of a first look at twelve entries
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?")
# A command, also the one that a written file is to be used with; a file; a line of TOML.
COPIED = re.compile(r" *(transopt|/|out/|click|\w+ = ).*|\S+ written; [a-z ,]+: transopt [^;]*")
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
WOOD, OTHER, CLICK = (f"out/{name}/library.npz" for name in ("wood_on_foam", "single_grip", "lra_click"))
TAPS = sorted(map(str, (ROOT / "problems/recordings").glob("*.csv")))
VARIED = ("--vary", "limits.current_A=4,5", "--speed", "0.4", "--executor", "serial", "--out", "study")
ASKED = (
    *("--require", "tap_error<=30%", "--solve-for", "limits.current_A=4:6", "--speed", "0.4", "--grip", "5"),
    *("--executor", "serial", "--out", "least"),
)
SHEET = (
    *("--resonance-Hz", "150", "--rms-V", "2", "--rms-A", "0.15", "--R-ohm", "8", "--case-mass-kg", "0.1"),
    *("--rms-g", "1.4", "--rise-s", "0.03", "--stroke-m", "6e-4", "--peak", "3"),
)
BEFORE = [["transopt", "solve", name, "--no-figures"] for name in ("single_grip", "lra_click")]
SOLVE, SHOW = ["transopt", "solve", "--no-figures"], ["transopt", "show", WOOD]
COMMANDS = {
    "show in detail": ["transopt", "show", OTHER, "--table", "--report"],
    "show targets in detail": ["transopt", "show", CLICK, "--table"],
    "verify": ["transopt", "verify", OTHER],
    "compare": ["transopt", "compare", WOOD, OTHER],
    "taps": ["transopt", "taps", *TAPS],
    "scene list": ["transopt", "scene", "list"],
    "scene keys": ["transopt", "scene", "keys"],
    "export to a driver": ["transopt", "export", CLICK, "click.wav", "--drive", "--rate-Hz", "24000"],
    "device show": ["transopt-play", "device", "show"],
}
LONGER = {
    "solve a poor one": ["transopt", "solve", "firm_fast", "--no-figures"],
    "solve in detail": ["transopt", "solve", "--no-figures", "--table", "--report"],
    "identify coil": ["transopt", "identify", "coil", "heat.npz", "--out", "MODEL.json"],
    "study": ["transopt", "study", *VARIED],
    "a question to the study": ["transopt", "study", *ASKED],
    "a sheet completed": ["transopt", "plant", "new", "lra", *SHEET, "--force"],
    "tap": ["transopt-play", "tap", WOOD, "--simulate"],
    "tap outside": ["transopt-play", "tap", WOOD, "--simulate", "--speed", "0.9"],
}
TIMED = ("solve in detail", "study")  # some of their numbers are times
Printed = dict[int, tuple[str, int]]  # width -> text and exit code


def printed(folder: Path, *asked: tuple[list[str], Sequence[int]]) -> list[Printed]:
    """What each command prints at each of its widths."""
    ended = subprocess.run(
        [sys.executable, "-m", "tests.benches.widths"],
        input=json.dumps(asked),
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "OPENBLAS_NUM_THREADS": "1", "COLUMNS": ""},
        timeout=1000,
    )
    return [
        {width: (COLOUR.sub("", text), code) for width, (text, code) in zip(widths, each, strict=True)}
        for each, (_, widths) in zip(json.loads(ended.stdout), asked, strict=True)
    ]


def check(name: str, by_width: Printed) -> None:
    """No terminal cuts or splits what a wide one shows whole."""
    wide, code = by_width[WIDE]
    for width, (text, its_code) in by_width.items():
        assert its_code == code, text
        assert "…" not in text
        # A line that a terminal has to break itself is to be copied.
        long = [line for line in text.splitlines() if len(line) > width]
        assert all(re.fullmatch(COPIED, line) for line in long), long
        if name not in TIMED:
            assert set(NUMBER.findall(text)) == set(NUMBER.findall(wide)), (name, width)


def check_first(text: str) -> None:
    lines = text.splitlines()
    assert len(lines) <= FIRST, text
    assert lines[0].startswith("wood_on_foam: 12 taps, all proven optimal")
    assert "36.2*" in text
    assert "The 4 A current limit costs most: with 5 A 27.9 %; from about 6.1 A on" in " ".join(text.split())
    assert sum(line.startswith("  transopt") for line in lines) == 3


def test_first_looks_are_short_and_no_table_cuts_or_splits_a_number(tmp_path: Path) -> None:
    narrow = (WIDTHS[0], WIDE)
    before = [(command, (80,)) for command in BEFORE]
    tables = [(command, narrow) for command in COMMANDS.values()]
    found = printed(tmp_path, *before, (SOLVE, narrow), (SHOW, (*WIDTHS, WIDE)), *tables)
    for name, by_width in zip(("solve", "show", *COMMANDS), found[len(before) :], strict=True):
        assert by_width[WIDE][1] == 0, (name, by_width[WIDE][0])
        check(name, by_width)
        for width in by_width.keys() - {WIDE} if name in ("solve", "show") else ():
            check_first(by_width[width][0])
    # What README and the manual's first page quote is what is printed.
    quoted = found[len(before)][WIDE][0].split("out/wood_on_foam: ")[0]
    for page in ("README.md", "docs/start/everything.md"):
        assert quoted in (ROOT / page).read_text(encoding="utf-8"), page


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_nor_any_other_command_at_any_width(tmp_path: Path) -> None:
    t = np.arange(0.0, 3000.0, 10.0)
    warm = 22.0 + np.where(t < 1500, 60 * (1 - np.exp(-t / 600.0)), 55.0 * np.exp(-(t - 1500.0) / 600.0))
    np.savez(tmp_path / "heat.npz", time_s=t, current_A=np.where(t < 1500, 1.1, 0.0), winding_C=warm)
    before, widths = [(command, (80,)) for command in (*BEFORE, SOLVE)], (*WIDTHS, WIDE)
    commands = {"solve": SOLVE, "show": SHOW, **COMMANDS, **LONGER}
    found = printed(tmp_path, *before, *((command, widths) for command in commands.values()))
    for name, by_width in zip(commands, found[len(before) :], strict=True):
        check(name, by_width)
        for width in WIDTHS if name in ("solve", "show") else ():
            check_first(by_width[width][0])


PIPED = """
from rich.text import Text
from transopt.base.terminal import console
out = console()
out.print("word " * 100, style="red")
out.print(Text("word " * 30))
"""


@cache
def piped(columns: str) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    environment |= {"PYTHONPATH": str(ROOT), "NO_COLOR": "1", **({"COLUMNS": columns} if columns else {})}
    command = [sys.executable, "-c", PIPED]
    return subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout


@pytest.mark.parametrize(("columns", "width"), [("60", 60), ("", 160)])
def test_a_pipe_has_whole_lines_and_is_as_wide_as_columns_says(columns: str, width: int) -> None:
    out = piped(columns)
    assert "\x1b" not in out
    whole, *broken = out.splitlines()
    assert whole.split() == ["word"] * 100
    assert 0.9 * width < max(map(len, broken)) <= width
