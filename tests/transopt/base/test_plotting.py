"""Figures as files: whole, or not written at all."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

from transopt.base.errors import InputError
from transopt.base.plotting import draw_ticks_at_once, leave_room, save_figure, style
from transopt.base.signals import FloatArray


def test_a_saved_figure_is_a_png_at_150_dpi(tmp_path: Path) -> None:
    path = tmp_path / "bode.png"
    figure = Figure(figsize=(7.2, 5.0), layout="constrained")
    figure.subplots(2, 1)
    save_figure(figure, path)
    height, width = imread(path).shape[:2]
    assert (width, height) == tuple(np.round(150 * figure.get_size_inches()))
    assert [file.name for file in tmp_path.iterdir()] == ["bode.png"]


def test_the_name_of_what_is_shown_stands_in_the_lower_left_corner_as_it_is(tmp_path: Path) -> None:
    pictures = []
    for name in ("", "$mine"):
        figure = Figure(figsize=(4, 3), layout="constrained")
        figure.subplots().set_xlabel("time [ms]")
        save_figure(figure, tmp_path / "figure.png", name)
        pictures.append(imread(tmp_path / "figure.png")[..., :3])
    rows, columns = np.nonzero(np.abs(pictures[1] - pictures[0]).max(axis=2))
    height, width = pictures[0].shape[:2]
    assert rows.size
    assert rows.min() > 0.9 * height
    assert columns.max() < 0.25 * width


def test_a_figure_with_a_layout_is_drawn_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = Figure(layout="constrained")
    (line,) = figure.subplots().plot([0.0, 1.0])
    drawn = []
    monkeypatch.setattr(line, "draw", drawn.append)
    save_figure(figure, tmp_path / "line.png")
    assert len(drawn) == 1


def test_margins_hold_whatever_a_users_matplotlibrc_lays_out(tmp_path: Path) -> None:
    with rc_context({"figure.constrained_layout.use": True}):
        figure = Figure(figsize=(4, 2))
        axes = figure.subplots()
        leave_room(figure, 1.0, 1.0, 0.5, 0.5)
        save_figure(figure, tmp_path / "figure.png")
    assert axes.get_position().bounds == pytest.approx((0.25, 0.25, 0.5, 0.5))


def test_a_failing_save_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "bode.png"
    path.write_bytes(b"old")

    def break_off(figure: Figure, file: Any, **options: Any) -> None:
        file.write(b"half a pic")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", break_off)
    with pytest.raises(InputError, match="No space left on device"):
        save_figure(Figure(), path)
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["bode.png"]


def logarithmic(decades: float) -> Figure:
    figure = Figure(figsize=(3, 2))
    axes = figure.add_subplot()
    axes.loglog([1.0, 10**decades], [1.0, 10**decades])
    axes.set(xlim=(1.0, 10**decades), ylim=(1.0, 10**decades))
    return figure


def panels() -> Figure:
    """Two rows of two panels that share their axes, labelled at the left and at the bottom only."""
    figure = Figure(figsize=(3, 2))
    for axes in figure.subplots(2, 2, sharex=True, sharey=True).flat:
        axes.plot([-1.0, 2.0], [3.0, -4.0])
        style(axes)
    return figure


def partly_hidden() -> Figure:
    """Two rows of panels, one panel without its axes and one without its horizontal axis."""
    figure = panels()
    figure.axes[1].set_axis_off()
    figure.axes[0].xaxis.set_visible(False)
    return figure


def without_ticks(figure: Figure) -> None:
    """Remove the ticks that have no labels."""
    for axes in figure.axes:
        axes.minorticks_off()
        for ticks in (axes.xaxis, axes.yaxis):
            if not ticks.get_major_ticks(1)[0].label1.get_visible():
                ticks.set_tick_params(bottom=False, left=False, gridOn=False)


def drawn(figure: Figure) -> FloatArray:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(float)


@pytest.mark.parametrize("made", [lambda: logarithmic(2.0), panels, partly_hidden], ids=["minor", "major", "hidden"])
def test_ticks_drawn_at_once_are_where_they_were(made: Callable[[], Figure]) -> None:
    at_once, without = made(), made()
    draw_ticks_at_once(at_once)
    without_ticks(without)
    one_by_one = drawn(made())
    missing = np.abs(drawn(without) - one_by_one).sum()
    assert missing > 0
    assert np.abs(drawn(at_once) - one_by_one).sum() < 0.02 * missing


def test_of_panels_that_share_an_axis_only_those_with_labels_keep_its_ticks() -> None:
    figure = panels()
    draw_ticks_at_once(figure)
    kept = [tuple(len(axis.get_majorticklocs()) > 0 for axis in (axes.xaxis, axes.yaxis)) for axes in figure.axes]
    assert kept == [(False, True), (False, False), (True, True), (True, False)]


def test_minor_ticks_with_labels_stay() -> None:
    figure = logarithmic(0.5)
    before = figure.axes[0].xaxis.get_minorticklocs()
    draw_ticks_at_once(figure)
    assert before.size
    np.testing.assert_allclose(figure.axes[0].xaxis.get_minorticklocs(), before)
