"""An entry: the answer for one tap or named target, with every result derived from it."""

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
from transopt.problem.answer import Multipliers, Status, held_back, verdict
from transopt.problem.limits import kinds_of
from transopt.problem.objective.bands import Levels, normal_levels
from transopt.problem.objective.figures import Figures
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.admit import admit
from transopt.proof.designed import Attained, Designed
from transopt.proof.effect import Box, boxes
from transopt.proof.replay import Replay
from transopt.solvers.options import SolverOptions
from transopt.solvers.shape import Size, size
from transopt.solvers.side_by_side import alone

if TYPE_CHECKING:  # nothing is drawn while a library is solved
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class SpreadErrors:
    """Errors of a robust entry over its devices: those of the nominal design and those of the robust one.

    The nominal design is the optimum for the node's own device alone. An error is the square root of a device's loss
    in J (`Tracking.losses`). It therefore includes the motion after the window, or after the end of a target, with
    the weight that the scene gives it.

    Attributes
    ----------
    nominal, robust : error on the entry's own device.
    nominal_rms, robust_rms : root mean square over the devices; a robust design minimises this or the worst.
    nominal_worst, robust_worst : the largest error over the devices.
    """

    nominal: float
    nominal_rms: float
    nominal_worst: float
    robust: float
    robust_rms: float
    robust_worst: float


@dataclass(frozen=True, eq=False, repr=False)
class Entry(Answered):
    """The answer for one (speed, grip) or named target of a scene, with every result derived from it.

    Derived results are computed on first access and cached. The replay is computed together with those of the other
    answers of the same device; results that only some readers need, such as prices, for this entry alone.

    Attributes
    ----------
    speed_m_s, grip_N : speed and grip of the tap; 0 for a named target.
    target : name of the target; empty for a tap.
    designed : the answer with its proof.
    batch : the answers of the same device, which are replayed together. index : of this answer among them.
    repeatability : trial-to-mean error of the recordings; NaN if unknown.
    options : solver options for further optima, such as those behind the prices.
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
        """Return a copy in which the named results have the given values, instead of being computed on access."""
        named = {field.name for field in fields(self)}
        found = replace(self, **{name: value for name, value in values.items() if name in named})
        made = {name: value for name, value in vars(self).items() if name not in named} | values
        vars(found).update({name: value for name, value in made.items() if name not in named})
        return found

    def let_go(self) -> None:
        """Free the trajectories cached by search, certificate and replay; they are recomputed when read again."""
        self.batch.let_go()
        problem, effect = self.problem, self.designed.effect
        problem.unlimited.clear()
        # A nonlinear plant's motion would have to be integrated again.
        linear = self.designed.nonlinear is None
        rolled = ("motion", "lasting", "others", "accelerations_m_s2") if linear else ()
        for of, courses in (
            (problem, ("rest",)),
            (problem.tracking, ("wanted", "weights", "unit_wanted", "solved_weights", "solved_wanted")),
            (problem.target, ("whole_m_s2", "free_m_s2", "recorded_m_s2", "continued_m_s2")),
            (effect, ("continued", "mean_square_A2", "rise_K", "winding_C", "values", *rolled)),
        ):
            for course in courses:
                vars(of).pop(course, None)

    @cached_property
    def played(self) -> Replay:
        """Continuous-time replay of the command."""
        return self.batch.replays[self.index]

    @cached_property
    def baselines(self) -> Baselines:
        """Replayed figures of the two baseline methods."""
        return self.batch.rivals[self.index]

    @cached_property
    def uncorrected(self) -> Target:
        """Target against which errors are reported, without the correction that a refinement tracks as well."""
        return self.batch.uncorrected[self.index]

    @property
    def free_peak(self) -> float:
        """Largest plant input of the optimum without limits."""
        return self.designed.free_peak

    @cached_property
    def _admission(self) -> tuple[Status, list[str]]:
        return admit(self.designed, self.played)

    @cached_property
    def status(self) -> Status:
        """How the design ended; an entry of a library is OPTIMAL, or STATIONARY where the problem is not convex."""
        return self._admission[0]

    @cached_property
    def shortfalls(self) -> list[str]:
        """Reasons against admission, one sentence each; empty for an admitted entry."""
        return self._admission[1]

    @property
    def admitted(self) -> bool:
        """Whether the entry may be part of a library."""
        return self.status.admitted

    @cached_property
    def prices(self) -> list[Price]:
        """What each binding limit costs, the most expensive first; each price takes two to four further optima."""
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
                objective=self.objective,
                effect=designed.effect,
            )

    @cached_property
    def spread(self) -> SpreadErrors | None:
        """Errors over the spread of devices; None for an entry designed for one device, or refused."""
        if not self.problem.spread or self.status is not Status.OPTIMAL:
            return None
        # The nominal problem: the same objective for the node's own device alone.
        with one_blas_thread():
            nominal = alone(best(self.problem.alone(), self.options, objective=self.objective)).solution.command
        return _spread_errors(self.problem, nominal, self.solution.command)

    @cached_property
    def remedies(self) -> tuple[Remedy, ...]:
        """Changes that make a refused entry possible, or those tried in vain; empty unless a build searched them."""
        return ()

    @cached_property
    def linear_played(self) -> Replay | None:
        """Replay of `linear_command` on the nonlinear plant."""
        return None if self.designed.linear is None else self.batch.linear_replays[self.index]

    @property
    def linear_tap_error(self) -> float:
        """Tap error of `linear_command` on the nonlinear plant; NaN for a linear plant or if the motion diverges."""
        played = self.linear_played
        error = NAN if played is None else played.figures.tap_error
        return error if np.isfinite(error) else NAN

    @cached_property
    def linear_leaves(self) -> list[str]:
        """Limits that the linear design violates on the nonlinear plant, one sentence each."""
        played = self.linear_played
        return [] if played is None else [x.replayed(played.peak(x)) for x in self.problem.limits if played.leaves(x)]

    @property
    def off_replay(self) -> float:
        """Largest difference of predicted and replayed y'', relative to its peak: the stage model's own error."""
        return self.played.off(self.predicted_m_s2)

    @property
    def attained(self) -> Attained | None:
        """The energy attained beside the energy asked for; None where the scene asks for none."""
        return self.designed.attained

    @property
    def solved(self) -> TransientProblem | None:
        """The reduced problem that was solved as a program; None where one linear solve was enough."""
        return self.designed.solved

    @cached_property
    def left_out(self) -> dict[str, str]:
        """Part that was left out of the solved problem -> the reason."""
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
        """Speed and grip, or target, as text."""
        return self._axes.place(0, 0)

    @property
    def device(self) -> str:
        """The entry's device as text."""
        return self._axes.device(0)

    @property
    def cells(self) -> list[str]:
        """Speed and grip, or target, as the cells of a table row (`Axes.columns`)."""
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
        """The entry's value in a column of `transopt.library.columns.COLUMNS`."""
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
        """The status message of a refused entry; empty for an admitted one."""
        return "" if self.admitted else self.status.value

    def _repr_html_(self) -> str:
        """Table, a row for each column, and figure in a notebook."""
        names = ("tap", "floor", "felt", "felt_dB", "speed", "bump", "heat", "peak", "gap", "binding", "verdict")
        shown = EntryTable((), names, (self,), self.unit)
        rows = [["entry", self.place], *map(list, zip(shown.heads, shown.figures(self), strict=True))]
        rows += [["why it is refused", reason] for reason in self.shortfalls]
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
        """(N + M,) replayed y'', from which the figures are computed."""
        return self.played.lasting_m_s2

    @property
    def figures(self) -> Figures:
        """Figures of the replay: how near the played tap comes to the recorded one."""
        return self.played.figures

    @property
    def slopes(self) -> dict[str, float]:
        """Name of each binding limit -> decrease of J per unit by which the limit is raised, from the multipliers.

        This is the derivative at the present limit. A finite step gains less, since the slope flattens along it;
        `prices` are computed by solving the problem with the raised limit.
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

    @cached_property
    def held(self) -> list[str]:
        """The limits that hold the entry back (`held_back`); the floor of a plant linearised at rest is not used."""
        floor, free_J = (self.floor, self.unlimited_objective) if self.designed.nonlinear is None else (NAN, NAN)
        return held_back(self.figures.tap_error, floor, self.certificate.objective, free_J, self.binding)

    @property
    def verdict(self) -> str:
        """How good the entry is (`transopt.problem.answer.verdict`).

        On a nonlinear plant the floor is not used: it is that of the plant linearised at rest.
        """
        if not self.admitted:
            return "refused"
        if self.problem.reference_is_zero:
            return "zero reference"
        floor = self.floor if self.designed.nonlinear is None else NAN
        named = bool(self.target)
        # One motor's negative input means that the surface pulls; with several motors it does not.
        least = None if self.problem.stage.motors > 1 else (float(self.plant_input.min()), self.unit)
        return verdict(
            self.figures, floor, self.repeatability, self.levels, self.held, named=named, least_input=least
        )


# Values of the columns of `transopt.library.columns.COLUMNS` that are not stored in a library file.
VALUES: dict[str, Callable[[Entry], Any]] = {
    "linear": lambda entry: PAIR if entry.linear_played is None else (entry.linear_promised, entry.linear_tap_error),
    "linear_after": lambda entry: NAN if entry.linear_played is None else entry.linear_played.figures.error_after,
    "seed": lambda entry: (entry.baselines.seed.tap_error, entry.baselines.seed_steady.tap_error),
    "clipped": lambda entry: (entry.baselines.clipped.tap_error, entry.baselines.clipped_steady.tap_error),
    "repeats": lambda entry: entry.repeatability,
    "gap": lambda entry: entry.certificate.relative_gap,
    "result": lambda entry: "; ".join([entry.status.value, *entry.shortfalls]),
    "held": lambda entry: "; ".join(entry.held),
    "verdict": lambda entry: entry.verdict,
}


def not_asked_for(problem: TransientProblem, grip_N: float) -> dict[str, str]:
    """Parts that the scene of a problem does not ask for, each with the reason; the entries of a grip share them."""
    asked = grip_N, problem.wall is None, problem.heat_price
    same = (problem.limits, problem.terms)
    return problem.stage.kept(not_asked_for, same, asked, lambda: _not_asked_for(problem, grip_N))


def _not_asked_for(problem: TransientProblem, grip_N: float) -> dict[str, str]:
    stage = problem.stage
    # A black-box model has no position output (Ce = 0); its idle states are not those of a position.
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
    """Errors over a robust entry's devices, for its command and for the nominal command; None without a spread."""
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
