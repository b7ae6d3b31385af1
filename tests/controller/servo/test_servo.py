"""The servo tick by tick: states, faults, limits, feedback, phase."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.servo.interface import Notice, Readings, State
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank, Method, bank
from tests.benches.oracle.servo import Servo
from tests.benches.servo import AMPLIFIER, CONTACT, COUNT_M, DECAY, DT_S, WALL, Bench, tap_m
from transopt.base.errors import InputError
from transopt.library.library import Library
from transopt.plant.wall import FeedbackLoop

NAN, INF = math.nan, math.inf


def test_a_tap_runs_through_the_states(bench: Bench) -> None:
    assert bench.servo.state is State.ARMED
    bench.run(CONTACT + 1200)
    states = [output.state for output in bench.outputs]
    first = states.index(State.PLAYING)
    assert first in (CONTACT - 4, CONTACT - 3)
    # 800 samples, blended over one tick more.
    assert states.count(State.PLAYING) in (799, 800)
    # The library was designed without this wall, whose feedback may add to the limit.
    events = [event for event in bench.events() if event is not Notice.COMMAND_SATURATED]
    assert events == [Notice.CONTACT, Notice.FINISHED]
    bench.servo.disarm()
    assert bench.step().command_A == 0.0
    assert bench.servo.state is State.IDLE


@pytest.mark.parametrize(("part", "speed_m_s"), [(0.0, 0.1), (0.13, 0.37), (0.92, 0.2)])
def test_phase_is_exact_resampling_of_the_held_commands(
    stated: Settings, tables: Bank, part: float, speed_m_s: float
) -> None:
    """Each command is the mean, over its period, of the waveform held from its own instant on."""
    bench = Bench(stated, tables, lambda k: tap_m(k, speed_m_s, CONTACT + part))
    bench.servo.arm()
    while not bench.events():
        bench.step()
    due = bench.tick - 1 - bench.servo.approach.phase
    contact = bench.outputs[-1].events[0]
    assert contact.speed_m_s == pytest.approx(speed_m_s, rel=0.01)
    # A speed near 1.5 counts per tick lets the rounding beat slowly through the window: a tenth of a tick.
    assert due == pytest.approx(CONTACT + part - 3, abs=0.2)
    started = bench.tick - 1
    bench.run(900)
    samples = np.array(bench.servo.play.samples_A)
    charge = np.concatenate([[0.0], np.cumsum(samples)])
    ticks = np.arange(len(bench.outputs) + 1)
    wanted = np.diff(np.interp(ticks, due + np.arange(801), charge))
    # The first part of the first period is lost where the last reading moved the contact by a little.
    wanted[:started] = 0.0
    np.testing.assert_allclose(bench.commands(), wanted, atol=1e-9)


@pytest.mark.parametrize("latency_ticks", [0, 3])
def test_feedback_is_the_walls_law(stated: Settings, library: Library, latency_ticks: int) -> None:
    wall = replace(WALL, latency_ticks=latency_ticks)
    bench = Bench(replace(stated, wall=wall), bank(library, Method.PROPORTIONAL))
    bench.servo.arm()
    bench.run(CONTACT + 1000)
    first = 300  # by then the filter has settled on the straight approach: 0.73^300
    z = np.round([tap_m(k) / COUNT_M for k in range(CONTACT + 1000)]) * COUNT_M
    loop = FeedbackLoop(wall, stated.amplifier, DT_S, np.array([z[first]]), np.array([0.3]))
    wanted = [float(loop.step(np.array([value]))[0]) for value in z[first:]]
    start = CONTACT - first + 50
    assert max(wanted) > 0.2
    assert Notice.COMMAND_SATURATED not in bench.events()
    np.testing.assert_allclose(bench.commands()[first + start :], wanted[start:], atol=1e-12)


def test_a_cut_leaves_no_windup(stated: Settings, library: Library) -> None:
    """Deep in a stiff wall the current rests at its limit and comes down with the wanted one, without overshoot."""
    stiff = replace(WALL, stiffness_N_m=5000.0, damping_N_s_m=0.0)
    bench = Bench(replace(stated, wall=stiff), bank(library, Method.PROPORTIONAL))
    bench.servo.arm()
    currents = []
    for _ in range(CONTACT + 1800):
        bench.step()
        currents.append(bench.current_A)
    z = np.round([tap_m(k) / COUNT_M for k in range(CONTACT + 1800)]) * COUNT_M
    wanted = np.append(0.0, np.clip(-stiff.stiffness_N_m * np.minimum(z, 0) / 1.25, 0, 4.0)[:-1])
    assert np.sum(wanted == 4.0) > 1000
    np.testing.assert_allclose(currents, wanted, atol=1e-9)
    assert bench.servo.counts[Notice.COMMAND_SATURATED] == 1


READING = st.builds(
    Readings,
    st.integers(0, 10**9),
    st.one_of(st.integers(-300, 300), st.integers(), st.sampled_from([NAN, INF, -INF])),  # type: ignore[arg-type]
    st.one_of(st.floats(0, 10), st.floats()),
    st.one_of(st.floats(-4, 4), st.floats()),
    st.floats(),
    st.booleans(),
)


@settings(max_examples=150, deadline=None)
@given(st.lists(READING, min_size=1, max_size=40), st.booleans())
def test_absurd_readings_never_make_an_absurd_command(
    stated: Settings, tables: Bank, readings: list[Readings], keen: bool
) -> None:
    servo = Servo(replace(stated, wall=WALL, window_ticks=4, rearm_s=DT_S), tables)
    for reading in readings:
        if keen:
            servo.reset()
        servo.arm()
        output = servo.step(reading)
        assert abs(output.command_A) <= 6.0
        assert abs(servo.expected_A) <= 4.0 + 1e-12
        assert output.winding_C <= 1000.0
        if output.state in (State.FAULT, State.IDLE):
            assert output.command_A == 0.0


@pytest.mark.parametrize("slew_A_per_s", [None, 5000.0])
@pytest.mark.parametrize("seed", range(2))
def test_limits_hold_whatever_the_hand_does(
    stated: Settings, tables: Bank, seed: int, slew_A_per_s: float | None
) -> None:
    """A wild hand on a stiff wall: command, predicted current and slew stay inside."""
    rng = np.random.default_rng(seed)
    z = 3e-3 * np.cumsum(np.convolve(rng.standard_normal(4000), np.ones(30) / 30, "same")) / 30
    wall = replace(WALL, stiffness_N_m=4000.0, damping_N_s_m=20.0)
    made = replace(stated, wall=wall, slew_limit_A_per_s=slew_A_per_s, rearm_s=1e-3, rearm_height_m=1e-4)
    bench = Bench(made, tables, lambda k: float(z[int(k)]))
    bench.servo.arm()
    bench.run(z.size)
    assert bench.servo.fault is None
    assert Notice.COMMAND_SATURATED in bench.events()
    command = np.array(bench.commands())
    assert np.abs(command).max() <= 6.0
    assert np.abs([bench.servo.expected_A]).max() <= 4.0 + 1e-12
    current = 0.0
    for k, c in enumerate(command.tolist()):
        current = DECAY * current + (1 - DECAY) * c
        assert abs(current) <= 4.0 + 1e-12, k
    if slew_A_per_s is not None:
        # The current limit comes first, so the slew may be left where that one pulls.
        steps = np.abs(np.diff(command))
        assert np.mean(steps <= slew_A_per_s * DT_S + 1e-9) > 0.95


@pytest.mark.parametrize("off", [-0.2, 0.0, 0.2])
def test_the_limit_holds_for_every_pole_within_the_tolerance(stated: Settings, tables: Bank, off: float) -> None:
    """An amplifier that is faster or slower than the model, under a wild hand on a stiff wall."""
    rng = np.random.default_rng(3)
    z = 3e-3 * np.cumsum(np.convolve(rng.standard_normal(4000), np.ones(30) / 30, "same")) / 30
    wall = replace(WALL, stiffness_N_m=4000.0, damping_N_s_m=20.0)
    peaks = []
    for tolerance in (0.2, 0.0):
        made = replace(stated, wall=wall, amplifier_tolerance=tolerance)
        bench = Bench(made, tables, lambda k: float(z[int(k)]))
        bench.servo.arm()
        decay, current, peak = math.exp(-AMPLIFIER.rate_rad_s * DT_S * (1 + off)), 0.0, 0.0
        for c in bench.run(z.size).commands():
            current = decay * current + (1 - decay) * c
            peak = max(peak, abs(current))
        peaks.append(peak)
    assert peaks[0] <= 4.0 + 1e-12
    assert (peaks[1] > 4.04) == (off > 0)


def test_out_of_grid_and_grip_are_told(stated: Settings, tables: Bank) -> None:
    fast = Bench(stated, tables, lambda k: tap_m(k, 0.7))
    fast.servo.arm()
    fast.run(CONTACT + 5)
    assert fast.events() == [Notice.CONTACT, Notice.OUT_OF_GRID]
    edge = Bench(stated, tables, lambda k: tap_m(k, 0.402))
    edge.servo.arm()
    edge.grip_N = 5.06  # within what the sensors are worth
    edge.run(CONTACT + 5)
    assert edge.events() == [Notice.CONTACT]
    loose = Bench(stated, tables)
    loose.servo.arm()
    loose.grip_N = 0.3
    loose.run(CONTACT + 300)
    assert loose.events() == [Notice.NO_GRIP]
    assert not any(loose.commands())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dt_s": 0.0}, r"servo: dt_s = 0: must be > 0 and finite"),
        ({"current_limit_A": math.nan}, r"servo: current_limit_A = nan: must be > 0 and finite"),
        ({"lead_s": -1e-4}, r"servo: lead_s = -0.0001: must be >= 0 and finite"),
        ({"amplifier_tolerance": 1.0}, r"servo: amplifier_tolerance = 1: must be below 1"),
        ({"window_ticks": 3}, r"servo: window_ticks = 3: a quadratic needs at least 4 readings"),
        ({"surface_counts": math.inf}, r"servo: surface_counts and grip_open_N must be finite"),
    ],
)
def test_settings_are_checked(stated: Settings, change: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(stated, **change)  # type: ignore[arg-type]
