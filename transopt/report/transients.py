"""The figure of transients: every waveform of a library, a build or one entry.

It uses matplotlib's object interface; pyplot is never imported, because it needs a window system and keeps a global
list of figures. Colours run through viridis, cut where it is too light for white paper; markers and line styles carry
the same information in grey print.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from transopt.base.axes import Axes
from transopt.base.plotting import DARK, LABEL_PT, SMALL_PT, Drawing, colours, leave_room, style
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.library.library import Library
from transopt.plant.state_space import Input
from transopt.plant.time_grid import TimeGrid
from transopt.problem.baselines import input_bounds
from transopt.problem.limits.limit import SIDES
from transopt.problem.limits.row import motor_row
from transopt.proof.certify import BINDING_MULTIPLIER, BINDING_SLACK

if TYPE_CHECKING:  # a library that draws itself does not load the designer
    from transopt.design.entry import Entry

MARKERS = "os^Dv<>P"
OTHER_MOTORS = ("--", ":")  # line styles of the motors after the first
BINDING = "0.5"
BINDING_STRIP = 0.022  # height of the strip that shows where a waveform's limit binds, as a share of the panel
DARKER = 0.55  # factor on the colour of a waveform for its reference
END: dict[str, Any] = {"color": "0.5", "linewidth": 0.9, "linestyle": "-."}  # marks the end of the waveform

MOST_SPEEDS, MOST_GRIPS = 8, 6  # the number of markers; more would not be legible

LEGEND_IN, LEGEND_ROW_IN = 0.1, 0.17  # height of a legend in SMALL_PT: margins, and each row
TITLE_IN = 0.27
NAME_IN = 0.2  # height of the line of the name that `save_figure` writes below a figure

QUIET = 0.1  # of the reference's peak: the panel of what follows begins once all references stay below it
PROMINENT = 0.7  # share of a column's width for the part before that
MUCH_LONGER = 1.5  # what follows gets a panel of its own if it would be that many times wider at one scale
MARGIN = 0.02  # share of a column's width beyond the data, so that jumps at its ends are visible
MARKED = 7  # number of markers on a line
TICK_STEPS = (1, 2, 5, 10)


def grip_label(grip_N: float) -> str:
    return "free device" if grip_N == 0 else f"grip {grip_N:g} N"


def legend_above(figure: Figure, handles: Sequence[Any], entry_in: float) -> float:
    """One legend above all axes in columns of `entry_in` inches, as many as fit; returns its height [in].

    A figure without a layout engine has to leave that height free.
    """
    rows = -(-len(handles) // max(int(figure.get_figwidth() / entry_in), 1))
    columns = -(-len(handles) // rows)
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, fontsize=SMALL_PT, frameon=False)
    return LEGEND_IN + LEGEND_ROW_IN * rows


def _ticks(intervals: int, start: float, end: float) -> FloatArray:
    """Round numbers that enclose start to end, in about `intervals` intervals."""
    return np.asarray(MaxNLocator(intervals, steps=TICK_STEPS).tick_values(start, end))


@dataclass(frozen=True)
class _Span:
    """A part of the time axis [ms], linear, with its share of a column's width."""

    start_ms: float
    end_ms: float
    share: float

    def spread(self, times_ms: FloatArray, phase: float) -> list[int]:
        """Indices of evenly spaced samples in the panel, the first at `phase` (0 to 1) of their distance."""
        count = max(round(MARKED * self.share), 1)
        wanted = self.start_ms + (np.arange(count) + phase) / count * (self.end_ms - self.start_ms)
        return [int(k) for k in np.unique(np.searchsorted(times_ms, wanted))]


def _time_spans(times_ms: FloatArray, end_ms: float, reference: FloatArray) -> list[_Span]:
    """Parts of the time axis for references (nv, N) at `times_ms` (N,): one, or the tap and what follows it."""
    size = np.abs(reference)
    loud = np.flatnonzero(np.any(size > QUIET * size.max(axis=1, keepdims=True), axis=0))
    last_ms = float(times_ms[loud[-1]]) if loud.size else end_ms
    ticks = _ticks(5, 0.0, max(last_ms, 0.0))
    quiet_ms, start_ms = float(ticks[ticks >= last_ms][0]), float(times_ms[0])
    if quiet_ms <= 0 or (end_ms - quiet_ms) / quiet_ms < MUCH_LONGER * (1 - PROMINENT) / PROMINENT:
        return [_Span(start_ms, end_ms, 1.0)]
    return [_Span(start_ms, quiet_ms, PROMINENT), _Span(quiet_ms, end_ms, 1 - PROMINENT)]


def _some(count: int, most: int) -> list[int]:
    """At most `most` of 0..count-1, evenly spaced, including the first and the last."""
    return [int(j) for j in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


@dataclass(frozen=True)
class Transients:
    """Data of the figure; NaN is not drawn.

    Attributes
    ----------
    axes : speeds and grips, or named targets.
    driven_by : the plant input, a current or a voltage.
    target_m_s2 : (nv, ng, N + M) target of y'' at the switching instants, in the window and after it.
    acceleration_m_s2, plant_input : (nv, ng, N + M) at these instants; with several directions (nv, ng, p, N + M),
        with several motors (nv, ng, m, N + M).
    limit : limit on the input. bounds : (m, 1) limit of each of several motors; None for a single motor.
    input_multiplier : (nv, ng, N), or (nv, ng, m, N), the larger multiplier of the limit's two sides.
    nonlinear : whether the commands are stationary points on a nonlinear plant.
    """

    grid: TimeGrid
    axes: Axes
    driven_by: Input
    target_m_s2: FloatArray
    acceleration_m_s2: FloatArray
    plant_input: FloatArray
    limit: float
    input_multiplier: FloatArray
    hand_over_samples: int
    nonlinear: bool = False
    bounds: FloatArray | None = None

    @property
    def has_several(self) -> bool:
        """Whether there are several motors."""
        return self.bounds is not None

    @property
    def limit_binds(self) -> NDArray[np.bool_]:
        """(nv, ng, N) whether the input limit of any motor binds, as in `certify.binding_limits`."""
        within = self.plant_input[..., : self.grid.stages]
        limit = self.limit if self.bounds is None else self.bounds
        at_limit = np.abs(np.abs(within) - limit) < BINDING_SLACK * limit
        binds = at_limit & (self.input_multiplier > BINDING_MULTIPLIER)
        return np.asarray(binds if self.bounds is None else binds.any(axis=2))

    def binding_spans_ms(self, iv: int, ig: int) -> list[tuple[float, float]]:
        """Intervals in which the limit binds for one entry."""
        active = self.limit_binds[iv, ig]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], active.astype(int), [0]])))
        start_ms, half_ms = self.grid.switching_times_s * 1e3, 0.5e3 * self.grid.dt_s
        return [
            (start_ms[first] - half_ms, start_ms[after - 1] + half_ms)
            for first, after in zip(edges[::2], edges[1::2], strict=True)
        ]


def library_figure(library: Library) -> Figure:
    """Figure of every waveform of a library, see `transients_figure`."""
    grid, (nv, ng) = library.time_grid(), library.command.shape[:2]
    acceleration, current = (
        np.append(each, np.full((*each.shape[:-1], grid.after_stages), np.nan), axis=-1)
        for each in (library.acceleration_m_s2, library.plant_input)
    )
    if grid.after_stages:  # what follows the window is not in the file, and is computed only for what is drawn
        for iv, ig in itertools.product(_some(nv, MOST_SPEEDS), _some(ng, MOST_GRIPS)):
            lasting = library.lasting(iv, ig)
            acceleration[iv, ig, ..., grid.stages :], current[iv, ig, ..., grid.stages :] = (
                x[..., grid.stages :] for x in lasting
            )
    return transients_figure(
        Transients(
            grid=grid,
            axes=library.axes,
            driven_by=library.driven_by,
            target_m_s2=_normal(
                np.append(library.target_m_s2 - library.correction_m_s2, library.target_after_m_s2, axis=-1)
            ),
            acceleration_m_s2=acceleration,
            plant_input=current,
            limit=library.input_limit,
            input_multiplier=_multiplier(library),
            hand_over_samples=library.hand_over_samples,
            nonlinear=library.nonlinear,
            bounds=input_bounds(library.problem(0, 0)) if library.command.ndim > 3 else None,
        )
    )


def _normal(courses: FloatArray) -> FloatArray:
    """(nv, ng, N) courses along the normal."""
    return courses if courses.ndim == 3 else courses[:, :, 0]


def _multiplier(library: Library) -> FloatArray:
    """The larger multiplier of the two sides of the input limit, for each motor."""
    name, (nv, ng, *motors, N) = library.driven_by.name, library.command.shape
    rows = [motor_row(name, j) for j in range(*motors)] if motors else [name]
    found = [np.maximum(*(library.array(f"mu_{row}_{side}") for side in SIDES)) for row in rows]
    return np.stack(found, axis=2).reshape(nv, ng, *motors, N)


def entries_figure(entries: Sequence[Sequence["Entry"]]) -> Figure:
    """Figure of entries (nv, ng), speeds outermost; a refused entry has no waveform and shows its reference only."""
    first = entries[0][0].problem
    several, rows = first.stage.motors > 1, first.limits.input.rows(first)

    def drawn(entry: "Entry") -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N + M,) acceleration and input, and (N,) multiplier of the input limit."""
        N, M = first.grid.stages, first.grid.after_stages
        if not entry.admitted:
            nothing, p = np.full((*first.rest.shape[:-1], N + M), np.nan), first.directions
            return np.full((*p, N + M), np.nan), nothing, np.zeros_like(first.rest)
        multipliers = entry.solution.multipliers
        pushed = np.stack([np.maximum(multipliers.lower(row.name), multipliers.upper(row.name)) for row in rows])
        lasting = entry.designed.effect.lasting
        return lasting.acceleration_m_s2, lasting.plant_input, pushed.reshape(first.rest.shape)

    cells = [[drawn(entry) for entry in row] for row in entries]
    acceleration, current, multiplier = (np.array([[cell[j] for cell in row] for row in cells]) for j in range(3))
    return transients_figure(
        Transients(
            grid=first.grid,
            axes=Axes(
                tuple(row[0].speed_m_s for row in entries),
                tuple(entry.grip_N for entry in entries[0]),
                tuple(row[0].target for row in entries if row[0].target),
                tuple(entry.spot for entry in entries[0] if entry.spot is not None),
            ),
            driven_by=first.driven_by,
            target_m_s2=np.array([[entry.uncorrected.normal.continued_m_s2 for entry in row] for row in entries]),
            acceleration_m_s2=acceleration,
            plant_input=current,
            limit=first.limits.input_limit,
            input_multiplier=multiplier,
            hand_over_samples=first.hand_over_samples,
            nonlinear=entries[0][0].designed.nonlinear is not None,
            bounds=input_bounds(first) if several else None,
        )
    )


def _panels(figure: Figure, columns: int, parts: Sequence[_Span]) -> NDArray[np.object_]:
    """(2, columns, parts) axes that share the scale in a row and the time in a part."""
    cells = figure.add_gridspec(2, columns, wspace=0.06, hspace=0.08)
    panels = np.full((2, columns, len(parts)), None, dtype=object)
    for at, row, column in np.ndindex(len(parts), 2, columns):
        cell = cells[row, column].subgridspec(1, len(parts), width_ratios=[part.share for part in parts], wspace=0.06)
        axes = figure.add_subplot(cell[at], sharex=panels[0, 0, at], sharey=panels[row, 0, 0])
        leftmost = column == 0 and at == 0
        axes.tick_params(left=at == 0, labelleft=leftmost, labelbottom=row == 1)
        panels[row, column, at] = axes
    return panels


def transients_figure(drawn: Transients) -> Figure:
    """Every waveform in the layout of the seed's Fig. 10.

    One column per grip. Above: the reference r (dashed) and the predicted acceleration (solid) [g]. Below: the input,
    a current or a voltage, with its limit. The whole horizon is shown, including the samples after the waveform,
    whose end a dash-dotted line marks. After the references have decayed, time continues in narrow panels of its own.
    For a large grid only some nodes are drawn, its edges among them, and the axis label says how many.
    """
    grid = drawn.grid
    times_ms = np.append(grid.switching_times_s, grid.after_times_s) * 1e3
    ends_ms = grid.end_s * 1e3
    end_ms = ends_ms + grid.after_stages * grid.dt_s * 1e3
    parts = _time_spans(times_ms, end_ms, drawn.target_m_s2.reshape(-1, times_ms.size))
    speeds, grips, named = drawn.axes.speeds_m_s, drawn.axes.grips_N, drawn.axes.targets
    shown_speeds, shown_grips = _some(len(speeds), MOST_SPEEDS), _some(len(grips), MOST_GRIPS)
    limit = drawn.limit
    hand_over_ms = (grid.issue_times_s[-drawn.hand_over_samples] + grid.delay_s) * 1e3
    shades = colours(len(shown_speeds))

    figure = Drawing(figsize=(max(1.0 + 2.1 * len(shown_grips), 4.4), 5.0))
    panels = _panels(figure, len(shown_grips), parts)
    binds = False
    for (column, ig), (at, part) in itertools.product(enumerate(shown_grips), enumerate(parts)):
        above, below = panels[:, column, at]
        for axes in (above, below):
            style(axes)
            axes.axhline(0.0, color="0.6", linewidth=0.6)
            if grid.after_stages:
                axes.axvline(ends_ms, **END)
        for line, iv in enumerate(shown_speeds):
            line_style: dict[str, Any] = {
                "label": named[iv] if named else f"{speeds[iv]:g} m/s",
                "color": shades[line],
                "marker": MARKERS[line % len(MARKERS)],
                "markersize": 3.5,
                "markevery": part.spread(times_ms, (line + 0.5) / len(shown_speeds)),
            }
            normal, *aside = np.atleast_2d(drawn.acceleration_m_s2[iv, ig]) / STANDARD_GRAVITY_M_S2
            above.plot(times_ms, normal, linewidth=2.0, **line_style)
            for across in aside:
                above.plot(times_ms, across, color=shades[line], linewidth=0.7)
            current, *others = np.atleast_2d(drawn.plant_input[iv, ig])
            below.plot(times_ms, current, linewidth=1.3, **line_style)
            for span in drawn.binding_spans_ms(iv, ig):
                # A strip along the lower edge for each waveform, in its colour, so that one sees whose limit binds.
                low, high = line * BINDING_STRIP, (line + 0.8) * BINDING_STRIP
                below.axvspan(*span, ymin=low, ymax=high, color=shades[line], linewidth=0)
                binds = True
            for j, motor in enumerate(others):
                below.plot(times_ms, motor, color=shades[line], linewidth=1.0, linestyle=OTHER_MOTORS[j % 2])
        for shade, target in zip(shades, drawn.target_m_s2[shown_speeds, ig], strict=True):
            dark = tuple(DARKER * each for each in to_rgb(shade))  # the colour says whose reference it is
            above.plot(times_ms, target / STANDARD_GRAVITY_M_S2, color=dark, linewidth=0.8, linestyle="--")
        for sign in (1, -1):
            below.axhline(sign * limit, color=DARK, linewidth=1.0, linestyle=":")
        if not named and at == 0:
            where = "\nnormal {:g}, posture {:g}".format(*drawn.axes.places[ig]) if drawn.axes.places else ""
            above.set_title(f"{grip_label(grips[ig])}{where}", fontsize=LABEL_PT, x=0.5 / part.share)
    for axes, part in zip(panels[0, 0], parts, strict=True):
        beyond_ms = MARGIN / part.share * (part.end_ms - part.start_ms)
        axes.set_xlim(part.start_ms - beyond_ms * (part is parts[0]), part.end_ms + beyond_ms * (part is parts[-1]))
        # A label at the beginning of a narrow panel would lie on that at the end of the panel before it.
        locator = MaxNLocator(
            max(round(6 * part.share), 3),
            steps=TICK_STEPS,
            min_n_ticks=1,
            prune=None if part is parts[0] else "lower",
        )
        axes.xaxis.set_major_locator(locator)
    for axes in panels[:, 0, 0]:
        axes.yaxis.set_major_locator(MaxNLocator(6, steps=TICK_STEPS))
    panels[0, 0, 0].set_ylabel("acceleration [g]", fontsize=LABEL_PT)
    panels[1, 0, 0].set_ylabel(f"{drawn.driven_by.name} [{drawn.driven_by.unit}]", fontsize=LABEL_PT)
    parted = f"narrow panels: from {parts[1].start_ms:g} ms on; " if len(parts) > 1 else ""
    whole = len(shown_speeds) == len(speeds) and len(shown_grips) == len(grips)
    rows_of = f"{len(shown_speeds)} of {len(speeds)} {'targets' if named else 'speeds'}"
    some = (
        ""
        if whole
        else f"; {rows_of}, {len(shown_grips)} of {len(grips)} {'grips and places' if drawn.axes.places else 'grips'}"
    )
    some += "\nthin: across the normal; second and third motor dashed and dotted" if drawn.has_several else ""
    some += "\nnonlinear plant: certified stationary points" if drawn.nonlinear else ""
    time, end = ("time", "command 0") if named else ("time after contact", "hand-over")
    label = f"{time} [ms]\n{parted}{end} from {hand_over_ms:.1f} ms{some}"
    # Above the line of the scene's name, which stands in the corner.
    figure.supxlabel(label, fontsize=LABEL_PT, y=NAME_IN / figure.get_size_inches()[1])

    handles = [
        *panels[1, 0, 0].get_legend_handles_labels()[0],
        Line2D([], [], color=DARK, linewidth=0.8, linestyle="--", label="reference"),
        Line2D([], [], color=DARK, linewidth=1.0, linestyle=":", label=f"limit {limit:g} {drawn.driven_by.unit}"),
        *([Patch(color=BINDING, label="limit binds")] if binds else []),
        *([Line2D([], [], label="waveform ends", **END)] if grid.after_stages else []),
    ]
    above_in = legend_above(figure, handles, entry_in=1.15) + (
        0.0 if named else TITLE_IN * (2 if drawn.axes.places else 1)
    )
    leave_room(
        figure,
        left_in=0.72,
        right_in=0.08,
        below_in=0.6 + NAME_IN + LEGEND_ROW_IN * (drawn.nonlinear or drawn.has_several),
        above_in=above_in,
    )
    return figure
