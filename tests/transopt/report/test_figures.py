"""Figures: the drawn data are the library's, in the units the axes say, and nothing is lost or clipped."""

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from transopt.base.signals import STANDARD_GRAVITY_M_S2, Signal
from transopt.design.build import Build
from transopt.design.entry import Baselines, Entry
from transopt.library.figures import library_figure
from transopt.library.library import ARRAYS, Library
from transopt.plant.chain import Link, chain
from transopt.problem.answer import Status
from transopt.proof.replay import Replay
from transopt.recordings.recording import Recording
from transopt.recordings.tap import PreparedTap
from transopt.report.figures import bode_figure, method_figure, taps_figure

G = STANDARD_GRAVITY_M_S2
LIMIT_A = 4.0
FORCE_N_A, MASS_KG = 1.25, 0.04


def make_library(nv: int = 2, ng: int = 2, stages: int = 300, decay_s: float = 2e-3) -> Library:
    """A library of decaying oscillations that grow with speed; nothing in it is solved."""
    sizes = {"v": nv, "g": ng, "N": stages, "h": 10, "n": 2, "s": 0, "1": 1, "2": 2}
    arrays: dict[str, Any] = {
        name: np.full([sizes[letter] for letter in stated.shape], "" if stated.is_text else 0.0)
        for name, stated in ARRAYS.items()
    }
    arrays["speeds_m_s"] = 0.1 * np.arange(1, nv + 1)
    arrays["grips_N"] = 1.0 + 2.0 * np.arange(ng)
    t = 1e-4 * np.arange(stages)
    wave = np.exp(-t / decay_s) * np.cos(2 * np.pi * 200 * t)
    arrays["reference_m_s2"] = 300.0 * arrays["speeds_m_s"][:, None] * wave
    by_grip = 1.0 - 0.02 * np.arange(ng)
    arrays["acceleration_m_s2"] = arrays["reference_m_s2"][:, None] * by_grip[:, None]
    arrays["current_A"] = np.clip(arrays["acceleration_m_s2"] / 20.0, -LIMIT_A, LIMIT_A)
    for ig, grip in enumerate(arrays["grips_N"]):
        plant = chain([MASS_KG], [Link(100.0 * grip, 4.0)], force_per_current_N_A=FORCE_N_A, stylus=0)
        for matrix in ("A", "B", "C", "D", "Ce"):
            arrays[f"plant_{matrix}"][ig] = getattr(plant, matrix)
    amplifier = {"pole_Hz": 1050.0, "delay_s": 68e-6, "command_limit_A": 6.0}
    meta = {
        "dt_s": 1e-4,
        "lead_s": 3e-4,
        "amplifier": amplifier,
        "limits": {"current_A": LIMIT_A},
        "hand_over_samples": 10,
    }
    return Library.of(arrays, meta)


def make_entry(speed_m_s: float = 0.1, grip_N: float = 3.0, nrmse: float = 0.1, **changes: Any) -> Entry:
    nothing = cast(Any, None)
    empty = np.zeros(0)
    played = Replay(
        acceleration_m_s2=empty,
        current_A=empty,
        nrmse=nrmse,
        peak_current_A=0.0,
        peak_command_A=0.0,
        after_peak_m_s2=0.0,
        reached={},
        reached_while_stated={},
        winding_C=0.0,
        housing_C=0.0,
        command_A=empty,
        rounding_m_s2=0.0,
        step_error=0.0,
    )
    entry = Entry(
        speed_m_s=speed_m_s,
        grip_N=grip_N,
        problem=nothing,
        solution=nothing,
        certificate=nothing,
        played=played,
        predicted_m_s2=empty,
        current_A=empty,
        transient_command_A=empty,
        floor=0.004,
        free_peak_A=0.0,
        baselines=Baselines(seed=0.15, clipped=0.12, seed_steady=0.7, clipped_steady=0.6),
        repeatability=0.01,
        status=Status.OPTIMAL,
        shortfalls=[],
        binding="none",
        prices=[],
        left_out={},
        size=None,
        spread=None,
    )
    return replace(entry, **changes)


def make_build(entries: list[list[Entry]]) -> Build:
    scene = SimpleNamespace(
        limits=SimpleNamespace(steady_current_A=1.25, transient_current_A=LIMIT_A),
    )
    return Build(cast(Any, scene), [], entries, None, "riccati", 0.0)


def make_tap(name: str, speed_m_s: float, end_s: float = 0.07) -> PreparedTap:
    t = np.arange(-0.03, end_s, 1e-4)
    pulse = 100.0 * np.where(t < 0, 0.0, np.exp(-np.abs(t) / 3e-3) * np.sin(2 * np.pi * 120 * t))
    signal = Signal(-0.03, 1e-4, pulse)
    recording = Recording(name, "made here", "", signal)
    return PreparedTap(recording, signal, speed_m_s, "stated", 0.0, 1, 0.0, float(pulse.max()), 1.0, 0, ())


def legend_texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def solid_curves(axes: Axes, size: int) -> list[Any]:
    return [line for line in axes.lines if line.get_linestyle() == "-" and len(line.get_xdata()) == size]


def shaded(axes: Axes) -> list[tuple[float, float]]:
    """Horizontal extents of the shaded spans [ms]."""
    spans = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    return [(span.get_x(), span.get_x() + span.get_width()) for span in spans]


def assert_nothing_clipped(figure: Figure) -> None:
    """Everything drawn lies on the paper, and the legend beside all axes."""
    figure.draw_without_rendering()
    drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert 0 <= drawn.x0 < drawn.x1 <= width
    assert 0 <= drawn.y0 < drawn.y1 <= height
    legend = figure.legends[0].get_window_extent()
    assert not any(axes.get_window_extent().padded(-1.0).overlaps(legend) for axes in figure.axes)


# ---------------------------------------------------------------------------------------------------- library


def test_library_figure_draws_the_arrays_in_g_ampere_and_ms() -> None:
    library = make_library(nv=3, ng=2)
    figure = library_figure(library)
    panels = figure.axes
    assert len(panels) == 4
    times_ms = 1e3 * library.time_grid().switching_times_s
    for ig in range(2):
        above, below = panels[ig], panels[2 + ig]
        predicted, current = solid_curves(above, times_ms.size), solid_curves(below, times_ms.size)
        references = [line for line in above.lines if line.get_linestyle() == "--"]
        assert len(predicted) == len(current) == len(references) == 3
        for iv in range(3):
            np.testing.assert_allclose(predicted[iv].get_ydata(), library.acceleration_m_s2[iv, ig] / G)
            np.testing.assert_allclose(references[iv].get_ydata(), library.reference_m_s2[iv] / G)
            np.testing.assert_array_equal(current[iv].get_ydata(), library.current_A[iv, ig])
            for line in (predicted[iv], references[iv], current[iv]):
                np.testing.assert_allclose(line.get_xdata(), times_ms)


def test_library_figure_names_units_grips_speeds_and_limit() -> None:
    figure = library_figure(make_library())
    assert [axes.get_title() for axes in figure.axes[:2]] == ["grip 1 N", "grip 3 N"]
    assert figure.axes[0].get_ylabel() == "acceleration [g]"
    assert figure.axes[2].get_ylabel() == "current [A]"
    assert figure.get_supxlabel().startswith("time after contact [ms]")
    assert legend_texts(figure) == ["0.1 m/s", "0.2 m/s", "reference", "limit 4 A"]
    levels = [line.get_ydata()[0] for line in figure.axes[2].lines if line.get_linestyle() == ":"]
    assert sorted(levels) == [-LIMIT_A, LIMIT_A]


def test_the_free_device_is_named_so() -> None:
    library = replace(make_library(ng=1), grips_N=np.array([0.0]))
    assert library_figure(library).axes[0].get_title() == "free device"


def test_the_limit_is_shaded_where_it_binds_and_nowhere_else() -> None:
    library = make_library()
    library.current_A[1, 1, 20:31] = LIMIT_A
    library.multipliers_of["mu_current_upper"][1, 1, 20:31] = 1e-4
    library.current_A[0, 1, 28:41] = -LIMIT_A
    library.multipliers_of["mu_current_lower"][0, 1, 28:41] = 1e-4
    library.current_A[0, 0, 50] = LIMIT_A  # touches the limit without pushing against it
    library.multipliers_of["mu_current_upper"][0, 0, 60] = 1e-4  # a multiplier inside the limit is rounding
    figure = library_figure(library)
    times_ms = 1e3 * library.time_grid().switching_times_s
    for axes in (figure.axes[1], figure.axes[3]):
        np.testing.assert_allclose(shaded(axes), [(times_ms[20] - 0.05, times_ms[40] + 0.05)])
    assert shaded(figure.axes[0]) == shaded(figure.axes[2]) == []
    assert "limit binds" in legend_texts(figure)


def test_the_whole_horizon_is_shown_and_a_compressed_axis_says_so() -> None:
    library = make_library(stages=600)
    figure = library_figure(library)
    times_ms = 1e3 * library.time_grid().switching_times_s
    left, right = figure.axes[0].get_xlim()
    assert left < times_ms[0]
    assert right > times_ms[-1]
    assert "compressed" in figure.get_supxlabel()
    assert "hand-over from 58.8 ms" in figure.get_supxlabel()
    axis = figure.axes[0].xaxis.get_transform()
    on_paper = axis.transform(times_ms)
    assert np.all(np.diff(on_paper) > 0)
    np.testing.assert_allclose(axis.inverted().transform(on_paper), times_ms, atol=1e-9)


def test_a_reference_that_lasts_is_not_compressed() -> None:
    figure = library_figure(make_library(decay_s=1.0))
    assert "compressed" not in figure.get_supxlabel()


@pytest.mark.parametrize(("nv", "ng", "stages"), [(1, 1, 300), (8, 6, 300), (2, 3, 11), (1, 2, 2000)])
def test_any_size_of_library_fits_on_the_paper(nv: int, ng: int, stages: int) -> None:
    assert_nothing_clipped(library_figure(make_library(nv, ng, stages)))


def test_speeds_differ_in_colour_and_in_grey() -> None:
    lines = solid_curves(library_figure(make_library(nv=8, ng=1)).axes[1], 300)
    assert len({line.get_marker() for line in lines}) == 8
    luminance = [float(np.dot(line.get_color()[:3], [0.2126, 0.7152, 0.0722])) for line in lines]
    assert np.all(np.diff(luminance) > 0)
    assert max(luminance) < 0.75  # still seen on white paper


def test_of_a_large_grid_some_nodes_are_drawn_and_the_axis_says_so() -> None:
    library = make_library(nv=20, ng=10)
    figure = library_figure(library)
    columns = figure.axes[: len(figure.axes) // 2]
    assert [axes.get_title() for axes in columns][:: len(columns) - 1] == ["grip 1 N", "grip 19 N"]
    assert len(columns) == 6
    curves = solid_curves(figure.axes[-1], 300)
    assert len(curves) == 8
    np.testing.assert_array_equal(curves[0].get_ydata(), library.current_A[0, -1])
    np.testing.assert_array_equal(curves[-1].get_ydata(), library.current_A[-1, -1])
    assert "8 of 20 speeds, 6 of 10 grips" in figure.get_supxlabel()
    assert "speeds" not in library_figure(make_library(nv=8, ng=6)).get_supxlabel()


def test_a_zero_reference_can_be_drawn() -> None:
    library = make_library()
    zero = {name: 0 * getattr(library, name) for name in ("reference_m_s2", "acceleration_m_s2", "current_A")}
    assert_nothing_clipped(library_figure(replace(library, **zero)))


# ---------------------------------------------------------------------------------------------------- methods


def test_method_figure_draws_every_method_in_percent() -> None:
    entries = [[make_entry(v, g, nrmse=0.1 * v * g) for g in (1.0, 3.0)] for v in (0.3, 0.4)]
    figure = method_figure(make_build(entries))
    axes = figure.axes[0]
    assert axes.get_ylabel() == "NRMSE after replay [%]"
    assert axes.get_yscale() == "log"
    drawn = {str(line.get_label()): line.get_ydata() for line in axes.lines}
    np.testing.assert_allclose(drawn["optimum, 4 A"], [3.0, 9.0, 4.0, 12.0])
    np.testing.assert_allclose(drawn["floor (no limits)"], 0.4)
    np.testing.assert_allclose(drawn["seed inversion, 4 A"], 15.0)
    np.testing.assert_allclose(drawn["seed inversion, 1.25 A"], 70.0)
    np.testing.assert_allclose(drawn["clipped optimum, 4 A"], 12.0)
    np.testing.assert_allclose(drawn["clipped optimum, 1.25 A"], 60.0)
    np.testing.assert_allclose(drawn["amplitude threshold 20 %"], 20.0)
    assert legend_texts(figure) == [*drawn, "repeatability of the taps"]
    assert [label.get_text() for label in axes.get_xticklabels()] == [
        "0.3 m/s\n1 N",
        "0.3 m/s\n3 N",
        "0.4 m/s\n1 N",
        "0.4 m/s\n3 N",
    ]


def test_unknown_repeatability_is_left_out() -> None:
    figure = method_figure(make_build([[make_entry(repeatability=float("nan"))]]))
    assert "repeatability of the taps" not in legend_texts(figure)
    assert_nothing_clipped(figure)


def test_a_refused_entry_is_marked() -> None:
    figure = method_figure(make_build([[make_entry(status=Status.NOT_CERTIFIED)]]))
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["0.1 m/s\n3 N\nrefused"]


def test_zero_and_infinite_errors_do_not_break_the_axis() -> None:
    zero = make_entry(nrmse=0.0, floor=0.0, baselines=Baselines(float("inf"), 0.0, float("inf"), 0.0))
    figure = method_figure(make_build([[zero, make_entry()]]))
    bottom, top = figure.axes[0].get_ylim()
    optimum = figure.axes[0].lines[0].get_ydata()
    assert 0 < bottom < top < 1000
    np.testing.assert_allclose(optimum, [bottom, 10.0])
    assert_nothing_clipped(figure)


def test_many_entries_have_one_label_for_each_speed() -> None:
    figure = method_figure(make_build([[make_entry(0.1 * i + 0.1, j + 0.5) for j in range(10)] for i in range(7)]))
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == [f"{0.1 * i + 0.1:.3g}" for i in range(7)]
    np.testing.assert_allclose(axes.get_xticks(), 4.5 + 10 * np.arange(7))
    assert axes.get_xlabel() == "speed [m/s], grips 0.5 to 9.5 N in each stripe"


@pytest.mark.parametrize(("nv", "ng"), [(1, 1), (4, 3), (10, 6)])
def test_any_number_of_entries_fits_on_the_paper(nv: int, ng: int) -> None:
    figure = method_figure(make_build([[make_entry(0.1 * i + 0.1, j + 0.5) for j in range(ng)] for i in range(nv)]))
    assert_nothing_clipped(figure)
    boxes = [label.get_window_extent() for label in figure.axes[0].get_xticklabels()]
    assert not any(a.overlaps(b) for a, b in pairwise(boxes))


# ---------------------------------------------------------------------------------------------------- device


def test_bode_figure_is_the_analytic_response_in_g_per_ampere_and_degrees() -> None:
    library = make_library(ng=3)
    figure = bode_figure(library)
    magnitude, phase = figure.axes
    assert magnitude.get_ylabel() == "acceleration per current [g/A]"
    assert phase.get_ylabel() == "phase [deg]"
    assert phase.get_xlabel() == "frequency [Hz]"
    assert (magnitude.get_xscale(), magnitude.get_yscale(), phase.get_xscale()) == ("log", "log", "log")
    assert legend_texts(figure) == ["grip 1 N", "grip 3 N", "grip 5 N"]
    assert len({line.get_linestyle() for line in magnitude.lines}) == 3
    for size, angle, grip in zip(magnitude.lines, phase.lines, library.grips_N, strict=True):
        frequencies = np.asarray(size.get_xdata())
        assert frequencies[[0, -1]] == pytest.approx([1.0, 2000.0])
        s = 2j * np.pi * frequencies
        expected = FORCE_N_A * s**2 / (MASS_KG * s**2 + 4.0 * s + 100.0 * grip)
        np.testing.assert_allclose(size.get_ydata(), np.abs(expected) / G, rtol=1e-9)
        # One mass on a spring: from 180 deg down to 0, without a jump.
        np.testing.assert_allclose(angle.get_ydata(), np.degrees(np.angle(expected)), atol=1e-6)
    assert_nothing_clipped(figure)


def test_phase_does_not_wrap_behind_two_springs() -> None:
    library = make_library(ng=1)
    links = [Link(6e4, 1.0), Link(6e4, 1.0), Link(100.0, 4.0)]
    plant = chain([0.014, 0.014, 0.026], links, force_per_current_N_A=FORCE_N_A, stylus=2)
    matrices = {f"plant_{name}": getattr(plant, name)[None] for name in ("A", "B", "C", "D", "Ce")}
    degrees = np.asarray(bode_figure(replace(library, **matrices)).axes[1].lines[0].get_ydata())
    assert np.abs(np.diff(degrees)).max() < 90
    assert 90 < degrees[0] <= 180
    assert -360 < degrees[-1] < -270


# ---------------------------------------------------------------------------------------------------- recordings


def test_taps_figure_overlays_recordings_from_slow_to_fast() -> None:
    taps = [make_tap("fast", 0.4), make_tap("slow", 0.1, end_s=0.05)]
    figure = taps_figure(taps)
    axes = figure.axes[0]
    curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
    for line, tap in zip(curves, reversed(taps), strict=True):
        np.testing.assert_allclose(line.get_xdata(), 1e3 * tap.acceleration.times_s)
        np.testing.assert_allclose(line.get_ydata(), tap.acceleration.values / G)
    assert legend_texts(figure) == ["slow, 0.1 m/s", "fast, 0.4 m/s"]
    assert axes.get_ylabel() == "acceleration [g]"
    assert axes.get_xlabel().startswith("time after contact [ms], to ")
    assert axes.get_xlabel().endswith(" of 70 ms recorded")
    assert axes.lines[0].get_xdata() == [0.0, 0.0]  # the contact
    left, right = axes.get_xlim()
    assert left < 0 < right < 70


def test_a_tap_that_serves_every_speed_says_what_it_is_scaled_to() -> None:
    assert legend_texts(taps_figure([make_tap("drop", float("nan"))])) == ["drop, scaled to 1 m/s"]


@pytest.mark.parametrize("count", [1, 12, 70])
def test_any_number_of_taps_fits_on_the_paper(count: int) -> None:
    name = "a_folder_with_a_very_long_name_and_a_tap_on_oak.csv"
    assert_nothing_clipped(taps_figure([make_tap(name, 0.1 + 0.01 * j) for j in range(count)]))


def test_drawing_needs_neither_pyplot_nor_casadi() -> None:
    check = "import sys, transopt.report.figures; print({'matplotlib.pyplot', 'casadi'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
