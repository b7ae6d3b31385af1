"""What a device of a small memory is given of a library with cool commands."""

from dataclasses import replace

import numpy as np
import pytest

from controller.host.payload import Load, fitted
from controller.protocol.capacity import Capacity
from controller.protocol.configuration import configuration_of
from controller.protocol.image import bank_of, image_of
from tests.benches.compiled import DT_S, SETTINGS, TAIL, cooled, smooth_bank

BANK = cooled(smooth_bank(2, 2, 61))
COUNT = 2 * 2 * 61
GIVEN = Load(SETTINGS, configuration_of(SETTINGS), image_of(BANK, DT_S, SETTINGS.lead_s, TAIL))


@pytest.mark.parametrize(
    ("samples", "bits", "words"),
    [
        (2 * COUNT, 16, ""),
        (2 * COUNT - 1, 8, "in 8 bit"),
        (3 * COUNT // 2, 8, "in 8 bit"),
        (3 * COUNT // 2 - 1, 0, "scaled down instead"),
        (COUNT, 0, "scaled down instead"),
        (COUNT - 1, 16, ""),
    ],
)
def test_second_waveforms_go_where_there_is_room(samples: int, bits: int, words: str) -> None:
    """What does not even hold the first ones is refused as ever, by the session."""
    found, said = fitted(GIVEN, Capacity(samples=samples))
    bank, head = bank_of(found.image)
    assert head["cool_bits"] == bits
    assert said.count("\n") == 0
    assert words in said
    assert bool(words) == bool(said)
    np.testing.assert_array_equal(bank.command_A, bank_of(GIVEN.image)[0].command_A)
    assert (found.settings, found.configuration) == (GIVEN.settings, GIVEN.configuration)
    assert fitted(found, Capacity(samples=samples)) == (found, "")


def test_a_library_without_second_waveforms_stays_as_it_is() -> None:
    plain = replace(GIVEN, image=image_of(smooth_bank(2, 2, 61), DT_S, SETTINGS.lead_s, TAIL))
    for samples in (COUNT, COUNT - 1):
        assert fitted(plain, Capacity(samples=samples)) == (plain, "")
