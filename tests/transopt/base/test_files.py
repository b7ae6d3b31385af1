"""Files and archives that may be anything, and folders that killed runs left behind."""

import io
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from transopt.base.errors import InputError
from transopt.base.files import check_depth, read_file, staging_folder, whole_file
from transopt.base.npz import Archive
from transopt.base.sizes import DEEPEST, MOST_UNPACKED_BYTES
from transopt.base.toml_edit import edited

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


ARRAYS: dict[str, Any] = {
    "numbers": np.arange(12.0).reshape(3, 4),
    "columns first": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "words": np.array([["a", "longer"]]),
    "one": np.array(2.5),
    "none": np.zeros((0, 3)),
}


def packed(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


def npy(array: Any, shape: tuple[int, ...] | None = None) -> bytes:
    """An NPY file, whose head may state another shape."""
    array, stream = np.asarray(array), io.BytesIO()
    head = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape if shape is None else shape}
    np.lib.format.write_array_header_1_0(stream, head)
    return stream.getvalue() + array.tobytes()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_reads_what_numpy_writes(save: Any) -> None:
    stream = io.BytesIO()
    save(stream, **ARRAYS)
    archive = Archive(stream.getvalue())
    assert set(archive) == set(ARRAYS)
    assert len(archive) == len(ARRAYS)
    for name, array in ARRAYS.items():
        assert archive[name].dtype == array.dtype
        np.testing.assert_array_equal(archive[name], array)


@pytest.mark.parametrize("shape", [(2**40,), (4, -1), (2,), (2**33, 2**33)])
def test_a_head_that_states_another_size(shape: tuple[int, ...]) -> None:
    archive = Archive(packed(a=npy(np.arange(4.0), shape)))
    with pytest.raises(ValueError, match=r"a of shape|negative"):
        archive["a"]


def test_what_would_unpack_to_more_than_there_is_room_for() -> None:
    stream, zeros = io.BytesIO(), bytes(2**20)
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.npy", "w") as member:
        for _ in range(MOST_UNPACKED_BYTES // len(zeros) + 1):
            member.write(zeros)
    data = stream.getvalue()
    assert len(data) < MOST_UNPACKED_BYTES / 500
    with pytest.raises(ValueError, match="unpacks to 257 MB, at most 256 MB"):
        Archive(data)


def test_objects_and_foreign_packing() -> None:
    stream = io.BytesIO()
    np.savez(stream, a=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="never loaded"):
        Archive(stream.getvalue())["a"]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a.npy", npy([1.0]))
    with pytest.raises(ValueError, match="packed or encrypted"):
        Archive(stream.getvalue())["a"]
    with pytest.raises(ValueError, match="a single array"):
        Archive(npy([1.0]))


def test_a_changed_line_says_what_stood_there() -> None:
    text = '# a\n[limits]\nbeta = 3.2  # wide\nwords = "a # b"\nmany = [1,\n  2]  # two\n\n[grid]\nspeeds = [1.0]\n'
    found = edited(text, {"limits.beta": 2.0, "limits.words": "c", "limits.many": [3], "grid.speeds": None, "x.y": 1})
    assert 'beta = 2.0  # wide (was 3.2)\nwords = "c"  # (was "a # b")\nmany = [3]' in found
    assert "# speeds = [1.0]" in found
    assert found.endswith("[x]\ny = 1\n")


def test_a_table_takes_the_place_of_another_with_all_that_is_in_it() -> None:
    text = "[a]\nx = 1\n# said\n[a.b]\ny = 2\n[c]\nz = 3\n"
    assert edited(text, {"a": {"w": "v"}}) == '[a]\nw = "v"\n# said\n[c]\nz = 3\n'
    assert edited(text, {"d": {"w": 1.0}}) == f"{text}\n[d]\nw = 1.0\n"


@pytest.mark.parametrize("text", ["", "limits = { beta = 3.2 }\n", "limits.beta = 3.2\n", "no text"])
def test_what_is_not_stated_line_by_line_is_not_edited(text: str) -> None:
    assert edited(text, {"limits.beta": 2.0}) is None


@pytest.mark.parametrize(
    ("line", "new"),
    [
        ("# beta = 3  # wide", "beta = 2.0  # wide"),
        ("#beta =", "beta = 2.0"),
        ("# beta =  # share", "beta = 2.0  # share"),
    ],
)
def test_a_key_that_a_comment_states_takes_its_place(line: str, new: str) -> None:
    text = "# beta = 9\n[limits]\nwide = 1\n{}\n[grid]\n# beta = 4\n"
    for noted in (True, False):
        assert edited(text.format(line), {"limits.beta": 2.0}, noted=noted) == text.format(new)
    assert edited(text.format("beta = 1"), {"limits.beta": 2.0}, noted=False) == text.format("beta = 2.0")
