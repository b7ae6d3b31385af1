"""Libraries of an arm: whole files, blends that keep the limits, and the C header."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import transopt as to
from controller.host.payload import load_playable
from tests.benches.libraries import proven_again, rewritten
from transopt.base.errors import InputError
from transopt.design.build import Build
from transopt.design.refine_grid import refine_grid
from transopt.design.verify import verify_library
from transopt.library.c_header import c_header
from transopt.library.library import Library
from transopt.library.proven import doubts
from transopt.library.statements import misstatements
from transopt.report.markdown import build_markdown
from transopt.report.tables import refinement_summary
from transopt.scene.recordings import recordings_of
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
def build() -> Build:
    return to.build(short_scene())


@pytest.fixture(scope="module")
def library(build: Build) -> Library:
    assert build.library is not None
    return build.library


@pytest.fixture
def file(library: Library, tmp_path: Path) -> Path:
    path = tmp_path / "library.npz"
    library.save(path)
    return path


def test_every_entry_is_admitted_and_proven_again(library: Library, tmp_path: Path) -> None:
    assert len(verify_library(proven_again(library, tmp_path))) == 2 * 2 * 2 * 2


def test_a_limit_binds_at_the_fast_tap_and_none_at_the_slow_one(library: Library) -> None:
    assert set(library.binding[0].ravel()) == {"none"}
    assert all("current" in said for said in library.binding[1].ravel())


def test_below_the_limits_the_force_is_along_the_normal(library: Library) -> None:
    assert np.degrees(library.direction_rad[0]).max() < 2.0


def test_the_error_across_the_normal_counts_to_the_end_of_the_intention(library: Library) -> None:
    """The window of 24 ms is shorter than the intention of 30 ms, and the lead leaves contact no sample before it."""
    made = library.lasting(1, 0)[0] + np.concatenate(
        [library.free_m_s2[1, 0], library.free_after_m_s2[1, 0]], axis=-1
    )
    recorded = np.concatenate([library.recorded_m_s2[1, 0], library.recorded_after_m_s2[1, 0]], axis=-1)
    times_s = library.time_grid().switching_times_s[0] + 1e-4 * np.arange(made.shape[-1])
    within = (times_s > -1e-9) & (times_s < 0.03 - 1e-9)
    error = np.linalg.norm((made - recorded)[1:, within]) / np.linalg.norm(recorded[0, within])
    turned = np.arctan2(np.linalg.norm((made - recorded)[1:, within]), np.linalg.norm(made[0, within]))
    assert library.tangential_error[1, 0] == pytest.approx(error, rel=1e-5)
    assert library.direction_rad[1, 0] == pytest.approx(turned, rel=1e-5)


def test_blends_keep_all_limits(library: Library) -> None:
    lot, problem = np.random.default_rng(0), library.problem(0, 0)
    places = lot.uniform([0.1, 1.0, 1.0, 1.0], [0.3, 3.0, 2.0, 2.0], (500, 4))
    commands = np.stack([library.at(*place).command for place in places])
    currents = problem.stage.motion(commands).plant_input
    assert np.abs(commands).max() <= 6.0 + 1e-9
    assert np.abs(currents).max() <= 2.5 * (1 + 1e-6)


def test_a_blend_at_a_node_is_its_command(library: Library) -> None:
    third = library.axes.places.index((2, 1))  # of the first grip, the outermost of what the devices are made of
    np.testing.assert_array_equal(library.at(0.3, 1.0, 2.0, 1.0).command, library.command[1, third])
    clamped = library.at(0.9, 0.6, 5.0, 1.0)
    assert (clamped.speed_clamped, clamped.grip_clamped, clamped.place_clamped) == (True, True, True)
    np.testing.assert_array_equal(clamped.command, library.command[1, third])


def test_places_of_normals_and_postures(library: Library) -> None:
    arm, normals, postures = library.scene().arm(), library.normals[[0, 2]], library.postures_rad[:2]
    assert arm.normal_along(normals[1]) == pytest.approx(2.0)
    assert arm.normal_along(normals[0] + normals[1]) == pytest.approx(1.5, abs=0.05)
    assert arm.posture_along(0.25 * postures[0] + 0.75 * postures[1]) == pytest.approx(1.75)


@pytest.mark.parametrize("name", ["command", "plant_A", "mu_end", "normals", "mu_current_motor_1_upper", "meta"])
def test_a_file_without_an_array_is_refused(file: Path, name: str) -> None:
    with pytest.raises(InputError, match=f"{name}"):
        to.load_library(rewritten(file, drop=name))


def test_a_changed_file_is_refused(file: Path, library: Library) -> None:
    with pytest.raises(InputError, match="does not match its hash"):
        to.load_library(rewritten(file, hashed=False, command=1.0001 * library.command))


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("command", np.zeros((2, 8, 3, 9)), "has shape"),
        ("tap_error", np.full((2, 8), np.nan), "not finite"),
        ("mu_current_motor_1_upper", np.zeros((2, 8, 9)), "no finite array of shape"),
        ("grips_N", np.array([1.0, 1.0, 1.0, 1.0, 4.0, 4.0, 4.0, 4.0]), "grips_N is not that of the scene in meta"),
        ("meta", np.array("{"), "not JSON"),
    ],
)
def test_a_forged_file_is_refused(file: Path, name: str, value: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        to.load_library(rewritten(file, **{name: value}))


@pytest.mark.parametrize("part", ["command", "mu_current_motor_2_upper", "tap_error", "target_m_s2"])
def test_what_is_no_optimum_is_found(file: Path, library: Library, part: str) -> None:
    forged = to.load_library(rewritten(file, **{part: 0.99 * library.array(part)}))
    assert any(check.shortfalls for check in verify_library(forged)) or [*misstatements(forged)]
    assert [*doubts(forged)]


@pytest.mark.parametrize("part", ["felt_dB", "objective", "tangential_error", "direction_rad"])
def test_a_figure_that_does_not_follow_from_the_commands_is_named(file: Path, library: Library, part: str) -> None:
    figure = library.array(part).copy()
    figure[-1, 0] += 0.01
    forged = to.load_library(rewritten(file, **{part: figure}))
    for said in ([text for check in verify_library(forged) for text in check.shortfalls], [*doubts(forged)]):
        assert len(said) == 1
        assert f"{part} says " in said[0]


def test_a_limit_that_does_not_bind_is_named(file: Path, library: Library) -> None:
    binding = library.binding.copy()
    binding[-1, 0] = "none"
    forged = to.load_library(rewritten(file, binding=binding))
    (said,) = (text for check in verify_library(forged) for text in check.shortfalls)
    assert said.startswith("binding says 'none', recomputed ")


@pytest.mark.parametrize(
    "part", ["speeds_m_s", "normals", "postures_rad", "plant_A", "plant_B", "plant_C", "plant_D"]
)
def test_nodes_and_plants_of_another_scene_are_doubted(file: Path, library: Library, part: str) -> None:
    forged = to.load_library(rewritten(file, **{part: 1.001 * library.array(part) + 1e-3}))
    assert any(said.startswith(part) for said in misstatements(forged))


def test_what_is_for_one_motor_refuses_it(library: Library, file: Path) -> None:
    said = "has several motors, and this needs one"
    for asked in (lambda: to.Online(library), lambda: to.export_library(library, file.with_name("arm.wav"))):
        with pytest.raises(InputError, match=said):
            asked()
    with pytest.raises(InputError, match="a stylus on a motor plays currents over speeds and grips"):
        load_playable(file)


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


def test_header_plays_the_blend(library: Library, tmp_path: Path) -> None:
    (tmp_path / "arm.h").write_text(c_header(library))
    (tmp_path / "main.c").write_text(HARNESS)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run(["cc", *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    lot = np.random.default_rng(1)
    places = [(0.2, 2.0, 1.5, 1.5), (0.3, 1.0, 2.0, 1.0), (9.0, 9.0, 9.0, 9.0)]
    places += [tuple(lot.uniform([0.1, 1.0, 1.0, 1.0], [0.3, 3.0, 2.0, 2.0])) for _ in range(5)]
    given = "\n".join(" ".join(f"{value:.9g}" for value in place) for place in places)
    run = subprocess.run([tmp_path / "main"], input=given, text=True, capture_output=True, check=True)
    played = np.array(run.stdout.split(), dtype=float).reshape(len(places), *library.command.shape[2:])
    wanted = np.stack([library.at(*place).command for place in places])
    assert np.abs(played - wanted).max() < 4 * np.abs(library.command).max() / 65534
    currents = library.problem(0, 0).stage.motion(played).plant_input
    assert np.abs(currents).max() <= 2.5 * (1 + 1e-6)


def test_header_is_silent_for_what_is_no_tap(library: Library, tmp_path: Path) -> None:
    (tmp_path / "arm.h").write_text(c_header(library))
    (tmp_path / "main.c").write_text(HARNESS)
    subprocess.run(["cc", "-std=c99", "main.c", "-o", "main"], cwd=tmp_path, check=True)
    given = "nan 2 1 1\n0.2 nan 1 1\n0.2 2 nan 1\n0.2 2 1 nan\n-0.2 2 1 1\n0.2 0.1 1 1\n"
    run = subprocess.run([tmp_path / "main"], input=given, text=True, capture_output=True, check=True)
    assert set(run.stdout.split()) <= {"0", "-0"}


def test_a_scene_whose_limits_are_too_tight_has_reasons() -> None:
    made = to.build(short_scene(limits={"current_A": 1e-9, "steady_current_A": 1e-9}, grid={"speeds_m_s": [0.3]}))
    for entry in made.all_entries():
        assert entry.admitted or entry.shortfalls


def test_the_grid_says_between_which_places_it_lacks() -> None:
    scene = short_scene(grid={"speeds_m_s": [0.3], "grips_N": [1.0]})
    found = refine_grid(scene, recordings_of(scene), 1e-4)
    (worst,) = found.points
    assert worst.spot is not None
    assert worst.spot not in scene.axes.places
    assert "4 entries (1 speeds x 1 grips x 4 places" in found.shortfall
    assert "add one to model.normals or model.postures_deg there" in found.shortfall
    assert refinement_summary(found) == found.shortfall
    assert "## Between the nodes" in build_markdown(to.build(scene, grid_tolerance=1e-4), full=False)


def test_speeds_are_added_for_the_worst_place() -> None:
    scene = short_scene(grid={"speeds_m_s": [0.1, 0.3], "grips_N": [1.0]})
    taps = recordings_of(scene)
    assert refine_grid(scene, taps, 0.5).grid.speeds_m_s == [0.1, 0.3]
    found = refine_grid(scene, taps, 0.02, cap=12)
    assert found.grid.speeds_m_s == [0.1, 0.2, 0.3]
    assert max(p.excess_before for p in found.points) > 0.02
