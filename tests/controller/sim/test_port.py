"""The port `sim:`: the same session, recorder and comparison as on a wire, in virtual time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.cli.bench import simulated_bench
from controller.cli.tap_figure import tap_figure
from controller.device.device_file import BUILT_IN
from controller.host.connection import Connection
from controller.host.driver import Device
from controller.host.payload import payload_of
from controller.record.played import PlayedTap, played_tap
from controller.record.recorder import Contact, Recorder
from controller.servo.interface import Notice, State
from controller.servo.settings import Settings
from controller.sim.played_tap import play_tap
from controller.sim.port import SimulatedPort, core_end
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections
from controller.sim.true_device import device_of
from controller.waveforms.bank import bank
from tests.benches.commands import Run, assert_refused
from tests.benches.oracle.servo import Servo
from tests.benches.telemetry_file import read_csv
from transopt.base.errors import InputError
from transopt.base.plotting import save_figure
from transopt.library.library import Library

pytestmark = pytest.mark.usefixtures("c_compiler")


def contacts(library: Library, *taps: SimulatedTap) -> tuple[list[Contact], Device]:
    """What is recorded of taps one after the other, and the device afterwards."""
    given = payload_of(library)
    bench, hand = simulated_bench(given, device_of(library.scene()), taps)
    assert not isinstance(bench.port, str)
    recorder = Recorder(None, given.settings.dt_s, given.settings.count_m)
    with Device(bench.port) as device:
        device.configure(given.configuration)
        device.upload(given.image)
        device.listeners.append(recorder.take)
        device.set_telemetry(1)
        device.arm(1.0)
        while not hand.done:
            device.listen(0.05)
        device.disarm()
    return recorder.contacts, device


def compared(library: Library, contact: Contact) -> PlayedTap:
    return played_tap(contact, library, Settings.of(library), 1.0, BUILT_IN.accelerometer)


def test_a_tap_is_that_of_servo_and_simulator_alone(library: Library) -> None:
    """The core, the wire and the sensors take nothing away but what int16 waveforms and float32 telemetry do."""
    tap = SimulatedTap(0.3, 3.0, imperfections=Imperfections(), seed=2)
    [contact], _ = contacts(library, tap)
    truth = play_tap(library, Servo(Settings.of(library), bank(library)), tap)
    begun = next(event for event in truth.events if event.what is Notice.CONTACT)
    assert contact.speed_m_s == pytest.approx(begun.speed_m_s, rel=1e-6)
    here, there = contact.ticks == contact.tick, begun.tick
    at = int(np.argmax(here))
    played = slice(at, at + 600), slice(there, there + 600)
    np.testing.assert_allclose(contact.command_A[played[0]], truth.command_A[played[1]], atol=1e-3)
    found = compared(library, contact).compared
    assert found.latency_s == pytest.approx(truth.latency_s, abs=5e-6)
    assert found.playback_error == pytest.approx(truth.playback_error, abs=5e-3)


def test_the_same_seed_gives_the_same_tap(library: Library) -> None:
    one, again, other = (contacts(library, SimulatedTap(0.2, 2.0, seed=seed))[0][0] for seed in (5, 5, 6))
    for name in ("ticks", "counts", "acceleration_m_s2", "current_A", "command_A", "winding_C"):
        np.testing.assert_array_equal(getattr(one, name), getattr(again, name))
    assert np.any(one.acceleration_m_s2 != other.acceleration_m_s2)


def test_taps_one_after_the_other_on_an_armed_device(library: Library) -> None:
    taps = [SimulatedTap(speed, grip, seed=j) for j, (speed, grip) in enumerate([(0.4, 5.0), (0.1, 1.0), (0.3, 3.0)])]
    found, device = contacts(library, *taps)
    assert [contact.speed_m_s for contact in found] == pytest.approx([0.4, 0.1, 0.3], rel=0.01)
    assert [contact.grip_N for contact in found] == pytest.approx([5.0, 1.0, 3.0], abs=0.1)
    assert [contact.missed for contact in found] == [0, 0, 0]
    assert all(compared(library, contact).compared.playback_error < 0.03 for contact in found)
    assert device.state is State.IDLE


def test_it_is_a_connection_and_time_passes_only_in_reads(library: Library) -> None:
    bench, _ = simulated_bench(payload_of(library), device_of(library.scene()), ())
    port = bench.port
    assert isinstance(port, SimulatedPort)
    connection: Connection = port
    connection.write(b"\x00")
    assert connection.now_s() == 0.0
    assert connection.read(0.01) == b""
    assert connection.now_s() == pytest.approx(0.01)


def test_the_figure_with_and_without_motor_data(library: Library, tmp_path: Path) -> None:
    [contact], _ = contacts(library, SimulatedTap(0.2, 3.0))
    played = compared(library, contact)
    unknown = replace(played, contact=replace(contact, winding_C=np.full_like(contact.winding_C, np.nan)))
    for name, tap in (("a.png", played), ("b.png", unknown)):
        save_figure(tap_figure(tap, "a tap", walled=False), tmp_path / name)
        assert (tmp_path / name).stat().st_size > 20_000


@pytest.mark.parametrize(
    "name", ["out/library_of_mine_" * 8, "out/$a_$/a library of mine " * 8], ids=["one word", "words"]
)
def test_the_title_of_the_figure_is_whole_however_long_the_files_name(library: Library, name: str) -> None:
    [contact], _ = contacts(library, SimulatedTap(0.2, 3.0))
    figure = tap_figure(compared(library, contact), name, walled=False)
    figure.draw_without_rendering()
    title, panel = figure.texts[0].get_window_extent(), figure.axes[0].get_window_extent()
    assert title.x0 >= 0
    assert title.x1 <= figure.bbox.x1
    assert panel.y1 <= title.y0
    assert title.y1 <= figure.bbox.y1


def test_simulate_is_short_for_the_port(play: Run) -> None:
    tap = ("tap", "library.npz", "--speed", 0.2, "--seed", 3)
    outcomes = [play(*tap, *how, "--out", name) for how, name in ((("--simulate",), "a"), (("--port", "sim:"), "b"))]
    assert [outcome.code for outcome in outcomes] == [0, 0]
    assert outcomes[0].out == outcomes[1].out.replace("b: ", "a: ")
    one, other = (read_csv(Path(name) / "telemetry.csv") for name in ("a", "b"))
    np.testing.assert_array_equal(one["measured_acceleration_m_s2"], other["measured_acceleration_m_s2"])
    assert "contact" in one["events"].tolist()
    with np.load("a/telemetry.npz") as stored:
        np.testing.assert_array_equal(stored["command_A"], one["command_A"])
    # It can be made again, unlike the recording of a real device.
    assert play(*tap, "--simulate", "--out", "a").code == 0


def test_a_paced_run_says_how_far_it_fell_behind(play: Run) -> None:
    outcome = play("tap", "library.npz", "--simulate", "--real-time", "--speed", 0.4)
    assert outcome.code == 0
    assert "fell behind the clock by " in outcome.out


def test_without_a_compiler_it_says_what_to_install(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(
        InputError, match=r"^--simulate runs .*needs the wheel or a compiler: CC = no-such-compiler.*too small"
    ):
        core_end(Settings.of(library), 300_000)  # of which no core is loaded


@pytest.mark.parametrize("command", [("upload", "library.npz"), ("monitor",), ("check",)])
def test_commands_that_outlast_one_process_name_the_server(play: Run, command: tuple[str, ...]) -> None:
    assert_refused(play(*command, "--port", "sim:"), "--port sim: ends with its command", "transopt-device")
