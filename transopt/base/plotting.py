"""Shared by all figures: sizes, colours, and atomic writing."""

import io
from pathlib import Path

import numpy as np
from matplotlib import colormaps, rc_context, rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import TICKDOWN, TICKLEFT, MarkerStyle
from matplotlib.ticker import NullLocator

from transopt.base.files import whole_file
from transopt.base.shown import cut
from transopt.base.signals import FloatArray

DPI = 150
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
    with whole_file(path) as file:
        figure.savefig(file, format="png", dpi=DPI)


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


def draw_minor_ticks_at_once(figure: Figure) -> None:
    """Draw the minor ticks of every logarithmic axis as one line of markers, once all limits are final.

    Matplotlib draws each tick as three lines and two labels: the ticks of seven panels take longer than their data.
    An axis whose minor ticks have labels is unchanged.
    """
    found = []
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            places = np.asarray(axis.get_minorticklocs() if axis.get_scale() == "log" else [], dtype=float)
            low, high = sorted(axis.get_view_interval())
            places = places[(places >= low) & (places <= high)]
            if places.size and not any(axis.get_minor_formatter().format_ticks(places.tolist())):
                found.append((axes, axis, places))
    for _, axis, _ in found:  # only after all positions are known, since panels may share a locator
        axis.set_minor_locator(NullLocator())
    for axes, axis, places in found:
        on_edge = np.zeros(places.size)
        if axis is axes.xaxis:
            line = Line2D(places, on_edge, transform=axes.get_xaxis_transform(), marker=MarkerStyle(TICKDOWN))
            size, width, colour = rcParams["xtick.minor.size"], rcParams["xtick.minor.width"], rcParams["xtick.color"]
        else:
            line = Line2D(on_edge, places, transform=axes.get_yaxis_transform(), marker=MarkerStyle(TICKLEFT))
            size, width, colour = rcParams["ytick.minor.size"], rcParams["ytick.minor.width"], rcParams["ytick.color"]
        line.set(linestyle="", markersize=size, markeredgewidth=width, color=colour, clip_on=False)
        axes.add_artist(line)
