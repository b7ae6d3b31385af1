"""Figures as files: whole, or not written at all."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread

from transopt.base.plotting import save_figure


def test_a_saved_figure_is_a_png_at_150_dpi(tmp_path: Path) -> None:
    path = tmp_path / "bode.png"
    figure = Figure(figsize=(7.2, 5.0), layout="constrained")
    figure.subplots(2, 1)
    save_figure(figure, path)
    height, width = imread(path).shape[:2]
    assert (width, height) == tuple(np.round(150 * figure.get_size_inches()))
    assert [file.name for file in tmp_path.iterdir()] == ["bode.png"]
