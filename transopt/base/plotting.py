"""Shared by all figures: sizes, colours, and atomic writing."""

import io
from pathlib import Path

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis, Tick, Ticker
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, NullLocator

from transopt.base.files import whole_file
from transopt.base.shown import cut
from transopt.base.signals import FloatArray

DPI = 150
COMPRESSION = 3  # of PNG files: the usual 6 takes a third longer for files smaller by a twentieth
LABEL_PT, SMALL_PT = 9.0, 8.0
OPTIMUM, SEED, CLIPPED = "#0072B2", "#D55E00", "#009E73"  # Okabe and Ito's blue, vermilion and green
DARK, FAINT = "0.15", "0.4"
VIRIDIS_RANGE = (0.12, 0.8)  # darker hides a reference drawn over it, lighter fades on white paper


class Drawing(Figure):
    """A figure that a notebook displays.

    A notebook displays Matplotlib's own figures only once pyplot is loaded, which this package does not do.
    """

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png", dpi=DPI)
        return file.getvalue()


def save_figure(figure: Figure, path: Path, name: str = "") -> None:
    """Write a PNG whole or not at all.

    Parameters
    ----------
    name : name of the scene or device shown, written into the lower left corner.

    Raises
    ------
    InputError : the file cannot be written.
    """
    figure.set_dpi(DPI)
    if (layout := figure.get_layout_engine()) is not None:
        # savefig would draw the figure a second time only to lay it out, so the layout is executed here, once.
        # (The engine "none" would leave a placeholder, for which savefig goes through the whole figure again.)
        layout.execute(figure)
        figure.set_layout_engine(None)
    if name:
        figure.text(0.01, 0.01, cut(name), size=SMALL_PT, color=FAINT, parse_math=False)
    draw_ticks_at_once(figure)
    with whole_file(path) as file:
        figure.savefig(file, format="png", dpi=DPI, pil_kwargs={"compress_level": COMPRESSION})


def leave_room(figure: Figure, left_in: float, right_in: float, below_in: float, above_in: float) -> None:
    """Set the margins around the panels of a figure, without a layout engine.

    A layout engine takes as long to find room for labels of known size as Matplotlib takes to draw them.
    """
    width, height = figure.get_size_inches()
    if figure.get_layout_engine() is not None:  # set by a user's matplotlibrc; it would ignore the margins
        with rc_context({"figure.constrained_layout.use": False, "figure.autolayout": False}):
            figure.set_layout_engine(None)
    figure.subplots_adjust(
        left=left_in / width, right=1 - right_in / width, bottom=below_in / height, top=1 - above_in / height
    )


def colours(n: int) -> FloatArray:
    """(n, 4) colours from dark to light, for quantities that have an order."""
    return np.asarray(colormaps["viridis"](np.linspace(*VIRIDIS_RANGE, n) if n > 1 else [0.35]))


def plain(value: float, _: object = None) -> str:
    """A tick's label without exponent and trailing zeros; the second argument is Matplotlib's tick position."""
    return f"{value:g}"


def style(axes: Axes) -> None:
    """Small tick labels, and a light grid behind the data."""
    axes.tick_params(labelsize=SMALL_PT)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def draw_ticks_at_once(figure: Figure) -> None:
    """Draw the ticks without labels of each axis, and their grid, as one line each, once all limits are final.

    Matplotlib draws each tick as three lines and two labels: the ticks of seven panels take longer than their data.
    Ticks with labels are unchanged.
    """
    found = []
    for axes in figure.axes:
        drawn = (axes.xaxis, axes.yaxis) if axes.axison else ()
        for axis in filter(Axis.get_visible, drawn):
            for ticks, places in (("major", axis.get_majorticklocs()), ("minor", axis.get_minorticklocs())):
                low, high = sorted(axis.get_view_interval())
                seen = np.asarray(places)[(places >= low) & (places <= high)]
                if seen.size and not _labelled(axis, ticks, seen):
                    found.append((axes, axis, ticks, seen))
    # Only after all positions are known: panels that share an axis share its locator, which each of them needs.
    for axes, axis, ticks, places in found:
        tick = _first(axis, ticks)
        for line in (tick.gridline, tick.tick1line, tick.tick2line):
            if line.get_visible():
                axes.add_artist(_at_all(line, places, along_x=axis is axes.xaxis)).set_zorder(axis.get_zorder())
        setattr(axis, ticks, Ticker())  # one of its own
        getattr(axis, f"set_{ticks}_locator")(NullLocator())
        getattr(axis, f"set_{ticks}_formatter")(NullFormatter())


def _first(axis: Axis, ticks: str) -> Tick:
    """A tick of an axis, "major" or "minor", which shows how all of them are drawn."""
    return (axis.get_major_ticks(1) if ticks == "major" else axis.get_minor_ticks(1))[0]


def _labelled(axis: Axis, ticks: str, places: FloatArray) -> bool:
    tick = _first(axis, ticks)
    formatter = axis.get_major_formatter() if ticks == "major" else axis.get_minor_formatter()
    return (tick.label1.get_visible() or tick.label2.get_visible()) and any(formatter.format_ticks(places.tolist()))


def _at_all(line: Line2D, places: FloatArray, *, along_x: bool) -> Line2D:
    """One line that draws a line of a tick at all places; NaN separates them."""
    across = np.append(line.get_ydata() if along_x else line.get_xdata(), np.nan)
    along, across = np.repeat(places, across.size), np.tile(across, places.size)
    found = Line2D(*((along, across) if along_x else (across, along)))
    found.update_from(line)
    found.set_clip_on(line.get_marker() in ("None", None))  # the marks stand outside the panel
    return found
