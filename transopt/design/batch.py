"""Replays of the answers of one device, made together, and the two other methods beside them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.coil import CoilModel
from transopt.problem.baselines import clipped_optimum, input_bounds, seed_inversion
from transopt.problem.objective.figures import Figures
from transopt.problem.objective.target import Target
from transopt.proof.continuous import Accurate, accurate
from transopt.proof.designed import Designed
from transopt.proof.replay import Replay, figures_of, replay, replayed_figures
from transopt.proof.several import replay_several


@dataclass(frozen=True)
class Baselines:
    """Figures of the two other methods after replay, at the transient limit and at the steady limit."""

    seed: Figures
    clipped: Figures
    seed_steady: Figures
    clipped_steady: Figures


class Batch:
    """Answers of one device, time axis and tap rate, which one simulation plays when the first of them is read.

    Parameters
    ----------
    designed : the answers, at least one.
    coil : of the motor; None where nothing is known of it.
    steady_input : what the actuator stands for ever, at which the other methods are looked at besides [A or V].
    told : targets against which errors are told; by default what each problem tracks.
    transients : (M, N) what is played beside the wall's feedback; by default what the commands leave of it.
    with_rivals : whether the other methods are going to be read too, which then share the simulation.
    """

    def __init__(
        self,
        designed: Sequence[Designed],
        coil: CoilModel | None,
        steady_input: float,
        told: Sequence[Target] | None = None,
        transients: FloatArray | None = None,
        *,
        with_rivals: bool = False,
    ) -> None:
        self._stated, self._with_rivals = transients, with_rivals
        self.designed, self._coil, self._steady_input = designed, coil, steady_input
        self.told = [each.problem.target for each in designed] if told is None else told

    @cached_property
    def replays(self) -> list[Replay]:
        """Each command, through the wall if there is one."""
        if self.designed[0].nonlinear is not None:
            return [both[1] for both in self._on_nonlinear_plant]
        return self._replayed(self._together.of(slice(len(self.designed))) if self._share else None)

    @cached_property
    def linear_replays(self) -> list[Replay]:
        """The commands that were designed for the plant at rest, on the nonlinear plant."""
        return [both[0] for both in self._on_nonlinear_plant]

    @cached_property
    def rivals(self) -> list[Baselines]:
        """Figures of the two other methods, of each answer; they know no wall."""
        first = self.designed[0]
        if self._several:
            problems = [each.problem for each in self.designed] * 4
            figures = [played.figures for played in replay_several(problems, self._rival_commands)]
            return [Baselines(*figures[m :: len(self.designed)]) for m in range(len(self.designed))]
        if first.nonlinear is not None:
            return [Baselines(*self._figures_on_nonlinear_plant(each)) for each in self.designed]
        yardstick, targets, M = first.problem.yardstick, [*self.told] * 4, len(self.designed)
        if self._share:
            found = figures_of(self._together.of(slice(M, None)), yardstick, targets)
        else:
            found = replayed_figures(first.problem.stage, yardstick, self._rival_commands, targets)
        return [Baselines(*found[m::M]) for m in range(M)]

    @property
    def _share(self) -> bool:
        """Whether one simulation plays answers and rivals: the rivals know no wall."""
        return self._with_rivals and self.designed[0].problem.wall is None and not self._several

    @property
    def _several(self) -> bool:
        """Whether each command is for several motors."""
        return self.designed[0].problem.stage.motors > 1

    @cached_property
    def _together(self) -> Accurate:
        """Simulation of the answers, and of the rivals behind them."""
        problem = self.designed[0].problem
        return accurate(problem.stage, problem.grid, np.concatenate([self._transients, self._rival_commands]), None)

    @property
    def _transients(self) -> FloatArray:
        """(M, N) what is played of each answer, beside the wall's feedback."""
        if self._stated is not None:
            return self._stated
        # A solver that broke down returns NaN, which no integrator needs to see.
        commands = [np.nan_to_num(d.solution.command, nan=0.0, posinf=0.0, neginf=0.0) for d in self.designed]
        return np.stack([d.problem.transient_command(c) for d, c in zip(self.designed, commands, strict=True)])

    def _replayed(self, simulated: Accurate | None) -> list[Replay]:
        problems = [d.problem for d in self.designed]
        if self._several:
            return replay_several(problems, self._transients)
        budgets = [p.thermal.budget for p in problems if p.thermal is not None]
        walls = [p.wall for p in problems if p.wall is not None]
        return replay(
            problems[0].stage,
            problems[0].grid,
            self._transients,
            self.told,
            self._coil,
            limits=[problem.limits for problem in problems],
            walls=walls or None,
            budgets=budgets or None,
            simulated=simulated,
            spread=problems[0].spread,
            yardstick=problems[0].yardstick,
        )

    @cached_property
    def _on_nonlinear_plant(self) -> list[list[Replay]]:
        """The linear design and the answer, of each."""
        # IPOPT's results alone need this import.
        from transopt.proof.nonlinear_replay import replay_nonlinear

        found = []
        for each in self.designed:
            assert each.nonlinear is not None
            assert each.linear is not None
            commands = [np.nan_to_num(d.solution.command) for d in (each.linear, each)]
            found.append(replay_nonlinear(each.nonlinear, commands))
        return found

    @property
    def _rival_commands(self) -> FloatArray:
        """(4 M, N) commands of the two other methods, in the order of `Baselines`, each of all answers."""
        return _rivals_of(self.designed, self._steady_input)

    def _figures_on_nonlinear_plant(self, designed: Designed) -> list[Figures]:
        assert designed.nonlinear is not None
        # The rivals invert the plant at rest, as the linear design does.
        return [
            designed.nonlinear.figures(each) for each in _rivals_of([designed.linear or designed], self._steady_input)
        ]


def _rivals_of(designed: Sequence[Designed], steady_input: float) -> FloatArray:
    first = designed[0].problem
    if first.stage.motors > 1:
        return _rivals_of_motors(designed, steady_input)
    references = np.stack([d.problem.reference_m_s2 for d in designed])
    free = np.stack([d.unlimited_command for d in designed])
    # Both limits at once: what is clipped at them is the same.
    transient = np.array([d.problem.limits.input_limit for d in designed])
    limits = np.stack([transient, np.full_like(transient, steady_input)])[:, :, None]
    seed = seed_inversion(first.stage, first.grid, references, limits, first.hand_over_samples)
    clipped = clipped_optimum(first.stage, first.grid, free, limits)
    return np.stack([seed, clipped], axis=1).reshape(-1, first.grid.stages)  # limit, method, answer


def _rivals_of_motors(designed: Sequence[Designed], steady_input: float) -> FloatArray:
    """(4 M, m, N) the same of several motors, each cut at what it has of the limit."""
    found = []
    for limit in (1.0, steady_input / designed[0].problem.limits.input_limit):
        posed = [(d, limit * input_bounds(d.problem)) for d in designed]
        found += [
            seed_inversion(p.stage, p.grid, p.reference_m_s2, bounds, p.hand_over_samples)
            for p, bounds in ((d.problem, bounds) for d, bounds in posed)
        ]
        found += [
            clipped_optimum(d.problem.stage, d.problem.grid, d.unlimited_command, bounds) for d, bounds in posed
        ]
    return np.stack(found)
