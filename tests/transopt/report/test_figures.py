"""Figures: the drawn data are the library's, in the units the axes say, and nothing is lost or clipped."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text

from tests.benches.libraries import resized
from transopt.base import axes as entries
from transopt.base.plotting import save_figure
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.design.batch import Baselines
from transopt.design.build import Build
from transopt.library.library import Library
from transopt.plant.chain import Link, chain
from transopt.plant.state_space import VOLTAGE_INPUT
from transopt.plant.time_grid import TimeGrid
from transopt.problem.answer import Status
from transopt.recordings.recording import Recording
from transopt.recordings.tap import PreparedTap, prepare
from transopt.report.figures import bode_figure, method_figure, taps_figure
from transopt.report.transients import Transients, library_figure, transients_figure
from transopt.scene.scene import Scene

LIMIT_A = 4.0


@pytest.fixture(scope="module")
def prepared(scene: Scene, taps: list[Recording]) -> list[PreparedTap]:
    return [prepare(tap, scene.recordings) for tap in taps]


def legend_texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def solid_curves(axes: Axes, size: int) -> list[Any]:
    return [line for line in axes.lines if line.get_linestyle() == "-" and len(line.get_xdata()) == size]


def shaded(axes: Axes) -> list[tuple[float, float]]:
    """Horizontal extents of the shaded spans [ms]."""
    spans = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    return [(span.get_x(), span.get_x() + span.get_width()) for span in spans]


def stripes(axes: Axes) -> list[str]:
    """The labels below the stripes of the methods."""
    return [label.get_text() for label in axes.child_axes[0].get_xticklabels()]


def assert_apart(labels: list[Text]) -> None:
    boxes = [label.get_window_extent() for label in labels]
    assert not any(a.overlaps(b) for a, b in pairwise(boxes))


def assert_nothing_clipped(figure: Figure) -> None:
    """Everything drawn lies on the paper, and the legend beside all axes."""
    figure.draw_without_rendering()
    drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert 0 <= drawn.x0 < drawn.x1 <= width
    assert 0 <= drawn.y0 < drawn.y1 <= height
    legend = figure.legends[0].get_window_extent()
    assert not any(axes.get_window_extent().padded(-1.0).overlaps(legend) for axes in figure.axes)


class TestLibrary:
    def test_the_name_in_the_corner_stands_below_the_label_of_a_narrow_figure(
        self, library: Library, tmp_path: Path
    ) -> None:
        figure = library_figure(resized(library, 2, 1))
        save_figure(figure, tmp_path / "transients.png", "wood_on_foam")
        (name,) = (text for text in figure.texts if text.get_text() == "wood_on_foam")
        (label,) = (text for text in figure.texts if text.get_text() == figure.get_supxlabel())
        assert name.get_window_extent().y1 < label.get_window_extent().y0
        assert_nothing_clipped(figure)

    def test_draws_the_arrays_in_g_ampere_and_ms(self, library: Library) -> None:
        figure = library_figure(library)
        grid = library.time_grid()
        panels, times_ms = figure.axes, 1e3 * np.append(grid.switching_times_s, grid.after_times_s)
        assert [axes.get_title() for axes in panels] == ["grip 1 N", "grip 3 N", "grip 5 N"] + [""] * 9
        assert (panels[0].get_ylabel(), panels[3].get_ylabel()) == ("acceleration [g]", "current [A]")
        speeds = [f"{speed:g} m/s" for speed in library.speeds_m_s]
        assert legend_texts(figure) == [*speeds, "reference", "limit 4 A", "limit binds", "waveform ends"]
        levels = [line.get_ydata()[0] for line in panels[3].lines if line.get_linestyle() == ":"]
        assert sorted(levels) == [-LIMIT_A, LIMIT_A]
        for ig in range(3):
            above, below = panels[ig], panels[3 + ig]
            predicted, current = solid_curves(above, times_ms.size), solid_curves(below, times_ms.size)
            references = [line for line in above.lines if line.get_linestyle() == "--"]
            assert len(predicted) == len(current) == len(references) == 4
            for iv in range(4):
                drawn, N = predicted[iv].get_ydata(), grid.stages
                np.testing.assert_allclose(drawn[:N], library.acceleration_m_s2[iv, ig] / G)
                wanted = np.append(library.target_m_s2[iv, ig], library.target_after_m_s2[iv, ig]) / G
                np.testing.assert_allclose(references[iv].get_ydata(), wanted)
                # The largest error after the waveform is what the file says.
                after = np.abs(drawn - wanted)[N:].max()
                assert after == pytest.approx(library.peak_after_m_s2[iv, ig] / G, rel=1e-6)
                np.testing.assert_array_equal(current[iv].get_ydata()[:N], library.plant_input[iv, ig])
                for line in (predicted[iv], references[iv], current[iv]):
                    np.testing.assert_allclose(line.get_xdata(), times_ms)

    def test_the_limit_is_shaded_where_it_binds_and_nowhere_else(self, library: Library) -> None:
        panels, times_ms = library_figure(library).axes, 1e3 * library.time_grid().switching_times_s
        bound = 0
        for ig in range(3):
            expected = []
            for iv in range(4):  # each waveform has a strip of its own
                at = np.flatnonzero(np.abs(library.plant_input[iv, ig]) > LIMIT_A * (1 - 1e-6))
                runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if at.size else []
                expected += [(times_ms[run[0]] - 0.05, times_ms[run[-1]] + 0.05) for run in runs]
            assert shaded(panels[3 + ig]) == [pytest.approx(span) for span in expected]
            assert shaded(panels[ig]) == []
            bound += len(expected)
        assert bound >= 2
        # At the limit without pushing against it, or pushed by rounding somewhere else, nothing binds.
        elsewhere = {name: np.roll(array, 200, axis=-1) for name, array in library.multipliers_of.items()}
        assert not any(shaded(axes) for axes in library_figure(replace(library, multipliers_of=elsewhere)).axes)

    def test_what_comes_after_the_tap_has_panels_of_its_own_and_no_axis_is_bent(self, library: Library) -> None:
        figure, grid = library_figure(library), library.time_grid()
        (left, parted), (from_, right) = figure.axes[0].get_xlim(), figure.axes[6].get_xlim()
        assert left < 1e3 * grid.switching_times_s[0]
        assert parted == pytest.approx(from_) == pytest.approx(15.0)
        assert right > 1e3 * grid.after_times_s[-1]
        said = figure.get_supxlabel()
        assert said == "time after contact [ms]\nnarrow panels: from 15 ms on; hand-over from 78.8 ms"
        assert {axes.get_xscale() for axes in figure.axes} == {"linear"}
        heights = [axes.get_ylim() for axes in figure.axes]
        assert heights == 2 * (3 * heights[:1] + 3 * heights[3:4])
        lasting = replace(library, target_m_s2=np.ones_like(library.target_m_s2))
        assert len(library_figure(lasting).axes) == 6

    def test_no_label_of_a_narrow_panel_lies_on_that_of_the_panel_before(self) -> None:
        grid = TimeGrid(dt_s=1e-4, stages=400, lead_s=0.005, delay_s=0.0)
        target = (grid.switching_times_s < 18e-3).astype(float)[None, None]
        places, idle = entries.Axes((0.0,), (0.0,), ("thud",)), np.zeros_like(target)
        figure = transients_figure(Transients(grid, places, VOLTAGE_INPUT, target, target, idle, 1.0, idle, 2))
        wide, narrow = figure.axes[0], figure.axes[2]
        ((_, parted), (from_, _)) = wide.get_xlim(), narrow.get_xlim()
        assert parted == pytest.approx(from_) == pytest.approx(wide.get_xticks()[-1])
        assert not np.isclose(narrow.get_xticks(), from_).any()

    @pytest.mark.parametrize(("speeds", "grips"), [(1, 1), (8, 6)])
    def test_any_size_fits_on_the_paper(self, library: Library, speeds: int, grips: int) -> None:
        assert_nothing_clipped(library_figure(resized(library, speeds, grips)))

    def test_speeds_differ_in_colour_and_in_grey(self, library: Library) -> None:
        lines = solid_curves(library_figure(resized(library, 8, 1)).axes[1], 1100)
        assert len({line.get_marker() for line in lines}) == 8
        luminance = [float(np.dot(line.get_color()[:3], [0.2126, 0.7152, 0.0722])) for line in lines]
        assert np.all(np.diff(luminance) > 0)
        assert max(luminance) < 0.75  # still seen on white paper

    def test_of_a_large_grid_some_nodes_are_drawn_and_the_axis_says_so(self, library: Library) -> None:
        large = resized(library, 20, 10)
        figure = library_figure(large)
        titles = [title for axes in figure.axes if (title := axes.get_title())]
        assert titles[:: len(titles) - 1] == ["grip 1 N", "grip 5 N"]
        assert len(titles) == 6
        curves = solid_curves(figure.axes[-1], 1100)
        assert len(curves) == 8
        np.testing.assert_array_equal(curves[0].get_ydata()[:800], large.plant_input[0, -1])
        np.testing.assert_array_equal(curves[-1].get_ydata()[:800], large.plant_input[-1, -1])
        assert "8 of 20 speeds, 6 of 10 grips" in figure.get_supxlabel()
        assert "speeds" not in library_figure(library).get_supxlabel()


def of_size(build: Build, speeds: int, grips: int) -> Build:
    """A build that has its first entry everywhere."""
    one, places = build.entries[0][0], 0.5 + np.arange(grips)
    rows = [[one.stating(speed_m_s=0.1 * (j + 1), grip_N=float(F)) for F in places] for j in range(speeds)]
    return replace(build, entries=rows)


def with_entry(build: Build, **changes: Any) -> Build:
    """A build whose first entry is another one."""
    first, *others = build.entries[0]
    return replace(build, entries=[[first.stating(**changes), *others], *build.entries[1:]])


class TestMethods:
    def test_every_method_is_drawn_in_percent(self, build: Build) -> None:
        figure = method_figure(build)
        axes, entries = figure.axes[0], list(build.all_entries())
        assert axes.get_ylabel() == "tap error after replay [%], log scale"
        assert axes.get_yscale() == "log"
        drawn = {str(line.get_label()): line.get_ydata() for line in axes.lines}
        wanted = {
            "optimum, 4 A": [e.figures.tap_error for e in entries],
            "floor (no limits)": [e.floor for e in entries],
            "seed inversion, 4 A": [e.baselines.seed.tap_error for e in entries],
            "seed inversion, 1.25 A": [e.baselines.seed_steady.tap_error for e in entries],
            "clipped optimum, 4 A": [e.baselines.clipped.tap_error for e in entries],
            "clipped optimum, 1.25 A": [e.baselines.clipped_steady.tap_error for e in entries],
        }
        assert legend_texts(figure) == [*wanted, "repeatability of the taps"] == [*drawn, legend_texts(figure)[-1]]
        for name, shares in wanted.items():
            np.testing.assert_allclose(drawn[name], 100 * np.asarray(shares), err_msg=name)
        labels = [label.get_text() for label in axes.get_xticklabels()]
        assert labels[::11] == ["1 N", "5 N"]
        assert stripes(axes) == ["0.1 m/s", "0.2 m/s", "0.3 m/s", "0.4 m/s"]

    def test_refused_entries_are_marked_and_what_is_unknown_is_left_out(self, build: Build) -> None:
        refused = method_figure(with_entry(build, status=Status.NOT_CERTIFIED))
        assert refused.axes[0].get_xticklabels()[0].get_text() == "1 N\nrefused"
        unknown = [[entry.stating(repeatability=float("nan")) for entry in row] for row in build.entries]
        figure = method_figure(replace(build, entries=unknown))
        assert "repeatability of the taps" not in legend_texts(figure)
        assert_nothing_clipped(figure)

    def test_zero_and_infinite_errors_do_not_break_the_axis(self, build: Build) -> None:
        entry = build.entries[0][0]
        none = replace(entry.figures, tap_error=0.0)
        played, endless = replace(entry.played, figures=none), replace(none, tap_error=float("inf"))
        infinite = Baselines(endless, none, endless, none)
        figure = method_figure(with_entry(build, played=played, floor=0.0, baselines=infinite))
        bottom, top = figure.axes[0].get_ylim()
        assert 0 < bottom < top < 1000
        assert figure.axes[0].lines[0].get_ydata()[0] == pytest.approx(bottom)
        assert_nothing_clipped(figure)

    def test_many_entries_have_one_label_for_each_speed(self, build: Build) -> None:
        axes = method_figure(of_size(build, 7, 10)).axes[0]
        assert [label.get_text() for label in axes.get_xticklabels()] == [f"{0.1 * i + 0.1:.3g}" for i in range(7)]
        np.testing.assert_allclose(axes.get_xticks(), 4.5 + 10 * np.arange(7))
        assert axes.get_xlabel() == "speed [m/s], grips 0.5 to 9.5 N in each stripe"

    @pytest.mark.parametrize(("speeds", "grips"), [(1, 1), (4, 3), (10, 6)])
    def test_any_number_of_entries_fits_on_the_paper(self, build: Build, speeds: int, grips: int) -> None:
        figure = method_figure(of_size(build, speeds, grips))
        assert_nothing_clipped(figure)
        assert_apart(figure.axes[0].get_xticklabels())

    def test_speeds_of_many_digits_do_not_collide(self, build: Build) -> None:
        """Labels stay apart at a single grip, whose stripes are as narrow as an entry, and at three."""
        for grips in (1, 3):
            long = [[e.stating(speed_m_s=e.speed_m_s + 0.0034) for e in row[:grips]] for row in build.entries]
            figure = method_figure(replace(build, entries=long))
            assert_nothing_clipped(figure)
            axes = figure.axes[0]
            assert stripes(axes)[0] == "0.1034 m/s"
            below = axes.child_axes[0].get_xticklabels()
            assert_apart(below)
            assert not any(
                a.get_window_extent().overlaps(b.get_window_extent()) for a in below for b in axes.get_xticklabels()
            )


def test_bode_figure_is_the_response_in_g_per_ampere_and_degrees(library: Library, scene: Scene) -> None:
    figure = bode_figure(library)
    magnitude, phase = figure.axes
    assert magnitude.get_ylabel() == "acceleration per current [g/A]"
    assert phase.get_ylabel() == "phase [deg]"
    assert phase.get_xlabel() == "frequency [Hz]"
    assert (magnitude.get_xscale(), magnitude.get_yscale(), phase.get_xscale()) == ("log", "log", "log")
    assert legend_texts(figure) == ["grip 1 N", "grip 3 N", "grip 5 N"]
    assert len({line.get_linestyle() for line in magnitude.lines}) == 3
    for size, angle, grip in zip(magnitude.lines, phase.lines, scene.grid.grips_N, strict=True):
        frequencies, degrees = np.asarray(size.get_xdata()), np.asarray(angle.get_ydata())
        assert frequencies[[0, -1]] == pytest.approx([1.0, 2000.0])
        expected = scene.plant(grip).response(frequencies)
        np.testing.assert_allclose(size.get_ydata(), np.abs(expected) / G, rtol=1e-9)
        np.testing.assert_allclose(np.exp(1j * np.radians(degrees)), expected / np.abs(expected), atol=1e-6)
    assert_nothing_clipped(figure)


def test_phase_does_not_wrap_behind_two_springs(library: Library) -> None:
    links = [Link(6e4, 1.0), Link(6e4, 1.0), Link(100.0, 4.0)]
    plant = chain([0.014, 0.014, 0.026], links, force_per_current_N_A=1.25, stylus=2)
    matrices = {f"plant_{name}": getattr(plant, name)[None] for name in ("A", "B", "C", "D", "Ce")}
    one = replace(library, grips_N=library.grips_N[:1], **matrices)
    degrees = np.asarray(bode_figure(one).axes[1].lines[0].get_ydata())
    assert np.abs(np.diff(degrees)).max() < 90
    assert 90 < degrees[0] <= 180
    assert -360 < degrees[-1] < -270


class TestTaps:
    def test_recordings_lie_over_each_other_from_slow_to_fast(self, prepared: list[PreparedTap]) -> None:
        chosen = [prepared[-1], prepared[0]]
        figure = taps_figure(chosen)
        axes = figure.axes[0]
        curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
        for line, tap in zip(curves, reversed(chosen), strict=True):
            np.testing.assert_allclose(line.get_xdata(), 1e3 * tap.acceleration.times_s)
            np.testing.assert_allclose(line.get_ydata(), tap.acceleration.values / G)
        assert legend_texts(figure) == [f"{tap.recording.name}, {tap.speed_m_s:.3g} m/s" for tap in chosen[::-1]]
        assert axes.get_ylabel() == "acceleration [g]"
        end_ms = 1e3 * max(tap.acceleration.end_s for tap in chosen)
        assert axes.get_xlabel().startswith("time after contact [ms], to ")
        assert axes.get_xlabel().endswith(f" of {end_ms:.0f} ms recorded")
        assert axes.lines[0].get_xdata() == [0.0, 0.0]  # the contact
        left, right = axes.get_xlim()
        assert left < 0 < right < end_ms

    def test_one_that_serves_every_speed_says_what_it_is_scaled_to(self, prepared: list[PreparedTap]) -> None:
        every = replace(prepared[0], speed_m_s=float("nan"))
        assert legend_texts(taps_figure([every]))[0].endswith(", scaled to 1 m/s")
