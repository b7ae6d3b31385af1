"""Data shared by the entries of a scene: devices by grip and references by speed and grip, each computed once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from transopt.base.kept import Kept
from transopt.library.posed import with_laws
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import StageModel
from transopt.plant.nonlinear import NonlinearCoil
from transopt.problem.objective.figures import Yardstick
from transopt.problem.objective.target import Target
from transopt.problem.posing import Posing, Wanted
from transopt.problem.problem import TransientProblem
from transopt.proof.designed import Designed
from transopt.recordings.recording import Recording
from transopt.references.reference import Reference
from transopt.references.references import Cells, References
from transopt.scene.recordings import references_of, sampled_again
from transopt.scene.scene import Scene

KEPT_BETWEEN = 32
Spot = tuple[float, float] | None  # normal and posture of an arm, by number from 1, or between two
Devices = dict[tuple[float, Spot], tuple[StageModel, tuple[StageModel, ...]]]


@dataclass(frozen=True)
class Posed:
    """A problem, with everything else that is needed to solve it and to report its answer.

    Attributes
    ----------
    problem : objective and limits of the command; for a nonlinear plant those of the plant linearised at rest.
    speed_m_s, grip_N, target : where the entry stands in a library; speed and grip are 0 for a named target.
    place : normal and posture of an arm, by number from 1; None for any other plant.
    objective : "waveform" minimises J, "intensity" asks for the energy of the tap too.
    coil : the motor's coil, for the replay; None where it is not known.
    steady_input : largest plant input that the actuator bears continuously [A or V], a limit of the baselines.
    repeatability : trial-to-mean error of its recordings; NaN if unknown.
    uncorrected : the target against which errors are reported; None for the target that the problem tracks.
    plant : the nonlinear plant; None for a linear one.
    warmer : an answer; this one may make at most `cool_share` of its heat. None without such a bound.
    """

    problem: TransientProblem
    speed_m_s: float = 0.0
    grip_N: float = 0.0
    target: str = ""
    objective: str = "waveform"
    coil: CoilModel | None = None
    steady_input: float = float("inf")
    repeatability: float = float("nan")
    uncorrected: Target | None = None
    plant: NonlinearCoil | None = None
    warmer: Designed | None = None
    cool_share: float = 1.0
    place: Spot = None


class Context:
    """Devices, references and posing of one scene.

    Parameters
    ----------
    scene : whose entries are posed.
    references : those of the scene's recordings or named targets, or a function that computes them on first use.
    """

    def __init__(self, scene: Scene, references: References | Callable[[], References] | None = None) -> None:
        self.scene, self._given = scene, references
        self._between: Kept[Reference] = Kept(KEPT_BETWEEN)
        self._varied_from: tuple[tuple[object, ...], Devices] | None = None

    @classmethod
    def recorded(cls, scene: Scene, recordings: Sequence[Recording]) -> "Context":
        """Create the context of a scene with its recordings; references are computed on first use.

        Raises
        ------
        InputError : recordings that cannot be used; raised when the references are first used.
        """
        return cls(scene, lambda: references_of(scene, recordings))

    def varied(self, scene: Scene) -> "Context":
        """Create the context of a scene with other numbers; it shares these references.

        If its time axis differs, the references are resampled. Otherwise references between the recorded ones are the
        same objects, with all that was computed of them.
        """
        if scene.time_grid() != self.scene.time_grid():
            return Context(scene, lambda: sampled_again(scene, self.references))
        # Known references are handed over themselves, so that no context keeps the one that it was varied from.
        found = Context(scene, vars(self).get("references", lambda: self.references))
        found._between = self._between
        found._varied_from = (self._made_of, self._devices) if "_devices" in vars(self) else None
        return found

    @cached_property
    def references(self) -> References:
        """References of the recorded speeds and grips, or of the named targets."""
        given = self._given() if callable(self._given) else self._given
        return References() if given is None else given

    def reference(self, speed_m_s: float, grip_N: float, target: str = "") -> Reference:
        """The reference of a named target, or of a speed and a grip, interpolated between the recorded ones."""
        if target:
            return self.references.named(target)
        return self._between.get(repr((speed_m_s, grip_N)), lambda: self.references.at(speed_m_s, grip_N))

    @cached_property
    def cells(self) -> Cells:
        """References of all entries of the scene."""
        rows, grips = self.scene.axes.rows, self.scene.axes.grips_N

        def column(grip_N: float) -> list[Reference]:
            known = self.references if self.scene.targets else self.references.of_grip(grip_N)
            return [known.named(target) if target else known.at(speed_m_s, grip_N) for speed_m_s, target in rows]

        return Cells.of(map(column, grips), len(grips))

    @cached_property
    def posing(self) -> Posing:
        """The part of the problem that all taps of the scene share, with user-defined limits evaluated."""
        return with_laws(self._linear.posing())

    @cached_property
    def yardstick(self) -> Yardstick:
        """The error measures by which the scene's entries are compared with the recorded taps."""
        grid, named = self.posing.grid, bool(self.scene.targets)
        return Yardstick(grid, grid.end_s if named else self.posing.intention_s, named)

    @cached_property
    def _linear(self) -> Scene:
        """The scene with its plant linearised at rest; problems of a nonlinear plant are posed with it."""
        return self.scene.at_rest() if self.scene.nonlinear else self.scene

    @cached_property
    def plant(self) -> NonlinearCoil | None:
        """The nonlinear plant; None for a linear one."""
        return self.scene.nonlinear_plant() if self.scene.nonlinear else None

    @cached_property
    def _coil(self) -> CoilModel | None:
        """The motor's coil, one object shared by all entries."""
        return self.scene.coil()

    @cached_property
    def _devices(self) -> Devices:
        """Stage models by grip and place; those of the context that this one was varied from if they are the same."""
        before = self._varied_from
        return before[1] if before is not None and before[0] == self._made_of else {}

    @property
    def _made_of(self) -> tuple[object, ...]:
        """All that stage models depend on besides grip and place."""
        scene = self.scene
        return scene.model, scene.motor, scene.transmission, scene.tip, scene.robust, *self.posing.discretised_by

    def stage(self, grip_N: float, place: Spot = None) -> StageModel:
        """The stage model of one grip and, for an arm, of one place."""
        return self._device(grip_N, place)[0]

    def spread(self, grip_N: float) -> tuple[StageModel, ...]:
        """Stage models of the spread: further devices for which the commands of one grip are designed as well."""
        return self._device(grip_N, None)[1]

    def _device(self, grip_N: float, place: Spot) -> tuple[StageModel, tuple[StageModel, ...]]:
        at = grip_N, place
        if at not in self._devices:
            own, others = self._linear.plant(grip_N, place), self._linear.spread(grip_N)
            spread = tuple(self.posing.stage(of.plant(grip)) for of, grip in others)
            self._devices[at] = self.posing.stage(own), spread
        return self._devices[at]

    def posed(self, speed_m_s: float, grip_N: float, target: str = "", place: Spot = None) -> Posed:
        """Pose the problem of one entry of the scene.

        Raises
        ------
        InputError : numbers that define no valid problem, recordings that cannot be used.
        """
        return self.posed_as(self.reference(speed_m_s, grip_N, target), grip_N, place)

    def posed_as(self, reference: Reference, grip_N: float, place: Spot = None) -> Posed:
        """Pose the problem of tracking a reference with the device of one grip."""
        return self.posed_together([reference], grip_N, place)[0]

    def posed_together(self, references: Sequence[Reference], grip_N: float, place: Spot = None) -> list[Posed]:
        """Pose the problems of tracking references with the device of one grip, which share what they can."""
        scene = self.scene
        problems = self.posing.problems(list(map(wanted_of, references)), *self._device(grip_N, place))
        return [
            Posed(
                problem=problem,
                speed_m_s=reference.speed_m_s,
                grip_N=grip_N,
                target=reference.name,
                objective=scene.weights.objective,
                coil=self._coil,
                steady_input=scene.limits.steady_input,
                repeatability=reference.repeatability,
                plant=self.plant,
                place=place,
            )
            for reference, problem in zip(references, problems, strict=True)
        ]


def wanted_of(reference: Reference) -> Wanted:
    """The acceleration that a reference asks for, and the nominal motion on which it is superposed."""
    return Wanted(
        reference.speed_m_s,
        reference.target,
        reference.nominal_velocity_m_s,
        reference.nominal_position_m,
        reference.nominal_position_at_ticks_m,
        reference.ends_s,
        reference.slow_part_known,
    )
