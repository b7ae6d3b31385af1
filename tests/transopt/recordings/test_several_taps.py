"""Files of several taps, of three axes, and of hands that pull back."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import problems
import transopt as to
from tests.benches.libraries import proven_again
from tests.benches.places import IMPACTS
from tests.benches.recording_files import SPEEDS, STARTS, TIMES_S, session, text
from transopt.base.errors import InputError
from transopt.base.signals import Signal
from transopt.files.names import Layout
from transopt.recordings.after_contact import pulled_back_after_s
from transopt.recordings.axes import across, joined
from transopt.recordings.recording import load_recording
from transopt.recordings.settings import Recordings
from transopt.recordings.split import bounds
from transopt.recordings.tap import PreparedTap, check_speed, prepare, read_recordings
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings

# ---- lengths and rates -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate_Hz", "length_s"), [(1e3, 0.025), (1e3, 10.0), (1e6, 0.025), (1e5, 10.0)])
def test_short_and_long_slow_and_fast(tmp_path: Path, rate_Hz: float, length_s: float) -> None:
    times = np.arange(round(rate_Hz * length_s)) / rate_Hz
    at = 0.4 * length_s
    acceleration = 60 * np.exp(-(((times - at) / 2e-3) ** 2)) + 1e-3 * np.random.default_rng(1).standard_normal(
        times.size
    )
    np.savez(tmp_path / "tap.npz", time_s=times, acceleration_m_s2=acceleration, speed_m_s=0.2)
    tap = only_tap(tmp_path, "tap.npz")
    assert tap.onset_s == pytest.approx(at, abs=6e-3)


# ---- several taps ------------------------------------------------------------------------------------------


def settings(folder: Path, name: str, **more: object) -> Recordings:
    return Recordings.model_validate({"files": [name], "folder": str(folder), **more})


def only_tap(folder: Path, name: str, **more: object) -> PreparedTap:
    stated = settings(folder, name, **more)
    (recording,) = read_recordings(stated)
    return prepare(recording, stated)


class TestSeveralTaps:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        (tmp_path / "session.csv").write_text(session(STARTS, SPEEDS))
        return tmp_path

    def test_are_split_with_their_times_and_speeds(self, folder: Path) -> None:
        stated = settings(folder, "session.csv")
        taps = [prepare(recording, stated) for recording in read_recordings(stated)]
        assert [tap.recording.name for tap in taps] == [f"session.csv#{k}" for k in (1, 2, 3)]
        np.testing.assert_allclose([tap.onset_s for tap in taps], STARTS, atol=3e-4)
        np.testing.assert_allclose([tap.speed_m_s for tap in taps], SPEEDS, rtol=0.02)
        assert taps[1].notes[0] == "tap 2 of 3 in session.csv, peak at 0.902 s"

    def test_are_chosen(self, folder: Path) -> None:
        names = [r.name for r in read_recordings(settings(folder, "session.csv", taps_by_file={"session.*": [3, 1]}))]
        assert names == ["session.csv#1", "session.csv#3"]
        with pytest.raises(InputError, match=r"tap 4 is not there, the file has 3 taps, at 0\.40.*: choose 1 to 3"):
            read_recordings(settings(folder, "session.csv", taps_by_file={"*": [4]}))
        with pytest.raises(InputError, match=r"taps_by_file: 'other' is not among the files"):
            read_recordings(settings(folder, "session.csv", taps_by_file={"other": [1]}))

    def test_have_speeds_of_their_own(self, folder: Path) -> None:
        by_file = {"session.csv": 0.3, "session.csv#2": 0.25}
        taps = read_recordings(settings(folder, "session.csv", speed_by_file_m_s=by_file))
        assert [tap.speed_m_s for tap in taps] == [0.3, 0.25, 0.3]
        assert "stated for all taps of session.csv" in taps[0].notes[-1]
        assert "stated for all" not in " ".join(taps[1].notes)
        with pytest.raises(InputError, match=r"'session.csv#4' is not among the files"):
            read_recordings(settings(folder, "session.csv", speed_by_file_m_s={"session.csv#4": 0.2}))

    def test_a_stated_onset_is_in_the_files_own_time(self, folder: Path) -> None:
        (whole,) = read_recordings(settings(folder, "session.csv", onset_s=0.9, speed_m_s=0.2))
        assert whole.name == "session.csv"

    def test_a_rebound_belongs_to_its_tap(self, tmp_path: Path) -> None:
        (tmp_path / "one.csv").write_text(session(STARTS[:1], SPEEDS[2:]))
        (one,) = read_recordings(settings(tmp_path, "one.csv"))
        assert one.name == "one.csv"


def test_a_grip_that_lets_go_is_no_tap() -> None:
    """Struck, held pressed with a fifth of the peak, and let go within milliseconds."""
    t = np.arange(10000) * 1e-4
    hit = 40 * np.sin(np.pi * np.clip(t - 0.2, 0, 3e-3) / 3e-3)
    held = 8.0 * np.clip((t - 0.25) / 0.1, 0, 1) * np.clip((0.6 - t) / 3e-3, 0, 1)
    assert len(bounds(Signal(0.0, 1e-4, hit + held))) == 1
    assert len(bounds(Signal(0.0, 1e-4, -hit - held))) == 1


def test_a_trigger_without_pre_roll_says_so(tmp_path: Path) -> None:
    pulse = 80 * np.sin(np.pi * np.minimum(TIMES_S + 2e-4, 4e-3) / 4e-3)
    (tmp_path / "shot.csv").write_text("time [s],acc [m/s^2]\n" + text(TIMES_S, pulse))
    tap = only_tap(tmp_path, "shot.csv", speed_m_s=0.2)
    assert any("the contact is at the start of the file" in note for note in tap.notes)


# ---- the grip and the position by their columns -----------------------------------------------------------------


def gripped(name: str, force_N: float, position: str = "pos [m]") -> str:
    """A session of three taps with a load cell that reads this force before contact, and more during a tap."""
    rows = [line.split(",") for line in session(STARTS, SPEEDS).splitlines()[1:]]
    t, a, z = np.array(rows, dtype=float).T
    grip = force_N * np.ones(t.size)
    for start in STARTS:
        grip[(t >= start) & (t < start + 0.05)] *= 3
    return f"time [s],acc [g],{position},{name}\n" + text(t, a, z, grip)


@pytest.mark.parametrize(
    ("name", "force_N"), [("Grip [N]", 3.0), ("grip_N", 3.0), ("Griffkraft [N]", 3.0), ("grip [N]", -3.0)]
)
def test_the_mean_of_a_grip_column_before_contact_is_the_grip(tmp_path: Path, name: str, force_N: float) -> None:
    (tmp_path / "s.csv").write_text(gripped(name, force_N))
    taps = [prepare(each, Recordings()) for each in read_recordings(settings(tmp_path, "s.csv", grip_N=5.0))]
    assert [tap.recording.grip_N for tap in taps] == pytest.approx([3.0] * 3, rel=1e-3)
    assert all(any("the grip of 3 N is the mean of its column" in note for note in tap.notes) for tap in taps)


def test_a_stated_grip_goes_before_that_of_the_column(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text("# grip_N: 2\n" + gripped("Grip [N]", 3.0))
    taps = [prepare(each, Recordings()) for each in read_recordings(settings(tmp_path, "s.csv"))]
    assert [tap.recording.grip_N for tap in taps] == pytest.approx([2.0] * 3, rel=1e-12)


def test_a_column_in_newton_is_a_grip_by_its_name_only(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text(gripped("Kraft [N]", 3.0))
    first = read_recordings(settings(tmp_path, "s.csv"))[0]
    assert first.grip is None
    assert first.force is not None


def test_a_position_by_an_unknown_name_is_offered_where_the_speed_is_missed(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text(gripped("Grip [N]", 3.0, position="Hub [m]"))
    missed = prepare(read_recordings(settings(tmp_path, "s.csv"))[0], Recordings())
    with pytest.raises(InputError, match=r"no incoming speed: .* for example --units Hub=m "):
        check_speed(missed)
    offered = prepare(read_recordings(settings(tmp_path, "s.csv", units={"Hub": "m"}))[0], Recordings())
    assert offered.speed_m_s == pytest.approx(SPEEDS[0], rel=0.05)
    (tmp_path / "s.csv").write_text(gripped("Grip [N]", 3.0, position="Weg [m]"))
    known = prepare(read_recordings(settings(tmp_path, "s.csv"))[0], Recordings())
    assert known.speed_m_s == pytest.approx(SPEEDS[0], rel=0.05)


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
    lacking, _ = library.yardstick.across(library.uncorrected(0, 0), alone.lasting(0, 0)[0])
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


OBJECTS = ("wood_on_foam", "hard_metal", "soft_rubber", "second_order", "free_stylus")
SAID = "the hand pulls the stylus back"


def notes_of(scene_name: str, law: str) -> list[str]:
    """Notes of each tap that a hand of that law makes, joined."""
    scene = with_values(problems.load(scene_name), {"hand.yields": law, "recordings.simulated.repeats": 1})
    return ["; ".join(prepare(tap, scene.recordings).notes) for tap in recordings(scene)]


@pytest.mark.parametrize("scene_name", OBJECTS)
@pytest.mark.parametrize("law", ["pulls", "brakes", "straight", "stops", "decays"])
def test_a_hand_that_pulls_is_found_and_no_other(scene_name: str, law: str) -> None:
    assert {SAID in notes for notes in notes_of(scene_name, law)} == {law == "pulls"}


def position(z_m: np.ndarray) -> Signal:
    return Signal(-0.03, 1e-4, z_m)


def test_a_free_rebound_is_no_pull() -> None:
    """A ball that comes back as fast as it came, and slows down, or goes on."""
    t = -0.03 + 1e-4 * np.arange(1500)
    for slowing_m_s2 in (0.0, 5.0):
        z = np.where(t < 0, -0.2 * t, 0.2 * t - slowing_m_s2 * t**2 / 2)
        assert pulled_back_after_s(position(z), 0.0) is None
    out = np.where(t < 0.03, -1e-3, -1e-3 + (t - 0.03) ** 2)
    assert pulled_back_after_s(position(np.where(t < 0, -0.2 * t, out)), 0.0) is not None


def test_a_short_record_says_nothing() -> None:
    assert pulled_back_after_s(Signal(-0.03, 1e-4, np.zeros(600)), 0.0) is None


@pytest.mark.skipif(not IMPACTS.is_dir(), reason="the recorded impacts (CC BY-SA) are not part of the project")
def test_recorded_impacts_are_silent() -> None:
    settings = Recordings(files=["unused"], speed_m_s=1.14, implausible="accept")
    for path in sorted(IMPACTS.glob("*.txt")):
        recording = load_recording(path, Layout(columns=["time_s", "acceleration_g"]))
        assert SAID not in "; ".join(prepare(replace(recording, speed_m_s=1.14), settings).notes)
