"""Cases of the stress suite: the problem of an entry, described by a few extreme numbers.

A case is data and is built by the library's own constructors, so that a constructor refuses it as it refuses a user's
input. `problems.stress.families` defines directed cases, `problems.stress.draw` random ones.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from problems.stress.actuators import Actuator
from problems.stress.hands import HandMotion
from problems.stress.parts import (
    R_OHM,
    Coil,
    Current,
    Demand,
    DrawnDevice,
    Horizon,
    Spread,
    Surface,
)
from transopt.design.context import Posed
from transopt.design.intensity import most_price
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import Circuit
from transopt.plant.discretise import discretise
from transopt.plant.intention import Intention
from transopt.plant.state_space import CURRENT_INPUT, Input, StateSpace
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import HandOver, Wall
from transopt.problem.heat import Budget
from transopt.problem.limits import needed_outputs, posed
from transopt.problem.limits.limit import Setting
from transopt.problem.problem import TransientProblem


@dataclass(frozen=True)
class StressCase:
    """One problem of the stress suite.

    Attributes
    ----------
    family : name of the family.
    device : the device.
    current : amplifier and limits.
    horizon : time grid.
    demand : reference and weights.
    coil : coil with a temperature limit; None for no such limit.
    surface : virtual wall; None for none.
    actuator : actuator in place of the device, with its own limits; None for a stylus on a motor. The case's numbers
        for currents then apply to its input, a current or a voltage.
    spread : further devices to serve; None for a single device.
    """

    family: str
    device: DrawnDevice = field(default_factory=DrawnDevice)
    current: Current = field(default_factory=Current)
    horizon: Horizon = field(default_factory=Horizon)
    demand: Demand = field(default_factory=Demand)
    coil: Coil | None = None
    surface: Surface | None = None
    actuator: Actuator | None = None
    spread: Spread | None = None

    def __str__(self) -> str:
        """One line with the differences from the plain case."""
        plain = StressCase(self.family)
        words = []
        for name in ("device", "current", "horizon", "demand", "coil", "surface", "actuator", "spread"):
            own = getattr(self, name)
            if own is None:
                continue
            usual = getattr(plain, name) or type(own)()
            changed = [f.name for f in fields(own) if getattr(own, f.name) != getattr(usual, f.name)]
            said = " ".join(f"{key}={_short(getattr(own, key))}" for key in changed)
            if said or getattr(plain, name) is None:
                words.append(f"{name}({said})")
        return f"{self.family}: {' '.join(words) or 'plain'}"

    @property
    def objective(self) -> str:
        """Objective as a scene would state it."""
        return "waveform" if self.demand.asked_dB is None else "intensity"

    def grid(self) -> TimeGrid:
        """Time grid of the case; raises InputError like `problem`."""
        horizon = self.horizon
        delay = 0.0 if self.current.pole_Hz is None else self.current.delay_samples * horizon.dt_s
        return TimeGrid(horizon.dt_s, horizon.stages, horizon.lead_s, delay, horizon.after)

    @property
    def driven_by(self) -> Input:
        """The plant's input; commands have the same unit."""
        return CURRENT_INPUT if self.actuator is None else self.actuator.driven_by

    def _numbers(self) -> dict[str, Any]:
        """Dotted key of a scene -> number of the case."""
        current, horizon, driven = self.current, self.horizon, self.driven_by
        largest, supply = current.limit_A, current.supply
        numbers: dict[str, Any] = {
            "time.dt_s": horizon.dt_s,
            "time.stages": horizon.stages,
            "weights.rho": self.demand.rho,
            f"limits.{driven.name}_{driven.unit}": largest,
            f"limits.slew_{driven.unit}_per_s": None
            if current.slew is None
            else current.slew * largest / horizon.dt_s,
        }
        if self.actuator is None:
            numbers["limits.supply_V"] = None if supply is None else supply * R_OHM * largest
        else:
            own = self.actuator.limits(largest, horizon.dt_s * horizon.stages)
            numbers |= {f"limits.{key}": number for key, number in own.items()}
        if current.pole_Hz is not None:
            numbers[f"amplifier.command_limit_{driven.unit}"] = current.command * largest
        if self.surface is not None:
            numbers |= {
                "feedback.stiffness_N_m": self.surface.stiffness_N_m,
                "feedback.damping_N_s_m": self.surface.damping_N_s_m,
                "feedback.latency_ticks": self.surface.latency_ticks,
            }
        if self.coil is not None:
            coil, share = self.coil.model(current.limit_A, horizon.dt_s * horizon.stages), self.coil.tap_share
            numbers |= {
                "thermal.start_winding_C": coil.start_winding_C,
                "thermal.start_housing_C": coil.start_housing_C,
                "thermal.ambient_C": coil.ambient_C,
                "motor.R_wh_K_W": coil.R_wh_K_W,
                "motor.R_ha_K_W": coil.R_ha_K_W,
                "thermal.tap_rate_Hz": None if share is None else share / (horizon.stages * horizon.dt_s),
            }
        return numbers

    def value(self, key: str) -> float | None:
        """The number of the case for a dotted key of a scene; None if it has none."""
        number: float | None = self._numbers().get(key)
        return number

    def posed(self, changes: Mapping[str, float | None] | None = None) -> Posed:
        """The problem in the form for `transopt.design.design`; parameters and errors as in `problem`."""
        problem = self.problem(changes)
        thermal = problem.thermal
        return Posed(problem, objective=self.objective, coil=None if thermal is None else thermal.coil)

    def problem(self, changes: Mapping[str, float | None] | None = None) -> TransientProblem:
        """The optimal-control problem of the case.

        Parameters
        ----------
        changes : dotted key of a scene -> another number; None removes the key. All other numbers keep their values
            in SI, even if the case states them relative to a changed one; "feedback" is the whole wall.

        Raises
        ------
        InputError : a constructor refuses it.
        """
        grid = self.grid()
        numbers = self._numbers() | dict(changes or {})
        grid = replace(grid, dt_s=numbers["time.dt_s"], stages=int(numbers["time.stages"]))
        driven, of = self.driven_by, self.actuator
        speed, force_N_A = (self.demand.speed_m_s if of is None else 0.0), self.device.force_N_A
        amplifier = None
        if self.current.pole_Hz is not None:
            largest = numbers[f"amplifier.command_limit_{driven.unit}"]
            amplifier = Amplifier(self.current.pole_Hz, grid.delay_s, largest)
        plant = self.device.plant() if of is None else of.plant()
        asked = {key.removeprefix("limits."): number for key, number in numbers.items() if key.startswith("limits.")}
        hand = HandMotion(Intention(self.demand.intention_s, self.demand.yields), speed, grid)
        target = self.demand.target(grid, hand, lost=self.horizon.lost)
        wall = None
        if self.surface is not None and numbers.get("feedback", True) is not None:
            law = Wall(
                numbers["feedback.stiffness_N_m"],
                numbers["feedback.damping_N_s_m"],
                force_N_A,
                int(numbers["feedback.latency_ticks"]),
                self.surface.filter_Hz,
            )
            nominal = hand.position_m(grid.all_issue_times_s)
            wall = HandOver(law, nominal, speed, nominal < 0)
        coil = None
        if self.coil is not None:
            made = self.coil.model(self.current.limit_A, self.horizon.dt_s * self.horizon.stages)
            stated = {key.rsplit(".", 1)[-1]: number for key, number in numbers.items()}
            coil = replace(made, **{f.name: stated[f.name] for f in fields(made) if f.name in stated})
        circuit = Circuit(R_OHM, L_H=0.238e-3, emf_V_s_m=force_N_A)
        outputs = needed_outputs(asked, driven)
        stage = discretise(plant, amplifier, grid.dt_s, position=wall is not None, outputs=outputs)
        others = () if self.spread is None else tuple(self._others(self.spread))
        spread = tuple(discretise(each, amplifier, grid.dt_s, outputs=outputs) for each in others)
        setting = Setting(
            stage=stage,
            grid=grid,
            circuit=circuit,
            coil=coil,
            budget=Budget(tap_rate_Hz=numbers.get("thermal.tap_rate_Hz")),
            wall=wall,
            reference_m_s2=target.window_m_s2,
            nominal_m=hand.position_m(grid.switching_times_s),
            nominal_m_s=hand.velocity_m_s(grid.switching_times_s),
            spread=spread,
        )
        key = f"{driven.name}_{driven.unit}"
        plain = TransientProblem(
            stage=stage,
            grid=grid,
            target=target,
            terms=self.demand.terms(grid),
            rho=numbers["weights.rho"],
            limits=posed({key: asked[key]}, replace(setting, coil=None)),
            hand_over_samples=self.horizon.hand_over,
            wall=wall,
            heat_price=self.demand.heat_price / asked[key] ** 2,
        )
        # The target is built first, so that a refused reference is reported before a refused limit.
        whole = replace(plain, limits=posed(asked, setting))
        if self.spread is not None:
            whole = replace(whole, spread=spread, worst=self.spread.worst)
        return replace(
            whole, intensity=self.demand.price * most_price(whole), intensity_dB=self.demand.asked_dB or 0.0
        )

    def _others(self, spread: Spread) -> list[StateSpace]:
        """The plants of the spread."""
        own, device = self.actuator, self.device
        if own is not None:
            return [
                replace(own, resonance_Hz=f * own.resonance_Hz, quality=g * own.quality).plant()
                for f, g in spread.factors()
            ]
        return [
            replace(device, mode_Hz=f * device.mode_Hz, grip_N=g * device.grip_N).plant() for f, g in spread.factors()
        ]


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
