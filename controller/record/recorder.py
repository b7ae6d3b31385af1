"""Record a device's telemetry and events in files that are complete at any moment.

    telemetry.csv    every record with its events; grows by blocks of complete lines; telemetry.npz the same as arrays
    events.csv       every event, with its tick; written as it comes
    tap_001.csv ...  acceleration, position and current around each contact in the canonical format that
                     `transopt.recordings.recording` reads; each written whole, when its time has passed

An armed device reports contacts; for taps on a real object, which it does not predict, a contact is where the
acceleration leaves its running mean.

No call takes longer than a lease, since data that was written is not touched again.
"""

import math
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller.device.device_file import Accelerometer
from controller.device.rail import why_at_rail
from controller.protocol.codes import LinkNotice
from controller.protocol.events import Happened, News, Samples, column
from controller.protocol.messages import Record
from controller.record.telemetry import CSV_NAME, NPZ_NAME, Lines, Telemetry
from controller.record.trial_file import refuse_old
from controller.servo.interface import Fault, Notice
from transopt.base.files import whole_file
from transopt.base.signals import FloatArray
from transopt.base.terminal import make_folder

EVENTS_NAME = "events.csv"
EVENT_COLUMNS = "tick,time_s,event,speed_m_s,grip_N,scale,cooled"
BEFORE_S, AFTER_S = 0.06, 0.1  # kept around each contact
MEAN_S = 0.05  # time constant of the running mean of the acceleration


@dataclass(frozen=True)
class Contact:
    """The records around one contact.

    Attributes
    ----------
    number : from 1.
    tick : tick at which the waveform began, or the acceleration rose.
    speed_m_s : as the device estimated it; NaN for a real object.
    grip_N : as the device read it, or the mean before contact.
    ticks : (n,) ticks of the records, evenly spaced; the columns below are (n,) too.
    counts : encoder counts.
    current_A : measured current.
    winding_C : the device's estimate.
    missed : number of records lost in between.
    cut : what ended its waveform too soon, as its message; empty if nothing did.
    path : path of its file; None without one.
    surface_counts : counts of the surface at the time; None for those of the settings.
    scale, cooled : the transient as scaled for the coil's heat: scale times a blend with a share `cooled` of the cool
        command.
    """

    number: int
    tick: int
    speed_m_s: float
    grip_N: float
    dt_s: float
    ticks: FloatArray
    counts: FloatArray
    acceleration_m_s2: FloatArray
    current_A: FloatArray
    command_A: FloatArray
    feedback_A: FloatArray
    winding_C: FloatArray
    missed: int
    path: Path | None = None
    surface_counts: float | None = None
    scale: float = 1.0
    cooled: float = 0.0
    cut: str = ""

    @property
    def spoilt(self) -> str:
        """Reason why neither its figures nor a file of it count; empty if they do."""
        if self.missed:
            return f"{self.missed} records were lost"
        return f"cut short: {self.cut}" if self.cut else ""


class Recorder:
    """A listener of `driver.Device` that records a session.

    Parameters
    ----------
    folder : None keeps contacts in memory and writes nothing.
    count_m, surface_counts : of the encoder, as in `Settings`.
    trigger_m_s2 : deviation from the running mean that counts as a contact; None uses the contacts of the device.
    over : whether to overwrite a recording in the folder; if not, it is an error.
    around_s : time recorded before and after each contact.
    accelerometer : of the device; a tap that reaches an end of its range gets no file. None looks at no range.

    Attributes
    ----------
    count_m, surface_counts : of the encoder; the surface may be moved between two taps.
    contacts : completed contacts.
    at_rail : number of a contact that has reached an end of the accelerometer's range -> the reason in words.
    records, missed : numbers of records so far, received and lost.
    loudest_m_s2 : largest deviation from the running mean so far that could have been a contact; 0 without a trigger.

    Raises
    ------
    InputError : the folder cannot be written, or already holds a recording.
    """

    def __init__(
        self,
        folder: Path | None,
        dt_s: float,
        count_m: float,
        surface_counts: float = 0.0,
        trigger_m_s2: float | None = None,
        *,
        over: bool = False,
        around_s: tuple[float, float] = (BEFORE_S, AFTER_S),
        accelerometer: Accelerometer | None = None,
    ) -> None:
        self._folder, self._dt_s, self._over = folder, dt_s, over
        self._before, self._after = (round(each / dt_s) for each in around_s)
        self.count_m, self.surface_counts = count_m, surface_counts
        self._trigger_m_s2, self._mean_m_s2 = trigger_m_s2, float("nan")
        self._deaf_until, self.loudest_m_s2 = 0, 0.0
        self._rail_tick: int | None = None  # at which the present run of readings that are no number began
        self._first, self._every = 0, 1  # of the telemetry
        self.contacts: list[Contact] = []
        self.at_rail: dict[int, str] = {}
        self._accelerometer = accelerometer
        self.records = self.missed = 0
        self._kept: deque[tuple[int, Record]] = deque(maxlen=2 * (self._before + self._after))
        self._open: list[Happened] = []
        self._heat: dict[int, tuple[float, float]] = {}  # tick -> scale and cooled, for open contacts
        self._playing: int | None = None  # tick of the contact whose waveform plays
        self._cut: dict[int, str] = {}  # tick -> what cut the waveform, for open contacts
        self._happened: dict[int, list[str]] = {}  # tick -> names of events whose record has not come yet
        self._telemetry: Telemetry | None = None
        self._events: Lines | None = None
        self._begun = False
        if folder is not None:
            make_room(folder, over=over)

    def in_words(self) -> str:
        """Phrase on the files in the folder, to be appended to a sentence; empty without a folder."""
        if not self._begun:
            return ""
        files = [contact.path.name for contact in self.contacts if contact.path is not None]
        spoilt = len(self.contacts) - len(files) - len(self.at_rail)
        gaps = f" ({spoilt} taps, cut short or with records lost, have no file of their own)" if spoilt else ""
        return f"; {self._folder}: {', '.join([CSV_NAME, NPZ_NAME, EVENTS_NAME, *files])}, all whole{gaps}"

    def take(self, news: News) -> None:
        if self._folder is not None and not self._begun and isinstance(news, Samples | Happened):
            # Files are created with the first data, so that a run that fails to start leaves none behind.
            self._begun = True
            self._telemetry = Telemetry(self._folder, self._dt_s, over=self._over)
            self._events = Lines(self._folder / EVENTS_NAME, EVENT_COLUMNS, over=self._over)
        if isinstance(news, Samples):
            self._samples(news)
        elif isinstance(news, Happened):
            self._event(news)

    def fit(self, most: int) -> tuple[int, int]:
        """Record at most `most` ticks around a contact, fewer before and after it in proportion.

        Returns
        -------
        Ticks before and after a contact.
        """
        shorter = min(most / (self._before + 1 + self._after), 1.0)
        self._before, self._after = int(shorter * self._before), int(shorter * self._after)
        return self._before, self._after

    def flush(self) -> None:
        """Bring the files up to date."""
        if self._telemetry is not None:
            self._telemetry.flush()

    def close(self) -> None:
        """Complete the files; a contact whose time has not passed is in the telemetry only."""
        telemetry, events = self._telemetry, self._events
        self._telemetry = self._events = None
        try:
            if telemetry is not None:
                telemetry.close()
        finally:
            if events is not None:
                events.close()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _samples(self, samples: Samples) -> None:
        if self.records == 0 or samples.every != self._every:
            self._restart(samples)
        self.missed += samples.missed
        self.records += len(samples.records)
        for j, record in enumerate(samples.records):
            tick = samples.tick + j * samples.every
            self._kept.append((tick, record))
            if self._trigger_m_s2 is not None:
                self._feel(tick, record, samples.every, self._trigger_m_s2)
            if self._telemetry is not None:
                self._telemetry.record(tick, record, ";".join(self._happened.pop(tick, ())))
        newest = self._kept[-1][0]
        while self._open and newest >= self._open[0].tick + self._after:
            self._complete(self._open.pop(0))

    def _restart(self, samples: Samples) -> None:
        """Begin a new stream of telemetry; a contact before its first record gets no further ones."""
        while self._open and self._open[0].tick < samples.tick:
            self._complete(self._open.pop(0))
        self._kept.clear()
        self._first, self._every = samples.tick, samples.every

    def _event(self, event: Happened) -> None:
        if self._events is not None:
            self._events.append(
                f"{event.tick},{event.tick * self._dt_s!r},{event.what.name.lower()},"
                f"{event.speed_m_s!r},{event.grip_N!r},{event.scale!r},{event.cooled!r}\n"
            )
            # An event is sent at once, its record in a batch that usually comes later.
            if isinstance(event.what, Notice | Fault):
                self._happened.setdefault(event.tick, []).append(event.what.name.lower())
        if event.what is Notice.CONTACT and self._trigger_m_s2 is None:
            self._open.append(event)
            self._playing = event.tick
        elif event.what is Notice.SCALED_FOR_HEAT:
            self._heat[event.tick] = event.scale, event.cooled
        elif event.what is Notice.FINISHED:
            self._playing = None
        elif self._playing is not None and (isinstance(event.what, Fault) or event.what is LinkNotice.LEASE_LOST):
            self._cut[self._playing], self._playing = event.what.value, None

    def _feel(self, tick: int, record: Record, every: int, trigger_m_s2: float) -> None:
        a = record.acceleration_m_s2
        if not math.isfinite(a):
            # The accelerometer is at its rail, or its wire is broken: only a reading thereafter tells which.
            self._rail_tick = tick if self._rail_tick is None else self._rail_tick
            return
        begun, self._rail_tick = tick if self._rail_tick is None else self._rail_tick, None
        if self._deaf_until == 0:
            # The first reading is gravity.
            self._mean_m_s2, self._deaf_until = a, tick + self._before
        if tick >= self._deaf_until:
            self.loudest_m_s2 = max(self.loudest_m_s2, abs(a - self._mean_m_s2))
            if abs(a - self._mean_m_s2) > trigger_m_s2:
                self._open.append(Happened(0, begun, Notice.CONTACT, float("nan"), float("nan"), 0))
                self._deaf_until = tick + self._before + self._after
        self._mean_m_s2 += every * self._dt_s / MEAN_S * (a - self._mean_m_s2)

    def _complete(self, event: Happened) -> None:
        low, high = event.tick - self._before, event.tick + self._after
        rows = [(tick, record) for tick, record in self._kept if low <= tick <= high]
        ticks, records = np.array([tick for tick, _ in rows], dtype=float), [record for _, record in rows]
        missed = (high - max(low, self._first)) // self._every + 1 - len(rows)
        (scale, cooled), cut = self._heat.pop(event.tick, (1.0, 0.0)), self._cut.pop(event.tick, "")
        before_N = column(records, "grip_N")[ticks < event.tick]
        number, acceleration = len(self.contacts) + 1, column(records, "acceleration_m_s2")
        why = ""
        if self._accelerometer is not None and not (missed or cut):
            why = why_at_rail((ticks - event.tick) * self._dt_s, acceleration, self._accelerometer)
        if why:
            self.at_rail[number] = why
        contact = Contact(
            number=number,
            tick=event.tick,
            speed_m_s=event.speed_m_s,
            grip_N=event.grip_N if np.isfinite(event.grip_N) else float(before_N.mean()),
            dt_s=self._dt_s,
            ticks=ticks,
            counts=column(records, "encoder_counts"),
            acceleration_m_s2=acceleration,
            current_A=column(records, "measured_current_A"),
            command_A=column(records, "command_A"),
            feedback_A=column(records, "feedback_A"),
            winding_C=column(records, "winding_C"),
            missed=missed,
            path=None if missed or cut or why or self._folder is None else self._folder / f"tap_{number:03d}.csv",
            surface_counts=self.surface_counts,
            scale=scale,
            cooled=cooled,
            cut=cut,
        )
        self.contacts.append(contact)
        if contact.path is not None:
            self._write(contact, contact.path)

    def _write(self, contact: Contact, path: Path) -> None:
        head = [
            f"# recorded from a device; time from its tick {contact.tick}",
            *([f"# speed_m_s: {contact.speed_m_s!r}"] if np.isfinite(contact.speed_m_s) else []),
            *([f"# grip_N: {contact.grip_N!r}"] if np.isfinite(contact.grip_N) else []),
            "time_s,acceleration_m_s2,position_m,current_A",
        ]
        times = (contact.ticks - contact.tick) * self._dt_s
        position = (contact.counts - self.surface_counts) * self.count_m
        columns = zip(times, contact.acceleration_m_s2, position, contact.current_A, strict=True)
        rows = [f"{t:.6f},{a:.6g},{z:.7f},{i:.6g}" for t, a, z, i in columns]
        with whole_file(path) as file:
            file.write(("\n".join([*head, *rows]) + "\n").encode("ascii"))


def make_room(folder: Path, *, over: bool = False) -> None:
    """Make sure that a recording can begin there.

    Parameters
    ----------
    over : a recording that is there may be written over: that of a simulated device can be made again, that of a
        real one cannot.
    """
    make_folder(folder)
    if not over:
        refuse_old(folder, [CSV_NAME, EVENTS_NAME, *sorted(path.name for path in folder.glob("tap_*.csv"))])
