"""The problems that a library file states, by its scene and arrays: devices, limits, targets, nominal motions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.axes import Axes
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.library.held import Held
from transopt.library.meta import most_parts, parts_of
from transopt.library.multipliers import pairs_of
from transopt.library.place import interpolation_weights, speed_weights
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import StageModel
from transopt.plant.state_space import Input, Output, StateSpace
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import Wall
from transopt.problem.answer import Multipliers, Status
from transopt.problem.limits import OF_OUTPUTS
from transopt.problem.limits.own import OwnLimit
from transopt.problem.objective.figures import Yardstick
from transopt.problem.objective.target import Target
from transopt.problem.posing import Posing, Wanted
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import pressing_under

if TYPE_CHECKING:  # a device that plays a library loads neither matplotlib nor pydantic for it
    from transopt.scene.scene import Scene

PLANT = ("A", "B", "C", "D", "Ce")
# What is proven for commands that are no proven optima; every display of such a library prints it.
NONLINEAR_CLAIM = (
    "nonlinear plant: each command is a certified stationary point, replayed on that plant; no bound says that there "
    "is no better one, and floor is of the plant as it is at rest"
)
STATIONARY_CLAIM = (
    "limit that is not convex: such a command is a certified stationary point, replayed; no bound says that there is "
    "no better one"
)


@dataclass(frozen=True)
class Posed(Held):
    """The problems of a library; `transopt.library.library.Library` adds the answers.

    The problem of an entry is the scene's in `meta`, with the plants and the targets of the arrays; nothing else
    states it.
    """

    multipliers_of: Mapping[str, FloatArray]
    meta: dict[str, Any]

    @property
    def nonlinear(self) -> bool:
        """Whether its commands are for a nonlinear plant."""
        return self.scene().nonlinear

    @property
    def claim(self) -> str:
        """One sentence on what is proven if the commands are not proven optima; empty if they are."""
        if self.nonlinear:
            return NONLINEAR_CLAIM
        return STATIONARY_CLAIM if self.is_stationary else ""

    @property
    def is_stationary(self) -> bool:
        """Whether a command of it is proven to be a stationary point, and not proven to be the optimum."""
        return bool((self.status == Status.STATIONARY.value).any())

    def check_linear(self, what: str) -> None:
        """Refuse an operation that needs a linear plant with one motor.

        Raises
        ------
        InputError : the plant is nonlinear or has several motors.
        """
        self.scene().check_one_motor(what)
        if self.nonlinear:
            raise InputError(
                f"{what}: this library's plant is nonlinear, and this is done with linear plants alone: verify, "
                "show, compare and export take it; for all else solve the scene without model.nonlinear"
            )

    @cached_property
    def axes(self) -> Axes:
        """The axes of its entries: speeds and grips, or named targets."""
        names = tuple(map(str, self.targets)) if self.scene().targets else ()
        places = self.scene().axes.places
        return Axes(tuple(self.speeds_m_s.tolist()), tuple(self.grips_N.tolist()), names, places)

    @property
    def dt_s(self) -> float:
        """Servo period."""
        return self.time_grid().dt_s

    @property
    def lead_s(self) -> float:
        """Time from the first command to contact."""
        return self.time_grid().lead_s

    @property
    def hand_over_samples(self) -> int:
        """Number of commands at the end that are the wall's own feedback; zero without a wall."""
        return self.posing().hand_over_samples

    @property
    def grip_min_N(self) -> float:
        """Grip below which nothing is played; 0 for the free device, which has no such bound."""
        return 0.0 if self.grips_N[0] == 0 else self.scene().grid.grip_min_N

    @property
    def input_limit(self) -> float:
        """Transient limit on the plant input."""
        return float(self.posing().asked[f"{self.driven_by.name}_{self.driven_by.unit}"])

    @property
    def steady_input(self) -> float:
        """Limit on the plant input that the actuator bears continuously; the baselines are computed at it too."""
        return float(self.posing().asked[f"steady_{self.driven_by.name}_{self.driven_by.unit}"])

    @property
    def yardstick(self) -> Yardstick:
        """The measures that compare its entries with the recorded taps."""
        named = bool(self.axes.targets)
        grid = self.time_grid()
        return Yardstick(grid, grid.end_s if named else self.posing().intention_s, named)

    def scene(self) -> "Scene":
        """The scene that the library was solved from, as stated in the file.

        Raises
        ------
        InputError : the scene is from another version, or was changed by hand.
        """
        return self._scene

    @cached_property
    def _scene(self) -> "Scene":
        return scene_in(self.meta)

    def posing(self) -> Posing:
        """What the problems of all taps share; for a nonlinear plant, those of the plant at rest."""
        return self._posing

    @cached_property
    def _posing(self) -> Posing:
        return with_laws(posing_of(self.scene()))

    def time_grid(self) -> TimeGrid:
        """Ticks, switching instants, and the number of samples after them that count."""
        return self.posing().grid

    @property
    def driven_by(self) -> Input:
        """The plant input: a current or a voltage."""
        return self.posing().driven_by

    def coil(self) -> CoilModel | None:
        """The motor's coil; None if the scene does not state one."""
        return self.posing().coil

    def wall(self) -> Wall | None:
        """The virtual wall; None without a wall."""
        return self.posing().wall

    def amplifier(self) -> Amplifier | None:
        """The amplifier; None for an ideal one, whose command is the plant's input."""
        return self.posing().amplifier

    def plant(self, ig: int) -> StateSpace:
        """The device at one grip, with the outputs that the user's own limits need."""
        by_grip = self.meta.get("outputs")  # missing if no limit needs an output
        A, B, C, D, Ce = (getattr(self, f"plant_{name}")[ig] for name in PLANT)
        outputs = _outputs(by_grip[ig] if by_grip else {})
        return StateSpace.from_matrices(A, B, C, D, Ce, outputs, self.driven_by)

    def stage(self, ig: int) -> StageModel:
        """Stage model at one grip, discretised from the plant in the file."""
        return self.posing().stage(self.plant(ig))

    def spread(self, ig: int) -> tuple[StageModel, ...]:
        """Further devices that the entries of one grip were designed for."""
        by_grip, found = self.meta.get("spread_outputs"), list[StageModel]()
        for j in range(self.spread_A.shape[1]):
            A, B, C, D, Ce = (getattr(self, f"spread_{name}")[ig, j] for name in PLANT)
            outputs = _outputs(by_grip[ig][j] if by_grip else {})
            plant = StateSpace.from_matrices(A, B, C, D, Ce, outputs, self.driven_by)
            found.append(self.posing().stage(plant))
        return tuple(found)

    def problem(self, iv: int, ig: int) -> TransientProblem:
        """The problem that entry (iv, ig) claims to solve, as one of `problems`."""
        return self.problems(ig, [iv])[0]

    def problems(self, ig: int, rows: Sequence[int]) -> list[TransientProblem]:
        """The problems that entries (iv, ig) claim to solve; an entry's own motion determines where a wall presses.

        For a nonlinear plant they are those of the plant at rest; `transopt.library.nonlinear.nonlinear_problem`
        puts their limits and objective on the nonlinear plant.

        Parameters
        ----------
        rows : iv of the entries, which share all that is computed from their device.
        """
        stage, *spread = self.stage(ig), *self.spread(ig)
        wanted = [self._corrected(iv, ig) for iv in rows]
        posed = self.posing().problems(wanted, stage, tuple(spread))
        return [self._claimed(problem, iv, ig) for problem, iv in zip(posed, rows, strict=True)]

    def _corrected(self, iv: int, ig: int) -> Wanted:
        wanted, correction = self.wanted_of(iv, ig), self.correction_m_s2[iv, ig]
        return replace(wanted, target=wanted.target.moved(correction)) if correction.any() else wanted

    def _claimed(self, problem: TransientProblem, iv: int, ig: int) -> TransientProblem:
        """The problem of a tap with the prices, shares, instants and ticks of the wall that its entry states."""
        posing, prices = self.posing(), (float(self.intensity[iv, ig]), float(self.heat_price[iv, ig]))
        if posing.worst or prices != (problem.intensity, problem.heat_price):
            shares = self._shares(iv, ig) if posing.worst else problem.shares
            problem = replace(problem, intensity=prices[0], heat_price=prices[1], shares=shares)
        problem = problem.within(self.parts(iv, ig))
        if problem.wall is None:
            return problem
        return pressing_under(problem, self.command[iv, ig])

    def parts(self, iv: int, ig: int) -> dict[str, int]:
        """Name of a limit on an output -> number of parts of a servo period at whose ends the entry states it.

        Raises
        ------
        InputError : a number of parts that no entry of a library has.
        """
        stated = self.instants_within[iv, ig].tolist()
        found = {kind.name: parts_of(within) for kind, within in zip(OF_OUTPUTS, stated, strict=True)}
        if max(found.values()) > most_parts(self.meta):
            raise InputError(f"instants_within = {max(stated):g}: more than meta.instants_within")
        return found

    def _shares(self, iv: int, ig: int) -> FloatArray:
        """(S,) weights of the devices in the J of the worst device, the nominal device first."""
        others = self.spread_share[iv, ig]
        return np.append(max(1.0 - others.sum(), 0.0), others)

    def lasting(self, iv: int, ig: int) -> tuple[FloatArray, FloatArray]:
        """(N + M,) predicted y'' and plant input of an entry at the switching instants, also after the window."""
        if self.nonlinear:
            # Only a nonlinear plant needs this import, which loads the scene and its readers.
            from transopt.library.nonlinear import nonlinear_problem
            from transopt.proof.nonlinear import NonlinearEffect

            lasting = NonlinearEffect(nonlinear_problem(self, iv, ig), self.command[iv, ig]).lasting
            return lasting.acceleration_m_s2, lasting.plant_input
        problem = self.problem(iv, ig)
        return problem.stage.rollout(problem.continued(self.command[iv, ig]))

    def uncorrected(self, iv: int, ig: int) -> Target:
        """r - a_free of an entry, which errors are measured against; it contains no correction."""
        return self.wanted_of(iv, ig).target

    def wanted_of(self, iv: int, ig: int) -> Wanted:
        """The recorded target of an entry and the nominal motion under it; it contains no correction."""
        ends_s = float(self.target_ends_s[iv]) if self.axes.targets else np.inf
        known = self.meta["slow_part_known"][iv][ig]
        return self._wanted(float(self.speeds_m_s[iv]), lambda course: course[iv, ig], ends_s, known)

    def wanted(self, speed_m_s: float, grip_N: float) -> Wanted:
        """Target and motion of a tap between the nodes: r / v is linear in speed (`speed_weights`) and in grip."""
        by_grip = interpolation_weights(self.grips_N, grip_N)
        weights = np.outer(speed_weights(self.speeds_m_s, speed_m_s), by_grip)
        known = bool(np.all(np.array(self.meta["slow_part_known"])[weights > 0]))

        def blended(course: FloatArray) -> FloatArray:
            return (weights.ravel() @ course.reshape(weights.size, -1)).reshape(course.shape[2:])

        return self._wanted(speed_m_s, blended, np.inf, known)

    def _wanted(self, speed_m_s: float, of: Callable[[FloatArray], FloatArray], ends_s: float, known: bool) -> Wanted:
        """Target and motion; `of` selects or blends a course (v, g, ...) of the nodes."""
        free, before, after = of(self.free_m_s2), of(self.free_before_m_s2), of(self.free_after_m_s2)
        target = Target(
            of(self.recorded_m_s2) - free,
            of(self.recorded_after_m_s2) - after,
            of(self.recorded_before_m_s2) - before,
            free,
            after,
            before,
        )
        at_ticks = np.append(of(self.nominal_position_at_ticks_m), of(self.nominal_after_at_ticks_m))
        velocity, position = of(self.nominal_velocity_m_s), of(self.nominal_position_m)
        return Wanted(speed_m_s, target, velocity, position, at_ticks, ends_s, known)

    def multipliers(self, iv: int, ig: int) -> Multipliers:
        """Multipliers of one entry."""
        stages = self.command.shape[-1]
        nothing = np.zeros(stages)
        sides = {name: self.multipliers_of[name][iv, ig] for name, priced in self._priced.items() if priced[iv, ig]}
        return Multipliers(stages, pairs_of(sides, nothing), self.mu_end[iv, ig], self.current_sign[iv, ig])

    @cached_property
    def _priced(self) -> dict[str, NDArray[np.bool_]]:
        """Name of a multipliers' array -> (v, g) whether the entry has any other than zero."""
        return {name: np.asarray(array.any(axis=-1)) for name, array in self.multipliers_of.items()}


def scene_in(meta: dict[str, Any]) -> "Scene":
    """The scene of a library's `meta`.

    Raises
    ------
    InputError : the scene is from another version, or was changed by hand.
    """
    # Imported here so that a program which only names a library's type does not load pydantic.
    from pydantic import ValidationError

    from transopt.scene.file import explain
    from transopt.scene.scene import Scene

    try:
        return Scene.model_validate(meta["scene"])
    except ValidationError as error:
        raise InputError(f"{explain('meta.scene', error, meta['scene'])}; solve the scene again") from None


def posing_of(scene: "Scene") -> Posing:
    """What the problems of a scene share; for a nonlinear plant, those of the plant at rest."""
    return scene.at_rest().posing()


def with_laws(posing: Posing) -> Posing:
    """Add what evaluates the limits of a user's own that are not linear, where there is one."""
    if all(table["function"] is None for table in posing.asked.get(OwnLimit.key) or ()):
        return posing
    # Only such a limit needs CasADi.
    from transopt.solvers.own import law

    return replace(posing, law_of=law)


def _outputs(stored: Mapping[str, Mapping[str, Any]]) -> dict[str, Output]:
    """Further outputs of a plant as `StateSpace.stored` writes them."""
    return {name: Output(**{**each, "row": np.array([each["row"]])}) for name, each in stored.items()}
