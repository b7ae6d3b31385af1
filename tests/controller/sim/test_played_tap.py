"""The experiment: nominal taps played open loop, users."""

from dataclasses import replace

import numpy as np
import pytest

from controller.servo.interface import Event, Fault, Notice, Output, Readings, State
from controller.servo.settings import Settings
from controller.sim.played_tap import Played, play_tap
from controller.sim.simulated_tap import SimulatedTap, approach_ticks
from controller.sim.simulator import Imperfections
from controller.sim.true_device import Ground
from controller.waveforms.bank import bank
from controller.waveforms.prediction import predict
from tests.benches.oracle.servo import Servo
from transopt.base.errors import InputError
from transopt.base.signals import nrmse
from transopt.library.library import Library
from transopt.library.place import speed_weights
from transopt.references.references import References

DT = 1e-4
LEAD_TICKS = 3


class Player:
    """Plays a library's command from a tick that is known in advance; all that a servo has to find out is given."""

    def __init__(
        self, library: Library, speed_m_s: float, grip_N: float, *, late: int = 0, gain: float = 1.0
    ) -> None:
        self._command = (gain * library.at(speed_m_s, grip_N).command).tolist()
        self._first = approach_ticks(speed_m_s, DT) - LEAD_TICKS + late
        self.armed = False

    def arm(self) -> None:
        self.armed = True

    def step(self, readings: Readings) -> Output:
        assert self.armed
        k = readings.tick - self._first
        if not 0 <= k < len(self._command):
            return Output(0.0, State.ARMED, 0.0, 0.0, 25.0)
        events = (Event(readings.tick, Notice.CONTACT, 0.2, 3.0),) if k == 0 else ()
        return Output(self._command[k], State.PLAYING, self._command[k], 0.0, 25.0, events)


def play(library: Library, speed_m_s: float, grip_N: float, late: int = 0, **options: object) -> Played:
    tap = SimulatedTap(speed_m_s, grip_N, phase=0.0, **options)  # type: ignore[arg-type]
    return play_tap(library, Player(library, speed_m_s, grip_N, late=late, gain=tap.gain), tap)


class TestPrediction:
    def test_at_a_node_it_is_the_library(self, library: Library) -> None:
        found = predict(library, 0.3, 5.0)
        np.testing.assert_array_equal(found.acceleration_m_s2, library.acceleration_m_s2[2, 2])
        np.testing.assert_array_equal(found.reference_m_s2, library.uncorrected(2, 2).window_m_s2)
        assert found.floor == library.floor[2, 2]

    def test_replay_at_a_node_agrees_with_the_library(self, library: Library) -> None:
        half = predict(library, 0.3, 5.0, gain=0.5)
        peak = np.abs(library.acceleration_m_s2[2, 2]).max()
        np.testing.assert_allclose(
            2 * half.acceleration_m_s2, library.acceleration_m_s2[2, 2], rtol=0, atol=1e-8 * peak
        )

    def test_reference_between_speeds_follows_the_rule_of_the_references(
        self, library: Library, recorded: References
    ) -> None:
        found = predict(library, 0.27, 2.0)
        expected = recorded.at(0.27, 2.0)
        np.testing.assert_allclose(found.reference_m_s2, expected.target.window_m_s2, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.own_m_s2, expected.free_m_s2, rtol=0, atol=1e-9)
        np.testing.assert_allclose(speed_weights(np.array([0.1, 0.2]), 0.2), [0.0, 1.0])

    def test_outside_the_grid_it_is_the_edge_and_below_the_least_grip_silence(self, library: Library) -> None:
        found = predict(library, 0.9, 20.0)
        assert (found.speed_m_s, found.grip_N) == (0.4, 5.0)
        silent = predict(library, 0.2, 0.1)
        assert silent.silent
        assert not np.any(silent.acceleration_m_s2)


class TestNominalTap:
    @pytest.mark.parametrize(("speed", "grip"), [(0.1, 1.0), (0.2, 3.0), (0.4, 5.0)])
    def test_at_the_nodes(self, library: Library, speed: float, grip: float) -> None:
        m = play(library, speed, grip)
        assert abs(m.latency_s) < 1e-8
        assert m.playback_error < 1e-6
        iv, ig = list(library.speeds_m_s).index(speed), list(library.grips_N).index(grip)
        assert m.tap_error == pytest.approx(library.tap_error[iv, ig], abs=1e-6)
        assert m.peak_current_A == pytest.approx(library.peak_input[iv, ig], abs=1e-9)
        assert m.winding_C.max() == pytest.approx(library.peak_temperature_C[iv, ig], abs=1e-3)
        assert m.notices == {Notice.CONTACT: 1}

    @pytest.mark.parametrize(("speed", "grip"), [(0.15, 2.0), (0.33, 4.1)])
    def test_between_the_nodes(self, library: Library, speed: float, grip: float) -> None:
        m = play(library, speed, grip)
        assert m.playback_error < 1e-5
        assert m.tap_error < 0.4

    @pytest.mark.parametrize("late", [-2, 1, 5])
    def test_late_ticks_are_latency_not_error(self, library: Library, late: int) -> None:
        m = play(library, 0.2, 3.0, late=late)
        assert m.latency_s == pytest.approx(late * DT, abs=1e-7)
        assert m.playback_error < 1e-4

    def test_phase_is_latency_when_nobody_blends(self, library: Library) -> None:
        tap = SimulatedTap(0.2, 3.0, phase=0.37)
        m = play_tap(library, Player(library, 0.2, 3.0), tap)
        assert m.latency_s == pytest.approx(-0.37 * DT, abs=1e-7)
        # Kinks of the held command meet the spline between its knots.
        assert m.playback_error < 1e-3

    def test_same_seed_same_tap_and_phase_of_its_own(self, library: Library) -> None:
        def once(seed: int) -> Played:
            tap = SimulatedTap(0.2, 3.0, seed=seed, imperfections=Imperfections(mismatch=0.1))
            return play_tap(library, Player(library, 0.2, 3.0), tap)

        first, second, other = once(1), once(1), once(2)
        assert first.latency_s == second.latency_s
        np.testing.assert_array_equal(first.acceleration_m_s2, second.acceleration_m_s2)
        assert other.latency_s != first.latency_s


class TestUsersAndImperfections:
    def test_a_hand_that_departs_from_the_assumption_costs(self, library: Library) -> None:
        """Nothing until it can react, tens of percent of the whole window where the hand stops dead then."""
        yielding = play(library, 0.3, 3.0, yields="brakes")
        stopping = play(library, 0.3, 3.0, yields="stops")
        assert 0.02 < yielding.playback_error < 0.4 < stopping.playback_error
        assert yielding.tap_error == pytest.approx(stopping.tap_error, abs=0.01)
        before = (yielding.times_s > 0) & (yielding.times_s < 0.029)
        np.testing.assert_allclose(
            yielding.acceleration_m_s2[before], stopping.acceleration_m_s2[before], rtol=0, atol=1e-9
        )

    @pytest.mark.parametrize(
        "imperfections",
        [
            Imperfections(crossover_A=0.02),
            Imperfections(mismatch=0.05),
            Imperfections(ground=Ground(damping_N_s_m=0.2)),
            Imperfections(ground=Ground(friction_N=0.05)),
        ],
    )
    def test_each_imperfection_is_felt_but_small(self, library: Library, imperfections: Imperfections) -> None:
        m = play(library, 0.2, 3.0, imperfections=imperfections, seed=1)
        assert 1e-4 < m.playback_error < 0.1

    def test_unmodelled_friction_costs_what_was_measured_before_building(self, library: Library) -> None:
        """2 N s/m of viscous friction to ground that the model lacks cost 10 %."""
        imperfections = Imperfections(crossover_A=0.0, ground=Ground(damping_N_s_m=2.0))
        assert play(library, 0.3, 3.0, imperfections=imperfections).playback_error == pytest.approx(0.1, abs=0.04)


class TestNothingPlayed:
    def test_too_little_grip(self, library: Library) -> None:
        m = play(library, 0.2, 0.1)
        assert not m.played
        assert np.isnan(m.latency_s)
        assert m.peak_current_A == 0.0

    def test_fault(self, library: Library) -> None:
        class Broken(Player):
            def step(self, readings: Readings) -> Output:
                if readings.tick < 100:
                    return Output(0.0, State.ARMED, 0.0, 0.0, 25.0)
                events = (Event(readings.tick, Fault.EMERGENCY_STOP),) if readings.tick == 100 else ()
                return Output(0.0, State.FAULT, 0.0, 0.0, 25.0, events)

        m = play_tap(library, Broken(library, 0.2, 3.0), SimulatedTap(0.2, 3.0))
        assert m.faults == (Fault.EMERGENCY_STOP,)


def test_gain_scales_the_prediction_of_the_real_servo_alike(library: Library) -> None:
    servo = Servo(Settings.of(library), bank(library))
    servo.set_gain(0.5)
    assert play_tap(library, servo, SimulatedTap(0.3, 3.0, gain=0.5)).playback_error < 0.03


def test_alignment_is_the_least_error_over_all_shifts(library: Library) -> None:
    """No shift on a fine raster beats the one found, on a mismatched device."""
    played = play(library, 0.3, 3.0, imperfections=Imperfections(mismatch=0.2), seed=4)
    times, predicted = played.prediction.times_s, played.prediction.acceleration_m_s2
    errors = [
        nrmse(np.interp(times + shift, played.times_s, played.acceleration_m_s2), predicted)
        for shift in np.arange(-1e-3, 1e-3, 5e-6)
    ]
    assert played.playback_error <= min(errors) + 1e-4


def test_a_library_of_another_version_is_refused_in_one_line(library: Library) -> None:
    scene = {**library.meta["scene"], "thermal": {"idle_A": 0.0}}
    with pytest.raises(
        InputError, match=r"meta\.scene: thermal: idle_A flows in the pauses .*; solve the scene again"
    ):
        replace(library, meta={**library.meta, "scene": scene}).scene()
