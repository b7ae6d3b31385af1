"""Writes library, report and figures of a build, and moves them into their folder together."""

from collections.abc import Callable, Sequence
from pathlib import Path

from transopt.base.errors import InputError
from transopt.base.files import ctrl_c_waits, staging_folder
from transopt.base.terminal import make_folder
from transopt.base.writing import write_text
from transopt.design.build import Build
from transopt.report.markdown import build_markdown
from transopt.report.report_json import build_json

Files = dict[str, Callable[[Path], object]]  # file name -> function that writes this file to a path
LIBRARY = "library.npz"

# Files of an earlier build that this build may not write again.
LEFTOVERS = (
    "refused.md",
    "refused.json",
    "transients.png",
    "methods.png",
    "bode.png",
    "trade_off.png",
    "grid_error.png",
)


def text(content: str) -> Callable[[Path], object]:
    """A function that writes a text to a path."""
    return lambda path: write_text(content, path)


def publish(folder: Path, files: Files, stale: Sequence[str] = ()) -> None:
    """Write all files to a temporary folder beside the target, and move them only when all are complete.

    Parameters
    ----------
    stale : names of earlier results that are removed at the same time.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    place = folder
    try:
        with staging_folder(folder) as staging:
            place = staging
            for name, write in files.items():
                write(staging / name)
            with ctrl_c_waits():
                for name in files:
                    (staging / name).replace(folder / name)
                for name in stale:
                    (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be written ({error.strerror}); choose another folder") from None
    except InputError as error:
        raise InputError(str(error).replace(str(place), str(folder))) from None


def files_of(build: Build, *, figures: bool = True, full: bool = False) -> Files:
    """Library, report and, if wanted, figures; for a refused build only the reasons.

    Parameters
    ----------
    full : whether the report includes what needs further optima of every entry, see `build_markdown`.
    """
    library = build.library
    if library is None:
        return {
            "refused.md": text(build_markdown(build, full=full)),
            "refused.json": text(build_json(build, full=full)),
        }
    files: Files = {
        LIBRARY: library.save,
        "report.md": text(build_markdown(build, full=full)),
        "report.json": text(build_json(build, full=full)),
    }
    if not figures:
        return files
    # matplotlib takes longer to load than a small library takes to solve, so it is loaded only to draw.
    from transopt.base.plotting import save_figure
    from transopt.report import figures as drawing

    name = build.scene.name
    files["transients.png"] = lambda path: save_figure(library.plot(), path, name)
    files["methods.png"] = lambda path: save_figure(drawing.method_figure(build), path, name)
    if not build.scene.shares:  # each of several motors has a response in every direction
        files["bode.png"] = lambda path: save_figure(drawing.bode_figure(library), path, name)
    if full and build.trade_offs:
        files["trade_off.png"] = lambda path: save_figure(drawing.trade_off_figure(build), path, name)
    refinement = build.refinement
    if refinement is not None and refinement.entries > 1:
        files["grid_error.png"] = lambda path: save_figure(refinement.plot(), path, name)
    return files


def write_report(build: Build, folder: str | Path, *, figures: bool = True, full: bool = False) -> list[Path]:
    """Write the files of `transopt solve`: `library.npz`, `report.md`, `report.json` and the figures, all or none.

    A scene with `[model.nonlinear]` gives the files of `transopt.report.nonlinear.nonlinear_files`. A build with
    refused entries gives `refused.md` and `refused.json`, and an earlier library stays; a figure or a table of an
    earlier build that is not written now is removed.

    Parameters
    ----------
    full : whether the report has the prices and the cost of intensity of all entries, with a figure; else only the
        prices of the entry farthest above its floor. It takes several times as long as the library.

    Returns
    -------
    Paths of the files written.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    folder = Path(folder)
    make_folder(folder)
    earlier: Sequence[str]
    if build.scene.nonlinear:
        from transopt.report import nonlinear  # only a nonlinear plant needs it

        files, earlier = nonlinear.nonlinear_files(build, figures=figures), (nonlinear.COMMANDS, nonlinear.DRAWN)
    else:
        # A refused build writes no library, and keeps the earlier one with all its files.
        files, earlier = files_of(build, figures=figures, full=full), LEFTOVERS if build.library is not None else ()
    publish(folder, files, [name for name in earlier if name not in files])
    return [folder / name for name in files]
