"""What the compiled device asks of configurations and images, number by number, and where its memory ends."""

import math
import struct
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from controller.protocol import messages as m
from controller.protocol.codes import REASONS, Reason
from controller.protocol.configuration import HEADER, NAMES, configuration_of
from controller.protocol.image import HEADER as IMAGE_HEADER
from controller.protocol.image import IMAGE_FIELDS, image_of, sha256
from controller.protocol.packed import Packed
from controller.protocol.wire import Decoder, encode
from controller.servo.settings import Settings
from tests.benches.compiled import DT_S, TAIL, smooth_bank
from tests.benches.device import Talker
from tests.benches.probed import ProbedDevice
from tests.benches.servo import AMPLIFIER, WALL
from tests.campaigns.conversations import NUMBERS
from transopt.plant.coil import CoilModel

pytestmark = pytest.mark.usefixtures("c_compiler")

SETTINGS = Settings(
    DT_S,
    3e-4,
    4.0,
    AMPLIFIER,
    wall=WALL,
    coil=CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0),
    slew_limit_A_per_s=5e3,
    assumed_grip_N=3.0,
)
CONFIGURATION_REASONS = (
    Reason.BAD_VALUE,
    Reason.BAD_CONFIGURATION,
    Reason.BAD_TIMING,
    Reason.BEYOND_HARDWARE,
)
IMAGE_REASONS = (
    Reason.BAD_FORMAT,
    Reason.TOO_LARGE,
    Reason.BAD_AXES,
    Reason.BAD_VALUE,
    Reason.BAD_TIMING,
    Reason.NO_ZERO_TAIL,
    Reason.OVER_LIMIT,
)
BARE = Settings(DT_S, 3e-4, 4.0)
EXCITED = replace(BARE, host_starts=True)


def reason(answer: Packed) -> Reason | None:
    """Reason of a refusal; None where the message was taken."""
    assert isinstance(answer, m.Done | m.Refused)
    return REASONS[answer.reason] if isinstance(answer, m.Refused) else None


IMAGE = image_of(smooth_bank(samples=40), DT_S, 3e-4, TAIL)


@pytest.mark.parametrize("settings", [SETTINGS, BARE, EXCITED], ids=["all", "bare", "excited"])
def test_every_number_of_a_configuration_is_asked_for(settings: Settings) -> None:
    device, data = Talker(), configuration_of(settings)
    answers = set()
    for place, name in enumerate(NAMES):
        at = HEADER.size + 8 * place
        (value,) = struct.unpack_from("<d", data, at)
        for other in (*NUMBERS, value * 1.001, -value, value + 1.0, 1e9, 1e-3):
            changed = data[:at] + struct.pack("<d", other) + data[at + 8 :]
            answers.add(answer := reason(device.configure(changed)))
            assert math.isfinite(other) or answer is Reason.BAD_VALUE, (name, other)
    assert isinstance(device.configure(data), m.Done)
    assert answers == {None, *CONFIGURATION_REASONS}


def with_number(settings: Settings, name: str, value: float) -> bytes:
    data, at = configuration_of(settings), HEADER.size + 8 * NAMES.index(name)
    return data[:at] + struct.pack("<d", value) + data[at + 8 :]


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("dt_s", math.nan, Reason.BAD_VALUE),
        ("gain_rate_1_s", math.inf, Reason.BAD_VALUE),
        ("encoder_direction", 0.0, Reason.BAD_CONFIGURATION),
        ("monitor_scale", 0.1, Reason.BAD_CONFIGURATION),
        ("amplifier_scale", -5.1, Reason.BAD_CONFIGURATION),
        ("pulse_nodes", 5.0, Reason.BAD_CONFIGURATION),
        ("pulse_nodes", 1.0, Reason.BAD_CONFIGURATION),  # its prediction is zero
        ("over_current", 100.0, Reason.BEYOND_HARDWARE),
        ("has_wall", 0.5, Reason.BAD_VALUE),
        ("host_starts", 0.5, Reason.BAD_VALUE),
        ("window_ticks", 20.5, Reason.BAD_VALUE),
        ("window_ticks", 3.0, Reason.BAD_CONFIGURATION),
        ("has_wall", 1.0, Reason.BAD_CONFIGURATION),
        ("has_coil", 1.0, Reason.BAD_CONFIGURATION),
        ("current_limit_A", -1.0, Reason.BAD_CONFIGURATION),
        ("dt_s", 5e-324, Reason.BAD_TIMING),
        ("window_ticks", 1e15, Reason.BEYOND_HARDWARE),
    ],
)
def test_numbers_that_do_not_belong_together(device: Talker, name: str, value: float, expected: Reason) -> None:
    assert reason(device.configure(with_number(BARE, name, value))) is expected


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (replace(SETTINGS, dt_s=2e-4), Reason.BAD_TIMING),
        (replace(SETTINGS, window_ticks=257), Reason.BEYOND_HARDWARE),
        (replace(SETTINGS, current_limit_A=10.5), Reason.BEYOND_HARDWARE),
        (replace(SETTINGS, amplifier=replace(AMPLIFIER, command_limit=11.0)), Reason.BEYOND_HARDWARE),
        (replace(SETTINGS, amplifier=replace(AMPLIFIER, pole_Hz=1e-3)), Reason.BEYOND_HARDWARE),
        (replace(SETTINGS, amplifier=replace(AMPLIFIER, pole_Hz=21e3)), Reason.BEYOND_HARDWARE),
        (
            replace(SETTINGS, amplifier=replace(AMPLIFIER, pole_Hz=60.0), amplifier_tolerance=0.2),
            Reason.BEYOND_HARDWARE,
        ),
        (replace(SETTINGS, wall=replace(WALL, latency_ticks=32)), Reason.BEYOND_HARDWARE),
        (replace(SETTINGS, encoder_limit_counts=1 << 30), Reason.BEYOND_HARDWARE),
    ],
)
def test_what_the_device_cannot_do(device: Talker, settings: Settings, expected: Reason) -> None:
    assert reason(device.configure(configuration_of(settings))) is expected


@pytest.mark.parametrize(
    ("delay_s", "expected"), [(4e-4, None), (4.01e-4, Reason.BEYOND_HARDWARE), (1e300, Reason.BEYOND_HARDWARE)]
)
def test_how_late_an_amplifier_may_be(device: Talker, delay_s: float, expected: Reason | None) -> None:
    assert reason(device.configure(with_number(SETTINGS, "amplifier_delay_s", delay_s))) is expected


def test_other_formats(device: Talker) -> None:
    data = configuration_of(BARE)
    for at in (0, 4, 6):  # magic, version, count
        assert reason(device.configure(data[:at] + b"\7" + data[at + 1 :])) is Reason.BAD_FORMAT


def odd_images() -> Iterator[bytes]:
    at = 0
    for _, form in IMAGE_FIELDS:
        size = struct.calcsize("<" + form)
        for other in (0, 1, 2, 3, 4, 2 ** (8 * size) - 1) if form != "d" else (*NUMBERS, 1e-4, 3e-4):
            yield IMAGE[:at] + struct.pack("<" + form, other) + IMAGE[at + size :]
        at += size
    tables = range(IMAGE_HEADER.size, IMAGE_HEADER.size + 8 * 12, 8)
    for at in tables:
        for number in NUMBERS:
            yield IMAGE[:at] + struct.pack("<d", number) + IMAGE[at + 8 :]
    for sample in (0, 29, 30, 39, 159):
        at = len(IMAGE) - 320 + 2 * sample
        for count in (-32768, -1, 0, 32767):
            yield IMAGE[:at] + struct.pack("<h", count) + IMAGE[at + 2 :]
    for size in (1, 55, 56, len(IMAGE) - 1):
        yield IMAGE[:size]
    for sizes in ((64, 64, 12), (65, 1, 12), (1, 65, 12), (1, 1, 20_000), (1, 1, 20_001), (14, 1, 19_000)):
        yield image_of(smooth_bank(*sizes), DT_S, 3e-4, TAIL)


@pytest.mark.parametrize("settings", [SETTINGS, BARE], ids=["all", "bare"])
def test_every_number_of_an_image_is_asked_for(settings: Settings) -> None:
    device = Talker()
    assert isinstance(device.configure(configuration_of(settings)), m.Done)
    assert isinstance(device.upload(IMAGE), m.Done)
    assert {reason(device.upload(image)) for image in odd_images()} == {None, *IMAGE_REASONS}
    # What was refused leaves what was there in force.
    again = device.tell(m.UploadBegin(len(IMAGE), sha256(IMAGE)))[-1]
    assert isinstance(again, m.UploadReady)


def imaged(**others: object) -> bytes:
    return image_of(replace(smooth_bank(samples=40), **others), DT_S, 3e-4, TAIL)  # type: ignore[arg-type]


def with_header(**values: float) -> bytes:
    head = dict(zip((name for name, _ in IMAGE_FIELDS), IMAGE_HEADER.unpack_from(IMAGE), strict=True))
    return IMAGE_HEADER.pack(*{**head, **values}.values()) + IMAGE[IMAGE_HEADER.size :]


@pytest.mark.parametrize(
    ("expected", "images"),
    [
        (Reason.BAD_FORMAT, [with_header(**{name: 1}) for name in ("magic", "cool_bits")]),
        (Reason.BAD_FORMAT, [with_header(version=1), with_header(flags=4), with_header(samples=41)]),
        (Reason.BAD_FORMAT, [with_header(speeds=0), IMAGE[:10], IMAGE[: IMAGE_HEADER.size], IMAGE + b"\0"]),
        (Reason.BAD_TIMING, [with_header(dt_s=2e-4), with_header(lead_s=0.0), with_header(dt_s=math.nan)]),
        (Reason.BAD_VALUE, [with_header(scale_A=math.inf), with_header(grip_min_N=math.nan)]),
        (Reason.BAD_VALUE, [with_header(grip_min_N=-1.0)]),
        (Reason.NO_ZERO_TAIL, [with_header(tail_samples=tail) for tail in (0, TAIL + 2, 41)]),
        (Reason.OVER_LIMIT, [with_header(scale_A=1.0)]),
        *(
            (Reason.BAD_AXES, [imaged(speeds_m_s=axis), imaged(grips_N=axis)])
            for axis in ([0.2, 0.2], [0.4, 0.1], [math.nan, 0.1], [0.1, math.inf], [-0.1, 0.2])
        ),
        *(
            (Reason.BAD_VALUE, [imaged(feedback_A=norms)])
            for norms in ([[bad, 0.0], [0.0, 0.0]] for bad in (math.nan, -1.0, math.inf))
        ),
        (None, [IMAGE, imaged(command_A=np.zeros((2, 2, 40)))]),
    ],
)
def test_images_and_why_they_are_refused(device: Talker, expected: Reason | None, images: list[bytes]) -> None:
    device.configure(configuration_of(BARE))
    assert {reason(device.upload(image)) for image in images} == {expected}


def test_peaks_are_those_of_the_current_from_rest(device: Talker) -> None:
    """A command of 6 A for one tick is 2.9 A of current, for ten ticks it is 6."""
    driven = replace(BARE, amplifier=AMPLIFIER)
    device.configure(configuration_of(driven))
    decay = math.exp(-AMPLIFIER.rate_rad_s * DT_S)
    for ticks, peak_A in ((1, 6.0), (2, 6.0), (10, 6.0), (1, -6.01)):
        command = np.zeros((1, 1, 40))
        command[..., :ticks] = peak_A
        image = image_of(replace(smooth_bank(1, 1, samples=40), command_A=command), DT_S, 3e-4, TAIL)
        fits = 6.0 * (1 - decay**ticks) <= 4.0 and abs(peak_A) <= 6.0
        assert reason(device.upload(image)) is (None if fits else Reason.OVER_LIMIT)
    # Beside a wall, whose feedback is taken away from it, the command alone may be larger.
    device.configure(configuration_of(replace(driven, wall=WALL)))
    assert reason(device.upload(image)) is None


def test_where_the_host_starts_there_is_one_waveform(device: Talker) -> None:
    one = smooth_bank(1, 1, samples=40)
    assert isinstance(device.configure(configuration_of(EXCITED)), m.Done)
    others = (smooth_bank(1, 2), smooth_bank(2, 1), replace(one, speeds_m_s=[0.0]), replace(one, grips_N=[0.4]))
    for other in others:
        answer = device.upload(image_of(other, DT_S, 3e-4, TAIL))
        assert isinstance(answer, m.Refused)
        assert REASONS[answer.reason] is Reason.ONE_WAVEFORM
    assert isinstance(device.upload(image_of(one, DT_S, 3e-4, TAIL)), m.Done)
    # In force it stays as long as the configuration takes it, and is started by contacts in the other one.
    assert isinstance(device.configure(configuration_of(BARE)), m.Done)
    assert isinstance(device.upload(IMAGE), m.Done)
    assert isinstance(device.configure(configuration_of(EXCITED)), m.Done)
    assert device.device.look().library_sha256 == m.NO_HASH


@pytest.fixture
def device() -> Talker:
    return Talker()


def test_the_core_outlives_a_host_that_asks_and_never_listens() -> None:
    core, decoder = ProbedDevice(1, simulated=True), Decoder()
    for session in range(1, 1001):
        core.receive(encode(m.Frame(1, session, m.Hello(m.MAGIC, m.PROTOCOL, 0)).payload()))
    assert core.look().lost_frames > 100
    said = decoder.feed(core.bytes_to_send())
    assert decoder.bad_frames == 0
    assert len(said) + core.look().lost_frames == 1000
    core.receive(encode(m.Frame(1, 4711, m.Hello(m.MAGIC, m.PROTOCOL, 0)).payload()))
    assert len(decoder.feed(core.bytes_to_send())) == 1
