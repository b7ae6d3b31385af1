"""The files that a build leaves, written together and moved into their folder together."""

import shutil
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path

from transopt.base.errors import InputError
from transopt.base.files import ctrl_c_waits
from transopt.design.build import Build
from transopt.report.markdown import build_json, build_markdown


@dataclass(frozen=True)
class Files:
    """File name -> what writes it: in this process, and what any process can do."""

    here: dict[str, Callable[[Path], None]]
    tasks: dict[str, Callable[[Path], None]]

    @property
    def names(self) -> list[str]:
        return [*self.here, *self.tasks]


@contextmanager
def publishing(folder: Path, files: Files, stale: list[str], pool: Executor | None) -> Iterator[None]:
    """Write all files beside the folder's own and move them in only when all are whole, at the end of the block.

    Parameters
    ----------
    stale : names of earlier results that go when these come.
    pool : workers for what any process can write, which they do while the block runs.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    drawing: dict[str, Future[None]] = {}
    staging = folder
    try:
        staging = Path(tempfile.mkdtemp(dir=folder, prefix=".part-"))
        if pool is not None:
            with suppress(BrokenProcessPool), ctrl_c_waits():
                for name, write in files.tasks.items():
                    drawing[name] = pool.submit(write, staging / name)
        yield
        for name, write in files.here.items():
            write(staging / name)
        for name, write in files.tasks.items():
            if not _is_drawn(drawing.get(name)):
                write(staging / name)
        with ctrl_c_waits():
            for name in files.names:
                (staging / name).replace(folder / name)
            for name in stale:
                (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be written ({error.strerror}); choose another folder") from None
    except InputError as error:
        raise InputError(str(error).replace(str(staging), str(folder))) from None
    finally:
        try:
            # Who still draws would write into the folder while it is being removed.
            wait([figure for figure in drawing.values() if not figure.cancel()])
        finally:
            if staging != folder:
                shutil.rmtree(staging, ignore_errors=True)


def _is_drawn(drawing: Future[None] | None) -> bool:
    """Whether a worker has finished a figure: there may be no worker, or one that died over it."""
    if drawing is None:
        return False
    try:
        drawing.result()
    except BrokenProcessPool:
        return False
    return True


def _draw(figure: str, subject: object, path: Path) -> None:
    """A figure by its module and function; this process need not have loaded either, nor matplotlib."""
    from transopt.base.plotting import save_figure

    module, name = figure.rsplit(".", 1)
    save_figure(getattr(import_module(f"transopt.{module}"), name)(subject), path)


# Of an earlier build in the same folder, which this one may not have.
LEFTOVERS = ("refused.md", "refused.json", "transients.png", "methods.png", "bode.png", "grid_error.png")


def files_of(build: Build, *, figures: bool = True) -> Files:
    """Library, report and, unless not wanted, figures; of a build that was refused, why."""

    def text(content: str) -> Callable[[Path], None]:
        def write(path: Path) -> None:
            path.write_text(content, encoding="utf-8")

        return write

    library = build.library
    if library is None:
        return Files({"refused.md": text(build_markdown(build)), "refused.json": text(build_json(build))}, {})
    drawn: dict[str, Callable[[Path], None]] = {
        "transients.png": partial(_draw, "library.figures.library_figure", library),
        "methods.png": partial(_draw, "report.figures.method_figure", replace(build, references=[], library=None)),
        "bode.png": partial(_draw, "report.figures.bode_figure", library),
    }
    if (refinement := build.refinement) is not None and refinement.entries > 1:
        drawn["grid_error.png"] = partial(_draw, "report.grid_figure.grid_figure", refinement)
    return Files(
        here={
            "library.npz": library.save,
            "report.md": text(build_markdown(build)),
            "report.json": text(build_json(build)),
        },
        tasks=drawn if figures else {},
    )
