"""The plan of a constraint study: its points, the rows of their entries, the tasks that solve them."""

import hashlib
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.stats import qmc

from transopt.base.axes import Axes
from transopt.base.errors import InputError
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.study.axes import Axis, label
from transopt.study.recordings import StudyRecordings
from transopt.study.tasks import Item, Task

TOGETHER = 32  # entries per task, which share one pass through solver and replay
MOST_POINTS = 10_000_000
# Tables that determine device, time axis or recordings. Points that differ in one of them share less work.
HEAVY = ("model", "motor", "transmission", "tip", "amplifier", "time", "recordings", "targets", "feedback")


@dataclass(frozen=True)
class Plan:
    """Everything that defines the rows of a study.

    Attributes
    ----------
    scene : states everything that is not varied.
    axes : the varied keys with their values.
    speeds_m_s : speeds of the entries of every point [m/s], within the scene's recorded ones; zeros for targets.
    grips_N : grips of the entries of every point [N].
    sample : number of points of a Latin hypercube; None for all combinations of the axes' values.
    seed : seed of the Latin hypercube.
    rivals : whether baselines and prices of the limits are computed too.
    options : options of the solver.

    Raises
    ------
    InputError : a key is varied twice or stated by another one; a speed was not recorded; the scene refuses a grip;
        or the number of points is outside 1 to `MOST_POINTS`.
    """

    scene: Scene
    axes: tuple[Axis, ...]
    speeds_m_s: tuple[float, ...]
    grips_N: tuple[float, ...]
    sample: int | None = None
    seed: int = 1
    rivals: bool = False
    options: SolverOptions = field(default_factory=SolverOptions)

    def __post_init__(self) -> None:
        names = [axis.key for axis in self.axes]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"--vary {name}: stands there twice; give all its values at once")
        rivals = {"limits.current_A", "limits.beta"}
        if rivals <= set(names):
            raise InputError("--vary limits.beta: limits.current_A states the same limit: vary one of the two")
        recorded = self.scene.grid.speeds_m_s
        for speed in self.speeds_m_s if recorded else ():
            if not recorded[0] <= speed <= recorded[-1]:
                raise InputError(
                    f"--speed {speed:g}: must be between {recorded[0]:g} and {recorded[-1]:g} m/s, "
                    "the recorded speeds of the scene"
                )
        with_values(self.scene, {"grid.grips_N": list(self.grips_N)})
        if not 1 <= self.points <= MOST_POINTS:
            raise InputError(f"{self.points} points: must be at least 1 and at most {MOST_POINTS}")

    @property
    def entry_axes(self) -> Axes:
        """The axes of every point's entries."""
        return Axes(self.speeds_m_s, self.grips_N, self.scene.axes.targets)

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def points(self) -> int:
        return math.prod(self.shape) if self.sample is None else self.sample

    @property
    def entries_per_point(self) -> int:
        return len(self.speeds_m_s) * len(self.grips_N)

    @property
    def entries(self) -> int:
        return self.points * self.entries_per_point

    @cached_property
    def _draws(self) -> Any:
        """(sample, axes) uniform in 0..1, one in each of `sample` equal slices along every axis."""
        hypercube = qmc.LatinHypercube(len(self.axes), rng=np.random.default_rng(self.seed))
        return hypercube.random(self.sample or 0)

    def place(self, point: int) -> tuple[int, ...]:
        """Index of a point along every axis; only for all combinations."""
        return tuple(int(j) for j in np.unravel_index(point, self.shape)) if self.axes else ()

    def changes(self, point: int) -> dict[str, Any]:
        """The keys of a point with their values."""
        if self.sample is None:
            return {axis.key: axis.values[j] for axis, j in zip(self.axes, self.place(point), strict=True)}
        return {axis.key: _drawn(axis, float(u)) for axis, u in zip(self.axes, self._draws[point], strict=True)}

    def labels(self, point: int) -> dict[str, str]:
        """The keys of a point with the labels of their values."""
        if self.sample is None:
            return {axis.key: axis.labels[j] for axis, j in zip(self.axes, self.place(point), strict=True)}
        found = self.changes(point)
        return {
            axis.key: axis.labels[axis.values.index(found[axis.key])]
            if axis.limits is None
            else label(found[axis.key])
            for axis in self.axes
        }

    def groups(self) -> Iterator[Sequence[int]]:
        """Groups of points that share device, time axis and recordings."""
        heavy = [axis.key.split(".")[0] in HEAVY for axis in self.axes]
        if self.sample is not None:
            yield from ([p] for p in range(self.points)) if any(heavy) else [range(self.points)]
            return
        strides = [math.prod(self.shape[j + 1 :]) for j in range(len(self.axes))]

        def offsets(of_heavy: bool) -> Iterator[int]:
            steps = [
                range(0, n * stride, stride)
                for n, stride, is_heavy in zip(self.shape, strides, heavy, strict=True)
                if is_heavy == of_heavy
            ]
            return (sum(step) for step in itertools.product(*steps))

        for first in offsets(True):
            yield [first + offset for offset in offsets(False)]

    @property
    def together(self) -> int:
        """Number of entries per task; on a nonlinear plant each is solved by itself, for seconds."""
        return 1 if self.scene.nonlinear else TOGETHER

    def index(self, point: int, iv: int, ig: int) -> int:
        """Index of a row: points outermost, then speeds, then grips."""
        return (point * len(self.speeds_m_s) + iv) * len(self.grips_N) + ig

    def point_of(self, index: int) -> int:
        return index // self.entries_per_point

    def tasks(self, done: Callable[[int], bool], recorded: StudyRecordings) -> Iterator[Task]:
        """Tasks with at least one row that is not done.

        How rows are grouped into tasks never depends on which are done. Replayed together with other neighbours, an
        entry may differ in its last digits, and a resumed study must end with the same rows as an uninterrupted one.
        """
        names = self.scene.axes.targets or ("",) * len(self.speeds_m_s)
        scene = hashlib.sha256(self.scene.model_dump_json().encode()).hexdigest()
        for points in self.groups():
            recordings, source = recorded.of(self.changes(points[0]))
            for ig, grip in enumerate(self.grips_N):
                rows = ((p, iv) for p in points for iv in range(len(self.speeds_m_s)))
                while together := list(itertools.islice(rows, self.together)):
                    if all(done(self.index(p, iv, ig)) for p, iv in together):
                        continue
                    own = list(dict.fromkeys(p for p, _ in together))
                    yield Task(
                        scene=self.scene,
                        recordings=recordings,
                        source=f"{scene} {source}",
                        grip_N=grip,
                        points=tuple(self.changes(p) for p in own),
                        items=tuple(
                            Item(self.index(p, iv, ig), own.index(p), self.speeds_m_s[iv], names[iv])
                            for p, iv in together
                        ),
                        options=self.options,
                        rivals=self.rivals,
                    )


def _drawn(axis: Axis, u: float) -> Any:
    if axis.limits is None:
        return axis.values[int(u * len(axis.values))]
    low, high = axis.limits
    value = low * (high / low) ** u if axis.log else low + u * (high - low)
    return round(value) if isinstance(axis.values[0], int) else float(f"{value:.12g}")


def two_speeds(scene: Scene) -> tuple[float, ...]:
    """The fastest taps of a scene, and those half as fast or the slowest [m/s]; one where they are the same."""
    speeds_m_s = scene.axes.speeds_m_s
    return tuple(sorted({max(speeds_m_s[0], speeds_m_s[-1] / 2), speeds_m_s[-1]}))


def grip_range(scene: Scene, name: str) -> tuple[float, float]:
    """The least and the greatest grip of a scene [N], for the named study that asks about grips between them.

    Raises
    ------
    InputError : the scene has one grip.
    """
    grips_N = scene.axes.grips_N
    if len(grips_N) < 2:
        raise InputError(
            f"--study {name}: asks about grips between the least and the greatest, {scene.name} has one: state two "
            "or more in grid.grips_N"
        )
    return grips_N[0], grips_N[-1]
