"""Files that may be anything, and folders that killed runs left behind."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from transopt.base.errors import InputError
from transopt.base.files import check_depth, read_file, staging_folder, whole_file
from transopt.base.sizes import DEEPEST

ADVICE = "give another"


def refusal(path: Path, most_bytes: int = 100) -> str:
    with pytest.raises(InputError) as caught:
        read_file(path, most_bytes, ADVICE)
    message = str(caught.value)
    assert message.isprintable()
    assert message.endswith(ADVICE)
    return message


class TestReading:
    def test_up_to_the_limit(self, tmp_path: Path) -> None:
        path = tmp_path / "file"
        path.write_bytes(b"x" * 100)
        assert read_file(path, 100, ADVICE) == b"x" * 100
        assert "larger than" in refusal(path, 99)

    def test_what_is_no_file(self, tmp_path: Path) -> None:
        assert "no such file" in refusal(tmp_path / "absent")
        assert "no such file" in refusal(tmp_path / "two\nlines")
        assert "a folder, not a file" in refusal(tmp_path)
        assert "cannot be a file" in refusal(tmp_path / "zero\0byte")
        assert "too long" in refusal(tmp_path / ("n" * 5000))

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
    def test_nothing_that_would_block_is_opened(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "pipe")
        assert "a pipe or a device" in refusal(tmp_path / "pipe")
        assert "a pipe or a device" in refusal(Path(os.devnull))


@pytest.mark.skipif(os.name != "posix", reason="devices are files only there")
def test_no_device_is_replaced_by_a_file(tmp_path: Path) -> None:
    place = tmp_path / "pipe.csv"
    os.mkfifo(place)
    with pytest.raises(InputError, match="a pipe or a device is there"), whole_file(place) as file:
        file.write(b"x")
    assert place.is_fifo()
    assert list(tmp_path.iterdir()) == [place]


def test_depth_is_bounded() -> None:
    value: object = 1
    for _ in range(DEEPEST):
        value = [value]
    check_depth({"a": [1, {"b": 2}]})
    with pytest.raises(ValueError, match="nested deeper"):
        check_depth({"a": value})


class TestStaging:
    def test_gone_at_the_end(self, tmp_path: Path) -> None:
        with staging_folder(tmp_path) as staging:
            assert list(tmp_path.iterdir()) == [staging]
            (staging / "file").write_text("x")
        assert not list(tmp_path.iterdir())

    @pytest.mark.skipif(os.name != "posix", reason="elsewhere a process cannot be asked whether it runs")
    def test_what_a_killed_process_left_is_swept(self, tmp_path: Path) -> None:
        program = (
            "import os, sys; from pathlib import Path; from transopt.base.files import staging_folder\n"
            "with staging_folder(Path(sys.argv[1])) as staging:\n"
            "    (staging / 'file').write_text('x')\n"
            "    os.kill(os.getpid(), 9)\n"
        )
        subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=False)
        (left,) = tmp_path.iterdir()
        assert left.name.startswith(".part-")
        with staging_folder(tmp_path) as running:
            assert list(tmp_path.iterdir()) == [running]
            with staging_folder(tmp_path):
                assert running.exists(), "its process runs"

    def test_others_are_left_alone(self, tmp_path: Path) -> None:
        others = [tmp_path / ".part-elsewhere-1-abc", tmp_path / ".part-abc", tmp_path / "results"]
        for folder in others:
            folder.mkdir()
        with staging_folder(tmp_path):
            pass
        assert all(folder.exists() for folder in others)
