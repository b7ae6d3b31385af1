"""The real servo plays a library on the nominal device: on time and as predicted.

`scripts/playback_accuracy.py` is the long form, over more phases, seeds and points.
"""

from dataclasses import replace

import numpy as np
import pytest

from controller.servo.interface import Notice
from controller.servo.servo import Servo
from controller.servo.settings import Settings
from controller.sim.played_tap import play_tap
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections
from controller.waveforms.bank import Bank, Method, bank
from scripts.playback_accuracy import MOST_LATENCY_S, MOST_NRMSE, at_node, between, inside
from transopt.library.library import Library


@pytest.fixture(scope="module")
def tables(library: Library) -> Bank:
    return bank(library)


@pytest.mark.parametrize("iv", range(4))
@pytest.mark.parametrize("ig", range(3))
def test_every_node_is_on_time_and_as_predicted(library: Library, tables: Bank, iv: int, ig: int) -> None:
    node = at_node(library, tables, iv, ig, np.array([0.0, 0.3, 0.65]), seeds=1)
    assert node.latency_rms_s <= MOST_LATENCY_S
    assert node.nrmse <= MOST_NRMSE
    assert node.nrmse_reference <= library.nrmse[iv, ig] + MOST_NRMSE
    assert node.peak_current_A <= 4.0 + 1e-6


def test_between_the_nodes_only_interpolation_is_added(library: Library, tables: Bank) -> None:
    points = [between(library, tables, float(v), float(F), seed) for seed, (v, F) in enumerate(inside(library, 12))]
    late = np.array([p.latency_s for p in points])
    assert np.sqrt(np.mean(late**2)) <= MOST_LATENCY_S
    for p in points:
        assert p.nrmse <= MOST_NRMSE, p
        assert p.nrmse_blend <= p.interpolation + MOST_NRMSE, p


@pytest.mark.parametrize("mismatch", [0.1, 0.2])
def test_a_mismatched_amplifier_stays_within_the_limit_it_was_told_of(
    library: Library, tables: Bank, mismatch: float
) -> None:
    """Seed 3 draws a faster pole: without the tolerance its current passes the limit."""
    tap = SimulatedTap(0.4, 5.0, seed=3, imperfections=Imperfections(mismatch=mismatch, crossover_A=0.0))
    settings = Settings.of(library)
    told = replace(settings, amplifier_tolerance=mismatch)
    peaks = [play_tap(library, Servo(s, tables), tap).peak_current_A for s in (settings, told)]
    assert peaks[0] > 4.02
    assert peaks[1] <= 4.0 + 1e-6


def test_every_method_plays_within_the_limits(library: Library) -> None:
    for method in Method:
        m = play_tap(library, Servo(Settings.of(library), bank(library, method)), SimulatedTap(0.35, 4.5))
        assert not m.faults, method
        assert m.notices[Notice.CONTACT] == 1
        assert m.played == (method is not Method.PROPORTIONAL), method
        assert m.peak_current_A <= 4.0 + 1e-6
