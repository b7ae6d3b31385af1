"""The optimal-control problem of a tap with the limits, weights and time axis of a library."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.circuit import Circuit, Supply
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import StageModel, TimeGrid
from transopt.plant.wall import HandOver, Wall
from transopt.problem.heat import Budget
from transopt.problem.leave_out import thermal_of
from transopt.problem.objective.weighting import ErrorFilter, error_filter
from transopt.problem.problem import Limits, TransientProblem


@dataclass(frozen=True)
class Wanted:
    """What one incoming speed asks for, all (N,) at the switching instants but the position, which is at the ticks.

    Attributes
    ----------
    speed_m_s : at contact. reference_m_s2 : r.
    nominal_velocity_m_s, nominal_position_m : the hand's own motion, for the back-EMF and for the wall.
    """

    speed_m_s: float
    reference_m_s2: FloatArray
    nominal_velocity_m_s: FloatArray
    nominal_position_m: FloatArray

    __repr__ = brief


@dataclass(frozen=True)
class Posing:
    """What the problems of all taps of one library share, read from its `meta` once."""

    grid: TimeGrid
    amplifier: Amplifier | None
    tracking_weights: FloatArray
    rho: float
    error_filter: ErrorFilter | None
    limits: Limits
    hand_over_samples: int
    supply: tuple[float, Circuit] | None
    wall: Wall | None
    budget: Budget

    __repr__ = brief

    @classmethod
    def of(cls, meta: dict[str, Any], stages: int) -> "Posing":
        """Of a library's `meta` and its number of stages."""
        amplifier = None if meta["amplifier"] is None else Amplifier(**meta["amplifier"])
        limits, thermal, feedback = meta["limits"], meta["thermal"], meta["feedback"]
        powered = limits["supply_V"] is not None and amplifier is not None
        return cls(
            grid=TimeGrid(meta["dt_s"], stages, meta["lead_s"], 0.0 if amplifier is None else amplifier.delay_s),
            amplifier=amplifier,
            tracking_weights=np.asarray(meta["weights"]["tracking"], dtype=float),
            rho=meta["weights"]["rho"],
            error_filter=error_filter(meta["weights"]["error_filter"], meta["dt_s"]),
            limits=Limits(
                current_A=limits["current_A"],
                command_A=None if amplifier is None else amplifier.command_limit_A,
                slew_A_per_s=limits["slew_A_per_s"],
            ),
            hand_over_samples=meta["hand_over_samples"],
            supply=(limits["supply_V"], Circuit(**meta["circuit"])) if powered else None,
            wall=None if feedback is None else Wall(**feedback),
            budget=Budget() if thermal is None else Budget(**thermal["budget"]),
        )

    def problem(
        self, wanted: Wanted, stage: StageModel, spread: tuple[StageModel, ...], coil: CoilModel | None
    ) -> TransientProblem:
        """The problem of a tap; a wall pushes where the nominal motion is under the surface."""
        supply = hand_over = None
        if self.supply is not None and self.amplifier is not None:
            supply = Supply(*self.supply, self.amplifier.rate_rad_s, wanted.nominal_velocity_m_s)
        if self.wall is not None:
            nominal = wanted.nominal_position_m
            hand_over = HandOver(self.wall, nominal, wanted.speed_m_s, nominal < 0)
        return TransientProblem(
            stage=stage,
            grid=self.grid,
            reference_m_s2=wanted.reference_m_s2,
            tracking_weights=self.tracking_weights,
            rho=self.rho,
            limits=self.limits,
            hand_over_samples=self.hand_over_samples,
            supply=supply,
            wall=hand_over,
            thermal=thermal_of(coil, self.amplifier, self.grid, self.budget, hand_over, wanted.reference_m_s2),
            error_filter=self.error_filter,
            spread=spread,
        )
