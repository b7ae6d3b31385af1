"""Twelve taps on a device on a desk, through the commands that a user types.

    python -m pytest -m long -n 0 tests/campaigns/test_desk.py --campaign="[LIBRARY] [--out DIR] [--json FILE]"

The device has equations of its own (`common.own_device`): an encoder of 10 um whose counts are 1234 at the surface,
no grip sensor, gravity along the accelerometer, another delay of the amplifier than the library's. Its device file
says so. Then `transopt-play check`, a quiet tap and twelve taps, three at each of four speeds, by `transopt-play
tap`; a scripted person holds the stylus at 3 N and does what is asked. All of it runs in virtual time behind the
compiled core. It fails if the latency is above 20 us rms, or a tap's error more than 3 points above the library's
floor.
"""

import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Option

from controller.cli import play
from controller.cli import port as port_commands
from controller.device.device_file import Accelerometer, DeviceFile, Encoder, Grip
from controller.device.reading import write_device
from controller.host.connection import Connection
from controller.host.driver import Device
from controller.servo.interface import Output, State
from controller.sim.port import SimulatedPort
from controller.waveforms.prediction import predict
from tests.benches.own_device import OwnWorld, Sensing
from tests.benches.probed import ProbedDevice
from tests.campaigns.harness import JsonFile, LibraryFile, Seed, library_of, long_form, show, write_json
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.cli import main as transopt_command
from transopt.library.library import Library

DT_S = 1e-4
TYPING_S = 1.5
COUNT_M, SURFACE, GRIP_N = 10e-6, 1234, 3.0
SPEEDS_M_S, EACH = (0.1, 0.2, 0.3, 0.38), 3
ROW = re.compile(r"│ +\d+ │ +([\d.]+) │ +([\d.]+) │ +(-?[\d.]+) │ +([\d.]+) │")
MOST_LATENCY_S, MOST_OVER = 20e-6, 0.03
DESK = DeviceFile(
    name="on a desk",
    encoder=Encoder(count_m=COUNT_M, surface_counts=SURFACE),
    grip=Grip(sensor=False, assumed_grip_N=GRIP_N),
    accelerometer=Accelerometer(rest_m_s2=STANDARD_GRAVITY_M_S2),
)


class Tapping(OwnWorld):
    """Taps in turn while the device is armed, each when the one before it is over."""

    def __init__(self, seed: int) -> None:
        sensing = Sensing(count_m=COUNT_M, surface_counts=SURFACE, grip_sensor=False)
        super().__init__(DT_S, sensing=sensing, grip_N=GRIP_N, seed=seed)
        self.planned: Iterator[float] = iter(())
        self.free_s = 0.0

    def advance(self, output: Output) -> None:
        if output.state is State.ARMED and self.now_s >= self.free_s:
            speed = next(self.planned, None)
            if speed is not None:
                self.person.tap(speed)
                self.free_s = self.now_s + 2.0
        super().advance(output)


class Desk(SimulatedPort):
    """The port that the commands find."""

    name, harmless = "desk", False

    def connect(self, port: str | Connection) -> Device:
        # Between two commands a person types, and the stylus comes to rest.
        for _ in range(round(TYPING_S / DT_S)):
            self.step()
        return Device(self)


@contextmanager
def at_the_desk(world: OwnWorld, connect: Callable[[str | Connection], Device]) -> Iterator[None]:
    """The commands find what `connect` opens behind any port, and the world's person at the terminal."""
    before = port_commands.open_device, port_commands.ConsolePerson
    port_commands.open_device, port_commands.ConsolePerson = connect, lambda: world  # type: ignore
    try:
        yield
    finally:
        port_commands.open_device, port_commands.ConsolePerson = before  # type: ignore[misc]


def typed(*words: object) -> None:
    """A command line; its first word is `transopt` or `transopt-play`.

    Raises
    ------
    InputError : it ended with another exit code than 0.
    """
    line = [str(word) for word in words]
    before, sys.argv = sys.argv, line
    code: object = 0
    try:
        {"transopt": transopt_command.main, "transopt-play": play.main}[line[0]]()
    except SystemExit as end:
        code = end.code
    finally:
        sys.argv = before
    if code:
        raise InputError(f"{' '.join(line)}: exit code {code}")


@dataclass(frozen=True)
class Tap:
    """Tap as `transopt-play tap` printed it; latency [s], tap error and what the library says of it as parts."""

    speed_m_s: float
    grip_N: float
    latency_s: float
    tap_error: float
    predicted: float


def run_desk(library: Library, folder: Path, seed: int) -> list[Tap]:
    """Describe the device, check it, tap quietly, then in full; telemetry lies in `folder`/taps."""
    said, path = StringIO(), folder / "library.npz"
    library.save(path)
    with redirect_stdout(said):
        _run(path, folder, seed)
    text = said.getvalue()
    print(text, end="")
    return taps_in(text, library)


def taps_in(text: str, library: Library) -> list[Tap]:
    """Taps of the last table that a command has printed: those in full."""
    rows = [ROW.match(line) for line in text[text.rindex(" gain 1") :].splitlines()]
    taps = []
    for row in filter(None, rows):
        speed, grip, latency_us, error = map(float, row.groups())
        taps.append(Tap(speed, grip, 1e-6 * latency_us, error / 100, predicted_error(library, speed, grip)))
    return taps


def _run(library: Path, folder: Path, seed: int) -> None:
    device, world = folder / "device.toml", Tapping(seed)
    write_device(device, DESK)
    where = ("--port", "desk", "--device", device)
    tap = ("transopt-play", "tap", library, *where, "--taps")
    with at_the_desk(world, Desk(ProbedDevice(1, simulated=False), world, DT_S).connect):
        typed("transopt-play", "check", library, *where, "--patience", 3)
        world.planned, world.free_s = iter((0.2,)), 0.0
        typed(*tap, 1, "--gain", 0.1)
        world.planned, world.free_s = iter(SPEEDS_M_S * EACH), 0.0
        typed(*tap, len(SPEEDS_M_S) * EACH, "--out", folder / "taps")


def predicted_error(library: Library, speed_m_s: float, grip_N: float) -> float:
    """Tap error that the library says a tap has."""
    said = predict(library, speed_m_s, grip_N)
    target = library.wanted(said.speed_m_s, said.grip_N).target
    return library.yardstick.tap_error(target, said.acceleration_m_s2)


def judged(library: Library, folder: Path, seed: int, json: Path | None) -> int:
    """Taps and verdict."""
    taps = run_desk(library, folder, seed)
    rows = [
        (
            f"{t.speed_m_s:.3f}",
            f"{t.grip_N:.2f}",
            f"{1e6 * t.latency_s:.1f}",
            f"{100 * t.tap_error:.2f}",
            f"{100 * t.predicted:.2f}",
        )
        for t in taps
    ]
    show(("m/s", "N", "latency us", "tap error %", "predicted %"), rows)
    latency_s = float(np.sqrt(np.mean([t.latency_s**2 for t in taps]))) if taps else float("nan")
    over = max((t.tap_error - t.predicted for t in taps), default=float("nan"))
    good = len(taps) == len(SPEEDS_M_S) * EACH and latency_s <= MOST_LATENCY_S and over <= MOST_OVER
    print(
        f"{len(taps)} of {len(SPEEDS_M_S) * EACH} taps; latency {1e6 * latency_s:.1f} us rms (at most "
        f"{1e6 * MOST_LATENCY_S:g}), tap error at most {100 * over:.2f} points above the predicted one (at most "
        f"{100 * MOST_OVER:g}): {'good' if good else 'FELL SHORT'}"
    )
    write_json({"latency_rms_s": latency_s, "taps": [asdict(t) for t in taps]}, json)
    return 0 if good else 1


def main(
    library: LibraryFile = None,
    out: Annotated[Path | None, Option(help="keep device file and telemetry here")] = None,
    seed: Seed = 0,
    json: JsonFile = None,
) -> int:
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        return judged(library_of(library), out, seed, json)
    with tempfile.TemporaryDirectory() as folder:
        return judged(library_of(library), Path(folder), seed, json)


test_long_form = long_form(main)
