"""Limits on a named output of the plant, |q(t)| <= limit for all t: stroke, velocity, coil current.

The limit applies to the physical motion z = y + z_nom, the nominal motion included. It is stated at the switching
instants, tightened by a margin for the excursion of q from its chord within a servo period. With the command held,

    q(tau_k + s) - [(1 - s / dt) q(tau_k) + (s / dt) q(tau_(k+1))]

is a linear function of the commands so far. The L1 norm of its impulse response times the largest command bounds it;
the curvature of the nominal motion bounds that part. The bound is loose where the limit admits only a small part of
the largest command, and may exceed the limit itself. So the margin is at most a twentieth of the limit, and the
replay, which follows the output at all times, checks whether it was sufficient.

Where the margin costs much of J (`transopt.design.within`), the limit is stated at the ends of m parts of every
period; the margin, taken from the chord of a part, then falls with 1 / m^2. For a position the parts are equal. A
velocity and a coil's current bend most just after a new command, within the coil's time constant: their parts end at
(j / m)^2. In a coil whose time constant is a small part of the period the current reaches its next value long before
the chord does, and does not go beyond it. In place of s / dt any share in [0, 1] gives a valid bound, since such a
point lies between the values at both ends. For a coil's current the share that fits best at each instant is taken.
"""

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.matrices import exponential
from transopt.base.signals import FloatArray
from transopt.plant.discretise import AFTER, StageModel, within
from transopt.problem.limits.limit import Limit, Posed, Setting, positive
from transopt.problem.limits.row import Row

MOST_KEPT = 0.05  # largest margin as a share of the limit
LAGS = (2, 3, 6)  # numbers of preceding samples in the least-squares fits of the excursion (`_bends_of`)
SUBSTEPS, SUBSTEPS_OF_PART = 8, 16  # samples of the excursion in a whole servo period, and in a part of one
PARTS = (1, 2, 4, 8, 16, 32)  # numbers of parts of a servo period; the ends of each are among those of the next


@dataclass(frozen=True, repr=False)
class OutputLimit(Limit):
    """|output + nominal| <= limit for all t.

    Attributes
    ----------
    limit : > 0.
    nominal : (N + 1,) the nominal motion's part of the output at tau_0 to tau_N.
    largest : bound on |c_k|.
    bends : (fits, S, 2) for every device: coefficients of bounds on the excursion from the chord, by the largest
        output without the nominal motion and by the largest command. Each fit is a valid bound; the smallest counts.
    parts : number of parts of a servo period at whose ends the limit is stated; one of `PARTS`.
    output : name of the limited output. grading : exponent p of the ends (j / parts)^p.
    straight : whether the excursion is that from the chord; if not, from the nearest point between both ends' values.
    """

    output: ClassVar[str]
    of_each_device: ClassVar[bool] = True
    grading: ClassVar[int] = 2
    straight: ClassVar[bool] = True

    limit: float
    nominal: FloatArray
    largest: float
    bends: tuple[FloatArray, ...]
    parts: int = 1

    def __post_init__(self) -> None:
        positive(self.key, self.limit)

    def margin(self, device: int = 0) -> float:
        """Margin taken off the limit for the time between the instants at which it is stated."""
        return min(self.excursion(device), MOST_KEPT * self.limit)

    def excursion(self, device: int = 0) -> float:
        """Bound on the excursion of the output from its chord between two such instants."""
        curved = float(np.abs(np.diff(self.nominal, 2)).max(initial=0.0)) / 8
        most = self.limit + float(np.abs(self.nominal).max())
        return float((self.bends[device] @ (most, self.largest)).min(axis=0).max()) + curved

    @staticmethod
    @abstractmethod
    def nominal_part(setting: Setting) -> FloatArray:
        """(N,) the nominal motion's part of the output at tau_k."""

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        stage, own = setting.stage, cls.nominal_part(setting)
        # The nominal motion is extrapolated linearly to tau_N.
        nominal = np.append(own, 2 * own[-1] - own[-2] if own.size > 1 else own[-1])
        largest = setting.input_limit(asked) if stage.amplifier is None else stage.amplifier.command_limit
        whole, stages = (Fraction(1),), setting.grid.stages
        bends = tuple(_bends(device, cls.output, stages, whole, cls.straight) for device in setting.devices)
        return cls(asked[cls.key], nominal, largest, bends)

    def within(self, problem: Posed, parts: int) -> Self:
        """The limit stated at the ends of so many parts of every servo period."""
        if parts == self.parts:
            return self
        ends = (*self.shares(parts), Fraction(1))
        stages = problem.grid.stages
        bends = tuple(_bends(device, self.output, stages, ends, self.straight) for device in problem.devices)
        return replace(self, bends=bends, parts=parts)

    @classmethod
    def shares(cls, parts: int) -> tuple[Fraction, ...]:
        """Ends of the parts as shares of a servo period, without the last one, which is 1."""
        return tuple(Fraction(j, parts) ** cls.grading for j in range(1, parts))

    @property
    def stated(self) -> float:
        return self.limit

    def wider(self, factor: float) -> Self:
        return replace(self, limit=factor * self.limit)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        # No command changes the output at tau_0, so the rows begin after it and go on to tau_N.
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
        # At tau_0 no command acts yet, and until tau_1 the first one can move the output by `reach` only.
        reach = self._reach(problem)
        start = max(
            abs(float(self.nominal[0])), abs(float(self.nominal[1])) + float(max(self._kept(problem) - reach))
        )
        if start <= self.limit + self.tolerance:
            return ""
        return (
            f"{self.missed(start - self.limit)} at "
            f"{problem.grid.switching_times_s[0] * 1e3:.1f} ms by the motion of the incoming stylus alone"
        )

    def _kept(self, problem: Posed) -> FloatArray:
        """(S,) margin for every device."""
        return np.array([self.margin(device) for device in range(len(problem.devices))])

    def _reach(self, problem: Posed) -> FloatArray:
        """(S,) largest change of every device's output by the first command within its period."""
        largest = problem.limits.command_bound(ideal=problem.stage.amplifier is None)
        return np.array([largest * abs(device.output(self.output + AFTER)[1]) for device in problem.devices])

    def unresolved(self, problem: Posed, command: FloatArray, peak: float) -> str:
        if all(self.excursion(device) <= self.margin(device) for device in range(len(self.bends))):
            return ""
        return (
            f"{self.missed(peak - self.limit)} between two switching instants, despite a "
            f"margin of {MOST_KEPT:.0%} at time.dt_s = {problem.grid.dt_s:g} s"
        )

    def replayed(self, peak: float) -> str:
        return f"replayed {self.label} {peak:.6g} {self.unit}, limit {self.limit:g} {self.unit}"


def largest_of(rows: Iterable[Row], problem: Posed) -> float:
    """Bound on the values of rows under any admissible command: L1 norm of the response times the largest command."""
    largest = problem.limits.command_bound(ideal=problem.stage.amplifier is None)
    impulse = np.eye(1, problem.grid.stages)[0]
    motions, most = [device.motion(impulse) for device in problem.devices], 0.0
    for row in rows:
        responses = np.abs(replace(row, offset=0.0).value(motions[row.device], impulse))
        most = max(most, float((np.cumsum(responses) * largest + np.abs(row.offset)).max()))
    return most


def row_within(name: str, share: Fraction) -> str:
    """Name of a limit's row at this share of a servo period."""
    return name if share == 1 else f"{name}_{share.numerator}_of_{share.denominator}"


def _bends(stage: StageModel, output: str, stages: int, ends: tuple[Fraction, ...], straight: bool) -> FloatArray:
    """`OutputLimit.bends` of one device, cached in the stage model for the other entries of its grip."""
    kind = "bends", output, stages, ends, straight
    return stage.kept(kind, (), None, lambda: _bends_of(stage, output, stages, ends, straight))


def _bends_of(stage: StageModel, output: str, stages: int, ends: tuple[Fraction, ...], straight: bool) -> FloatArray:
    """(1 + fits, S, 2) bounds on the excursion e of y at S instants, by max |y(tau_k)| and max |c|.

    Both e and y(tau_k) are linear in the commands so far, and the limit bounds y(tau_k). So for any numbers a_l

        |e| <= sum |a_l| max |y| + sum |e - sum_l a_l y(tau_(k+1-l))| max |c|,

    the second sum over the response to one command. Least-squares fits of that response choose the a_l such that most
    of a resonance's long memory cancels. The first bound has a_l = 0; it is the only one where the limit is not
    stated within the period.
    """
    row, impulse = stage.outputs[output], np.eye(1, stages + 1)[0]
    states, alone, until = stage.states(impulse), len(ends) == 1, np.eye(row.size + 1)
    curve = np.append(row, 0.0) @ stage.flow @ stage.flow
    at, reached, size, curved = states @ row, states[:-1], np.abs(states).sum(axis=0), list[float]()
    bent, start, substeps = list[FloatArray](), at[:-1], SUBSTEPS if alone else SUBSTEPS_OF_PART
    lengths_s = stage.dt_s * np.diff(np.array([0, *ends], dtype=float)) / substeps
    for length_s, ended in zip(lengths_s, ends, strict=True):
        course, step, steepest = [start], exponential(stage.flow * length_s), 0.0
        for j in range(1, substeps + 1):
            if not alone:
                steepest = max(steepest, float(np.abs(reached @ curve[:-1] + impulse[:-1] * curve[-1]).sum()))
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
        curved.append(steepest)
        way = start - course[0]
        for j in range(1, substeps):
            gone = course[j] - course[0]
            share = j / substeps if straight else float(np.clip(gone @ way / (way @ way or 1.0), 0.0, 1.0))
            bent.append(gone - share * way)
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
    unseen = [_unseen(stage, curve, most, size, g_s) for most, g_s in zip(curved, lengths_s, strict=True)]
    bounds[..., 1] += np.repeat(unseen, substeps - 1)
    return bounds


def _unseen(stage: StageModel, curve: FloatArray, curved: float, size: FloatArray, g_s: float) -> float:
    """Bound on the excursion of q from its chord within a substep of g seconds, per unit of command.

    It is g^2 / 8 times the largest curvature of q: that at the beginning of a substep, and what it gains within g,
    in which the states grow at most by the factor exp(|F| g), with F the generator of the motion.

    Parameters
    ----------
    curve : (n + 1,) row of the curvature q'' by states and command.
    curved : bound on the curvature at the beginning of any such substep.
    size : (n,) bound on the states at any time.
    """
    flow = stage.flow
    with np.errstate(over="ignore", invalid="ignore"):  # the growth of states much faster than the substep
        steepening = float(np.abs(curve @ flow) @ exponential(np.abs(flow) * g_s) @ np.append(size, 1.0))
        bound = g_s**2 / 8 * (curved + g_s * steepening)
    return bound if np.isfinite(bound) else np.inf


@dataclass(frozen=True, repr=False)
class StrokeLimit(OutputLimit):
    """The limit on the displacement z of the motor mass from contact, as the encoder reads it [m]."""

    name: ClassVar[str] = "stroke"
    unit: ClassVar[str] = "m"
    key: ClassVar[str] = "stroke_m"
    needs: ClassVar[tuple[str, ...]] = ("position",)
    said_without: ClassVar[str] = "the scene states no stroke limit"
    output: ClassVar[str] = "position"
    grading: ClassVar[int] = 1

    @staticmethod
    def nominal_part(setting: Setting) -> FloatArray:
        return setting.nominal_m


@dataclass(frozen=True, repr=False)
class VelocityLimit(OutputLimit):
    """The limit on the velocity dz/dt of the motor mass [m/s]; it begins at the incoming speed."""

    name: ClassVar[str] = "velocity"
    unit: ClassVar[str] = "m/s"
    key: ClassVar[str] = "velocity_m_s"
    needs: ClassVar[tuple[str, ...]] = ("velocity",)
    said_without: ClassVar[str] = "the scene states no velocity limit"
    output: ClassVar[str] = "velocity"

    @staticmethod
    def nominal_part(setting: Setting) -> FloatArray:
        return setting.nominal_m_s
