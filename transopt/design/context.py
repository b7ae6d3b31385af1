"""What the entries of a scene share: its devices by grip, its references by speed and grip, each made once."""

import json
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

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
from transopt.recordings.reference import Reference
from transopt.recordings.references import Cells, References
from transopt.scene.recordings import references_of, sampled_again
from transopt.scene.scene import Scene

KEPT_STAGES, KEPT_BETWEEN = 64, 32
# What a stage model depends on, beside the outputs that the limits look at.
OF_A_STAGE = ("model", "motor", "transmission", "tip", "amplifier", "time", "feedback")
T = TypeVar("T")
Spot = tuple[float, float] | None  # normal and posture of an arm, by number from 1, or between two


class Kept(Generic[T]):
    """The values made last, by a text that says what they depend on."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._values: OrderedDict[str, T] = OrderedDict()

    def get(self, key: str, make: Callable[[], T]) -> T:
        """The value of a key, made if it is not there."""
        if key not in self._values:
            self._values[key] = make()
            if len(self._values) > self._most:
                self._values.popitem(last=False)
        self._values.move_to_end(key)
        return self._values[key]


def as_text(scene: Scene, *parts: str) -> str:
    """Parts of a scene as a text by which something that depends on them alone is kept."""
    return json.dumps(scene.model_dump(include=set(parts), mode="json"), sort_keys=True)


@dataclass(frozen=True)
class Posed:
    """A problem, and what else its answer is told by.

    Attributes
    ----------
    problem : what a command has to meet; of a nonlinear plant that of the plant at rest.
    speed_m_s, grip_N, target : where the entry stands in a library; speed and grip are 0 for a named target.
    place : normal and posture of an arm, by number from 1; None for any other plant.
    objective : "waveform" minimises J, "intensity" asks for the energy of the tap too.
    coil : of the motor, for the replay; None where nothing is known of it.
    steady_input : what the actuator stands for ever [A or V], at which the other methods are looked at.
    repeatability : trial-to-mean error of its recordings; NaN if unknown.
    told : the target against which errors are told; None for what the problem tracks.
    plant : the nonlinear plant; None for a linear one.
    warmer : the answer of which this one may make `cool_share` of the heat; None where the heat is left to J.
    """

    problem: TransientProblem
    speed_m_s: float = 0.0
    grip_N: float = 0.0
    target: str = ""
    objective: str = "waveform"
    coil: CoilModel | None = None
    steady_input: float = float("inf")
    repeatability: float = float("nan")
    told: Target | None = None
    plant: NonlinearCoil | None = None
    warmer: Designed | None = None
    cool_share: float = 1.0
    place: Spot = None


class Context:
    """Devices, references and posing of one scene.

    Parameters
    ----------
    scene : whose entries are posed.
    references : of its recordings or named targets, or what makes them when they are first asked for.
    stages : in which stage models are kept; contexts of varied scenes may share one.
    """

    def __init__(
        self,
        scene: Scene,
        references: References | Callable[[], References] | None = None,
        stages: Kept[StageModel] | None = None,
    ) -> None:
        self.scene, self._given = scene, references
        self.stages: Kept[StageModel] = Kept(KEPT_STAGES) if stages is None else stages
        self._between: Kept[Reference] = Kept(KEPT_BETWEEN)
        self._devices: dict[tuple[float, Spot], tuple[StageModel, tuple[StageModel, ...]]] = {}

    @classmethod
    def recorded(cls, scene: Scene, recordings: Sequence[Recording]) -> "Context":
        """The context of a scene with its recordings.

        Raises
        ------
        InputError : recordings that cannot serve, when the references are first asked for.
        """
        return cls(scene, lambda: references_of(scene, recordings))

    def varied(self, scene: Scene) -> "Context":
        """Give a scene with other numbers these references and the devices that are kept.

        On another time axis the references are sampled again.
        """
        if scene.time_grid() == self.scene.time_grid():
            return Context(scene, lambda: self.references, self.stages)
        return Context(scene, lambda: sampled_again(scene, self.references), self.stages)

    @cached_property
    def references(self) -> References:
        """References of the recorded speeds and grips, or of the named targets."""
        given = self._given() if callable(self._given) else self._given
        return References() if given is None else given

    def reference(self, speed_m_s: float, grip_N: float, target: str = "") -> Reference:
        """The reference of a speed and a grip, blended between those recorded, or of a named target."""
        if target:
            return self.references.named(target)
        return self._between.get(repr((speed_m_s, grip_N)), lambda: self.references.at(speed_m_s, grip_N))

    @cached_property
    def cells(self) -> Cells:
        """References of all entries of the scene."""
        rows, grips = self.scene.axes.rows, self.scene.axes.grips_N

        def made(i: int, j: int) -> Reference:
            speed_m_s, target = rows[i]
            return self.reference(speed_m_s, grips[j], target)

        return Cells.of(made, len(rows), len(grips))

    @cached_property
    def posing(self) -> Posing:
        """What the problems of all taps of the scene share, limits of a user's own evaluated."""
        return with_laws(self._linear.posing())

    @cached_property
    def yardstick(self) -> Yardstick:
        """How the entries of the scene are compared with the recorded taps."""
        grid, named = self.posing.grid, bool(self.scene.targets)
        return Yardstick(grid, grid.end_s if named else self.posing.intention_s, named)

    @cached_property
    def _linear(self) -> Scene:
        """The scene with its plant as it is at rest, by which a nonlinear one is posed."""
        return self.scene.at_rest() if self.scene.nonlinear else self.scene

    @cached_property
    def plant(self) -> NonlinearCoil | None:
        """The nonlinear plant; None for a linear one."""
        return self.scene.nonlinear_plant() if self.scene.nonlinear else None

    @cached_property
    def _coil(self) -> CoilModel | None:
        """Coil of the motor, the same object for all entries."""
        return self.scene.coil()

    def stage(self, grip_N: float, place: Spot = None) -> StageModel:
        """The device of one grip, and of an arm at one place, as the scene's problem needs it."""
        return self._device(grip_N, place)[0]

    def spread(self, grip_N: float) -> tuple[StageModel, ...]:
        """Further devices that the commands of one grip shall serve."""
        return self._device(grip_N, None)[1]

    def _device(self, grip_N: float, place: Spot) -> tuple[StageModel, tuple[StageModel, ...]]:
        at = grip_N, place
        if at not in self._devices:
            own = self._stage(self._linear, grip_N, place)
            self._devices[at] = own, tuple(self._stage(of, grip) for of, grip in self._linear.spread(grip_N))
        return self._devices[at]

    def _stage(self, of: Scene, grip_N: float, place: Spot = None) -> StageModel:
        posing = self.posing
        outputs = sorted(posing.watched)
        key = f"{grip_N!r} {place} {outputs} {as_text(of, *OF_A_STAGE)}"
        return self.stages.get(key, lambda: posing.stage(of.plant(grip_N, place)))

    def posed(self, speed_m_s: float, grip_N: float, target: str = "", place: Spot = None) -> Posed:
        """One entry of the scene.

        Raises
        ------
        InputError : numbers that make no problem, recordings that cannot serve.
        """
        return self.posed_as(self.reference(speed_m_s, grip_N, target), grip_N, place)

    def posed_as(self, reference: Reference, grip_N: float, place: Spot = None) -> Posed:
        """The entry of a device that a reference asks for."""
        scene, device = self.scene, self._device(grip_N, place)
        problem = self.posing.problem(wanted_of(reference), *device)
        return Posed(
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


def wanted_of(reference: Reference) -> Wanted:
    """What a reference asks of the device, and the nominal motion under it."""
    return Wanted(
        reference.speed_m_s,
        reference.target,
        reference.nominal_velocity_m_s,
        reference.nominal_position_m,
        reference.nominal_position_at_ticks_m,
        reference.ends_s,
        reference.slow_part_known,
    )
