"""Detects a dead time in a measured response, on which a fit of a state space spends states.

A rational fit of exp(-s T) is all-pass: every zero in the right half plane mirrors a pole, as in a Pade
approximation, and turns the phase by at most half a turn. So n of them stand for at most n / 2 periods of the highest
frequency. The verdict comes from fits of fewer states to the response with a delay taken out: if one follows as well,
the delay is a dead time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import eigvals
from scipy.optimize import minimize_scalar

from transopt.base.signals import ComplexArray
from transopt.base.sizes import LONGEST_DELAY_S
from transopt.identify.response_fit import CERTAIN, RELOCATIONS, ResponseFit, fit_response
from transopt.plant.state_space import StateSpace

FOLLOWS = 0.01  # misfit beyond noise up to which a delayed fit explains a response that a fit does not follow
EXACT = 1e-3  # the same beside a fit that follows: a smaller misfit of its own is not asked for
LEAST = 0.25  # period of the highest frequency: a shorter delay is not told from the lag of an amplifier or a sensor
MOST_TURNS = 8  # half turns of the highest frequency that are tried where a fit does not follow the response
TRIED = 24  # delays tried per period of the highest frequency: half a step off costs a misfit of about five percent
ROUGH = 8  # relocations of the poles that tell the delays of the grid apart, in half the time of converged fits
SHARP = 1e-4  # of that period: how closely the delay is found


@dataclass(frozen=True)
class DeadTime:
    """A dead time beside a plant of fewer states.

    Attributes
    ----------
    delay_s : the dead time. order : number of states that follow the response without it.
    """

    delay_s: float
    order: int


def dead_time(fit: ResponseFit) -> DeadTime | None:
    """The dead time that a fit replaces by states; None if no delay makes fewer states follow the response as well.

    A fit that may not be used is compared with delayed ones of as many states too.
    """
    good, period_s = fit.fit_to_design_with, 1 / float(fit.frequencies_Hz[-1])
    unstable = int(np.sum(_zeros(fit.plant).real > 2 * np.pi * fit.frequencies_Hz[0]))
    if good and not unstable:
        return None
    turns = (unstable + 1 if good else MOST_TURNS) / 2
    longest_s = min(turns * period_s, LONGEST_DELAY_S)
    bound = max(_beyond_noise(fit), EXACT**2) if good else FOLLOWS**2

    def late(order: int) -> DeadTime | None:
        off = partial(_off, fit, order)
        delay_s = _best_delay(off, longest_s, period_s)
        return DeadTime(delay_s, order) if off(delay_s) <= bound else None

    too_few, enough = 0, fit.plant.order - good
    found = late(enough) if enough else None
    while found is not None and enough - too_few > 1:  # more states follow whatever fewer do
        order = (too_few + enough) // 2
        fewer = late(order)
        found, too_few, enough = (found, order, enough) if fewer is None else (fewer, too_few, order)
    if found is None or found.delay_s < LEAST * period_s or _off(fit, found.order, 0.0) <= bound:
        return None
    return found


def _off(fit: ResponseFit, order: int, delay_s: float, relocations: int = RELOCATIONS) -> float:
    """What noise does not explain of the misfit of `order` states to the same response with a delay taken out."""
    ahead = fit.measured * np.exp(2j * np.pi * fit.frequencies_Hz * delay_s)
    other = fit_response(
        fit.frequencies_Hz,
        ahead,
        order,
        fit.plant.driven_by,
        deviations=fit.deviations,
        relocations=relocations,
    )
    return _beyond_noise(other)


def _beyond_noise(fit: ResponseFit) -> float:
    """Square of the misfit that noise does not explain, with an allowance for the noise of its own estimate."""
    return fit.misfit**2 - (1 + CERTAIN / float(np.sqrt(fit.frequencies_Hz.size))) * fit.noise**2


def _best_delay(off: Callable[..., float], longest_s: float, period_s: float) -> float:
    """The delay [s] of the least misfit, by a grid of rough fits and a bounded search around its best delay."""
    step_s = period_s / TRIED
    grid = np.arange(step_s, longest_s + step_s / 2, step_s)
    best_s = float(grid[np.argmin([off(float(each), ROUGH) for each in grid])])
    bounds = (best_s - step_s, best_s + step_s)
    return float(minimize_scalar(off, bounds=bounds, method="bounded", options={"xatol": SHARP * period_s}).x)


def _zeros(plant: StateSpace) -> ComplexArray:
    """Finite invariant zeros [1/s] of the acceleration: where [[A - s I, B], [C, D]] is singular."""
    order = plant.order
    pencil = np.block([[plant.A, plant.B], [plant.C, plant.D]])
    identity = np.zeros_like(pencil)
    identity[:order, :order] = np.eye(order)
    zeros = eigvals(pencil, identity)
    return np.asarray(zeros[np.isfinite(zeros)])
