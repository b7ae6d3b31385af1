"""Poses the optimal-control problem of a tap from the limits, weights and time axis of a scene or a library."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.kept import Kept
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import Circuit, CoilModel
from transopt.plant.discretise import StageModel, discretise
from transopt.plant.intention import INTENTION_S
from transopt.plant.state_space import CURRENT_INPUT, Input, StateSpace
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import HandOver, Wall
from transopt.problem.heat import Budget
from transopt.problem.limits import needed_outputs, posed
from transopt.problem.limits.limit import Setting
from transopt.problem.limits.own import LawOf
from transopt.problem.objective.error_term import ErrorTerm, plain, rapid
from transopt.problem.objective.target import Target
from transopt.problem.objective.weighting import ErrorFilter
from transopt.problem.problem import TransientProblem

KEPT_TERMS = 16
STAGES: Kept[StageModel] = Kept(64)  # of all scenes and libraries: what follows from a device is computed once


@dataclass(frozen=True)
class Wanted:
    """The tap, or named target, wanted at one incoming speed.

    Attributes
    ----------
    speed_m_s : speed at contact.
    target : target acceleration.
    nominal_velocity_m_s, nominal_position_m : (N,) the hand's own motion, dz_nom/dt and z_nom, at the switching
        instants.
    nominal_position_at_ticks_m : (N + M,) z_nom at the servo ticks, where the encoder is read, for the wall.
    ends_s : end of a named target; infinite for a tap.
    slow_part_known : whether the recording is reliable at low frequencies, which the plain term needs.
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
    """The data that the problems of all taps of one scene or library share.

    Attributes
    ----------
    grid : time axis.
    amplifier : None for an ideal one.
    plain : weight of the unfiltered error during the intention.
    rapid : filter of the rapid term; None without that term.
    rho : weight of the command's movement.
    asked : key of the scene's table `limits` -> number, or None where the scene states none.
    hand_over_samples : number of last commands that equal the wall's feedback.
    circuit, coil, wall : None where the scene has none.
    budget : requirements on the winding's temperature beyond its limit.
    objective : "waveform" minimises J; "intensity" also requires the energy `intensity_dB`.
    intensity_dB : required energy over that of the recorded tap [dB].
    law_of : makes the function of a user's own nonlinear limit from its text; None where none is needed.
    driven_by : the plants' input, current or voltage.
    calm : factor >= 1 on the weights of the error after the end of a named target, in window and tail.
    worst : whether the worst device of a spread counts, not the mean.
    heat_price : price of the squared input [1/A^2 or 1/V^2].
    intention_s : duration after contact during which the hand moves on as it came.
    tangential : weight of the error across the normal, for a plant with several directions.
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
        """The stage model of a plant with the outputs that wall and limits need; the most recent ones are kept.

        Raises
        ------
        InputError : a limit on an output that the plant does not have.
        """
        by = amplifier, dt_s, position, outputs = self.discretised_by
        return STAGES.get(
            (*by, plant.numbers), lambda: discretise(plant, amplifier, dt_s, position=position, outputs=outputs)
        )

    @property
    def discretised_by(self) -> tuple[Amplifier | None, float, bool, tuple[str, ...]]:
        """Amplifier, servo period, whether a wall needs the position, and the outputs that the limits need."""
        return self.amplifier, self.grid.dt_s, self.wall is not None, self.watched

    @property
    def watched(self) -> tuple[str, ...]:
        """Names of the outputs that the limits need."""
        return needed_outputs(self.asked, self.driven_by, self.circuit)

    def terms(self, wanted: Wanted) -> tuple[ErrorTerm, ...]:
        """The error terms: plain and rapid for a tap, plain alone for a named target.

        Taps that share the same tuple share everything derived from it.

        Raises
        ------
        InputError : no term has a weight.
        """
        if np.isfinite(wanted.ends_s):
            return _of_target(self.grid, self.calm, wanted.ends_s)
        return _of_taps(self.grid, self.plain if wanted.slow_part_known else 0.0, self.rapid, self.intention_s)

    def problems(
        self,
        wanted: Sequence[Wanted],
        stage: StageModel,
        spread: tuple[StageModel, ...] = (),
        coil: CoilModel | None = None,
    ) -> list[TransientProblem]:
        """The problems of several taps with one device, as `problem` poses each of them.

        Problems that differ only in the target share everything else: without a wall, those under limits that hold
        no course of the nominal motion.
        """
        alike, found = dict[object, TransientProblem](), list[TransientProblem]()
        for each in wanted:
            known = alike.get(key := (each.ends_s, each.slow_part_known))
            if known is None:
                posed = self.problem(each, stage, spread, coil)
                if self.wall is None and posed.limits.are_hashable:
                    alike[key] = posed
            else:
                posed = known.aiming_at(each.target.along_normal(stage.tracked))
            found.append(posed)
        return found

    def problem(
        self,
        wanted: Wanted,
        stage: StageModel,
        spread: tuple[StageModel, ...] = (),
        coil: CoilModel | None = None,
    ) -> TransientProblem:
        """The problem of a tap; at first the wall pushes where the nominal motion is below the surface.

        Parameters
        ----------
        stage : device under the tap's grip.
        spread : further devices that the same command drives.
        coil : replaces the scene's coil, to start from other temperatures.

        Raises
        ------
        InputError : data of which no problem can be made.
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
            target=wanted.target.along_normal(p),
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


@lru_cache(maxsize=KEPT_TERMS)
def _of_target(grid: TimeGrid, calm: float, ends_s: float) -> tuple[ErrorTerm, ...]:
    term, over = plain(1.0, grid, np.inf), grid.switching_times_s > ends_s
    return (replace(term, weights=np.where(over, calm, 1.0), after=calm),)


@lru_cache(maxsize=KEPT_TERMS)
def _of_taps(grid: TimeGrid, weight: float, by: ErrorFilter | None, intention_s: float) -> tuple[ErrorTerm, ...]:
    found = [plain(weight, grid, intention_s)] if weight > 0 else []
    if by is not None:
        found.append(rapid(by, grid))
    if not found:
        raise InputError(
            "weights: no error term is left: give weights.plain above 0 and recordings whose slow part is known, "
            'or weights.rapid = "highpass"'
        )
    return tuple(found)
