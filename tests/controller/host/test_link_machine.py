"""Anything may happen to host, link and device at any instant: a state machine in virtual time.

What must hold: without bytes from the host the device is at rest within the lease; nothing arms but an ARM that the
user asked for; no event is told twice, nor lost where the link recovers; a library is in force whole or not at all; a
dead link is reported within a second.
"""

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from controller.host.session_states import OPEN, OVER, SessionState
from controller.protocol.events import Happened
from controller.protocol.image import sha256
from controller.protocol.messages import NO_HASH
from controller.servo.interface import Readings, State
from tests.benches.device import CONFIGURATION, DT_S, EXCITED, IMAGE, ONE_WAVEFORM, World, image
from tests.benches.servo import COUNT_M
from tests.benches.virtual_link import Trouble

ACTIVE = (State.ARMED, State.PLAYING)
LEASE_MS = 100
LIBRARIES = (IMAGE, image(speeds=3, samples=100), image(speeds=8, grips=8, samples=200))
IMAGES = {sha256(data): data for data in (*LIBRARIES, ONE_WAVEFORM)}
CALM = Trouble()
TROUBLES = (
    CALM,
    Trouble(latency_s=0.016),
    Trouble(latency_s=0.002, jitter_s=0.01, repetition=0.2),
    Trouble(latency_s=0.001, loss=0.1, corruption=0.1),
    Trouble(loss=0.4, corruption=0.2, repetition=0.3),
)


def tapping(k: int, stop: bool) -> Readings:
    """A tap every 0.3 s: 10 mm up, in at 0.2 m/s, 2 mm deep, out again."""
    j = k % 3000
    z = 0.01 if j < 800 else 0.01 - 0.2 * (j - 800) * DT_S if j < 1400 else -2e-3 + 5e-5 * (j % 7)
    z = z if j < 2200 else min(-2e-3 + 0.2 * (j - 2200) * DT_S, 0.01)
    return Readings(k, round(z / COUNT_M), 3.0, 0.0, 0.0, emergency_stop=stop)


class Trials(RuleBasedStateMachine):
    """One world; each rule is one thing that may happen."""

    @initialize(trouble=st.sampled_from(TROUBLES), seed=st.integers(0, 1000))
    def begin(self, trouble: Trouble, seed: int) -> None:
        self.world = World(seed=seed)
        self.stop = False
        self.world.readings = lambda k: tapping(k, self.stop)
        self.arms_allowed = 0
        self.cut_since_s: float | None = None
        self.numbers: dict[int, set[int]] = {}  # by boot: told by any process so far
        self.told = 0
        self.world.armed(LEASE_MS)
        self.was_active = True
        self.world.link.set_trouble(trouble)

    def run_for(self, duration_s: float) -> None:
        world = self.world
        for _ in range(round(duration_s / DT_S)):
            world.step()
            self.after_each_tick()

    def after_each_tick(self) -> None:
        world = self.world
        active = world.device.state in ACTIVE
        if not active:
            assert world.output.command_A == 0.0
        elif not self.was_active:
            assert self.arms_allowed > 0
            self.arms_allowed -= 1
        if world.now_s - world.last_arrival_s > LEASE_MS * 1e-3 + 3 * DT_S:
            assert not active
        if world.device.state is State.FAULT:
            self.arms_allowed = 0
        self.was_active = active
        dead = not world.link.connected and world.host_alive
        self.cut_since_s = (self.cut_since_s or world.now_s) if dead else None
        if self.cut_since_s is not None and world.now_s - self.cut_since_s > 1.0:
            assert world.session.state not in OPEN
        if len(world.told) > self.told:
            self.read_news()

    def read_news(self) -> None:
        world = self.world
        for news in world.told[self.told :]:
            if isinstance(news, Happened):
                told = self.numbers.setdefault(world.session.device.boot, set())
                if news.number in told:
                    # Only by another process, before this one.
                    assert news.number not in self.numbers_here
                self.numbers_here.add(news.number)
                told.add(news.number)
        self.told = len(world.told)

    def __init__(self) -> None:
        super().__init__()
        self.numbers_here = set()

    @rule(duration_s=st.sampled_from([0.0003, 0.004, 0.03, 0.15, 0.4]))
    def time_passes(self, duration_s: float) -> None:
        self.run_for(duration_s)

    @rule(trouble=st.sampled_from(TROUBLES))
    def link_changes(self, trouble: Trouble) -> None:
        self.world.link.set_trouble(trouble)

    @rule()
    def unplugged(self) -> None:
        self.world.link.unplug()

    @rule()
    def plugged(self) -> None:
        self.world.link.plug()

    @rule()
    def device_resets(self) -> None:
        self.world.reset_device()
        self.arms_allowed, self.was_active = 0, False
        self.numbers_here = set()
        self.run_for(0.001)

    @rule()
    def host_is_killed(self) -> None:
        self.world.host_alive = False

    @rule()
    def host_stalls_and_goes_on(self) -> None:
        self.world.host_alive = False
        self.run_for(0.3)
        self.world.host_alive = True

    @precondition(lambda self: not self.world.host_alive)
    @rule()
    def host_starts_anew(self) -> None:
        self.world.restart_host()
        self.told, self.numbers_here = 0, set()

    @rule(pressed=st.booleans())
    def stop_button(self, pressed: bool) -> None:
        self.stop = pressed

    @precondition(lambda self: self.world.host_alive and self.world.session.state in OVER)
    @rule()
    def user_connects(self) -> None:
        self.world.session.connect(self.world.now_s)
        self.run_for(0.15)

    @precondition(lambda self: self.world.host_alive)
    @rule(data=st.sampled_from(LIBRARIES), duration_s=st.sampled_from([0.0, 0.1, 0.5]))
    def user_sets_out_to_tap(self, data: bytes, duration_s: float) -> None:
        self.set_out(CONFIGURATION, data)
        self.run_for(duration_s)

    @precondition(lambda self: self.world.host_alive)
    @rule(negative=st.booleans(), duration_s=st.sampled_from([0.0, 0.01, 0.1]))
    def user_sets_out_to_sweep(self, negative: bool, duration_s: float) -> None:
        if self.world.session.state is SessionState.ARMED:
            self.world.session.disarm()
            self.run_for(0.05)
        self.set_out(EXCITED, ONE_WAVEFORM)
        if self.world.session.state is SessionState.ARMED:
            self.world.session.start(negative=negative)
        self.run_for(duration_s)

    def set_out(self, configuration: bytes, data: bytes) -> None:
        """From wherever things stand to ARMED, as far as they go."""
        session = self.world.session
        if session.state in OVER:
            session.connect(self.world.now_s)
            self.run_for(0.1)
        if session.state is SessionState.FAULTED:
            session.reset()
            self.run_for(0.05)
        if session.state is SessionState.READY and session.idle:
            session.configure(configuration)
            session.upload(data)
            # The stylus may be moving just now: a user would try again.
            for _ in range(4):
                self.run_for(0.05)
                if session.idle and session.state is SessionState.READY:
                    session.arm(1.0, LEASE_MS)
                    self.arms_allowed = 1

    @precondition(lambda self: self.world.host_alive and self.world.session.state in OPEN)
    @rule(what=st.sampled_from(["disarm", "reset", "telemetry", "stop", "close"]))
    def user_asks(self, what: str) -> None:
        session = self.world.session
        if what == "disarm":
            session.disarm()
        elif what == "reset":
            session.reset()
        elif what == "telemetry":
            session.set_telemetry(5)
        elif what == "stop":
            session.emergency_stop(self.world.now_s)
        else:
            session.close()

    @invariant()
    def a_library_is_whole_or_not_in_force(self) -> None:
        if not hasattr(self, "world"):
            return
        in_force = self.world.device.look().library_sha256
        assert in_force == NO_HASH or self.world.device.image() == IMAGES[in_force]

    def teardown(self) -> None:
        """The link recovers: everything that happened since the device's start is told."""
        if not hasattr(self, "world"):
            return
        world = self.world
        world.link.set_trouble(CALM)
        world.link.plug()
        world.host_alive, self.stop = True, False
        self.run_for(0.8)
        active = world.device.state in ACTIVE
        if world.session.state in OVER:
            # Whatever ended the session, the device is at rest and stays so.
            assert not active
            world.session.connect(world.now_s)
        self.run_for(0.5)
        assert world.session.state in OPEN
        device = world.device.look()
        told = self.numbers.get(device.boot, set())
        assert told == set(range(device.events))
        assert device.oldest_event == device.events


Trials.TestCase.settings = settings(
    max_examples=15,
    stateful_step_count=15,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
TestTrials = Trials.TestCase
