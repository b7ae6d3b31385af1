"""What an entry of a scene has to meet: the device of its grip, the reference of its speed, and the limits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.design.intensity import best
from transopt.plant.discretise import StageModel
from transopt.problem.posing import Posing, Wanted
from transopt.problem.problem import TransientProblem
from transopt.recordings.recording import Recording
from transopt.recordings.reference import Reference
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.solvers.own import law

_last: list[tuple[Scene, Posing]] = []  # the scene that was asked for last, whose entries ask one after the other


def posing_of(scene: Scene) -> Posing:
    """What the problems of all taps of a scene share, limits of a user's own evaluated."""
    known = next((posing for of, posing in _last if of is scene), None)
    if known is None:
        known = replace(scene.posing(), law_of=law)
        _last[:] = [(scene, known)]
    return known


def scene_stage(scene: Scene, grip_N: float) -> StageModel:
    """The device of one grip as the scene's problem needs it."""
    return posing_of(scene).stage(scene.plant(grip_N))


def spread_stages(scene: Scene, grip_N: float) -> tuple[StageModel, ...]:
    """Further devices that the commands of one grip shall serve."""
    return tuple(posing_of(scene).stage(of.plant(grip)) for of, grip in scene.spread(grip_N))


def entry_problem(
    scene: Scene, stage: StageModel, reference: Reference, spread: tuple[StageModel, ...] = ()
) -> TransientProblem:
    """What one entry has to meet: the stage model of its grip, the reference of its speed."""
    return posing_of(scene).problem(wanted_of(reference), stage, spread)


def wanted_of(reference: Reference) -> Wanted:
    """What a reference asks of the device, and the nominal motion under it."""
    return Wanted(
        reference.speed_m_s,
        reference.target,
        reference.nominal_velocity_m_s,
        reference.nominal_position_m,
        reference.nominal_position_at_ticks_m,
        reference.ends_s,
    )


@dataclass(frozen=True)
class Commands:
    """The optima of a scene alone.

    Attributes
    ----------
    references : of the nv speeds or named targets.
    plant_input : (ng, nv, N) what drives the plant [A or V].
    predicted_m_s2 : (ng, nv, N) the acceleration that it adds.
    """

    references: list[Reference]
    plant_input: FloatArray
    predicted_m_s2: FloatArray

    __repr__ = brief


def optimal_commands(scene: Scene, recordings: Sequence[Recording]) -> Commands:
    """What `build.build_library` plays, without its replays, rivals and prices.

    Raises
    ------
    InputError : recordings that cannot serve, or parameters that are not passive at some grip.
    """
    references, options, found = references_of(scene, recordings), SolverOptions(), []
    for grip in scene.grid.grips_N:
        stage, spread = scene_stage(scene, grip), spread_stages(scene, grip)
        for reference in references:
            problem = entry_problem(scene, stage, reference, spread)
            designed = best(problem, options, objective=scene.weights.objective)
            found.append(designed.problem.stage.rollout(designed.solution.command))
    predicted, felt = (
        np.array(each).reshape(len(scene.grid.grips_N), len(references), -1) for each in zip(*found, strict=True)
    )
    return Commands(references, felt, predicted)
