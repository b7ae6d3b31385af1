"""The bring-up check: what must hold of a device before it may be armed, step by step, expected beside seen.

Nobody is asked to confirm anything: the person is asked to do things, and the device's own readings show that it was
done and what came of it. The steps that only look come first; a current flows only once all of those have passed.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from controller.host.driver import Device, DeviceError, LinkLostError
from controller.protocol.capacity import TRIAL_GAIN
from controller.protocol.events import Changed, Happened, News, Samples
from controller.protocol.messages import STOP_PRESSED, Record, column
from controller.servo.interface import Fault, Notice, State
from controller.servo.settings import Settings
from transopt.base.errors import InputError
from transopt.base.nearest import did_you_mean
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray

PATIENCE_S = 30.0  # for what a person has to do
KEPT_S = 3.0
WINDOW_S = 0.3  # over which readings are averaged
STILL_COUNTS = 12  # in that time; a hand's tremor is 4 counts each way
LINK_S, LINK_ERROR_S, CLOCK_OFF = 1.0, 0.05, 0.01
TRAVEL_M = 2.5e-3
REST_G = 0.2  # by which the accelerometer may be off; its wrong sign is off by 2
GRIP_ZERO_N = 0.2
OFFSET_A = 0.05
PULSE_A, PULSE_S, COAST_S = 0.05, 5e-3, 0.1
PULSE_SEEN = 0.5  # part of the pulse that has to be measured, over its second half
SIGMAS = 4.0


class Person(Protocol):
    """Whoever stands at the device."""

    def asked(self, what: str) -> None:
        """To do something; returns at once."""
        ...


@dataclass(frozen=True)
class Result:
    """One step. passed : None if it was left out, for the reason that stands in `seen`."""

    name: str
    expected: str
    seen: str
    passed: bool | None


Verdict = tuple[str, bool]


class _FailedError(Exception):
    """A step cannot go on; the text says what was seen instead."""


class Check:
    """The state that the steps share.

    Parameters
    ----------
    device : connected, IDLE, with configuration and library if there are any; every record of telemetry on.
    settings : of its configuration. loaded : whether it has configuration and library.
    rest_g : what the accelerometer reads at rest: 1 with the surface level, 0 where it stands upright.
    """

    def __init__(
        self,
        device: Device,
        settings: Settings,
        person: Person,
        *,
        loaded: bool,
        rest_g: float = 1.0,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self.device, self.settings, self.person, self.loaded = device, settings, person, loaded
        self.rest_g, self.patience_s = rest_g, patience_s
        self.dt_s = device.hello.dt_s
        self.records: deque[tuple[int, Record]] = deque(maxlen=round(KEPT_S / self.dt_s))
        self.happened: list[Happened] = []
        self.missed = 0
        self.travel_counts = round(TRAVEL_M / settings.count_m)
        device.listeners.append(self._take)

    def close(self) -> None:
        self.device.listeners.remove(self._take)

    def _take(self, news: News) -> None:
        if isinstance(news, Samples):
            self.missed += news.missed
            self.records.extend((news.tick + j * news.every, r) for j, r in enumerate(news.records))
        elif isinstance(news, Happened):
            self.happened.append(news)

    # What the steps are made of.

    def wait(self, met: Callable[[], bool], limit_s: float) -> bool:
        """Until it is so; False if it is not within the limit. A fault that nobody asked for ends the step."""
        return met() or self.device.listen(limit_s, until=lambda news: self._unless(news) or met())

    def _unless(self, news: News) -> bool:
        if isinstance(news, Changed) and news.fault not in (None, Fault.EMERGENCY_STOP):
            assert news.fault is not None
            raise _FailedError(f"fault: {news.fault.value}")
        return False

    def column(self, name: str, duration_s: float = WINDOW_S) -> FloatArray:
        """The newest readings of so long a time."""
        size = round(duration_s / self.dt_s)
        return column((record for _, record in list(self.records)[-size:]), name)

    def forget(self) -> None:
        """Forget what was read before now."""
        self.records.clear()

    def at_rest(self) -> bool:
        """Whether a whole window has come in which the stylus was still."""
        counts = self.column("encoder_counts")
        return counts.size >= round(WINDOW_S / self.dt_s) and float(np.ptp(counts)) <= STILL_COUNTS

    def need_rest(self) -> None:
        self.forget()
        if not self.wait(self.at_rest, self.patience_s):
            counts = self.column("encoder_counts")
            raise _FailedError(f"no rest: {np.ptp(counts) if counts.size else 0:.0f} counts in {WINDOW_S:g} s")

    # The steps.

    def link(self) -> Verdict:
        """Heartbeats there and back, and the device's clock against the host's."""
        before, missed = self.device.session.decoder.bad_frames, self.missed
        self.device.listen(LINK_S)
        clock = self.device.session.clock
        if clock is None or not self.records:
            return "no heartbeat or no telemetry", False
        damaged, lost = self.device.session.decoder.bad_frames - before, self.missed - missed
        seen = f"clock {100 * clock.drift:+.2f} %, known to {1e3 * clock.error_s:.1f} ms"
        seen += f", {lost} records lost, {damaged} frames damaged"
        sound = lost == 0 and damaged == 0
        return seen, abs(clock.drift) <= CLOCK_OFF and clock.error_s <= LINK_ERROR_S and sound

    def emergency_stop(self) -> Verdict:
        self.person.asked("press the emergency stop")
        if not self.wait(lambda: self.device.fault is Fault.EMERGENCY_STOP, self.patience_s):
            return f"not pressed within {self.patience_s:g} s", False
        self.person.asked("release the emergency stop")
        self.forget()

        def released() -> bool:
            flags = self.column("flags")
            return flags.size > 0 and not int(flags[-1]) & STOP_PRESSED

        if not self.wait(released, self.patience_s):
            return f"not released within {self.patience_s:g} s", False
        self.device.reset()
        return f"latched, reset to {self.device.state.value}", self.device.state is State.IDLE

    def encoder(self) -> Verdict:
        self.forget()
        if not self.wait(lambda: len(self.records) > 0, 1.0):
            return "no telemetry", False
        begin = self.records[0][1].encoder_counts
        self.person.asked("move the stylus slowly outwards, away from the surface, by 5 mm")

        def moved() -> int:
            return self.records[-1][1].encoder_counts - begin if self.records else 0

        self.wait(lambda: abs(moved()) >= self.travel_counts, self.patience_s)
        return f"{moved():+d} counts, {1e3 * moved() * self.settings.count_m:+.2f} mm", moved() >= self.travel_counts

    def accelerometer(self) -> Verdict:
        self.person.asked("let the stylus rest")
        self.need_rest()
        mean_g = float(self.column("acceleration_m_s2").mean()) / STANDARD_GRAVITY_M_S2
        return f"{mean_g:+.3f} g", abs(mean_g - self.rest_g) <= REST_G

    def grip_zero(self) -> Verdict:
        self.person.asked("let go of the stylus, and leave it alone until the next request")
        self.forget()

        def let_go() -> bool:
            grip = self.column("grip_N")
            return grip.size >= round(WINDOW_S / self.dt_s) and float(np.abs(grip).max()) <= GRIP_ZERO_N

        done = self.wait(let_go, self.patience_s)
        grip = self.column("grip_N")
        return f"{grip.mean() if grip.size else np.nan:+.3f} N", done

    def current_offset(self) -> Verdict:
        self.need_rest()
        mean_A = float(self.column("measured_current_A").mean())
        return f"{mean_A:+.4f} A", abs(mean_A) <= OFFSET_A

    def polarity(self) -> Verdict:
        """Pulses so small that they do no harm with the wrong sign either.

        5 ms at 50 mA move a stylus that hangs free by ten counts, one that is held by less than one: then once more,
        with the most that a device gives for a test.
        """
        seen, sound, furthest = self._pulsed(PULSE_A, PULSE_S)
        if sound and furthest == 0:
            most_A, most_s = self.device.hello.pulse_A, self.device.hello.pulse_s
            more, sound, furthest = self._pulsed(most_A, most_s)
            seen += f"; at {1e3 * most_A:g} mA, {1e3 * most_s:g} ms: {more}"
        return seen, sound and furthest >= 1

    def _pulsed(self, pulse_A: float, duration_s: float) -> tuple[str, bool, int]:
        """In words; whether current and acceleration are as they should be; how far the encoder went."""
        self.need_rest()
        quiet = self.column("acceleration_m_s2")
        self.forget()
        ticks = round(duration_s / self.dt_s)
        self.device.pulse(pulse_A, ticks)
        self.device.listen(duration_s + COAST_S)
        records = [record for _, record in self.records]
        driven = np.array([record.command_A != 0 for record in records])
        if int(driven.sum()) != ticks:
            return f"{int(driven.sum())} of {ticks} ticks of the pulse seen", False, 0
        first = int(np.argmax(driven))
        late = records[first + ticks // 2 : first + ticks]
        current_A = float(np.mean([record.measured_current_A for record in late]))
        # The amplifier's delay is over after two ticks; later on a hand's spring pushes back.
        short = round(PULSE_S / self.dt_s)
        pushed = [record.acceleration_m_s2 for record in records[first + 2 : first + short + 1]]
        push = float(np.mean(pushed) - quiet.mean())
        # Noise is correlated over some ticks: taken of means over as many.
        means = quiet[: quiet.size // short * short].reshape(-1, short).mean(axis=1)
        path = np.array([record.encoder_counts for record in records[first:]]) - records[first].encoder_counts
        furthest = int(path[int(np.argmax(np.abs(path)))])
        seen = f"current {current_A:+.3f} A, acceleration {push:+.2f} m/s², encoder {furthest:+d} counts"
        sound = current_A >= PULSE_SEEN * pulse_A and push > SIGMAS * float(means.std())
        return seen, sound, furthest

    def trial_sweep(self) -> Verdict:
        self.person.asked("hold the stylus, or leave it alone, still: it will tremble for a moment")
        self.need_rest()
        begin = len(self.happened)

        def ended() -> bool:
            return any(event.what is Notice.FINISHED for event in self.happened[begin:])

        self.device.arm(TRIAL_GAIN, trial=True)
        try:
            self.device.start()
            done = self.wait(ended, self.patience_s)
        finally:
            self.device.disarm()
        return "played to its end" if done else "not played to its end", done

    def trial(self) -> Verdict:
        self.person.asked("hold the stylus above the surface, still")

        def held() -> bool:
            z = (self.column("encoder_counts") - self.settings.surface_counts) * self.settings.count_m
            grip = self.column("grip_N")
            firm = self.settings.assumed_grip_N is not None or float(grip.min(initial=np.inf)) > least_N
            return self.at_rest() and firm and float(z.min()) > self.settings.rearm_height_m

        least_N = self.settings.grip_min_N + self.settings.grip_margin_N
        self.forget()
        if not self.wait(held, self.patience_s):
            return f"not held still above the surface within {self.patience_s:g} s", False
        begin = len(self.happened)

        def came(what: Notice) -> Happened | None:
            return next((event for event in self.happened[begin:] if event.what is what), None)

        self.device.arm(TRIAL_GAIN, trial=True)
        try:
            self.person.asked("tap the surface")
            self.wait(lambda: came(Notice.FINISHED) is not None, self.patience_s)
        finally:
            self.device.disarm()
        contact = came(Notice.CONTACT)
        if contact is None:
            seen = ", ".join(dict.fromkeys(event.what.value for event in self.happened[begin:]))
            return f"no contact within {self.patience_s:g} s" + (f": {seen}" if seen else ""), False
        where = f"contact at {contact.speed_m_s:.3f} m/s, {contact.grip_N:.2f} N"
        done = came(Notice.FINISHED) is not None
        return f"{where}, {'played to its end' if done else 'not played to its end'}", done


@dataclass(frozen=True)
class Step:
    """drives : a current flows, so that everything before it has to have passed; needs configuration and library."""

    name: str
    run: Callable[[Check], Verdict]
    expected: Callable[[Check], str]
    drives: bool = False


STEPS = (
    Step(
        "link",
        Check.link,
        lambda _: f"clock within {100 * CLOCK_OFF:g} %, known to {1e3 * LINK_ERROR_S:g} ms, nothing lost",
    ),
    Step("emergency-stop", Check.emergency_stop, lambda _: "latches a fault when pressed, resets when released"),
    Step("encoder", Check.encoder, lambda c: f"at least +{c.travel_counts} counts: they grow outwards"),
    Step("accelerometer", Check.accelerometer, lambda c: f"{c.rest_g:+g} ± {REST_G:g} g at rest"),
    Step("grip-zero", Check.grip_zero, lambda _: f"0 ± {GRIP_ZERO_N:g} N when released"),
    Step("current-offset", Check.current_offset, lambda _: f"0 ± {OFFSET_A:g} A at rest"),
    Step(
        "polarity",
        Check.polarity,
        lambda _: f"{1e3 * PULSE_A:g} mA, {1e3 * PULSE_S:g} ms: current flows, both sensors go outwards",
        drives=True,
    ),
    Step("trial-tap", Check.trial, lambda _: f"a tap at gain {TRIAL_GAIN:g} is played to its end", drives=True),
)
SWEEP_STEPS = (
    *STEPS[:-1],
    Step("trial-sweep", Check.trial_sweep, lambda _: f"a sweep at gain {TRIAL_GAIN:g} is played to its end", True),
)
# What a device may lack, or what the person at it may have no way to do.
SKIPPABLE = ("emergency-stop", "encoder", "accelerometer", "grip-zero")


def check_skipped(names: Sequence[str]) -> tuple[str, ...]:
    """The names, if all of them may be left out.

    Raises
    ------
    InputError : one may not.
    """
    for name in names:
        if name not in SKIPPABLE:
            raise InputError(f"--skip {name}: must be one of {', '.join(SKIPPABLE)}{did_you_mean(name, SKIPPABLE)}")
    return tuple(names)


def run_steps(check: Check, skip: tuple[str, ...] = (), tell: Callable[[Result], None] | None = None) -> list[Result]:
    """All steps in order; `tell` is called with each as it is done.

    Parameters
    ----------
    skip : names of steps to leave out, of SKIPPABLE.

    Raises
    ------
    LinkLostError : the device is gone.
    """
    results: list[Result] = []
    for step in SWEEP_STEPS if check.settings.host_starts else STEPS:
        results.append(_result(check, step, skip, results))
        if tell is not None:
            tell(results[-1])
    return results


def _result(check: Check, step: Step, skip: tuple[str, ...], before: list[Result]) -> Result:
    expected = step.expected(check)
    reason = None
    if step.name in skip:
        reason = "left out by --skip"
    elif step.drives and any(result.passed is False for result in before):
        reason = "left out: a step before it has failed"
    elif step.drives and not check.loaded:
        reason = "left out: give a library"
    elif step.name == "grip-zero" and check.settings.assumed_grip_N is not None:
        reason = "left out: this library is for a device without grip sensor"
    if reason is not None:
        return Result(step.name, expected, reason, None)
    try:
        seen, passed = step.run(check)
    except LinkLostError:
        raise
    except (_FailedError, DeviceError) as failed:
        seen, passed = str(failed), False
    return Result(step.name, expected, seen, passed)


def passed(results: list[Result], skip: tuple[str, ...] = ()) -> bool:
    """Whether the device may be armed: no step failed, and each was done or left out by the user or for its kind."""
    return all(
        result.passed or (result.passed is None and (result.name in skip or result.name == "grip-zero"))
        for result in results
    )
