"""The files of a build come into their folder together, or not at all."""

from pathlib import Path

import pytest

from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.report.write import publish


def written(path: Path) -> None:
    path.write_text("new")


def test_everything_comes_at_the_end_and_what_is_stale_goes(tmp_path: Path) -> None:
    (tmp_path / "stale").write_text("old")

    def last(path: Path) -> None:
        assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["stale"]
        written(path)

    publish(tmp_path, {"a": written, "b": last}, ["stale"])
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys("ab", "new")


def test_a_folder_that_is_gone_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="gone: cannot be written"):
        publish(tmp_path / "gone", {"a": written})


def test_no_error_names_the_place_beside(tmp_path: Path) -> None:
    def fails(path: Path) -> None:
        with whole_file(path) as file:
            file.write(b"half")
            raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match=r"a: cannot be written .No space left") as caught:
        publish(tmp_path, {"a": fails})
    assert str(caught.value).startswith(f"{tmp_path / 'a'}:")
    assert list(tmp_path.iterdir()) == []
