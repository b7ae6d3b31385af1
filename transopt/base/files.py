"""Reading files that may be anything, writing files whole or not at all, steps that Ctrl-C must not cut in two."""

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

STAGING = ".part-"  # how the folder begins in which results are written before they are moved into place


def read_file(path: Path, most_bytes: int, advice: str) -> bytes:
    """The content of a regular file that is not too large; nothing else is opened, since a pipe would block for ever.

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
    """A library that lies in a folder that was named in its stead."""
    library = folder / "library.npz"
    return f" (did you mean {library}?)" if is_file(library) else ""


def is_file(path: Path) -> bool:
    """Whether there is a regular file; False also for a name that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def check_depth(value: Any) -> None:
    """Refuse tables and lists that are nested deeper than anything here: whoever walks them would run out of stack.

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
    """A binary file that appears under `path` when the block ends well, and not at all otherwise.

    It is written beside its place under a temporary name, then renamed over it.

    Raises
    ------
    InputError : the place cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.exists() and not path.is_file():  # a device would be replaced by a file
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
    """A folder inside another, for results that are moved into it together; it is gone when the block ends.

    Folders that killed processes of this computer left behind are swept first.

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
    """This computer's name: a folder may be shared with others, whose processes cannot be seen here."""
    return "".join(c for c in socket.gethostname() if c.isalnum()) or "here"


def _staged(folder: Path) -> Iterator[tuple[str, int]]:
    """Name and process of the staging folders of this computer."""
    ours = f"{STAGING}{_computer()}-"
    for found in folder.glob(f"{STAGING}*"):
        process = found.name.removeprefix(ours).split("-")[0]
        if found.name.startswith(ours) and process.isdecimal() and found.is_dir() and not found.is_symlink():
            yield found.name, int(process)


def _runs(process: int) -> bool:
    """Whether a process is there; True where that cannot be asked without ending it (Windows)."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True  # another user's
    return True


@contextmanager
def ctrl_c_waits() -> Iterator[None]:
    """A Ctrl-C or SIGTERM that comes inside is answered at the end; processes started inside never see a Ctrl-C.

    A Ctrl-C is held back in this thread, which a process started here inherits. The system may hand a signal to
    another thread, and Python then answers it in the main thread all the same: so the answers are put off too.
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
    """Whether a signal has an answer in Python, and this is the thread that gives it."""
    return threading.current_thread() is threading.main_thread() and callable(signal.getsignal(number))


def without_nan(value: Any) -> Any:
    """A copy of nested dictionaries and lists with None for every number that JSON cannot hold (NaN, infinity)."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
