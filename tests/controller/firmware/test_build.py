"""Compiling the C sources: kept, found again, refused in one line."""

import sysconfig
from pathlib import Path

import pytest

from controller.firmware import build as builder
from controller.firmware.build import NoCompilerError, build, compiler
from transopt.base.errors import InputError


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def source(tmp_path: Path) -> Path:
    try:
        compiler()
    except NoCompilerError as missing:
        pytest.skip(str(missing))
    path = tmp_path / "source" / "answer.c"
    path.parent.mkdir()
    path.write_text("int main(void) { return 0; }\n")
    return path


def test_what_is_built_is_kept_and_found_again(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = build("answer", [source])
    assert first.stat().st_mode & 0o777 == 0o700
    assert list(first.parent.iterdir()) == [first], "a temporary file is left"

    def never(*_: object) -> None:
        raise AssertionError("compiled a second time")

    monkeypatch.setattr(builder, "_compile", never)
    assert build("answer", [source]) == first


def test_sources_flags_and_compiler_each_make_another_binary(source: Path) -> None:
    chosen = compiler()
    built = {build("answer", [source]), build("answer", [source], flags=("-O1",))}
    (source.parent / "answer.h").write_text("/* not even included */\n")
    built.add(build("answer", [source]))
    source.write_text("int main(void) { return 1; }\n")
    built.add(build("answer", [source]))
    built.add(build("answer", [source], with_=builder.Compiler(chosen.command, chosen.version + "another")))
    assert len(built) == 5


def test_a_compiler_named_in_cc_has_to_run(monkeypatch: pytest.MonkeyPatch) -> None:
    for words in ("/nowhere/cc", "false"):
        monkeypatch.setenv("CC", words)
        with pytest.raises(NoCompilerError, match=f"CC = {words}: is no C compiler that runs; unset CC"):
            compiler()


def test_no_compiler_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sysconfig, "get_config_var", lambda name: None)
    with pytest.raises(NoCompilerError, match=r"^no C compiler found \(cc, gcc, clang\): install one") as told:
        compiler()
    assert isinstance(told.value, InputError)


def test_a_source_that_does_not_compile_is_told_with_its_first_error(source: Path) -> None:
    source.write_text("int main(void) { return nothing; }\n")
    with pytest.raises(NoCompilerError, match=r"cannot compile the device: .*nothing") as told:
        build("answer", [source])
    assert "\n" not in str(told.value)
    assert list(builder.cache_folder().iterdir()) == []


def test_a_cache_that_cannot_be_written_is_told(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(InputError, match=r"cannot be written .*; set XDG_CACHE_HOME to another"):
        build("answer", [source])
