"""What limits on the motion of the device have in common: a named output of the plant, between two bounds, for all t.

Such a limit is on the physical motion z = y + z_nom, the nominal motion included. It is stated at the switching
instants; what the output may do beyond them within a servo period is taken off as a margin: with the command held,

    q(tau_k + s) - [(1 - s / dt) q(tau_k) + (s / dt) q(tau_(k+1))]

is a linear function of the commands so far, whose response to one command is found from the plant itself, and the
sum of its sizes times the largest command bounds it (the L1 norm of an impulse response). The nominal motion's own
part is bounded by its curvature. Where a limit leaves but a small part of the largest command that bound says little,
and could be more than the limit: no more than a twentieth of the limit is taken off, and the replay, which follows
the output at all times, says whether that was enough.

Where that margin costs much of J (`transopt.design.within`), the limit is stated at the ends of m parts of every
period, and the margin, by the chord of a part, falls with 1 / m^2. The parts are equal for a position. A velocity and
a coil's current bend most just after a new command, in the coil's time constant: their ends lie at (j / m)^2.
"""

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.discretise import AFTER, StageModel, exponential, within
from transopt.problem.limits.limit import Limit, Posed, Row, Setting, positive

MOST_KEPT = 0.05  # of the limit, for the time between the switching instants
LAGS = (2, 3, 6)  # numbers of switching instants whose values explain what happens between two
SUBSTEPS, FINER = 8, 16  # at which the excursion from the chord is looked at: of a whole period, and of a part of it
PARTS = (1, 2, 4, 8, 16, 32)  # into which a servo period may be parted, the instants of a few among those of more


@dataclass(frozen=True, repr=False)
class OutputLimit(Limit):
    """|output + nominal| <= limit for all t.

    Attributes
    ----------
    limit : > 0.
    nominal : (N + 1,) the nominal motion's part of the output at tau_0 to tau_N.
    largest : size of any command.
    bends : of every device (fits, S, 2), bounds on what it may do between two instants beyond its values there, by
        the largest size of the output without the nominal motion and by that of the commands; the least of all fits
        is one.
    parts : of a servo period, at whose ends it is stated; one of `PARTS`.
    output : what is limited. grading : p of the ends (j / parts)^p.
    """

    output: ClassVar[str]
    grading: ClassVar[int] = 2

    limit: float
    nominal: FloatArray
    largest: float
    bends: tuple[FloatArray, ...]
    parts: int = 1

    def __post_init__(self) -> None:
        positive(self.key, self.limit)

    def margin(self, device: int = 0) -> float:
        """What is taken off the limit for the time between its instants."""
        return min(self.excursion(device), MOST_KEPT * self.limit)

    def excursion(self, device: int = 0) -> float:
        """Bound on what the output may do between two instants beyond its values there."""
        curved = float(np.abs(np.diff(self.nominal, 2)).max(initial=0.0)) / 8
        most = self.limit + float(np.abs(self.nominal).max())
        return float((self.bends[device] @ (most, self.largest)).min(axis=0).max()) + curved

    @staticmethod
    @abstractmethod
    def nominal_part(setting: Setting) -> FloatArray:
        """(N,) what the nominal motion alone makes of the output at tau_k."""

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        stage, own = setting.stage, cls.nominal_part(setting)
        # To tau_N the nominal motion goes on straight.
        nominal = np.append(own, 2 * own[-1] - own[-2] if own.size > 1 else own[-1])
        largest = setting.input_limit(asked) if stage.amplifier is None else stage.amplifier.command_limit
        whole, stages = (Fraction(1),), setting.grid.stages
        bends = tuple(_bends(device, cls.output, stages, whole) for device in setting.devices)
        return cls(asked[cls.key], nominal, largest, bends)

    def within(self, problem: Posed, parts: int) -> Self:
        """State the limit at the ends of so many parts of a servo period."""
        if parts == self.parts:
            return self
        ends = (*self.shares(parts), Fraction(1))
        bends = tuple(_bends(device, self.output, problem.grid.stages, ends) for device in problem.devices)
        return replace(self, bends=bends, parts=parts)

    @classmethod
    def shares(cls, parts: int) -> tuple[Fraction, ...]:
        """Shares of a servo period after which so many parts end, but for the last one."""
        return tuple(Fraction(j, parts) ** cls.grading for j in range(1, parts))

    @property
    def stated(self) -> float:
        return self.limit

    def wider(self, factor: float) -> Self:
        return replace(self, limit=factor * self.limit)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        # At tau_0 it is what it is; the commands have their say from then on to tau_N.
        def of(device: int, share: Fraction) -> Row:
            bound, later = self.limit - self.margin(device), float(share)
            nominal = self.nominal[1:] if share == 1 else (1 - later) * self.nominal[:-1] + later * self.nominal[1:]
            name, output = row_within(self.name, share), within(self.output, share)
            return Row(name, {output: 1.0}, -bound, bound, nominal).of_device(device)

        shares = (*self.shares(self.parts), Fraction(1))
        return tuple(of(device, share) for device in range(len(problem.devices)) for share in shares)

    def watched(self, problem: Posed) -> tuple[Row, ...]:
        own = Row(self.name, {self.output: 1.0}, -self.limit, self.limit, self.nominal)
        return tuple(own.of_device(device) for device in range(len(problem.devices)))

    @property
    def kept_back(self) -> float:
        return max(self.margin(device) for device in range(len(self.bends)))

    def cannot_bind(self, problem: Posed) -> str:
        bound = largest_of(self.rows(problem), problem)
        if bound > self.limit - self.kept_back:
            return ""
        return (
            f"no command inside its limits moves it beyond {bound:.4g} {self.unit}, limit {self.limit:g} {self.unit}"
        )

    def unavoidable(self, problem: Posed) -> str:
        # What the first command can do about the first period is nothing beside the motion that is there.
        reach = self._reach(problem)
        start = max(
            abs(float(self.nominal[0])), abs(float(self.nominal[1])) + float(max(self._kept(problem) - reach))
        )
        if start <= self.limit + self.tolerance:
            return ""
        return (
            f"{self.label} {start - self.limit:.3g} {self.unit} over its {self.limit:g} {self.unit} at "
            f"{problem.grid.switching_times_s[0] * 1e3:.1f} ms: the motion of the incoming stylus alone"
        )

    def _kept(self, problem: Posed) -> FloatArray:
        """(S,) margin of every device."""
        return np.array([self.margin(device) for device in range(len(problem.devices))])

    def _reach(self, problem: Posed) -> FloatArray:
        """(S,) by how much the first command can move the output of every device within its period."""
        largest = problem.limits.command_bound(ideal=problem.stage.amplifier is None)
        return np.array([largest * abs(device.output(self.output + AFTER)[1]) for device in problem.devices])

    def unresolved(self, problem: Posed, command: FloatArray, peak: float) -> str:
        if all(self.excursion(device) <= self.margin(device) for device in range(len(self.bends))):
            return ""
        return (
            f"{self.label} {peak - self.limit:.3g} {self.unit} over its {self.limit:g} {self.unit} between the "
            f"instants at which it is kept, {MOST_KEPT:.0%} being kept back: time.dt_s = {problem.grid.dt_s:g} s"
        )

    def replayed(self, peak: float) -> str:
        return f"replayed {self.label} {peak:.6g} {self.unit}, limit {self.limit:g} {self.unit}"


def largest_of(rows: Iterable[Row], problem: Posed) -> float:
    """What no admissible command can make rows exceed: the sums of their responses, every command at its largest."""
    largest = problem.limits.command_bound(ideal=problem.stage.amplifier is None)
    impulse = np.eye(1, problem.grid.stages)[0]
    motions, most = [device.motion(impulse) for device in problem.devices], 0.0
    for row in rows:
        responses = np.abs(replace(row, offset=0.0).value(motions[row.device], impulse))
        most = max(most, float((np.cumsum(responses) * largest + np.abs(row.offset)).max()))
    return most


def row_within(name: str, share: Fraction) -> str:
    """What the row of a limit is called after this share of a servo period."""
    return name if share == 1 else f"{name}_{share.numerator}_of_{share.denominator}"


def _bends(stage: StageModel, output: str, stages: int, ends: tuple[Fraction, ...]) -> FloatArray:
    """`OutputLimit.bends` of a device, kept with it for the next entry."""
    key = ("bends", output, stages, ends)
    if key not in stage.derived:
        stage.derived[key] = _bends_of(stage, output, stages, ends)
    found: FloatArray = stage.derived[key]
    return found


def _bends_of(stage: StageModel, output: str, stages: int, ends: tuple[Fraction, ...]) -> FloatArray:
    """(1 + fits, S, 2) bounds on |y - its chord| at S instants, by the largest |y| at the switching instants and |c|.

    The difference e from the chord is a sum of the commands so far. So is y at the switching instants, where the
    limit bounds it: |e| <= sum |a_l| max |y| + sum |e - sum_l a_l y(tau_(k+1-l))| max |c| for any numbers a_l, the
    last sum over the response to one command. Least-squares fits of the response give numbers that take most of a
    resonance's memory out of it. The first bound has none, and is alone without instants within the period.
    """
    row, impulse = stage.outputs[output], np.eye(1, stages + 1)[0]
    states, alone, until = stage.states(impulse), len(ends) == 1, np.eye(row.size + 1)
    at, size = states @ row, np.abs(states).sum(axis=0)
    bent, start, substeps = list[FloatArray](), at[:-1], SUBSTEPS if alone else FINER
    lengths_s = stage.dt_s * np.diff(np.array([0, *ends], dtype=float)) / substeps
    for length_s, ended in zip(lengths_s, ends, strict=True):
        course, step = [start], exponential(stage.flow * length_s)
        for j in range(1, substeps + 1):
            if ended == 1 and j == substeps:
                course.append(at[1:])
                continue
            until = exponential(stage.flow * (stage.dt_s * j / substeps)) if alone else step @ until
            by_state, by_command = until[:-1, :-1], until[:-1, -1]
            course.append(states[:-1] @ (row @ by_state) + impulse[:-1] * float(row @ by_command))
            if not alone:
                reached = states[:-1] @ by_state.T + np.outer(impulse[:-1], by_command)
                size = np.maximum(size, np.abs(reached).sum(axis=0))
        start = course[-1]
        bent += [course[j] - ((1 - j / substeps) * course[0] + j / substeps * start) for j in range(1, substeps)]
    responses = np.array(bent)
    found = [np.column_stack([np.zeros(len(bent)), np.abs(responses).sum(axis=1)])]
    if alone:
        return np.array(found)
    before = np.concatenate([np.zeros(LAGS[-1]), at])
    lagged = np.column_stack([before[LAGS[-1] + 1 - lag :][:stages] for lag in range(LAGS[-1])])
    Q, R = np.linalg.qr(lagged)
    seen = Q.T @ responses.T
    for lags in LAGS:
        fit = np.linalg.lstsq(R[:, :lags], seen, rcond=None)[0]
        left = np.abs(responses.T - lagged[:, :lags] @ fit).sum(axis=0)
        found.append(np.column_stack([np.abs(fit).sum(axis=0), left]))
    bounds = np.array(found)
    bounds[..., 1] += np.repeat([_unseen(stage, row, size, length_s) for length_s in lengths_s], substeps - 1)
    return bounds


def _unseen(stage: StageModel, row: FloatArray, size: FloatArray, g_s: float) -> float:
    """Bound on |q - its chord| within a substep of g seconds, per unit of command.

    It is g^2 / 8 of the largest curvature; within the substep the states are at most exp(|F| g) times what they are
    at its beginning.

    Parameters
    ----------
    size : (n,) bound on the states at the beginning of any substep.
    """
    flow = stage.flow
    curvature = np.abs(np.append(row, 0.0) @ flow @ flow) @ exponential(np.abs(flow) * g_s)
    return g_s**2 / 8 * float(curvature @ np.append(size, 1.0))
