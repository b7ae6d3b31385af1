"""The directed families of the stress suite: cases with a single extreme number each."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

from problems.stress.cases import StressCase
from problems.stress.parts import Coil, Current, Demand, DrawnDevice, Horizon, Surface

SATURATED = Demand(speed_m_s=1.0)
SMALL_A = 0.3  # a current limit at which the plain tap saturates


def _devices() -> Iterator[StressCase]:
    for mode in (2e3, 12e3, 35e3):
        for damping in (0.17, 1e-2, 1e-4):
            yield StressCase("mode", DrawnDevice(mode_Hz=mode, damping_ratio=damping))
    for moving, stylus in ((1e-6, 1e-6), (1e-6, 100.0), (100.0, 1e-6), (100.0, 100.0), (14e-3, 1e-6)):
        yield StressCase("mass", DrawnDevice(moving_kg=moving, stylus_kg=stylus))
    for grip in (0.0, 0.5, 100.0):
        yield StressCase("grip", DrawnDevice(grip_N=grip))
    for grip in (0.0, 60.0, 100.0):
        yield StressCase("second order", DrawnDevice("second_order", grip_N=grip))
    for mode in (1.0, 400.0, 35e3, 160e3):
        yield StressCase("defective", DrawnDevice("defective", mode_Hz=mode))
    yield StressCase("defective", DrawnDevice("defective", mode_Hz=0.0))
    # 80 and 40 time constants in one tick: at the switching instants link and current cancel, down to rounding.
    late = Current(limit_A=1.8, command=1.0, pole_Hz=12.4e3, delay_samples=2.999)
    light = DrawnDevice("defective", stylus_kg=1.4e-6, mode_Hz=18.4e3)
    yield StressCase("defective", light, late, Horizon(dt_s=7.4e-4, stages=40, lead_s=1e-4))
    heavy = DrawnDevice("defective", stylus_kg=3.1e-3, mode_Hz=13.8e3, units=1e3)
    coarse = Horizon(dt_s=4.4e-4, lead_s=5e-3, hand_over=1)
    yield StressCase("defective", heavy, replace(late, delay_samples=1.0), coarse, Demand(rho=1e-12))
    for units in (1e-6, 1e-3, 1e3, 1e6):
        yield StressCase("units", DrawnDevice(units=units), Current(limit_A=1.0))
    yield StressCase("input", DrawnDevice(stylus_kg=0.0))
    yield StressCase("input", DrawnDevice(damping_ratio=-1e-4))
    yield StressCase("input", DrawnDevice(moving_kg=float("nan")))


def _currents() -> Iterator[StressCase]:
    for limit in (1e-6, 1e-3, 0.3, 1e3):
        yield StressCase("limit", current=Current(limit_A=limit))
    for pole in (10.0, 1e5, 1e6, None):
        yield StressCase("pole", current=Current(pole_Hz=pole))
        yield StressCase("pole", current=Current(limit_A=SMALL_A, pole_Hz=pole), demand=SATURATED)
    for delay in (0.0, 1.0, 2.999, 20.0):
        yield StressCase("delay", current=Current(delay_samples=delay, limit_A=SMALL_A))
    for slew in (1e-6, 1e-2, 0.3, 3.0):
        yield StressCase("slew", current=Current(slew=slew))
    for supply in (0.3, 0.8, 1.0, 3.0):
        yield StressCase("supply", current=Current(supply=supply, limit_A=1.0))
    for limit in (0.0, -1.0, float("nan"), float("inf")):
        yield StressCase("input", current=Current(limit_A=limit))
    for pole in (0.0, -1.0, float("nan")):
        yield StressCase("input", current=Current(pole_Hz=pole))
    yield StressCase("input", current=Current(delay_samples=-1.0))


def _horizons() -> Iterator[StressCase]:
    for stages in (1, 2, 10, 600):
        for hand_over in sorted({1, min(stages, 10)}):
            for limit in (SMALL_A, 4.0):
                horizon = Horizon(stages=stages, hand_over=hand_over, lead_s=0.0)
                yield StressCase("stages", current=Current(limit_A=limit), horizon=horizon)
    for lead in (0.0, 3e-4, 5e-3):
        yield StressCase("lead", current=Current(limit_A=SMALL_A), horizon=Horizon(lead_s=lead))
    for dt in (1e-6, 1e-5, 1e-3):
        for limit in (SMALL_A, 4.0):
            yield StressCase("period", current=Current(limit_A=limit), horizon=Horizon(dt_s=dt, lead_s=0.0))
    for horizon in (Horizon(stages=0), Horizon(hand_over=0), Horizon(hand_over=101), Horizon(dt_s=0.0)):
        yield StressCase("input", horizon=horizon)
    yield StressCase("input", horizon=Horizon(lead_s=float("nan")))


def _demands() -> Iterator[StressCase]:
    for kind in ("constant", "denormal", "noise", "sample", "huge", "overflow", "nan", "empty"):
        yield StressCase("reference", demand=Demand(kind))
    for speed in (0.0, 1e-6, 1e-2, 5.0):
        yield StressCase("speed", demand=Demand(speed_m_s=speed))
    for weights in ("late", "sparse", "none", "tiny"):
        for rho in (0.0, 1e-12, 1e-3):
            for limit in (SMALL_A, 4.0):
                yield StressCase("weights", current=Current(limit_A=limit), demand=Demand(weights=weights, rho=rho))
    for rho in (0.0, 1e-12, 1e3):
        for limit in (SMALL_A, 4.0):
            yield StressCase("rho", current=Current(limit_A=limit), demand=Demand(rho=rho))
    for rapid, weights, rho in itertools.product(("pacinian", "highpass"), ("intention", "none"), (1e-3, 0.0)):
        demand = Demand(rapid=rapid, weights=weights, rho=rho)
        yield StressCase("filter", current=Current(limit_A=SMALL_A), demand=demand)
    for price in (1e-8, 1e-4, 1.0):
        demand = Demand(rapid="highpass", weights="intention", heat_price=price)
        yield StressCase("heat price", current=Current(limit_A=SMALL_A), demand=demand)
    yield StressCase("input", demand=Demand(rho=-1.0))


def _heat() -> Iterator[StressCase]:
    for tau in (1e-5, 1e-3, 12.0, 1e4):
        yield StressCase("coil", coil=Coil(tau_w_s=tau))
    yield StressCase("coil", coil=Coil(tau_w_s=1e-5, tau_h_s=1e-4))
    yield StressCase("coil", coil=Coil(nodes=1))
    for below in (1e-6, 0.0, -1e-6):
        yield StressCase("start", coil=Coil(below_K=below))
    for share in (0.05, 0.6, 1.5):
        yield StressCase("repeated", coil=Coil(below_K=20.0, tap_share=share))


def _walls() -> Iterator[StressCase]:
    for stiffness in (200.0, 2e3, 2e4):
        for speed in (0.1, 0.4):
            yield StressCase("wall", surface=Surface(stiffness), demand=Demand(speed_m_s=speed))
    yield StressCase("wall", surface=Surface(0.0, 0.0))
    yield StressCase("wall", surface=Surface(500.0), current=Current(limit_A=SMALL_A))
    yield StressCase("wall", surface=Surface(500.0), current=Current(slew=0.05))
    yield StressCase("wall", surface=Surface(500.0, latency_ticks=5), current=Current(delay_samples=2.999))
    yield StressCase("input", surface=Surface(-1.0))


def _intensities() -> Iterator[StressCase]:
    for limit in (SMALL_A, 1.0, 1e3):
        cut = Current(limit_A=limit)
        for share in (1e-6, 0.5, 1.0):
            yield StressCase("price", current=cut, demand=replace(SATURATED, price=share))
        for asked in (-3.0, 0.0, 6.0):
            yield StressCase("intensity", current=cut, demand=replace(SATURATED, asked_dB=asked))
    for weights in ("late", "tiny"):
        yield StressCase("intensity", current=Current(limit_A=1.0), demand=Demand(weights=weights, asked_dB=0.0))
    yield StressCase("intensity", coil=Coil(), demand=replace(SATURATED, asked_dB=0.0))
    yield StressCase("intensity", surface=Surface(500.0), demand=replace(SATURATED, asked_dB=0.0))
    yield StressCase("input", demand=Demand(price=-1.0))


def _tails() -> Iterator[StressCase]:
    for after in (1, 30, 300):
        for current in (Current(limit_A=SMALL_A), Current(limit_A=1.0, slew=0.1), Current(pole_Hz=None)):
            yield StressCase("tail", current=current, horizon=Horizon(after=after), demand=SATURATED)
        yield StressCase("tail", horizon=Horizon(after=after), surface=Surface(500.0))
        yield StressCase("tail", horizon=Horizon(after=after), coil=Coil())
    late = Current(limit_A=1.0, delay_samples=20.0)
    yield StressCase("lost", current=late, horizon=Horizon(lead_s=0.0, lost=True, after=30), demand=SATURATED)
    yield StressCase("input", horizon=Horizon(after=-1))


def directed() -> list[StressCase]:
    """All directed cases."""
    return [*_devices(), *_currents(), *_horizons(), *_demands(), *_heat(), *_walls(), *_intensities(), *_tails()]


def rescaled(case: StressCase, units: float) -> StressCase:
    """The case with the states of its device in other units."""
    return replace(case, device=replace(case.device, units=units))


def long_cases() -> list[StressCase]:
    """Cases with horizons of 20000 stages, which take seconds each."""
    slow = Horizon(stages=20000)
    return [
        StressCase("long", horizon=slow),
        StressCase("long", current=Current(limit_A=SMALL_A), horizon=slow),
        StressCase("long", current=Current(limit_A=SMALL_A), horizon=slow, demand=Demand("noise")),
    ]
