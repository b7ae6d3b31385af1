"""A host session, a link and the compiled device on one virtual clock; and a host that speaks frame by frame."""

import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from operator import attrgetter
from pathlib import Path

import pytest

from controller.firmware.build import NoCompilerError, build, compiler
from controller.protocol import messages as m
from controller.protocol.capacity import Hardware
from controller.protocol.codes import REASONS, Reason
from controller.protocol.configuration import configuration_of
from controller.protocol.events import News
from controller.protocol.image import image_of, sha256
from controller.protocol.packed import Packed
from controller.protocol.wire import DELIMITER, Decoder, decode, encode
from controller.servo.interface import Output, Readings, State
from controller.servo.settings import Settings
from tests.benches.compiled import smooth_bank
from tests.benches.probed import ProbedDevice
from tests.benches.rehearsal import Rehearsal
from tests.benches.servo import AMPLIFIER, DT_S
from tests.benches.virtual_link import Trouble

SETTINGS = Settings(DT_S, 3 * DT_S, 4.0, AMPLIFIER, window_ticks=20)
CONFIGURATION = configuration_of(SETTINGS)
# Without optimisation they compile in half the time, and nothing undefined is optimised away before they see it.
SANITIZERS = ("-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer")


def image(**sizes: int) -> bytes:
    return image_of(smooth_bank(**sizes), DT_S, SETTINGS.lead_s, 10)


IMAGE = image()
EXCITED = configuration_of(replace(SETTINGS, host_starts=True))
ONE_WAVEFORM = image(speeds=1, grips=1, samples=300)


def tokens() -> Callable[[], int]:
    counter: Iterator[int] = count(1)
    return lambda: next(counter)


def need_compiler() -> None:
    """Skip the test on a machine that cannot compile the device."""
    try:
        compiler()
    except NoCompilerError as missing:
        pytest.skip(str(missing))


def need_clean(name: str, files: list[Path], argument: Path, flags: tuple[str, ...] = ()) -> None:
    """The sanitizers have nothing to say of a program of the core; what it answers is compared without them."""
    command = [str(checked(name, files, flags)), str(argument)]
    said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=100)
    assert said.stdout
    assert said.stderr == ""


def checked(name: str, files: list[Path], flags: tuple[str, ...] = ()) -> Path:
    """Built under the sanitizers, where the compiler has them."""
    try:
        return build(f"{name}-checked", files, flags=(*flags, *SANITIZERS))
    except NoCompilerError as refused:
        pytest.skip(f"no sanitizers here: {refused}")


def started(
    boot: int, hardware: Hardware | None = None, samples: int | None = None, *, simulated: bool = True
) -> ProbedDevice:
    """The device as it is after power on.

    Parameters
    ----------
    samples : int16 samples that its libraries may have. simulated : it vouches that nothing is wired wrong.
    """
    need_compiler()
    flags = () if samples is None else (f"-DTD_MAX_LIBRARY_SAMPLES={samples}",)
    return ProbedDevice(boot, hardware, flags, simulated=simulated)


def reframed(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """Whole frames with other payloads; what is empty afterwards is left out."""
    payloads = [decode(piece) for piece in data.split(DELIMITER)[:-1]]
    changed = [change(payload) for payload in payloads if payload]
    return b"".join(encode(payload) for payload in changed if payload)


class World(Rehearsal[ProbedDevice]):
    """The compiled device rehearses, its stylus in a hand 5 mm above the surface unless `readings` say otherwise."""

    def __init__(
        self,
        trouble: Trouble | None = None,
        seed: int = 0,
        samples: int | None = None,
        *,
        simulated: bool = True,
    ) -> None:
        super().__init__(lambda boot: started(boot, samples=samples, simulated=simulated), DT_S, trouble, seed)

    def of(self, kind: type[News]) -> list[News]:
        return [news for news in self.told if isinstance(news, kind)]

    def ready(self, configuration: bytes = CONFIGURATION, image: bytes = IMAGE) -> "World":
        return super().ready(configuration, image)

    def armed(self, lease_ms: int = 200, gain: float = 1.0) -> "World":
        self.ready()
        self.session.arm(gain, lease_ms)
        return self.until(lambda: self.session.device_state is State.ARMED, 1.0)


REST_TICKS = 100  # after so many readings a device knows that the stylus rests
REST = Readings(0, 200, 3.0, 0.0, 0.0)
SENSED = attrgetter(*Readings._fields[1:])  # all but the tick
HASHES = sha256(CONFIGURATION), sha256(IMAGE)
ARM = m.Arm(0, 200, 1.0, *HASHES)


class Talker:
    """A device and whoever speaks to it, frame by frame."""

    def __init__(self, device: ProbedDevice | None = None) -> None:
        self.device = started(7) if device is None else device
        self.decoder, self.sequence, self.tick, self.host_us, self.session = Decoder(), 1, 0, 0, 9
        self.put(m.Hello(m.MAGIC, m.PROTOCOL, 5))

    def put(self, message: Packed, *, sequence: int | None = None, session: int | None = None) -> list[Packed]:
        """What it answers."""
        number = self.sequence if sequence is None else sequence
        of = self.session if session is None else session
        self.device.receive(encode(m.Frame(number, of, message).payload()))
        return self.heard()

    def lease(self) -> m.Lease:
        """The next heartbeat of a host whose clock goes on."""
        self.host_us += 1
        return m.Lease(self.host_us)

    def heard(self) -> list[Packed]:
        return [m.read_frame(payload).message for payload in self.decoder.feed(self.device.bytes_to_send())]

    def tell(self, *messages: Packed) -> list[Packed]:
        """All that it says while these come."""
        said = []
        for message in messages:
            self.sequence += 1
            said += self.put(message)
        return said

    def ask(self, message: Packed) -> Packed:
        (answer,) = (x for x in self.tell(message) if not isinstance(x, m.Event))
        return answer

    def configure(self, configuration: bytes) -> Packed:
        return self.tell(m.Configure(0, configuration), m.ConfigureCommit(sha256(configuration)))[-1]

    def upload(self, image: bytes) -> Packed:
        chunks = [m.Data(j, image[j : j + m.DATA_LIMIT]) for j in range(0, len(image), m.DATA_LIMIT)]
        return self.tell(m.UploadBegin(len(image), sha256(image)), *chunks, m.Commit())[-1]

    def refused(self, message: Packed) -> Reason:
        answer = self.ask(message)
        assert isinstance(answer, m.Refused)
        assert answer.request == m.KINDS[type(message)]
        return REASONS[answer.reason]

    def done(self, *messages: Packed) -> None:
        for message in messages:
            assert isinstance(self.ask(message), m.Done), message

    def configured(self, configuration: bytes = CONFIGURATION) -> "Talker":
        assert isinstance(self.configure(configuration), m.Done)
        # A device knows of a rest only after it has read for a while; ticks are counted from then on.
        self.step(REST_TICKS)
        self.heard()
        self.tick = 0
        return self

    def loaded(self, image: bytes = IMAGE) -> "Talker":
        assert isinstance(self.upload(image), m.Done)
        return self

    def ready(self) -> "Talker":
        return self.configured().loaded()

    def step(self, ticks: int = 1, reading: Readings = REST) -> Output:
        sensed = SENSED(reading)
        for _ in range(ticks):
            output = self.device.step(Readings(self.tick, *sensed))  # `replace` takes longer than all the rest
            self.tick += 1
        return output
