"""`transopt-play tap --simulate` as a user meets it: figure and telemetry, messages, exit codes."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.benches.commands import Run
from tests.benches.places import ROOT
from transopt.library.library import Library
from transopt.scene.recordings import Recordings


def test_tap_with_figure_and_telemetry(play: Run) -> None:
    outcome = play("tap", "library.npz", "--simulate", "--speed", 0.3, "--grip", 3, "--out", "run")
    assert (outcome.code, outcome.err) == (0, "")
    for word in (
        "latency",
        "tap error",
        "playback error",
        "peak",
        "spectral error",
        "rate-hardness",
        "winding",
        "clamps",
        "verdict",
    ):
        assert word in outcome.out
    assert {path.name for path in Path("run").iterdir()} == {
        "tap.png",
        "telemetry.csv",
        "telemetry.npz",
        "events.csv",
        "tap_001.csv",
    }


def sentences(out: str) -> str:
    """What tables print, in one line: their cells wrap as the terminal is wide."""
    return " ".join(out.replace("│", " ").split())


def test_a_tap_outside_the_grid_has_its_reason_and_no_empty_figures(play: Run) -> None:
    outcome = play("tap", "library.npz", "--simulate", "--speed", 0.9)
    assert (outcome.code, outcome.err) == (0, "")
    assert "lies outside the library's 0.1 to 0.4 m/s" in sentences(outcome.out)
    for what in ("peak current", "winding", "verdict"):
        assert what in outcome.out
    for figure in ("latency", "tap error", "playback", "predicted", "rate-hardness"):
        assert figure not in outcome.out
    assert not re.search(r"[│ ]-  *│", outcome.out)


def test_rate_hardness_of_recorded_taps_says_why_there_is_no_other(play: Run, library: Library) -> None:
    scene = library.scene()
    stated = {**scene.model_dump()["recordings"], "simulated": None, "files": ["tap.csv"]}
    recorded = scene.model_copy(update={"recordings": Recordings(**stated)})
    replace(library, meta={**library.meta, "scene": recorded.model_dump(mode="json")}).save(Path("recorded.npz"))
    outcome = play("tap", "recorded.npz", "--simulate", "--speed", 0.3, "--grip", 3)
    assert (outcome.code, outcome.err) == (0, "")
    assert "the real object, struck: unknown, as no recorded tap tells the force" in sentences(outcome.out)


@pytest.mark.parametrize("user", ["straight", "stops"])
def test_another_users_tap(play: Run, user: str) -> None:
    outcome = play("tap", "library.npz", "--simulate", "--speed", 0.3, "--grip", 3, "--user", user)
    assert (outcome.code, outcome.err) == (0, "")
    assert f"{user} user" in outcome.out


def test_nothing_played_is_a_result_that_fell_short(play: Run) -> None:
    outcome = play("tap", "library.npz", "--simulate", "--grip", 0.1)
    assert outcome.code == 1
    assert "no transient played" in outcome.out


def test_a_simulated_tap_never_loads_the_optimiser(library: Library, tmp_path: Path) -> None:
    library.save(tmp_path / "library.npz")
    program = (
        "import sys; from pathlib import Path; import controller.cli.play\n"
        "assert not {'numpy', 'scipy', 'casadi', 'matplotlib'} & set(sys.modules), 'help must come at once'\n"
        "sys.argv = ['transopt-play', 'tap', sys.argv[1], '--simulate']\n"
        "try:\n    controller.cli.play.main()\nexcept SystemExit as stop:\n    assert not stop.code\n"
        "assert not {'casadi', 'matplotlib', 'serial', 'scipy.signal', 'scipy.stats'} & set(sys.modules)"
    )
    path = str(tmp_path / "library.npz")
    subprocess.run([sys.executable, "-c", program, path], check=True, cwd=ROOT, timeout=60)
