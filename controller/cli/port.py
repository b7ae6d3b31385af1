"""What every command does with a device on a port of any kind: connect, load, run, and stop on Ctrl-C.

Heavy imports stand inside the commands, so that help and errors come at once.
"""

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from controller.cli.options import SIMULATED
from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from controller.cli.bench import Bench
    from controller.host.connection import Connection
    from controller.host.driver import Device
    from controller.host.monitor import Monitor
    from controller.host.payload import Load
    from controller.host.surface import Drift
    from controller.protocol.events import News
    from controller.protocol.messages import HelloReply
    from controller.record.recorder import Recorder

LISTEN_S = 0.05  # between two looks at whether to end
STOPPED = "stopped; the device is disarmed"
UNCONFIRMED = "stopped; the device has not confirmed that it is disarmed: it disarms itself when its lease is over"
NOT_CONNECTED = "stopped before the device was connected"


def person_at(name: str) -> "Bench":
    """A device on a port in the hand of whoever reads the terminal."""
    from controller.cli.bench import Bench
    from controller.host.sweeps import request

    return Bench(name, terminal.console(), hold=lambda grip_N: ConsolePerson().asked(request(grip_N)))


def open_device(port: "str | Connection") -> "Device":
    """Connect; what the commands do is the same for any device that speaks the protocol.

    Raises
    ------
    InputError : no device; or the simulated one by its name alone, which says nothing of its hand.
    """
    from controller.host.driver import Device

    if port == SIMULATED:
        raise InputError(
            f"--port {SIMULATED} ends with its command and is for tap, record and refine: "
            "start `transopt-device` for a simulated device that stays"
        )
    return Device(port)


def load(device: "Device", given: "Load", console: "Console") -> None:
    """Configuration and library in force, with a progress bar where there is a terminal; says what was replaced.

    A device holds one library. The name of the scene of each is kept by its hash, which is all that a device knows.
    Cool commands that a small device has no room for are coarser there or left out, which is said.
    """
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

    from controller.device.rail import range_in_words
    from controller.device.stated import grip_in_words
    from controller.host.kept import library_in_words, remember_library
    from controller.host.payload import Payload, fitted, heat_in_words, need_hardware
    from controller.protocol.events import capacity_of
    from controller.protocol.image import sha256

    need_hardware(given.settings, device.hello)
    given, cost = fitted(given, capacity_of(device.hello))
    before, after = device.hello.library_sha256, sha256(given.image)
    if isinstance(given, Payload) and not device.harmless:
        remember_library(after, given.library.meta["scene"]["name"])
    device.configure(given.configuration)
    began_s = time.monotonic()
    columns = (TextColumn("upload"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("upload", total=len(given.image))
        sent = device.upload(given.image, lambda done, total: bar.update(task, completed=done, total=total))
    device.surface(given.settings.surface_counts)
    took = f"{len(given.image) / 1e3:.1f} kB in {time.monotonic() - began_s:.3f} s"
    words, named = "the device has this library already", library_in_words(after)
    if sent:
        words = f"uploaded {took}"
        named += f", in place of {library_in_words(before)}" if any(before) else ""
    words = f"{words}: {named}"
    console.print(f"{device.name}: {words}")
    for said in filter(None, (cost, heat_in_words(given.settings, device.hello))):
        console.print(f"{device.name}: {said}")
    if isinstance(given, Payload):
        for words in (of(given.device, given.library) for of in (grip_in_words, range_in_words)):
            if words:
                console.print(words)


class StoppedError(Exception):
    """Ctrl-C while a device was looked after; it is disarmed."""


@contextmanager
def disarmed_by_ctrl_c(device: "Device") -> Iterator[None]:
    """The first Ctrl-C disarms; at another one meanwhile the driver gives an emergency stop.

    Raises
    ------
    StoppedError : that happened.
    KeyboardInterrupt : the device is a simulated one.
    """
    from controller.servo.interface import State

    try:
        yield
    except KeyboardInterrupt:
        if device.harmless:
            raise  # a simulation that is stopped has nothing to tell
        if device.state is not State.FAULT:
            device.disarm()
        terminal.takes_its_time()  # for what was recorded until then
        raise StoppedError from None


@contextmanager
def connected(port: "str | Connection", reset: bool | None = None) -> "Iterator[Device]":
    """A device for the length of a block; a fault is left only where the user says so, None does not look.

    Raises
    ------
    InputError : no device, or a fault is latched.
    """
    from controller.servo.interface import State

    device: Device | None = None
    try:
        with open_device(port) as device:
            if reset and device.state is State.FAULT:
                device.reset()
            if reset is not None:
                device.need_no_fault()
            yield device
    except KeyboardInterrupt:
        # The driver has given an armed one an emergency stop, and any one a DISARM.
        words = NOT_CONNECTED if device is None else STOPPED if device.disarmed else UNCONFIRMED
        typer.echo(words, err=True)
        raise typer.Exit(130) from None


def listen(device: "Device", duration_s: float | None, ended: Callable[[], bool], *, armed: bool | None) -> None:
    """Until it is so, or for so long, or for ever.

    Parameters
    ----------
    armed : True ends when the device is armed no more, by a fault or a lost lease; False at a fault; None at neither.
    """
    from controller.servo.interface import State

    over = {True: (State.FAULT, State.IDLE), False: (State.FAULT,), None: ()}[armed]
    end_s = float("inf") if duration_s is None else device.now_s() + duration_s
    while not ended() and device.now_s() < end_s:
        device.listen(min(LISTEN_S, end_s - device.now_s()))
        if device.state in over:
            # The event that says why may come after the state.
            device.listen(2 * LISTEN_S)
            return


def who(port: str, hello: "HelloReply") -> str:
    """One line about a device."""
    version = f"{hello.firmware >> 16}.{hello.firmware >> 8 & 255}.{hello.firmware & 255}"
    from controller.host.kept import library_in_words
    from controller.protocol.messages import PULSE_SOUND, TRIAL_FINISHED

    there = any(hello.configuration_sha256)
    checked = "checked" if hello.evidence == PULSE_SOUND | TRIAL_FINISHED else "not checked"
    return (
        f"{port}: firmware {version} ({'double' if hello.real_bytes == 8 else 'float'}), boot {hello.boot:08x}, "
        f"period {hello.dt_s * 1e6:g} us, limits {hello.current_A:g} A and {hello.command_A:g} A, "
        + (f"configuration {hello.configuration_sha256.hex()[:8]} {checked}, " if there else "no configuration, ")
        + library_in_words(hello.library_sha256)
    )


@contextmanager
def no_long_pauses() -> Iterator[None]:
    """A search for garbage in all that numpy, scipy and rich have made takes 0.15 s, most of a lease.

    What there is of it by now stays until the end of this.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def run(
    bench: "Bench",
    device: "Device",
    recorder: "Recorder",
    title: str,
    *,
    enough: Callable[[], bool] = lambda: False,
    seconds: float | None = None,
    gain: float | None = None,
    file: Path | None = None,
) -> "tuple[Monitor, bool]":
    """Take telemetry of every tick to screen and files until whoever holds the device has tapped.

    Over a line that does not carry every tick, the device is armed for one tap at a time, and sends it afterwards.

    Parameters
    ----------
    enough : asked again and again; a person's run ends with it.
    seconds : after which it ends at the latest.
    gain : to arm with; None leaves the device idle.
    file : of the device, in which the surface is stored when the counts have drifted; None without one.

    Returns
    -------
    What was shown, and whether Ctrl-C ended it.

    Raises
    ------
    LinkLostError : the device is gone; the files are whole as far as they go.
    """
    from controller.host.driver import LinkLostError
    from controller.host.monitor import Monitor
    from controller.host.rates import WHOLE, carried
    from controller.host.slow_taps import tap_by_tap
    from controller.host.surface import Drift
    from controller.servo.interface import State

    drift = Drift(device.hello.dt_s, recorder.count_m, recorder.surface_counts)
    stopped, shown = (
        False,
        Monitor(bench.console, title, device.hello.dt_s, recorder.count_m, recorder.surface_counts),
    )
    listeners = [recorder.take, shown.take, drift.take]
    with recorder, shown, no_long_pauses():
        try:
            with disarmed_by_ctrl_c(device):
                share = 1.0 if gain is None or device.harmless else carried(device)
                if gain is not None and device.lacks_trial():
                    _try_out(device, bench.console, seconds)
                device.listeners += listeners

                def ended() -> bool:
                    if drift.moved and gain is not None and device.state in (State.ARMED, State.IDLE):
                        _follow(drift, device, recorder, bench.console, file)
                    return bench.done(enough())

                if gain is None or share >= WHOLE:
                    device.set_telemetry(1)
                    if gain is not None:
                        device.arm(gain, tell=bench.console.print)
                    listen(device, seconds, ended, armed=gain is not None)
                else:
                    tap_by_tap(device, recorder, gain, share, seconds, ended, bench.console.print)
                if device.state is not State.FAULT:
                    device.disarm()
        except StoppedError:
            stopped = True
        except LinkLostError as lost:
            raise LinkLostError(f"{lost}{recorder.in_words()}") from None
        finally:
            for listener in filter(device.listeners.__contains__, listeners):
                device.listeners.remove(listener)
    return shown, stopped


def _try_out(device: "Device", console: "Console", seconds: float | None) -> None:
    """One tap at a tenth, which a device wants of each library that is new to it."""
    from controller.protocol.capacity import TRIAL_GAIN
    from controller.protocol.events import Happened
    from controller.servo.interface import Notice, State

    console.print("this library is new to the device: tap the surface once, it is played at a tenth")
    ended: list[bool] = []

    def take(news: "News") -> None:
        if isinstance(news, Happened) and news.what is Notice.FINISHED:
            ended.append(True)

    with device.heard_by(take):
        device.arm(TRIAL_GAIN, trial=True, tell=console.print)
        listen(device, seconds, lambda: bool(ended), armed=True)
        if device.state is not State.FAULT:
            device.disarm()


def _follow(drift: "Drift", device: "Device", recorder: "Recorder", console: "Console", file: Path | None) -> None:
    """Move the surface to where the stylus has come to rest on it, on the device, in the recording, in the file."""
    from controller.device.reading import restate
    from controller.host.driver import RefusedError
    from controller.host.kept import remember_surface
    from controller.protocol.codes import Reason

    moved, stored = drift.moved, ""
    try:
        device.surface(drift.surface_counts + moved)
    except RefusedError as refused:
        if refused.reason not in (Reason.STILL_PLAYING, Reason.WALL_PUSHES):
            raise
        return  # touched since the newest record: the next rest will do
    drift.done(moved)
    recorder.surface_counts = drift.surface_counts
    if file is not None:
        restate(file, "encoder.surface_counts", drift.surface_counts)
        remember_surface(file, drift.surface_counts, device.hello.boot)
        stored = f", stored in {file}"
    console.print(
        f"the counts have drifted: three rests in a row at {moved:+.0f} counts; the surface is at "
        f"{drift.surface_counts:g} counts from here on{stored}"
    )


class ConsolePerson:
    """Whoever reads the terminal."""

    def asked(self, what: str) -> None:
        terminal.console().print(f"  please {what}")
