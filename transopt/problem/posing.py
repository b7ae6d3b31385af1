"""The optimal-control problem of a tap with the limits, weights and time axis of a scene or a library."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.circuit import Circuit
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import StageModel, TimeGrid, discretise
from transopt.plant.state_space import CURRENT_INPUT, Input, StateSpace
from transopt.plant.wall import HandOver, Wall
from transopt.problem.heat import Budget
from transopt.problem.limits import needed_outputs, posed
from transopt.problem.limits.limit import Setting
from transopt.problem.limits.own import LawOf
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
    """

    speed_m_s: float
    target: Target
    nominal_velocity_m_s: FloatArray
    nominal_position_m: FloatArray
    nominal_position_at_ticks_m: FloatArray
    ends_s: float = np.inf

    __repr__ = brief


@dataclass(frozen=True)
class Posing:
    """What the problems of all taps of one scene or library share.

    Attributes
    ----------
    asked : key of the scene's `limits` -> number, or None where it is not asked for.
    circuit, coil, wall, error_filter : None where the scene has none.
    objective : "waveform", J is minimised, or "intensity", the tap has to have the energy asked for as well.
    intensity_dB : that energy, over the recorded tap's [dB].
    driven_by : what the input of the plants is.
    calm : factor on the tracking weights behind the end of what is wanted, >= 1.
    worst : of a spread of devices the worst counts and not the mean.
    law_of : what evaluates limits of a user's own that are not linear; None where nothing does.
    """

    grid: TimeGrid
    amplifier: Amplifier | None
    tracking_weights: FloatArray
    rho: float
    error_filter: ErrorFilter | None
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
            outputs=needed_outputs(self.asked, self.driven_by),
        )

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
        over = self.grid.switching_times_s > wanted.ends_s
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
        return TransientProblem(
            stage=stage,
            grid=self.grid,
            target=wanted.target,
            tracking_weights=self.tracking_weights * np.where(over, self.calm, 1.0),
            rho=self.rho,
            limits=posed(self.asked, setting, self.law_of),
            hand_over_samples=self.hand_over_samples,
            wall=hand_over,
            error_filter=self.error_filter,
            spread=spread,
            worst=self.worst and bool(spread),
            intensity_dB=self.intensity_dB,
        )
