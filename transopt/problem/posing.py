"""The optimal-control problem of a tap with the limits, weights and time axis of a scene or a library."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.circuit import Circuit
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import StageModel, TimeGrid, discretise
from transopt.plant.intention import INTENTION_S
from transopt.plant.state_space import CURRENT_INPUT, Input, StateSpace
from transopt.plant.wall import HandOver, Wall
from transopt.problem.heat import Budget
from transopt.problem.limits import needed_outputs, posed
from transopt.problem.limits.limit import Setting
from transopt.problem.limits.own import LawOf
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.plain import plain
from transopt.problem.objective.rapid import rapid
from transopt.problem.objective.target import Target
from transopt.problem.objective.weighting import ErrorFilter
from transopt.problem.problem import TransientProblem


@dataclass(frozen=True)
class Wanted:
    """What one incoming speed asks for.

    Attributes
    ----------
    speed_m_s : at contact.
    target : r.
    nominal_velocity_m_s, nominal_position_m : (N,) the hand's own motion z_nom and its derivative at the switching
        instants.
    nominal_position_at_ticks_m : (N + M,) z_nom at the servo ticks, where the encoder is read, for the wall.
    ends_s : when it is over; infinite for a tap, which goes on as it was recorded.
    slow_part_known : whether the recording can be trusted in its slow part, so that the plain term means something.
    """

    speed_m_s: float
    target: Target
    nominal_velocity_m_s: FloatArray
    nominal_position_m: FloatArray
    nominal_position_at_ticks_m: FloatArray
    ends_s: float = np.inf
    slow_part_known: bool = True

    __repr__ = brief


@dataclass(frozen=True)
class Posing:
    """What the problems of all taps of one scene or library share.

    Attributes
    ----------
    asked : key of the scene's `limits` -> number, or None where it is not asked for.
    circuit, coil, wall, rapid : None where the scene has none; `rapid` is the filter of the term of that name.
    plain : weight of the error as it is over the intention.
    heat_price : of the squared input [1/A^2 or 1/V^2].
    intention_s : for so long after contact the hand means to move on as it came.
    objective : "waveform", J is minimised, or "intensity", the tap has to have the energy asked for as well.
    intensity_dB : that energy, over the recorded tap's [dB].
    driven_by : what the input of the plants is.
    calm : factor on the weights of the error behind the end of a named target, in window and tail, >= 1.
    worst : of a spread of devices the worst counts and not the mean.
    tangential : weight of the errors across the normal, of a plant with several directions.
    law_of : what evaluates limits of a user's own that are not linear; None where nothing does.
    """

    grid: TimeGrid
    amplifier: Amplifier | None
    plain: float
    rapid: ErrorFilter | None
    rho: float
    asked: Mapping[str, Any]
    hand_over_samples: int
    circuit: Circuit | None
    coil: CoilModel | None
    wall: Wall | None
    budget: Budget
    objective: str = "waveform"
    intensity_dB: float = 0.0
    law_of: LawOf | None = None
    driven_by: Input = CURRENT_INPUT
    calm: float = 1.0
    worst: bool = False
    heat_price: float = 0.0
    intention_s: float = INTENTION_S
    tangential: float = 1.0

    __repr__ = brief

    def stage(self, plant: StateSpace) -> StageModel:
        """A device as the problems need it: with the encoder's position for a wall, and what the limits look at.

        Raises
        ------
        InputError : a limit on an output that the plant does not have.
        """
        return discretise(
            plant,
            self.amplifier,
            self.grid.dt_s,
            position=self.wall is not None,
            outputs=self.watched,
        )

    @property
    def watched(self) -> tuple[str, ...]:
        """Outputs that the limits look at."""
        return needed_outputs(self.asked, self.driven_by, self.circuit)

    def terms(self, wanted: Wanted) -> tuple[ErrorTerm, ...]:
        """The terms of the error: of a tap the plain and the rapid one, of a named target the plain one alone.

        Raises
        ------
        InputError : neither of the two is left.
        """
        key = wanted.ends_s, wanted.slow_part_known
        if key not in self._terms:
            self._terms[key] = self._terms_of(wanted)
        return self._terms[key]

    @cached_property
    def _terms(self) -> dict[tuple[float, bool], tuple[ErrorTerm, ...]]:
        """Terms made so far; taps that share them are known to share what depends on them."""
        return {}

    def _terms_of(self, wanted: Wanted) -> tuple[ErrorTerm, ...]:
        if np.isfinite(wanted.ends_s):
            term = plain(1.0, self.grid, np.inf)
            over = self.grid.switching_times_s > wanted.ends_s
            return (replace(term, weights=np.where(over, self.calm, 1.0), after=self.calm),)
        found = []
        if self.plain > 0 and wanted.slow_part_known:
            found.append(plain(self.plain, self.grid, self.intention_s))
        if self.rapid is not None:
            found.append(rapid(self.rapid, self.grid))
        if not found:
            raise InputError(
                "weights: no term of the error is left: give weights.plain above 0 and recordings whose slow part is "
                'known, or weights.rapid = "highpass"'
            )
        return tuple(found)

    def problem(
        self,
        wanted: Wanted,
        stage: StageModel,
        spread: tuple[StageModel, ...] = (),
        coil: CoilModel | None = None,
    ) -> TransientProblem:
        """The problem of a tap; a wall pushes where the nominal motion is under the surface.

        Parameters
        ----------
        stage : device of the tap's grip. spread : further devices that the command shall serve.
        coil : with other temperatures at the start than those that the library states.

        Raises
        ------
        InputError : numbers that make no problem.
        """
        hand_over = None
        if self.wall is not None:
            nominal = wanted.nominal_position_at_ticks_m
            hand_over = HandOver(self.wall, nominal, wanted.speed_m_s, nominal < 0)
        carried = 0.0 if stage.plant.moves_in_a_case else 1.0
        setting = Setting(
            stage=stage,
            grid=self.grid,
            circuit=self.circuit,
            coil=self.coil if coil is None else coil,
            budget=self.budget,
            wall=hand_over,
            reference_m_s2=wanted.target.window_m_s2,
            nominal_m=carried * wanted.nominal_position_m,
            nominal_m_s=carried * wanted.nominal_velocity_m_s,
            spread=spread,
        )
        p = stage.tracked
        return TransientProblem(
            stage=stage,
            grid=self.grid,
            target=wanted.target if p == 1 else wanted.target.along_normal(p),
            shares=None if p == 1 else np.array([1.0, *[self.tangential] * (p - 1)]),
            terms=self.terms(wanted),
            rho=self.rho,
            limits=posed(self.asked, setting, self.law_of),
            hand_over_samples=self.hand_over_samples,
            wall=hand_over,
            spread=spread,
            worst=self.worst and bool(spread),
            heat_price=self.heat_price,
            intention_s=self.intention_s if np.isinf(wanted.ends_s) else self.grid.end_s,
            named=bool(np.isfinite(wanted.ends_s)),
            intensity_dB=self.intensity_dB,
        )
