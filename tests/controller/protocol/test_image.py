"""A library as a device stores it: what comes back, and what does not fit."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.protocol.capacity import Capacity
from controller.protocol.configuration import HEADER
from controller.protocol.image import HEADER as IMAGE_HEADER
from controller.protocol.image import IMAGE_FIELDS, bank_of, image_bytes, image_of, too_large
from controller.servo.settings import Settings
from controller.waveforms.bank import Method, bank
from tests.benches.compiled import smooth_bank as table
from tests.benches.device import IMAGE, SETTINGS
from tests.benches.servo import DT_S
from transopt.base.errors import InputError
from transopt.library.library import Library

CAPACITY = Capacity()


def changed(image: bytes, **values: float) -> bytes:
    """An image with other numbers in its header."""
    head = dict(zip((name for name, _ in IMAGE_FIELDS), IMAGE_HEADER.unpack_from(image), strict=True))
    return IMAGE_HEADER.pack(*{**head, **values}.values()) + image[IMAGE_HEADER.size :]


def test_the_built_in_library_survives_within_half_a_count(library: Library) -> None:
    original = bank(library)
    settings = Settings.of(library)
    image = image_of(original, settings.dt_s, settings.lead_s, library.hand_over_samples)
    assert len(image) == image_bytes(*original.command_A.shape)
    stored, _ = bank_of(image)
    scale = np.max(np.abs(original.command_A)) / 32767
    assert np.max(np.abs(stored.command_A - original.command_A)) <= 0.5000001 * scale
    # What is stored survives a second trip to the bit.
    again = image_of(stored, settings.dt_s, settings.lead_s, library.hand_over_samples)
    np.testing.assert_array_equal(bank_of(again)[0].command_A, stored.command_A)
    for name in ("speeds_m_s", "grips_N", "feedback_A", "grip_min_N", "by_grip", "nearest", "method"):
        assert getattr(stored, name) == getattr(original, name)
    # The norms are computed from the commands, and bound those of the currents closely.
    currents, commands = np.array(original.transient_A), np.array(stored.transient_A)
    assert np.all(commands >= currents * (1 - 1e-6))
    assert np.all(commands <= 1.1 * currents)


@given(st.integers(1, 4), st.integers(1, 4), st.integers(11, 40), st.booleans(), st.booleans())
def test_every_shape_comes_back(speeds: int, grips: int, samples: int, by_grip: bool, nearest: bool) -> None:
    method = Method.NEAREST if nearest else Method.BILINEAR
    original = replace(table(speeds, grips, samples), by_grip=by_grip, nearest=nearest, method=method)
    stored, head = bank_of(image_of(original, DT_S, SETTINGS.lead_s, 10))
    assert stored.command_A.shape == (speeds, grips, samples)
    np.testing.assert_allclose(stored.command_A, original.command_A, atol=0.51 * head["scale_A"])
    assert (stored.by_grip, stored.nearest, stored.method) == (by_grip, nearest, method)


def test_float64_lie_on_multiples_of_8() -> None:
    assert IMAGE_HEADER.size % 8 == HEADER.size % 8 == 0
    offset = 0
    for _, form in IMAGE_FIELDS:
        assert offset % struct.calcsize(form) == 0
        offset += struct.calcsize("<" + form)


def test_what_cannot_become_an_image() -> None:
    with pytest.raises(InputError, match="not all zero"):
        image_of(table(), DT_S, SETTINGS.lead_s, 20)
    with pytest.raises(InputError, match="not all zero"):
        image_of(table(), DT_S, SETTINGS.lead_s, 0)
    with pytest.raises(InputError, match="no number"):
        image_of(replace(table(), command_A=np.full((2, 2, 20), np.nan)), DT_S, SETTINGS.lead_s, 10)
    with pytest.raises(InputError, match="no waveforms"):
        image_of(replace(table(), command_A=np.zeros((2, 2, 0))), DT_S, SETTINGS.lead_s, 10)


def test_sizes_beyond_the_device_are_named() -> None:
    image = image_of(table(10, 8, 600), DT_S, SETTINGS.lead_s, 10)
    small = Capacity(samples=20_000)
    words = too_large(image, small)
    assert words is not None
    assert "10 speeds x 8 grips x 600 samples" in words
    assert "a grid of 6 speeds x 5 grips or 250 samples (25 ms, or 4.16 kHz) would fit" in words
    assert 6 * 5 * 600 <= 20_000
    for capacity in (Capacity(speeds=9), Capacity(grips=7), Capacity(waveform_samples=599)):
        assert too_large(image, capacity) is not None
    assert "with more memory" in str(too_large(image, Capacity(samples=70, waveform_samples=1)))
    assert too_large(image, CAPACITY) is None


@given(st.integers(1, 30), st.integers(1, 30), st.integers(1, 3000), st.integers(1, 50_000))
def test_the_advised_grid_fits(speeds: int, grips: int, samples: int, room: int) -> None:
    head = changed(IMAGE, speeds=speeds, grips=grips, samples=samples)[: IMAGE_HEADER.size]
    image = head + bytes(image_bytes(speeds, grips, samples) - len(head))
    capacity = Capacity(samples=room, speeds=20, grips=10, waveform_samples=2000)
    words = too_large(image, capacity)
    fits = speeds <= 20 and grips <= 10 and samples <= 2000 and speeds * grips * samples <= room
    assert (words is None) == fits
    if words is not None and "a grid of" in words:
        v, g = (int(x) for x in words.split("a grid of ")[1].split(" grips")[0].split(" speeds x "))
        assert v <= 20
        assert g <= 10
        assert v * g * samples <= room
