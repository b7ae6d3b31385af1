"""Device files: read, written, kept as their owner wrote them, refused in one line."""

from pathlib import Path

import pytest

from controller.device.device_file import BUILT_IN, DeviceFile, Encoder, Grip, Period
from controller.device.reading import BESIDE, as_text, examples, find, read_device, restate, write_device
from transopt.base.errors import InputError


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
