"""Safe reading of untrusted files, atomic writing of files, and steps that Ctrl-C must not interrupt."""

import math
import os
import shutil
import signal
import socket
import stat
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from transopt.base.errors import InputError
from transopt.base.sizes import DEEPEST, megabytes

STAGING = ".part-"  # prefix of the temporary folders in which results are written before they are moved


def read_file(path: Path, most_bytes: int, advice: str) -> bytes:
    """The content of a regular file up to a size; nothing else is opened, since reading a pipe could block forever.

    Parameters
    ----------
    advice : what to do instead, at the end of every message.

    Raises
    ------
    InputError : no such file, a folder, a pipe or a device, no permission to read it, or too large.
    """
    name = str(path) if str(path).isprintable() else ascii(str(path))
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            kind = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
            raise InputError(f"{name}: {kind}, not a file{_inside(path)}; {advice}")
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except FileNotFoundError:
        raise InputError(f"{name}: no such file; {advice}") from None
    except PermissionError:
        raise InputError(f"{name}: no permission to read it; {advice}") from None
    except OSError as error:
        raise InputError(f"{name}: cannot be read ({error.strerror}); {advice}") from None
    except InputError:
        raise
    except ValueError as error:  # a name with a zero byte
        raise InputError(f"{name}: cannot be a file ({error}); {advice}") from None
    if len(data) > most_bytes:
        raise InputError(f"{name}: larger than {megabytes(most_bytes)}; {advice}")
    return data


def _inside(folder: Path) -> str:
    """Hint to the library file inside a folder that was given in its place; empty without one."""
    library = folder / "library.npz"
    return f" (did you mean {library}?)" if is_file(library) else ""


def is_file(path: Path) -> bool:
    """Whether the path is a regular file; False also for a name that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def check_depth(value: Any) -> None:
    """Refuse tables and lists nested so deeply that recursive functions would exceed the stack.

    Raises
    ------
    ValueError : nested deeper than `DEEPEST`.
    """
    level, depth = [value], 0
    while level:
        if depth > DEEPEST:
            raise ValueError(f"nested deeper than {DEEPEST} levels")
        nested = [each for each in level if isinstance(each, dict | list)]
        level = [inner for each in nested for inner in (each.values() if isinstance(each, dict) else each)]
        depth += 1


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A binary file that appears under `path` only if the block ends without an exception.

    It is written in the same folder under a temporary name, then renamed to `path`.

    Raises
    ------
    InputError : the path cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.exists() and not path.is_file():  # renaming would replace a device by a file
            raise OSError(0, "a folder, a pipe or a device is there")
        try:
            with temporary.open("wb") as file:
                yield file
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        if not path.parent.is_dir():
            raise InputError(
                f"{path}: there is no folder {path.parent}: create it, or choose another place"
            ) from None
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another place") from None


@contextmanager
def staging_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder inside `folder` for results that are moved there together; removed at the block's end.

    Temporary folders left behind by killed processes of this computer are removed first.

    Raises
    ------
    OSError : the folder cannot be written.
    """
    for name, process in _staged(folder):
        if not _runs(process):
            shutil.rmtree(folder / name, ignore_errors=True)
    with ctrl_c_waits():
        staging = Path(tempfile.mkdtemp(dir=folder, prefix=f"{STAGING}{_computer()}-{os.getpid()}-"))
    try:
        yield staging
    finally:
        with ctrl_c_waits():
            shutil.rmtree(staging, ignore_errors=True)


def _computer() -> str:
    """This computer's name; a folder may be shared with other computers, whose processes cannot be checked here."""
    return "".join(c for c in socket.gethostname() if c.isalnum()) or "here"


def _staged(folder: Path) -> Iterator[tuple[str, int]]:
    """Names and process ids of the temporary folders of this computer."""
    ours = f"{STAGING}{_computer()}-"
    for found in folder.glob(f"{STAGING}*"):
        process = found.name.removeprefix(ours).split("-")[0]
        if found.name.startswith(ours) and process.isdecimal() and found.is_dir() and not found.is_symlink():
            yield found.name, int(process)


def _runs(process: int) -> bool:
    """Whether a process is running; True on Windows, where the check would end it."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True  # it runs as another user
    return True


@contextmanager
def ctrl_c_waits() -> Iterator[None]:
    """Defer Ctrl-C and SIGTERM to the end of the block; processes started inside it never receive a Ctrl-C.

    SIGINT is blocked in this thread, and processes started here inherit that. The system may deliver a signal to
    another thread, for which Python runs the handler in the main thread all the same; so the handlers are deferred
    too.
    """
    waiting = [number for number in (signal.SIGINT, signal.SIGTERM) if _answered_here(number)]
    came: list[int] = []
    masks = hasattr(signal, "pthread_sigmask")  # Windows has no signal masks
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else set()
    answers = {number: signal.signal(number, lambda given, _: came.append(given)) for number in waiting}
    try:
        yield
    finally:
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, previous)
        for number, answer in answers.items():
            signal.signal(number, answer)
        for given in came:
            signal.raise_signal(given)


def _answered_here(number: int) -> bool:
    """Whether a signal has a Python handler, and this is the main thread, in which handlers run."""
    return threading.current_thread() is threading.main_thread() and callable(signal.getsignal(number))


def without_nan(value: Any) -> Any:
    """A copy of nested dictionaries and lists with None for each number that JSON cannot hold (NaN, infinity)."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
