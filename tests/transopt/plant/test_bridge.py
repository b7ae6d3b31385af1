"""Pole, delay and heat of a PWM bridge, against a bridge that is switched edge by edge."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.benches.switched_bridge import Switched, switch
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.bridge import Bridge
from transopt.plant.coil import Circuit
from transopt.problem.heat import Heating, heating

DT_S = 1e-4
RE_25 = Circuit(2.18, 0.238e-3, 1.25)
WITHIN = 0.05  # what is promised of bandwidth and heat


def gain_at(bridge: Bridge, frequency_Hz: float) -> float:
    """Amplitude of a switched current over that of its command, which takes a fifth of the rail."""
    size = 0.2 * bridge.rail_V / abs(bridge.circuit.R_ohm + 2j * np.pi * frequency_Hz * bridge.circuit.L_H)
    settled, periods = 2 / bridge.crossover_Hz, max(6, round(30 * frequency_Hz / bridge.switching_Hz))
    course = switch(bridge, lambda t: size * np.sin(2 * np.pi * frequency_Hz * t), settled + periods / frequency_Hz)
    end = course.t[-1] + course.h[-1]
    return course.since(end - periods / frequency_Hz).amplitude(frequency_Hz) / size


def drawn(random: np.random.Generator) -> Bridge:
    """Any bridge that the model takes, at the edges of its range too."""
    while True:
        L, f = np.exp(random.uniform(np.log([0.05e-3, 10e3]), np.log([2e-3, 100e3])))
        R, V = np.exp(random.uniform(np.log([0.2, 3.0]), np.log([20.0, 60.0])))
        gain = 2 * np.pi * L * f * random.choice([0.1, random.uniform(0.01, 0.1)])
        try:
            return Bridge(Circuit(R, L, 0.0), V, f, gain)
        except InputError:
            continue


def check_bandwidth(bridge: Bridge) -> None:
    pole = bridge.pole_Hz
    assert gain_at(bridge, pole / (1 + WITHIN)) > np.sqrt(0.5) > gain_at(bridge, pole * (1 + WITHIN))


def tap(random: np.random.Generator) -> FloatArray:
    """(60,) commands: a blow, what rings after it, and a hold."""
    t = DT_S * np.arange(60)
    ring = np.exp(-t / random.uniform(1e-3, 4e-3)) * np.cos(2 * np.pi * random.uniform(50, 500) * t)
    return np.asarray(ring + random.uniform(0, 0.5) * np.exp(-((t / 8e-3) ** 2)))


def held(command: FloatArray) -> Callable[[float], float]:
    """Commands (N,) as a servo holds them, the last one for ever."""
    return lambda t: float(command[min(int((t + 1e-9) / DT_S), command.size - 1)])


def following(bridge: Bridge, command: FloatArray) -> tuple[Heating, FloatArray]:
    """Heating of a period behind the bridge's pole, and (N,) the currents at the starts of the periods."""
    model = heating(Amplifier(bridge.pole_Hz, 0.0, 1e3), DT_S, bridge.ripple_A)
    current = np.zeros(command.size)
    for k in range(1, command.size):
        current[k] = model.after(current[k - 1], command[k - 1])
    return model, current


def within_rail(bridge: Bridge, command: FloatArray, share: float) -> FloatArray:
    """Commands as large as the rail allows R i + L di/dt to be just after each instant, times a share."""
    _, current = following(bridge, command)
    rate = 2 * np.pi * bridge.pole_Hz * (command - current)
    return command * share * bridge.rail_V / np.abs(bridge.circuit.voltage_V(current, rate, np.zeros(1))).max()


def check_heat(bridge: Bridge, random: np.random.Generator) -> None:
    """A tap heats as a problem counts it, with pole, heat factor and ripple of the bridge.

    In the mean over what lies between the clocks of servo and loop: at 10 kHz one tap alone may be 12 % off.
    """
    command = within_rail(bridge, tap(random), random.uniform(0.4, 1.0))
    model, current = following(bridge, command)
    counted = bridge.heat_factor * model.mean_square(current, command).mean()
    squares = []
    for phase in (0.125, 0.375, 0.625, 0.875):
        later = held(np.append(0.0, command))
        wait_s = DT_S - phase * bridge.period_s
        squares.append(switch(bridge, lambda t: later(t + wait_s), 60 * DT_S).mean_square())  # noqa: B023
    assert counted == pytest.approx(np.mean(squares), rel=WITHIN)


class TestBandwidth:
    @pytest.mark.parametrize("L_H", [0.05e-3, 0.238e-3, 2e-3])
    @pytest.mark.parametrize("switching_Hz", [10e3, 22.5e3, 100e3])
    @pytest.mark.parametrize("share", [0.01, 0.03, 0.1])
    def test_a_switched_bridge_loses_3_dB_at_the_pole(self, L_H: float, switching_Hz: float, share: float) -> None:
        circuit = Circuit(0.4 * 2 * L_H * switching_Hz, L_H, 0.0)
        check_bandwidth(Bridge(circuit, 7 * L_H * switching_Hz, switching_Hz, 2 * np.pi * share * switching_Hz * L_H))

    @pytest.mark.parametrize("bridges", [8, pytest.param(300, marks=pytest.mark.long)])
    def test_anywhere_in_the_range(self, bridges: int) -> None:
        random = np.random.default_rng(11)
        for _ in range(bridges):
            check_bandwidth(drawn(random))

    def test_with_eddy_currents(self) -> None:
        check_bandwidth(Bridge(RE_25, 12.0, 22.5e3, 1.5, R_eddy_ohm=40.0))

    def test_a_slow_loop_is_one_pole_at_its_crossover(self) -> None:
        slow = Bridge(RE_25, 12.0, 100e3, 2 * np.pi * 10.0 * RE_25.L_H)
        assert slow.pole_Hz == pytest.approx(slow.crossover_Hz, rel=1e-3) == pytest.approx(10.0)
        assert slow.delay_s == pytest.approx(1.5 * slow.period_s, rel=0.01)

    def test_pole_and_delay_follow_a_switched_tap(self) -> None:
        bridge = Bridge(RE_25, 24.0, 50e3, 1.2)
        command = within_rail(bridge, tap(np.random.default_rng(2)), 1.0)
        course = switch(bridge, held(command), 60 * DT_S)
        of_pole = np.zeros(course.t.size)
        w = 2 * np.pi * bridge.pole_Hz
        for k, asked in enumerate(command - np.append(0.0, command[:-1])):
            since = course.t - k * DT_S - bridge.delay_s
            of_pole += asked * np.where(since > 0, -np.expm1(-w * np.maximum(since, 0.0)), 0.0)
        between = slice(0, None, 3)  # pulses, where the current is near its mean
        off = (course.steady + course.falling - of_pole)[between]
        assert np.linalg.norm(off) < 0.03 * np.linalg.norm(of_pole[between])


class TestHeat:
    @pytest.mark.parametrize("duty", [0.02, 0.2, 0.5, 0.9])
    @pytest.mark.parametrize("R_eddy_ohm", [None, 40.0])
    def test_the_ripple_of_a_steady_current_is_exact(self, duty: float, R_eddy_ohm: float | None) -> None:
        bridge = Bridge(RE_25, 12.0, 22.5e3, 1.5, R_eddy_ohm)
        back = 3.0
        command = (duty * bridge.rail_V - back) / RE_25.R_ohm
        course = switch(bridge, lambda _: command, 0.02, lambda _: back)
        course = course.since(course.t[-1] - 100.5 * bridge.period_s)
        whole = Switched(*(x[: 3 * 100] for x in (course.t, course.h, course.steady, course.falling)), course.tau)
        variance = whole.mean_square() - whole.mean() ** 2
        voltage = RE_25.R_ohm * whole.mean() + back
        assert variance == pytest.approx(float(bridge.ripple_square_A2(voltage)), rel=1e-3)
        currents = whole.steady + whole.falling * np.exp(-np.stack([0 * whole.h, whole.h]) / whole.tau)
        assert np.ptp(currents) == pytest.approx(float(bridge.peak_to_peak_A(voltage / bridge.rail_V)), rel=1e-3)

    def test_a_small_ripple_is_a_triangle(self) -> None:
        """Peak to peak V d (1 - d) / (2 L f_s), its mean square a twelfth of its square."""
        for R in (1e-4, 0.02, 0.04, 0.08):
            bridge, d = Bridge(replace(RE_25, R_ohm=R), 24.0, 100e3), np.array([0.01, 0.3, 0.5, 0.99])
            ripple = 24.0 * d * (1 - d) / (2 * RE_25.L_H * 100e3)
            assert bridge.peak_to_peak_A(d) == pytest.approx(ripple, rel=1e-5)
            assert bridge.ripple_square_A2(24.0 * d) == pytest.approx(ripple**2 / 12, rel=1e-5)

    @pytest.mark.parametrize("L_H", [0.05e-3, 0.238e-3, 2e-3])
    @pytest.mark.parametrize("switching_Hz", [10e3, 22.5e3, 100e3])
    def test_a_tap_heats_as_counted(self, L_H: float, switching_Hz: float) -> None:
        circuit = Circuit(0.74 * 2 * L_H * switching_Hz, L_H, 0.0)
        bridge = Bridge(circuit, 7.5 * L_H * switching_Hz, switching_Hz, 2 * np.pi * 0.05 * switching_Hz * L_H)
        check_heat(bridge, np.random.default_rng(3))

    @pytest.mark.parametrize("bridges", [4, pytest.param(300, marks=pytest.mark.long)])
    def test_a_tap_anywhere_in_the_range(self, bridges: int) -> None:
        random = np.random.default_rng(21)
        for _ in range(bridges):
            check_heat(drawn(random), random)

    def test_no_steady_current_heats_more_than_is_counted(self) -> None:
        """Nor 5 % less, but around zero with eddy currents, where Eq. 7 counts the square of its constant."""
        for bridge in (
            Bridge(RE_25, 24.0, 22.5e3),
            Bridge(replace(RE_25, L_H=0.05e-3), 10.0, 29.1e3),
            Bridge(RE_25, 15.0, 22.5e3, 1.5, 40.0),
        ):
            current = np.linspace(0.05, 1.0, 777) * bridge.rail_V / bridge.circuit.R_ohm
            truly = current**2 + bridge.ripple_square_A2(bridge.circuit.R_ohm * current)
            found = bridge.heat_factor * (current + bridge.ripple_A) ** 2
            assert (truly <= found).all()
            assert (found <= (1 + WITHIN) * truly).all()

    def test_the_jump_of_eddy_currents_makes_the_constant_of_the_seed(self) -> None:
        """0.02 A on a rail of 24 V is a resistance of 34 ohm across the inductance, a jump of 0.66 A."""
        bridge = Bridge(RE_25, 24.0, 100e3, 1.5, 33.9)
        assert bridge.ripple_A == pytest.approx(0.02, rel=0.01)
        assert Bridge(RE_25, 24.0, 100e3).ripple_A == 0


FAST = replace(RE_25, L_H=0.06e-3)


class TestRefusals:
    """Each by name, with value, limit and what to do next, which then works."""

    @pytest.mark.parametrize(
        ("refused", "words", "advised"),
        [
            pytest.param(
                lambda: Bridge(RE_25, 24.0, 22.5e3, 5.0),
                ("gain_V_A = 5 V/A", "3344 Hz", "at most 2250 Hz"),
                lambda to: Bridge(RE_25, 24.0, 22.5e3, to),
                id="a fast crossover",
            ),
            pytest.param(
                lambda: Bridge(RE_25, 24.0, 10.5e3),
                ("switching_Hz = 10500 Hz", "1.2 A peak to peak", "at most 1 A", "limits.supply_V to 20 V"),
                lambda to: (Bridge(RE_25, 24.0, to), Bridge(RE_25, 20.0, 10.5e3)),
                id="a large ripple",
            ),
            pytest.param(
                lambda: Bridge(RE_25, 48.0, 20e3, 1.0, 40.0),
                ("at most 1 A", " V,"),
                lambda to: Bridge(RE_25, to, 20e3, 1.0, 40.0),
                id="a ripple that no switching makes small",
            ),
            pytest.param(
                lambda: Bridge(FAST, 6.0, 15e3),
                ("33.3 us", "0.75 of", "27.5 us"),
                lambda to: Bridge(FAST, 6.0, to),
                id="a short time constant",
            ),
            pytest.param(
                lambda: Bridge(RE_25, 6.0, 80e3, 1.5, RE_25.R_ohm),
                ("R_eddy_ohm = 2.18 ohm: ",),  # below four times the winding's resistance
                lambda to: Bridge(RE_25, 6.0, 80e3, 1.5, to),
                id="eddy currents that short the winding",
            ),
        ],
    )
    def test_by_name_with_advice_that_works(
        self, refused: Callable[[], object], words: tuple[str, ...], advised: Callable[[float], object]
    ) -> None:
        with pytest.raises(InputError) as told:
            refused()
        for word in words:
            assert word in str(told.value)
        found = re.search(r"(?:(?:raise|lower) (?:it|limits\.supply_V) to|from) ([\d.e+]+) \S+", str(told.value))
        assert found, told.value
        advised(float(found[1]))

    @pytest.mark.parametrize("L_H", [0.049e-3, 2.1e-3])
    def test_an_inductance_beyond_the_range(self, L_H: float) -> None:
        with pytest.raises(InputError, match=r"holds from 5e-05 to 0\.002 H: take another motor, or state pole_Hz"):
            Bridge(replace(RE_25, L_H=L_H), 6.0, 100e3)
