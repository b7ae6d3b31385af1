"""Answers of entries, computed from command and model alone; and the answers that a library file holds."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.library.nonlinear import nonlinear_problem
from transopt.plant.nonlinear import NonlinearCoil
from transopt.problem.answer import Certificate, Multipliers, Solution, Status
from transopt.problem.objective.figures import Figures
from transopt.problem.objective.target import Target
from transopt.problem.objective.tracking import filter_together
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import binding_limits, certify
from transopt.proof.designed import Designed
from transopt.proof.effect import Effect, Free, effects, free_optima
from transopt.proof.nonlinear import NonlinearEffect, certify_nonlinear

NAN = float("nan")


class Answered:
    """Figures of an answer that follow from its command and its model, whether or not it was replayed.

    Attributes
    ----------
    designed : the answer with its proof.
    """

    designed: Designed

    @property
    def uncorrected(self) -> Target:
        """Target that errors are measured against."""
        return self.problem.target

    @property
    def problem(self) -> TransientProblem:
        """Problem with every limit of the scene; for a nonlinear plant it is the problem of the plant at rest."""
        return self.designed.problem

    @property
    def solution(self) -> Solution:
        """Command (N,) and its multipliers."""
        return self.designed.solution

    @property
    def certificate(self) -> Certificate:
        """Certificate of the answer."""
        return self.designed.certificate

    @property
    def unit(self) -> str:
        """Unit of the commands: "A" or "V"."""
        return self.problem.driven_by.unit

    @property
    def predicted_m_s2(self) -> FloatArray:
        """(N,) y'' of the command at the switching instants."""
        return self.designed.effect.motion.acceleration_m_s2

    @property
    def lasting_m_s2(self) -> FloatArray:
        """(N + M,) y'' of the command through the window and after it."""
        return self.designed.effect.lasting.acceleration_m_s2

    @property
    def after_m_s2(self) -> FloatArray:
        """(M,) y'' after the last command."""
        return self.lasting_m_s2[..., self.problem.grid.stages :]

    @property
    def plant_input(self) -> FloatArray:
        """(N,) plant input at the switching instants [A or V]."""
        return self.designed.effect.motion.plant_input

    @cached_property
    def transient_command(self) -> FloatArray:
        """(N,) the command without the wall's predicted feedback; the command itself without a wall."""
        return self.problem.transient_command(self.solution.command)

    @cached_property
    def binding(self) -> str:
        """The limits that bind, and when; empty if a command is NaN or infinite."""
        command, effect = self.solution.command, self.designed.effect
        if not np.isfinite(command).all():
            return ""
        return binding_limits(self.problem, command, self.solution.multipliers, effect=effect)

    @cached_property
    def heat_A2_s(self) -> float:
        """Integral of i^2, of all motors, over the window [A^2 s]; NaN where a voltage drives."""
        return self.problem.grid.dt_s * self.designed.effect.heat_A2 if self.unit == "A" else NAN

    @property
    def made_m_s2(self) -> FloatArray:
        """(N + M,) y'' that the figures are computed from."""
        return self.lasting_m_s2

    @property
    def tangential_error(self) -> float:
        """Error across the normal over the intention, relative to |r| along it; 0 for a plant with one direction."""
        return self.problem.yardstick.across(self.uncorrected, self.made_m_s2)[0] if self.problem.directions else 0.0

    @property
    def direction_rad(self) -> float:
        """Angle by which that error turns the acceleration; 0 for a plant with one direction."""
        return self.problem.yardstick.across(self.uncorrected, self.made_m_s2)[1] if self.problem.directions else 0.0

    @cached_property
    def energy_dB(self) -> float:
        """Energy of y'' over the energy of r within the window, after the error filter [dB]; 0 if r is zero."""
        if self.problem.reference_is_zero:
            return 0.0
        return self.problem.tracking.energy_dB(self.designed.effect.accelerations_m_s2)

    @property
    def unlimited_command(self) -> FloatArray:
        """(N,) the optimum of J without limits."""
        return self.designed.unlimited_command

    @cached_property
    def floor(self) -> float:
        """Tap error of that optimum; NaN where it was not found."""
        if self.uncorrected is self.problem.target:
            return self.designed.floor
        return self._by_stage_model(self.unlimited_command)

    @property
    def unlimited_objective(self) -> float:
        """J of that optimum; NaN where it was not found."""
        return self.designed.unlimited_objective

    @property
    def linear_command(self) -> FloatArray | None:
        """(N,) command designed for the plant at rest, kept beside the command for a nonlinear plant; else None."""
        linear = self.designed.linear
        return None if linear is None else np.nan_to_num(linear.solution.command)

    @cached_property
    def linear_promised(self) -> float:
        """Tap error of `linear_command` on the plant at rest; NaN for a linear plant."""
        if self.linear_command is None:
            return NAN
        return self._by_stage_model(self.linear_command)

    def _by_stage_model(self, command: FloatArray) -> float:
        """Tap error of another command (N,) on the linear device."""
        made_m_s2, _ = self.problem.stage.rollout(self.problem.continued(command))
        return self.problem.yardstick.tap_error(self.uncorrected, made_m_s2)


class Stored(Answered):
    """An answer as a library file states it: predicted by the stage model and not replayed.

    Parameters
    ----------
    uncorrected : target that errors are measured against.
    figures : distance of the predicted motion from that target.
    objective : "waveform" or "intensity", as in the scene.
    """

    def __init__(self, designed: Designed, uncorrected: Target, figures: Figures, objective: str) -> None:
        self.designed, self._uncorrected, self.figures, self.objective = designed, uncorrected, figures, objective

    @property
    def uncorrected(self) -> Target:
        return self._uncorrected

    @property
    def linear_tap_error(self) -> float:
        """Tap error of `linear_command` on the nonlinear plant; NaN if its motion is not finite."""
        if self.designed.nonlinear is None or self.linear_command is None:
            return NAN
        return self.designed.nonlinear.figures(self.linear_command).tap_error


def uncorrected_of(library: Library, iv: int, ig: int, problem: TransientProblem) -> Target:
    """Target that the errors of an entry are measured against: that of its problem but for a refined library."""
    return library.uncorrected(iv, ig) if library.correction_m_s2[iv, ig].any() else problem.target


Prove = Callable[[Sequence[tuple[Effect, Multipliers]]], list[Certificate]]
Unlimited = Callable[[Sequence[TransientProblem]], list[FloatArray | None]]


def answers_of(library: Library, grips: Sequence[int], prove: Prove, unlimited: Unlimited) -> list[Designed]:
    """The answers that the entries of some grips state, grips outermost, with certificates computed here.

    Parameters
    ----------
    grips : ig of each.
    prove : computes the certificates of commands and their multipliers in linear problems.
    unlimited : computes each problem's optimum (N,) without limits; None where it cannot.
    """
    rows = range(library.speeds_m_s.size)
    places = [(iv, ig) for ig in grips for iv in rows]
    plant = library.scene().nonlinear_plant() if library.nonlinear else None
    problems = [problem for ig in grips for problem in library.problems(ig, rows)]
    filter_together([problem.tracking for problem in problems])
    frees = _frees(problems, unlimited)
    if plant is not None:
        return [
            _on_plant(library, *place, plant, problem, free)
            for place, problem, free in zip(places, problems, frees, strict=True)
        ]
    made = effects([(problem, library.command[place]) for place, problem in zip(places, problems, strict=True)])
    answers = [_answer(library, *place, Status.OPTIMAL, Status.STATIONARY) for place in places]
    proofs = prove([(effect, answer.multipliers) for effect, answer in zip(made, answers, strict=True)])
    return list(map(_designed, problems, answers, proofs, made, frees))


def _frees(problems: Sequence[TransientProblem], unlimited: Unlimited) -> list[Free]:
    """The optimum of each problem without limits; zero for a zero reference, NaN where none was found."""
    asked = [problem for problem in problems if not problem.reference_is_zero]
    found = iter(unlimited([problem.without_intensity() for problem in asked]))
    commands = [problem.rest if problem.reference_is_zero else next(found) for problem in problems]
    known = [
        (problem, np.full_like(problem.rest, NAN) if command is None else command)
        for problem, command in zip(problems, commands, strict=True)
    ]
    return [free for _, free in free_optima(known)]


def _answer(library: Library, iv: int, ig: int, *accepted: Status) -> Solution:
    """Command, multipliers and status that the file states; `accepted` are statuses of a certified entry."""
    claimed = str(library.status[iv, ig])
    status = Status.OPTIMAL if claimed in [each.value for each in accepted] else Status.NOT_CERTIFIED
    spent = float(library.solve_time_s[iv, ig])
    return Solution(status, library.command[iv, ig], library.multipliers(iv, ig), "", claimed, 0, spent)


def _designed(
    problem: TransientProblem, answer: Solution, proof: Certificate, effect: Effect, free: Free
) -> Designed:
    return Designed(problem, answer, proof, effect, *free, {}, None, [])


def _on_plant(
    library: Library, iv: int, ig: int, plant: NonlinearCoil, problem: TransientProblem, free: Free
) -> Designed:
    """The answer that an entry of a nonlinear plant states, together with the linear design."""
    answer, nonlinear = _answer(library, iv, ig, Status.STATIONARY), nonlinear_problem(library, iv, ig, plant)
    effect = NonlinearEffect(nonlinear, answer.command)
    proof = certify_nonlinear(nonlinear, answer.command, answer.multipliers, effect=effect)
    # J is a sum of squares, so 0 is a lower bound.
    proof = replace(proof, lower_bound=0.0) if proof.finite else proof
    # The file holds no multipliers of the linear design: its certificate proves that it is feasible, not optimal.
    none, at_rest = Multipliers.zero(problem), Effect(problem, library.linear_command[iv, ig])
    stated = Solution(Status.NOT_CERTIFIED, at_rest.command, none, "", "", 0, 0.0)
    linear = _designed(problem, stated, certify(problem, at_rest.command, none, effect=at_rest), at_rest, free)
    return replace(_designed(problem, answer, proof, effect, free), nonlinear=nonlinear, linear=linear)
