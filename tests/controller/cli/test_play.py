"""`transopt-play tap --simulate` as a user meets it; a library that is new to a device, tapped once at a tenth."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from controller.cli.port import _try_out
from controller.device.device_file import Accelerometer, DeviceFile
from controller.host.driver import Device, DeviceError
from controller.host.payload import payload_of
from controller.protocol.image import bank_of, image_of
from controller.servo.interface import Output, State
from controller.sim.port import SimulatedPort
from tests.benches.commands import Run
from tests.benches.own_device import OwnWorld
from tests.benches.places import ROOT
from tests.benches.probed import ProbedDevice
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.library.library import Library
from transopt.scene.recordings import Recordings


def test_tap_with_figure_and_telemetry(play: Run) -> None:
    outcome = play("tap", "library.npz", "--simulate", "--speed", 0.3, "--grip", 3, "--out", "run")
    assert (outcome.code, outcome.err) == (0, "")
    for word in (
        "latency",
        "tap error",
        "playback error",
        "peak",
        "spectral error",
        "rate-hardness",
        "winding",
        "clamps",
        "verdict",
    ):
        assert word in outcome.out
    assert {path.name for path in Path("run").iterdir()} == {
        "tap.png",
        "telemetry.csv",
        "telemetry.npz",
        "events.csv",
        "tap_001.csv",
    }


def sentences(out: str) -> str:
    """What tables print, in one line: their cells wrap as the terminal is wide."""
    return " ".join(out.replace("│", " ").split())


def test_a_tap_outside_the_grid_has_its_reason_and_no_empty_figures(play: Run) -> None:
    outcome = play("tap", "library.npz", "--simulate", "--speed", 0.9)
    assert (outcome.code, outcome.err) == (0, "")
    assert "lies outside the library's 0.1 to 0.4 m/s" in sentences(outcome.out)
    for what in ("peak current", "winding", "verdict"):
        assert what in outcome.out
    for figure in ("latency", "tap error", "playback", "predicted", "rate-hardness"):
        assert figure not in outcome.out
    assert not re.search(r"[│ ]-  *│", outcome.out)


def test_rate_hardness_of_recorded_taps_says_why_there_is_no_other(play: Run, library: Library) -> None:
    scene = library.scene()
    stated = {**scene.model_dump()["recordings"], "simulated": None, "files": ["tap.csv"]}
    recorded = scene.model_copy(update={"recordings": Recordings(**stated)})
    replace(library, meta={**library.meta, "scene": recorded.model_dump(mode="json")}).save(Path("recorded.npz"))
    outcome = play("tap", "recorded.npz", "--simulate", "--speed", 0.3, "--grip", 3)
    assert (outcome.code, outcome.err) == (0, "")
    assert "the real object, struck: unknown, as no recorded tap tells the force" in sentences(outcome.out)


def test_another_users_tap(play: Run) -> None:
    outcome = play("tap", "library.npz", "--simulate", "--speed", 0.3, "--grip", 3, "--user", "stops")
    assert (outcome.code, outcome.err) == (0, "")
    assert "stops user" in outcome.out


def test_nothing_played_is_a_result_that_fell_short(play: Run) -> None:
    outcome = play("tap", "library.npz", "--simulate", "--grip", 0.1)
    assert outcome.code == 1
    assert "no transient played" in outcome.out


def test_a_simulated_tap_never_loads_the_optimiser(library: Library, tmp_path: Path) -> None:
    library.save(tmp_path / "library.npz")
    program = (
        "import sys; from pathlib import Path; import controller.cli.play\n"
        "assert not {'numpy', 'scipy', 'casadi', 'matplotlib'} & set(sys.modules), 'help must come at once'\n"
        "sys.argv = ['transopt-play', 'tap', sys.argv[1], '--simulate']\n"
        "try:\n    controller.cli.play.main()\nexcept SystemExit as stop:\n    assert not stop.code\n"
        "assert not {'casadi', 'matplotlib', 'serial', 'scipy.signal', 'scipy.stats'} & set(sys.modules)"
    )
    path = str(tmp_path / "library.npz")
    subprocess.run([sys.executable, "-c", program, path], check=True, cwd=ROOT, timeout=60)


LEVEL = DeviceFile(name="trial", accelerometer=Accelerometer(rest_m_s2=STANDARD_GRAVITY_M_S2))


class Tapped(OwnWorld):
    """A person who taps once the device is armed."""

    tapped = False

    def advance(self, output: Output) -> None:
        if output.state is State.ARMED and not self.tapped:
            self.tapped = True
            self.person.tap(0.3)
        super().advance(output)


class Port(SimulatedPort):
    """One of a device that can do harm."""

    name, harmless = "own device", False


def test_a_new_library_is_tapped_once_at_a_tenth(library: Library, c_compiler: None) -> None:
    given, world = payload_of(library, device=LEVEL), Tapped()
    settings = given.settings
    table, head = bank_of(given.image)
    weaker = replace(table, command_A=0.9 * table.command_A)
    other = image_of(weaker, settings.dt_s, settings.lead_s, head["tail_samples"], amplifier=settings.amplifier)
    with Device(Port(ProbedDevice(1, simulated=False), world, settings.dt_s)) as device:
        device.configure(given.configuration)
        device.upload(given.image)
        assert not device.lacks_trial()  # without sound pulses a trial is not what is missing
        device.pulse(settings.pulse_A, settings.pulse_ticks, 2)
        device.listen(2.5)
        assert device.lacks_trial()
        with pytest.raises(DeviceError, match="no finished trial of this library"):
            device.arm(1.0)
        _try_out(device, Console(quiet=True), 3.0)
        assert world.tapped
        assert not device.lacks_trial()
        device.upload(other)
        assert device.lacks_trial()
