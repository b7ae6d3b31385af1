"""Random tapping and faults, servo on simulator; `scripts/soak.py` and `scripts/fault_injection.py` in short."""

import pytest

from controller.servo.interface import Notice
from controller.waveforms.bank import Bank, bank
from scripts.fault_injection import INJECTIONS, Injection, inject
from scripts.soak import STRETCHES, Stretch, Tally, soak
from transopt.library.library import Library


@pytest.fixture(scope="module")
def tables(library: Library) -> Bank:
    return bank(library)


@pytest.mark.parametrize("stretch", STRETCHES, ids=lambda s: s.name)
def test_limits_hold_and_nothing_is_left_unsaid(library: Library, tables: Bank, stretch: Stretch) -> None:
    tally = Tally()
    soak(library, tables, stretch, 5, tally, duration_s=4.0)
    assert tally.violations == []
    assert tally.contacts >= 5
    assert tally.notices[Notice.CONTACT] >= 3
    if stretch.hot:
        assert tally.notices[Notice.SCALED_FOR_HEAT] + tally.notices[Notice.TOO_HOT_TO_PLAY] > 0


def test_a_faster_amplifier_than_the_servo_knows_is_a_violation(library: Library, tables: Bank) -> None:
    """What the soak would find: seed 3 draws such a device."""
    tally = Tally()
    soak(library, tables, Stretch("told nothing", mismatch=0.2), 3, tally, duration_s=3.0, amplifier_tolerance=0.0)
    assert [words.split()[0] for words in tally.violations] == ["current"]


@pytest.mark.parametrize("injection", INJECTIONS, ids=lambda i: i.name)
@pytest.mark.parametrize("seed", range(3))
def test_every_fault_is_caught_at_once_in_closed_loop(
    library: Library, tables: Bank, injection: Injection, seed: int
) -> None:
    outcome = inject(library, tables, injection, seed)
    assert outcome.wrong == ""
    assert outcome.late_ticks == 0
