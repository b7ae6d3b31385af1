"""Do the intervals of `transopt identify hand` cover the truth as often as they say?

    python scripts/hand_coverage.py [--repeats 200] [--seed 1] [--json FILE]
    python scripts/hand_coverage.py --bias

Repeats the whole experiment: 81 simulated taps of scattering hands (`problems.generators.tapping_trials`), a fit per
tap, lines over grip, bootstrap intervals. Exit code 1 if one of the six coefficients is covered less than 90 or more
than 99 %.
`--bias`: what noise, the low-pass and the accelerometer's pole do to a fit of hands that do not scatter.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np

from problems.generators.tapping_trials import Sensors, Spread, recorded, second_order_hands, session, surface
from transopt.base.files import whole_file
from transopt.base.signals import FloatArray
from transopt.base.writing import table
from transopt.identify.hand import tap as hand_tap
from transopt.identify.hand.lines import COEFFICIENTS, HandFit, fit_hand
from transopt.identify.hand.tap import cut_tap, fit_tap
from transopt.plant.second_order import SEED_HAND_DAMPING_N_S_M, SEED_HAND_MASS_KG, SEED_HAND_STIFFNESS_N_M
from transopt.recordings.settings import SimulatedTaps

TRUTH = np.array(
    [
        value
        for line in (SEED_HAND_MASS_KG, SEED_HAND_DAMPING_N_S_M, SEED_HAND_STIFFNESS_N_M)
        for value in (line.constant, line.per_newton)
    ]
)
COVERED = (0.90, 0.99)
BATCH = 5  # experiments simulated at once


@dataclass(frozen=True)
class Coverage:
    """Of R experiments: fitted coefficients (R, 6) and their 95 % intervals (R, 6, 2)."""

    found: FloatArray
    intervals: FloatArray

    @property
    def covered(self) -> FloatArray:
        """(6,) share of the experiments whose interval holds the truth."""
        return np.asarray(((self.intervals[..., 0] <= TRUTH) & (self.intervals[..., 1] >= TRUTH)).mean(axis=0))


def coefficients(fit: HandFit) -> tuple[FloatArray, FloatArray]:
    """(6,) and (6, 2) in the order of `COEFFICIENTS`."""
    found = [value for line in fit.lines for value in (line.line.constant, line.line.per_newton)]
    return np.array(found), np.concatenate([line.intervals for line in fit.lines])


def experiments(repeats: int, seed: int) -> Coverage:
    random = np.random.default_rng([seed, 2])
    target = surface()
    found: list[FloatArray] = []
    intervals: list[FloatArray] = []
    while len(found) < repeats:
        batch = min(BATCH, repeats - len(found))
        grips, speeds = (
            np.concatenate(values) for values in zip(*(session(random) for _ in range(batch)), strict=True)
        )
        hands = second_order_hands(grips, random, Spread())
        trials = recorded(hands, grips, speeds, random, target=target)
        taps = [
            cut_tap(
                f"{j}",
                trials.force_N[j],
                trials.acceleration_m_s2[j],
                float(trials.times_s[1]),
                grip_N=float(trials.grip_N[j]),
                accelerometer_Hz=trials.accelerometer_Hz,
            )
            for j in range(grips.size)
        ]
        for part in np.array_split(np.arange(grips.size), batch):
            value, interval = coefficients(fit_hand([taps[j] for j in part], seed=len(found)))
            found.append(value)
            intervals.append(interval)
    return Coverage(np.array(found), np.array(intervals))


def coverage_rows(coverage: Coverage) -> list[list[str]]:
    bias = coverage.found.mean(axis=0) - TRUTH
    spread = coverage.found.std(axis=0, ddof=1)
    width = (coverage.intervals[..., 1] - coverage.intervals[..., 0]).mean(axis=0)
    return [
        [name, f"{TRUTH[j]:.5g}", f"{bias[j]:+.2g}", f"{spread[j]:.2g}", f"{width[j]:.2g}", f"{100 * share:.1f}"]
        for j, (name, share) in enumerate(zip(COEFFICIENTS, coverage.covered, strict=True))
    ]


def relative_errors(sensors: Sensors, target: SimulatedTaps, *, told_pole: bool = True) -> FloatArray:
    """(81, 3) relative errors of mass, damping and stiffness of taps of hands that do not scatter."""
    random = np.random.default_rng(3)
    grips, speeds = session(random)
    trials = recorded(
        second_order_hands(grips, random, Spread(0, 0, 0)), grips, speeds, random, target=target, sensors=sensors
    )
    errors = []
    for j, grip_N in enumerate(grips.tolist()):
        tap = cut_tap(
            f"{j}",
            trials.force_N[j],
            trials.acceleration_m_s2[j],
            float(trials.times_s[1]),
            grip_N=grip_N,
            accelerometer_Hz=sensors.accelerometer_Hz if told_pole else None,
        )
        fit = fit_tap(tap)
        errors.append(
            [
                fit.mass_kg / SEED_HAND_MASS_KG.at(grip_N) - 1,
                fit.damping_N_s_m / SEED_HAND_DAMPING_N_S_M.at(grip_N) - 1,
                fit.stiffness_N_m / SEED_HAND_STIFFNESS_N_M.at(grip_N) - 1,
            ]
        )
    return np.array(errors)


def bias_rows() -> list[list[str]]:
    target, usual = surface(), Sensors()
    quiet = replace(usual, noise_g_rtHz=0.0, force_N=0.0)
    rows = []

    def add(label: str, errors: FloatArray) -> None:
        mean, spread = 100 * errors.mean(axis=0), 100 * errors.std(axis=0, ddof=1)
        rows.append([label, *(f"{m:+.2f} ({s:.2f})" for m, s in zip(mean, spread, strict=True))])

    add("no noise", relative_errors(quiet, target))
    add("no noise, the accelerometer's pole not stated", relative_errors(quiet, target, told_pole=False))
    add("noise", relative_errors(usual, target))
    loud = replace(usual, noise_g_rtHz=10 * usual.noise_g_rtHz)
    add("ten times the accelerometer's noise", relative_errors(loud, target))
    with mock.patch.object(hand_tap, "LOWPASS_HZ", np.inf):
        add("ten times the accelerometer's noise, no low-pass", relative_errors(loud, target))
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--bias", action="store_true")
    options = parser.parse_args(arguments)
    if options.bias:
        print(
            "\n".join(
                table(["mean (standard deviation) of the error, %", "mass", "damping", "stiffness"], bias_rows())
            )
        )
        return 0
    coverage = experiments(options.repeats, options.seed)
    head = ["coefficient", "truth", "bias", "scatter", "width of the interval", "covered %"]
    print("\n".join(table(head, coverage_rows(coverage))))
    if options.json:
        covered = dict(zip(COEFFICIENTS, coverage.covered.tolist(), strict=True))
        with whole_file(options.json) as file:
            file.write(json.dumps({"repeats": options.repeats, "seed": options.seed, "covered": covered}).encode())
    return int(not np.all((coverage.covered >= COVERED[0]) & (coverage.covered <= COVERED[1])))


if __name__ == "__main__":
    sys.exit(main())
