"""Trials of an excitation on a device: start them, record them, and keep them only if complete.

A trial holds every tick of the excitation, with a rest before it and the ringing after it. A trial with lost
telemetry or a wrong grip is repeated, not written.

Records of every tick are requested only during a trial. So the device's telemetry buffer is empty when a trial
begins, and what a slow line does not carry during the trial is sent after it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from controller.host.driver import LATE_S, Device, DeviceError, LinkLostError
from controller.host.rates import LOOK_S, remedy
from controller.protocol.capacity import TRIAL_GAIN
from controller.protocol.codes import LinkNotice
from controller.protocol.events import Happened, News, Samples, column
from controller.protocol.messages import Record
from controller.record.trial_file import write_measurement
from controller.servo.interface import Fault, Notice, State
from transopt.base.signals import FloatArray
from transopt.base.terminal import make_folder

BEFORE_S, AFTER_S = 0.05, 0.1  # recorded rest before, and ringing after the excitation
WINDOW_S = 0.3  # window in which grip and rest are judged
STILL_M = 5e-4  # motion within the window that counts as rest; a hand's tremor is +-0.1 mm
FREE_N = 0.2  # largest reading of a grip sensor that nobody touches
GRIP_N, GRIP_PART = 0.3, 0.1  # allowed error of the grip, absolute and relative; the larger one applies
ATTEMPTS = 3  # at each trial
PATIENCE_S = 60.0  # longest wait for a person to do what is asked
WAITED_S = 2e-3  # margin of waiting times for the difference of the two clocks
KEPT_PART = 0.9  # share of the buffered length that a shorter sweep is advised to use


class AbortedError(Exception):
    """No further trial is possible; the text tells why."""


class _AgainError(Exception):
    """This trial is not complete; the text tells why."""


@dataclass(frozen=True)
class Trial:
    """The measurements of one trial, tick by tick.

    Attributes
    ----------
    time_s : (n,) 0 at the first sample of the excitation. The command of a row follows its readings and is held until
        the next row, so the current of row k depends on commands before k only.
    command_A, current_A, acceleration_m_s2, position_m : (n,); the command as issued, after all limits.
    grip_N : mean during the excitation; 0 for the free device.
    negative : whether it was played with opposite sign. cut_ticks : number of ticks in which a limit cut the command.
    """

    time_s: FloatArray
    command_A: FloatArray
    current_A: FloatArray
    acceleration_m_s2: FloatArray
    position_m: FloatArray
    grip_N: float
    negative: bool
    cut_ticks: int

    def write(
        self, path: Path, accelerometer_Hz: float, *, held_out: bool = False, period_s: float | None = None
    ) -> None:
        """Write the trial to a file. held_out : for validation only. period_s : period of a repeated excitation.

        Raises
        ------
        InputError : the file cannot be written.
        """
        columns = {
            "time_s": self.time_s,
            "command_A": self.command_A,
            "current_A": self.current_A,
            "acceleration_m_s2": self.acceleration_m_s2,
            "position_m": self.position_m,
        }
        scalars = {"grip_N": self.grip_N, "accelerometer_Hz": accelerometer_Hz}
        if held_out:
            scalars["held_out"] = 1.0
        if period_s is not None:
            scalars["period_s"] = period_s
        write_measurement(path, columns, scalars)


@dataclass
class _Ears:
    """Records and events since the last `forget`."""

    records: list[tuple[int, Record]] = field(default_factory=list)
    happened: list[Happened] = field(default_factory=list)

    def take(self, news: News) -> None:
        if isinstance(news, Samples):
            self.records.extend((news.tick + j * news.every, record) for j, record in enumerate(news.records))
        elif isinstance(news, Happened):
            self.happened.append(news)

    def forget(self) -> None:
        self.records, self.happened = [], []

    def at(self, what: Notice) -> int | None:
        """The tick of the last event of this kind; None if there is none."""
        return next((event.tick for event in reversed(self.happened) if event.what is what), None)


class Sweeps:
    """Trials on one device, armed only during each trial; a context manager that listens to the device.

    Parameters
    ----------
    device : IDLE, with the excitation loaded. samples : length of the excitation. gain : its gain.
    hold : function that asks the person for a grip. grip_N : requested grip; 0 to let go, None for any.
    assumed_grip_N : grip of a device without a grip sensor, used in place of readings; None with a sensor.
    """

    def __init__(
        self,
        device: Device,
        hold: Callable[[float | None], None],
        samples: int,
        *,
        gain: float,
        grip_N: float | None,
        count_m: float,
        assumed_grip_N: float | None = None,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._device, self._hold, self._samples, self._gain = device, hold, samples, gain
        self._grip_N, self._count_m, self._patience_s = grip_N, count_m, patience_s
        self._assumed_grip_N = assumed_grip_N
        self._dt_s = device.hello.dt_s
        self._ears = _Ears()
        self._looked = 0  # tick at which the hand was last judged

    def __enter__(self) -> "Sweeps":
        self._device.listeners.append(self._ears.take)
        return self

    def __exit__(self, *_: object) -> None:
        self._device.listeners.remove(self._ears.take)

    def trial(self, *, negative: bool, tell: Callable[[str], None]) -> Trial:
        """Record one complete trial; `tell` is called with the reason whenever one is incomplete.

        Raises
        ------
        AbortedError : a fault, a lost lease, the requested grip did not come, the device does not start, or no
            attempt was complete.
        DeviceError : the device does not arm. LinkLostError : the link is lost.
        """
        why = ""
        for _ in range(ATTEMPTS):
            self._wait_for_hand()
            try:
                return self._one(negative)
            except _AgainError as again:
                why = str(again)
                tell(f"not whole, once more: {why}")
        raise AbortedError(f"{ATTEMPTS} attempts at a trial, none whole: {why}")

    def try_out(self, tell: Callable[[str], None]) -> None:
        """Play the excitation once at a gain of 0.1, which a device requires for each new excitation.

        Raises
        ------
        AbortedError : a fault, a lost lease, the device does not start, or the excitation does not end.
        DeviceError : the device does not arm. LinkLostError : the link is lost.
        """
        if not self._device.lacks_trial():
            return
        tell("at a tenth first: this excitation is new to the device")
        self._wait_for_hand()
        self._device.arm(TRIAL_GAIN, trial=True)
        self._ears.forget()
        self._play(negative=False)
        self._device.disarm()

    # Before a trial.

    def _wait_for_hand(self) -> None:
        self._device.set_telemetry(max(round(LOOK_S / self._dt_s), 1))
        self._hold(self._grip_N)
        self._ears.forget()
        if not self._until(self._ready, self._patience_s, (State.FAULT,)):
            grips, places = self._grips(self._window("grip_N")), self._window("encoder_counts")
            seen = (
                "no telemetry"
                if not grips.size
                else (f"{grips.mean():.2f} N, moving by {1e3 * self._count_m * np.ptp(places):.2f} mm")
            )
            raise AbortedError(f"not as asked within {self._patience_s:g} s: {seen}")

    def _window(self, name: str) -> FloatArray:
        size = round(WINDOW_S / LOOK_S)
        return column((record for _, record in self._ears.records[-size:]), name)

    def _ready(self) -> bool:
        """Whether the stylus was at rest and held as requested for a whole window."""
        ears, window = self._ears, round(WINDOW_S / self._dt_s)
        newest = ears.records[-1][0] if ears.records else 0
        if not ears.records or newest - ears.records[0][0] < window or newest - self._looked < window // 10:
            return False
        self._looked = newest
        del ears.records[: -2 * round(WINDOW_S / LOOK_S)]
        places, grips = self._window("encoder_counts"), self._grips(self._window("grip_N"))
        return float(np.ptp(places)) * self._count_m <= STILL_M and self._wrong_grip(grips) is None

    def _grips(self, read_N: FloatArray) -> FloatArray:
        """The grips as read; without a sensor the requested grip, or the assumed one if none was requested."""
        if self._assumed_grip_N is None:
            return read_N
        return np.full_like(read_N, self._assumed_grip_N if self._grip_N is None else self._grip_N)

    def _wrong_grip(self, grips: FloatArray) -> str | None:
        """Reason why these readings are not the requested grip; None if they are."""
        asked, mean = self._grip_N, float(grips.mean())
        if asked is None:
            return None
        room = FREE_N if asked == 0 else max(GRIP_N, GRIP_PART * asked)
        return None if abs(mean - asked) <= room else f"the grip was {mean:.2f} N, asked {asked:g} ± {room:.2g} N"

    # The trial.

    def _until(
        self, met: Callable[[], bool], limit_s: float, over: tuple[State, ...] = (State.FAULT, State.IDLE)
    ) -> bool:
        """Wait until `met` is true, for at most `limit_s`; return whether it was.

        Raises
        ------
        AbortedError : the device entered one of the states `over`.
        """
        came = self._device.listen(limit_s, until=lambda _: self._device.state in over or met())
        if self._device.state in over:
            # The event with the reason may come after the state.
            self._device.listen(0.1)
            self._need_nothing_wrong()
            raise AbortedError(f"the device is {self._device.state.value}")
        return came

    def _need_nothing_wrong(self) -> None:
        wrong = [event.what.value for event in self._ears.happened if isinstance(event.what, Fault | LinkNotice)]
        if wrong:
            raise AbortedError(wrong[0])

    def _play(self, *, negative: bool) -> int:
        """Start the excitation on the armed device; return the tick at which it ended."""
        duration_s = self._samples * self._dt_s
        try:
            self._device.start(negative=negative)
        except LinkLostError:
            raise
        except DeviceError as refused:
            self._until(lambda: False, 0.0)  # a fault or a lost lease gives a better reason
            self._device.disarm()
            raise AbortedError(str(refused)) from None
        self._until(lambda: self._ears.at(Notice.FINISHED) is not None, duration_s + LATE_S)
        end = self._ears.at(Notice.FINISHED)
        if end is None:
            raise AbortedError(f"the excitation of {duration_s:g} s has not ended")
        return end

    def _one(self, negative: bool) -> Trial:
        dt_s = self._dt_s
        before, after = round(BEFORE_S / dt_s), round(AFTER_S / dt_s)
        self._device.arm(self._gain)
        self._device.set_telemetry(1)
        self._ears.forget()
        self._until(lambda: False, BEFORE_S + WAITED_S)
        end = self._play(negative=negative)
        self._until(lambda: self._has(end + after), AFTER_S + WAITED_S)
        # Catching up may take longer than a lease.
        self._device.disarm()
        self._device.catch_up(lambda: self._ears.records[-1][0] if self._ears.records else -1, end + after)
        # A lost lease may have been reported only now, and nothing is armed again after one.
        self._need_nothing_wrong()
        first = end - self._samples
        rows = [(tick, record) for tick, record in self._ears.records if first - before <= tick <= end + after]
        lost = before + self._samples + after + 1 - len(rows)
        if lost > 0:
            raise _AgainError(f"{lost} of {len(rows) + lost} records of telemetry were lost; {self._remedy(first)}")
        return self._kept(rows, first, negative)

    def _has(self, tick: int) -> bool:
        return bool(self._ears.records) and self._ears.records[-1][0] >= tick

    def _remedy(self, begin: int) -> str:
        """Remedy for a line that was too slow for the excitation that began at this tick.

        The first gap tells how long a sweep the device can buffer. With a buffer of r records and a carried share c,
        the first loss comes after f = r / (1 - c) records, and of n records r + c n arrive.
        """
        ticks = np.array([tick for tick, _ in self._ears.records], dtype=float)
        gaps = np.flatnonzero(np.diff(ticks) > 1)
        if not gaps.size:
            return remedy(self._dt_s, 0.0)
        first, all_of_them = float(gaps[0] + 1), float(ticks[-1] - ticks[0] + 1)
        carried = max((ticks.size - first) / (all_of_them - first), 0.0)
        return remedy(self._dt_s, carried, KEPT_PART * (first - begin + ticks[0]) * self._dt_s - AFTER_S)

    def _kept(self, rows: Sequence[tuple[int, Record]], first: int, negative: bool) -> Trial:
        records = [record for _, record in rows]
        ticks = np.array([tick for tick, _ in rows], dtype=float) - first
        playing = (ticks >= 0) & (ticks < self._samples)
        acceleration = column(records, "acceleration_m_s2")
        grips = self._grips(column(records, "grip_N")[playing])
        if not (np.all(np.isfinite(acceleration)) and np.all(np.isfinite(grips))):
            raise _AgainError("a sensor gave no number")
        wrong = self._wrong_grip(grips)
        if wrong is not None:
            raise _AgainError(wrong)
        command, transient = column(records, "command_A"), column(records, "transient_A")
        return Trial(
            time_s=ticks * self._dt_s,
            command_A=command,
            current_A=column(records, "measured_current_A"),
            acceleration_m_s2=acceleration,
            position_m=column(records, "encoder_counts") * self._count_m,
            # The zero of a sensor may be slightly negative.
            grip_N=0.0 if self._grip_N == 0 else max(float(grips.mean()), 0.0),
            negative=negative,
            cut_ticks=int(np.sum(command != transient)),
        )


def request(grip_N: float | None) -> str:
    """The sentence that asks a person for a grip."""
    if grip_N is None:
        return "hold the stylus as it shall be recorded, still"
    return "let go of the stylus, and leave it alone" if grip_N == 0 else f"hold the stylus still, at {grip_N:g} N"


def free_numbers(folder: Path, count: int) -> list[Path]:
    """Paths for `count` new files, numbered after the last existing one, so that none is overwritten.

    Raises
    ------
    InputError : the folder cannot be created or written.
    """
    make_folder(folder)
    there = [path.stem.removeprefix("sweep_") for path in folder.glob("sweep_*.npz")]
    last = max((int(number) for number in there if number.isdecimal()), default=0)
    return [folder / f"sweep_{last + 1 + j:03d}.npz" for j in range(count)]
