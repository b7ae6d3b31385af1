"""`transopt-play doctor`: what is installed, which ports there are, who may open them, and what answers on one."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from controller.cli import port as sessions
from controller.cli.options import AnyPort
from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.host.driver import Device
    from controller.host.transport import Listed

NEEDED = ("casadi", "numpy", "pyserial", "scipy")
USB_SERIAL = Path("/sys/bus/usb-serial/devices")
LATENCY_MS = 4  # of an adapter: four of its periods, there and back, must fit well into a lease


class Finding(NamedTuple):
    """One line. remedy : empty where nothing is to be done."""

    what: str
    found: str
    remedy: str = ""


def doctor(port: AnyPort = None) -> None:
    """Say what is installed, which ports there are, who may open them, and what answers on --port.

    Exit 1: something is to be done.
    """
    console = terminal.console()
    short = False
    for one in [*installed(), *on_ports(port is not None), *([] if port is None else answering(port))]:
        short |= bool(one.remedy)
        words = f"{one.what}: {one.found}" + (f": {one.remedy}" if one.remedy else "")
        console.print(words, style="red" if one.remedy else None)
    if port is None:
        console.print("no port was asked: --port NAME says what answers there")
    if short:
        raise typer.Exit(1)


def installed() -> Iterator[Finding]:
    """The package, its solver and its device core."""
    from controller.firmware.build import NoCompilerError
    from controller.firmware.core_device import CoreDevice
    from transopt.base.machine import versions
    from transopt.solvers.options import default_solver

    yield Finding("installed", ", ".join(f"{name} {number}" for name, number in versions(*NEEDED).items()))
    solver = default_solver()
    compiled = solver == "riccati"
    slower = (
        ""
        if compiled
        else "its own solver was not built, so that solving takes longer: install a C compiler, then it"
    )
    yield Finding("solver", solver, slower)
    try:
        CoreDevice(1)
        yield Finding("device core", "there, for --simulate and transopt-device")
    except NoCompilerError as missing:
        yield Finding("device core", "missing", f"{missing}; only --simulate needs it")


def on_ports(named: bool) -> Iterator[Finding]:
    """Every port: what it is, whether it may be opened, how long an adapter keeps what it has.

    Parameters
    ----------
    named : a port was named, so that having none, as beside a socket, is nothing to be done about.
    """
    from controller.host.transport import listed_ports

    found = listed_ports()
    if not found:
        yield Finding("ports", "none", "" if named else "plug the device in; a cable for charging has no data lines")
    for port in found:
        yield _permission(port)
        yield from _latency(port)


def _permission(port: "Listed") -> Finding:
    name = f"{port.name} {port.description}".strip()
    if not Path(port.name).exists() or os.access(port.name, os.R_OK | os.W_OK):
        return Finding(name, "may be opened")  # a name that is no file, like COM3, has no permissions
    rule = (
        ""
        if port.vendor is None
        else (
            f', or in /etc/udev/rules.d/60-transopt.rules: SUBSYSTEM=="tty", ATTRS{{idVendor}}=="{port.vendor:04x}", '
            'TAG+="uaccess", ENV{ID_MM_DEVICE_IGNORE}="1"; then sudo udevadm control --reload and plug it in again'
        )
    )
    return Finding(name, "may not be opened", f"sudo usermod -aG dialout $USER and log in again{rule}")


def _latency(port: "Listed") -> Iterator[Finding]:
    timer = USB_SERIAL / Path(port.name).name / "latency_timer"
    try:
        held_ms = int(timer.read_text())
    except (OSError, ValueError):
        return  # no adapter, or one without a timer
    faster = f"echo 1 | sudo tee {timer}" if held_ms > LATENCY_MS else ""
    yield Finding(f"{port.name} adapter", f"keeps what it has for {held_ms} ms", faster)


def answering(port: str) -> Iterator[Finding]:
    """What is on a port: it is asked who it is, and listened to; nothing is configured or armed."""
    try:
        with sessions.open_device(port) as device:
            yield Finding("device", sessions.who(port, device.hello))
            yield from _line(device)
            if device.fault is not None:
                yield Finding("fault", "latched", device.fault.value)
    except InputError as error:
        yield Finding("device", "does not answer", str(error))


def _line(device: "Device") -> Iterator[Finding]:
    from controller.host.rates import WHOLE, carried, remedy

    share = carried(device)
    yield Finding(
        "line",
        f"{100 * share:.0f} % of the records of every tick",
        "" if share >= WHOLE else remedy(device.hello.dt_s, share),
    )
    clock = device.session.clock
    if clock is not None:
        yield Finding("clock", f"known to {1e3 * clock.error_s:.1f} ms")
