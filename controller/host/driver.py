"""A device on a port, with blocking calls: the interface that the command line uses.

    with Device("/dev/ttyACM0") as device:
        device.configure(configuration)
        device.upload(image, progress=bar)
        device.arm(gain=0.1)
        device.listeners.append(print)
        device.listen(60.0)

The caller's thread alone pumps the link. No second thread could keep the lease alive while the program hangs or waits
at a prompt, so a device whose host stops attending to it disarms within the lease. Blocking calls pump; while armed,
no more than a lease may pass between two calls. Leaving the block stops the device: it is disarmed, or, on Ctrl-C or
any other exception, stopped by an emergency stop whose effect is awaited for a moment. Every wait is bounded, at the
latest by the session's own deadlines. Not thread-safe.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from controller.host.connection import CLOCK, Connection, PortError, UnpluggedError
from controller.host.session import Session
from controller.host.session_states import OPEN, SessionState
from controller.protocol.capacity import LEASE_DEFAULT_MS
from controller.protocol.codes import Kind, Reason
from controller.protocol.events import Completed, Connected, Ended, News, Progress, Refused, Witnessed
from controller.protocol.messages import PULSE_SOUND, TRIAL_FINISHED, EvidenceReply, HelloReply
from controller.servo.interface import Fault, State
from transopt.base.errors import InputError

CONNECT_S = 3.0  # a board that restarts when its port is opened takes 2 s
ANSWER_S = 10.0
UPLOAD_S = 60.0
STOP_S = 0.5
LATE_S = 2.0  # longest wait for telemetry in transit
REST_S = 0.2  # longest wait for the device to detect rest: a window of the approach's fit, with a margin
PATIENCE_S = 60.0  # longest wait for a person who holds the stylus to hold it still
HOLD_STILL = "hold the stylus above the surface, still: the device arms at rest"


class DeviceError(InputError):
    """The device cannot do what was requested, or is gone; the message is one line with a remedy."""


class RefusedError(DeviceError):
    """The device has refused a request; `reason` tells why."""

    def __init__(self, message: str, reason: Reason) -> None:
        super().__init__(message)
        self.reason = reason


class LinkLostError(DeviceError):
    """The session has ended: the device is silent, unplugged, of another version, or not one of ours."""


Listener = Callable[[News], None]


def _opened(name: str) -> Connection:
    if CLOCK in name:
        from controller.host.emulated import EmulatedPort  # terminals of a Unix

        return EmulatedPort(name)
    from controller.host.transport import Transport  # pyserial, which a simulated device does without

    return Transport(name)


class Device:
    """A connected device.

    Parameters
    ----------
    port : name of a port to open, or an open connection; both are closed with the device.

    Attributes
    ----------
    session : gives access to clock, counters and state.
    listeners : functions called with each piece of news.
    name, harmless : those of the connection.
    disarmed : whether the device has confirmed the DISARM with which `close` leaves it.

    Raises
    ------
    PortError : the port cannot be opened.
    LinkLostError : no transopt device answers.
    """

    def __init__(
        self, port: str | Connection, *, connect_s: float = CONNECT_S, session: Session | None = None
    ) -> None:
        self.session = Session() if session is None else session
        self.listeners: list[Listener] = []
        self._connection: Connection = _opened(port) if isinstance(port, str) else port
        self.name, self.harmless = self._connection.name, self._connection.harmless
        self.disarmed = False
        try:
            self.connect(connect_s)
        except BaseException:
            self._connection.close()
            raise

    def connect(self, timeout_s: float = CONNECT_S) -> None:
        """Send HELLO on the open port; works again after a lost link, and never arms anything."""
        self.session.connect(self.now_s(), timeout_s)
        self._wait(lambda news: isinstance(news, Connected), timeout_s + 1.0, "connect")

    def now_s(self) -> float:
        """Time of the clock that all waits use."""
        return self._connection.now_s()

    @property
    def hello(self) -> HelloReply:
        """The device's reply to HELLO at the last connect."""
        assert self.session.device is not None
        return self.session.device

    @property
    def state(self) -> State:
        """State that the device reported last."""
        return self.session.device_state

    @property
    def fault(self) -> Fault | None:
        """Fault that the device reported last."""
        return self.session.fault

    def need_no_fault(self) -> None:
        """
        Raises
        ------
        DeviceError : a fault is latched, so that only `reset` is possible.
        """
        if self.state is State.FAULT:
            why = "" if self.fault is None else f": {self.fault.value}"
            raise DeviceError(f"{self.name}: a fault is latched{why} (--reset)")

    # Requests: each returns when the device has done it.

    def configure(self, configuration: bytes, *, anew: bool = False) -> bool:
        """Activate a configuration; return whether it had to be sent. anew : send it even if it is active already."""
        self.need_no_fault()
        self.session.configure(configuration, anew=anew)
        return not self._done(Kind.CONFIGURE_COMMIT).skipped

    def upload(self, image: bytes, progress: Callable[[int, int], None] | None = None) -> bool:
        """Activate a library; return whether it had to be sent. progress : called with bytes sent and in all."""

        def watch(news: News) -> None:
            if progress is not None and isinstance(news, Progress):
                progress(news.done, news.total)

        with self.heard_by(watch):
            self.need_no_fault()
            self.session.upload(image)
            return not self._done(Kind.COMMIT, UPLOAD_S).skipped

    def arm(
        self,
        gain: float,
        lease_ms: int = LEASE_DEFAULT_MS,
        *,
        trial: bool = False,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        """Arm the device. From here on call `listen` or `pump` at least once per lease.

        A device that has just been configured or reset must read its sensors for a while before it can detect rest.

        Parameters
        ----------
        tell : told to hold the stylus still where it moves, which is then waited for; None does not wait.
        """
        self.need_no_fault()
        self._at_rest(lambda: self.session.arm(gain, lease_ms, trial=trial), Kind.ARM, tell)

    def start(self, *, negative: bool = False) -> None:
        """Start an excitation on the armed device; returns when it has begun."""
        self.need_no_fault()
        if self.session.state is not SessionState.ARMED:
            raise DeviceError(f"{self.name}: {Reason.NOT_ARMED.value}")
        self.session.start(negative=negative)
        self._done(Kind.START)

    def disarm(self) -> None:
        self.session.disarm()
        self._done(Kind.DISARM)

    def reset(self) -> None:
        self.session.reset()
        self._done(Kind.RESET)

    def set_gain(self, gain: float) -> None:
        self.session.set_gain(gain)
        self._done(Kind.GAIN)

    def set_telemetry(self, every: int, before: int = 0) -> None:
        """Request one record per `every` ticks, 0 for none; the listeners get them as `Samples`.

        before : if not 0, the device holds records back until a waveform plays, and starts this many before it.
        """
        self.session.set_telemetry(every, before)
        self._done(Kind.TELEMETRY)

    def catch_up(self, newest: Callable[[], int], tick: int) -> None:
        """Wait for telemetry that the device has buffered, as long as records keep coming.

        Parameters
        ----------
        newest : function that gives the tick of the newest record. tick : tick of the last record wanted.
        """
        while (seen := newest()) < tick:
            if not self.listen(LATE_S, until=lambda _: newest() > seen):
                return

    def pulse(self, current_A: float, ticks: int, pairs: int = 0) -> None:
        """Play test pulses; returns when they have begun. pairs : 0 for a single one, else pairs that are judged."""
        self.need_no_fault()
        self._at_rest(lambda: self.session.pulse(current_A, ticks, pairs), Kind.PULSE)

    def evidence(self) -> EvidenceReply:
        """The evidence that the device has gathered since its start under this configuration."""
        self.session.evidence()
        found = self._wait(lambda news: isinstance(news, Witnessed), ANSWER_S, "evidence")
        assert isinstance(found, Witnessed)
        return found.evidence

    def lacks_trial(self) -> bool:
        """Whether the pulses were sound but the active library needs a trial before `arm`."""
        both = PULSE_SOUND | TRIAL_FINISHED
        return not self.hello.simulated and self.evidence().bits & both == PULSE_SOUND

    def surface(self, counts: float) -> None:
        """Set the surface's position, in counts along the encoder's direction."""
        self.need_no_fault()
        self.session.surface(counts)
        self._done(Kind.SURFACE)

    @contextmanager
    def heard_by(self, *listeners: Listener) -> Iterator[None]:
        """Further listeners within the block."""
        self.listeners += listeners
        try:
            yield
        finally:
            for listener in listeners:
                self.listeners.remove(listener)

    # Waiting.

    def _at_rest(self, ask: Callable[[], None], kind: Kind, tell: Callable[[str], None] | None = None) -> None:
        """Make a request that requires rest; repeat it for up to `REST_S` while the device reports that it moves.

        tell : told then to hold still; the request is repeated for up to `PATIENCE_S`.
        """
        begun_s, told = self.now_s(), False
        while True:
            ask()
            try:
                self._done(kind)
                return
            except RefusedError as refused:
                took_s = self.now_s() - begun_s
                if refused.reason is not Reason.NOT_AT_REST or took_s >= (REST_S if tell is None else PATIENCE_S):
                    raise
            if tell is not None and not told and took_s >= REST_S:
                tell(HOLD_STILL)
                told = True
            self.listen(REST_S / 10)

    def listen(self, duration_s: float, until: Callable[[News], bool] = lambda news: False) -> bool:
        """Pump for this duration, or until `until` is true for some news; return whether it was.

        Raises
        ------
        LinkLostError : the link is lost; nothing is armed by itself.
        """
        end_s = self.now_s() + duration_s
        while True:
            if any(until(news) for news in self.pump(end_s)):
                return True
            if self.now_s() >= end_s:
                return False

    def pump(self, until_s: float = 0.0) -> list[News]:
        """Send what is due, wait for bytes until the next deadline or `until_s`, and pass the news to the listeners.

        Raises
        ------
        LinkLostError : the link is lost; the listeners have got all news from before.
        """
        try:
            now_s = self.now_s()
            self._connection.write(self.session.bytes_to_send(now_s))
            wait_s = min(self.session.next_deadline_s(), until_s) - now_s
            data = self._connection.read(max(wait_s, 0.0))
            news = self.session.receive(data, self.now_s())
            self._connection.write(self.session.bytes_to_send(self.now_s()))
        except UnpluggedError as error:
            self.session.unplugged(error.detail)
            news = self.session.receive(b"", self.now_s())
        for one in news:
            for listener in tuple(self.listeners):
                listener(one)
        for one in news:
            if isinstance(one, Ended):
                raise LinkLostError(f"{self.name}: {one}")
        return news

    def _wait(self, met: Callable[[News], bool], timeout_s: float, what: str) -> News:
        end_s = self.now_s() + timeout_s
        while True:
            for news in self.pump(end_s):
                if isinstance(news, Refused):
                    raise RefusedError(f"{self.name}: {news}", news.reason)
                if met(news):
                    return news
            if self.now_s() >= end_s:
                raise DeviceError(f"{self.name}: no answer to {what} within {timeout_s:g} s: reset the device")

    def _done(self, kind: Kind, timeout_s: float = ANSWER_S) -> Completed:
        name = kind.name.lower().replace("_", " ")
        done = self._wait(lambda news: isinstance(news, Completed) and news.request is kind, timeout_s, name)
        assert isinstance(done, Completed)
        return done

    # The end.

    def emergency_stop(self) -> None:
        """Stop at once; wait a moment for the device to report its fault. Never raises if the link is gone."""
        self.session.emergency_stop(self.now_s())
        end_s = self.now_s() + STOP_S
        with suppress(DeviceError, PortError):
            self._connection.write(self.session.bytes_to_send(self.now_s()))
            while self.session.device_state is not State.FAULT and self.now_s() < end_s:
                self.pump(end_s)

    def close(self) -> None:
        """Disarm the device, then close the port; may be called repeatedly.

        A device in IDLE is disarmed too: it may be playing test pulses, which DISARM cuts.
        """
        try:
            if self.session.state in OPEN:
                with suppress(DeviceError):
                    self.session.disarm()
                    self._wait(lambda news: news == Completed(Kind.DISARM), STOP_S, "disarm")
                    self.disarmed = True
        finally:
            self.session.close()
            self._connection.close()

    def __enter__(self) -> "Device":
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        try:
            # An ARM without an answer may still have reached the device.
            armed = self.session.device_state in (State.ARMED, State.PLAYING) or self.session.arming
            if error is not None and armed:
                self.emergency_stop()
        finally:
            self.close()


def arm_at_rest(device: Device, lease_ms: int, within_s: float) -> None:
    """Arm as soon as the hand is at rest.

    Raises
    ------
    DeviceError : the device could not be armed within `within_s`.
    """
    end_s = device.now_s() + within_s
    while True:
        try:
            device.arm(1.0, lease_ms)
            return
        except LinkLostError:
            raise
        except DeviceError:
            if device.now_s() > end_s:
                raise
            device.listen(0.02)
