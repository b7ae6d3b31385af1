"""Library and configuration as a device stores them: what comes back, and what is refused with which reason."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.protocol.capacity import Capacity, Hardware
from controller.protocol.codes import Reason
from controller.protocol.configuration import (
    CONFIGURATION_BYTES,
    HEADER,
    NAMES,
    Configuration,
    ConfigurationError,
    accept,
    configuration_of,
)
from controller.protocol.image import HEADER as IMAGE_HEADER
from controller.protocol.image import (
    IMAGE_FIELDS,
    ImageError,
    bank_of,
    capacity_bytes,
    check,
    image_bytes,
    image_of,
    too_large,
)
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank, Method, bank
from scripts.campaign.compiled_device import smooth_bank as table
from tests.benches.device import CONFIGURATION, IMAGE, SETTINGS
from tests.benches.servo import AMPLIFIER, DT_S, WALL
from transopt.base.errors import InputError
from transopt.library.library import Library
from transopt.plant.coil import CoilModel

CAPACITY, HARDWARE = Capacity(), Hardware()


def settings_of(data: bytes) -> Settings:
    """What a device takes a configuration's bytes for."""
    return accept(data, CAPACITY, HARDWARE).settings


COIL = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0)
FULL = replace(
    SETTINGS,
    wall=WALL,
    coil=COIL,
    slew_limit_A_per_s=1e4,
    assumed_grip_N=0.0,
    amplifier_tolerance=0.1,
    grip_min_N=0.0,
)


def changed(image: bytes, **values: float) -> bytes:
    """An image with other numbers in its header."""
    head = dict(zip((name for name, _ in IMAGE_FIELDS), IMAGE_HEADER.unpack_from(image), strict=True))
    return IMAGE_HEADER.pack(*{**head, **values}.values()) + image[IMAGE_HEADER.size :]


def refused(image: bytes, settings: Settings = SETTINGS, capacity: Capacity = CAPACITY) -> Reason:
    with pytest.raises(ImageError) as error:
        check(image, accept(configuration_of(settings), CAPACITY, HARDWARE), capacity)
    return error.value.reason


def checked(image: bytes, settings: Settings = SETTINGS) -> Bank:
    return check(image, accept(configuration_of(settings), CAPACITY, HARDWARE), CAPACITY)


def test_the_built_in_library_survives_within_half_a_count(library: Library) -> None:
    original = bank(library)
    settings = Settings.of(library)
    image = image_of(original, settings.dt_s, settings.lead_s, library.meta["hand_over_samples"])
    assert len(image) == image_bytes(*original.command_A.shape)
    stored = checked(image, settings)
    scale = np.max(np.abs(original.command_A)) / 32767
    assert np.max(np.abs(stored.command_A - original.command_A)) <= 0.5000001 * scale
    # What is stored survives a second trip to the bit.
    again = image_of(stored, settings.dt_s, settings.lead_s, library.meta["hand_over_samples"])
    np.testing.assert_array_equal(bank_of(again)[0].command_A, stored.command_A)
    for name in ("speeds_m_s", "grips_N", "transient_A", "feedback_A", "grip_min_N", "by_grip", "nearest", "method"):
        assert getattr(stored, name) == getattr(original, name)


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


def test_a_silent_library_is_an_image_too() -> None:
    silent = table(peak_A=0.0)
    assert not np.any(checked(image_of(silent, DT_S, SETTINGS.lead_s, 10)).command_A)


def test_what_cannot_become_an_image() -> None:
    with pytest.raises(InputError, match="not all zero"):
        image_of(table(), DT_S, SETTINGS.lead_s, 20)
    with pytest.raises(InputError, match="not all zero"):
        image_of(table(), DT_S, SETTINGS.lead_s, 0)
    with pytest.raises(InputError, match="no number"):
        image_of(replace(table(), command_A=np.full((2, 2, 20), np.nan)), DT_S, SETTINGS.lead_s, 10)
    with pytest.raises(InputError, match="no waveforms"):
        image_of(replace(table(), command_A=np.zeros((2, 2, 0))), DT_S, SETTINGS.lead_s, 10)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"magic": 1}, Reason.BAD_FORMAT),
        ({"version": 2}, Reason.BAD_FORMAT),
        ({"flags": 4}, Reason.BAD_FORMAT),
        ({"reserved": 1}, Reason.BAD_FORMAT),
        ({"samples": 61}, Reason.BAD_FORMAT),
        ({"speeds": 0}, Reason.BAD_FORMAT),
        ({"dt_s": 2e-4}, Reason.BAD_TIMING),
        ({"lead_s": 0.0}, Reason.BAD_TIMING),
        ({"dt_s": math.nan}, Reason.BAD_TIMING),
        ({"scale_A": math.inf}, Reason.BAD_VALUE),
        ({"grip_min_N": math.nan}, Reason.BAD_VALUE),
        ({"grip_min_N": -1.0}, Reason.BAD_VALUE),
        ({"tail_samples": 0}, Reason.NO_ZERO_TAIL),
        ({"tail_samples": 12}, Reason.NO_ZERO_TAIL),
        ({"tail_samples": 61}, Reason.NO_ZERO_TAIL),
        ({"scale_A": 1.0}, Reason.OVER_LIMIT),
    ],
)
def test_a_wrong_header_is_refused(values: dict[str, float], reason: Reason) -> None:
    assert refused(changed(IMAGE, **values)) is reason


@pytest.mark.parametrize("cut", [0, 10, IMAGE_HEADER.size, -1])
def test_a_cut_image_is_refused(cut: int) -> None:
    assert refused(IMAGE[:cut]) is Reason.BAD_FORMAT
    assert refused(IMAGE + b"\0") is Reason.BAD_FORMAT


@pytest.mark.parametrize("speeds", [[0.2, 0.2], [0.4, 0.1], [math.nan, 0.1], [0.1, math.inf], [-0.1, 0.2]])
def test_bad_axes_are_refused(speeds: list[float]) -> None:
    assert refused(image_of(replace(table(), speeds_m_s=speeds), DT_S, SETTINGS.lead_s, 10)) is Reason.BAD_AXES
    assert refused(image_of(replace(table(), grips_N=speeds), DT_S, SETTINGS.lead_s, 10)) is Reason.BAD_AXES


@pytest.mark.parametrize("norm", [math.nan, -1.0, math.inf])
def test_bad_norms_are_refused(norm: float) -> None:
    bad = [[norm, 0.0], [0.0, 0.0]]
    assert refused(image_of(replace(table(), transient_A=bad), DT_S, SETTINGS.lead_s, 10)) is Reason.BAD_VALUE
    assert refused(image_of(replace(table(), feedback_A=bad), DT_S, SETTINGS.lead_s, 10)) is Reason.BAD_VALUE


def test_peaks_are_judged_by_the_current_from_rest() -> None:
    """A command of 6 A for one tick is 2.9 A of current, for ten ticks it is 6."""
    decay = math.exp(-AMPLIFIER.rate_rad_s * DT_S)
    for ticks, fits in ((1, True), (2, False), (10, False)):
        command = np.zeros((1, 1, 40))
        command[..., :ticks] = 6.0
        image = image_of(replace(table(1, 1), command_A=command), DT_S, SETTINGS.lead_s, 10)
        assert (6.0 * (1 - decay**ticks) <= 4.0) == fits
        if fits:
            checked(image)
        else:
            assert refused(image) is Reason.OVER_LIMIT
    over = np.zeros((1, 1, 40))
    over[..., 0] = -6.01
    image = image_of(replace(table(1, 1), command_A=over), DT_S, SETTINGS.lead_s, 10)
    assert refused(image) is Reason.OVER_LIMIT
    # Beside a wall, whose feedback is taken away from it, the command alone may be larger.
    checked(image, replace(SETTINGS, wall=WALL))


def test_sizes_beyond_the_device_are_refused_and_named() -> None:
    image = image_of(table(10, 8, 600), DT_S, SETTINGS.lead_s, 10)
    small = Capacity(samples=20_000)
    assert refused(image, capacity=small) is Reason.TOO_LARGE
    words = too_large(image, small)
    assert words is not None
    assert "10 speeds x 8 grips x 600 samples" in words
    assert "a grid of 6 speeds x 5 grips or 250 samples (25 ms, or 4.17 kHz) would fit" in words
    assert 6 * 5 * 600 <= 20_000
    for capacity in (Capacity(speeds=9), Capacity(grips=7), Capacity(waveform_samples=599)):
        assert refused(image, capacity=capacity) is Reason.TOO_LARGE
        assert too_large(image, capacity) is not None
    assert "with more memory" in str(too_large(image, Capacity(samples=70, waveform_samples=1)))
    assert too_large(image, CAPACITY) is None
    assert capacity_bytes(CAPACITY) >= image_bytes(64, 64, 64)


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


@pytest.mark.parametrize("settings", [SETTINGS, FULL, replace(SETTINGS, amplifier=None)])
def test_settings_come_back(settings: Settings) -> None:
    data = configuration_of(settings)
    assert len(data) == CONFIGURATION_BYTES
    assert settings_of(data) == settings


def test_the_librarys_own_settings_come_back(library: Library) -> None:
    settings = Settings.of(library)
    assert settings_of(configuration_of(settings)) == settings


def configuration_with(name: str, value: float) -> bytes:
    place = HEADER.size + 8 * NAMES.index(name)
    return CONFIGURATION[:place] + struct.pack("<d", value) + CONFIGURATION[place + 8 :]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("dt_s", math.nan, Reason.BAD_VALUE),
        ("gain_step", math.inf, Reason.BAD_VALUE),
        ("has_wall", 0.5, Reason.BAD_VALUE),
        ("window_ticks", 20.5, Reason.BAD_VALUE),
        ("window_ticks", 3.0, Reason.BAD_CONFIGURATION),
        ("has_wall", 1.0, Reason.BAD_CONFIGURATION),
        ("has_coil", 1.0, Reason.BAD_CONFIGURATION),
        ("current_limit_A", -1.0, Reason.BAD_CONFIGURATION),
        ("current_limit_A", 5.0, Reason.BAD_CONFIGURATION),  # over_current_A does not follow
        ("decay", 0.1, Reason.BAD_CONFIGURATION),
        ("approach_slope_1", 0.0, Reason.BAD_CONFIGURATION),
        ("guard_rise_K", 1.0, Reason.BAD_CONFIGURATION),
    ],
)
def test_numbers_that_do_not_belong_together_are_refused(name: str, value: float, reason: Reason) -> None:
    with pytest.raises(ConfigurationError) as error:
        settings_of(configuration_with(name, value))
    assert error.value.reason is reason


@pytest.mark.parametrize(("name", "value"), [("dt_s", 5e-324), ("window_ticks", 1e15)])
def test_a_configuration_too_large_for_a_device_is_refused_before_it_is_built(name: str, value: float) -> None:
    with pytest.raises(ConfigurationError):
        accept(configuration_with(name, value), CAPACITY, HARDWARE)


@given(st.integers(0, len(NAMES) - 1), st.floats())
def test_any_number_in_any_place_is_refused_or_harmless(place: int, value: float) -> None:
    try:
        settings = settings_of(configuration_with(NAMES[place], value))
    except ConfigurationError:
        return
    assert settings_of(configuration_of(settings)) == settings


@pytest.mark.parametrize("data", [b"", CONFIGURATION[:-1], CONFIGURATION + b"\0", b"\0" + CONFIGURATION[1:]])
def test_other_formats_are_refused(data: bytes) -> None:
    with pytest.raises(ConfigurationError) as error:
        settings_of(data)
    assert error.value.reason is Reason.BAD_FORMAT


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (replace(SETTINGS, dt_s=2e-4), Reason.BAD_TIMING),
        (replace(SETTINGS, window_ticks=257), Reason.BEYOND_HARDWARE),
        (replace(SETTINGS, current_limit_A=10.5), Reason.BEYOND_HARDWARE),
        (replace(SETTINGS, amplifier=replace(AMPLIFIER, command_limit_A=11.0)), Reason.BEYOND_HARDWARE),
        (replace(SETTINGS, wall=replace(WALL, latency_ticks=32)), Reason.BEYOND_HARDWARE),
        (replace(SETTINGS, encoder_limit_counts=1 << 30), Reason.BEYOND_HARDWARE),
    ],
)
def test_what_the_device_cannot_do_is_refused(settings: Settings, reason: Reason) -> None:
    with pytest.raises(ConfigurationError) as error:
        accept(configuration_of(settings), CAPACITY, HARDWARE)
    assert error.value.reason is reason


def test_currents_are_the_amplifiers(library: Library) -> None:
    configuration = Configuration(Settings.of(library), b"")
    # The library states the current at the instant from which a command acts, this one after that period.
    after = configuration.currents(library.command_A)[..., :-1]
    np.testing.assert_allclose(after, library.current_A[..., 1:], atol=1e-9)
