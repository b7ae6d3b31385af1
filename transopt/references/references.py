"""All references of a scene: one cell per recorded speed and grip, and blends between them.

A tap differs from hand to hand, so recordings of different grips are never averaged: each grip is a cell. Speeds and
grips that were not recorded are blended: linearly in grip, as commands are, and in speed by the shape r / v. Outside
the recorded grips the nearest one is used. Taps that state no grip are used for every grip.
"""

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.plant.time_grid import TimeGrid
from transopt.recordings.recording import Recording
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import PreparedTap, check_usable, prepare_all
from transopt.references.reference import Free, Reference, TimeAxis, build_reference

ALIKE = 0.05  # relative difference of grips that the hysteresis of a grip sensor cannot resolve
ROUNDING = 1e-9  # relative difference up to which a grip or speed is a recorded one
COST = "a 3 N tap as target raises the felt error at 0.2 m/s from 3.6 to 13.0 % at 1 N, from 4.1 to 11.9 % at 5 N"
# The target's courses in `Cells`, in the order of time.
TARGETS = ("target_before_m_s2", "target_m_s2", "target_after_m_s2")
Scaled = tuple[PreparedTap, float]  # a tap and the factor that scales it to a grid speed


@dataclass(frozen=True)
class Cells:
    """References of a grid as views into common arrays of their courses.

    Attributes
    ----------
    rows : speeds or named targets outermost, grips within.
    courses : name in `COURSES` and `TARGETS` -> (rows, grips, samples), or (rows, grips, directions, samples).
    """

    rows: list[list[Reference]]
    courses: dict[str, FloatArray]

    @classmethod
    def of(cls, columns: Iterable[Sequence[Reference]], grips: int) -> "Cells":
        """Copy references into common arrays, grip by grip, so that those of one grip are in memory twice at most."""
        cells, resting = list[list[Reference]](), list[tuple[int, int]]()
        for j, column in enumerate(columns):
            if not cells:
                first, target = column[0], column[0].target
                cells = [[] for _ in column]
                stacked = np.zeros((len(column), grips, first.stacked.size))
                asked = np.empty((len(column), grips, *target.whole_m_s2.shape))
                count = asked.shape[-1]  # of samples of r, and of a_free after them
            for i, cell in enumerate(column):
                # Memory of zeros that is never written to is not allocated.
                ends = (count, 2 * count) if cell.aims_at_recorded else (0, 0)
                for part in (slice(ends[0]), slice(ends[1], None)):
                    stacked[i, j, part] = cell.stacked[part]
                if cell.aims_at_recorded:
                    resting.append((i, j))
                moved = cell.with_courses(stacked[i, j])
                vars(moved)["target"] = moved.aimed(asked[i, j])
                cells[i].append(moved)
        if len(resting) == len(cells) * grips:
            asked, resting = stacked[..., :count], []
        for i, j in resting:
            asked[i, j] = cells[i][j].target.whole_m_s2
        parts = np.split(asked, [target.lost, target.lost + first.recorded_m_s2.shape[-1]], axis=-1)
        courses = {
            name: stacked[..., part].reshape(*stacked.shape[:2], *shape)
            for name, (part, shape) in first.within_stacked.items()
        }
        return cls(cells, courses | dict(zip(TARGETS, parts, strict=True)))


@dataclass(frozen=True)
class References:
    """References of one scene, iterable cell by cell.

    Attributes
    ----------
    cells : one per recorded speed and grip, speeds outermost and both increasing; or one per named target.
    notes : what a user should know about how they were made, one sentence each.
    axis : makes the motions without current of hands at other grips than the cells'; None if the cells' are blended.
    """

    cells: tuple[Reference, ...] = ()
    notes: tuple[str, ...] = ()
    axis: TimeAxis | None = None

    __repr__ = brief

    def __iter__(self) -> Iterator[Reference]:
        return iter(self.cells)

    def __len__(self) -> int:
        return len(self.cells)

    @cached_property
    def _rows(self) -> dict[float, list[Reference]]:
        """Speed -> its cells, grips increasing."""
        rows: dict[float, list[Reference]] = {}
        for cell in self.cells:
            rows.setdefault(cell.speed_m_s, []).append(cell)
        return rows

    @property
    def speeds_m_s(self) -> tuple[float, ...]:
        """Recorded speeds, increasing."""
        return tuple(self._rows)

    @property
    def grips_N(self) -> tuple[float, ...]:
        """Grips of all cells, increasing."""
        return tuple(sorted({cell.grip_N for cell in self.cells if not cell.name}))

    def named(self, name: str) -> Reference:
        """The reference of a named target.

        Raises
        ------
        InputError : there is no target of that name.
        """
        found = next((cell for cell in self.cells if cell.name == name), None)
        if found is None:
            raise InputError(f"{name}: no target of this scene: {', '.join(c.name for c in self.cells) or 'none'}")
        return found

    def at(self, speed_m_s: float, grip_N: float) -> Reference:
        """The reference at any speed within the recorded range and at any grip; a recorded cell is returned itself.

        Between recorded speeds v1 < v < v2 the shape r / v is interpolated, with w = (v - v1) / (v2 - v1):

            r = v ((1 - w) r_1 / v_1 + w r_2 / v_2)

        Near a recorded speed this is the scaling by v / v1 of a tap near a grid speed (`assign`). All courses follow
        the rule, which keeps dz_nom/dt = -v at contact and d2z_nom/dt2 = a_free. At one speed r is linear in grip;
        outside the grips recorded at that speed it is that of the nearest one. a_free is the hand's at the grip.
        The result lists the scaled taps of all cells it is made from; its repeatability is the largest of theirs.

        Raises
        ------
        InputError : the speed is outside the recorded range.
        """
        speeds = self.speeds_m_s
        if not (speeds and speeds[0] <= speed_m_s <= speeds[-1]):
            known = f"from {speeds[0]:g} to {speeds[-1]:g} m/s only" if speeds else "for no speed"
            raise InputError(f"speed {speed_m_s:g} m/s: references are known {known}: record taps at that speed")
        nearest = _nearest(speeds, speed_m_s)
        if abs(nearest - speed_m_s) <= ROUNDING * nearest:
            return self._of_recorded(nearest, grip_N)
        j = bisect_left(speeds, speed_m_s)
        slow, fast = (self._of_recorded(v, grip_N) for v in speeds[j - 1 : j + 1])
        w = (speed_m_s - slow.speed_m_s) / (fast.speed_m_s - slow.speed_m_s)
        scales = (speed_m_s / slow.speed_m_s, speed_m_s / fast.speed_m_s)
        of = tuple(sorted({*slow.of_grips_N, *fast.of_grips_N}))
        between = (slow.speed_m_s, fast.speed_m_s)
        return _blend(slow, fast, w, scales, speed_m_s=speed_m_s, between_m_s=between, of_grips_N=of, grip_N=grip_N)

    def of_grip(self, grip_N: float) -> "References":
        """References at the recorded speeds and one grip, of which `at` makes those of any number of speeds."""
        return replace(self, cells=tuple(self._of_recorded(speed, grip_N) for speed in self._rows))

    def _of_recorded(self, speed_m_s: float, grip_N: float) -> Reference:
        """The reference of a recorded speed at any grip."""
        row = self._rows[speed_m_s]
        grips = [cell.grip_N for cell in row]
        nearest = row[grips.index(_nearest(grips, grip_N))]
        if abs(nearest.grip_N - grip_N) <= ROUNDING * grip_N:
            return nearest
        if not grips[0] < grip_N < grips[-1]:
            return self._held(replace(nearest, grip_N=grip_N), nearest.incoming_acceleration_m_s2)
        j = bisect_left(grips, grip_N)
        low, high = row[j - 1], row[j]
        w = (grip_N - low.grip_N) / (high.grip_N - low.grip_N)
        found = _blend(low, high, w, grip_N=grip_N, of_grips_N=(*low.of_grips_N, *high.of_grips_N))
        return self._held(found, (1 - w) * low.incoming_acceleration_m_s2 + w * high.incoming_acceleration_m_s2)

    def _held(self, found: Reference, incoming_m_s2: float) -> Reference:
        """A reference with the motion without current of the hand at its grip, which yields unlike one at another."""
        if self.axis is None or found.aims_at_recorded:  # a hand that goes straight on does so at any grip
            return found
        recorded = found.stacked[: found.within_stacked["free_before_m_s2"][0].start]
        moved = self.axis.motion(found.speed_m_s, found.grip_N, incoming_m_s2)
        return found.with_courses(np.concatenate([recorded, moved]))

    def remarks(self, grips_N: Sequence[float]) -> list[str]:
        """Parts of a design at these grips that rest on taps of other grips, one sentence each; `notes` included."""
        held = [F for F in grips_N if F > 0]  # nobody holds a free device, whatever the grip of its recordings
        speeds: dict[str, list[float]] = {}  # sentence -> speeds it holds for
        for speed, row in self._rows.items():
            known = [grip for cell in row for grip in cell.of_grips_N]
            beyond = [F for F in held if known and not _within(F, known)]
            blended = [F for F in held if known and _within(F, known) and not _among(F, known)]
            if beyond:
                words = f"{_listed(beyond)} N: taps of {_listed(known)} N only, that of the nearest grip serves"
                speeds.setdefault(words, []).append(speed)
            if blended:
                words = f"{_listed(blended)} N: blended from the taps of {_listed(known)} N"
                speeds.setdefault(words, []).append(speed)
        found = [*self.notes, *(f"{_listed(which)} m/s, {words}" for words, which in speeds.items())]
        if missing_s := max(cell.missing_s for cell in self.cells):
            cells = [cell for cell in self.cells if cell.missing_s > 0]
            found.append(
                f"{_listed(sorted({cell.speed_m_s for cell in cells}))} m/s: recordings end up to "
                f"{math.ceil(1e4 * missing_s) / 10:g} ms before the time after the waveform does; from there on the "
                "recorded acceleration counts as zero: record longer, or lower weights.after_s by as much"
            )
        if len(grips_N) > 1 and any(not cell.of_grips_N and not cell.name for cell in self.cells):
            found.append(f"the taps state no grip and serve every grip; state it (`# grip_N: 3`): {COST}")
        return found


def _listed(values: Sequence[float]) -> str:
    *others, last = (f"{value:g}" for value in values)
    return f"{', '.join(others)} and {last}" if others else last


def _among(grip_N: float, grips_N: Sequence[float]) -> bool:
    """Whether a grip equals one of these within a sensor's accuracy."""
    return any(abs(grip_N - each) <= ALIKE * each for each in grips_N)


def _within(grip_N: float, grips_N: Sequence[float]) -> bool:
    return min(grips_N) <= grip_N <= max(grips_N) or _among(grip_N, grips_N)


def _nearest(values: Sequence[float], value: float) -> float:
    """The nearest of increasing values, the smaller of two that are equally near."""
    above = bisect_left(values, value)
    return min(values[max(above - 1, 0) : above + 1], key=lambda each: abs(each - value))


def _blend(
    a: Reference, b: Reference, w: float, scales: tuple[float, float] = (1.0, 1.0), **others: Any
) -> Reference:
    """(1 - w) of one reference and w of another, each scaled to the blend's speed, and `others` of its fields."""
    scale_a, scale_b = scales
    return a.with_courses(
        (1 - w) * scale_a * a.stacked + w * scale_b * b.stacked,
        repeatability=_larger(a.repeatability, b.repeatability),
        repeatability_unaligned=_larger(a.repeatability_unaligned, b.repeatability_unaligned),
        taps=a.taps + b.taps,
        factors=np.concatenate([scale_a * a.factors, scale_b * b.factors]),
        missing_s=max(a.missing_s, b.missing_s),
        slow_part_known=a.slow_part_known and b.slow_part_known,
        **others,
    )


def _larger(a: float, b: float) -> float:
    """The larger number; NaN if one is."""
    return b if a < b or math.isnan(b) else a


def assign(taps: Sequence[PreparedTap], speeds_m_s: Sequence[float], settings: Recordings) -> list[list[Scaled]]:
    """The taps of each grid speed, each with the factor that scales it to that speed.

    A tap belongs to the nearest grid speed, which must be within `speed_tolerance`; taps that serve every grid speed
    belong to all.

    Raises
    ------
    InputError : a tap has no known speed or implausible units (`check_usable`), or is too far from every grid speed;
        a grid speed has no tap; some taps state a grip and others do not.
    """
    silent = [tap.recording.name for tap in taps if tap.recording.grip_N is None]
    if silent and len(silent) < len(taps):
        stated = next(tap.recording for tap in taps if tap.recording.grip_N is not None)
        raise InputError(
            f"{silent[0]}: states no grip, as {len(silent)} of {len(taps)} taps, while {stated.name} is of "
            f"{stated.grip_N:g} N: state it in the file (`# grip_N: 3`) or by recordings.grip_N, or leave it out"
        )
    nodes = np.asarray(speeds_m_s, dtype=float)
    groups: list[list[Scaled]] = [[] for _ in nodes]
    for tap in taps:
        check_usable(tap, settings)
        if np.isnan(tap.speed_m_s):
            for group, node in zip(groups, nodes, strict=True):
                group.append((tap, float(node)))
            continue
        distance = np.abs(nodes / tap.speed_m_s - 1)
        nearest = int(np.argmin(distance))
        if distance[nearest] > settings.speed_tolerance:
            raise InputError(
                f"{tap.recording.name}: speed {tap.speed_m_s:.4g} m/s is {distance[nearest]:.0%} from the nearest "
                f"grid speed {nodes[nearest]:g} m/s, limit {settings.speed_tolerance:.0%}: "
                "add a grid speed or leave the file out"
            )
        groups[nearest].append((tap, float(nodes[nearest] / tap.speed_m_s)))
    for group, node in zip(groups, nodes, strict=True):
        if not group:
            raise InputError(
                f"grid.speeds_m_s: no recording within {settings.speed_tolerance:.0%} of {node:g} m/s: "
                "record taps at that speed or take it off the grid"
            )
    return groups


def grip_groups(grips_N: Sequence[float]) -> list[list[float]]:
    """Sorted grips in groups within 5 % of the group's smallest grip."""
    groups: list[list[float]] = []
    for grip in sorted(grips_N):
        if groups and grip <= groups[-1][0] * (1 + ALIKE):
            groups[-1].append(grip)
        else:
            groups.append([grip])
    return groups


def _as_stated(grip_N: float, grips_N: Sequence[float]) -> float:
    """A recorded grip as the scene states it, or else as `transopt taps` writes it: to three digits."""
    written = f"{grip_N:.3g}"
    nearest = min(grips_N, key=lambda stated: abs(stated - grip_N), default=grip_N)
    return nearest if f"{nearest:.3g}" == written else float(written)


@one_blas_thread()
def build_references(
    recordings: Sequence[Recording],
    speeds_m_s: Sequence[float],
    grips_N: Sequence[float],
    grid: TimeGrid,
    settings: Recordings,
    free: Free,
) -> References:
    """References from all recordings of a scene: one cell per grid speed and recorded grip.

    Parameters
    ----------
    grips_N : grips of the scene; taps that state no grip get a cell for each of them, and taps of one of them serve
        that grip unblended.
    free : motion of the hand of a recording without current.

    Raises
    ------
    InputError : see `prepare`, `assign` and `build_reference`.
    """
    taps = prepare_all(recordings, settings)
    axis, cells, notes = TimeAxis(grid, free), list[Reference](), list[str]()
    grips = [tap.recording.grip_N for tap in taps if tap.recording.grip_N is not None]
    grouped = [(alike, _as_stated(float(np.mean(alike)), grips_N)) for alike in grip_groups(grips)]
    for speed, group in zip(speeds_m_s, assign(taps, speeds_m_s, settings), strict=True):
        if not grouped:
            of, factors = zip(*group, strict=True)
            cells += [build_reference(speed, grip, of, np.array(factors), axis) for grip in grips_N]
        for alike, mean in grouped:
            own = [(tap, factor) for tap, factor in group if tap.recording.grip_N in alike]
            if own:
                of, factors = zip(*own, strict=True)
                cells.append(build_reference(speed, mean, of, np.array(factors), axis, (mean,)))
                if alike[-1] > alike[0]:
                    notes += [f"taps of {alike[0]:.4g} to {alike[-1]:.4g} N are taken as of one grip, {mean:.4g} N"]
    return References(tuple(cells), tuple(dict.fromkeys(notes)), axis)


def sampled_again(references: References, grid: TimeGrid, free: Free) -> References:
    """References from the same taps on another time axis.

    Raises
    ------
    InputError : a recording does not cover the time axis, or is not available.
    """
    for cell in references:
        if not cell.taps:
            raise InputError(
                f"{cell.in_words}: its recordings are not at hand, so it is not sampled on another time axis: open "
                "the scene with them"
            )
    axis = TimeAxis(grid, free)
    cells = (build_reference(c.speed_m_s, c.grip_N, c.taps, c.factors, axis, c.of_grips_N) for c in references)
    return replace(references, cells=tuple(cells), axis=axis)
