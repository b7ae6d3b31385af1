"""The true device against the design's independent replay, its energy, delay, heat, sensors and users."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

import problems
from controller.sim.sensors import SensorBench, Sensors
from controller.sim.simulated_tap import strike_real
from controller.sim.simulator import NONE, Imperfections, Simulator, Trace
from controller.sim.true_device import Ground, Joint, TrueDevice, device_of, rates
from controller.sim.user import (
    StillHand,
    TapUser,
    Tremor,
    User,
)
from tests.benches.repeated_taps import RepeatedTaps
from transopt.base.errors import InputError
from transopt.base.matrices import exponential
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray, nrmse
from transopt.library.library import Library
from transopt.plant.coil import effective_square
from transopt.plant.discretise import discretise
from transopt.plant.hand import LinearInGrip
from transopt.plant.intention import BRAKING_S, INTENTION_S, YIELDINGS, Intention, Yielding
from transopt.problem.objective.target import Target
from transopt.proof.replay import replay
from transopt.scene.scene import Scene
from transopt.scene.strikes import strike

DT = 1e-4
CONTACT_TICKS = 500


def still(held_N: float = 3.0) -> StillHand:
    """Let the hand hold still where the wall is."""
    return StillHand(held_N, height_m=0.0)


def play(simulator: Simulator, command_A: FloatArray, before: int = 0, after: int = 0) -> Trace:
    for c in [0.0] * before + command_A.tolist() + [0.0] * after:
        simulator.advance(c)
    return simulator.trace()


def at(trace: Trace, times_s: FloatArray) -> np.ndarray:
    """Indices of the steps that end at these times."""
    k = np.searchsorted(trace.times_s, times_s - 1e-9)
    np.testing.assert_allclose(trace.times_s[k], times_s, rtol=0, atol=1e-12)
    return k


class TestAgainstReplay:
    """Same physical parameters, nothing else shared: absolute coordinates here, elongations there."""

    @pytest.mark.parametrize(("iv", "ig"), [(0, 0), (1, 1), (3, 2)])
    def test_library_command_gives_the_predicted_motion(
        self, scene: Scene, library: Library, iv: int, ig: int
    ) -> None:
        speed, grip = float(library.speeds_m_s[iv]), float(library.grips_N[ig])
        user = TapUser(speed, grip, CONTACT_TICKS * DT)
        simulator = Simulator(device_of(scene), user, DT, trace=True)
        start = CONTACT_TICKS - round(scene.lead_s / DT)
        trace = play(simulator, library.command[iv, ig], before=start, after=10)
        k = at(trace, library.time_grid().switching_times_s + CONTACT_TICKS * DT)
        predicted = library.acceleration_m_s2[iv, ig]
        peak = np.abs(predicted).max()
        np.testing.assert_allclose(trace.acceleration_m_s2[k], predicted, rtol=0, atol=1e-9 * peak)
        np.testing.assert_allclose(trace.current_A[k], library.plant_input[iv, ig], rtol=0, atol=1e-9)
        assert simulator.peak_current_A == pytest.approx(library.peak_input[iv, ig], abs=1e-9)

    @pytest.mark.parametrize("name", ["second_order", "free_stylus", "stiff_drive", "ideal_amplifier", "small_coil"])
    @pytest.mark.parametrize("delay_s", [0.0, 31.4e-6, 1e-4, 2.68e-4])
    def test_every_model_and_delay(self, name: str, delay_s: float) -> None:
        scene = problems.load(name)
        grip = scene.grid.grips_N[-1]
        amplifier = scene.amplifier_model()
        if amplifier is not None:
            amplifier = replace(amplifier, delay_s=delay_s)
        elif delay_s > 0:
            pytest.skip("an ideal amplifier has no delay")
        random = np.random.default_rng(7)
        command = np.repeat(random.uniform(-0.2, 0.2, 30), 4)  # inside every scene's command range
        grid = replace(scene.time_grid(), stages=command.size, delay_s=delay_s)
        stage = discretise(scene.plant(grip), amplifier, DT)
        [played] = replay(stage, grid, command[None], [Target(np.ones(command.size))], None)

        device = replace(device_of(scene), amplifier=amplifier)
        simulator = Simulator(device, still(grip), DT, trace=True)
        trace = play(simulator, command, after=10)
        times = grid.switching_times_s + grid.lead_s
        if amplifier is None:
            # The current jumps at the tick; the trace holds what was before.
            times, now = times[1:], played.acceleration_m_s2[1:]
        else:
            now = played.acceleration_m_s2
        k = at(trace, times)
        np.testing.assert_allclose(trace.acceleration_m_s2[k], now, rtol=0, atol=1e-8 * np.abs(now).max())

    def test_intention_moving_straight_is_the_frame(self, scene: Scene) -> None:
        """One command does the same to a resting and to a moving hand: nothing is tied to the ground."""
        command = np.sin(np.arange(200) / 7)
        resting = play(Simulator(device_of(scene), still(3.0), DT, trace=True), command)
        moving = play(Simulator(device_of(scene), TapUser(0.3, 3.0, 10e-3), DT, trace=True), command)
        scale = np.abs(resting.acceleration_m_s2).max()
        np.testing.assert_allclose(moving.acceleration_m_s2, resting.acceleration_m_s2, rtol=0, atol=1e-9 * scale)


class TestExponential:
    @pytest.mark.parametrize("name", ["wood_on_foam", "stiff_drive", "free_stylus", "second_order"])
    @pytest.mark.parametrize("step_s", [1e-12, 3.4e-5, 1e-3])
    def test_agrees_with_sixty_digits(self, name: str, step_s: float) -> None:
        """The sixty digits are those of mpmath: scipy's own exponential errs by 1e-8 on some processors."""
        scene = problems.load(name)
        X = rates(device_of(scene), None, 2500.0, scene.grid.grips_N[0]) * step_s
        with mpmath.workdps(60):
            exact = np.array(mpmath.expm(mpmath.matrix(X.tolist()), method="taylor").tolist(), dtype=float)
        _, (size, _) = linalg.matrix_balance(X, permute=False, separate=True)
        np.testing.assert_allclose(
            exponential(X) * size / size[:, None], exact * size / size[:, None], rtol=1e-11, atol=1e-11
        )


HELD_N = 2.0


def energy_J(simulator: Simulator, held_N: float) -> float:
    """Kinetic and elastic energy of the chain; with the intention at rest a passive device cannot gain any."""
    masses, stiffness, _ = simulator.device.at(held_N)
    z, v = np.split(simulator.state[: 2 * masses.size], 2)
    elongation = z - np.append(z[1:], 0.0)
    ground = simulator.device.ground.stiffness_N_m * z[0] ** 2
    return float((masses @ v**2 + stiffness @ elongation**2 + ground) / 2)


class TestEnergy:
    @pytest.mark.parametrize("ground", [Ground(), Ground(100.0, 2.0, 0.1)])
    def test_undriven_device_only_loses_energy(self, scene: Scene, ground: Ground) -> None:
        imperfections = Imperfections(mismatch=0.1, crossover_A=0.0, ground=ground)
        simulator = Simulator(device_of(scene), still(HELD_N), DT, imperfections=imperfections, seed=3)
        for c in [3.0] * 30 + [0.0] * 100:  # and 10 ms until no current is left
            simulator.advance(c)
        energies = [energy_J(simulator, HELD_N)]
        for _ in range(500):
            simulator.advance(0.0)
            energies.append(energy_J(simulator, HELD_N))
        assert np.all(np.diff(energies) <= 1e-12 * energies[0])
        assert energies[-1] < 0.2 * energies[0]

    def test_chain_without_dampers_keeps_its_energy(self) -> None:
        masses = tuple(LinearInGrip(m, 0.0) for m in (0.014, 0.026, 0.010))
        joints = tuple(Joint(LinearInGrip(k, 0.0), LinearInGrip(0.0, 0.0)) for k in (6e4, 9e3, 490.0))
        device = TrueDevice(masses, joints, 1, 1, 1.25, None, None)
        simulator = Simulator(device, still(HELD_N), DT)
        for _ in range(20):
            simulator.advance(2.0)
        simulator.advance(0.0)
        start = energy_J(simulator, HELD_N)
        for _ in range(2000):
            simulator.advance(0.0)
        assert energy_J(simulator, HELD_N) == pytest.approx(start, rel=1e-9)

    def test_friction_holds_against_a_smaller_force(self, scene: Scene) -> None:
        """0.2 N of friction, smoothed, against 0.1 N at a free device: it creeps where tanh(v / v_s) is a half."""
        imperfections = Imperfections(crossover_A=0.0, ground=Ground(friction_N=0.2))
        device = replace(device_of(scene), force_per_current_N_A=1.0)
        trace = play(Simulator(device, still(0.0), DT, imperfections=imperfections, trace=True), np.full(2000, 0.1))
        assert trace.motor_m_s[-1] == pytest.approx(2e-3 * np.arctanh(0.5), rel=1e-3)


class TestAmplifier:
    @pytest.mark.parametrize("delay_s", [0.0, 1e-6, 68e-6, 99.9e-6, 1e-4, 168e-6, 2.5e-4])
    def test_delay_to_a_fraction_of_a_tick(self, scene: Scene, delay_s: float) -> None:
        amplifier = scene.amplifier_model()
        device = replace(device_of(scene), amplifier=replace(amplifier, delay_s=delay_s))
        trace = play(Simulator(device, still(), DT, trace=True), np.ones(20))
        since = np.maximum(trace.times_s - delay_s, 0.0)
        np.testing.assert_allclose(trace.current_A, -np.expm1(-amplifier.rate_rad_s * since), rtol=0, atol=1e-12)

    def test_dead_band_and_range(self, scene: Scene) -> None:
        imperfections = Imperfections(crossover_A=0.02)

        def settled(command_A: float) -> float:
            simulator = Simulator(device_of(scene), still(), DT, imperfections=imperfections, trace=True)
            return float(play(simulator, np.full(100, command_A)).current_A[-1])

        assert [settled(c) for c in (0.015, -0.02)] == [0.0, 0.0]
        assert settled(1.0) == pytest.approx(0.98)
        assert settled(-1.0) == pytest.approx(-0.98)
        assert settled(9.0) == pytest.approx(6.0 - 0.02)

    @pytest.mark.parametrize("command_A", [float("nan"), float("inf")])
    def test_refuses_what_is_no_number(self, scene: Scene, command_A: float) -> None:
        with pytest.raises(ValueError, match="tick 0: must be a finite number"):
            Simulator(device_of(scene), still(), DT).advance(command_A)


class TestCoil:
    def test_two_nodes_as_the_design_states_them(self, scene: Scene) -> None:
        """Against the implicit midpoint rule of the design over the same current; both are of second order."""
        coil = replace(scene.coil(), start_winding_C=60.0, start_housing_C=40.0)
        simulator = Simulator(replace(device_of(scene), coil=coil), still(), DT, trace=True)
        random = np.random.default_rng(1)
        trace = play(simulator, np.repeat(random.uniform(-4, 4, 300), 10))
        a, b = (effective_square(i) for i in (trace.current_A[:-1], trace.current_A[1:]))
        squares = (a + np.sqrt(a * b) + b) / 3  # of a size that goes linearly from one to the other
        winding, housing = coil.simulate(squares[None], np.diff(trace.times_s))
        assert simulator.winding_C == pytest.approx(winding[0, -1], abs=1e-6)
        assert simulator.housing_C == pytest.approx(housing[0, -1], abs=1e-6)
        assert abs(winding[0, -1] - 60.0) > 0.1

    def test_one_node_keeps_its_housing(self, scene: Scene) -> None:
        coil = replace(scene.coil(), nodes=1, start_winding_C=40.0, start_housing_C=30.0)
        simulator = Simulator(replace(device_of(scene), coil=coil), still(), DT)
        for _ in range(100):
            simulator.advance(4.0)
        assert simulator.housing_C == 30.0

    def test_no_motor_data_no_temperature(self, scene: Scene) -> None:
        simulator = Simulator(replace(device_of(scene), coil=None), still(), DT)
        simulator.advance(4.0)
        assert np.isnan(simulator.winding_C)


class TestSensors:
    def test_encoder_rounds_to_the_nearest_count(self) -> None:
        bench = SensorBench(Sensors(), DT, 0, 3.0)
        assert [bench.counts(z * 24.5e-6) for z in (-1.6, -0.4, 0.0, 0.4, 0.6, 7.0)] == [-2, 0, 0, 0, 1, 7]

    def test_accelerometer_noise_has_the_datasheet_density_and_no_number_beyond_the_range(self) -> None:
        bench = SensorBench(Sensors(), DT, 0, 3.0)
        noise = np.array([bench.acceleration_m_s2(0.0) for _ in range(40000)])
        rms_g = np.sqrt(np.mean(noise**2)) / STANDARD_GRAVITY_M_S2
        assert rms_g == pytest.approx(320e-6 * np.sqrt(np.pi / 2 * 2500), rel=0.02)
        for sign in (1, -1):
            within, beyond = (sign * part * 18 * STANDARD_GRAVITY_M_S2 for part in (0.98, 1.02))
            assert bench.acceleration_m_s2(within) == pytest.approx(within, abs=6 * rms_g * STANDARD_GRAVITY_M_S2)
            assert np.isnan(bench.acceleration_m_s2(beyond))

    def test_accelerometer_lags_by_its_pole(self, scene: Scene) -> None:
        """A steady acceleration is read as it is, a new one after the pole's time constant to 63 %."""
        device = TrueDevice(
            (LinearInGrip(0.1, 0.0),), (Joint(LinearInGrip(0, 0), LinearInGrip(0, 0)),), 0, None, 1.0, None, None
        )
        sensors = Sensors(accelerometer_noise_g_rtHz=0.0, accelerometer_bandwidth_Hz=500.0)
        simulator = Simulator(device, still(), DT, imperfections=Imperfections(crossover_A=0.0, sensors=sensors))
        read = []
        for _ in range(100):
            read.append(simulator.readings().acceleration_m_s2)
            simulator.advance(1.0)
        expected = 10.0 * -np.expm1(-2 * np.pi * 500.0 * DT * np.arange(100))
        np.testing.assert_allclose(read, expected, rtol=0, atol=1e-9)

    def test_grip_sensor_lags_by_its_hysteresis_both_ways(self) -> None:
        bench = SensorBench(Sensors(grip_noise_N=0.0), DT, 0, 1.0)
        rising = [bench.grip_N(F) for F in np.linspace(1, 9, 50)]
        falling = [bench.grip_N(F) for F in np.linspace(9, 1, 50)]
        assert rising[-1] == pytest.approx(9 * 0.95)
        assert rising[0] == 1.0
        assert falling[-1] == pytest.approx(1.05)
        assert bench.grip_N(0.0) == 0.0

    def test_noise_of_grip_and_current(self) -> None:
        bench = SensorBench(Sensors(), DT, 0, 5.0)
        assert np.std([bench.grip_N(5.0) for _ in range(20000)]) == pytest.approx(0.02, rel=0.03)
        assert np.std([bench.current_A(1.0) for _ in range(20000)]) == pytest.approx(0.005, rel=0.03)


class TestSeed:
    def run(self, scene: Scene, seed: int) -> list[object]:
        imperfections = Imperfections(mismatch=0.1)
        user = RepeatedTaps(seed, tremor=Tremor())
        simulator = Simulator(device_of(scene), user, DT, imperfections=imperfections, seed=seed)
        read = []
        for k in range(2000):
            read.append(simulator.readings())
            simulator.advance(float(np.sin(k / 50)))
        return read

    def test_same_seed_same_run(self, scene: Scene) -> None:
        assert self.run(scene, 5) == self.run(scene, 5)
        assert self.run(scene, 5) != self.run(scene, 6)

    def test_mismatch_stays_within_its_fraction_and_touches_everything(self, scene: Scene) -> None:
        nominal = device_of(scene)
        devices = [nominal.mismatched(0.2, np.random.default_rng(seed)) for seed in range(300)]

        def spread(of: object) -> None:
            ratios = np.array([of(device) / of(nominal) for device in devices])  # type: ignore[operator]
            assert 0.8 <= ratios.min() < 0.83
            assert 1.17 < ratios.max() <= 1.2

        for j in range(3):
            spread(lambda d, j=j: d.masses_kg[j].at(3.0))
            spread(lambda d, j=j: d.joints[j].stiffness_N_m.at(3.0))
            spread(lambda d, j=j: d.joints[j].damping_N_s_m.at(3.0))
        spread(lambda d: d.force_per_current_N_A)
        spread(lambda d: d.amplifier.pole_Hz)
        spread(lambda d: d.amplifier.delay_s)


class TestApproach:
    @pytest.mark.parametrize("ground", [Ground(), Ground(damping_N_s_m=2.0), Ground(friction_N=0.2)])
    def test_straight_until_something_pushes(self, scene: Scene, ground: Ground) -> None:
        imperfections = Imperfections(crossover_A=0.0, ground=ground)
        simulator = Simulator(device_of(scene), TapUser(0.2, 3.0, 0.05), DT, imperfections=imperfections, trace=True)
        trace = play(simulator, np.zeros(400))
        assert np.abs(trace.acceleration_m_s2).max() < 1e-6
        np.testing.assert_allclose(trace.motor_m_s, -0.2, rtol=0, atol=1e-9)
        np.testing.assert_allclose(trace.motor_m, -0.2 * (trace.times_s - 0.05), rtol=0, atol=1e-9)


class TestUsers:
    def test_all_hands_agree_until_they_can_react(self) -> None:
        times = np.linspace(0.0, 0.05 + INTENTION_S, 50)
        users = [TapUser(0.3, 3.0, 0.05, Intention(yields=yields)) for yields in YIELDINGS]
        for t in times:
            assert [user.intention_m(t) for user in users] == pytest.approx([-0.3 * (t - 0.05)] * 5, abs=1e-12)

    def test_laws_after_the_reaction(self) -> None:
        end = 0.05 + INTENTION_S
        found = {yields: TapUser(0.3, 3.0, 0.05, Intention(yields=yields)) for yields in YIELDINGS}
        late = end + 2 * BRAKING_S
        assert found["straight"].intention_m(late) == pytest.approx(-0.3 * (late - 0.05))
        assert found["stops"].intention_m(late) == pytest.approx(-0.3 * INTENTION_S)
        assert found["brakes"].intention_m(late) == pytest.approx(-0.3 * (INTENTION_S + BRAKING_S / 2))
        assert found["pulls"].intention_m(late) > -0.3 * INTENTION_S
        half = (found["brakes"].intention_m(end + 0.031) - found["brakes"].intention_m(end + 0.029)) / 0.002
        assert half == pytest.approx(-0.15)

    def test_an_incoming_acceleration_lasts_until_the_intention_is_over(self) -> None:
        user = TapUser(0.3, 3.0, 0.05, Intention(yields="straight"), incoming_m_s2=2.0)
        for t in (-0.02, 0.01, 0.029):
            assert user.intention_m(0.05 + t) == pytest.approx(-0.3 * t + t**2)
        end, slower = 0.05 + INTENTION_S, 0.3 - 2.0 * INTENTION_S
        assert user.intention_m(end + 0.01) - user.intention_m(end) == pytest.approx(-0.01 * slower)

    def test_tremor_and_grip_ramp(self) -> None:
        user = TapUser(0.2, 3.0, 0.05, tremor=Tremor(2e-4, 8.0, 0.3), grip_rate_N_s=20.0)
        plain = TapUser(0.2, 3.0, 0.05)
        off = [user.intention_m(t) - plain.intention_m(t) for t in np.linspace(0, 1, 4001)]
        assert max(off) == pytest.approx(2e-4, rel=1e-4)
        assert (user.grip_N(0.02), user.grip_N(0.15)) == (3.0, pytest.approx(5.0))

    @pytest.mark.parametrize("yields", YIELDINGS)
    def test_the_undriven_stylus_moves_as_references_say_it_does(self, scene: Scene, yields: Yielding) -> None:
        hand = scene.hand.model_copy(update={"yields": yields})
        free = scene.model_copy(update={"hand": hand}).free_motion(3.0)
        user = TapUser(0.3, 3.0, 0.05, hand.intention())
        trace = play(Simulator(device_of(scene), user, DT, trace=True), np.zeros(1300))
        times = np.arange(0.0, 0.12, 1e-5)
        expected = np.interp(trace.times_s - 0.05, times, free.acceleration_m_s2(0.3, 0.0, times), left=0.0)
        inside = (trace.times_s > 0.05) & (trace.times_s < 0.16)
        # An intention that stops dead jumps: the jump falls into one step of either method.
        size = max(float(np.abs(expected).max()), 1.0)
        off = np.abs(trace.acceleration_m_s2 - expected)[inside]
        assert float(np.sqrt(np.mean(off**2))) < 5e-3 * size

    @settings(max_examples=20, deadline=None)
    @given(seed=st.integers(0, 10_000))
    def test_repeated_taps_come_in_straight_within_their_ranges_and_never_jump(self, seed: int) -> None:
        user = RepeatedTaps(seed)
        times = np.arange(0.0, 5.0, 1e-3)
        z = np.array([user.intention_m(t) for t in times])
        grips = np.array([user.grip_N(t) for t in times])
        assert np.abs(np.diff(z)).max() < 2.5e-3  # 2.5 m/s
        assert np.abs(np.diff(grips)).max() < 0.15
        assert grips.min() >= 0
        assert grips.max() <= 10
        cycle = user.cycle(2.0)
        assert 0.05 <= cycle.speed_m_s <= 1.0
        assert user.intention_m(cycle.contact_s) == pytest.approx(0.0, abs=1e-12)
        speed = (user.intention_m(cycle.contact_s - 0.02) - user.intention_m(cycle.contact_s)) / 0.02
        assert speed == pytest.approx(cycle.speed_m_s)
        assert user.intention_m(0.3) == z[300]  # asked again later: the same

    def test_a_hand_that_lets_go_no_longer_acts_and_takes_hold_where_the_stylus_is(self, scene: Scene) -> None:
        class Letting(StillHand):
            def grip_N(self, time_s: float) -> float:
                return 0.0 if 0.01 <= time_s < 0.05 else 3.0

        user: User = Letting(height_m=0.0)
        simulator = Simulator(device_of(scene), user, DT, trace=True)
        trace = play(simulator, np.append(np.full(20, 2.0), np.zeros(780)))
        free = (trace.times_s > 0.02) & (trace.times_s < 0.05)
        # The transmission has come to rest: motor and stylus fly on together.
        assert np.abs(trace.motor_m_s[free] - trace.motor_m_s[free][-1]).max() < 0.02 * np.abs(trace.motor_m_s).max()
        after = trace.times_s >= 0.05
        assert np.abs(trace.acceleration_m_s2[after]).max() < 20.0


class TestRealTap:
    def test_agrees_with_the_simulated_recordings(self, scene: Scene) -> None:
        """Another integrator (explicit Runge-Kutta there), other coordinates, the same physics."""
        target = scene.recordings.simulated
        assert target is not None
        struck = strike_real(device_of(scene), target, 0.3, 3.0, 40e-3, scene.time.dt_s)
        plant = scene.plant(3.0, struck=True)
        times, [expected], [encoder] = strike(plant, target, np.array([0.3]), 40e-3)
        after = (struck.times_s >= 0) & (struck.times_s <= times[-1])
        wanted = np.interp(struck.times_s[after], times, expected)
        assert nrmse(struck.acceleration_m_s2[after], wanted) < 1e-3
        z = np.interp(struck.times_s[after], times, encoder)
        np.testing.assert_allclose(struck.motor_m[after], z, rtol=0, atol=1e-7)
        assert struck.contact_N.min() == 0
        assert struck.contact_N.max() > 3

    def test_error_falls_with_the_square_of_the_step(self, scene: Scene) -> None:
        target = scene.recordings.simulated

        def motion(steps: int) -> FloatArray:
            user = TapUser(0.2, 3.0, 5e-3)
            simulator = Simulator(device_of(scene), user, DT, target=target, steps=steps, trace=True)
            trace = play(simulator, np.zeros(150))
            return trace.motor_m[at(trace, DT * np.arange(151))]

        exact = motion(64)
        coarse, fine = (np.abs(motion(steps) - exact).max() for steps in (2, 8))
        assert np.log2(coarse / fine) / 2 > 1.6, f"order {np.log2(coarse / fine) / 2:.2f}, expected 2"


def test_trace_is_kept_only_on_demand(scene: Scene) -> None:
    simulator = Simulator(device_of(scene), still(), DT, imperfections=NONE)
    with pytest.raises(ValueError, match="trace=True"):
        simulator.trace()


def test_an_actuator_that_no_hand_holds_is_refused() -> None:
    with pytest.raises(InputError, match="lra_click: no hand holds its actuator"):
        device_of(problems.load("lra_click"))
