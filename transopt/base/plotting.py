"""What all figures share: sizes, colours, and writing them whole."""

import io
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from transopt.base.files import whole_file
from transopt.base.signals import FloatArray

DPI = 150
LABEL_PT, SMALL_PT = 9.0, 8.0
OPTIMUM, SEED, CLIPPED = "#0072B2", "#D55E00", "#009E73"  # Okabe and Ito's blue, vermilion and green
DARK = "0.15"
VIRIDIS_RANGE = (0.12, 0.8)  # darker hides a reference drawn over it, lighter fades on white paper


class Drawing(Figure):
    """A figure that a notebook shows by itself.

    A notebook knows how to show figures of pyplot, and only once pyplot has been loaded, which nothing here does.
    """

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png", dpi=DPI)
        return file.getvalue()


def save_figure(figure: Figure, path: Path) -> None:
    """Write a PNG whole or not at all.

    Raises
    ------
    InputError : the file cannot be written.
    """
    figure.set_dpi(DPI)
    if (layout := figure.get_layout_engine()) is not None:
        # savefig would draw the figure a second time only to lay it out, so that is done here, once.
        layout.execute(figure)
        figure.set_layout_engine("none")
    with whole_file(path) as file:
        figure.savefig(file, format="png", dpi=DPI)


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
