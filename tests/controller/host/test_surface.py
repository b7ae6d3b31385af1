"""Rests on the surface: drift between taps, and the touches of `zero`."""

from collections.abc import Iterable

import numpy as np
import pytest

from controller.host.surface import IN_A_ROW, Drift, Touches
from controller.protocol.events import Happened, Samples
from controller.protocol.messages import Record
from controller.servo.interface import Notice

DT_S, COUNT_M, SURFACE = 1e-4, 24.5e-6, 1000.0
REST = 3000  # ticks


def at(counts: Iterable[int], feedback_A: float = 0.0) -> list[Samples]:
    """A batch of one tick each."""
    return [Samples(0, 1, (Record(int(c), 3.0, 0.0, 0.0, 0.0, 0.0, feedback_A, 25.0, 0, 0),), 0) for c in counts]


def contact() -> Happened:
    return Happened(0, 0, Notice.CONTACT, 0.2, 3.0, 0)


def tapped(drift: Drift, *offsets: int, spread: int = 1, feedback_A: float = 0.0) -> None:
    """A tap, and then a rest at so many counts from the surface, for each."""
    for offset in offsets:
        drift.take(contact())
        for samples in at((1000 + offset + j % (spread + 1) for j in range(REST)), feedback_A):
            drift.take(samples)


@pytest.fixture
def drift() -> Drift:
    return Drift(DT_S, COUNT_M, SURFACE)


def test_three_rests_on_one_side_move_the_surface_by_their_median(drift: Drift) -> None:
    tapped(drift, 6, 9)
    assert drift.moved == 0.0
    tapped(drift, 7)
    assert drift.moved == pytest.approx(7.5, abs=0.5)
    drift.done(drift.moved)
    assert (drift.moved, drift.surface_counts) == (0.0, pytest.approx(1007.5, abs=0.5))
    tapped(drift, 7, 8, 7, 8)
    assert drift.moved == 0.0


def test_a_hand_that_leans_on_a_wall_does_not_pull_the_surface_after_it(drift: Drift) -> None:
    """0.5 N on 2000 N/m rest 10 counts below the surface, where a feedback current of 0.4 A balances them."""
    tapped(drift, *[-10] * 9, feedback_A=0.4)
    assert drift.moved == 0.0
    tapped(drift, *[-10] * 3)
    assert drift.moved == pytest.approx(-9.5, abs=0.5)


def test_the_surface_is_not_moved_while_a_feedback_current_flows(drift: Drift) -> None:
    tapped(drift, 6, 7, 8)
    for samples in at([990], 0.4):
        drift.take(samples)
    assert drift.moved == 0.0
    for samples in at([1007]):
        drift.take(samples)
    assert drift.moved == pytest.approx(7.5, abs=0.5)


@pytest.mark.parametrize(
    "offsets",
    [
        (6, 0, 7, 8),  # one where it was
        (6, 7, -6, 7),  # one on the other side
        (1, 1, 1, 1),  # within the band
        (40, 41, 40, 41),  # a millimetre up: not at the surface
    ],
)
def test_what_is_no_drift(drift: Drift, offsets: tuple[int, ...]) -> None:
    tapped(drift, *offsets)
    assert drift.moved == 0.0


def test_a_trembling_hand_is_no_rest_and_one_tap_counts_once(drift: Drift) -> None:
    tapped(drift, 6, 6, 6, 6, spread=8)
    assert drift.moved == 0.0
    tapped(drift, 6)
    for samples in at([1006] * 5 * REST):
        drift.take(samples)
    assert drift.moved == 0.0


def test_a_fine_encoder_has_a_band_of_its_own() -> None:
    fine = Drift(DT_S, 1e-6, SURFACE)
    tapped(fine, 30, 30, 30, spread=20)
    assert fine.moved == 0.0
    tapped(fine, 80, 80, 80, spread=20)
    assert fine.moved == pytest.approx(90, abs=11)


def test_three_touches_at_one_place_are_the_surface() -> None:
    touches = Touches(DT_S, COUNT_M)
    away = np.concatenate([np.linspace(0, 200, 500), np.linspace(200, 0, 500)])
    for offset in (0, 1, -1):
        for counts in (1234 + offset + away, np.full(REST, 1234 + offset)):
            for samples in at(counts):
                touches.take(samples)
    assert touches.agree
    assert len(touches.counts) == IN_A_ROW
    assert touches.surface == pytest.approx(1234)


@pytest.mark.parametrize("direction", [1, -1])
def test_rests_in_the_air_between_the_touches_are_no_touches(direction: int) -> None:
    """Whoever pauses above the surface rests there, at one place or at several."""
    touches = Touches(DT_S, COUNT_M, direction)
    found = []
    for counts in (900, 0, 700, 1, 900, -1):
        move = np.linspace(counts + 300, counts, REST // 2)
        for samples in at(direction * np.concatenate([move, np.full(REST, counts)])):
            touches.take(samples)
        found.append(touches.agree)
    assert found == [False] * 5 + [True]
    assert touches.surface == pytest.approx(0)


def test_a_place_below_the_surface_is_forgotten() -> None:
    touches = Touches(DT_S, COUNT_M)
    for counts in (-400, *[0, 300] * 2, 0):
        for samples in at(np.concatenate([np.full(REST // 2, counts + 100), np.full(REST, counts)])):
            touches.take(samples)
        assert not touches.agree
    for counts in (300, 0):
        for samples in at(np.concatenate([np.full(REST // 2, counts + 100), np.full(REST, counts)])):
            touches.take(samples)
    assert touches.agree
    assert touches.surface == pytest.approx(0)


def test_a_stylus_that_lies_still_has_touched_once() -> None:
    touches = Touches(DT_S, COUNT_M)
    for samples in at([1234] * 5 * REST):
        touches.take(samples)
    assert len(touches.counts) == 1
    assert not touches.agree
