"""What a constraint study varies: keys with their values, the points they span, the tasks that solve them."""

import hashlib
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy.stats import qmc

import problems
from transopt.base.errors import InputError
from transopt.design.sweep import Item, Task
from transopt.recordings.recording import Recording
from transopt.recordings.tap import read_recordings
from transopt.scene.file import explain, read_toml
from transopt.scene.keys import Changes, check_value, find_key, parse_value, with_values
from transopt.scene.scene import Scene
from transopt.scene.sections import Motor, Transmission
from transopt.scene.strikes import recordings as simulated_recordings
from transopt.solvers.options import SolverOptions

TOGETHER = 16  # entries of a task: replaying 16 together takes 1.5 times as long as replaying one
MOST_POINTS = 10_000_000
# Tables that the device, its time axis or the recordings depend on: what differs in one of them shares less work.
HEAVY = ("model", "motor", "transmission", "tip", "amplifier", "time", "recordings", "feedback")
FILES = {"motor": Motor, "transmission": Transmission}
MARGIN_S = 5e-3  # the recordings of a simulated scene outlast its horizon by twice this


@dataclass(frozen=True)
class Axis:
    """One key and its values.

    Attributes
    ----------
    values : as the scene takes them. labels : as tables and CSV files show them.
    limits : the ends of a range, between which a sample may lie; None for listed values. log : the range's spacing.
    """

    key: str
    values: tuple[Any, ...]
    labels: tuple[str, ...]
    limits: tuple[float, float] | None = None
    log: bool = False

    @property
    def numeric(self) -> bool:
        return all(isinstance(value, int | float) for value in self.values)


def label(value: Any) -> str:
    """A value in a CSV file: enough digits to be read back exactly."""
    return repr(value) if isinstance(value, float) else "none" if value is None else str(value)


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(":")]
    except ValueError:
        raise InputError(f"{option} {text}: a range is START:STOP:COUNT, three numbers") from None


def parse_range(option: str, text: str) -> tuple[tuple[float, float], list[float], bool]:
    """Ends and values of START:STOP:COUNT, evenly spaced, or with :log behind it by equal factors.

    Raises
    ------
    InputError : no such range.
    """
    log = text.endswith(":log")
    numbers = _numbers(option, text.removesuffix(":log"))
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{option} {text}: a range is START:STOP:COUNT or START:STOP:COUNT:log")
    low, high, count = numbers
    if count != int(count) or not 2 <= count <= 1_000_000:
        raise InputError(f"{option} {text}: COUNT = {count:g}: must be a whole number, 2 or more")
    if not low < high or (log and low <= 0):
        raise InputError(f"{option} {text}: START must be below STOP{' and above 0' if log else ''}")
    space = np.geomspace if log else np.linspace
    # Twelve digits: 0.3, not 0.30000000000000004.
    return (low, high), [float(f"{value:.12g}") for value in space(low, high, int(count))], log


def parse_numbers(option: str, text: str) -> list[float]:
    """Numbers separated by commas, or a range.

    Raises
    ------
    InputError : neither.
    """
    if ":" in text:
        return parse_range(option, text)[1]
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = [math.nan]
    if not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{option} {text}: must be numbers separated by commas, or START:STOP:COUNT")
    return numbers


def _file(kind: str, name: str) -> tuple[str, dict[str, Any]]:
    """Label and table of a motor's or a transmission's file: a path, a built-in name, or the beginning of one."""
    folder = problems.FOLDER / f"{kind}s"
    known = {path.stem: path for path in sorted(folder.glob("*.toml"))}
    matches = [name] if name in known else [stem for stem in known if stem.startswith(name)]
    if Path(name).suffix == ".toml":
        path = Path(name)
    elif name and len(matches) == 1:
        path = known[matches[0]]
    else:
        raise InputError(
            f"{kind} = {name}: {'several files begin so' if matches else 'no such file'}; "
            f"give the path of a .toml file or one of {', '.join(known)}"
        )
    content = read_toml(path)
    try:
        return path.stem, FILES[kind].model_validate(content).model_dump()
    except ValidationError as error:
        raise InputError(explain(path, error, content)) from None


def parse_axis(scene: Scene, option: str, text: str) -> Axis:
    """KEY=V1,V2,... or KEY=START:STOP:COUNT, each value checked against its key's own bounds.

    Raises
    ------
    InputError : one line: key, value, limit.
    """
    path, equals, values_text = (part.strip() for part in text.partition("="))
    if not equals or not values_text:
        raise InputError(f"{option} {text}: give KEY=V1,V2,... or KEY=START:STOP:COUNT")
    if path in FILES:
        found = [_file(path, name.strip()) for name in values_text.split(",")]
        axis = Axis(path, tuple(table for _, table in found), tuple(stem for stem, _ in found))
    else:
        key = find_key(scene, path)
        if path.startswith("grid."):
            option_of = {"grid.speeds_m_s": "--speed", "grid.grips_N": "--grip"}.get(path)
            instead = f"; give them with {option_of}" if option_of else ""
            raise InputError(f"{path}: the grid is what every point is solved at, not a key that is varied{instead}")
        limits, log = None, False
        if ":" in values_text and key.number:
            limits, numbers, log = parse_range(f"{option} {path} =", values_text)
            values = tuple(round(number) if key.integer else number for number in numbers)
        else:
            values = tuple(parse_value(key, part) for part in values_text.split(","))
        axis = Axis(path, values, tuple(label(value) for value in values), limits, log)
    if len(set(axis.labels)) < len(axis.labels):
        raise InputError(f"{option} {text}: a value stands there twice")
    for value in axis.values:
        if not isinstance(value, dict):
            check_value(scene, path, value)
    return axis


def apply_settings(scene: Scene, settings: Sequence[str]) -> Scene:
    """The scene with keys set for all points, KEY=VALUE each.

    Raises
    ------
    InputError : one line: key, value, limit.
    """
    changes: dict[str, Any] = {}
    for text in settings:
        axis = parse_axis(scene, "--set", text)
        if len(axis.values) != 1:
            raise InputError(f"--set {text}: one value; --vary takes several")
        changes[axis.key] = axis.values[0]
    return with_values(scene, changes)


@dataclass(frozen=True)
class Plan:
    """Everything that defines the rows of a study.

    Attributes
    ----------
    scene : what is not varied. axes : what is. sample : points of a Latin hypercube; None: all combinations.
    speeds_m_s, grips_N : the entries of every point.
    rivals : baselines and prices too.
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
        for speed in self.speeds_m_s:
            if not recorded[0] <= speed <= recorded[-1]:
                raise InputError(
                    f"--speed {speed:g}: must be between {recorded[0]:g} and {recorded[-1]:g} m/s, "
                    "the recorded speeds of the scene"
                )
        with_values(self.scene, {"grid.grips_N": list(self.grips_N)})
        if not 1 <= self.points <= MOST_POINTS:
            raise InputError(f"{self.points} points: must be at least 1 and at most {MOST_POINTS}")

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
        """(sample, axes) uniform in 0..1, one of each of `sample` equal slices along every axis."""
        hypercube = qmc.LatinHypercube(len(self.axes), rng=np.random.default_rng(self.seed))
        return hypercube.random(self.sample or 0)

    def place(self, point: int) -> tuple[int, ...]:
        """Index of a point along every axis; of combinations only."""
        return tuple(int(j) for j in np.unravel_index(point, self.shape)) if self.axes else ()

    def changes(self, point: int) -> dict[str, Any]:
        """The keys of a point with their values."""
        if self.sample is None:
            return {axis.key: axis.values[j] for axis, j in zip(self.axes, self.place(point), strict=True)}
        return {axis.key: _drawn(axis, float(u)) for axis, u in zip(self.axes, self._draws[point], strict=True)}

    def labels(self, point: int) -> dict[str, str]:
        """The same as tables show them."""
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
        """Points that share device, time axis and recordings."""
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

    def index(self, point: int, iv: int, ig: int) -> int:
        """Number of a row: points outermost, then speeds, then grips."""
        return (point * len(self.speeds_m_s) + iv) * len(self.grips_N) + ig

    def point_of(self, index: int) -> int:
        return index // self.entries_per_point

    def tasks(self, done: Callable[[int], bool], takes: "Recorder") -> Iterator[Task]:
        """Tasks with at least one row that is not done; which rows share a task never depends on that."""
        for points in self.groups():
            recordings, source = takes.taken(self.changes(points[0]))
            for ig, grip in enumerate(self.grips_N):
                rows = ((p, iv) for p in points for iv in range(len(self.speeds_m_s)))
                while together := list(itertools.islice(rows, TOGETHER)):
                    if all(done(self.index(p, iv, ig)) for p, iv in together):
                        continue
                    own = list(dict.fromkeys(p for p, _ in together))
                    yield Task(
                        scene=self.scene,
                        recordings=recordings,
                        source=source,
                        grip_N=grip,
                        points=tuple(self.changes(p) for p in own),
                        items=tuple(
                            Item(self.index(p, iv, ig), own.index(p), self.speeds_m_s[iv]) for p, iv in together
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


class Recorder:
    """The recordings of a study: those of its scene, whatever device is varied.

    Simulated ones are taken with the scene's own device and long enough for every point, so that all points are to
    follow the same taps; only where keys of `recordings` are varied are they taken or read again.
    """

    def __init__(self, scene: Scene, axes: Sequence[Axis]) -> None:
        self._scene, self._last = scene, ("", (), "")
        longest: dict[str, float] = {"time.dt_s": scene.time.dt_s, "time.stages": scene.time.stages}
        amplifier = scene.amplifier_model()
        longest["amplifier.delay_s"] = 0.0 if amplifier is None else amplifier.delay_s
        for axis in axes:
            if axis.key in longest:
                longest[axis.key] = max(map(float, axis.values))
        end_s = longest["time.dt_s"] * longest["time.stages"] + longest["amplifier.delay_s"]
        self._longer_s = end_s - scene.time.dt_s * scene.time.stages

    def taken(self, changes: Changes) -> tuple[tuple[Recording, ...], str]:
        """Recordings for a point, and a name for them that no others have."""
        own = {key: value for key, value in changes.items() if key.startswith("recordings.")}
        if repr(own) == self._last[0]:
            return self._last[1], self._last[2]
        taken = tuple(self._take(own))
        digest = hashlib.sha256()
        for one in taken:
            digest.update(f"{one.name} {one.speed_m_s} {one.grip_N} {one.acceleration.dt_s}".encode())
            digest.update(np.ascontiguousarray(one.acceleration.values).tobytes())
        self._last = (repr(own), taken, digest.hexdigest())
        return taken, digest.hexdigest()

    def _take(self, own: Changes) -> list[Recording]:
        try:
            scene = with_values(self._scene, own)
        except InputError:
            scene = self._scene  # the point is refused for its value when it is solved
        if scene.recordings.simulated is None:
            return read_recordings(scene.recordings)
        if self._longer_s > MARGIN_S:
            stages = scene.time.stages + math.ceil(self._longer_s / scene.time.dt_s)
            scene = with_values(scene, {"time.stages": stages})
        return simulated_recordings(scene)
