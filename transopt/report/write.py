"""Library, report and figures of a build, written into a folder in one call."""

from pathlib import Path

from transopt.base.terminal import make_folder
from transopt.design.build import Build
from transopt.report.publish import LEFTOVERS, files_of, publish


def write_report(build: Build, folder: str | Path, *, figures: bool = True) -> list[Path]:
    """Write what `transopt solve` writes: `library.npz`, `report.md`, `report.json` and the figures, all or none.

    Of a build with refused entries it is `refused.md` and `refused.json`, and an earlier library stays.

    Returns
    -------
    The files.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    folder = Path(folder)
    make_folder(folder)
    files = files_of(build, figures=figures)
    # A build that was refused writes no library, and leaves the earlier one with all that belongs to it.
    stale = [] if build.library is None else [name for name in LEFTOVERS if name not in files]
    publish(folder, files, stale)
    return [folder / name for name in files]
