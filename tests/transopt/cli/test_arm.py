"""Commands with an arm that has several motors: what they do, and what they refuse in one line."""

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from tests.benches.commands import Run, assert_refused
from transopt.library.file import load_library
from transopt.scene.builtin import SCENES

ONE_MOTOR = "model.kind = arm has several motors, and this needs one"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = (SCENES / "stylus_3d.toml").read_text(encoding="utf-8")
    for old, new in (
        ("speeds_m_s = [0.1, 0.2, 0.3]", "speeds_m_s = [0.2]"),
        ("grips_N = [1.0, 3.0]", "grips_N = [2.0]"),
        ("stages = 600", "stages = 240"),
    ):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path_factory.mktemp("arm") / "short.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def library(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from transopt.design.solve import solve

    path = tmp_path_factory.mktemp("solved") / "library.npz"
    solve(scene).save(path)
    return path


def changed(scene: Path, old: str, new: str) -> Path:
    """The scene with another line, in the folder of the test."""
    text = scene.read_text(encoding="utf-8")
    assert old in text
    path = Path("changed.toml")
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


def test_solve_writes_a_library_that_verifies(run: Run, scene: Path) -> None:
    outcome = run("solve", scene, "--out", "solved", "--table")
    assert outcome.code == 0
    assert "4 taps, all proven optimal and replayed." in outcome.out
    drawn = ["methods.png", "transients.png"]
    written = sorted(path.name for path in Path("solved").iterdir())
    assert written == ["library.npz", drawn[0], "report.json", "report.md", drawn[1]]
    assert "| 0.2 | 2 | 2 | 2 |" in Path("solved/report.md").read_text(encoding="utf-8")
    rows = json.loads(Path("solved/report.json").read_text(encoding="utf-8"))["entries"]
    assert [(row["normal"], row["posture"]) for row in rows] == [(1, 1), (1, 2), (2, 1), (2, 2)]
    assert all(row["tangential_error"] > 0 for row in rows)
    verified = run("verify", "solved/library.npz")
    assert verified.code == 0
    assert "4 of 4 entries certified and replayed clean" in verified.out


def test_the_first_look_is_short_and_detail_is_asked_for(run: Run, library: Path) -> None:
    loaded = load_library(library)
    first = run("show", library).out
    assert len(first.splitlines()) <= 14
    assert f"{100 * loaded.tap_error.max():.1f} % (felt " in first
    level = f"{loaded.felt_dB[0, 0]:.2f}"
    assert level not in first
    assert level in run("show", library, "--table").out


def test_show_draws(run: Run, library: Path) -> None:
    outcome = run("show", library, "--figure", "look.png")
    assert outcome.code == 0
    assert Path("look.png").read_bytes()[:4] == b"\x89PNG"
    assert_refused(run("show", library, "--figure", "look.pdf"), "--figure look.pdf: figures are written as .png")


def test_verify_fails_on_a_library_that_claims_too_much(run: Run, library: Path) -> None:
    loaded = load_library(library)
    command = loaded.command.copy()
    command[0, loaded.axes.places.index((2, 1)), 2, 20] += 0.05
    replace(loaded, command=command).save("forged.npz")
    outcome = run("verify", "forged.npz")
    assert outcome.code == 1
    assert "3 of 4 entries certified" in outcome.out
    assert_refused(run("export", "forged.npz", "arm.h"), "forged.npz", "normal 2, posture 1", "not certified")
    assert_refused(run("show", "forged.npz"), "forged.npz", "normal 2, posture 1", "not certified")


def test_export(run: Run, library: Path) -> None:
    assert run("export", library, "arm.h").code == 0
    assert "transopt_command" in Path("arm.h").read_text(encoding="ascii")
    loaded = load_library(library)
    assert run("export", library, "arm.csv").code == 0
    text = [line for line in Path("arm.csv").read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    heads, *rows = (line.split(",") for line in text)
    for j in range(3):
        column = np.array([float(row[heads.index(f"motor_{j + 1}_command_A")]) for row in rows])
        np.testing.assert_allclose(column, loaded.command[:, :, j].ravel(), rtol=1e-15, atol=0)
    assert run("export", library, "arm.mat").code == 0
    np.testing.assert_allclose(loadmat("arm.mat")["command"], loaded.command, rtol=1e-15, atol=0)
    for name, *options in (["arm.wav"], ["arm.h", "--drive"]):
        assert_refused(run("export", library, name, *options), ONE_MOTOR)


def test_compare_reads_every_place(run: Run, library: Path) -> None:
    outcome = run("compare", library, library)
    assert outcome.code == 0
    assert "4 entries; A and B hold the same content" in " ".join(outcome.out.split())


def test_compare_says_at_which_place_the_error_changes_most(run: Run, library: Path, scene: Path) -> None:
    weaker = changed(scene, "current_A = 2.5", "current_A = 1.3")
    assert run("solve", weaker, "--no-figures", "--out", "weaker").code == 0
    before, after = load_library(library), load_library(Path("weaker/library.npz"))
    ig = int(np.argmax(np.abs(after.tap_error - before.tap_error)[0]))
    normal, posture = before.axes.places[ig]
    last = run("compare", library, "weaker/library.npz").out.splitlines()[-1]
    assert f"at 0.2 m/s, 2 N, normal {normal}, posture {posture};" in last


def test_commands_for_one_motor_refuse_the_library(run: Run, library: Path) -> None:
    if find_spec("starlette") is not None:  # the extra of the page
        assert_refused(run("page", library), ONE_MOTOR)


def test_commands_for_one_motor_refuse_the_scene(run: Run, scene: Path) -> None:
    for arguments in (
        *([["page", scene]] if find_spec("starlette") is not None else []),
        ["study", scene, "--vary", "limits.current_A=2,3", "--out", "varied"],
        ["study", scene, "--study", "grip_mismatch", "--out", "mismatch"],
    ):
        outcome = run(*arguments)
        assert outcome.code == 2, arguments
        assert ONE_MOTOR in " ".join(outcome.err.split()), arguments


def test_options_for_one_motor_are_refused(run: Run, scene: Path) -> None:
    assert_refused(run("solve", scene, "--out", "x", "--full"), f"--full: {ONE_MOTOR}")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "current_A = 2.5",
            "current_A = 2.5\nsupply_V = 12.0",
            "limits.supply_V: model.kind = arm cannot have it yet",
        ),
        (
            "current_A = 2.5",
            "current_A = 2.5\nstroke_m = 1e-2",
            "limits.stroke_m: model.kind = arm cannot have it yet",
        ),
        ("[weights]", "[thermal]\nheadroom_K = 1.0\n[weights]", "thermal: model.kind = arm cannot have it yet"),
        ("[weights]", "[robust]\ngrip_spread = 0.2\n[weights]", "robust: model.kind = arm cannot have it yet"),
        (
            "rho = 1e-3",
            'rho = 1e-3\nobjective = "intensity"',
            "weights.objective: model.kind = arm cannot have it yet",
        ),
        (
            "grips_N = [2.0]",
            "grips_N = [2.0]\ncool_share = 0.5",
            "grid.cool_share: model.kind = arm cannot have it yet",
        ),
        ("grips_N = [2.0]", "grips_N = [0.0]", "grid.grips_N: model.kind = arm is held by a hand"),
        ("[weights]", "[feedback]\nstiffness_N_m = 200.0\n[weights]", "feedback: a wall is for a stylus on a motor"),
        ("[[0.0, 25.0, 35.0], ", "[[0.0, 0.0, -90.0], ", "postures_deg 1: singular"),
        ("tangential = 1.0", "tangential = -1.0", "weights.tangential"),
    ],
)
def test_scenes_that_an_arm_cannot_have(run: Run, scene: Path, old: str, new: str, said: str) -> None:
    assert_refused(run("solve", changed(scene, old, new), "--out", "x"), "changed.toml", said)


def test_a_striker_is_missing(run: Run, scene: Path) -> None:
    text = scene.read_text(encoding="utf-8")
    start, end = text.index("\n[striker]"), text.index("\n[model]")
    Path("unstruck.toml").write_text(text[:start] + text[end:], encoding="utf-8")
    assert_refused(run("solve", "unstruck.toml", "--out", "x"), "recordings.simulated: several motors do not strike")


def test_a_weight_of_directions_needs_several(run: Run) -> None:
    text = (SCENES / "wood_on_foam.toml").read_text(encoding="utf-8").replace('"../', f'"{SCENES.parent}/')
    Path("one.toml").write_text(text.replace("[weights]", "[weights]\ntangential = 2.0"), encoding="utf-8")
    assert_refused(run("solve", "one.toml", "--out", "x"), "weights.tangential: model.kind = drive has one direction")


def test_study_of_the_direction(run: Run, scene: Path) -> None:
    outcome = run("study", scene, "--study", "direction", "--out", "studied")
    assert outcome.code == 0
    assert "clipping every motor alone" in " ".join(outcome.out.split())
    assert Path("studied/direction/direction.png").read_bytes()[:4] == b"\x89PNG"
    assert "32 of 32 optima certified" in Path("studied/direction/report.md").read_text(encoding="utf-8")


def test_study_of_the_direction_needs_an_arm(run: Run) -> None:
    assert_refused(
        run("study", "single_grip", "--study", "direction", "--out", "x"),
        "single_grip: model.kind = drive is no arm: take a scene of an arm, as stylus_3d",
    )
