"""Do the intervals of `transopt identify hand` cover the truth as often as they say?"""

import numpy as np
import pytest

from problems.generators.tapping_trials import Spread, recorded, second_order_hands, session
from transopt.base.signals import FloatArray
from transopt.identify.hand.lines import fit_hand
from transopt.identify.hand.tap import cut_tap
from transopt.plant.second_order import SEED_HAND_DAMPING_N_S_M, SEED_HAND_MASS_KG, SEED_HAND_STIFFNESS_N_M

LINES = (SEED_HAND_MASS_KG, SEED_HAND_DAMPING_N_S_M, SEED_HAND_STIFFNESS_N_M)
TRUTH = np.array([value for line in LINES for value in (line.constant, line.per_newton)])
BATCH = 5  # experiments simulated at once


def experiments(repeats: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Coefficients (R, 6) and their 95 % intervals (R, 6, 2), each of 81 simulated taps of scattering hands."""
    random, found, intervals = np.random.default_rng([seed, 2]), [], []
    while len(found) < repeats:
        batch = min(BATCH, repeats - len(found))
        drawn = zip(*(session(random) for _ in range(batch)), strict=True)
        grips, speeds = (np.concatenate(values) for values in drawn)
        trials = recorded(second_order_hands(grips, random, Spread()), grips, speeds, random)
        known = {"accelerometer_Hz": trials.accelerometer_Hz}
        dt_s = float(trials.times_s[1])
        taps = [
            cut_tap(f"{j}", force, acceleration, dt_s, grip_N=float(grip), **known)
            for j, (force, acceleration, grip) in enumerate(
                zip(trials.force_N, trials.acceleration_m_s2, trials.grip_N, strict=True)
            )
        ]
        for part in np.array_split(np.arange(grips.size), batch):
            lines = fit_hand([taps[j] for j in part]).lines
            found.append(np.array([value for one in lines for value in (one.line.constant, one.line.per_newton)]))
            intervals.append(np.concatenate([one.intervals for one in lines]))
    return np.array(found), np.array(intervals)


@pytest.mark.parametrize(
    ("repeats", "covered"),
    # At 95 % one in 10^4 falls below 6 of 10; of 200, 90 to 99 % are asked.
    [(10, (0.6, 1.0)), pytest.param(200, (0.9, 0.99), marks=(pytest.mark.long, pytest.mark.timeout(3600)))],
)
def test_intervals_cover_the_truth(repeats: int, covered: tuple[float, float]) -> None:
    found, intervals = experiments(repeats, 5)
    share = ((intervals[..., 0] <= TRUTH) & (intervals[..., 1] >= TRUTH)).mean(axis=0)
    assert np.all((share >= covered[0]) & (share <= covered[1])), share
    assert np.all(np.abs(found.mean(axis=0) - TRUTH) < found.std(axis=0, ddof=1))
