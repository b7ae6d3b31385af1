"""What the compiled device asks of configurations and images, number by number, and where its memory ends.

The oracle is `configuration.accept` and `image.check`: the same conditions in Python, in the same order.
"""

import struct
from collections.abc import Iterator
from dataclasses import replace

import pytest

from controller.firmware.core_device import CoreDevice
from controller.protocol import messages as m
from controller.protocol.capacity import Capacity, Hardware
from controller.protocol.codes import REASONS, Reason
from controller.protocol.configuration import HEADER, NAMES, ConfigurationError, accept, configuration_of
from controller.protocol.image import HEADER as IMAGE_HEADER
from controller.protocol.image import IMAGE_FIELDS, ImageError, check, image_of, sha256
from controller.protocol.packed import Packed
from controller.protocol.wire import Decoder, encode
from controller.servo.interface import Readings
from controller.servo.settings import Settings
from scripts.campaign.compiled_device import DT_S, TAIL, smooth_bank
from scripts.campaign.conversations import NUMBERS
from tests.benches.device import REST, Talker
from tests.benches.servo import AMPLIFIER, WALL
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


def answered(answer: Packed, why: ConfigurationError | ImageError | None) -> Reason | None:
    """The reason of a refusal, after it has been found to be the oracle's, with its value."""
    if why is None:
        assert isinstance(answer, m.Done)
        return None
    assert isinstance(answer, m.Refused)
    assert REASONS[answer.reason] is why.reason
    assert answer.value == pytest.approx(why.value, rel=1e-12, nan_ok=True)
    return why.reason


def refusal_of_configuration(data: bytes) -> ConfigurationError | None:
    try:
        accept(data, Capacity(), Hardware())
    except ConfigurationError as why:
        return why
    return None


def refusal_of_image(image: bytes, settings: Settings) -> ImageError | None:
    try:
        check(image, accept(configuration_of(settings), Capacity(), Hardware()), Capacity())
    except ImageError as why:
        return why
    return None


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
            answer = device.configure(changed)
            answers.add(answered(answer, refusal_of_configuration(changed)))
            if name.startswith(("guard_", "decay", "prefilter", "approach_")) and abs(other - value) > 1e-6:
                assert isinstance(answer, m.Refused), (name, other)
    assert isinstance(device.configure(data), m.Done)
    assert len(answers) == 5


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
    answers = []
    for image in odd_images():
        answers.append(answered(device.upload(image), refusal_of_image(image, settings)))
    assert set(answers) >= set(IMAGE_REASONS)
    # What was refused leaves what was there in force.
    again = device.tell(m.UploadBegin(len(IMAGE), sha256(IMAGE)))[-1]
    assert isinstance(again, m.UploadReady)


def test_where_the_host_starts_there_is_one_waveform(device: Talker) -> None:
    one = smooth_bank(1, 1)
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


def test_events_that_nobody_acknowledges_are_counted_when_there_is_no_room(device: Talker) -> None:
    """And telemetry goes round in the memory for what goes out, and is dropped where nobody fetches it."""
    device.configure(configuration_of(SETTINGS))
    device.tell(m.Telemetry(1))
    extreme = (1e300, -1e300, 3.4028235e38, 3.5e38, float("nan"))
    for tick in range(6000):
        pressed = tick % 50 == 10
        device.device.step(Readings(tick, 200, extreme[tick % 5], 0.0, extreme[tick % 4], pressed))
        if tick % 50 == 20:
            device.tell(m.Reset())
        if tick % (700 if tick < 3000 else 2600) == 0:
            device.heard()
    for said in device.tell(m.EventAck(64)):
        assert not isinstance(said, m.Event)
    for tick in range(6000, 6500):
        device.device.step(Readings(tick, 200, 3.0, 0.0, 0.0, tick == 6100))
    last = [said for said in device.heard() if isinstance(said, m.Event)][-1]
    assert last.lost > 50


@pytest.fixture
def device() -> Talker:
    return Talker()


def test_the_core_outlives_a_host_that_asks_and_never_listens() -> None:
    core, decoder = CoreDevice(1), Decoder()
    for session in range(1000):
        core.receive(encode(m.Frame(1, session, m.Hello(m.MAGIC, m.PROTOCOL, 0)).payload()))
    assert core.look().lost_frames > 100
    said = decoder.feed(core.bytes_to_send())
    assert decoder.bad_frames == 0
    assert len(said) + core.look().lost_frames == 1000
    core.receive(encode(m.Frame(1, 4711, m.Hello(m.MAGIC, m.PROTOCOL, 0)).payload()))
    assert len(decoder.feed(core.bytes_to_send())) == 1


def test_a_stop_before_any_configuration_is_latched(device: Talker) -> None:
    device.device.step(REST)
    device.tell(m.EmergencyStop(), m.Reset())
    device.device.step(REST)
    assert isinstance(device.configure(configuration_of(BARE)), m.Refused)
    device.device.step(Readings(1, 200, 3.0, 0.0, 0.0, True))
    device.tell(m.Reset())
    device.device.step(REST)
    assert isinstance(device.tell(m.Reset())[-1], m.Done)
    assert isinstance(device.configure(configuration_of(BARE)), m.Done)
