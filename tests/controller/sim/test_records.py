"""Records for identification: the same truth as the stepping simulator's, read back by the designer's reader."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.record.sweep_plan import FREE_LOW_HZ, Purpose, check_plan, sweep_plan
from controller.servo.servo import Servo
from controller.servo.settings import Settings
from controller.sim.open_loop import play_still, true_device
from controller.sim.records import heat_record, noise_seed, object_record, sweep_records, true_coil
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import Ground, TrueDevice, device_of
from controller.sim.user import StillHand
from scripts.common.experiment import play_tap
from tests.benches.commands import Run, assert_refused
from tests.benches.desk import PORT, Desk
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.identify.measurement import load_measurement
from transopt.library.library import Library
from transopt.plant.coil import effective_square
from transopt.recordings.recording import load_recording
from transopt.scene.scene import Scene

DT = 1e-4
WRONG = Imperfections(mismatch=0.2, crossover_A=0.01)


@pytest.fixture(scope="module")
def device(scene: Scene) -> TrueDevice:
    return true_device(device_of(scene), WRONG, 4)


def stepped(device: TrueDevice, grip_N: float, command_A: FloatArray, seed: int) -> FloatArray:
    """(N, 4) readings of the simulator, one period after the other."""
    wrong = replace(WRONG, mismatch=0.0)
    simulator = Simulator(device, StillHand(grip_N), DT, imperfections=wrong, seed=seed)
    rows = []
    for command in command_A.tolist():
        read = simulator.readings()
        rows.append(
            (WRONG.sensors.count_m * read.encoder_counts, read.grip_N, read.current_A, read.acceleration_m_s2)
        )
        simulator.advance(command)
    return np.array(rows)


class TestOpenLoop:
    """The affine map of a servo period is the stepping simulator."""

    @pytest.mark.parametrize("grip_N", [0.0, 0.13, 3.0])
    @pytest.mark.parametrize("delay_s", [None, 0.0, 68e-6, 1e-4, 2.3e-4])
    def test_same_readings_tick_by_tick(self, device: TrueDevice, grip_N: float, delay_s: float | None) -> None:
        # Half the commands lie beyond the amplifier's range or inside its dead band.
        command = np.random.default_rng(1).standard_normal(800) * np.repeat([0.01, 1.0, 8.0, 0.0], 200)
        amplifier = device.amplifier
        assert amplifier is not None
        amplifier = None if delay_s is None else replace(amplifier, delay_s=delay_s)
        varied = replace(device, amplifier=amplifier)
        found = play_still(varied, grip_N, command, DT, imperfections=WRONG, seed=7)
        told = np.stack([found.position_m, found.grip_N, found.current_A, found.acceleration_m_s2], axis=1)
        np.testing.assert_allclose(told, stepped(varied, grip_N, command, 7), rtol=1e-11, atol=1e-10)

    def test_friction_is_not_linear(self, device: TrueDevice) -> None:
        wrong = replace(WRONG, ground=Ground(friction_N=0.1))
        with pytest.raises(ValueError, match="friction"):
            play_still(device, 3.0, np.zeros(20), DT, imperfections=wrong, seed=0)

    def test_mismatch_is_put_on_once(self, scene: Scene, device: TrueDevice) -> None:
        """The device of a seed is that of a tap of the same seed."""
        played = Simulator(device_of(scene), StillHand(3.0), DT, imperfections=WRONG, seed=4)
        assert device == played.device
        assert true_device(device_of(scene), WRONG, 5) != device


class TestPlan:
    def test_presets(self) -> None:
        planned = sweep_plan(Purpose.DEVICE, [0.0, 1.0, 5.0], 4)
        assert [trial.polarity for trial in planned[:4]] == [1, -1, 1, -1]
        assert [trial.low_Hz for trial in planned] == [FREE_LOW_HZ] * 4 + [1.0] * 8
        assert {trial.high_Hz for trial in planned} == {2000.0}
        assert planned[5].file_name == "device_1N_2_neg.npz"
        amplifier = sweep_plan(Purpose.AMPLIFIER, None, 2)
        assert [(trial.grip_N, trial.offset_A) for trial in amplifier] == [(3.0, 0.0)] * 2 + [(3.0, 0.5)] * 2
        assert amplifier[3].file_name == "amplifier_3N_0.5A_2_neg.npz"
        np.testing.assert_array_equal(amplifier[2].command(DT), -amplifier[3].command(DT))
        assert len({trial.file_name for trial in [*planned, *amplifier]}) == 16

    def test_an_offset_keeps_clear_of_the_crossover(self) -> None:
        """Over the middle of the sweep the current never changes its sign."""
        offset = sweep_plan(Purpose.AMPLIFIER, None, 1)[1]
        command = offset.command(DT)
        assert command[command.size // 4 : -command.size // 10].min() > 0.1

    def test_refusals(self) -> None:
        for grips, trials, words in (([], 1, "at least one"), ([3.0, 3.0], 1, "once"), ([-1.0], 1, "0 to 50 N")):
            with pytest.raises(InputError, match=words):
                sweep_plan(Purpose.DEVICE, grips, trials)
        with pytest.raises(InputError, match="--trials 0"):
            sweep_plan(Purpose.DEVICE, None, 0)
        with pytest.raises(InputError, match=r"offset 3.5 A and amplitude 0.75 A together: above the limit of 4 A"):
            check_plan(sweep_plan(Purpose.DEVICE, None, 1, offset_A=3.5), DT, 4.0)


class TestSweeps:
    def test_transfer_function_of_the_truth(self, scene: Scene) -> None:
        """Spectra of a noiseless trial at a grip: acceleration over current is the chain behind the sensor's pole."""
        plain = Imperfections(crossover_A=0.0)
        quiet = replace(plain, sensors=replace(plain.sensors, accelerometer_noise_g_rtHz=0.0, current_noise_A=0.0))
        truth = true_device(device_of(scene), quiet, 0)
        [trial] = sweep_plan(Purpose.DEVICE, [3.0], 1, high_Hz=1000.0, seconds=2.0)
        [(_, record)] = sweep_records(truth, [trial], DT, imperfections=quiet, seed=1)
        columns = record.columns
        spectra = {name: np.fft.rfft(columns[name], 1 << 16) for name in ("current_A", "acceleration_m_s2")}
        frequencies = np.fft.rfftfreq(1 << 16, DT)
        band = (frequencies > 10) & (frequencies < 100)  # where the hold's staircase is a straight line
        found = spectra["acceleration_m_s2"][band] / spectra["current_A"][band]
        pole = 1 / (1 + 1j * frequencies[band] / quiet.sensors.accelerometer_bandwidth_Hz)
        wanted = scene.plant(3.0).response(frequencies[band]) * pole
        assert np.abs(found / wanted - 1).max() < 0.02

    def test_polarity_and_noise(self, device: TrueDevice) -> None:
        pair = sweep_plan(Purpose.DEVICE, [3.0], 2, seconds=1.0, low_Hz=5.0)
        one, other = (record for _, record in sweep_records(device, pair, DT, imperfections=WRONG, seed=1))
        [(_, again)] = sweep_records(device, pair[:1], DT, imperfections=WRONG, seed=1)
        np.testing.assert_array_equal(one.columns["acceleration_m_s2"], again.columns["acceleration_m_s2"])
        total = one.columns["acceleration_m_s2"] + other.columns["acceleration_m_s2"]
        rms = float(np.sqrt(np.mean(total**2)))
        assert rms == pytest.approx(np.sqrt(2) * WRONG.sensors.accelerometer_noise_m_s2, rel=0.05)
        assert one.scalars["grip_N"] == pytest.approx(3.0, abs=0.16)


class TestTaps:
    def test_object(self, scene: Scene) -> None:
        """The recorded force is the only force on chain and hand: it decelerates them at impact."""
        target = scene.recordings.simulated
        assert target is not None
        truth = device_of(scene)
        quiet = Imperfections()
        taken = object_record(truth, target, 0.3, 3.0, DT, imperfections=quiet, seed=noise_seed(3), force_noise_N=0.0)
        force, acceleration = taken.columns["force_N"], taken.columns["acceleration_m_s2"]
        times = taken.columns["time_s"]
        assert force.min() == 0.0
        assert force[times < 0].max() == 0.0
        rising = times[force > 0][0]
        assert 0 < rising <= DT
        assert 60 < acceleration.max() < 120
        assert float(acceleration[times < -DT].std()) < 1.1 * quiet.sensors.accelerometer_noise_m_s2
        slope = np.polyfit(times[times < 0], taken.columns["position_m"][times < 0], 1)[0]
        assert slope == pytest.approx(-0.3, rel=2e-3)
        assert not taken.columns["command_A"].any()

    def test_another_device_than_the_librarys(self, library: Library, device: TrueDevice) -> None:
        """`device` is what is there: the same as the library's own with the tap's mismatch."""
        settings = Settings.of(library, amplifier_tolerance=0.2)

        def played(tap: SimulatedTap, truth: TrueDevice | None) -> FloatArray:
            from controller.waveforms.bank import bank

            return play_tap(library, Servo(settings, bank(library)), tap, device=truth).acceleration_m_s2

        own = played(SimulatedTap(0.2, 3.0, seed=4, imperfections=WRONG), None)
        given = played(SimulatedTap(0.2, 3.0, seed=4, imperfections=replace(WRONG, mismatch=0.0)), device)
        np.testing.assert_array_equal(own, given)


class TestHeat:
    def test_against_the_exact_solution(self, scene: Scene) -> None:
        coil = scene.coil()
        assert coil is not None
        truth = true_coil(coil, 0.2, 3)
        assert truth.R_ha_K_W != coil.R_ha_K_W
        assert truth.R_wh_K_W == pytest.approx(coil.R_wh_K_W, rel=0.2)
        taken = heat_record(truth, 1.1, 900.0, 600.0, 1.0, noise_K=0.0, current_noise_A=0.0, seed=0)
        square = effective_square(taken.columns["current_A"][:-1])
        winding, housing = truth.simulate(square[None], np.ones(square.size))
        np.testing.assert_allclose(taken.columns["winding_C"], winding[0], atol=1e-3)
        np.testing.assert_allclose(taken.columns["housing_C"], housing[0], atol=1e-3)

    def test_too_hot(self, scene: Scene) -> None:
        coil = scene.coil()
        assert coil is not None
        with pytest.raises(InputError, match=r"would pass its limit of 100 C after \d+ s at 2 A; lower --current"):
            heat_record(coil, 2.0, 3600.0, 10.0, 1.0, noise_K=0.0, current_noise_A=0.0, seed=0)


class TestCommands:
    def test_sweep(self, play: Run) -> None:
        arguments = ("--grips", "0,2.5", "--trials", 2, "--seconds", 1.0, "--low", 10, "--mismatch", 0.1, "--seed", 4)
        outcome = play("record", "sweep", "--simulate", "--out", "sweeps", *arguments)
        assert outcome.code == 0, outcome.err
        assert "4 sweeps of 1 s" in outcome.out
        assert "transopt identify device sweeps/device_*.npz" in outcome.out
        names = sorted(path.name for path in Path("sweeps").iterdir())
        assert names[0] == "device_0N_1_pos.npz"
        assert names[3] == "device_2.5N_2_neg.npz"
        taken = load_measurement(Path("sweeps") / names[3])
        assert taken.grip_N == pytest.approx(2.5, rel=0.06)
        assert taken.accelerometer_Hz == 2500.0
        for quantity in ("command", "current", "acceleration", "position"):
            assert taken.require(quantity, quantity).rate_Hz == pytest.approx(1e4)
        free = load_measurement(Path("sweeps") / names[0])
        assert free.grip_N == 0.0
        again = play("record", "sweep", "--simulate", "--out", "sweeps", *arguments)
        assert_refused(again, "--out sweeps: holds a recording already (device_0N_1_pos.npz)", "another folder")
        joined = play("record", "sweep", "--simulate", "--out", "sweeps", "--grips", 4, *arguments[2:])
        assert joined.code == 0, joined.err
        assert len(list(Path("sweeps").iterdir())) == 6

    def test_taps_of_a_library(self, play: Run) -> None:
        outcome = play("record", "tap", "library.npz", "--simulate", "--speeds", 0.25, "--grips", "2,4", "--out", "t")
        assert outcome.code == 0, outcome.err
        assert "2 taps, tap_0.25m_s_2N_1.npz to tap_0.25m_s_4N_1.npz" in outcome.out
        taken = load_measurement(Path("t/tap_0.25m_s_2N_1.npz"))
        assert taken.speed_m_s == pytest.approx(0.25, rel=5e-3)
        command, current = taken.require("command", ""), taken.require("current", "")
        assert np.abs(command.values).max() > 1
        assert np.abs(current.values).max() > 1
        before = taken.require("acceleration", "").values[command.times_s < -1e-3]
        assert float(np.abs(before).max()) < 1

    def test_taps_on_an_object(self, play: Run) -> None:
        outcome = play("record", "tap", "--simulate", "--object", "--speeds", 0.2, "--repeats", 2, "--out", "t")
        assert outcome.code == 0, outcome.err
        one, other = (load_measurement(Path(f"t/tap_0.2m_s_3N_{n}.npz")) for n in (1, 2))
        assert one.require("force", "").values.max() > 1
        assert one.require("force", "").start_s != other.require("force", "").start_s
        assert "transopt taps t/tap_*.npz" in outcome.out
        as_a_tap = load_recording(Path("t/tap_0.2m_s_3N_1.npz"))
        assert as_a_tap.speed_m_s == 0.2
        np.testing.assert_array_equal(as_a_tap.acceleration.values, one.require("acceleration", "").values)

    def test_heat(self, play: Run) -> None:
        outcome = play(
            "record", "heat", "--simulate", "--heating", 60, "--cooling", 30, "--out", "h", "--device", "hot_coil"
        )
        assert outcome.code == 0, outcome.err
        taken = load_measurement(Path("h/heat.npz"))
        assert taken.require("winding", "").values.size == 91

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (("sweep", "--out", "x"), "record sweep: name one device"),
            (("sweep", "--simulate", "--out", "x", "--for", "hand"), "--for hand: must be one of amplifier, device"),
            (("sweep", "--simulate", "--out", "x", "--grips", "a"), "--grips a: must be numbers with commas between"),
            (("sweep", "--simulate", "--out", "x", "--high", 6000), "sweep: high 6000 Hz"),
            (("sweep", "--simulate", "--out", "x", "--amplitude", 5), "above the limit of 4 A"),
            (("sweep", "--simulate", "--out", "x", "--mismatch", 2), "--mismatch 2: must be 0 to 0.5"),
            (("sweep", "--simulate", "--out", "x", "--device", "none"), "none: no built-in scene"),
            (("tap", "--out", "x"), "record tap: name one device"),
            (("tap", "--out", "x", "--simulate", *PORT), "record tap: name one device"),
            (("tap", "--out", "x", "--simulate"), "name either a LIBRARY whose taps are played, or --object"),
            (("tap", "library.npz", "--out", "x", "--simulate", "--object"), "name either a LIBRARY"),
            (("tap", "library.npz", "--out", "x", *PORT), "library: only with --simulate"),
            (("tap", "--out", "x", "--object", *PORT), "--object: only with --simulate"),
            (("tap", "--out", "x", "--object", "--simulate", "--for", 3), "--for: only with --port"),
            (("tap", "--out", "x", "--object", "--simulate", "--grips", "0,3"), "--grips 0: only a sweep"),
            (("tap", "--out", "x", "--object", "--simulate", "--device", "own_taps"), "states no simulated object"),
            (("tap", "none.npz", "--out", "x", "--simulate"), "none.npz: no such file"),
            (("heat", "--out", "x"), "record heat: name the device"),
            (("heat", "--simulate", "--out", "x", "--current", 9), "--current 9: must be 0 to 4 A"),
            (("heat", "--simulate", "--out", "x", "--current", 2), "would pass its limit of 100 C"),
            (("heat", "--simulate", "--out", "x", "--heating", 1, "--cooling", 1), "fewer than ten readings"),
            (("heat", "--simulate", "--out", "/proc/x"), "--out /proc/x: cannot be written"),
        ],
    )
    def test_bad_input_is_one_line(self, play: Run, desk: Desk, arguments: tuple[object, ...], words: str) -> None:
        assert_refused(play("record", *arguments), words)
        assert desk.ticks == 0
