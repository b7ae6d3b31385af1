"""Cool commands, of less heat: what a device asks of them, and that it plays what the Python servo plays."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest

from controller.protocol import messages as m
from controller.protocol.capacity import Capacity
from controller.protocol.codes import REASONS, Reason
from controller.protocol.configuration import configuration_of
from controller.protocol.image import HEADER, IMAGE_FIELDS, bank_of, image_bytes, image_of, image_samples, too_large
from controller.servo.interface import Notice
from controller.servo.settings import Settings
from tests.benches.compiled import DT_S, TAIL, cooled, smooth_bank
from tests.benches.core_replay import Core
from tests.benches.device import Talker, started
from tests.benches.servo import AMPLIFIER
from tests.campaigns.test_device_conversations import Table as Conversation
from tests.campaigns.test_device_conversations import hot_taps, vouched
from transopt.problem.warm_coil import currents

pytestmark = pytest.mark.usefixtures("c_compiler")

SAMPLES = 41
BARE = Settings(DT_S, 3e-4, 4.0, AMPLIFIER)
TABLE = cooled(smooth_bank(samples=SAMPLES, peak_A=3.0))
IMAGES = {bits: image_of(TABLE, DT_S, 3e-4, TAIL, cool_bits=bits, amplifier=AMPLIFIER) for bits in (0, 8, 16)}
SCALES = HEADER.size + 8 * (2 + 2 + 4)  # where the first scale of a cool command stands


def headed(image: bytes, **values: float) -> bytes:
    head = dict(zip((name for name, _ in IMAGE_FIELDS), HEADER.unpack_from(image), strict=True))
    return HEADER.pack(*{**head, **values}.values()) + image[HEADER.size :]


def scaled(image: bytes, node: int, scale_A: float) -> bytes:
    at = SCALES + 8 * node
    return image[:at] + struct.pack("<d", scale_A) + image[at + 8 :]


def counted(image: bytes, bits: int, sample: int, count: int) -> bytes:
    """An image with another count of its last waveform, which is a cool one."""
    at = len(image) + (sample - SAMPLES) * bits // 8
    return image[:at] + struct.pack("<b" if bits == 8 else "<h", count) + image[at + bits // 8 :]


@pytest.fixture(scope="module")
def device() -> Talker:
    talker = Talker()
    assert isinstance(talker.configure(configuration_of(BARE)), m.Done)
    return talker


def reason(device: Talker, image: bytes) -> Reason | None:
    answer = device.upload(image)
    return REASONS[answer.reason] if isinstance(answer, m.Refused) else None


@pytest.mark.parametrize("bits", [0, 8, 16])
def test_sound_ones_are_taken(device: Talker, bits: int) -> None:
    image = IMAGES[bits]
    assert len(image) == image_bytes(2, 2, SAMPLES, bits)
    assert reason(device, image) is None
    found, head = bank_of(image)
    assert head["cool_bits"] == bits
    assert (found.cool_command_A is None) == (bits == 0)


@pytest.mark.parametrize("bits", [8, 16])
def test_forged_ones_are_refused_by_name(device: Talker, bits: int) -> None:
    image = IMAGES[bits]
    for value in (math.nan, -0.1, math.inf):
        assert reason(device, scaled(image, 3, value)) is Reason.BAD_VALUE
    for value in (1.0, 1e300):
        assert reason(device, scaled(image, 2, value)) is Reason.OVER_LIMIT
    full = 127 if bits == 8 else 32767
    assert reason(device, scaled(counted(image, bits, 0, -full), 3, 6.1 / full)) is Reason.OVER_LIMIT
    assert reason(device, counted(image, bits, SAMPLES - 1, 1)) is Reason.NO_ZERO_TAIL
    for other in (1, 7, 9, 24, 2**32 - 1):
        assert reason(device, headed(image, cool_bits=other)) is Reason.BAD_FORMAT
    for damaged in (headed(image, cool_bits=0), headed(image, cool_bits=24 - bits), image[:-1], image + b"\0"):
        assert reason(device, damaged) is Reason.BAD_FORMAT
    for sizes in ({"samples": 2**32 - 1}, {"speeds": 65535, "grips": 65535}, {"samples": 2**31, "speeds": 65535}):
        assert reason(device, headed(image, **sizes)) is Reason.BAD_FORMAT
    # A large count of the first waveforms makes no room for the cool ones.
    silent = replace(TABLE, command_A=np.zeros_like(TABLE.command_A))
    loud = image_of(silent, DT_S, 3e-4, TAIL, cool_bits=bits)
    assert reason(device, headed(scaled(loud, 0, 9.0 / full), scale_A=1e3)) is Reason.OVER_LIMIT


@pytest.mark.parametrize("bits", [8, 16])
def test_a_long_cool_current_is_refused_though_its_command_is_not(device: Talker, bits: int) -> None:
    command = np.zeros_like(TABLE.command_A)
    command[..., :20] = 4.5
    image = image_of(replace(TABLE, cool_command_A=command), DT_S, 3e-4, TAIL, cool_bits=bits)
    assert reason(device, image) is Reason.OVER_LIMIT


@pytest.mark.parametrize("bits", [8, 16])
def test_rounded_ones_ask_for_no_more_command_and_no_more_current(bits: int) -> None:
    random = np.random.default_rng(bits)
    for _ in range(20):
        command = random.uniform(0.5, 6.0) * random.standard_normal((2, 2, SAMPLES))
        command[0, 1] = np.abs(command[0, 1])
        command[1, 1] = 0.0
        command[..., -TAIL:] = 0.0
        table = replace(TABLE, cool_command_A=command)
        stored, _ = bank_of(image_of(table, DT_S, 3e-4, TAIL, cool_bits=bits, amplifier=AMPLIFIER))
        assert stored.cool_command_A is not None
        assert np.all(np.abs(stored.cool_command_A) <= np.abs(command) * (1 + 1e-9) + 1e-12)
        made, meant = (np.abs(currents(c, AMPLIFIER, DT_S)).max(axis=-1) for c in (stored.cool_command_A, command))
        assert np.all(made <= meant * (1 + 1e-12))
        # What is stored is stored again without loss.
        again, _ = bank_of(image_of(stored, DT_S, 3e-4, TAIL, cool_bits=bits, amplifier=AMPLIFIER))
        np.testing.assert_allclose(again.cool_command_A, stored.cool_command_A, rtol=1e-9, atol=1e-12)


def test_room_is_counted_in_samples_of_16_bit() -> None:
    assert [image_samples(1, 1, 41, bits) for bits in (0, 8, 16)] == [41, 62, 82]
    nodes = 4 * SAMPLES
    for bits, taken in ((0, nodes), (8, nodes + nodes // 2), (16, 2 * nodes)):
        assert too_large(IMAGES[bits], Capacity(samples=taken)) is None
        words = too_large(IMAGES[bits], Capacity(samples=taken - 1))
        assert words is not None
        if bits:
            assert f"cool commands of {bits} bit are {taken} samples" in words


@pytest.mark.parametrize(("bits", "samples"), [(8, 240), (16, 180)])
def test_a_device_without_room_refuses(bits: int, samples: int) -> None:
    for more, expected in ((0, None), (1, Reason.TOO_LARGE)):
        talker = Talker(started(7, samples=1440))
        talker.configure(configuration_of(BARE))
        table = cooled(smooth_bank(samples=samples + more, peak_A=3.0))
        image = image_of(table, DT_S, 3e-4, TAIL, cool_bits=bits, amplifier=AMPLIFIER)
        assert reason(talker, image) is expected


def test_the_core_itself_takes_no_other_depth() -> None:
    for image in (headed(IMAGES[8], cool_bits=7), headed(IMAGES[8], cool_bits=16), IMAGES[16][:-1]):
        with pytest.raises(ValueError, match="refuses"):
            Core(BARE, image)


def test_the_host_is_told_what_a_hot_coil_got() -> None:
    table = Conversation(vouched)
    hot_taps(table)
    told = [news for news in table.told if getattr(news, "what", None) is Notice.SCALED_FOR_HEAT]
    blend, rest = told
    assert blend.scale == pytest.approx(1.0)  # type: ignore[union-attr]
    assert 0.0 < blend.cooled < 1.0  # type: ignore[union-attr]
    assert 0.25 <= rest.scale < 1.0  # type: ignore[union-attr]
    assert rest.cooled == pytest.approx(1.0)  # type: ignore[union-attr]
    others = [news for news in table.told if getattr(news, "what", None) is Notice.CONTACT]
    assert all(math.isnan(news.scale) for news in others)  # type: ignore[union-attr]
