"""Which library a device holds, in words: a device knows only the hash of what it was sent.

One line per library in a small file of the user's: the hash and the name of the scene it was solved from. A library
that was uploaded elsewhere has no name here.
"""

import os
from contextlib import suppress
from pathlib import Path

from transopt.base.errors import InputError
from transopt.base.files import whole_file

KEPT = 1000  # lines
SHOWN = 8  # hexadecimal digits


def _path() -> Path:
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "transopt" / "libraries"


def _names() -> dict[str, str]:
    # A file that cannot be read names nothing.
    with suppress(OSError, UnicodeDecodeError):
        lines = _path().read_text(encoding="utf-8").splitlines()
        return {digest: name for digest, _, name in (line.partition(" ") for line in lines) if name}
    return {}


def in_words(library_sha256: bytes) -> str:
    """`wood_on_foam (3fa2b1c0)`, or only the hash of a library without a name; `no library` for zeros."""
    if not any(library_sha256):
        return "no library"
    digest = library_sha256.hex()
    name = _names().get(digest)
    return f"library {digest[:SHOWN]}" if name is None else f"{name} ({digest[:SHOWN]})"


def remember(library_sha256: bytes, name: str) -> None:
    """Give a library its name. Where nothing can be written it has none the next time."""
    names = _names()
    names.pop(library_sha256.hex(), None)
    kept = [*list(names.items())[1 - KEPT :], (library_sha256.hex(), " ".join(name.split()))]
    with suppress(OSError, InputError):
        _path().parent.mkdir(parents=True, exist_ok=True)
        with whole_file(_path()) as file:
            file.write("".join(f"{digest} {words}\n" for digest, words in kept).encode())
