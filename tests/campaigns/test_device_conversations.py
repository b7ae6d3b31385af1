"""Conversations with the device, recorded: what the compiled core must say and command in every tick.

    python -m pytest -m long -n 0 tests/campaigns/test_device_conversations.py
        --campaign="[--record]"

Without an option the recorded conversations are played to the core; `--record` records them anew, from the core as it
is.

The recordings stand in `tests/controller/firmware/vectors/conversations.npz`, where a test plays them too. They were
taken from a device written in Python, independently of the core; the core agreed with it in every byte and command of
these and of 200 longer conversations. Record anew only where the device is meant to answer differently, and say in
the commit what has changed: the conversations that differ are printed first. It fails if one differs and nothing
is recorded.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Option

from controller.firmware.core_device import DeviceEnd
from controller.host.session_states import SessionState
from controller.protocol import messages as m
from controller.protocol.codes import EVENTS, REASONS, Kind
from controller.protocol.configuration import configuration_of
from controller.protocol.image import image_of
from controller.protocol.wire import Decoder, encode
from tests.benches.compiled import DT_S, SETTINGS, TAIL, cooled, smooth_bank
from tests.benches.probed import ProbedDevice
from tests.benches.rehearsal import Rehearsal
from tests.benches.virtual_link import Trouble
from tests.campaigns.conversations import conversation
from tests.campaigns.harness import long_form
from tests.campaigns.recorded import BOOT, Conversation, Overheard, load, save
from tests.campaigns.unplug_cases import TappingHand
from transopt.plant.coil import CoilModel

VECTORS = Path(__file__).parents[1] / "controller" / "firmware" / "vectors" / "conversations.npz"
RANDOM_TICKS = 2000
# (seed, part of the frames that are damaged, ticks from one look at what the device said to the next); between them
# they meet every state and most reasons to refuse.
RANDOM = (
    *((7, 0.02, 1), (10, 0.02, 1), (12, 0.0, 1), (16, 0.02, 1), (33, 0.0, 40), (52, 0.02, 1), (57, 0.3, 1)),
    *((154, 0.02, 1), (160, 0.02, 1), (237, 0.02, 1)),
)
CONFIGURATION = configuration_of(SETTINGS)
IMAGE = image_of(smooth_bank(), DT_S, SETTINGS.lead_s, TAIL)
LARGE = image_of(smooth_bank(4, 4, 300), DT_S, SETTINGS.lead_s, TAIL)
EXCITED = configuration_of(replace(SETTINGS, host_starts=True))
COIL = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, 100.0)
HOT_C = 94.998  # the first tap is a blend, and what it leaves lets no more of the next than the cool command, scaled
HOT = configuration_of(replace(SETTINGS, coil=replace(COIL, start_winding_C=HOT_C, start_housing_C=HOT_C)))
COOLED = image_of(cooled(smooth_bank(peak_A=3.0)), DT_S, SETTINGS.lead_s, TAIL, cool_bits=8)
ONE_WAVEFORM = image_of(smooth_bank(1, 1), DT_S, SETTINGS.lead_s, TAIL)
BAD_LINE = Trouble(latency_s=2e-3, jitter_s=2e-3, loss=0.1, corruption=0.1, repetition=0.2)
Start = Callable[[int], DeviceEnd]


def vouched(boot: int) -> ProbedDevice:
    """The compiled core, of which nothing is wired wrong because nothing is wired."""
    return ProbedDevice(boot, simulated=True)


class Table(Rehearsal[Overheard]):
    """A host, a line and one device, of which everything is kept that reaches it and comes from it."""

    def __init__(self, start: Start, trouble: Trouble | None = None, seed: int = 0) -> None:
        super().__init__(lambda boot: Overheard(start(BOOT)), DT_S, trouble, seed)
        self.hand = TappingHand()
        self.readings = self.hand.readings

    def step(self) -> None:
        super().step()
        self.hand.command_A = self.output.command_A

    def ready(self, configuration: bytes = CONFIGURATION, image: bytes = IMAGE) -> "Table":
        return super().ready(configuration, image)

    def armed(self, lease_ms: int = 200) -> "Table":
        self.until(lambda: self.session.state is SessionState.READY, 1.0).run(0.02)
        self.session.arm(1.0, lease_ms)
        return self.until(lambda: self.session.state is SessionState.ARMED, 1.0)

    def asked(self) -> "Table":
        """Until all is answered."""
        return self.until(lambda: self.session.idle, 1.0).run(2e-3)


def bad_line(table: Table) -> None:
    """Up, loaded and armed though frames get lost, damaged, doubled and delayed; then disarmed."""
    table.link.set_trouble(BAD_LINE)
    table.ready(image=LARGE).armed(500).run(0.1)
    table.session.disarm()
    table.asked()


def taps(table: Table) -> None:
    """Contacts play while the device is armed, every second tick is told, events are acknowledged."""
    table.ready()
    table.session.set_telemetry(2)
    table.asked().armed()
    table.hand.moving = True
    table.run(0.4)
    table.session.set_gain(0.3)
    table.run(0.15)


def hot_taps(table: Table) -> None:
    """A coil that is close to its limit gets blends with the cool commands; then more of them, and scaled."""
    table.ready(HOT, COOLED)
    table.session.set_telemetry(1)
    table.asked().armed()
    table.hand.moving = True
    table.run(0.5)


def faults(table: Table) -> None:
    """Stopped by the button, by the host, by a dead sensor; no reset before the cause is gone."""
    table.ready().armed()
    hands = table.readings
    table.readings = lambda k: hands(k)._replace(emergency_stop=True)
    table.run(5e-3)
    table.session.reset()
    table.asked()
    table.readings = hands
    table.run(1e-3).session.reset()
    table.asked().armed()
    table.session.emergency_stop(table.now_s)
    table.run(0.1)
    table.session.reset()
    table.asked().armed()
    table.readings = lambda k: hands(k)._replace(current_A=float("nan"), acceleration_m_s2=1e300)
    table.run(5e-3)
    table.readings = hands
    table.session.reset()
    table.asked()


def silent_host(table: Table) -> None:
    """The lease runs out; another process connects, is told what happened, and arms nothing until it is asked to."""
    table.ready().armed(50)
    table.host_alive = False
    table.run(0.2)
    table.restart_host()
    table.connected().run(0.05)
    table.session.configure(CONFIGURATION)
    table.session.upload(IMAGE)
    table.asked().armed(100).run(0.05)


def cut_upload(table: Table) -> None:
    """The cable comes loose in the middle of a library; the next connection goes on from there."""
    table.link.set_trouble(Trouble(latency_s=8e-3))
    table.connected().session.configure(CONFIGURATION)
    table.asked().session.upload(LARGE)
    table.run(0.03).link.unplug()
    table.session.unplugged()
    table.link.plug()
    table.connected().session.configure(CONFIGURATION)
    table.session.upload(LARGE)
    table.until(lambda: table.session.idle, 1.0)


def excitation(table: Table) -> None:
    """What the host starts, with either sign, and what it may not start."""
    table.ready(EXCITED, ONE_WAVEFORM)
    table.session.set_telemetry(1)
    table.asked().armed()
    for negative in (False, True, True):
        table.session.start(negative=negative)
        table.run(4e-3)
    table.run(0.02)


def bring_up(table: Table) -> None:
    """Bring up as the check does: single and paired pulses, evidence, a surface, a trial arm with a gain limit."""
    table.connected().session.configure(CONFIGURATION)
    table.session.upload(IMAGE)
    table.asked().run(0.02).session.pulse(0.05, 50)
    table.asked().run(0.11).session.pulse(-0.1, 200)
    table.asked().run(0.13).session.pulse(0.1, 50, pairs=1)
    table.asked().run(0.3).session.evidence()
    table.asked().session.surface(3.5)
    table.asked().run(0.02).session.arm(0.1, trial=True)
    table.until(lambda: table.session.state is SessionState.ARMED, 1.0).session.set_gain(0.5)
    table.asked().session.disarm()
    table.asked()


def strangers(table: Table) -> None:
    """Another version of the protocol, somebody else's, and frames of no session; then the host."""
    greetings = (m.GREETING.pack(m.MAGIC, m.PROTOCOL + 1), m.GREETING.pack(5, m.PROTOCOL), b"")
    for session, greeting in enumerate(greetings):
        table.link.host_sends(encode(m.HEADER.pack(Kind.HELLO, 0, 1, session) + greeting), table.now_s)
        table.run(2e-3)
    table.link.host_sends(encode(m.Frame(1, 99, m.Telemetry(1, 0)).payload()), table.now_s)
    table.link.host_sends(encode(m.Frame(1, 99, m.EmergencyStop()).payload()), table.now_s)
    table.run(2e-3).connected().session.reset()
    table.asked()


SCENES: tuple[Callable[[Table], None], ...] = (
    bad_line,
    taps,
    hot_taps,
    faults,
    silent_host,
    cut_upload,
    excitation,
    bring_up,
    strangers,
)


def scene(play: Callable[[Table], None], start: Start) -> Conversation:
    """One of `SCENES` with a device as it is after power on."""
    table = Table(start)
    play(table)
    return table.device.conversation(play.__name__)


def random_talk(
    seed: int, damage: float, fetch: int, start: Start = vouched, ticks: int = RANDOM_TICKS
) -> Conversation:
    """A host that says sensible, foolish and damaged things in turn, and a stylus that swings."""
    device = Overheard(start(BOOT))
    for data, readings in conversation(seed, ticks, damage):
        device.receive(data)
        device.step(readings)
        if readings.tick % fetch == 0:
            device.bytes_to_send()
    return device.conversation(f"random {seed}")


def all_conversations(start: Start = vouched) -> list[Conversation]:
    talks = [random_talk(seed, damage, fetch, start) for seed, damage, fetch in RANDOM]
    return [scene(play, start) for play in SCENES] + talks


def said(conversations: list[Conversation]) -> Counter[str]:
    """What devices said, refused and were, how often."""
    counts: Counter[str] = Counter()
    for one in conversations:
        counts.update(state.decode() for state in one.ticks["state"].tolist())
        for payload in Decoder().feed(one.said):
            message = m.read_frame(payload).message
            words = type(message).__name__
            if isinstance(message, m.Refused):
                words += f" {REASONS[message.reason].name.lower()}"
            elif isinstance(message, m.Event):
                words += f" {EVENTS[message.code].name.lower()}"
            counts[words] += 1
    return counts


def main(
    record: Annotated[bool, Option("--record", help="put what the core does in the recordings' place")] = False,
) -> int:
    there = load(VECTORS) if VECTORS.exists() else []
    differences = [words for one in there if (words := one.differs(vouched(BOOT)))]
    recorded = all_conversations() if record else there
    for words in differences:
        print(f"  DIFFERENT {words}"[:1000])
    if record:
        VECTORS.parent.mkdir(exist_ok=True)
        save(VECTORS, recorded)
    print(f"{len(there)} conversations, {sum(one.ticks.size for one in there)} ticks, {len(differences)} differ")
    print(", ".join(f"{name} {count}" for name, count in said(recorded).most_common()))
    return 1 if differences and not record else 0


test_long_form = long_form(main)
