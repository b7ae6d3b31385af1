"""Libraries of an arm: whole files, blends that keep the limits, and the C header."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import transopt as to
from transopt.base.errors import InputError
from transopt.design.arm import ArmBuild, build_arm, verify_arm
from transopt.library.arm import ArmLibrary, is_arm_library, load_arm_library
from transopt.library.arm_header import arm_header
from transopt.library.arrays import HASH_FIELD, content_hash
from transopt.proof.several import replay_several
from transopt.scene.scene import Scene


def short_scene(**changed: Any) -> Scene:
    """The built-in scene with fewer nodes and a shorter window."""
    content = to.load_scene("stylus_3d").model_dump(mode="json")
    content["grid"] |= {"speeds_m_s": [0.1, 0.3], "grips_N": [1.0, 3.0]}
    content["time"] |= {"stages": 240}
    content["weights"] |= {"after_s": 0.01}
    for key, value in changed.items():
        content[key] |= value
    return Scene.model_validate(content)


@pytest.fixture(scope="module")
def build() -> ArmBuild:
    return build_arm(short_scene())


@pytest.fixture(scope="module")
def library(build: ArmBuild) -> ArmLibrary:
    assert build.library is not None
    return build.library


@pytest.fixture
def file(library: ArmLibrary, tmp_path: Path) -> Path:
    path = tmp_path / "library.npz"
    library.save(path)
    return path


def rewritten(path: Path, **changed: Any) -> None:
    """Write a file again with other arrays, and the hash that they have."""
    with np.load(path) as opened:
        arrays = {name: opened[name] for name in opened.files if name != HASH_FIELD}
    arrays |= changed
    arrays = {name: array for name, array in arrays.items() if array is not None}
    np.savez(path, **arrays, **{HASH_FIELD: np.array(content_hash(arrays))})


def test_every_entry_is_admitted_and_proven_again(library: ArmLibrary, file: Path) -> None:
    again = load_arm_library(file)
    checks = verify_arm(again)
    assert len(checks) == 2 * 2 * 2 * 2
    assert [check.shortfalls for check in checks] == [[]] * len(checks)
    for name, array in library.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], array)
    assert is_arm_library(file)


def test_a_limit_binds_at_the_fast_tap_and_none_at_the_slow_one(library: ArmLibrary) -> None:
    assert set(library.arrays["binding"][0].ravel()) == {"none"}
    assert all("current" in said for said in library.arrays["binding"][1].ravel())


def test_below_the_limits_the_force_is_along_the_normal(library: ArmLibrary) -> None:
    assert np.degrees(library.arrays["direction_rad"][0]).max() < 2.0


def test_blends_keep_all_limits(library: ArmLibrary) -> None:
    lot, problem = np.random.default_rng(0), library.problem((0, 0, 0, 0))
    (v, g), (o, q) = ([0.1, 0.3], [1.0, 3.0]), library.command.shape[2:4]
    places = [(lot.uniform(*v), lot.uniform(*g), lot.uniform(0, o - 1), lot.uniform(0, q - 1)) for _ in range(500)]
    commands = np.stack([library.blended(*place).command for place in places])
    currents = problem.stage.motion(commands).plant_input
    assert np.abs(commands).max() <= 6.0 + 1e-9
    assert np.abs(currents).max() <= 2.5 * (1 + 1e-6)


def test_a_blend_at_a_node_is_its_command(library: ArmLibrary) -> None:
    np.testing.assert_array_equal(library.blended(0.3, 1.0, 1.0, 0.0).command, library.command[1, 0, 1, 0])
    clamped = library.blended(0.9, 0.2, 5.0, 0.0)
    assert clamped.clamped == ("speed", "grip", "normal")
    np.testing.assert_array_equal(clamped.command, library.command[1, 0, 1, 0])


def test_places_of_normals_and_postures(library: ArmLibrary) -> None:
    normals, postures = library.arrays["normals"], library.arrays["postures_rad"]
    assert library.normal_along(normals[1]) == pytest.approx(1.0)
    assert library.normal_along(normals[0] + normals[1]) == pytest.approx(0.5, abs=0.05)
    assert library.posture_along(0.25 * postures[0] + 0.75 * postures[1]) == pytest.approx(0.75)


@pytest.mark.parametrize("name", ["command", "plant_A", "mu_end", "meta"])
def test_a_file_without_an_array_is_refused(file: Path, name: str) -> None:
    rewritten(file, **{name: None})
    with pytest.raises(InputError, match="missing"):
        load_arm_library(file)


def test_a_changed_file_is_refused(file: Path, library: ArmLibrary) -> None:
    with np.load(file) as opened:
        arrays = {name: opened[name] for name in opened.files}
    arrays["command"] = 1.0001 * arrays["command"]
    np.savez(file, **arrays)
    with pytest.raises(InputError, match="does not match its hash"):
        load_arm_library(file)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("command", np.zeros((2, 2, 2, 2, 3, 9)), "has shape"),
        ("tap_error", np.full((2, 2, 2, 2), np.nan), "not finite"),
        ("mu_current_motor_1_upper", None, "multipliers of other limits"),
        ("meta", np.array("{"), "not JSON"),
    ],
)
def test_a_forged_file_is_refused(file: Path, name: str, value: Any, said: str) -> None:
    rewritten(file, **{name: value})
    with pytest.raises(InputError, match=said):
        load_arm_library(file)


@pytest.mark.parametrize("part", ["command", "mu_current_motor_2_upper", "tap_error", "target_m_s2"])
def test_what_is_no_optimum_is_found(file: Path, library: ArmLibrary, part: str) -> None:
    array = (library.multipliers if part.startswith("mu") else library.arrays)[part]
    rewritten(file, **{part: 0.99 * array})
    checks = verify_arm(load_arm_library(file))
    assert any(check.shortfalls for check in checks)


@pytest.mark.parametrize("part", ["felt_error", "felt_dB", "floor", "objective", "peak_input", "tangential_error"])
def test_a_figure_that_does_not_follow_from_the_commands_is_named(file: Path, library: ArmLibrary, part: str) -> None:
    figure = library.arrays[part].copy()
    figure[-1, 0, 0, 0] += 0.01
    rewritten(file, **{part: figure})
    said = [text for check in verify_arm(load_arm_library(file)) for text in check.shortfalls]
    assert len(said) == 1
    assert said[0].startswith(f"{part} is stated as ")


def test_a_limit_that_does_not_bind_is_named(file: Path, library: ArmLibrary) -> None:
    binding = library.arrays["binding"].copy()
    binding[-1, 0, 0, 0] = "none"
    rewritten(file, binding=binding)
    (said,) = (text for check in verify_arm(load_arm_library(file)) for text in check.shortfalls)
    assert said.startswith("binding is stated as 'none' and comes out as ")


@pytest.mark.parametrize(
    "part", ["speeds_m_s", "grips_N", "normals", "postures_rad", "plant_A", "plant_B", "plant_C", "plant_D"]
)
def test_nodes_and_plants_of_another_scene_are_refused(file: Path, library: ArmLibrary, part: str) -> None:
    rewritten(file, **{part: 1.001 * library.arrays[part] + 1e-3})
    with pytest.raises(InputError, match=f"{part} is not that of the scene in meta; solve the scene again"):
        load_arm_library(file)


def test_other_readers_say_what_reads_it(file: Path) -> None:
    with pytest.raises(InputError, match=r"a library of an arm with several motors.*load_arm_library"):
        to.load_library(file)


HARNESS = """
#include <stdio.h>
#include "arm.h"
int main(void)
{
    float v, g, o, q;
    while (scanf("%f %f %f %f", &v, &g, &o, &q) == 4)
        for (int m = 0; m < TRANSOPT_MOTORS; m++)
            for (int k = 0; k < TRANSOPT_SAMPLES; k++) printf("%.9g\\n", (double)transopt_command(v, g, o, q, m, k));
    return 0;
}
"""


def test_header_plays_the_blend(library: ArmLibrary, tmp_path: Path) -> None:
    (tmp_path / "arm.h").write_text(arm_header(library))
    (tmp_path / "main.c").write_text(HARNESS)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run(["cc", *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    lot = np.random.default_rng(1)
    places = [(0.2, 2.0, 0.5, 0.5), (0.3, 1.0, 1.0, 0.0), (9.0, 9.0, 9.0, 9.0)]
    places += [tuple(lot.uniform([0.1, 1.0, 0.0, 0.0], [0.3, 3.0, 1.0, 1.0])) for _ in range(5)]
    given = "\n".join(" ".join(f"{value:.9g}" for value in place) for place in places)
    run = subprocess.run([tmp_path / "main"], input=given, text=True, capture_output=True, check=True)
    played = np.array(run.stdout.split(), dtype=float).reshape(len(places), *library.command.shape[4:])
    wanted = np.stack([library.blended(*place).command for place in places])
    assert np.abs(played - wanted).max() < 4 * np.abs(library.command).max() / 65534
    currents = library.problem((0, 0, 0, 0)).stage.motion(played).plant_input
    assert np.abs(currents).max() <= 2.5 * (1 + 1e-6)


def test_header_is_silent_for_what_is_no_tap(library: ArmLibrary, tmp_path: Path) -> None:
    (tmp_path / "arm.h").write_text(arm_header(library))
    (tmp_path / "main.c").write_text(HARNESS)
    subprocess.run(["cc", "-std=c99", "main.c", "-o", "main"], cwd=tmp_path, check=True)
    given = "nan 2 0 0\n0.2 nan 0 0\n0.2 2 nan 0\n0.2 2 0 nan\n-0.2 2 0 0\n0.2 0.1 0 0\n"
    run = subprocess.run([tmp_path / "main"], input=given, text=True, capture_output=True, check=True)
    assert set(run.stdout.split()) <= {"0", "-0"}


def test_a_scene_whose_limits_are_too_tight_has_reasons() -> None:
    made = build_arm(short_scene(limits={"current_A": 1e-9, "steady_current_A": 1e-9}, grid={"speeds_m_s": [0.3]}))
    for entry in made.entries:
        assert entry.admitted or entry.shortfalls


def test_replay_of_a_blend_is_between_its_nodes(library: ArmLibrary) -> None:
    problem = library.problem((1, 0, 0, 0))
    (played,) = replay_several([problem], library.blended(0.3, 2.0).command[None])
    assert played.figures.tap_error < 2 * library.arrays["tap_error"][1, :, 0, 0].max()


def test_meta_holds_the_scene(library: ArmLibrary) -> None:
    assert json.loads(json.dumps(library.meta)) == library.meta
    assert library.scene() == short_scene()
