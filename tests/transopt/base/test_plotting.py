"""Figures as files: whole, or not written at all."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from transopt.base.errors import InputError
from transopt.base.plotting import save_figure


def test_a_saved_figure_is_a_png_at_150_dpi(tmp_path: Path) -> None:
    path = tmp_path / "bode.png"
    figure = Figure(figsize=(7.2, 5.0), layout="constrained")
    figure.subplots(2, 1)
    save_figure(figure, path)
    height, width = imread(path).shape[:2]
    assert (width, height) == tuple(np.round(150 * figure.get_size_inches()))
    assert [file.name for file in tmp_path.iterdir()] == ["bode.png"]


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
