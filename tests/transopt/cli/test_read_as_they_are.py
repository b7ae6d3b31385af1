"""Commands on files as instruments write them: --columns, --units, --tap, --channel; and lines that work pasted."""

import re
from pathlib import Path

import numpy as np
import pytest

import problems
from tests.benches.commands import Run, assert_refused
from tests.benches.recording_files import SPEEDS, STARTS, session, text, wav
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.files.names import Layout
from transopt.identify.measurement import load_measurements, split_taps


@pytest.fixture
def three(run: Run) -> Path:
    path = Path("session.csv")
    path.write_text(session(STARTS, SPEEDS))
    return path


class TestTaps:
    @pytest.mark.usefixtures("three")
    def test_lists_every_tap_of_a_file_and_one_that_is_chosen(self, run: Run) -> None:
        outcome = run("taps", "session.csv")
        assert outcome.code == 0, outcome.err
        assert all(f"session.csv#{k}" in outcome.out for k in (1, 2, 3))
        assert "speeds_m_s = [0.1, 0.2, 0.4]" in outcome.out
        outcome = run("taps", "session.csv", "--tap", 2)
        assert 'taps_by_file = { "*" = [2] }' in outcome.out
        assert_refused(run("taps", "session.csv", "--tap", 7), "tap 7 is not there", "choose 1 to 3")

    def test_taps_of_unknown_speed_are_listed_before_they_are_refused(self, run: Run) -> None:
        Path("a.csv").write_text(re.sub(r"(?m),[^,\n]*$", "", session(STARTS, SPEEDS)))
        outcome = run("taps", "a.csv")
        assert_refused(outcome, 'recordings.speed_by_file_m_s = { "a.csv#1" = 0.2 }')
        assert "peak at 0.902" in " ".join(outcome.out.split())

    @pytest.mark.usefixtures("three")
    def test_the_lines_of_one_tap_make_a_scene_that_solves(self, run: Run) -> None:
        numbers = "\n".join(Path("session.csv").read_text().splitlines()[1:])
        Path("bare.txt").write_text(numbers)
        options = ("--columns", "time,acc,pos", "--units", "time=s,acc=g,pos=m", "--tap", 2)
        outcome = run("taps", "bare.txt", *options)
        assert outcome.code == 0, outcome.err
        grid, recordings = outcome.out[outcome.out.index("# in [grid]") :].split("\n\n")
        scene = problems.scene_path("own_taps").read_text()
        scene = scene.replace("speeds_m_s = [0.2, 0.3, 0.4]", grid).replace("[1.0, 3.0, 5.0]", "[3.0]")
        scene = scene.replace('folder = "../recordings"\nfiles = ["tap_*.csv"]', recordings)
        Path("pasted.toml").write_text(scene)
        outcome = run("solve", "pasted.toml", "--no-figures")
        assert outcome.code == 0, outcome.err


def pulse() -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and an acceleration [m/s^2] that may be a tap's."""
    times = np.arange(3000) * 1e-4
    return times, 60 * np.sin(np.pi * np.clip(times - 0.1, 0, 4e-3) / 4e-3)


def test_a_frequency_response_is_no_tap_and_the_command_that_is_named_fits_it(run: Run) -> None:
    f = np.arange(20.0, 600.0, 2.0)
    s = 2j * np.pi * f
    mobility = 32.0 * s / (s**2 + s * 2 * np.pi * 150 / 8 + (2 * np.pi * 150) ** 2)
    rows = text(f, 1e3 * np.abs(mobility), np.degrees(np.unwrap(np.angle(mobility))))
    Path("ldv.csv").write_text("Frequency (Hz),Magnitude (mm/s/V),Phase (deg)\n" + rows)
    refused = run("taps", "ldv.csv")
    assert_refused(refused, "column 'Frequency (Hz)': a frequency response, and no record over time")
    command = re.search(r"`transopt (plant fit FILE .*?)`", refused.err)
    assert command is not None
    fitted = run(*command[1].replace("FILE", "ldv.csv").split())
    assert fitted.code == 0, fitted.err
    assert "150 Hz (Q 8)" in fitted.out


def test_speeds_that_are_proposed_are_told_apart_by_the_change_that_they_mean(run: Run) -> None:
    times, values = pulse()
    Path("x.csv").write_text("time_s,acceleration_m_s2\n" + text(times, values))
    refused = run("taps", "x.csv")
    assert_refused(refused, "a tap changes it by 1 to 2 times")
    found = re.findall(
        r"--speed (\S+) \(10 kHz, .*? a change of speed by (\S+) times the incoming (\S+) m/s\)", refused.err
    )
    assert len(found) == 3
    for speed, ratio, said in found:
        assert float(speed) == pytest.approx(float(said), rel=1e-9)
        assert float(ratio) * float(speed) == pytest.approx(2 / np.pi * 60 * 4e-3, rel=0.1)


class TestIdleOptions:
    """An option that none of the files has a use for is refused, and what it proposes instead reads them."""

    @pytest.fixture(autouse=True)
    def files(self, run: Run) -> None:
        times, values = pulse()
        Path("x.wav").write_bytes(wav(values / 490.3))
        Path("x.csv").write_text("time_s,acceleration_m_s2\n" + text(times, values))

    @pytest.mark.parametrize(
        ("file", "options", "said"),
        [
            (
                "x.wav",
                ("--columns", "time_s,acc"),
                ("--columns time_s,acc", "no columns; leave it out", "--channel 1"),
            ),
            ("x.wav", ("--units", "acc=g"), ("--units acc=g", "no units; leave it out", "--full-scale 490.3")),
            ("x.wav", ("--rate-Hz", 10000), ("--rate-Hz 10000", "a WAV file states its own; leave it out")),
            (
                "x.csv",
                ("--channel", 2),
                ("--channel 2", "recordings.channel", "only WAV and universal files have channels; leave"),
            ),
            ("x.csv", ("--full-scale", 490.3), ("--full-scale 490.3", "only a WAV file has a full scale; leave it")),
        ],
    )
    def test_are_refused(self, run: Run, file: str, options: tuple[object, ...], said: tuple[str, ...]) -> None:
        needed = ("--speed", 0.2, *(("--full-scale", 490.3) if file == "x.wav" else ()))
        assert run("taps", file, *needed).code == 0
        assert_refused(run("taps", file, *needed, *options), *said)

    def test_are_used_where_one_of_the_files_has_a_use_for_them(self, run: Run) -> None:
        outcome = run("taps", "x.csv", "x.wav", "--speed", 0.2, "--full-scale", 490.3, "--units", "acceleration=m/s2")
        assert outcome.code == 0, outcome.err


def test_what_a_scenes_files_leave_open_is_asked_by_keys_that_read_them(run: Run) -> None:
    times, values = pulse()
    Path("x.csv").write_text("zeit,CH7\n" + text(times, values))
    scene = problems.scene_path("own_taps").read_text()
    lines = f'folder = "{Path().absolute()}"\nfiles = ["x.csv"]\nspeed_m_s = 0.3'
    stated = scene.replace('folder = "../recordings"\nfiles = ["tap_*.csv"]', lines)
    stated = re.sub(r"speeds_m_s = .*", "speeds_m_s = [0.3]", stated)
    Path("s.toml").write_text(stated)
    refused = run("solve", "s.toml")
    assert_refused(refused, "tried on it, of which only you know the right one: recordings.")
    key = re.search(r"right one: recordings\.(.*?) \(", refused.err)
    assert key is not None
    Path("s.toml").write_text(stated.replace(lines, f"{lines}\n{key[1]}"))
    assert run("solve", "s.toml", "--no-figures").code == 0


def test_a_stated_rate_is_obeyed_and_stands_in_the_scene(run: Run) -> None:
    times, values = pulse()
    Path("x.csv").write_text("time_s,acceleration_m_s2\n" + text(np.zeros_like(times), values))
    outcome = run("taps", "x.csv", "--speed", 0.2, "--rate-Hz", 10000, "--scene", "s.toml")
    assert outcome.code == 0, outcome.err
    assert "99." in outcome.out or "100." in outcome.out
    assert "rate_Hz = 10000.0" in Path("s.toml").read_text()
    assert_refused(run("taps", "x.csv", "--rate-Hz", 3), "--rate-Hz 3", "must be greater than or equal to 20")


@pytest.mark.parametrize("command", ["amplifier", "device", "hand", "coil"])
def test_identify_takes_columns_and_units(run: Run, command: str) -> None:
    Path("run.txt").write_text(
        "time force acc\n" + text(np.arange(9.0) * 1e-4, np.ones(9), np.ones(9), delimiter=" ")
    )
    first = run("identify", command, "run.txt", "--out", "M.json")
    assert_refused(first, "run.txt", "no unit stated in the columns 'time, force, acc'", "--units time=s,force=N")
    outcome = run("identify", command, "run.txt", "--out", "M.json", "--units", "time=s,force=N,acc=g")
    assert outcome.code == 2  # read, and then refused for what a sweep or a tap has to be
    assert "unit" not in outcome.err
    Path("bare.txt").write_text(text(np.ones(9), delimiter=" "))
    bare = ("identify", command, "bare.txt", "--out", "M.json", "--columns", "acceleration_g")
    assert_refused(run(*bare), "0 time columns", "--rate-Hz 10000")
    outcome = run(*bare, "--rate-Hz", 10000)
    assert outcome.code == 2
    assert "time" not in outcome.err
    outcome = run("identify", command, "run.txt", "--out", "M.json", "--columns", "time_s,-,acceleration_g")
    assert outcome.code == 2
    assert "unit" not in outcome.err


def test_a_hammers_session_gives_each_of_its_taps(tmp_path: Path) -> None:
    t = np.arange(20000) * 1e-4
    hits = [np.sin(np.pi * np.clip(t - at, 0, 3e-3) / 3e-3) for at in (0.3, 0.9, 1.4)]
    force = 40 * np.sum(hits, axis=0) + 0.01 * np.random.default_rng(3).standard_normal(t.size)
    (tmp_path / "hammer.txt").write_text("# grip_N: 3\ntime force acc\n" + text(t, force, 2 * force, delimiter="\t"))
    runs = load_measurements([tmp_path / "hammer.txt"], Layout(units={"time": "s", "force": "N", "acc": "g"}))
    taps = split_taps(runs)
    assert [tap.name for tap in taps] == [f"hammer.txt#{k}" for k in (1, 2, 3)]
    assert all(tap.grip_N == 3 for tap in taps)
    np.testing.assert_allclose(
        taps[1].require("acceleration").values, 2 * G * taps[1].require("force").values, rtol=1e-6, atol=1e-9
    )
    assert [tap.name for tap in split_taps(runs, [2])] == ["hammer.txt#2"]


def test_the_speed_of_a_tap_that_differs_is_that_of_its_position(run: Run) -> None:
    """One speed stated for all: the position of the slowest tells its own, whatever the peaks say."""
    for number, (speed, size) in enumerate(((0.2, 1.0), (0.094, 0.3))):
        times = np.arange(3000) * 1e-4
        after = times - 0.1
        tap = 60 * size * np.sin(np.pi * np.clip(after, 0, 4e-3) / 4e-3)
        position = np.where(after < 0, -speed * after, 0.0)
        rows = text(times, 9.80665 + tap + 0.01 * np.sin(np.arange(3000) ** 2), position)
        Path(f"t{number}.csv").write_text("time_s,acceleration_m_s2,position_m\n" + rows)
    shown = run("taps", "t0.csv", "t1.csv", "--speed", 0.2, "--accept").out
    assert 'recordings.speed_by_file_m_s = { "t1.csv" = 0.094 }' in shown
    assert "or leave the speed out where a position tells it" in shown
