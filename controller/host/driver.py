"""A device on a port, with calls that wait: what the command line uses.

    with Device("/dev/ttyACM0") as device:
        device.configure(configuration)
        device.upload(image, progress=bar)
        device.arm(gain=0.1)
        device.listeners.append(print)
        device.listen(60.0)

One thread, the caller's, pumps everything: there is no second one that could keep the lease alive while the program
hangs or waits for a prompt, so a host that stops looking after its device loses it within the lease. Calls that wait
pump; between two calls while armed no more than a lease may pass. Leaving the block, by Ctrl-C or any other exception
too, stops the device: disarmed if all is well, else by an emergency stop, and waits a moment to see it obeyed.
Every wait is bounded, by the session's own deadlines at the latest. Not thread-safe.
"""

from collections.abc import Callable
from contextlib import suppress

from controller.host.connection import CLOCK, Connection, PortError, UnpluggedError
from controller.host.session import Session
from controller.host.session_states import OPEN, SessionState
from controller.protocol.capacity import LEASE_DEFAULT_MS
from controller.protocol.codes import Kind, Reason
from controller.protocol.events import Completed, Connected, Ended, News, Progress, Refused, Witnessed
from controller.protocol.messages import PULSE_SOUND, TRIAL_FINISHED, EvidenceReply, HelloReply
from controller.servo.interface import Fault, State
from transopt.base.errors import InputError

CONNECT_S = 3.0  # a board that starts anew when its port is opened takes two
ANSWER_S = 10.0
UPLOAD_S = 60.0
STOP_S = 0.5
LATE_S = 2.0  # for telemetry that is under way
REST_S = 0.2  # a window of the approach's fit, with some room


class DeviceError(InputError):
    """The device cannot do what was asked, or is gone; one line with what to do."""


class RefusedError(DeviceError):
    """The device has refused; `reason` says why."""

    def __init__(self, message: str, reason: Reason) -> None:
        super().__init__(message)
        self.reason = reason


class LinkLostError(DeviceError):
    """The session is over: silent, unplugged, another version, not our device."""


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
    port : a name, opened here as a serial port, or a connection that is already open; closed with the device either
        way.

    Attributes
    ----------
    session : for everything beside the calls here: clock, counters, state.
    listeners : called with all news.
    name, harmless : of the connection.

    Raises
    ------
    PortError : the port cannot be opened.
    LinkLostError : no device of ours answers.
    """

    def __init__(
        self, port: str | Connection, *, connect_s: float = CONNECT_S, session: Session | None = None
    ) -> None:
        self.session = Session() if session is None else session
        self.listeners: list[Listener] = []
        self._connection: Connection = _opened(port) if isinstance(port, str) else port
        self.name, self.harmless = self._connection.name, self._connection.harmless
        try:
            self.connect(connect_s)
        except BaseException:
            self._connection.close()
            raise

    def connect(self, timeout_s: float = CONNECT_S) -> None:
        """Say HELLO on the open port; also after the link was lost, which arms nothing."""
        self.session.connect(self.now_s(), timeout_s)
        self._wait(lambda news: isinstance(news, Connected), timeout_s + 1.0, "connect")

    def now_s(self) -> float:
        """Time by the clock that all waits here are measured with."""
        return self._connection.now_s()

    @property
    def hello(self) -> HelloReply:
        """What the device said of itself at the last connect."""
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
        DeviceError : a fault is latched, so that nothing but `reset` makes sense.
        """
        if self.state is State.FAULT:
            why = "" if self.fault is None else f": {self.fault.value}"
            raise DeviceError(f"{self.name}: a fault is latched{why} (--reset)")

    # Requests: each returns when the device has done it.

    def configure(self, configuration: bytes, *, anew: bool = False) -> bool:
        """Put a configuration in force; whether anything had to be sent. anew : even if it is there already."""
        self.need_no_fault()
        self.session.configure(configuration, anew=anew)
        return not self._done(Kind.CONFIGURE_COMMIT).skipped

    def upload(self, image: bytes, progress: Callable[[int, int], None] | None = None) -> bool:
        """Put a library in force; whether it had to be sent. progress : called with bytes done and in all."""

        def watch(news: News) -> None:
            if progress is not None and isinstance(news, Progress):
                progress(news.done, news.total)

        self.listeners.append(watch)
        try:
            self.need_no_fault()
            self.session.upload(image)
            return not self._done(Kind.COMMIT, UPLOAD_S).skipped
        finally:
            self.listeners.remove(watch)

    def arm(self, gain: float, lease_ms: int = LEASE_DEFAULT_MS, *, trial: bool = False) -> None:
        """From here on `listen` or `pump` at least once per lease.

        A device that has just been configured or reset knows of no rest before it has read for a while.
        """
        self.need_no_fault()
        self._at_rest(lambda: self.session.arm(gain, lease_ms, trial=trial), Kind.ARM)

    def start(self, *, negative: bool = False) -> None:
        """An excitation, if the device is still armed; returns when it has begun."""
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
        """One record every so many ticks, 0 for none; they come as `Samples` to the listeners.

        before : not 0 keeps them back until a waveform plays; they then begin with so many from before it.
        """
        self.session.set_telemetry(every, before)
        self._done(Kind.TELEMETRY)

    def catch_up(self, newest: Callable[[], int], tick: int) -> None:
        """Wait for telemetry that the device has kept, for as long as any of it comes.

        Parameters
        ----------
        newest : tick of the last record that came. tick : of the last that is wanted.
        """
        while (seen := newest()) < tick:
            if not self.listen(LATE_S, until=lambda _: newest() > seen):
                return

    def pulse(self, current_A: float, ticks: int, pairs: int = 0) -> None:
        """Test pulses; returns when they have begun. pairs : 0 for a single one, else the configuration's, judged."""
        self.need_no_fault()
        self._at_rest(lambda: self.session.pulse(current_A, ticks, pairs), Kind.PULSE)

    def evidence(self) -> EvidenceReply:
        """What the device has seen of itself, for this start and this configuration."""
        self.session.evidence()
        found = self._wait(lambda news: isinstance(news, Witnessed), ANSWER_S, "evidence")
        assert isinstance(found, Witnessed)
        return found.evidence

    def lacks_trial(self) -> bool:
        """Whether its pulses were sound but the library in force is new to it: `arm` needs a trial of it first."""
        both = PULSE_SOUND | TRIAL_FINISHED
        return not self.hello.simulated and self.evidence().bits & both == PULSE_SOUND

    def surface(self, counts: float) -> None:
        """Tell the device where the surface is, in counts after the encoder's direction."""
        self.need_no_fault()
        self.session.surface(counts)
        self._done(Kind.SURFACE)

    # Waiting.

    def _at_rest(self, ask: Callable[[], None], kind: Kind) -> None:
        """Ask for what a device does at rest alone, again while it says that the stylus moves, `REST_S` at most."""
        end_s = self.now_s() + REST_S
        while True:
            ask()
            try:
                self._done(kind)
                return
            except RefusedError as refused:
                if refused.reason is not Reason.NOT_AT_REST or self.now_s() >= end_s:
                    raise
            self.listen(REST_S / 10)

    def listen(self, duration_s: float, until: Callable[[News], bool] = lambda news: False) -> bool:
        """Pump for so long, or until some news; whether that came.

        Raises
        ------
        LinkLostError : the link is gone; nothing will be armed by itself.
        """
        end_s = self.now_s() + duration_s
        while True:
            if any(until(news) for news in self.pump(end_s)):
                return True
            if self.now_s() >= end_s:
                return False

    def pump(self, until_s: float = 0.0) -> list[News]:
        """Send what is due, wait for bytes till the next deadline or `until_s` at the latest, and tell the news.

        Raises
        ------
        LinkLostError : the link is gone; what came before it has gone to the listeners.
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
        """At once; waits a moment for the device to report its fault. Never raises for a link that is gone."""
        self.session.emergency_stop(self.now_s())
        end_s = self.now_s() + STOP_S
        with suppress(DeviceError, PortError):
            self._connection.write(self.session.bytes_to_send(self.now_s()))
            while self.session.device_state is not State.FAULT and self.now_s() < end_s:
                self.pump(end_s)

    def close(self) -> None:
        """Disarm if there is somebody to disarm, then let go of the port; any number of times."""
        try:
            if self.session.state in OPEN and (self.session.device_state is not State.IDLE or self.session.arming):
                with suppress(DeviceError):
                    self.session.disarm()
                    self._wait(lambda news: news == Completed(Kind.DISARM), STOP_S, "disarm")
        finally:
            self.session.close()
            self._connection.close()

    def __enter__(self) -> "Device":
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        try:
            # An ARM that was not answered may have been heard.
            armed = self.session.device_state in (State.ARMED, State.PLAYING) or self.session.arming
            if error is not None and armed:
                self.emergency_stop()
        finally:
            self.close()


def arm_at_rest(device: Device, lease_ms: int, within_s: float) -> None:
    """Arm as soon as the hand is at rest.

    Raises
    ------
    DeviceError : it was not within this time.
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
