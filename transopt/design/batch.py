"""Replays of the answers of one device in one simulation, and of the two baseline methods beside them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.coil import CoilModel
from transopt.problem.baselines import clipped_optimum, input_bounds, seed_inversion
from transopt.problem.objective.figures import Figures
from transopt.problem.objective.target import Target
from transopt.proof.continuous import Course, accurate
from transopt.proof.designed import Designed
from transopt.proof.replay import Replay, figures_of, replayed, replayed_figures


@dataclass(frozen=True)
class Baselines:
    """Replayed figures of the two baseline methods, each at the transient and at the steady limit of the input."""

    seed: Figures
    clipped: Figures
    seed_steady: Figures
    clipped_steady: Figures


class Batch:
    """Answers of one device, time axis and tap rate; one simulation plays all when the first replay is read.

    Parameters
    ----------
    designed : the M answers, at least one.
    coil : the motor's coil; None where it is not known.
    steady_input : largest plant input that the actuator bears continuously [A or V]. The baselines are evaluated at
        this limit too.
    uncorrected : targets against which errors are reported; by default the target that each problem tracks.
    transients : (M, N) inputs played in addition to the wall's feedback; by default the commands less that feedback.
    with_rivals : whether the baselines will be read too; they then share the simulation.
    """

    def __init__(
        self,
        designed: Sequence[Designed],
        coil: CoilModel | None,
        steady_input: float,
        uncorrected: Sequence[Target] | None = None,
        transients: FloatArray | None = None,
        *,
        with_rivals: bool = False,
    ) -> None:
        # Replays keep this function, to play again, and must not keep the batch, which keeps them.
        self._transients = partial(_transients, designed, transients)
        self._with_rivals, self.designed = with_rivals, designed
        self._coil, self._steady_input = coil, steady_input
        self.uncorrected = [each.problem.target for each in designed] if uncorrected is None else uncorrected

    @cached_property
    def replays(self) -> list[Replay]:
        """The replay of each command, with the wall's feedback if there is a wall."""
        if self.designed[0].nonlinear is not None:
            return [both[1] for both in self._on_nonlinear_plant]
        simulated = self._together.of(slice(len(self.designed))) if self._share else None
        return replayed(
            [each.problem for each in self.designed],
            self._transients(),
            self._coil,
            uncorrected=self.uncorrected,
            simulated=simulated,
            again=self._transients,
        )

    def let_go(self) -> None:
        """Free the courses of the replays, which are played again when they are read."""
        for played in vars(self).get("replays", [])[:1]:
            played.samples.let_go()

    @cached_property
    def linear_replays(self) -> list[Replay]:
        """Replays on the nonlinear plant of the commands that were designed for the plant at rest."""
        return [both[0] for both in self._on_nonlinear_plant]

    @cached_property
    def rivals(self) -> list[Baselines]:
        """Figures of the two baseline methods for each answer; the baselines ignore the wall."""
        first = self.designed[0]
        if first.nonlinear is not None:
            return [Baselines(*self._figures_on_nonlinear_plant(each)) for each in self.designed]
        yardstick, targets, M = first.problem.yardstick, [*self.uncorrected] * 4, len(self.designed)
        if self._share:
            found = figures_of(self._together.of(slice(M, None)), yardstick, targets)
        else:
            found = replayed_figures(first.problem.stage, yardstick, self._rival_commands, targets)
        return [Baselines(*found[m::M]) for m in range(M)]

    @property
    def _share(self) -> bool:
        """Whether one simulation plays answers and baselines: not with a wall, which the baselines ignore."""
        return self._with_rivals and self.designed[0].problem.wall is None

    @cached_property
    def _together(self) -> Course:
        """One simulation of the M answers followed by the 4 M baselines."""
        problem = self.designed[0].problem
        return accurate(problem.stage, problem.grid, np.concatenate([self._transients(), self._rival_commands]), None)

    @cached_property
    def _on_nonlinear_plant(self) -> list[list[Replay]]:
        """For each answer the replays of its linear design and of itself."""
        # Imported here because only answers on a nonlinear plant need it.
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
        """(4 M, N) baseline commands: in the order of `Baselines`, and for each of these all M answers."""
        return _rivals_of(self.designed, self._steady_input)

    def _figures_on_nonlinear_plant(self, designed: Designed) -> list[Figures]:
        assert designed.nonlinear is not None
        # The baselines are designed for the plant at rest, as the linear design is.
        return [
            designed.nonlinear.figures(each) for each in _rivals_of([designed.linear or designed], self._steady_input)
        ]


def _transients(designed: Sequence[Designed], stated: FloatArray | None) -> FloatArray:
    """(M, N), or (M, m, N) of m motors: the input that each answer adds to the wall's feedback."""
    if stated is not None:
        return stated
    # A solver that broke down returns NaN; the integrator plays zeros instead.
    found = np.stack([each.solution.command for each in designed])
    np.nan_to_num(found, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    for each, command in zip(designed, found, strict=True):
        command[...] = each.problem.transient_command(command)
    return found


def _rivals_of(designed: Sequence[Designed], steady_input: float) -> FloatArray:
    first = designed[0].problem
    if first.stage.motors > 1:
        return _rivals_of_motors(designed, steady_input)
    references = np.stack([d.problem.reference_m_s2 for d in designed])
    free = np.stack([d.unlimited_command for d in designed])
    # Both limits in one call: the unclipped commands are the same for both.
    transient = np.array([d.problem.limits.input_limit for d in designed])
    limits = np.stack([transient, np.full_like(transient, steady_input)])[:, :, None]
    seed = seed_inversion(first.stage, first.grid, references, limits, first.hand_over_samples)
    clipped = clipped_optimum(first.stage, first.grid, free, limits)
    return np.stack([seed, clipped], axis=1).reshape(-1, first.grid.stages)  # limit, method, answer


def _rivals_of_motors(designed: Sequence[Designed], steady_input: float) -> FloatArray:
    """(4 M, m, N) baseline commands for m motors, each motor clipped at its own share of the limit."""
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
