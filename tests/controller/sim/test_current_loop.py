"""The simulated current loop against a bridge that is switched edge by edge, and in the device it drives."""

from dataclasses import replace

import numpy as np
import pytest

import problems
from controller.sim.current_loop import PHASE, CurrentLoop
from controller.sim.simulator import NONE, Simulator
from controller.sim.true_device import TrueDevice, device_of
from controller.sim.user import StillHand
from tests.benches.switched_bridge import switch
from transopt.base.signals import FloatArray
from transopt.plant.bridge import Bridge
from transopt.plant.coil import Circuit
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

RE_25 = Circuit(2.18, 0.238e-3, 1.25)
DT_S = 1e-4
TIMES_S = DT_S * np.arange(300)
PUSH_AND_PULL = 2.5 * np.exp(-((TIMES_S - 8e-3) ** 2) / 2e-5) - 1.5 * np.exp(-((TIMES_S - 15e-3) ** 2) / 1e-5)
DERIVED = {
    "amplifier.pole_Hz": None,
    "amplifier.delay_s": None,
    "amplifier.switching_Hz": 50e3,
    "limits.supply_V": 24.0,
}


@pytest.fixture(scope="module")
def derived(scene: Scene) -> Scene:
    return with_values(scene, DERIVED)


def driven(bridge: Bridge, command: FloatArray, emf_V: float, faster: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """(N,) mean currents and mean squares over the periods of commands."""
    loop = CurrentLoop(bridge, faster)
    return np.array([loop.advance(DT_S, c, emf_V, bridge.circuit.R_ohm) for c in command.tolist()]).T


class TestAgainstSwitching:
    @pytest.mark.parametrize("R_eddy_ohm", [None, 60.0])
    @pytest.mark.parametrize("emf_V", [0.0, 2.5])
    def test_mean_and_heat_of_a_course(self, R_eddy_ohm: float | None, emf_V: float) -> None:
        bridge = Bridge(RE_25, 20.0, 30e3, 1.5, R_eddy_ohm)
        command = 1.5 * np.sin(2 * np.pi * 150 * DT_S * np.arange(200)) + 0.5
        current, square = driven(bridge, command, emf_V)
        # The bench starts without a current and without the voltage that the back-EMF asks for.
        early = (PHASE + 1e-9) * bridge.period_s
        course = switch(
            bridge, lambda t: float(command[max(int((t - early) / DT_S), 0) % 200]), 0.02, lambda _: emf_V
        )
        settled = slice(67, None)  # two thirds of its three periods
        late = course.since(67 * DT_S)
        assert current[settled].mean() == pytest.approx(late.mean(), rel=0.03, abs=0.02)
        assert square[settled].mean() == pytest.approx(late.mean_square(), rel=0.03)

    def test_steps_of_any_length_go_the_same_way(self) -> None:
        bridge, command = Bridge(RE_25, 24.0, 22.5e3), np.random.default_rng(1).normal(size=12)
        courses = []
        for pieces in (1, 3, 64):
            loop = CurrentLoop(bridge, 1.0)
            parts = [loop.advance(DT_S / pieces, c, -0.5, 2.5) for c in command.tolist() for _ in range(pieces)]
            courses.append(np.array(parts).reshape(command.size, pieces, 2).mean(axis=1))
        np.testing.assert_allclose(courses[1], courses[0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(courses[2], courses[0], rtol=0, atol=1e-9)


class TestJump:
    def test_the_current_jumps_with_the_voltage(self) -> None:
        """It goes by step / (R + R_eddy), which no inductance allows without eddy currents."""
        for R_eddy_ohm, ohm in ((38.0, 40.18), (None, np.inf)):
            bridge = Bridge(RE_25, 20.0, 22.5e3, 1.5, R_eddy_ohm)
            loop, moment = CurrentLoop(bridge, 1.0), 1e-12
            loop.advance((PHASE + 1) * bridge.period_s - moment, 1.0, 0.0, RE_25.R_ohm)
            before, _ = loop.advance(moment / 2, 1.0, 0.0, RE_25.R_ohm)
            rested_V = loop.voltage_V
            loop.advance(moment, 1.0, 0.0, RE_25.R_ohm)
            after, _ = loop.advance(moment, 1.0, 0.0, RE_25.R_ohm)
            assert before == rested_V == 0
            assert loop.voltage_V > 1.0
            assert after - before == pytest.approx((loop.voltage_V - rested_V) / ohm, abs=1e-6)

    def test_it_heats(self) -> None:
        steady = np.full(300, 1.0)
        (_, plain), (current, with_jump) = (
            driven(Bridge(RE_25, 20.0, 22.5e3, 1.5, R_eddy), steady, 0.0) for R_eddy in (None, 38.0)
        )
        assert current[-1] == pytest.approx(1.0, abs=1e-3)
        jump = 20.0 * RE_25.R_ohm * 1.0 / 40.18**2 * (1 - RE_25.R_ohm / 20)
        assert with_jump[-50:].mean() - plain[-50:].mean() == pytest.approx(jump, rel=0.05)


class TestLoop:
    def test_the_rail_bounds_the_voltage_and_the_loop_recovers(self) -> None:
        bridge = Bridge(RE_25, 10.0, 50e3)
        loop, volts, current = CurrentLoop(bridge, 1.0), [], []
        for c in [8.0] * 40 + [1.0] * 40:
            current.append(loop.advance(DT_S, c, 0.0, RE_25.R_ohm)[0])
            volts.append(loop.voltage_V)
        assert max(volts) == 10.0
        assert current[39] == pytest.approx(10.0 / 2.18, rel=1e-3)
        assert current[50] == pytest.approx(1.0, rel=0.02)  # nothing was wound up

    def test_a_turning_motor_is_at_rest_without_a_command(self) -> None:
        current, _ = driven(Bridge(RE_25, 24.0, 22.5e3), np.zeros(20), -0.5)
        np.testing.assert_allclose(current, 0.0, atol=1e-12)


def held_device(device: TrueDevice, command: FloatArray) -> Simulator:
    simulator = Simulator(device, StillHand(3.0, height_m=0.01), DT_S, imperfections=NONE, trace=True)
    for c in command.tolist():
        simulator.advance(c)
    return simulator


class TestDevice:
    def test_it_moves_as_the_pole_that_follows(self, derived: Scene) -> None:
        device = device_of(derived)
        assert device.bridge is not None
        loop, pole = held_device(device, PUSH_AND_PULL), held_device(replace(device, bridge=None), PUSH_AND_PULL)
        ticks = DT_S * np.arange(20, 300)
        a, b = (np.interp(ticks, s.trace().times_s, s.trace().stylus_m) for s in (loop, pole))
        assert np.abs(a - b).max() < 0.02 * np.ptp(b)

    def test_it_heats_as_counted(self, derived: Scene) -> None:
        """A loop heats by its true square, a pole with heat factor and ripple of the bridge."""
        motor = {**derived.motor.model_dump(), "R_eddy_ohm": 60.0}  # type: ignore[union-attr]
        for scene in (derived, with_values(derived, {"motor": motor, "amplifier.switching_Hz": 30e3})):
            device = device_of(scene)
            rises = [held_device(d, PUSH_AND_PULL).winding_C - 25 for d in (device, replace(device, bridge=None))]
            assert rises[0] > 0.01
            assert rises[0] == pytest.approx(rises[1], rel=0.05)

    def test_a_stated_pole_is_what_the_device_has(self, derived: Scene) -> None:
        stated = with_values(derived, {"amplifier.pole_Hz": 1050.0, "amplifier.delay_s": 68e-6})
        assert device_of(stated).bridge is None
        assert device_of(problems.load("wood_on_foam")).bridge is None

    def test_a_stated_delay_beyond_the_loop_is_waited_for(self, derived: Scene) -> None:
        late = with_values(derived, {"amplifier.delay_s": 68e-6})
        device = device_of(late)
        assert device.delay_s == pytest.approx(68e-6 - device.bridge.delay_s)
        assert device_of(derived).delay_s == 0
