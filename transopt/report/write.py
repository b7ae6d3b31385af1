"""Library, report and figures of a build, written into a folder in one call."""

from pathlib import Path

from transopt.base.terminal import make_folder
from transopt.design.build import Build
from transopt.report.publish import LEFTOVERS, files_of, publish


def write_report(build: Build, folder: str | Path, *, figures: bool = True, full: bool = False) -> list[Path]:
    """Write what `transopt solve` writes: `library.npz`, `report.md`, `report.json` and the figures, all or none.

    Of a scene with `[model.nonlinear]` it is what `transopt.report.nonlinear.write_nonlinear` says.
    Of a build with refused entries it is `refused.md` and `refused.json`, and an earlier library stays.

    Parameters
    ----------
    full : whether the report has the prices of all entries and what intensity costs each, with its figure; else
        only the prices of the entry farthest above its floor. It takes several times as long as the library.

    Returns
    -------
    The files.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    if build.scene.nonlinear:
        # Only a nonlinear plant needs this import.
        from transopt.report.nonlinear import write_nonlinear

        return write_nonlinear(build, folder, figures=figures)
    folder = Path(folder)
    make_folder(folder)
    files = files_of(build, figures=figures, full=full)
    # A build that was refused writes no library, and leaves the earlier one with all that belongs to it.
    stale = [] if build.library is None else [name for name in LEFTOVERS if name not in files]
    publish(folder, files, stale)
    return [folder / name for name in files]
