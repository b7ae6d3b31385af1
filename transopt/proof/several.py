"""Independent continuous-time replay of commands of several motors.

The device is linear and starts at rest, so each acceleration is the sum of the responses to the single motors. Each
motor is simulated separately (`continuous`), on a plant with one input and one output; the design model has all
motors in one matrix exponential.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.plant.discretise import Motion, StageModel
from transopt.plant.state_space import StateSpace
from transopt.plant.time_grid import TimeGrid
from transopt.problem.limits.limit import Limits
from transopt.problem.problem import TransientProblem
from transopt.proof.continuous import accurate, fine, peak_scale
from transopt.proof.replay import Played, Replay


@dataclass(frozen=True)
class _Course:
    """One direction of M taps by all motors.

    Attributes
    ----------
    instants_m_s2 : (M, N + M_after) acceleration at the switching instants.
    fine_m_s2 : (M, K) acceleration at all samples.
    off_m_s2 : (M,) change of the motors' parts by halving the step.
    rounding_m_s2 : (M,) rounding error of the motors' parts.
    """

    instants_m_s2: FloatArray
    fine_m_s2: FloatArray
    off_m_s2: FloatArray
    rounding_m_s2: FloatArray


@one_blas_thread()
def replay_several(problems: Sequence[TransientProblem], commands: FloatArray) -> list[Replay]:
    """Play M commands (M, m, N) on one device from rest, and compare each with its target.

    Parameters
    ----------
    problems : one per command, all with the same device and time axis; targets and limits may differ.
    """
    first = problems[0]
    stage, grid = first.stage, first.grid
    courses, inputs, felt, after = _played(stage, grid, commands)
    instants = np.stack([each.instants_m_s2 for each in courses], axis=1)
    acceleration, later = np.split(instants, [grid.stages], axis=2)
    found = []
    for m, problem in enumerate(problems):
        rounding = max(float(each.rounding_m_s2[m]) for each in courses)
        peak = float(peak_scale(np.abs(acceleration[m]).max(), rounding))
        reached = _reached(problem.limits, stage, grid, inputs[m], felt[m])
        at = inputs[m][:, after.at_switching]
        found.append(
            Replay(
                acceleration_m_s2=acceleration[m] if first.directions else acceleration[m, 0],
                plant_input=at,
                figures=first.yardstick.figures(problem.target, instants[m]),
                after_m_s2=later[m] if first.directions else later[m, 0],
                peak_input=float(np.abs(inputs[m]).max()),
                peak_command=float(np.abs(commands[m]).max()),
                after_peak_m_s2=max(float(np.abs(each.fine_m_s2[m, after.start :]).max()) for each in courses),
                reached=reached,
                reached_while_stated=reached,
                winding_C=float("nan"),
                housing_C=float("nan"),
                command=commands[m],
                rounding_m_s2=rounding,
                step_error=max(float(each.off_m_s2[m]) for each in courses) / peak,
            )
        )
    return found


@dataclass(frozen=True)
class _Places:
    """Indices among the samples: those of the switching instants, and the first one after the waveform."""

    at_switching: NDArray[np.intp]
    start: int


def _played(
    stage: StageModel, grid: TimeGrid, commands: FloatArray
) -> tuple[list[_Course], FloatArray, FloatArray, _Places]:
    """Courses of all directions, inputs and acting commands (M, m, K), and sample indices."""
    plant, courses, inputs, felt = stage.plant, list[_Course](), [], []
    for i in range(plant.tracked):
        parts, off, rounding = [], [], []
        for j in range(plant.motors):
            run = accurate(_alone(stage, i, j), grid, commands[:, j], None)
            course = run.course
            trajectory = fine(course, run.flow, grid, moving=False)
            size = peak_scale(np.abs(run.acceleration_m_s2).max(axis=1), course.rounding(run.flow))
            parts.append((run.acceleration_m_s2, trajectory.acceleration_m_s2))
            off.append(run.step_error * size)
            rounding.append(course.rounding(run.flow))
            if i == 0:
                inputs.append(trajectory.plant_input)
                felt.append(trajectory.felt)
        instants, samples = (np.sum(each, axis=0) for each in zip(*parts, strict=True))
        courses.append(_Course(instants, samples, np.sum(off, axis=0), np.sum(rounding, axis=0)))
    over = int(np.searchsorted(trajectory.times_s, grid.end_s, side="right"))
    return courses, np.stack(inputs, axis=1), np.stack(felt, axis=1), _Places(trajectory.at_switching, over)


def _alone(stage: StageModel, direction: int, motor: int) -> StageModel:
    """The part of the device with one motor and one direction, cached in its stage model."""
    key = "alone", direction, motor
    if key not in stage.derived:
        plant, i, j = stage.plant, slice(direction, direction + 1), slice(motor, motor + 1)
        alone = StateSpace(plant.A, plant.B[:, j], plant.C[i], plant.D[i, j], driven_by=plant.driven_by)
        stage.derived[key] = replace(stage, plant=alone, outputs={}, instants={})
    found: StageModel = stage.derived[key]
    return found


def _reached(
    limits: Limits, stage: StageModel, grid: TimeGrid, inputs: FloatArray, felt: FloatArray
) -> dict[str, float]:
    """Name of a limit -> largest absolute value over all t, that of each motor divided by its share of the limit."""
    posed, nothing = Played((stage,), grid, limits), np.zeros(felt.shape[-1])
    motion = Motion(nothing, inputs, np.zeros_like(inputs), nothing)
    return {
        limit.name: max(
            (float(np.abs(row.value(motion, felt)).max()) / row.share for row in limit.watched(posed)), default=0.0
        )
        for limit in limits
    }
