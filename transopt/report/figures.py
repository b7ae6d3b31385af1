"""Figures of a build: methods, trade-offs, device, nonlinear plants, prepared recordings.

They use matplotlib's object interface; pyplot is never imported, because it needs a window system and keeps a global
list of figures. Colours run through viridis, cut where it is too light for white paper; markers and line styles carry
the same information in grey print.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from transopt.base.plotting import (
    CLIPPED,
    DARK,
    LABEL_PT,
    OPTIMUM,
    SEED,
    SMALL_PT,
    Drawing,
    colours,
    leave_room,
    plain,
    style,
)
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.base.writing import percent
from transopt.library.library import Library
from transopt.plant.state_space import StateSpace
from transopt.problem.limits.supply import SupplyLimit
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.bands import JUST_NOTICED_dB
from transopt.report.transients import QUIET, grip_label, legend_above

if TYPE_CHECKING:  # these load casadi and pydantic, which a figure of a library file does not need
    from transopt.design.build import Build
    from transopt.design.entry import Entry
    from transopt.design.trade_off import TradeOff
    from transopt.recordings.tap import PreparedTap

LINE_STYLES: tuple[Any, ...] = ("-", "--", "-.", (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5, 1, 1.5)), (0, (8, 2)))

MOST_LABELLED = 60  # most entries that are labelled one by one

BODE_HZ = (1.0, 2000.0)
BODE_POINTS = 500

LOWEST_dB, HIGHEST_dB = -12.0, 8.0  # range of the energy drawn; beyond it all paths look alike

MOST_TARGETS = 6  # most targets that one figure shows legibly
WANTED: dict[str, Any] = {"color": DARK, "linewidth": 2.2, "alpha": 0.35}
LINEAR: dict[str, Any] = {"color": CLIPPED, "linewidth": 1.0, "linestyle": "--"}
OWN: dict[str, Any] = {"color": OPTIMUM, "linewidth": 1.0}
BOUND: dict[str, Any] = {"color": DARK, "linewidth": 1.0, "linestyle": ":"}


# ---------------------------------------------------------------------------------------------------- methods


@dataclass(frozen=True)
class _Method:
    """One series of `method_figure`: how its tap error is read from an entry, and how it is drawn."""

    label: str
    value: Callable[["Entry"], float]
    offset: float
    marker: dict[str, Any]


def _methods(build: "Build") -> list[_Method]:
    limits = build.scene.limits
    unit = build.scene.driven_by.unit
    high, low = f"{limits.transient_input:g} {unit}", f"{limits.steady_input:g} {unit}"
    # A baseline that ignores supply rail or coil may lie below the optimum, which keeps them.
    more = any(
        {SupplyLimit.name, TemperatureLimit.name} & set(entry.slopes)
        for entry in build.all_entries()
        if entry.admitted
    )
    only = ", no other limit" if more else ""

    def dot(shape: str, colour: str, filled: bool) -> dict[str, Any]:
        # Hollow markers are larger, so that a filled one at the same place shows inside.
        face, size = (colour, 5.0) if filled else ("none", 7.5)
        return {"marker": shape, "markersize": size, "color": colour, "markerfacecolor": face}

    inversion = "frequency-domain inversion" if build.scene.targets else "seed inversion"
    # The nearest waveform with the energy of the tap may have a larger error than a weaker one.
    optimum = "intensity" if build.scene.weights.objective == "intensity" else "optimum"
    found = [
        _Method(f"{optimum}, {high}", lambda e: e.figures.tap_error, 0.0, dot("o", OPTIMUM, True)),
        _Method("floor (no limits)", lambda e: e.floor, 0.0, {"marker": "_", "markersize": 13, "color": "black"}),
        _Method(f"{inversion}, {high}", lambda e: e.baselines.seed.tap_error, -0.26, dot("s", SEED, True)),
        _Method(f"{inversion}, {low}", lambda e: e.baselines.seed_steady.tap_error, -0.26, dot("s", SEED, False)),
        _Method(
            f"clipped optimum, {high}{only}", lambda e: e.baselines.clipped.tap_error, 0.26, dot("^", CLIPPED, True)
        ),
        _Method(
            f"clipped optimum, {low}{only}",
            lambda e: e.baselines.clipped_steady.tap_error,
            0.26,
            dot("^", CLIPPED, False),
        ),
    ]
    # If the steady limit is the transient one, the baselines at both are the same.
    return [each for each in found if high != low or each.marker.get("markerfacecolor") != "none"]


def _error_of(build: "Build") -> str:
    """Name of the error that is drawn: a named target is no tap."""
    return "error" if build.scene.targets else "tap error"


def _refused(entry: "Entry") -> list[str]:
    return [] if entry.admitted else ["refused"]


def _label_entries(axes: Axes, build: "Build", optimum_percent: FloatArray) -> None:
    """Label each entry with its grip and each stripe with its speed; above, state the tap error of the optimum.

    If there are many, the labels are rotated, and each states speed and grip.
    """
    entries, positions = list(build.all_entries()), np.arange(optimum_percent.size)
    crowded = len(entries) > 20
    rotation = 90 if crowded else 0
    if crowded:
        labels = [", ".join([e.place, *_refused(e)]) for e in entries]
    elif build.scene.targets:
        labels = ["\n".join([*e.target.split(), *_refused(e)]) for e in entries]
    else:
        labels = ["\n".join([*e.device.split(", "), *_refused(e)]) for e in entries]
        below = axes.secondary_xaxis("bottom")
        below.set_xticks(_middles(build), [f"{group[0].speed_m_s:g} m/s" for group in build.entries])
        lines = 1 + max(label.count("\n") for label in labels)
        below.tick_params(length=0, pad=6 + 1.4 * lines * SMALL_PT, labelsize=SMALL_PT)
        below.spines["bottom"].set_visible(False)
    axes.set_xticks(positions, labels, rotation=rotation, fontsize=SMALL_PT)
    above = axes.secondary_xaxis("top")
    numbers = [f"{value:#.3g}".rstrip(".") for value in optimum_percent]
    above.set_xticks(positions, numbers, rotation=rotation, fontsize=SMALL_PT)
    above.tick_params(length=0)
    above.set_xlabel(f"{_error_of(build)} of the optimum [%]", fontsize=LABEL_PT)


def _middles(build: "Build") -> FloatArray:
    """(number of speeds,) middle of each speed's stripe, in entries."""
    sizes = np.array([len(group) for group in build.entries])
    return np.asarray(np.cumsum(sizes) - 0.5 - 0.5 * sizes)


def method_figure(build: "Build") -> Figure:
    """Tap error [%] of optimum, floor and baselines for every entry, with the repeatability of the taps.

    A value of zero (a zero reference) is drawn at the lower edge.
    """
    entries = list(build.all_entries())
    methods = _methods(build)
    percent = 100 * np.array([[method.value(entry) for entry in entries] for method in methods])
    repeatability = 100 * np.array([entry.repeatability for entry in entries])
    shown = np.concatenate([percent.ravel(), repeatability])
    shown = shown[np.isfinite(shown) & (shown > 0)]
    bottom, top = 0.7 * float(shown.min()), 1.5 * float(shown.max())

    figure = Figure(figsize=(float(np.clip(1.5 + 0.48 * len(entries), 5.0, 16.0)), 4.6), layout="constrained")
    axes = figure.subplots()
    style(axes)
    axes.grid(visible=False, axis="x")
    positions = np.arange(len(entries))
    first = 0
    for row, group in enumerate(build.entries):
        if row % 2:
            axes.axvspan(first - 0.5, first + len(group) - 0.5, color="0.95", linewidth=0)
        first += len(group)
    for j, (method, values) in enumerate(zip(methods, percent, strict=True)):
        # NaN and infinity are not drawn; zero has no place on a logarithmic axis and is drawn at its edge.
        x, y = positions + method.offset, np.maximum(values, bottom)
        axes.plot(x, y, linestyle="", zorder=9 - j, clip_on=False, label=method.label, **method.marker)
    left, right = positions - 0.45, positions + 0.45
    label = "_none" if np.all(np.isnan(repeatability)) else "repeatability of the taps"
    axes.hlines(repeatability, left, right, color="0.45", linewidth=1.2, linestyle=":", label=label)
    axes.set_yscale("log")
    axes.set_ylim(bottom, top)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0) if top < 1e4 * bottom else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(plain))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_ylabel(f"{_error_of(build)} after replay [%], log scale", fontsize=LABEL_PT)
    axes.set_xlim(-0.5, len(entries) - 0.5)
    if len(entries) > MOST_LABELLED:
        # One label for each speed.
        axes.set_xticks(_middles(build), [f"{group[0].speed_m_s:.3g}" for group in build.entries], fontsize=SMALL_PT)
        grips = [entry.grip_N for entry in build.entries[0]]
        stripes = f"speed [m/s], grips {grips[0]:g} to {grips[-1]:g} N in each stripe"
        axes.set_xlabel(f"{len(entries)} targets" if build.scene.targets else stripes, fontsize=LABEL_PT)
    else:
        _label_entries(axes, build, percent[0])

    handles, _ = axes.get_legend_handles_labels()
    legend_above(figure, handles, entry_in=1.8)
    return figure


# ---------------------------------------------------------------------------------------------------- device


def bode_figure(library: Library) -> Figure:
    """The device at every grip: magnitude [g/A] and phase [deg] of current to added acceleration, y''/i."""
    frequencies = np.geomspace(*BODE_HZ, BODE_POINTS)
    figure = Figure(figsize=(5.0, 4.6))
    magnitude, phase = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2), gridspec_kw={"hspace": 0.08})
    shades = colours(library.grips_N.size)
    for ig, grip in enumerate(library.grips_N):
        matrices = (library.plant_A, library.plant_B, library.plant_C, library.plant_D)
        response = StateSpace(*(m[ig] for m in matrices)).response(frequencies)
        degrees = np.degrees(np.unwrap(np.angle(response)))
        degrees -= 360 * np.floor((degrees[0] + 90) / 360)  # from 180 if a spring holds the stylus, from 0 if free
        dashes = LINE_STYLES[ig % len(LINE_STYLES)]
        drawn: dict[str, Any] = {"color": shades[ig], "linestyle": dashes, "linewidth": 1.4}
        magnitude.plot(
            frequencies,
            np.abs(response) / STANDARD_GRAVITY_M_S2,
            label="actuator" if library.axes.targets else grip_label(grip),
            **drawn,
        )
        phase.plot(frequencies, degrees, **drawn)
    for axes in (magnitude, phase):
        style(axes)
    magnitude.set_xscale("log")
    magnitude.set_yscale("log")
    for logarithmic in (magnitude.xaxis, magnitude.yaxis):  # drawing eight minor ticks per decade would take 0.1 s
        logarithmic.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        logarithmic.set_minor_formatter(NullFormatter())
    magnitude.yaxis.set_major_formatter(FuncFormatter(plain))
    drive = library.driven_by
    magnitude.set_ylabel(f"acceleration per {drive.name} [g/{drive.unit}]", fontsize=LABEL_PT)
    phase.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 1.8, 3, 4.5, 9, 10]))
    phase.set_ylabel("phase [deg]", fontsize=LABEL_PT)
    phase.set_xlim(*BODE_HZ)
    phase.xaxis.set_major_formatter(FuncFormatter(plain))
    phase.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    above_in = legend_above(figure, magnitude.get_lines(), entry_in=1.2)
    leave_room(figure, left_in=0.72, right_in=0.1, below_in=0.48, above_in=above_in)
    return figure


# ---------------------------------------------------------------------------------------------------- recordings


def _tap_label(tap: "PreparedTap") -> str:
    name = tap.recording.name
    name = name if len(name) <= 30 else f"{name[:14]}…{name[-15:]}"
    return f"{name}, scaled to 1 m/s" if np.isnan(tap.speed_m_s) else f"{name}, {tap.speed_m_s:.3g} m/s"


def taps_figure(taps: Sequence["PreparedTap"]) -> Figure:
    """Prepared recordings over each other, contact at 0, slow to fast: acceleration [g] over time [ms].

    The axis ends where all of them have decayed; its label says how much of the longest recording that is.

    Parameters
    ----------
    taps : at least one.
    """
    ordered = sorted(taps, key=lambda tap: tap.speed_m_s)
    columns = -(-len(ordered) // 30)
    figure = Figure(figsize=(4.6 + 2.6 * columns, max(3.6, 0.7 + 0.2 * len(ordered) / columns)), layout="constrained")
    axes = figure.subplots()
    style(axes)
    axes.axvline(0.0, color="0.4", linewidth=0.8)
    last_ms = 0.0
    for j, (tap, colour) in enumerate(zip(ordered, colours(len(ordered)), strict=True)):
        times_ms, values = tap.acceleration.times_s * 1e3, tap.acceleration.values / STANDARD_GRAVITY_M_S2
        dashes = LINE_STYLES[j % len(LINE_STYLES)]
        axes.plot(times_ms, values, color=colour, linewidth=1.1, linestyle=dashes, label=_tap_label(tap))
        loud = np.flatnonzero(np.abs(values) > 0.5 * QUIET * np.abs(values).max())
        last_ms = max(last_ms, float(times_ms[loud[-1]]))
    end_ms = max(tap.acceleration.end_s for tap in taps) * 1e3
    shown_ms = min(1.2 * last_ms, end_ms)
    axes.set_xlim(-0.1 * shown_ms, shown_ms)
    axes.set_xlabel(f"time after contact [ms], to {shown_ms:.0f} of {end_ms:.0f} ms recorded", fontsize=LABEL_PT)
    axes.set_ylabel("acceleration [g]", fontsize=LABEL_PT)
    figure.legend(loc="outside right upper", ncols=columns, fontsize=SMALL_PT, frameon=False)
    return figure


# --------------------------------------------------------------------------------------------- waveform and intensity


def trade_off_figure(build: "Build") -> Figure:
    """Tap error [%] over energy [dB], one line per entry; circles: nearest waveform, squares: intensity.

    Parameters
    ----------
    build : a build in which a limit binds in at least one entry.
    """
    found = build.trade_offs
    figure = Figure(figsize=(6.4, 4.6))
    axes = figure.subplots()
    style(axes)
    axes.axvspan(-JUST_NOTICED_dB, JUST_NOTICED_dB, color="0.93", linewidth=0)
    axes.axvline(0.0, color="0.6", linewidth=0.8)
    speeds = sorted({(each.speed_m_s, each.cells[0]) for each in found})
    grips = sorted({each.grip_N for each in found})
    shades = colours(len(speeds))
    dashes = ("-", "--", "-.", ":")
    lines = []
    for each in found:
        i, j = speeds.index((each.speed_m_s, each.cells[0])), grips.index(each.grip_N)
        dB, error = ([getattr(p, name) for p in each.path] for name in ("energy_dB", "tap_error"))
        drawn: dict[str, Any] = {"color": shades[i], "linewidth": 1.2}
        label = each.place
        (line,) = axes.plot(dB, 100 * np.array(error), linestyle=dashes[j % len(dashes)], label=label, **drawn)
        lines.append(line)
        for point, marker in ((each.waveform, "o"), (each.intensity, "s")):
            axes.plot([point.energy_dB], [100 * point.tap_error], marker=marker, markersize=5, linestyle="", **drawn)
    axes.set_xlim(*_shown(found))
    within = [100 * p.tap_error for each in found for p in each.path if p.energy_dB <= axes.get_xlim()[1]]
    axes.set_ylim(0.0, 1.08 * max(within))
    axes.set_xlabel("energy within the window over that of the recorded tap [dB]", fontsize=LABEL_PT)
    axes.set_ylabel("tap error as predicted [%]", fontsize=LABEL_PT)
    axes.text(
        0.01,
        0.98,
        f"circle: nearest waveform; square: intensity\nshaded: {JUST_NOTICED_dB:g} dB, just noticed",
        transform=axes.transAxes,
        fontsize=SMALL_PT,
        va="top",
    )
    leave_room(figure, left_in=0.62, right_in=0.1, below_in=0.48, above_in=legend_above(figure, lines, entry_in=1.6))
    return figure


def _shown(found: Sequence["TradeOff"]) -> tuple[float, float]:
    """Ends of the energy axis: all optima, and as much of the paths as leaves the optima distinguishable."""
    optima = [point.energy_dB for each in found for point in (each.waveform, each.intensity)]
    low, high = max(min(optima), LOWEST_dB), min(max(*optima, 0.0) + 4.0, max(HIGHEST_dB, *optima) + 1)
    return low - 0.3, high


# --------------------------------------------------------------------------------------------------- nonlinear plants


def nonlinear_figure(entries: Sequence["Entry"]) -> Figure:
    """Acceleration of both designs on the nonlinear plant, above their commands; one column per target.

    Parameters
    ----------
    entries : the first `MOST_TARGETS` are drawn.
    """
    shown = entries[:MOST_TARGETS]
    figure = Drawing(figsize=(max(1.0 + 2.6 * len(shown), 4.4), 5.0))
    rows = figure.subplots(2, len(shown), sharex="col", squeeze=False, gridspec_kw={"wspace": 0.28, "hspace": 0.08})
    for column, entry in enumerate(shown):
        above, below = rows[:, column]
        problem = entry.problem
        felt_ms, issued_ms = problem.grid.switching_times_s * 1e3, problem.grid.issue_times_s * 1e3
        above.plot(felt_ms, problem.reference_m_s2, **WANTED)
        if entry.linear_played is not None and entry.linear_command is not None:
            above.plot(felt_ms, entry.linear_played.acceleration_m_s2, **LINEAR)
            below.step(issued_ms, entry.linear_command, where="post", **LINEAR)
        above.plot(felt_ms, entry.played.acceleration_m_s2, **OWN)
        below.step(issued_ms, entry.solution.command, where="post", **OWN)
        for side in (-1, 1):
            below.axhline(side * problem.limits.input_limit, **BOUND)
        errors = f"linear {percent(entry.linear_tap_error)} %, nonlinear {percent(entry.figures.tap_error)} %"
        above.set_title(f"{entry.target}\n{errors}", fontsize=SMALL_PT)
        below.set_xlabel("time [ms]", fontsize=LABEL_PT)
        for axes in (above, below):
            style(axes)
    driven_by = shown[0].problem.driven_by
    rows[0, 0].set_ylabel("acceleration [m/s²]", fontsize=LABEL_PT)
    rows[1, 0].set_ylabel(f"{driven_by.name} [{driven_by.unit}]", fontsize=LABEL_PT)
    handles = [
        Line2D([], [], label="wanted", **WANTED),
        Line2D([], [], label="linear design", **LINEAR),
        Line2D([], [], label="nonlinear design", **OWN),
        Line2D([], [], label="limit", **BOUND),
    ]
    above_in = legend_above(figure, handles, entry_in=1.15) + 0.42
    leave_room(figure, left_in=0.72, right_in=0.12, below_in=0.5, above_in=above_in)
    return figure
