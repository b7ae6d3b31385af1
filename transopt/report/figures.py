"""Figures of a library, of a build and of prepared recordings, through matplotlib's object interface.

pyplot is never imported: no window system, no global list of figures. Colours run through viridis, cut before it
is too light for white paper; markers and line styles carry the same information into grey print.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.library.library import Library
from transopt.plant.chain import StateSpace
from transopt.problem.problem import AMPLITUDE_THRESHOLD, Status
from transopt.proof.certify import BINDING_MULTIPLIER, BINDING_SLACK

if TYPE_CHECKING:  # these import casadi and pydantic, which a figure of a library file needs not
    from transopt.design.build import Build
    from transopt.design.entry import Entry
    from transopt.recordings.tap import PreparedTap

MARKERS = "os^Dv<>P"
LINE_STYLES: tuple[Any, ...] = ("-", "--", "-.", (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5, 1, 1.5)), (0, (8, 2)))
VIRIDIS_RANGE = (0.12, 0.8)  # darker hides the reference drawn over it, lighter fades on white paper
BINDING = "0.86"

MOST_SPEEDS, MOST_GRIPS = 8, 6  # as there are markers; that one figure shows legibly
MOST_LABELLED = 60  # entries that have a label each

QUIET = 0.1  # of the reference's peak: the time axis is compressed once all references stay below it
PROMINENT = 0.7  # share of the time axis before that
TICK_STEPS = (1, 2, 5, 10)
BODE_HZ = (1.0, 2000.0)
BODE_POINTS = 500


def _colours(n: int) -> FloatArray:
    """(n, 4) colours from dark to light, for quantities that have an order."""
    return np.asarray(colormaps["viridis"](np.linspace(*VIRIDIS_RANGE, n) if n > 1 else [0.35]))


def _style(axes: Axes) -> None:
    axes.tick_params(labelsize=SMALL_PT)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def _plain(value: float, _: object = None) -> str:
    return f"{value:g}"


def _grip(grip_N: float) -> str:
    return "free device" if grip_N == 0 else f"grip {grip_N:g} N"


def _legend_above(figure: Figure, handles: Sequence[Any], entry_in: float) -> None:
    """One legend above all axes, in as many columns of `entry_in` inches as the figure has room for."""
    rows = -(-len(handles) // max(int(figure.get_figwidth() / entry_in), 1))
    columns = -(-len(handles) // rows)
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, fontsize=SMALL_PT, frameon=False)


# ---------------------------------------------------------------------------------------------------- time axis


def _ticks(intervals: int, start: float, end: float) -> FloatArray:
    """Round numbers that enclose start to end, in about so many intervals."""
    return np.asarray(MaxNLocator(intervals, steps=TICK_STEPS).tick_values(start, end))


@dataclass(frozen=True)
class _TimeAxis:
    """Time in ms, compressed `factor` times after `knee_ms` so that the whole horizon is in the figure."""

    start_ms: float
    knee_ms: float
    end_ms: float
    factor: float

    def forward(self, t_ms: FloatArray) -> FloatArray:
        late = np.asarray(t_ms) - self.knee_ms
        return self.knee_ms + np.where(late > 0, late / self.factor, late)

    def inverse(self, x: FloatArray) -> FloatArray:
        late = np.asarray(x) - self.knee_ms
        return self.knee_ms + np.where(late > 0, late * self.factor, late)

    @property
    def limits_ms(self) -> tuple[float, float]:
        """Where the axis begins and ends: a little outside the data, so that jumps at its ends are seen."""
        margin_ms = 0.03 * self.knee_ms
        return self.start_ms - margin_ms, self.end_ms + margin_ms * self.factor

    @property
    def ticks_ms(self) -> FloatArray:
        left, right = self.limits_ms
        early, late = _ticks(5, 0.0, self.knee_ms), _ticks(2, self.knee_ms, right)
        after_knee = self.knee_ms + 0.12 * self.knee_ms * self.factor  # leaves room for the label at the knee
        early, late = early[(early >= left) & (early <= self.knee_ms)], late[(late > after_knee) & (late <= right)]
        return np.concatenate([early, late])

    def spread(self, times_ms: FloatArray, count: int, phase: float) -> list[int]:
        """Indices of `count` samples evenly spaced on paper, the first at `phase` (0 to 1) of their distance."""
        x = self.forward(times_ms)
        wanted = x[0] + (np.arange(count) + phase) / count * (x[-1] - x[0])
        return [int(k) for k in np.unique(np.searchsorted(x, wanted))]


def _time_axis(times_ms: FloatArray, end_ms: float, reference: FloatArray) -> _TimeAxis:
    """The axis for references (nv, N) at `times_ms` (N,)."""
    size = np.abs(reference)
    loud = np.flatnonzero(np.any(size > QUIET * size.max(axis=1, keepdims=True), axis=0))
    last_ms = float(times_ms[loud[-1]]) if loud.size else end_ms
    ticks = _ticks(5, 0.0, max(last_ms, 0.0))
    knee_ms = float(ticks[ticks >= last_ms][0])
    factor = (end_ms - knee_ms) / knee_ms * PROMINENT / (1 - PROMINENT) if knee_ms > 0 else 1.0
    if factor <= 1.5:  # hardly shorter than it is
        return _TimeAxis(float(times_ms[0]), end_ms, end_ms, 1.0)
    return _TimeAxis(float(times_ms[0]), knee_ms, end_ms, factor)


# ---------------------------------------------------------------------------------------------------- library


def _some(count: int, most: int) -> list[int]:
    """At most so many of 0..count-1, evenly spread, the first and the last among them."""
    return [int(j) for j in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


def _binding_spans_ms(library: Library, ig: int) -> list[tuple[float, float]]:
    """When the current limit binds at a grip, for at least one speed, as in `certify.binding_limits`."""
    limit = library.meta["limits"]["current_A"]
    at_limit = np.abs(np.abs(library.current_A[:, ig]) - limit) < BINDING_SLACK * limit
    mu = np.maximum(library.mu_current_lower[:, ig], library.mu_current_upper[:, ig])
    active = np.any(at_limit & (mu > BINDING_MULTIPLIER), axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], active.astype(int), [0]])))
    grid = library.time_grid()
    start_ms, half_ms = grid.switching_times_s * 1e3, 0.5e3 * grid.dt_s
    return [
        (start_ms[first] - half_ms, start_ms[after - 1] + half_ms)
        for first, after in zip(edges[::2], edges[1::2], strict=True)
    ]


def library_figure(library: Library) -> Figure:
    """Every waveform of a library in the layout of the seed's Fig. 10.

    One column per grip; above, the reference r (dashed) and the predicted acceleration (solid) [g], below, the
    current [A] with its limit. The whole horizon is shown; where the references have died away the time axis is
    compressed, and says so. Of a large grid some nodes are drawn, its edges among them; the axis says of how many.
    """
    grid = library.time_grid()
    times_ms, end_ms = grid.switching_times_s * 1e3, grid.end_s * 1e3
    axis = _time_axis(times_ms, end_ms, library.reference_m_s2)
    speeds, grips = library.speeds_m_s, library.grips_N
    shown_speeds, shown_grips = _some(speeds.size, MOST_SPEEDS), _some(grips.size, MOST_GRIPS)
    limit = library.meta["limits"]["current_A"]
    hand_over_ms = (grid.issue_times_s[-library.meta["hand_over_samples"]] + grid.delay_s) * 1e3
    colours = _colours(len(shown_speeds))

    figure = Figure(figsize=(max(1.0 + 2.1 * len(shown_grips), 4.4), 5.0), layout="constrained")
    rows = figure.subplots(2, len(shown_grips), sharex=True, sharey="row", squeeze=False)
    binds = False
    for column, ig in enumerate(shown_grips):
        above, below = rows[:, column]
        spans = _binding_spans_ms(library, ig)
        binds = binds or bool(spans)
        for axes in (above, below):
            _style(axes)
            axes.axhline(0.0, color="0.6", linewidth=0.6)
            if axis.factor > 1:
                axes.axvline(axis.knee_ms, color="0.6", linewidth=0.8)
            for span in spans:
                axes.axvspan(*span, color=BINDING, linewidth=0)
        for line, iv in enumerate(shown_speeds):
            style: dict[str, Any] = {
                "label": f"{speeds[iv]:g} m/s",
                "color": colours[line],
                "marker": MARKERS[line % len(MARKERS)],
                "markersize": 3.5,
                "markevery": axis.spread(times_ms, 7, (line + 0.5) / len(shown_speeds)),
            }
            above.plot(times_ms, library.acceleration_m_s2[iv, ig] / STANDARD_GRAVITY_M_S2, linewidth=2.0, **style)
            below.plot(times_ms, library.current_A[iv, ig], linewidth=1.3, **style)
        for reference in library.reference_m_s2[shown_speeds]:
            above.plot(times_ms, reference / STANDARD_GRAVITY_M_S2, color=DARK, linewidth=0.8, linestyle="--")
        for sign in (1, -1):
            below.axhline(sign * limit, color=DARK, linewidth=1.0, linestyle=":")
        above.set_title(_grip(grips[ig]), fontsize=LABEL_PT)
    rows[0, 0].set_xscale("function", functions=(axis.forward, axis.inverse))
    rows[0, 0].set_xlim(*axis.limits_ms)
    rows[0, 0].set_xticks(axis.ticks_ms, [_plain(tick) for tick in axis.ticks_ms])
    for axes in rows[:, 0]:
        axes.yaxis.set_major_locator(MaxNLocator(6, steps=TICK_STEPS))
    rows[0, 0].set_ylabel("acceleration [g]", fontsize=LABEL_PT)
    rows[1, 0].set_ylabel("current [A]", fontsize=LABEL_PT)
    squeezed = f"compressed {axis.factor:.1f} times after {axis.knee_ms:g} ms, " if axis.factor > 1 else ""
    whole = len(shown_speeds) == speeds.size and len(shown_grips) == grips.size
    some = "" if whole else f"; {len(shown_speeds)} of {speeds.size} speeds, {len(shown_grips)} of {grips.size} grips"
    label = f"time after contact [ms]\n{squeezed}hand-over from {hand_over_ms:.1f} ms{some}"
    figure.supxlabel(label, fontsize=LABEL_PT)

    handles = [
        *rows[1, 0].get_legend_handles_labels()[0],
        Line2D([], [], color=DARK, linewidth=0.8, linestyle="--", label="reference"),
        Line2D([], [], color=DARK, linewidth=1.0, linestyle=":", label=f"limit {limit:g} A"),
        *([Patch(color=BINDING, label="limit binds")] if binds else []),
    ]
    _legend_above(figure, handles, entry_in=1.15)
    return figure


# ---------------------------------------------------------------------------------------------------- methods


@dataclass(frozen=True)
class _Method:
    """One series of `method_figure`: where its NRMSE is found and how it is drawn."""

    label: str
    value: Callable[["Entry"], float]
    offset: float
    marker: dict[str, Any]


def _methods(build: "Build") -> list[_Method]:
    limits = build.scene.limits
    high, low = f"{build.scene.current_limits().current_A:g} A", f"{limits.steady_current_A:g} A"
    # A rival that heeds neither rail nor coil may lie below the optimum, which does.
    more = any({"supply", "coil"} & {price.limit for price in entry.prices} for entry in build.all_entries())
    only = ", no other limit" if more else ""

    def dot(shape: str, colour: str, filled: bool) -> dict[str, Any]:
        # Hollow ones are larger, so that a filled one at the same place shows inside.
        face, size = (colour, 5.0) if filled else ("none", 7.5)
        return {"marker": shape, "markersize": size, "color": colour, "markerfacecolor": face}

    return [
        _Method(f"optimum, {high}", lambda e: e.nrmse, 0.0, dot("o", OPTIMUM, True)),
        _Method("floor (no limits)", lambda e: e.floor, 0.0, {"marker": "_", "markersize": 13, "color": "black"}),
        _Method(f"seed inversion, {high}", lambda e: e.baselines.seed, -0.26, dot("s", SEED, True)),
        _Method(f"seed inversion, {low}", lambda e: e.baselines.seed_steady, -0.26, dot("s", SEED, False)),
        _Method(f"clipped optimum, {high}{only}", lambda e: e.baselines.clipped, 0.26, dot("^", CLIPPED, True)),
        _Method(
            f"clipped optimum, {low}{only}", lambda e: e.baselines.clipped_steady, 0.26, dot("^", CLIPPED, False)
        ),
    ]


def _entry_label(entry: "Entry", separator: str) -> str:
    refused = [] if entry.status is Status.OPTIMAL else ["refused"]
    return separator.join([f"{entry.speed_m_s:g} m/s", f"{entry.grip_N:g} N", *refused])


def method_figure(build: "Build") -> Figure:
    """NRMSE [%] of the optimum, its floor and its rivals for every entry, with the marks that tell if it matters.

    A value of zero (a zero reference) stands at the lower edge.
    """
    entries = list(build.all_entries())
    methods = _methods(build)
    percent = 100 * np.array([[method.value(entry) for entry in entries] for method in methods])
    repeatability = 100 * np.array([entry.repeatability for entry in entries])
    shown = np.concatenate([percent.ravel(), repeatability, [100 * AMPLITUDE_THRESHOLD]])
    shown = shown[np.isfinite(shown) & (shown > 0)]
    bottom, top = 0.7 * float(shown.min()), 1.5 * float(shown.max())

    crowded = len(entries) > 20
    figure = Figure(figsize=(float(np.clip(1.5 + 0.48 * len(entries), 5.0, 16.0)), 4.6), layout="constrained")
    axes = figure.subplots()
    _style(axes)
    axes.grid(visible=False, axis="x")
    positions = np.arange(len(entries))
    first = 0
    for row, group in enumerate(build.entries):
        if row % 2:
            axes.axvspan(first - 0.5, first + len(group) - 0.5, color="0.95", linewidth=0)
        first += len(group)
    for j, (method, values) in enumerate(zip(methods, percent, strict=True)):
        # NaN and infinity stay away; zero cannot be on a logarithmic axis and is put on its edge.
        x, y = positions + method.offset, np.maximum(values, bottom)
        axes.plot(x, y, linestyle="", zorder=9 - j, clip_on=False, label=method.label, **method.marker)
    label = f"amplitude threshold {100 * AMPLITUDE_THRESHOLD:g} %"
    axes.axhline(100 * AMPLITUDE_THRESHOLD, color=DARK, linewidth=1.0, linestyle="--", label=label)
    left, right = positions - 0.45, positions + 0.45
    label = "_none" if np.all(np.isnan(repeatability)) else "repeatability of the taps"
    axes.hlines(repeatability, left, right, color="0.45", linewidth=1.2, linestyle=":", label=label)
    axes.set_yscale("log")
    axes.set_ylim(bottom, top)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0) if top < 1e4 * bottom else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(_plain))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_ylabel("NRMSE after replay [%]", fontsize=LABEL_PT)
    axes.set_xlim(-0.5, len(entries) - 0.5)
    if len(entries) > MOST_LABELLED:
        # One label for each speed, and what stands in its stripe.
        middles = np.cumsum([len(group) for group in build.entries]) - 0.5 - 0.5 * len(build.entries[0])
        axes.set_xticks(middles, [f"{group[0].speed_m_s:.3g}" for group in build.entries], fontsize=SMALL_PT)
        grips = [entry.grip_N for entry in build.entries[0]]
        axes.set_xlabel(f"speed [m/s], grips {grips[0]:g} to {grips[-1]:g} N in each stripe", fontsize=LABEL_PT)
    else:
        rotation = 90 if crowded else 0
        labels = [_entry_label(entry, ", " if crowded else "\n") for entry in entries]
        axes.set_xticks(positions, labels, rotation=rotation, fontsize=SMALL_PT)
        above = axes.secondary_xaxis("top")
        numbers = [f"{value:#.3g}".rstrip(".") for value in percent[0]]
        above.set_xticks(positions, numbers, rotation=rotation, fontsize=SMALL_PT)
        above.tick_params(length=0)
        above.set_xlabel("NRMSE of the optimum [%]", fontsize=LABEL_PT)

    handles, _ = axes.get_legend_handles_labels()
    _legend_above(figure, handles, entry_in=1.8)
    return figure


# ---------------------------------------------------------------------------------------------------- device


def bode_figure(library: Library) -> Figure:
    """The device at every grip: magnitude [g/A] and phase [deg] of current to added acceleration, y''/i."""
    frequencies = np.geomspace(*BODE_HZ, BODE_POINTS)
    figure = Figure(figsize=(5.0, 4.6), layout="constrained")
    magnitude, phase = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    colours = _colours(library.grips_N.size)
    for ig, grip in enumerate(library.grips_N):
        matrices = (library.plant_A, library.plant_B, library.plant_C, library.plant_D, library.plant_Ce)
        response = StateSpace(*(m[ig] for m in matrices)).response(frequencies)
        degrees = np.degrees(np.unwrap(np.angle(response)))
        degrees -= 360 * np.floor((degrees[0] + 90) / 360)  # from 180 where a spring holds the stylus, from 0 if free
        dashes = LINE_STYLES[ig % len(LINE_STYLES)]
        style: dict[str, Any] = {"color": colours[ig], "linestyle": dashes, "linewidth": 1.4}
        magnitude.plot(frequencies, np.abs(response) / STANDARD_GRAVITY_M_S2, label=_grip(grip), **style)
        phase.plot(frequencies, degrees, **style)
    for axes in (magnitude, phase):
        _style(axes)
    magnitude.set_xscale("log")
    magnitude.set_yscale("log")
    for logarithmic in (magnitude.xaxis, magnitude.yaxis):  # drawing eight minor ticks a decade takes 0.1 s
        logarithmic.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        logarithmic.set_minor_formatter(NullFormatter())
    magnitude.yaxis.set_major_formatter(FuncFormatter(_plain))
    magnitude.set_ylabel("acceleration per current [g/A]", fontsize=LABEL_PT)
    phase.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 1.8, 3, 4.5, 9, 10]))
    phase.set_ylabel("phase [deg]", fontsize=LABEL_PT)
    phase.set_xlim(*BODE_HZ)
    phase.xaxis.set_major_formatter(FuncFormatter(_plain))
    phase.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    _legend_above(figure, magnitude.get_lines(), entry_in=1.2)
    return figure


# ---------------------------------------------------------------------------------------------------- recordings


def _tap_label(tap: "PreparedTap") -> str:
    name = tap.recording.name
    name = name if len(name) <= 30 else f"{name[:14]}…{name[-15:]}"
    return f"{name}, scaled to 1 m/s" if np.isnan(tap.speed_m_s) else f"{name}, {tap.speed_m_s:.3g} m/s"


def taps_figure(taps: Sequence["PreparedTap"]) -> Figure:
    """Prepared recordings over each other, contact at 0, slow to fast: acceleration [g] over time [ms].

    The figure ends where all of them have died away; the axis says how much of the longest that is.

    Parameters
    ----------
    taps : at least one.
    """
    ordered = sorted(taps, key=lambda tap: tap.speed_m_s)
    columns = -(-len(ordered) // 30)
    figure = Figure(figsize=(4.6 + 2.6 * columns, max(3.6, 0.7 + 0.2 * len(ordered) / columns)), layout="constrained")
    axes = figure.subplots()
    _style(axes)
    axes.axvline(0.0, color="0.4", linewidth=0.8)
    last_ms = 0.0
    for j, (tap, colour) in enumerate(zip(ordered, _colours(len(ordered)), strict=True)):
        times_ms, values = tap.acceleration.times_s * 1e3, tap.acceleration.values / STANDARD_GRAVITY_M_S2
        style = LINE_STYLES[j % len(LINE_STYLES)]
        axes.plot(times_ms, values, color=colour, linewidth=1.1, linestyle=style, label=_tap_label(tap))
        loud = np.flatnonzero(np.abs(values) > 0.5 * QUIET * np.abs(values).max())
        last_ms = max(last_ms, float(times_ms[loud[-1]]))
    end_ms = max(tap.acceleration.end_s for tap in taps) * 1e3
    shown_ms = min(1.2 * last_ms, end_ms)
    axes.set_xlim(-0.1 * shown_ms, shown_ms)
    axes.set_xlabel(f"time after contact [ms], to {shown_ms:.0f} of {end_ms:.0f} ms recorded", fontsize=LABEL_PT)
    axes.set_ylabel("acceleration [g]", fontsize=LABEL_PT)
    figure.legend(loc="outside right upper", ncols=columns, fontsize=SMALL_PT, frameon=False)
    return figure
