"""`transopt-play record sweep` on a device: what is written, and what is not."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from controller.cli import port as port_commands
from controller.firmware.build import NoCompilerError
from controller.host.driver import Device
from controller.host.payload import trial_sweep
from controller.protocol.capacity import Hardware
from controller.protocol.codes import STATES, Kind
from controller.protocol.events import News, Samples
from controller.record.excitation import sweep_command
from controller.servo.interface import State
from controller.sim.compiled_device import CompiledDevice
from controller.sim.sensors import SEED_SENSORS
from controller.sim.true_device import DEFAULT_DEVICE
from controller.sim.user import StillHand
from tests.benches.commands import Run, assert_refused
from tests.benches.compiled import plant_of
from tests.benches.desk import DT_S, PORT, Desk
from tests.benches.virtual_link import Trouble
from tests.controller.cli.test_device import interrupt
from transopt.identify.measurement import load_measurement
from transopt.library.library import Library
from transopt.plant.chain import Link, chain

CHECK = ("check", "--sweep", *PORT, "--skip", "encoder", "--skip", "emergency-stop", "--skip", "grip-zero")
SHORT = ("record", "sweep", *PORT, "--out", "rec", "--low", 20, "--high", 800, "--seconds", 0.2)
SAMPLES = 2000


@pytest.fixture
def checked(desk: Desk) -> Desk:
    """Held, and past the check."""
    desk.asked("hold")
    with desk.connect() as device:
        given = trial_sweep(device.hello, None)
    desk.pass_check(given.configuration)
    return desk


def files() -> list[str]:
    return sorted(path.name for path in Path("rec").iterdir())


def read(name: str) -> dict[str, np.ndarray]:  # type: ignore[type-arg]
    with np.load(Path("rec") / name, allow_pickle=False) as file:
        return {key: file[key] for key in file.files}


def test_check_then_trials_of_both_signs_at_the_grip_asked_for(play: Run, desk: Desk) -> None:
    desk.asked("hold")
    outcome = play(*CHECK)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "trial-sweep: passed: played to its end" in outcome.out
    checked = desk
    first = play(*SHORT, "--trials", 2, "--grips", 3, "--gain", 0.1)
    assert first.code == 0, first.out + first.err
    assert checked.requests[-1] == "hold the stylus still, at 3 N"
    Path("slow.toml").write_text("[accelerometer]\nbandwidth_Hz = 1600\n")
    second = play(*SHORT, "--trials", 2, "--grips", 3, "--device", "slow.toml")
    assert second.code == 0, second.out + second.err
    assert "rec: 2 of 2 trials, all whole" in second.out
    assert checked.end.state is State.IDLE
    assert files() == [f"sweep_00{j}.npz" for j in (1, 2, 3, 4)]
    wanted = sweep_command(20, 800, 0.2, 0.75, DT_S)
    for name, factor in zip(files(), (0.1, -0.1, 1.0, -1.0), strict=True):
        trial = read(name)
        names = "time_s command_A current_A acceleration_m_s2 position_m grip_N accelerometer_Hz"
        assert set(trial) == set(names.split())
        time, command = trial["time_s"], trial["command_A"]
        assert np.all(np.abs(np.diff(time) - DT_S) < 1e-12)
        assert (time[0], time[-1]) == (pytest.approx(-0.05), pytest.approx(0.2 + 0.1))
        playing = (time > -DT_S / 2) & (time < 0.2 - DT_S / 2)
        # Counts of 0.75 A / 32767, and the float32 of the telemetry.
        np.testing.assert_allclose(command[playing], factor * wanted, rtol=0, atol=2e-5)
        assert not np.any(command[~playing])
        assert trial["grip_N"] == pytest.approx(3.0, abs=0.2)
        # The sensors answer: current follows, the stylus moves.
        late = np.corrcoef(trial["current_A"][1:], command[:-1])[0, 1]
        assert late > 0.8
        assert np.ptp(trial["position_m"]) >= (24.5e-6 if abs(factor) == 1 else 0.0)
    # What identification reads of it.
    measurement = load_measurement(Path("rec/sweep_004.npz"))
    assert measurement.command is not None
    assert measurement.acceleration is not None
    assert (measurement.command.start_s, measurement.command.dt_s) == pytest.approx((-0.05, DT_S))
    assert (measurement.grip_N, measurement.accelerometer_Hz) == (trial["grip_N"], 1600)
    assert measurement.off_grid < 1e-6
    np.testing.assert_allclose(measurement.command.values, command, rtol=0, atol=1e-12)
    full, negative = read("sweep_003.npz"), read("sweep_004.npz")
    assert full["accelerometer_Hz"] == 1600
    moved = [np.abs(one["acceleration_m_s2"] - one["acceleration_m_s2"].mean()).max() for one in (full, negative)]
    assert min(moved) > 10.0


def test_another_device_may_be_checked_in_between(
    play: Run, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two devices that have started equally often, with motors of their own."""
    first, second = (Desk(library, simulated=False) for _ in range(2))
    second.motor = 1.05
    for desk in (first, second):
        desk.put(monkeypatch).asked("hold")
        outcome = play(*CHECK)
        assert outcome.code == 0, outcome.out + outcome.err
    first.put(monkeypatch)
    outcome = play(*SHORT, "--trials", 1)
    assert outcome.code == 0, outcome.out + outcome.err


def test_the_device_is_armed_no_longer_than_it_plays(play: Run, checked: Desk) -> None:
    armed = 0

    def look() -> None:
        nonlocal armed
        armed += checked.end.state is not State.IDLE

    checked.each_ms = look
    assert play(*SHORT, "--trials", 2).code == 0
    # The rest before, the sweep, what rings after, and the way there and back.
    assert armed < 2 * (50 + 200 + 100 + 60)
    assert checked.link.to_device.kinds[Kind.START] == 2


def test_not_before_the_check_of_these_limits(
    play: Run, library: Library, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.asked("hold")
    outcome = play(*SHORT, "--library", "library.npz", "--trials", 1)
    assert outcome.code == 0, outcome.out + outcome.err  # its port vouches that nothing is wired
    before = files()
    Desk(library, simulated=False).put(monkeypatch)
    assert_refused(
        play(*SHORT, "--out", "other"),
        "have not passed the bring-up check",
        "run `transopt-play check --sweep --port desk`",
    )
    assert files() == before


def test_what_the_device_cannot_hold_or_the_limits_forbid(
    play: Run, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    Desk(library, samples=1440).put(monkeypatch)
    assert_refused(play(*SHORT), "sweep: 0.2 s at 10 kHz are 2000 samples, the device holds 1440", "--seconds 0.144")
    Desk(library).put(monkeypatch)
    for options, words in (
        (("--seconds", 3), "the device holds 20000: --seconds 2 would fit"),
        (("--amplitude", 2), "the current reaches 2 A, the limit is 1.25 A"),
        (("--amplitude", 1, "--offset", -0.5), "lower --amplitude, --offset or --tap-current"),
        (("--tap-current", 3), "the current reaches"),
        (("--high", 6000), "below half the servo's rate, 5000 Hz"),
        (("--low", 1), "must be 1 s or more, one period of low 1 Hz"),
        (("--grips", 0.2), "--grips 0.2: must be 0.5 to 50 N, or 0 to let go"),
        (("--gain", 2), "--gain 2"),
        (("--trials", 0), "--trials 0"),
    ):
        assert_refused(play(*SHORT, *options), words)
    Desk(library, hardware=Hardware(current_A=0.5)).put(monkeypatch)
    assert_refused(play(*SHORT), "the limit is 0.5 A")
    assert not files()


def test_the_free_device_is_asked_for_and_written_as_such(play: Run, checked: Desk) -> None:
    outcome = play(*SHORT, "--trials", 1, "--grips", 0)
    assert outcome.code == 0, outcome.out + outcome.err
    assert checked.requests[-1].startswith("let go of the stylus")
    assert read("sweep_001.npz")["grip_N"] == 0.0


def test_another_grip_than_asked_is_no_trial(play: Run, checked: Desk) -> None:
    refused = play(*SHORT, "--grips", 5, "--patience", 1)
    assert refused.code == 1
    seen = re.search(r"not as asked within 1 s: ([\d.]+) N", refused.out)
    assert seen is not None, refused.out
    assert float(seen[1]) == pytest.approx(3.0, abs=0.06)
    assert "0 of 4 trials" in refused.out

    def slip() -> None:
        checked.hand.held_N = 2.0 if checked.end.state is State.PLAYING else 3.0

    checked.each_ms = slip
    refused = play(*SHORT, "--grips", 3)
    assert refused.code == 1
    assert refused.out.count("not whole, once more: the grip was 2.") == 3
    assert "3 attempts at a trial, none whole: the grip was" in refused.out
    assert not files()


def test_lost_telemetry_is_repeated_then_refused_by_name(play: Run, checked: Desk) -> None:
    """The line swallows a frame while the first attempt plays; later it swallows frames for good."""
    state = {"seen": 0}

    def once() -> None:
        playing = checked.end.state is State.PLAYING
        state["seen"] += playing
        checked.link.to_host.trouble = Trouble(loss=1.0 if playing and state["seen"] in range(50, 60) else 0.0)

    checked.each_ms = once
    outcome = play(*SHORT, "--trials", 1)
    assert outcome.code == 0, outcome.out + outcome.err
    assert outcome.out.count("not whole, once more:") == 1
    assert "of 3501 records of telemetry were lost; every tick takes 340 kB/s" in outcome.out
    assert read("sweep_001.npz")["time_s"].size == 3501

    def always() -> None:
        state["seen"] += 1
        playing = checked.end.state is State.PLAYING
        checked.link.to_host.trouble = Trouble(loss=1.0 if playing and state["seen"] % 20 == 0 else 0.0)

    checked.each_ms = always
    refused = play(*SHORT, "--trials", 1)
    assert refused.code == 1
    assert "3 attempts at a trial, none whole" in refused.out
    assert files() == ["sweep_001.npz"]


@pytest.mark.parametrize("how", ["unplugged", "let go", "dead sensor"])
def test_what_ends_a_trial_leaves_the_ones_before_whole_and_nothing_of_it(play: Run, checked: Desk, how: str) -> None:
    started = {"trials": 0, "ms": 0}

    def look() -> None:
        playing = checked.end.state is State.PLAYING
        started["ms"] = started["ms"] + 1 if playing else 0
        started["trials"] += started["ms"] == 1
        if started["trials"] == 2 and started["ms"] == 100:
            if how == "unplugged":
                checked.gone = True
            elif how == "let go":
                checked.hand.held_N = 0.0
            else:
                checked.wrong = lambda readings: readings._replace(current_A=float("nan"))

    checked.each_ms = look
    outcome = play(*SHORT, "--trials", 3, "--grips", 3)
    if how == "unplugged":
        assert_refused(outcome, "it does not arm by itself", "rec: 1 of 3 trials, all whole")
    else:
        assert outcome.code == 1, outcome.out + outcome.err
        words = {
            "let go": "the stylus was let go while a transient played",
            "dead sensor": "a sensor gave no number",
        }[how]
        assert words in outcome.out
        assert "1 of 3 trials, all whole" in outcome.out
    assert files() == ["sweep_001.npz"]
    assert read("sweep_001.npz")["time_s"].size == 3501
    checked.gone = False


def test_a_coil_that_has_become_too_warm_is_let_cool_and_no_fault(play: Run, checked: Desk) -> None:
    def look() -> None:
        if checked.end.state is State.ARMED:
            checked.end.heat(95.0 - 1e-6, 25.0)

    checked.each_ms = look
    outcome = play(*SHORT)
    assert outcome.code == 1
    assert "start refused: the coil is too hot to play: let it cool (device saw 95 C)" in outcome.out
    assert (checked.end.state, checked.end.look().fault) == (State.IDLE, None)
    assert not files()


def test_ctrl_c_disarms(play: Run, checked: Desk) -> None:
    count = iter(range(10_000))
    checked.each_ms = lambda: interrupt() if next(count) == 500 else None
    outcome = play(*SHORT)
    assert outcome.code == 130, outcome.out + outcome.err
    assert "stopped; the device is disarmed" in outcome.err
    assert checked.end.state is State.IDLE
    assert checked.end.look().fault is None
    assert not [name for name in files() if not name.startswith("sweep_")]


def test_files_are_never_written_over(play: Run, checked: Desk) -> None:
    Path("rec").mkdir()
    (Path("rec") / "sweep_007.npz").write_bytes(b"mine")
    assert play(*SHORT, "--trials", 1).code == 0
    assert files() == ["sweep_007.npz", "sweep_008.npz"]
    assert (Path("rec") / "sweep_007.npz").read_bytes() == b"mine"
    (Path("blocked")).write_text("")
    assert_refused(play(*SHORT[:4], "--out", "blocked"), "--out blocked: cannot be written")


def test_heat_is_not_measured_by_any_device(play: Run, desk: Desk) -> None:
    outcome = play("record", "heat", *PORT)
    assert_refused(outcome, "neither the coil's voltage nor its temperature", "time_s, current_A, voltage_V")


# In real time, over a pseudo-terminal, with the compiled device.


@pytest.fixture
def served(patient: None) -> Iterator[CompiledDevice]:
    try:
        compiled = CompiledDevice(plant_of(StillHand(), StillHand.period_s))
    except NoCompilerError as missing:
        pytest.skip(str(missing))
    with compiled, Device(compiled.name) as device:
        given = trial_sweep(device.hello, None)
        device.configure(given.configuration)
        device.close()
        yield compiled


def test_what_is_recorded_over_a_port_is_the_device(play: Run, served: CompiledDevice) -> None:
    """The files alone give the device's transfer function: signs, units and instants are right."""
    options = ("--out", "rec", "--low", 10, "--high", 1500, "--seconds", 0.5, "--trials", 2, "--grips", 3)
    outcome = play("record", "sweep", "--port", served.name, *options, "--gain", 1)
    assert outcome.code == 0, outcome.out + outcome.err
    currents, accelerations = 0j, 0j
    for name, sign in zip(files(), (1, -1), strict=True):
        trial = read(name)
        currents = currents + sign * np.fft.rfft(trial["current_A"])
        swing = trial["acceleration_m_s2"] - trial["acceleration_m_s2"][:400].mean()
        accelerations = accelerations + sign * np.fft.rfft(swing)
    frequency = np.fft.rfftfreq(read("sweep_001.npz")["time_s"].size, DT_S)
    inner = (frequency > 20) & (frequency < 800)
    seen = (accelerations / currents)[inner] * (1 + 1j * frequency[inner] / SEED_SENSORS.accelerometer_bandwidth_Hz)
    masses, stiffness, damping = DEFAULT_DEVICE.at(3.0)
    links, force = map(Link, stiffness, damping), DEFAULT_DEVICE.force_per_current_N_A
    plant = chain(masses.tolist(), list(links), force_per_current_N_A=force, stylus=DEFAULT_DEVICE.stylus)
    ratio = seen / plant.response(frequency[inner])
    assert np.median(np.abs(20 * np.log10(np.abs(ratio)))) < 0.5
    assert np.median(np.abs(np.angle(ratio, deg=True))) < 3.0


def test_a_device_that_dies_half_way_leaves_nothing_half(
    play: Run, served: CompiledDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    playing = 0

    def killing(news: News) -> None:
        nonlocal playing
        # A trial whose records a busy machine loses is played again, so the first file tells when one is over.
        if isinstance(news, Samples) and files():
            playing += sum(STATES[record.state] is State.PLAYING for record in news.records)
            if playing > 0.5 * 5000:
                served.process.kill()

    def opened(port: str) -> Device:
        device = Device(port)
        device.listeners.append(killing)
        return device

    monkeypatch.setattr(port_commands, "open_device", opened)
    options = ("--out", "rec", "--low", 10, "--high", 1500, "--seconds", 0.5, "--trials", 3)
    assert_refused(play("record", "sweep", "--port", served.name, *options), "it does not arm by itself")
    assert files() == ["sweep_001.npz"]
    assert read("sweep_001.npz")["time_s"].size == 5000 + 1501
