"""Add nodes to a library's grid until the blend of commands between the nodes meets a tolerance.

A blend keeps the limits of its commands on current and command, but it is not the optimum. It is further from the
tap, and it is weaker, since it adds commands that are not in phase. Between grips it may leave a limit on the motion,
since it moves another device than theirs, and anywhere a limit of a user's own that is not convex. Its excess at
(v, F), through the device of grip F, is the largest of

- the difference of its tap error from that of the optimum solved exactly there;
- the share of amplitude that it lacks beside that optimum, 1 - 10^(dB / 20), from the energies of both within the
  window, through the filter of the scene's rapid term;
- the share of a limit by which it leaves it, by the stage model.

A tolerance of 0.02 therefore allows 2 percentage points of tap error, 0.18 dB, and 2 % of a limit. An optimum of
intensity does not have the least tap error; its blend is bounded by the second difference. References between
recorded speeds come from `References.at`.
"""

import itertools
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.design.context import Context, Spot
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.design.nodes import Interval, Nodes, Point, shares, spots
from transopt.problem.answer import Certificate, Multipliers, Status
from transopt.problem.limits.limit import tolerated
from transopt.problem.objective.target import normal
from transopt.problem.problem import TransientProblem
from transopt.proof.continuous import Loop, accurate
from transopt.proof.effect import Effect, boxes_of
from transopt.proof.replay import figures_of
from transopt.recordings.recording import Recording
from transopt.scene.scene import Scene
from transopt.scene.sections import Grid
from transopt.solvers.options import SolverOptions

if TYPE_CHECKING:  # nothing is drawn while a grid is refined
    from matplotlib.figure import Figure

DEFAULT_CAP = 400  # entries
# The optimum as a function of speed or grip has a kink where a limit begins to bind; the worst point of an interval
# lies there. Interpolation across a kink at share k of the interval errs by k (1 - k) times the change of slope. At
# least half of that error is visible at the midpoint, and at least 0.75 of it at the quarter points. A tested point
# may therefore use 0.75 of the tolerance; a cell whose midpoints use half of that is also tested at quarter points.
MARGIN = 0.75
CLOSER_LOOK = MARGIN / 2
TINY = 1e-30  # smallest energy ratio; keeps the logarithm of a zero blend finite
REPLAYED_TOGETHER = 20  # points in one simulation; bounds the memory of their fine trajectories

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class OffNode:
    """Replayed quality of a library's blend at one speed and grip, beside the optimum there.

    Attributes
    ----------
    optimum : tap error of the optimum solved exactly there.
    before, after : tap errors of the blends on the recorded and on the refined grid.
    before_dB, after_dB : predicted energies of both blends within the window, relative to that of the optimum.
    before_beyond, after_beyond : share of a limit by which each blend leaves it; 0 if it keeps all.
    spot : for an arm, the normal and posture with the largest excess; None for any other plant.
    """

    speed_m_s: float
    grip_N: float
    optimum: float
    before: float
    after: float
    before_dB: float = 0.0
    after_dB: float = 0.0
    before_beyond: float = 0.0
    after_beyond: float = 0.0
    spot: Spot = None

    @property
    def excess_before(self) -> float:
        return _excess(self.before - self.optimum, self.before_dB, self.before_beyond)

    @property
    def excess_after(self) -> float:
        return _excess(self.after - self.optimum, self.after_dB, self.after_beyond)


def lacking(dB: float) -> float:
    """Missing share of amplitude at a relative energy in dB; negative where the energy is larger."""
    return 1 - float(10 ** (dB / 20))


def _excess(error: float, dB: float, beyond: float) -> float:
    """The largest of the three differences of a blend; a limit that it keeps is none."""
    return max(error, lacking(dB), beyond if beyond > 0 else -np.inf)


def beyond(problem: TransientProblem, command: FloatArray) -> float:
    """Largest share of a limit by which a command (N,) leaves it; 0 if it keeps all."""
    boxes = boxes_of(Effect(problem, command), Multipliers.zero(problem))
    over = ((float(box.excess.max()), box.limit.stated) for box in boxes)
    return max((excess / limit for excess, limit in over if excess > tolerated(limit)), default=0.0)


@dataclass(frozen=True)
class Refinement:
    """A grid on which the blend between the nodes meets a tolerance, with the evidence.

    Attributes
    ----------
    tolerance : largest excess allowed, absolute in tap error, as a share of amplitude and of a limit (0.02: two
        percentage points, 0.18 dB, 2 %).
    recorded, grid : the scene's own grid, and the refined one.
    points : all points tested in the cells of the refined grid, nodes included.
    shortfall : what is missing and what to do if the cap was reached first; empty if the tolerance is met.
    """

    tolerance: float
    recorded: Grid
    grid: Grid
    points: list[OffNode]
    rounds: int
    shortfall: str
    elapsed_s: float

    __repr__ = brief

    def plot(self) -> "Figure":
        """Plot the excess of the blend over speed and grip, on the grid of the scene and on the refined one.

        The figure is matplotlib's; `savefig` writes it to a file.
        """
        from transopt.report.grid_figure import grid_figure

        return grid_figure(self)

    @property
    def entries(self) -> int:
        return len(self.grid.speeds_m_s) * len(self.grid.grips_N)

    @property
    def is_one_point(self) -> bool:
        """Whether the grid is a single node, so that there is nothing to blend."""
        return self.entries == 1 and all(point.spot is None for point in self.points)

    @property
    def recorded_entries(self) -> int:
        return len(self.recorded.speeds_m_s) * len(self.recorded.grips_N)

    def off(self, grid: Grid) -> list[OffNode]:
        """The points at which a grid blends: all but its nodes; for an arm also nodes between places."""
        return [
            p
            for p in self.points
            if p.speed_m_s not in grid.speeds_m_s or p.grip_N not in grid.grips_N or p.spot is not None
        ]


class Errors:
    """The excess at any point of any grid; optima and results are cached.

    For an arm the excess of a point is the largest over all places of the scene; the final replay also tests places
    half-way between its normals and postures.
    """

    def __init__(self, context: Context, options: SolverOptions) -> None:
        self.context, self._options = context, options
        self._spots = spots(context.scene)
        self._optima: dict[tuple[Point, Spot], Entry] = {}
        self._excess: dict[tuple[Point, tuple[Interval, Interval]], float] = {}

    @property
    def places(self) -> list[Spot]:
        """Places of an arm's scene; [None] for any other plant."""
        return [spot for spot, corners in self._spots.items() if len(corners) == 1]

    def optimum(self, point: Point, spot: Spot = None) -> Entry:
        """The optimum at a point.

        Raises
        ------
        InputError : no solver's answer can be proven, so that an excess over it would be meaningless.
        """
        if (point, spot) not in self._optima:
            speed, grip = point
            (found,) = design([self.context.posed(speed, grip, place=spot)], options=self._options)
            solution, proof = found.solution, found.certificate
            if solution.status is not Status.OPTIMAL or not proof.accepted:
                raise InputError(
                    f"--grid-tolerance: no proven optimum at {speed:g} m/s, {grip:g} N (gap "
                    f"{proof.relative_gap:.0e}, {solution.status.value}): leave it out to see what the grid's own "
                    "entries lack"
                )
            self._optima[point, spot] = found
        return self._optima[point, spot]

    @property
    def proofs(self) -> dict[Point, tuple[Status, Certificate]]:
        """Status and certificate of every optimum solved so far."""
        return {point: (found.solution.status, found.certificate) for (point, _), found in self._optima.items()}

    def solve(self, nodes: Nodes, points: Iterable[Point], progress: Callable[[int, int], None]) -> None:
        """Solve all optima that the excess at some points depends on, those of the surrounding nodes included."""
        corners = itertools.chain.from_iterable(itertools.product(*nodes.cell(point)) for point in points)
        wanted = itertools.product(dict.fromkeys([*corners, *points]), self.places)
        missing = [each for each in wanted if each not in self._optima]
        for done, each in enumerate(missing):
            progress(done, len(missing))
            self.optimum(*each)

    def _predicted_tap_error(self, point: Point, spot: Spot) -> float:
        """Tap error of the optimum at a point, by the stage model."""
        found = self.optimum(point, spot)
        return self.context.yardstick.tap_error(found.uncorrected, found.lasting_m_s2)

    def _energy(self, acceleration_m_s2: FloatArray) -> float:
        """Energy of an acceleration (N,), or along the normal (p, N), through the filter of the rapid term."""
        of, acceleration_m_s2 = self.context.posing.rapid, normal(acceleration_m_s2)
        heard = of.apply(acceleration_m_s2) if of else acceleration_m_s2
        return float(heard @ heard)

    def dB(self, point: Point, acceleration_m_s2: FloatArray, spot: Spot = None) -> float:
        """Energy [dB] of an acceleration (N,) relative to that of the optimum at a point; 0 if that one is zero."""
        best = self._energy(self.optimum(point, spot).predicted_m_s2)
        return 10 * float(np.log10(max(self._energy(acceleration_m_s2) / best, TINY))) if best > 0 else 0.0

    def blend(self, nodes: Nodes, point: Point, spot: Spot = None, *, transient: bool = False) -> FloatArray:
        """(N,) linear blend of the node commands, or of their transients, equal to that of `Library.at`."""
        by_speed, by_grip = (shares(i, value) for i, value in zip(nodes.cell(point), point, strict=True))
        blended = np.zeros_like(self.optimum(point, spot).solution.command)
        for (v, a), (F, b), (at, c) in itertools.product(by_speed, by_grip, self._spots[spot]):
            node = self.optimum((v, F), at)
            command = node.solution.command
            blended += a * b * c * (node.problem.transient_command(command) if transient else command)
        return blended

    def excess(self, nodes: Nodes, points: Iterable[Point]) -> dict[Point, float]:
        """Excess of the blends over the optima by the stage model, which is exact at the instants; cached by cell."""
        keys = {point: (point, nodes.cell(point)) for point in points}
        missing = [point for point, key in keys.items() if key not in self._excess]
        for spot, (grip, group) in itertools.product(self.places, _by_grip(missing)):
            problems = [self.optimum(point, spot).problem for point in group]
            blended = [self.blend(nodes, point, spot) for point in group]
            lasting = [problem.continued(command) for problem, command in zip(problems, blended, strict=True)]
            played, _ = self.context.stage(grip, spot).rollout(np.stack(lasting))
            for point, problem, command, acceleration in zip(group, problems, blended, played, strict=True):
                error = self.context.yardstick.tap_error(self.context.reference(*point).target, acceleration)
                error -= self._predicted_tap_error(point, spot)
                dB = self.dB(point, acceleration[..., : command.shape[-1]], spot)
                worst = _excess(error, dB, beyond(problem, command))
                self._excess[keys[point]] = max(worst, self._excess.get(keys[point], -np.inf))
        return {point: self._excess[key] for point, key in keys.items()}

    def replayed(self, points: Sequence[Point], before: Nodes, after: Nodes) -> list[OffNode]:
        """Optimum and both blends at every point, by the independent replay: the final evidence."""
        found = dict[Point, OffNode]()
        for spot, (grip, group) in itertools.product(self._spots, _by_grip(points)):
            for part in (group[j : j + REPLAYED_TOGETHER] for j in range(0, len(group), REPLAYED_TOGETHER)):
                for point, each in zip(part, self._replayed(part, grip, spot, before, after), strict=True):
                    if point not in found or each.excess_after > found[point].excess_after:
                        found[point] = each
        return [found[point] for point in points]

    def _replayed(self, part: list[Point], grip: float, spot: Spot, before: Nodes, after: Nodes) -> list[OffNode]:
        """Replay optimum and both blends at points of one device, over a wall with the feedback of each replay."""
        entries = [self.optimum(point, spot) for point in part]
        commands = np.stack(
            [
                command
                for point, own in zip(part, entries, strict=True)
                for command in (
                    own.problem.transient_command(own.solution.command),
                    *(self.blend(nodes, point, spot, transient=True) for nodes in (before, after)),
                )
            ]
        )
        device = self.context.stage(grip, spot)
        # The coil is not simulated: heating is convex, so a blend heats at most as much as the blended heatings.
        wanted = [self.context.reference(*point).target for point in part for _ in range(3)]
        walls = [own.problem.wall for own in entries for _ in range(3) if own.problem.wall is not None]
        course = accurate(device, self.context.yardstick.grid, commands, Loop(walls, 0.0) if walls else None)
        figures = figures_of(course, self.context.yardstick, wanted)
        moved = course.accelerations[..., : commands.shape[-1]]
        found = []
        for j, point in enumerate(part):
            optimum, *blended = (each.tap_error for each in figures[3 * j : 3 * j + 3])
            dB = [self.dB(point, each, spot) for each in moved[3 * j + 1 : 3 * j + 3]]
            left = [beyond(entries[j].problem, self.blend(nodes, point, spot)) for nodes in (before, after)]
            found.append(OffNode(*point, optimum, blended[0], blended[1], dB[0], dB[1], left[0], left[1], spot))
        return found


def _by_grip(points: Iterable[Point]) -> list[tuple[float, list[Point]]]:
    """Points grouped by grip: those of one grip share a device and can be simulated together."""
    groups: dict[float, list[Point]] = {}
    for point in points:
        groups.setdefault(point[1], []).append(point)
    return list(groups.items())


def _blame(errors: Errors, nodes: Nodes, failing: dict[Point, float]) -> list[tuple[int, Interval]]:
    """Intervals to split as (axis, interval), the worst first; axis 0 is the speed.

    A failing point on an edge of a cell asks for a split along that edge. A failing point inside a cell counts only
    if neither of its intervals is to be split yet; it asks for the axis along which its projection on the edges is
    worse.
    """
    wanted: dict[tuple[int, Interval], float] = {}
    worst_first = sorted(failing, key=lambda point: -failing[point])
    inside = []
    for point in worst_first:
        speeds, grips = nodes.cell(point)
        if speeds[0] == speeds[1] or grips[0] == grips[1]:
            axis = 1 if speeds[0] == speeds[1] else 0
            wanted.setdefault((axis, (speeds, grips)[axis]), failing[point])
        else:
            inside.append(point)
    for point in inside:
        speeds, grips = nodes.cell(point)
        if (0, speeds) in wanted or (1, grips) in wanted:
            continue
        along = [
            max(errors.excess(nodes, edges).values())
            for edges in ([(point[0], F) for F in grips], [(v, point[1]) for v in speeds])
        ]
        axis = int(np.argmax(along))
        wanted[axis, (speeds, grips)[axis]] = failing[point]
    return sorted(wanted, key=lambda split: -wanted[split])


def check_tolerance(scene: Scene, tolerance: float, cap: int) -> None:
    """Check the arguments of a refinement before any work is done.

    Raises
    ------
    InputError : a tolerance or cap out of range, a scene of named targets.
    """
    if not 0 < tolerance < 1:
        raise InputError(f"--grid-tolerance {tolerance:g}: must be between 0 and 1 (0.02: two percentage points)")
    if scene.targets:
        raise InputError(f"--grid-tolerance: {scene.name} has named targets, nothing lies between them: leave it out")
    entries = scene.axes.entries
    if cap < entries:
        raise InputError(f"--grid-cap {cap}: the scene's own grid has {entries} entries: raise the cap")


def refine_grid(
    scene: Scene,
    recordings: Sequence[Recording],
    tolerance: float,
    *,
    cap: int = DEFAULT_CAP,
    options: SolverOptions | None = None,
    progress: Progress = lambda description, done, total: None,
) -> Refinement:
    """Split intervals of the grid, round by round, until no point between the nodes exceeds the tolerance.

    Test points are the midpoints of every interval of one axis, combined with nodes and midpoints of the other. Once
    they use at most `MARGIN` of the tolerance, the quarter points of cells that use more than `CLOSER_LOOK` are
    tested in the same way. At the end every test point is replayed and compared with the whole tolerance. An axis
    with one node is not refined.

    Parameters
    ----------
    tolerance : largest excess, absolute in tap error, as a share of amplitude and of a limit.
    cap : most entries (speeds times grips) of the refined grid; reaching it is not an error but a `shortfall`.
    progress : called with the present step, the number of its optima already solved, and their total.

    Raises
    ------
    InputError : a tolerance or cap out of range, recordings that cannot be used, a point without a proven optimum.
    """
    check_tolerance(scene, tolerance, cap)
    first = Nodes(tuple(scene.grid.speeds_m_s), tuple(scene.grid.grips_N))
    start = time.perf_counter()
    context = Context.recorded(scene, recordings)
    errors = Errors(context, SolverOptions() if options is None else options)
    nodes, rounds = first, 0

    def excess(points: list[Point]) -> dict[Point, float]:
        text = f"grid round {rounds + 1}, {len(nodes.speeds)} x {len(nodes.grips)} nodes"
        errors.solve(nodes, points, lambda done, total: progress(text, done, total))
        return errors.excess(nodes, points)

    while True:
        found = excess(nodes.midpoints())
        if all(e <= MARGIN * tolerance for e in found.values()):
            found |= excess(nodes.quarters(found, CLOSER_LOOK * tolerance))
        before = nodes
        for axis, interval in _blame(errors, nodes, {p: e for p, e in found.items() if not e <= MARGIN * tolerance}):
            finer = nodes.split(axis, interval)
            nodes = finer if finer.entries * len(errors.places) <= cap else nodes
        if nodes == before:
            break
        rounds += 1
    points = errors.replayed(list(found), first, nodes)
    worst = max(points, key=lambda point: point.excess_after)
    return Refinement(
        tolerance=tolerance,
        recorded=scene.grid,
        grid=Grid(speeds_m_s=list(nodes.speeds), grips_N=list(nodes.grips), grip_min_N=scene.grid.grip_min_N),
        points=points,
        rounds=rounds,
        shortfall="" if worst.excess_after <= tolerance else _shortfall(worst, nodes, tolerance, cap, errors.places),
        elapsed_s=time.perf_counter() - start,
    )


def _shortfall(worst: OffNode, nodes: Nodes, tolerance: float, cap: int, places: Sequence[Spot]) -> str:
    at, remedy = f"{worst.speed_m_s:.4g} m/s, {worst.grip_N:.4g} N", "raise --grid-cap or --grid-tolerance"
    if worst.spot is not None:
        at += ", normal {:g}, posture {:g}".format(*worst.spot)
        if worst.spot not in places:
            remedy = "add one to model.normals or model.postures_deg there, or raise --grid-tolerance"
    times = f" x {len(places)} places" if len(places) > 1 else ""
    return (
        f"grid tolerance {100 * tolerance:g} % not met with {nodes.entries * len(places)} entries "
        f"({len(nodes.speeds)} speeds x {len(nodes.grips)} grips{times}, --grid-cap {cap}): worst remaining excess "
        f"{100 * worst.excess_after:.2f} % at {at}: {remedy}"
    )
