"""An entry: the answer for one tap or named target, with everything that is said about it."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from transopt.base.axes import Axes
from transopt.base.shown import cut, html_figure, html_table, wrapped
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.base.writing import percent
from transopt.design.batch import Baselines, Batch
from transopt.design.context import Spot
from transopt.design.explain import Remedy
from transopt.design.intensity import best
from transopt.design.price import Price, binding, prices
from transopt.library.answered import Answered
from transopt.library.columns import COLUMNS, NAN, OF_DIRECTIONS, PAIR, EntryTable
from transopt.library.multipliers import ARRAYS
from transopt.problem.answer import Multipliers, Status, verdict
from transopt.problem.limits import kinds_of
from transopt.problem.objective.bands import Levels, normal_levels
from transopt.problem.objective.figures import Figures
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.admit import admit
from transopt.proof.certify import Box, boxes
from transopt.proof.designed import Attained, Designed
from transopt.proof.replay import Replay
from transopt.solvers import unlimited
from transopt.solvers.options import SolverOptions
from transopt.solvers.shape import Size, size
from transopt.solvers.side_by_side import alone

if TYPE_CHECKING:  # nothing is drawn while a library is solved
    from matplotlib.figure import Figure

ADMITTED = (Status.OPTIMAL, Status.STATIONARY)


@dataclass(frozen=True)
class SpreadErrors:
    """Errors of a robust entry over its devices: of the design for the node alone, and of its own.

    Each is the root of what a device loses in J (`Tracking.losses`), so that what comes after the window, or after
    the end of a target, counts as much as the scene has it count.

    Attributes
    ----------
    nominal, robust : of the entry's own device, for which the nominal design was made.
    nominal_rms, robust_rms : root of the mean square over the devices; a robust design minimises this or the worst.
    nominal_worst, robust_worst : the largest over the devices.
    """

    nominal: float
    nominal_rms: float
    nominal_worst: float
    robust: float
    robust_rms: float
    robust_worst: float


@dataclass(frozen=True, eq=False, repr=False)
class Entry(Answered):
    """One (speed, grip) or named target of a scene, and everything that is said about it.

    What is said is made when it is first read and then kept: the replay with those of the other answers of the same
    device, and what only some readers ask for, as prices, alone.

    Attributes
    ----------
    speed_m_s, grip_N : that it is for; 0 where it is for a named target.
    target : its name; empty for a tap.
    designed : the answer with its proof.
    batch : the answers of the same device, which are replayed together. index : of this one among them.
    repeatability : trial-to-mean error of the recordings; NaN if unknown.
    options : by which further optima are solved.
    objective : "waveform" or "intensity", as the scene asks.
    spot : normal and posture of an arm, by number from 1; None for any other plant.
    """

    speed_m_s: float
    grip_N: float
    target: str
    designed: Designed
    batch: Batch
    index: int
    repeatability: float
    options: SolverOptions
    objective: str
    spot: Spot = None

    def stating(self, **values: Any) -> "Entry":
        """Give the entry again with some of what is said of it stated, by name, in place of being made."""
        named = {field.name for field in fields(self)}
        found = replace(self, **{name: value for name, value in values.items() if name in named})
        made = {name: value for name, value in vars(self).items() if name not in named} | values
        vars(found).update({name: value for name, value in made.items() if name not in named})
        return found

    def let_go(self) -> None:
        """Drop the courses that the search and the certificate worked with; whoever asks for one makes it again.

        What is told of the entry is made first: admission and binding limits look at most of them.
        """
        _ = self.admitted and self.binding
        problem, effect = self.problem, self.designed.effect
        for of, courses in (
            (problem, ("rest",)),
            (problem.tracking, ("wanted", "weights", "unit_wanted", "solved_weights", "solved_wanted")),
            (problem.target, ("whole_m_s2", "free_m_s2", "recorded_m_s2", "continued_m_s2")),
            (effect, ("continued", "mean_square_A2", "rise_K")),
        ):
            for course in courses:
                vars(of).pop(course, None)

    @cached_property
    def played(self) -> Replay:
        """The command in continuous time."""
        return self.batch.replays[self.index]

    @cached_property
    def baselines(self) -> Baselines:
        """Errors of the two other methods."""
        return self.batch.rivals[self.index]

    @cached_property
    def told(self) -> Target:
        """Target against which errors are told, where refinement asks the device for another one."""
        return self.batch.told[self.index]

    @cached_property
    def floor(self) -> float:
        """Tap error of the optimum without limits."""
        if self.told is self.problem.target:
            return self.designed.floor
        free = self.designed.unlimited_command
        if self.problem.intensity > 0:
            # A price on intensity moves that optimum; the floor is that of the waveform alone.
            free = unlimited.solve([self.problem.without_intensity()])[0].command
        return self.problem.yardstick.tap_error(self.told, self.problem.stage.rollout(free)[0])

    @property
    def free_peak(self) -> float:
        """Largest plant input of the optimum without limits."""
        return self.designed.free_peak

    @cached_property
    def _admission(self) -> tuple[Status, list[str]]:
        return admit(self.designed, self.played)

    @cached_property
    def status(self) -> Status:
        """How it ended; an entry of a library is OPTIMAL, or on a nonlinear plant STATIONARY."""
        return self._admission[0]

    @cached_property
    def shortfalls(self) -> list[str]:
        """What speaks against it, one sentence each; empty where it is admitted."""
        return self._admission[1]

    @property
    def admitted(self) -> bool:
        """Whether it may stand in a library."""
        return self.status in ADMITTED

    @cached_property
    def prices(self) -> list[Price]:
        """What each limit that binds costs, the dearest first; each is two to four optima more."""
        designed = self.designed
        if self.status is not Status.OPTIMAL:
            return []
        with one_blas_thread():
            return prices(
                designed.problem,
                designed.solution.command,
                designed.solution.multipliers,
                designed.unlimited_command,
                self.options,
                effect=designed.effect,
            )

    @cached_property
    def spread(self) -> SpreadErrors | None:
        """Errors over the spread of devices; None for an entry designed for one device, or refused."""
        if not self.problem.spread or self.status is not Status.OPTIMAL:
            return None
        # Made for the node alone, and asked for the same.
        with one_blas_thread():
            nominal = alone(best(self.problem.alone(), self.options, objective=self.objective)).solution.command
        return _spread_errors(self.problem, nominal, self.solution.command)

    @cached_property
    def remedies(self) -> tuple[Remedy, ...]:
        """What would do for a refused entry, or what was tried; empty unless a build has looked for it."""
        return ()

    @cached_property
    def linear_played(self) -> Replay | None:
        """Replay of `linear_command` on the nonlinear plant."""
        return None if self.designed.linear is None else self.batch.linear_replays[self.index]

    @property
    def linear_tap_error(self) -> float:
        """Tap error of that command on the nonlinear plant; NaN for a linear plant, and without a finite motion."""
        played = self.linear_played
        error = NAN if played is None else played.figures.tap_error
        return error if np.isfinite(error) else NAN

    @cached_property
    def linear_leaves(self) -> list[str]:
        """Limits that the linear design leaves on the nonlinear plant, one sentence each."""
        played = self.linear_played
        return [] if played is None else [x.replayed(played.peak(x)) for x in self.problem.limits if played.leaves(x)]

    @property
    def off_replay(self) -> float:
        """Largest difference of the predicted y'' to the replay's, relative to its peak: the stage's own error."""
        off = float(np.abs(self.predicted_m_s2 - self.played.acceleration_m_s2).max())
        return off / max(self.played.scale_m_s2, float(np.finfo(float).tiny))

    @property
    def attained(self) -> Attained | None:
        """What was found of the energy that was asked for; None where the scene asks for none."""
        return self.designed.attained

    @property
    def solved(self) -> TransientProblem | None:
        """The problem that a program was made of; None where one linear solve was enough."""
        return self.designed.solved

    @cached_property
    def left_out(self) -> dict[str, str]:
        """Part of the problem -> why it is not in it."""
        return {**not_asked_for(self.problem, self.grip_N), **self.designed.left_out}

    def __repr__(self) -> str:
        error = f"{percent(self.figures.tap_error)} %"
        if not self.admitted:
            found = f"refused: {cut('; '.join(self.shortfalls) or self.status.value)}"
        elif self.designed.linear is not None:
            found = f"tap error {error}, of the linear design {percent(self.linear_tap_error)} %"
        else:
            found = f"tap error {error}, felt error {percent(self.figures.felt_error)} %; {self.verdict}"
        binds = f"; binds: {cut(self.binding)}" if self.admitted else ""
        return wrapped(f"Entry({self.place}: {found}{binds})")

    @property
    def place(self) -> str:
        """Which entry it is, in a sentence."""
        return self._axes.place(0, 0)

    @property
    def device(self) -> str:
        """Which device it is for, in a sentence."""
        return self._axes.device(0)

    @property
    def cells(self) -> list[str]:
        """Which entry it is, in the columns of a table (`Axes.columns`)."""
        return self._axes.cells(0, 0)

    @property
    def columns(self) -> list[str]:
        """Heads of `cells`."""
        return self._axes.columns

    @property
    def _axes(self) -> Axes:
        targets = (self.target,) if self.target else ()
        return Axes((self.speed_m_s,), (self.grip_N,), targets, () if self.spot is None else (self.spot,))

    def value(self, column: str) -> Any:
        """What the entry has in a column of `transopt.library.columns.COLUMNS`."""
        stored = COLUMNS[column].array
        if column in OF_DIRECTIONS and not self.problem.directions:
            return NAN
        if not stored:
            return VALUES[column](self)
        array = ARRAYS[stored]
        if array.made is None or (COLUMNS[column].after and self.problem.grid.after_stages == 0):
            return COLUMNS[column].unknown
        return array.made(self)

    @property
    def refusal(self) -> str:
        """Why it is refused, in the words of its status; empty for an entry that is admitted."""
        return "" if self.admitted else self.status.value

    def _repr_html_(self) -> str:
        """Table, a row for each column, and figure in a notebook."""
        names = ("tap", "floor", "felt", "felt_dB", "speed", "bump", "heat", "peak", "gap", "binding", "verdict")
        shown = EntryTable((), names, (self,), self.unit)
        rows = [["entry", self.place], *map(list, zip(shown.heads, shown.figures(self), strict=True))]
        rows += [["why it is refused", said] for said in self.shortfalls]
        return html_table(repr(self), ["", ""], rows) + html_figure(self.plot())

    def plot(self) -> "Figure":
        """The waveform over time: acceleration beside its reference, current beside its limit.

        The figure is matplotlib's; `savefig` writes it to a file.
        """
        from transopt.report.transients import entries_figure

        return entries_figure([[self]])

    @cached_property
    def size(self) -> Size | None:
        """Size of the program that was solved; None where one linear solve was enough."""
        return None if self.solved is None else size(self.solved)

    @property
    def made_m_s2(self) -> FloatArray:
        """(N,) y'' by which figures are told, that of the replay."""
        return self.played.acceleration_m_s2

    @property
    def figures(self) -> Figures:
        """How near the played tap comes to the recorded one."""
        return self.played.figures

    @property
    def slopes(self) -> dict[str, float]:
        """Limit that binds -> by how much J falls per unit by which it is raised, from the multipliers alone.

        It is the slope at the limit as it stands. What a step buys is less, since the slope flattens on the way: see
        `prices`, which are solved for.
        """
        if self.problem.reference_is_zero:
            return {}
        return binding(self.problem, self.solution.command, self.solution.multipliers, effect=self.designed.effect)

    def boxes(self, command: FloatArray | None = None) -> list[Box]:
        """Every limit along a command, with its bounds.

        Parameters
        ----------
        command : (N,) another command in this entry's problem, without multipliers; by default the entry's own.
        """
        problem, solution = self.problem, self.solution
        multipliers = solution.multipliers if command is None else Multipliers.zero(problem)
        command = solution.command if command is None else command
        return boxes(problem, command, problem.stage.motion(command), multipliers)

    @cached_property
    def levels(self) -> Levels:
        """Energies of the predicted acceleration over those of r: broadband, as felt, band by band."""
        return normal_levels(self.problem.target, self.predicted_m_s2, self.problem.grid.dt_s)

    @property
    def verdict(self) -> str:
        """How good it is, see `transopt.problem.answer.verdict`; the floor of a plant at rest measures no other."""
        if not self.admitted:
            return "refused"
        if self.problem.reference_is_zero:
            return "zero reference"
        floor = self.floor if self.designed.nonlinear is None else NAN
        named = bool(self.target)
        # No motor of several pulls by itself.
        least = None if self.problem.stage.motors > 1 else (float(self.plant_input.min()), self.unit)
        return verdict(
            self.figures, floor, self.repeatability, self.levels, self.binding, named=named, least_input=least
        )


# What an entry has in the columns of `transopt.library.columns.COLUMNS` that no file holds.
VALUES: dict[str, Callable[[Entry], Any]] = {
    "linear": lambda entry: PAIR if entry.linear_played is None else (entry.linear_promised, entry.linear_tap_error),
    "linear_after": lambda entry: NAN if entry.linear_played is None else entry.linear_played.figures.error_after,
    "seed": lambda entry: (entry.baselines.seed.tap_error, entry.baselines.seed_steady.tap_error),
    "clipped": lambda entry: (entry.baselines.clipped.tap_error, entry.baselines.clipped_steady.tap_error),
    "repeats": lambda entry: entry.repeatability,
    "gap": lambda entry: entry.certificate.relative_gap,
    "result": lambda entry: "; ".join([entry.status.value, *entry.shortfalls]),
    "verdict": lambda entry: entry.verdict,
}


def not_asked_for(problem: TransientProblem, grip_N: float) -> dict[str, str]:
    """Parts that the scene of a problem does not ask for, each with the reason."""
    stage = problem.stage
    # A black box has no position, and the state of its other grip that a node does not need is none.
    idle = stage.idle_states if stage.plant.Ce.any() else 0
    parts = {
        "feedback": (problem.wall is None, "the scene has no wall"),
        "position": (
            problem.wall is None and not problem.stage.outputs,
            "nothing in the scene depends on it" + (f": {idle} state fewer" if idle else ""),
        ),
        "amplifier": (problem.stage.amplifier is None, "ideal in the scene"),
        "hand": (grip_N == 0, "free device, grip 0"),
        "rapid": (
            all(term.error_filter is None for term in problem.terms),
            "the scene weighs all frequencies alike",
        ),
        "heat price": (problem.heat_price == 0, "the scene states none"),
    }
    limits = {
        kind.name: (kind.name not in problem.limits, kind.said_without)
        for kind in kinds_of(problem.driven_by)
        if kind.said_without
    }
    parts = {**parts, **limits}
    return {part: reason for part, (missing, reason) in parts.items() if missing}


def _spread_errors(problem: TransientProblem, nominal: FloatArray, command: FloatArray) -> SpreadErrors | None:
    """Over the devices of a robust entry, of its command and of the command designed for the node alone."""
    if not problem.spread:
        return None
    own, robust = (np.sqrt(problem.tracking.losses(problem.accelerations(c))) for c in (nominal, command))

    def rms(errors: FloatArray) -> float:
        return float(np.sqrt(np.mean(errors**2)))

    return SpreadErrors(
        nominal=float(own[0]),
        nominal_rms=rms(own),
        nominal_worst=float(own.max()),
        robust=float(robust[0]),
        robust_rms=rms(robust),
        robust_worst=float(robust.max()),
    )
