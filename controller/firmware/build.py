"""The C sources, compiled by the system's compiler on first use and kept in a folder of the user's.

What is kept is found again by a hash of sources, flags and compiler, so that no stale binary is ever run; it appears
there by a rename, so that two processes may build at once.
"""

import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sysconfig
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from transopt.base.errors import InputError

FIRMWARE = Path(__file__).parent
CORE = FIRMWARE / "src" / "core"
# Contraction of a * b + c would give other bits than Python's floats.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
STRICT = ("-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wdouble-promotion", "-Wshadow")
BUILD_S = 120.0  # no compiler takes longer over a few small files


class NoCompilerError(InputError):
    """There is no C compiler on this machine, or none that works."""


@dataclass(frozen=True)
class Compiler:
    """A command that compiles C, and how it names itself."""

    command: tuple[str, ...]
    version: str


def compiler() -> Compiler:
    """$CC if it is set, else the one Python was built with, `cc`, `gcc` or `clang`, whichever runs first.

    Raises
    ------
    NoCompilerError : none runs, or $CC does not.
    """
    stated = os.environ.get("CC")
    found = [stated] if stated else [sysconfig.get_config_var("CC"), "cc", "gcc", "clang"]
    for words in found:
        command = tuple(shlex.split(words or ""))
        if not command or shutil.which(command[0]) is None:
            continue
        try:
            said = subprocess.run(
                [*command, "--version"], capture_output=True, text=True, timeout=BUILD_S, check=True
            )
        except (OSError, subprocess.SubprocessError):
            continue
        return Compiler(command, said.stdout)
    if stated:
        raise NoCompilerError(f"CC = {stated}: is no C compiler that runs; unset CC or name another")
    raise NoCompilerError("no C compiler found (cc, gcc, clang): install one or name it in the variable CC")


def cache_folder() -> Path:
    """Cache folder of this user: $XDG_CACHE_HOME or ~/.cache, and in it transopt/firmware."""
    stated = os.environ.get("XDG_CACHE_HOME")
    return (Path(stated) if stated else Path.home() / ".cache") / "transopt" / "firmware"


def sources(*folders: Path) -> list[Path]:
    """All C files of these folders, in a fixed order."""
    return sorted(path for folder in folders for path in folder.glob("*.c"))


def build(
    name: str,
    files: Iterable[Path],
    *,
    flags: Iterable[str] = (),
    shared: bool = False,
    with_: Compiler | None = None,
) -> Path:
    """An executable, or a shared library, of these C files; compiled only if it is not there yet.

    Parameters
    ----------
    flags : beside `FLAGS`. with_ : compiler; the system's without it.

    Raises
    ------
    NoCompilerError : no compiler, or it refuses these sources; the message holds its first complaint.
    InputError : the user's cache folder cannot be written.
    """
    chosen, files = compiler() if with_ is None else with_, list(files)
    folders = sorted({CORE, *(path.parent for path in files)})
    options = [*FLAGS, *flags, *(["-shared", "-fPIC", "-fvisibility=default"] if shared else [])]
    key = hashlib.sha256(
        "\0".join((platform.machine(), *chosen.command, chosen.version, *options, *map(str, files))).encode()
    )
    for path in sorted(path for folder in folders for path in folder.glob("*.[ch]")):
        key.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    folder = cache_folder()
    built = folder / f"{name}-{key.hexdigest()[:32]}{'.so' if shared else ''}"
    if built.exists():
        return built
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle, scratch = tempfile.mkstemp(prefix=f".{name}-", dir=folder)
        os.close(handle)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); set XDG_CACHE_HOME to another") from None
    temporary = Path(scratch)
    try:
        _compile(chosen, [*options, *(f"-I{path}" for path in folders)], files, temporary)
        temporary.chmod(0o700)
        temporary.replace(built)
    finally:
        temporary.unlink(missing_ok=True)
    return built


def _compile(chosen: Compiler, options: list[str], files: list[Path], target: Path) -> None:
    command = [*chosen.command, *options, *map(str, files), "-o", str(target), "-lm"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=BUILD_S, check=False)
    except (OSError, subprocess.SubprocessError) as error:
        raise NoCompilerError(
            f"{chosen.command[0]}: does not run ({error}); name another in the variable CC"
        ) from None
    if done.returncode:
        complaint = next((line for line in done.stderr.splitlines() if "error" in line), "no message")
        raise NoCompilerError(f"{chosen.command[0]}: cannot compile the device: {complaint.strip()}")
