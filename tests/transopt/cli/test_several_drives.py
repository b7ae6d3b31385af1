"""A device of several drives that a scene states by matrices, from the scene to the C header."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

import transopt as to
from tests.benches.commands import Run, assert_refused
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.proof.certify import certify
from transopt.scene.builtin import SCENES
from transopt.solvers.choose import solve as optimum
from transopt.solvers.options import SolverOptions

PLANT = """\
[model]
kind = "state_space"
# States: height of the middle and of one end against the other, then their rates.
A = [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [-142122.0, 9000.0, -75.4, 0.0], [9000.0, -355305.0, 0.0, -119.2]]
B = [[0.0, 0.0], [0.0, 0.0], [100.0, 80.0], [150.0, -140.0]]
C = [[-142122.0, 9000.0, -75.4, 0.0], [9000.0, -355305.0, 0.0, -119.2]]
D = [[100.0, 80.0], [150.0, -140.0]]
motor_shares = [1.0, 0.6]
"""
SCENE = f"""\
description = "a table with a drive under each end, one of them weaker"
amplifier = "ideal"
hand_over_samples = 1

[time]
dt_s = 1e-4
stages = 300
lead_s = 0.0

[[targets]]
name = "click"
shape = "burst"
frequency_Hz = 100
cycles = 2
peak_m_s2 = 20.0

[[targets]]
name = "buzz"
shape = "burst"
frequency_Hz = 200
cycles = 4
peak_m_s2 = 10.0

{PLANT}
[limits]
steady_current_A = 0.04
current_A = 0.08

[weights]
tangential = 0.3
"""
ONE_ROW = (
    (
        "C = [[-142122.0, 9000.0, -75.4, 0.0], [9000.0, -355305.0, 0.0, -119.2]]",
        "C = [-142122.0, 9000.0, -75.4, 0.0]",
    ),
    ("D = [[100.0, 80.0], [150.0, -140.0]]", "D = [[100.0, 80.0]]"),
    ("tangential = 0.3", ""),
)


def written(*changes: tuple[str, str]) -> Path:
    """The scene in the folder of the test, with other lines."""
    text = SCENE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = Path("table.toml")
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    path = tmp_path_factory.mktemp("table") / "table.toml"
    path.write_text(SCENE, encoding="utf-8")
    return to.solve(path)


def played(header: Path, calls: str, library: Library) -> np.ndarray:
    """Commands that the header returns, by target or speed, motor and tick."""
    lines = f"""\
#include <stdio.h>
#include "{header.name}"
int main(void)
{{
    for (int m = -1; m <= TRANSOPT_MOTORS; m++)
        for (int k = -1; k <= TRANSOPT_SAMPLES; k++) printf("%.9g\\n", (double){calls});
    return 0;
}}
"""
    main = header.with_name("main.c")
    main.write_text(lines, encoding="ascii")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run(["cc", *flags, main.name, "-o", "main"], cwd=header.parent, check=True)
    run = subprocess.run([header.parent / "main"], text=True, capture_output=True, check=True)
    m, stages = library.command.shape[2:]
    found = np.array(run.stdout.split(), dtype=float).reshape(m + 2, stages + 2)
    assert not found[[0, -1]].any()
    assert not found[:, [0, -1]].any()
    return np.asarray(found[1:-1, 1:-1])


def test_goes_from_the_scene_to_the_header(run: Run) -> None:
    outcome = run("solve", written(), "--out", "out")
    assert outcome.code == 0
    assert "2 targets, all proven optimal and replayed." in outcome.out
    assert "held back by the 0.08 A current limit" in " ".join(outcome.out.split())
    assert run("verify", "out/library.npz").code == 0
    assert run("show", "out/library.npz", "--figure", "look.png").code == 0
    assert Path("look.png").read_bytes()[:4] == b"\x89PNG"
    assert run("export", "out/library.npz", "table.h").code == 0
    solved = load_library(Path("out/library.npz"))
    for target in range(2):
        found = played(Path("table.h").resolve(), f"transopt_command({target}, m, k)", solved)
        wanted = solved.command[target, 0]
        assert np.abs(found - wanted).max() < 4 * np.abs(solved.command).max() / 65534
        assert (np.abs(found).max(axis=1) <= 0.08 * np.array([1.0, 0.6])).all()
    assert not played(Path("table.h").resolve(), "transopt_command(2, m, k)", solved).any()
    for name, *options in (["table.wav"], ["table.h", "--drive"]):
        assert_refused(
            run("export", "out/library.npz", name, *options), "model.kind = state_space has several motors"
        )


def test_has_motors_directions_and_no_places(library: Library) -> None:
    assert library.command.shape == (2, 1, 2, 300)
    assert library.acceleration_m_s2.shape == (2, 1, 2, 300)
    assert library.normals.shape == (0, 3)
    names = library.arrays()
    assert "normals" not in names
    assert {"mu_current_motor_2_upper", "tangential_error"} <= set(names)


def test_weaker_motor_binds_at_its_share(library: Library) -> None:
    most = np.abs(library.command).max(axis=(0, 1, 3))
    np.testing.assert_allclose(most, [0.08, 0.048], rtol=1e-5)


def test_is_the_optimum_of_another_solver(library: Library) -> None:
    problem = library.problem(0, 0)
    other = optimum(problem, SolverOptions("casadi-piqp"))
    proof = certify(problem, other.command, other.multipliers)
    assert proof.accepted
    assert library.objective[0, 0] == pytest.approx(proof.objective, abs=1e-8)


def test_one_acceleration_is_made_by_all_drives(run: Run) -> None:
    assert run("solve", written(*ONE_ROW), "--out", "one").code == 0
    assert run("verify", "one/library.npz").code == 0
    one = load_library(Path("one/library.npz"))
    assert one.command.shape == (2, 1, 2, 300)
    assert one.acceleration_m_s2.shape == (2, 1, 300)
    assert "tangential_error" not in one.arrays()


def test_taps_are_blended_between_speeds(run: Run) -> None:
    arm = (SCENES / "stylus_3d.toml").read_text(encoding="utf-8")
    taps = arm[arm.index("[recordings]") : arm.index("[model]")]
    text = SCENE[: SCENE.index("[[targets]]")] + SCENE[SCENE.index("[model]") :]
    text = text.replace("[time]", "[grid]\nspeeds_m_s = [0.1, 0.2]\n[time]").replace("_A = 0.0", "_A = 9.0")
    Path("taps.toml").write_text(f'{text}\n[hand]\nyields = "straight"\n{taps}', encoding="utf-8")
    assert run("solve", "taps.toml", "--out", "taps").code == 0
    assert run("export", "taps/library.npz", "taps.h").code == 0
    solved = load_library(Path("taps/library.npz"))
    found = played(Path("taps.h").resolve(), "transopt_command(0.15f, m, k)", solved)
    assert np.abs(found - solved.at(0.15, 0.0).command).max() < 4 * np.abs(solved.command).max() / 65534
    assert not played(Path("taps.h").resolve(), "transopt_command(-0.1f, m, k)", solved).any()


@pytest.mark.parametrize("name", ["table.npz", "table.mat"])
def test_matrices_come_from_a_file(run: Run, library: Library, name: str) -> None:
    plant = library.plant(0)
    arrays = {each: getattr(plant, each) for each in "ABCD"}
    if name.endswith(".npz"):
        np.savez(name, **arrays)
    else:
        from scipy.io import savemat

        savemat(name, arrays)
    lines = [line for line in PLANT.splitlines() if line[:3] in ("A =", "B =", "C =", "D =")]
    of_file = written(*((line, f'file = "{name}"' if line[0] == "A" else "") for line in lines))
    assert run("solve", of_file, "--out", "x").code == 0
    np.testing.assert_allclose(load_library(Path("x/library.npz")).command, library.command, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("B = [[0.0, 0.0], ", "B = [", "B: B has 2 columns, so it needs 4 rows of 2 numbers"),
        ("B = [[0.0, 0.0], ", "B = [[0.0, 0.0, 0.0], ", "B: B has 3 columns, so it needs 4 rows of 3 numbers"),
        ("D = [[100.0, 80.0], ", "D = [", "D: B has 2 columns, so it needs 2 rows of 2 numbers"),
        ("D = [[100.0, 80.0], [150.0, -140.0]]", "D = 1.0", "D: B has 2 columns, so it needs 2 rows of 2 numbers"),
        ("[9000.0, -355305.0, 0.0, -119.2]]\nD", "[9000.0, -355305.0, 0.0]]\nD", "C: a row of 3 numbers, A has 4"),
        ("[1.0, 0.6]", "[1.0]", "motor_shares: 1 of them, B has 2 columns: give one for each"),
        ("B = [[0.0, 0.0], [0.0, 0.0], [100.0, 80.0], [150.0, -140.0]]", "B = [0, 0, 100, 150]", "C: 2 rows need"),
        ("current_A = 0.08", "current_A = 0.08\nstroke_m = 1e-3", "limits.stroke_m: model.kind = state_space cannot"),
        ('"ideal"', '"ideal"\nrobust = { grip_spread = 0.2 }', "robust: model.kind = state_space cannot have it yet"),
    ],
)
def test_refuses_what_does_not_fit(run: Run, old: str, new: str, said: str) -> None:
    assert_refused(run("solve", written((old, new)), "--out", "x"), "table.toml", said)


def test_a_weight_across_needs_several_accelerations(run: Run) -> None:
    assert_refused(
        run("solve", written(*ONE_ROW[:2]), "--out", "x"),
        "weights.tangential: model.kind = state_space has one direction",
    )
