"""The machine and the versions with which a figure was measured."""

import os
import platform
from functools import lru_cache
from importlib import metadata
from pathlib import Path


def machine() -> dict[str, object]:
    """Name of the processor, number of cores, operating system."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line.split(":")[1].strip() for line in info.read_text().splitlines() if "model name" in line]
        name = models[0] if models else name
    return {"cpu": name, "cores": os.cpu_count(), "system": platform.platform()}


def versions(*names: str) -> dict[str, str]:
    """Name -> version of installed packages, and of Python.

    Raises
    ------
    importlib.metadata.PackageNotFoundError : one of them is not installed.
    """
    return {**{name: _version(name) for name in names}, "python": platform.python_version()}


@lru_cache(maxsize=64)  # versions do not change while the process runs, and reading one takes a millisecond
def _version(name: str) -> str:
    return metadata.version(name)
