"""Device files: read, written, kept as their owner wrote them, refused in one line; what they mean for the servo."""

from pathlib import Path

import numpy as np
import pytest

from controller.device.device_file import BUILT_IN, DeviceFile, Encoder, Grip, Limits, Period
from controller.device.reading import BESIDE, as_text, examples, find, read_device, restate, write_device
from controller.device.stated import assumed_grip_N, grip_in_words, library_numbers, servo_numbers
from controller.servo.settings import Settings
from tests.benches.oracle.approach import Approach, Touch, Trigger
from transopt.base.errors import InputError
from transopt.library.library import Library


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "mine.toml"


def test_what_is_written_reads_back(file: Path) -> None:
    described = DeviceFile(
        name='a "device"',
        encoder=Encoder(count_m=1e-5, direction=-1, surface_counts=1234.0),
        grip=Grip(sensor=False, assumed_grip_N=2.0),
        servo=Period(dt_s=5e-5),
    )
    write_device(file, described, "two lines\nof comment")
    assert read_device(file).device == described
    assert file.read_text().startswith("# two lines\n# of comment\n")
    with pytest.raises(InputError, match="is there already"):
        write_device(file, described)


def test_three_examples_are_device_files() -> None:
    assert list(examples()) == ["voice_coil", "with_grip", "without_grip"]
    devices = [find(name).device for name in examples()]
    assert [device.grip.sensor for device in devices] == [False, True, False]
    assert all(device != BUILT_IN for device in devices)


def test_what_is_not_stated_is_the_built_in_devices_and_said_so(file: Path) -> None:
    file.write_text("[encoder]\ncount_m = 1e-5\n")
    found = read_device(file)
    assert found.device.encoder.count_m == pytest.approx(1e-5)
    assert found.device.grip == BUILT_IN.grip
    assert "grip.scale" in found.in_words
    assert "encoder.count_m" not in found.in_words


def test_where_a_device_file_is_found(tmp_path: Path) -> None:
    library = tmp_path / "library.npz"
    assert find(None, library).device == BUILT_IN
    assert "the built-in one" in find(None, library).in_words
    (tmp_path / BESIDE).write_text("name = 'beside'\n[grip]\nsensor = false\n")
    assert find(None, library).device.name == "beside"
    assert find("voice_coil", library).device.name.startswith("voice coil")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[encoder]\ncount_um = 10", "encoder.count_um: unknown key.*did you mean count_m"),
        ("[encodr]\ncount_m = 1e-5", "encodr: unknown key.*did you mean encoder"),
        (
            "[encoder]\ncount_m = 10.0",
            r"10.0: must be less than or equal to 0.0001 m [(]did you mean 10 um",
        ),
        ("[encoder]\ndirection = 2", "encoder.direction = 2: must be -1 or 1"),
        ("[amplifier]\nscale = 0.01", "amplifier.scale = 0.01: its size must be 0.2 or more"),
        ("[amplifier]\nscale = nan", "amplifier.scale = nan"),
        ("[grip]\nassumed_grip_N = 'firm'", "grip.assumed_grip_N = 'firm': must be a number without quotes"),
        ("[servo]\ndt_s = 1.0", "servo.dt_s = 1.0: must be less than"),
        ("encoder", "not valid TOML"),
    ],
)
def test_an_error_is_one_line_with_file_key_value_and_limit(file: Path, text: str, words: str) -> None:
    file.write_text(text)
    with pytest.raises(InputError, match=words) as refused:
        read_device(file)
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(str(file))


@pytest.mark.parametrize(
    "before",
    [
        "# mine\n[encoder]\ncount_m = 1e-5 # fine\nsurface_counts = 0.0  # of the table\n[grip]\nscale = 1.0\n",
        "# mine\n[encoder]\ncount_m = 1e-5 # fine\n# surface_counts = 3\n[grip]\nscale = 1.0\n",
        "# mine\n[encoder]\ncount_m = 1e-5 # fine\n[grip]\nscale = 1.0\n",
        "# mine\n[grip]\nscale = 1.0",
    ],
)
def test_another_surface_keeps_the_owners_words(file: Path, before: str) -> None:
    file.write_text(before)
    old = read_device(file).device
    restate(file, "encoder.surface_counts", 1234.5)
    found = read_device(file).device
    assert found.encoder.surface_counts == pytest.approx(1234.5)
    assert (found.encoder.count_m, found.grip) == (old.encoder.count_m, old.grip)
    for comment in ("# mine", *(["# fine", "# of the table"] if "of the table" in before else [])):
        assert comment in file.read_text()


def test_a_file_that_is_laid_out_unusually_is_left_alone(file: Path) -> None:
    file.write_text('"encoder" = {count_m = 1e-5}\n')
    before = file.read_text()
    with pytest.raises(InputError):
        restate(file, "encoder.surface_counts", 7.0)
    assert file.read_text() == before


def test_the_text_of_a_device_explains_every_key() -> None:
    for line in as_text(BUILT_IN).splitlines():
        if "=" in line and not line.startswith("name"):
            assert "  # " in line


BLIND = DeviceFile(grip=Grip(sensor=False, assumed_grip_N=9.0))


def test_the_built_in_device_is_what_the_settings_say_by_themselves() -> None:
    numbers = servo_numbers(BUILT_IN, 1e-4)
    usual = Settings(1e-4, 0.0, 1.0)
    for name, value in numbers.items():
        assert value == pytest.approx(getattr(usual, name), rel=0.03), name


@pytest.mark.parametrize("count_m", [1e-6, 1e-5, 24.5e-6, 1e-4])
@pytest.mark.parametrize("dt_s", [5e-5, 1e-4, 1e-3])
def test_taps_are_met_once_by_any_encoder_on_any_servo(count_m: float, dt_s: float) -> None:
    """A steady approach at 0.2 m/s from 8 mm above is met once, at its speed, though the surface is no zero."""
    device = DeviceFile(encoder=Encoder(count_m=count_m, surface_counts=1234.0))
    s = Settings(dt_s, 3e-4 if dt_s < 3e-4 else dt_s, 4.0, **servo_numbers(device, dt_s))
    assert s.window_ticks * dt_s == pytest.approx(10e-3, rel=0.01)
    approach = Approach(
        dt_s,
        s.lead_s,
        count_m=s.count_m,
        surface_counts=s.surface_counts,
        window_ticks=s.window_ticks,
        least_speed_m_s=s.least_speed_m_s,
    )
    trigger, met = Trigger(s.count_m, s.touch_height_m, s.rearm_height_m, s.ticks(s.rearm_s)), []
    for tick in range(round(0.045 / dt_s)):
        z = 8e-3 - 0.2 * tick * dt_s
        counts = int(np.floor(z / count_m + 0.5)) + 1234
        approach.step(counts)
        if trigger.step((counts - 1234) * count_m, approach.speed_m_s, approach.phase) is Touch.CONTACT:
            met.append((tick, approach.speed_m_s))
    assert len(met) == 1
    tick, speed = met[0]
    assert speed == pytest.approx(0.2, rel=0.02 + 0.03 * count_m / 1e-5 * (dt_s >= 1e-3 or count_m > 5e-5))
    assert abs(tick * dt_s + s.lead_s - 0.04) <= 2 * dt_s + count_m / 0.2


def test_a_coarse_encoder_may_stand_still_longer_at_the_turning_point() -> None:
    fine, usual, coarse = (
        servo_numbers(DeviceFile(encoder=Encoder(count_m=count)), 1e-4)["stuck_A_s"]
        for count in (1e-6, 24.5e-6, 1e-4)
    )
    assert fine == pytest.approx(usual)
    assert coarse == pytest.approx(usual * np.sqrt(1e-4 / 24.5e-6))


def test_a_device_without_grip_sensor_plays_for_a_grip_that_the_library_has(library: Library) -> None:
    assert assumed_grip_N(BUILT_IN, library.grips_N) is None
    most = float(library.grips_N[-1])
    assert library_numbers(BLIND, library)["assumed_grip_N"] == pytest.approx(most)
    assert f"every tap is played for {most:g} N, the nearest to 9 N" in grip_in_words(BLIND, library)
    assert grip_in_words(BUILT_IN, library) == ""
    assert assumed_grip_N(BLIND, [0.0]) == pytest.approx(0.0)


def test_a_library_for_another_device_is_refused_in_one_line(library: Library) -> None:
    with pytest.raises(InputError, match=r"servo\.dt_s = 5e-05, the library is for 0.0001 s"):
        library_numbers(DeviceFile(servo=Period(dt_s=5e-5)), library)
    with pytest.raises(InputError, match=r"hardware\.current_A = 2"):
        library_numbers(DeviceFile(hardware=Limits(current_A=2.0)), library)
