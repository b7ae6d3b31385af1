"""Dead times beside plants of known order, and plants without one that lag, or whose zeros are unstable."""

from collections.abc import Callable

import numpy as np
import pytest

from transopt.identify.dead_time import DeadTime, dead_time
from transopt.identify.response_fit import fit_response
from transopt.plant.state_space import CURRENT_INPUT

F_HZ = np.linspace(5, 1000, 300)
S = 2j * np.pi * F_HZ
W = 2 * np.pi * 150.0

Response = Callable[[np.ndarray], np.ndarray]


def resonance(s: np.ndarray) -> np.ndarray:
    return 10 * s**2 / (s**2 + s * W / 8 + W**2)


def lagged(s: np.ndarray) -> np.ndarray:
    """The resonance behind an amplifier of 700 Hz."""
    return resonance(s) / (1 + s / (2 * np.pi * 700))


def unstable_zero(s: np.ndarray) -> np.ndarray:
    """The resonance beside a real zero at +400 Hz and a pole at -200 Hz, as of an actuator and sensor apart."""
    return resonance(s) * (1 - s / (2 * np.pi * 400)) / (1 + s / (2 * np.pi * 200))


def apart(s: np.ndarray) -> np.ndarray:
    """Three resonances of unlike signs, as between two places of one body, behind a lag of 2 kHz."""
    parts = ((60.0, 9.0, 1.0), (260.0, 15.0, -0.8), (520.0, 6.0, 0.5))
    rates = [(2 * np.pi * f, quality, gain) for f, quality, gain in parts]
    return sum(g * s**2 / (s**2 + s * w / q + w**2) for w, q, g in rates) / (1 + s / (2 * np.pi * 2000))


def found(plant: Response, order: int, delay_s: float = 0.0, noise: float = 0.0) -> DeadTime | None:
    G = plant(S) * np.exp(-S * delay_s)
    random, deviation = np.random.default_rng(3), noise * np.abs(G).max()
    G = G + deviation * (random.standard_normal(F_HZ.size) + 1j * random.standard_normal(F_HZ.size))
    deviations = np.full(F_HZ.size, deviation) if noise else None
    return dead_time(fit_response(F_HZ, G, order, CURRENT_INPUT, deviations=deviations))


@pytest.mark.parametrize(
    ("delay_s", "order", "noise"), [(3e-4, 3, 0.01), (5e-4, 5, 0.003), (2e-3, 8, 0.0), (2e-3, 8, 0.01)]
)
def test_a_dead_time_is_told_from_states(delay_s: float, order: int, noise: float) -> None:
    late = found(resonance, order, delay_s, noise)
    assert late is not None
    assert late.order == 2
    assert late.delay_s == pytest.approx(delay_s, abs=1e-5)


@pytest.mark.parametrize(("more", "noise"), [(0, 0.003), (1, 0.0), (3, 0.01)])
@pytest.mark.parametrize(("plant", "order"), [(resonance, 2), (lagged, 3), (unstable_zero, 3), (apart, 7)])
def test_a_plant_without_one_is_not_late(plant: Response, order: int, more: int, noise: float) -> None:
    assert found(plant, order + more, noise=noise) is None
