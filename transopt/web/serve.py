"""Serves a scene or a library as a page: for the command, for Python, for a notebook."""

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Self

from transopt.base.errors import InputError
from transopt.base.shown import html_figure, html_table
from transopt.design.entry import Entry
from transopt.library.columns import EntryTable
from transopt.library.library import Library
from transopt.report.transients import entries_figure
from transopt.scene.scene import Scene
from transopt.web.opening import opened
from transopt.web.server import Server, check_extra

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Page:
    """A page that can be served; every window that opens it has a service of its own.

    Parameters
    ----------
    source : a scene, a library, the name of a built-in scene, or the path of a .toml or .npz file.
    port : 0 for any free port; None for the usual one, or any if that is taken.
    recordings : folder of the scene's recordings, in place of the one that it names.
    token : secret part of the address; random by default.
    accept : whether to accept implausible numbers.

    Attributes
    ----------
    address : address to open in a browser on this machine; its token is secret.

    Raises
    ------
    InputError : a file that cannot be used, the extra `page` is missing, or the port is taken.
    """

    def __init__(
        self,
        source: Scene | Library | str | Path,
        *,
        port: int | None = 0,
        recordings: Path | None = None,
        token: str = "",
        accept: bool = False,
    ) -> None:
        check_extra()
        self.service = opened(source, recordings, accept=accept)
        self._server = Server(self.service.another, port, token)

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.service.opened.name

    @property
    def address(self) -> str:
        return self._server.address

    def serve(self) -> None:
        """Serve until a signal ends the process."""
        self._server.serve()

    def start(self) -> Self:
        """Serve in a thread of its own."""
        self._server.start()
        return self

    def close(self) -> None:
        """End the thread of `start`."""
        self._server.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Page({self.name}: {self.address})"

    @cached_property
    def _entries(self) -> list[list[Entry]]:
        """All taps as entries of a library, in rows of speeds or targets."""
        width = len(self.service.scene.axes.grips_N)
        entries = [self.service.entry(index) for index in range(len(self.service.places))]
        return [entries[at : at + width] for at in range(0, len(entries), width)]

    def plot(self) -> "Figure":
        """All taps in the figure of a library, without a server."""
        return entries_figure(self._entries)

    def _repr_html_(self) -> str:
        """Table and figure in a notebook, static."""
        rows, scene = self._entries, self.service.scene
        names = ("tap", "floor", "binding", "verdict")
        entries = [entry for row in rows for entry in row]
        shown = EntryTable(scene.axes.columns, names, entries, scene.driven_by.unit)
        return html_table(repr(self), shown.heads, shown.cells) + html_figure(entries_figure(rows))


def page(source: Scene | Library | str | Path, *, port: int = 0) -> Page:
    """Serve a scene or a library on its page, in a thread of this process.

    Returns
    -------
    The page, whose `address` a browser on this machine opens, and which a notebook shows; `close` ends it.

    Raises
    ------
    InputError : what `Page` refuses; a nonlinear plant.
    """
    if not isinstance(source, Scene | Library | str | Path):
        raise InputError(f"page: a scene, a library, or the name or path of one, not {type(source).__name__}")
    return Page(source, port=port).start()
