"""Recordings that the browser uploads, stored in a temporary folder of the session."""

import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from transopt.base.errors import InputError
from transopt.files.unclear import joined
from transopt.report.tried import AskedError
from transopt.web.opening import own_taps
from transopt.web.service import Service

SUFFIXES = (".csv", ".txt", ".mat", ".npz", ".wav")
MOST_FILES = 200
MOST_UPLOAD_BYTES = 16 * 2**20


def uploadable() -> dict[str, Any]:
    """Limits by which the page checks files before it sends them."""
    return {"bytes": MOST_UPLOAD_BYTES, "files": MOST_FILES, "suffixes": SUFFIXES}


class Upload:
    """Uploaded files, concatenated in one body; names from the browser are never opened as paths.

    Parameters
    ----------
    message : `files` with names and lengths, the page's fields for reading them, and `reading`, keys of `recordings`
        with the answers that the user has chosen.
    body : content of the files.

    Attributes
    ----------
    names : safe names of the files.
    reading : keys of `recordings` by which they are read.

    Raises
    ------
    InputError : too many or too large files, incomplete data, or names that are not those of recordings.
    """

    def __init__(self, message: Mapping[str, Any], body: bytes) -> None:
        listed = message["files"]
        if not listed or len(listed) > MOST_FILES:
            raise InputError(f"{len(listed)} files dropped: from 1 to {MOST_FILES} at once")
        if len(body) > MOST_UPLOAD_BYTES:
            raise InputError(f"the files have {len(body)} bytes, at most {MOST_UPLOAD_BYTES}: drop fewer at once")
        if sum(int(size) for _, size in listed) != len(body):
            raise InputError("the files did not arrive whole: drop them again")
        columns = [each.strip() for each in str(message.get("columns") or "").split(",") if each.strip()]
        self.reading: dict[str, Any] = {"columns": columns} if columns else {}
        if message.get("speed_m_s") is not None:
            self.reading["speed_m_s"] = float(message["speed_m_s"])
        if message.get("accept"):
            self.reading["implausible"] = "accept"
        self.reading = joined(self.reading, message.get("reading") or {})
        self.names: list[str] = []
        for name, _ in listed:
            self.names.append(safe_name(str(name), self.names))
        self._folder = tempfile.TemporaryDirectory()
        at = 0
        for name, (_, size) in zip(self.names, listed, strict=True):
            (Path(self._folder.name) / name).write_bytes(body[at : at + int(size)])
            at += int(size)

    def service(self, of: Service) -> Service:
        """The service of a scene with these taps in place of its recordings.

        Raises
        ------
        AskedError : files that leave a fact open.
        InputError : files that are not taps for this scene.
        """
        try:
            return own_taps(of, Path(self._folder.name), self.names, self.reading)
        except InputError as error:
            if isinstance(error, AskedError) and error.good:
                raise
            raise InputError(str(error).replace(f"{self._folder.name}/", "")) from None

    def close(self) -> None:
        """Delete the files."""
        self._folder.cleanup()


def safe_name(name: str, taken: list[str]) -> str:
    """A file name of letters, digits, dashes and underscores, with a supported suffix.

    Raises
    ------
    InputError : another suffix.
    """
    stem, dot, suffix = name.rpartition(".")
    suffix = f"{dot}{suffix}".lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{name[:80]}: not a recording: files of taps end in {', '.join(SUFFIXES)}")
    safe = re.sub(r"[^A-Za-z0-9_-]", "_", stem)[:60] or "tap"
    while f"{safe}{suffix}" in taken:
        safe += "_"
    return f"{safe}{suffix}"
