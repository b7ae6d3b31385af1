"""Recordings of three axes as targets of an arm: what lies across the tap's main direction is asked for too."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import transopt as to
from tests.benches.libraries import proven_again
from transopt.base.errors import InputError
from transopt.recordings.axes import across, joined
from transopt.scene.scene import Scene

RATE_HZ, SPEED_M_S = 10e3, 0.1
TILTED = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)) * 0.2 + np.eye(3))[0]
ROTATIONS = {"z": np.eye(3), "tilted": TILTED}


def courses(times_s: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Along the normal a tap, along the tangents a weaker one and a later one [m/s^2]."""

    def tap(peak_m_s2: float, start_s: float, width_s: float) -> np.ndarray[Any, Any]:
        share = (times_s - start_s) / width_s
        return np.where((share > 0) & (share < 1), peak_m_s2 * np.sin(np.pi * share) ** 2, 0.0)

    return np.array([tap(60.0, 0.0, 4e-3), tap(12.0, 0.0, 6e-3), tap(-9.0, 1e-3, 5e-3)])


def written(path: Path, turned: np.ndarray[Any, Any], gravity: float = 0.0) -> None:
    """A file of a sensor whose z lies along the normal, before it is turned."""
    times = np.arange(-0.05, 0.2, 1 / RATE_HZ)
    normal, first, second = courses(times)
    axes = turned @ (np.array([first, second, normal]) + gravity)
    rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in zip(times, *axes, strict=True))
    head = f"# speed_m_s: {SPEED_M_S}\n# grip_N: 1.0\ntime_s,ax_m_s2,ay_m_s2,az_m_s2\n"
    path.write_text(head + rows + "\n")


def scene_of(folder: Path, axis: str, kind: str = "stylus_3d") -> Scene:
    content = to.load_scene(kind).model_dump(mode="json")
    content["grid"] |= {"speeds_m_s": [SPEED_M_S], "grips_N": [1.0]}
    content["time"] |= {"stages": 240}
    content["recordings"] = {"files": ["tap.csv"], "folder": str(folder), "axis": axis, "onset_s": 0.0}
    content["striker"] = None
    content["weights"] |= {"after_s": 0.01}
    return Scene.model_validate(content)


@pytest.mark.parametrize("turned", [*ROTATIONS.values()], ids=[*ROTATIONS])
def test_the_frame_is_right_handed_and_keeps_all_energy(turned: np.ndarray[Any, Any]) -> None:
    table = turned @ np.random.default_rng(0).normal(size=(3, 500)) * np.array([[0.2], [0.3], [4.0]])
    axes = dict(zip("xyz", table, strict=True))
    normal, _ = joined(axes, "all")
    frame = np.array([normal, *across(axes)])
    turning = frame @ np.linalg.pinv(table)
    np.testing.assert_allclose(turning @ turning.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turning) == pytest.approx(1.0)
    np.testing.assert_allclose(normal, joined(axes, "main")[0], rtol=0, atol=0)


def test_all_three_directions_are_asked_for_and_made(tmp_path: Path) -> None:
    written(tmp_path / "tap.csv", np.eye(3), gravity=3.0)
    library = to.solve(scene_of(tmp_path, "all"))
    times = library.time_grid().switching_times_s
    recorded, wanted = library.recorded_m_s2[0, 0], courses(times)
    # The main direction leans towards what lies across it.
    along = np.linalg.norm(wanted, axis=0).max()
    assert np.abs(np.linalg.norm(recorded, axis=0) - np.linalg.norm(wanted, axis=0)).max() < 0.03 * along
    assert np.abs(recorded[1:]).max() > 0.1 * along
    alone = to.solve(scene_of(tmp_path, "main"))
    assert np.abs(alone.uncorrected(0, 0).window_m_s2[1:]).max() == 0
    lacking, _ = library.yardstick.across(library.uncorrected(0, 0), alone.acceleration_m_s2[0, 0])
    assert library.tangential_error[0, 0] < 0.5 * lacking
    made = library.acceleration_m_s2[0, 0] + library.free_m_s2[0, 0]
    assert np.linalg.norm(made[1:] - recorded[1:]) < 0.4 * np.linalg.norm(recorded[1:])


def test_a_library_with_three_directions_is_proven_again(tmp_path: Path) -> None:
    written(tmp_path / "tap.csv", ROTATIONS["tilted"])
    assert len(to.verify(proven_again(to.solve(scene_of(tmp_path, "all")), tmp_path))) == 4


def test_it_is_refused_with_one_motor_and_without_three_axes(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r'recordings\.axis: "all" is for an arm'):
        scene_of(tmp_path, "all", "wood_on_foam")
    rows = "\n".join(f"{k * 1e-4},{k % 7},1" for k in range(900))
    (tmp_path / "tap.csv").write_text(f"time_s,ax_m_s2,ay_m_s2\n{rows}")
    with pytest.raises(InputError, match="needs three axes, the file has"):
        to.solve(scene_of(tmp_path, "all"))
