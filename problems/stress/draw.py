"""Random stress cases in which all numbers vary at once; a case depends on seed and index only."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from problems.stress.actuators import Actuator
from problems.stress.cases import StressCase
from problems.stress.parts import Coil, Current, Demand, DrawnDevice, Horizon, Spread, Surface
from transopt.plant.intention import Yielding

STAGES = ((1, 0.03), (2, 0.04), (10, 0.15), (40, 0.38), (150, 0.28), (600, 0.118), (20000, 0.002))
MOST_FOR_SEVERAL = 600  # largest number of stages of a case with several devices
WHEN_LONG = 2000  # stages from which on a case has no coil and no wall, whose general solver would take minutes
YIELDED: tuple[Yielding, ...] = ("brakes", "brakes", "stops", "decays", "pulls")

T = TypeVar("T")


class _Draw:
    """The random numbers of one case."""

    def __init__(self, seed: int, index: int, apart: int | None = None) -> None:
        self._random = np.random.default_rng([seed, index] if apart is None else [seed, index, apart])

    def perhaps(self, probability: float) -> bool:
        """True with this probability."""
        return bool(self._random.random() < probability)

    def log(self, low: float, high: float) -> float:
        """Log-uniform between the two."""
        return float(np.exp(self._random.uniform(np.log(low), np.log(high))))

    def of(self, *choices: T) -> T:
        """One of the choices, with equal probabilities."""
        return choices[int(self._random.integers(len(choices)))]

    def weighted(self, choices: Sequence[tuple[int, float]]) -> int:
        """One of the values, with probabilities proportional to the weights."""
        values, shares = zip(*choices, strict=True)
        return int(self._random.choice(values, p=shares))

    def seed(self) -> int:
        """A seed for a separate generator."""
        return int(self._random.integers(2**31))


def _device(draw: _Draw) -> DrawnDevice:
    kind = "drive" if draw.perhaps(0.8) else draw.of("second_order", "defective")
    wide = draw.perhaps(0.4)
    return DrawnDevice(
        kind=kind,
        grip_N=0.0 if draw.perhaps(0.15) else draw.log(0.5, 100.0),
        moving_kg=draw.log(1e-6, 100.0) if wide else draw.log(1e-3, 1.0),
        stylus_kg=draw.log(1e-6, 100.0) if wide else draw.log(1e-3, 1.0),
        mode_Hz=draw.log(50.0, 35e3),
        damping_ratio=draw.log(1e-4, 1.0),
        force_N_A=draw.log(0.1, 10.0),
        units=draw.of(1e-6, 1e-3, 1e3, 1e6) if draw.perhaps(0.1) else 1.0,
    )


def _current(draw: _Draw) -> Current:
    pole = None if draw.perhaps(0.15) else draw.log(10.0, 1e6)
    return Current(
        limit_A=draw.log(1e-6, 10.0) if draw.perhaps(0.4) else draw.log(0.1, 10.0),
        command=1.0 if draw.perhaps(0.2) else draw.log(0.3, 10.0),
        pole_Hz=pole,
        delay_samples=draw.of(0.0, 1.0, 2.999, 20.0, 0.68, 0.68),
        slew=draw.log(1e-6, 3.0) if draw.perhaps(0.15) else None,
        supply=draw.log(0.1, 10.0) if draw.perhaps(0.12) else None,
    )


def _horizon(draw: _Draw) -> Horizon:
    stages = draw.weighted(STAGES)
    return Horizon(
        dt_s=draw.log(1e-6, 1e-3) if draw.perhaps(0.5) else 1e-4,
        stages=stages,
        lead_s=draw.of(0.0, 1e-4, 3e-4, 5e-3),
        hand_over=min(stages, draw.of(1, 10, 10, max(stages // 2, 1))),
    )


def _demand(draw: _Draw) -> Demand:
    kinds = ("constant", "noise", "noise", "sample", "sample", "huge", "denormal", "overflow", "nan", "empty")
    return Demand(
        kind="tap" if draw.perhaps(0.65) else draw.of(*kinds),
        speed_m_s=0.0 if draw.perhaps(0.03) else draw.log(0.01, 5.0),
        weights="one" if draw.perhaps(0.7) else draw.of("late", "sparse", "tiny", "none"),
        rho=draw.of(0.0, 1e-12, 1e-6, 1e-3, 1e-3, 1e-3),
        rapid="pacinian" if draw.perhaps(0.05) else "none",
        seed=draw.seed(),
    )


def _coil(draw: _Draw) -> Coil:
    return Coil(
        tau_w_s=draw.log(1e-5, 1e4),
        tau_h_s=draw.log(1e-2, 4e4),
        below_K=draw.of(1e-6, 0.0, -1e-6) if draw.perhaps(0.25) else draw.log(1e-3, 30.0),
        warming=draw.log(0.3, 30.0),
        nodes=draw.of(1, 2, 2),
        tap_share=draw.of(0.02, 0.2, 0.8, 1.2) if draw.perhaps(0.2) else None,
    )


def _surface(draw: _Draw) -> Surface:
    return Surface(
        stiffness_N_m=draw.log(1.0, 1e5),
        damping_N_s_m=draw.log(0.01, 50.0),
        latency_ticks=draw.of(0, 1, 2, 5),
        filter_Hz=draw.log(50.0, 5000.0),
    )


def drawn(seed: int, index: int) -> StressCase:
    """Case `index` of the sequence `seed`, independent of earlier draws."""
    draw = _Draw(seed, index)
    device, current, horizon, demand = _device(draw), _current(draw), _horizon(draw), _demand(draw)
    coil = _coil(draw) if draw.perhaps(0.15) else None
    surface = _surface(draw) if draw.perhaps(0.12) else None
    if horizon.stages >= WHEN_LONG:
        coil = surface = None
    horizon, demand = _beyond(_Draw(seed, index, apart=1), horizon, demand)
    apart = _Draw(seed, index, apart=2)
    if coil is None and surface is None and horizon.stages < WHEN_LONG and apart.perhaps(0.25):
        current = replace(current, supply=None)
        case = StressCase("random", device, current, horizon, demand, actuator=_actuator(apart))
    else:
        case = StressCase("random", device, current, horizon, demand, coil, surface)
    case = _several(_Draw(seed, index, apart=3), case)
    demand = _of_a_hand(_Draw(seed, index, apart=4), case.demand)
    return replace(case, demand=_of_a_recording(_Draw(seed, index, apart=5), demand))


def _of_a_recording(draw: _Draw, demand: Demand) -> Demand:
    """At random, let the hand yield and the recording's slow part be unknown.

    Separate random numbers keep the other parts of a case unchanged; so do the functions below.
    """
    if draw.perhaps(0.35):
        demand = replace(demand, yields=draw.of(*YIELDED), intention_s=draw.log(1e-4, 0.03))
    if demand.rapid != "none" and draw.perhaps(0.15):
        demand = replace(demand, weights="untrusted")
    return demand


def _of_a_hand(draw: _Draw, demand: Demand) -> Demand:
    """At random, use the weights of a tap, a heat price, or both."""
    if draw.perhaps(0.3):
        demand = replace(demand, heat_price=draw.log(1e-8, 1e-2))
    if draw.perhaps(0.5):
        return demand
    weights = "intention" if demand.weights == "one" else demand.weights
    return replace(demand, weights=weights, rapid="highpass", rapid_from_Hz=draw.log(5.0, 60.0))


def _several(draw: _Draw, case: StressCase) -> StressCase:
    """At random, turn a case into one for several devices."""
    if not draw.perhaps(0.15) or case.surface is not None or case.horizon.stages > MOST_FOR_SEVERAL:
        return case
    worst = draw.perhaps(0.5)
    demand = replace(case.demand, price=0.0, asked_dB=None) if worst else case.demand
    spread = Spread(draw.of(1, 2, 3, 6), draw.log(1e-4, 0.5), draw.log(1e-4, 0.5), worst)
    return replace(case, demand=demand, spread=spread)


def _actuator(draw: _Draw) -> Actuator:
    """A random actuator."""
    by_voltage, limited = draw.perhaps(0.8), draw.perhaps(0.6)
    return Actuator(
        resonance_Hz=draw.log(5.0, 2000.0),
        quality=draw.log(0.2, 1e3),
        moving_kg=draw.log(1e-4, 10.0),
        case_kg=draw.log(1e-3, 10.0) if draw.perhaps(0.7) else None,
        force_N_A=draw.log(0.01, 30.0),
        R_ohm=draw.log(0.1, 100.0),
        L_H=0.0 if draw.perhaps(0.2) else draw.log(1e-6, 1e-2),
        by_voltage=by_voltage,
        stroke=draw.log(1e-3, 10.0) if limited and draw.perhaps(0.7) else None,
        velocity=draw.log(1e-3, 10.0) if limited and draw.perhaps(0.3) else None,
        current=draw.log(1e-2, 2.0) if limited and draw.perhaps(0.3) else None,
        sag=draw.of(0.5, 0.8, 1.0) if draw.perhaps(0.2) else None,
    )


def _beyond(draw: _Draw, horizon: Horizon, demand: Demand) -> tuple[Horizon, Demand]:
    """At random, add lost samples, a tail, and a price on intensity or an intensity to search for."""
    after = draw.of(0, 0, 1, 7, 60, 300)
    horizon = replace(horizon, after=after if horizon.stages < WHEN_LONG else 0, lost=draw.perhaps(0.5))
    if draw.perhaps(0.25):
        return horizon, replace(demand, price=draw.of(1.0, 0.1, 0.5, 0.9))
    # A search solves several problems; the longest cases are solved only once.
    if horizon.stages < WHEN_LONG and draw.perhaps(0.3):
        return horizon, replace(demand, asked_dB=draw.of(0.0, 0.0, -3.0, 3.0, 12.0))
    return horizon, demand
