"""Waveforms by method, against independent formulas."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.waveforms import predecessors
from controller.waveforms.bank import Bank, Method, bank
from tests.benches.oracle.blend import blend_at
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.build import Build
from transopt.library.library import Library
from transopt.problem.warm_coil import currents


@pytest.fixture(scope="module")
def banks(library: Library) -> dict[Method, Bank]:
    return {method: bank(library, method) for method in Method}


@settings(max_examples=50, deadline=None)
@given(st.floats(0.01, 1.0), st.floats(0.5, 12.0))
def test_bilinear_plays_what_the_library_says(
    library: Library, banks: dict[Method, Bank], speed_m_s: float, grip_N: float
) -> None:
    play, waveform = blend_at(banks[Method.BILINEAR], speed_m_s, grip_N), library.at(speed_m_s, grip_N)
    np.testing.assert_allclose(play.samples_A, waveform.transient_command, rtol=0, atol=1e-12)
    assert play.out_of_grid == (waveform.speed_clamped or waveform.grip_clamped)
    assert (play.speed_m_s, play.grip_N) == pytest.approx((waveform.speed_m_s, waveform.grip_N))
    assert not play.silent


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize(
    ("speed_m_s", "grip_N"),
    [(0.0, 3.0), (-0.2, 3.0), (np.nan, 3.0), (0.2, 0.49), (0.2, np.nan), (0.2, -np.inf)],
)
def test_nothing_plays_without_speed_or_grip(
    banks: dict[Method, Bank], method: Method, speed_m_s: float, grip_N: float
) -> None:
    play = blend_at(banks[method], speed_m_s, grip_N)
    assert play.silent
    assert play.samples_A == []


def test_the_free_device_needs_no_grip(library: Library) -> None:
    assert not blend_at(replace(bank(library), grip_min_N=0.0), 0.2, 0.0).silent


def test_nearest_takes_one_node(library: Library, banks: dict[Method, Bank]) -> None:
    play = blend_at(banks[Method.NEAREST], 0.26, 1.9)
    np.testing.assert_array_equal(play.samples_A, library.transient_command[2, 0])
    assert (play.speed_m_s, play.grip_N) == (0.3, 1.0)


def test_blind_has_one_grip(library: Library, banks: dict[Method, Bank]) -> None:
    play, other = blend_at(banks[Method.BLIND], 0.23, 1.0), blend_at(banks[Method.BLIND], 0.23, 50.0)
    assert play.samples_A == other.samples_A
    assert not other.out_of_grid
    np.testing.assert_allclose(play.samples_A, library.at(0.23, 3.0).transient_command, atol=1e-12)
    with pytest.raises(InputError, match=r"blind grip 9 N: the library covers 1 to 5 N"):
        bank(library, Method.BLIND, blind_grip_N=9.0)


def test_proportional_plays_no_transient(banks: dict[Method, Bank]) -> None:
    play = blend_at(banks[Method.PROPORTIONAL], 0.2, 3.0)
    assert not play.silent
    assert play.samples_A == []


@pytest.mark.parametrize("method", Method)
def test_every_method_keeps_the_current_limit(library: Library, banks: dict[Method, Bank], method: Method) -> None:
    current = currents(banks[method].command_A, library.amplifier(), 1e-4)
    assert np.abs(current).max(initial=0.0) <= library.input_limit + 1e-6


def test_baselines_are_those_whose_errors_a_report_tells(
    build: Build, library: Library, banks: dict[Method, Bank]
) -> None:
    for method, stored in (
        (Method.SEED_INVERSION, "seed"),
        (Method.CLIPPED_OPTIMUM, "clipped"),
    ):
        for ig in range(library.grips_N.size):
            acceleration, _ = library.stage(ig).rollout(banks[method].command_A[:, ig])
            for iv in range(library.speeds_m_s.size):
                found = library.yardstick.tap_error(library.uncorrected(iv, ig), acceleration[iv])
                told = getattr(build.entries[iv][ig].baselines, stored).tap_error
                assert found == pytest.approx(told, abs=1e-6)


def asking_for(library: Library, shape: FloatArray) -> Library:
    """The library with taps of one shape (N,) at all its nodes, in proportion to the speed."""
    recorded = np.broadcast_to(library.speeds_m_s[:, None, None] * shape, library.command.shape)
    return replace(library, recorded_m_s2=recorded, free_m_s2=np.zeros_like(recorded))


def test_decaying_sinusoid_finds_its_own_parameters(library: Library) -> None:
    t = np.maximum(library.time_grid().switching_times_s, 0)
    shape = 300 * np.exp(-90 * t) * np.sin(2 * np.pi * 110 * t)
    made = asking_for(library, shape)
    assert predecessors.fitted_sinusoid(made) == pytest.approx((110, 90, 300), rel=1e-4)
    command = predecessors.decaying_sinusoid(made, 0.02)
    issued = library.time_grid().issue_times_s
    wanted = 0.02 * 0.1 * 300 * np.exp(-90 * issued) * np.sin(2 * np.pi * 110 * issued)
    np.testing.assert_allclose(command[0, 3:-10], wanted[3:-10], atol=1e-4)
    assert not command[:, :3].any()
    assert not command[:, -10:].any()


def test_fixed_width_pulse_is_the_best_rectangle_and_scales_with_speed(library: Library) -> None:
    t = library.time_grid().switching_times_s
    made = asking_for(library, np.where((t >= 0) & (t < 4e-3), 100.0, 0.0))
    width, amplitude = predecessors.fitted_pulse(made)
    assert (width, amplitude) == (40, pytest.approx(100.0))
    command = predecessors.fixed_width_pulse(made, 0.02)
    np.testing.assert_allclose(command[:, 3:43], 0.02 * 100 * library.speeds_m_s[:, None] * np.ones((1, 40)))
    assert not command[:, 43:].any()


@pytest.mark.parametrize("inertia_A_s2_m", [0.004, 0.032])
def test_momentum_cancellation_has_the_impulse_of_the_moving_mass(library: Library, inertia_A_s2_m: float) -> None:
    command = predecessors.momentum_cancellation(library, inertia_A_s2_m)
    np.testing.assert_allclose(command.sum(axis=1) * 1e-4, inertia_A_s2_m * library.speeds_m_s, rtol=1e-12)
    # The impulse is given as quickly as possible: at the limit from the contact on, but for the last tick.
    for row in command:
        on = row[row != 0]
        assert np.all(on[:-1] == library.input_limit)
        assert not row[:3].any()


def test_inertia_is_that_of_motor_and_stylus(library: Library) -> None:
    """14 g + 26 g at 1.25 N/A; the hand's skin and the transmission shift it by little."""
    assert predecessors.inertia(library) == pytest.approx(0.040 / 1.25, rel=0.05)
