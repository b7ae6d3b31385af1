"""Taps over a line that does not carry a record of every tick.

The device keeps the records of a tap and sends them afterwards. It is armed for one tap at a time, and disarmed while
the records come, so that no tap is played unrecorded. Between two taps it sends a few records, which show the hand
and a drift of the surface.
"""

from collections.abc import Callable

from controller.host.driver import HOLD_STILL, LATE_S, PATIENCE_S, Device, DeviceError, RefusedError
from controller.host.rates import LOOK_S, kept_records, remedy
from controller.protocol.codes import Reason
from controller.protocol.events import Happened, News, Samples, capacity_of
from controller.record.recorder import Recorder
from controller.servo.interface import Notice, State

SPARE = 2.0  # reserve of the line's rate, which also carries events and heartbeats
LISTEN_S = 0.05  # between two looks at whether to end
LOOKED_S = 0.3  # duration of the few records between two taps; a rest that shows a drift takes 0.2 s
OVER = State.FAULT, State.IDLE


def tap_by_tap(
    device: Device,
    recorder: Recorder,
    gain: float,
    share: float,
    duration_s: float | None,
    ended: Callable[[], bool],
    tell: Callable[[str], None],
) -> None:
    """Arm for one tap after the other and receive the records of each, until `ended`, a fault or a lost lease.

    Parameters
    ----------
    device : IDLE and ready to be armed.
    recorder : a listener of the device; where the device has little memory it records less around each contact.
    share : of the records of every tick that the line carries.
    duration_s : time after which no other tap is awaited; None for no limit.
    ended : whether enough was played; called often.
    tell : told what to do and what is awaited.

    Raises
    ------
    DeviceError : the line is too slow even for the records of a tap, or the device does not arm.
    LinkLostError : the link is lost.
    """
    if share * LOOK_S < SPARE * device.hello.dt_s:
        raise DeviceError(f"{device.name}: too slow to tap over it: {remedy(device.hello.dt_s, share)}")
    taps = _SlowTaps(device, recorder, gain, share, tell)
    end_s = float("inf") if duration_s is None else device.now_s() + duration_s
    with device.heard_by(taps.take):
        while taps.one(lambda: ended() or device.now_s() >= end_s):
            continue


class _SlowTaps:
    def __init__(
        self, device: Device, recorder: Recorder, gain: float, share: float, tell: Callable[[str], None]
    ) -> None:
        self._device, self._gain, self._tell, self._dt_s = device, gain, tell, device.hello.dt_s
        self._before, self._after = recorder.fit(kept_records(capacity_of(device.hello)))
        self._takes_s = (self._before + self._after) * self._dt_s / share
        self._contact: int | None = None  # tick of it
        self._finished, self._newest = False, -1
        tell(
            f"this line carries {100 * share:.0f} % of the records: the device keeps each tap and sends it "
            f"afterwards, in some {self._takes_s:.0f} s"
        )

    def take(self, news: News) -> None:
        if isinstance(news, Samples):
            self._newest = news.tick + (len(news.records) - 1) * news.every
        elif isinstance(news, Happened):
            if news.what is Notice.CONTACT and self._contact is None:
                self._contact = news.tick
            self._finished |= news.what is Notice.FINISHED

    def one(self, ended: Callable[[], bool]) -> bool:
        """One tap; whether another one may follow."""
        if not self._arm():
            return False
        self._tell("armed: tap once")
        while self._contact is None and not self._over:
            if ended():
                return False
            self._device.listen(LISTEN_S, until=lambda _: self._contact is not None or self._over)
        if self._contact is not None:
            self._device.listen(self._after * self._dt_s, until=lambda _: self._over)
            self._device.listen(LATE_S, until=lambda _: self._finished or self._over)
        if self._contact is None or self._over:
            self._device.listen(2 * LISTEN_S)  # the event that says why may come after the state
            return False
        self._device.disarm()
        self._tell(f"disarmed while the tap is sent: wait for some {self._takes_s:.0f} s")
        self._device.catch_up(lambda: self._newest, self._contact + self._after)
        self._look()
        return self._device.state is not State.FAULT and not ended()

    @property
    def _over(self) -> bool:
        return self._device.state in OVER

    def _arm(self) -> bool:
        """Arm as soon as the stylus is at rest, records kept from here on; whether no fault came before."""
        end_s, told = self._device.now_s() + PATIENCE_S, False
        while True:
            self._device.set_telemetry(1, self._before)
            self._contact, self._finished, self._newest = None, False, -1
            try:
                self._device.arm(self._gain)
                return True
            except RefusedError as refused:
                if refused.reason is Reason.FAULT_LATCHED:
                    self._device.listen(2 * LISTEN_S)
                    return False
                if refused.reason is not Reason.NOT_AT_REST or self._device.now_s() >= end_s:
                    raise
            if not told:
                self._tell(HOLD_STILL)
            told = True
            self._look()
            if self._device.state is State.FAULT:
                return False

    def _look(self) -> None:
        self._device.set_telemetry(max(round(LOOK_S / self._dt_s), 2))
        self._device.listen(LOOKED_S)
