"""The terms of the objective against their formulas, their gradients against differences."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.time_grid import TimeGrid
from transopt.problem.objective.error_term import ErrorTerm, plain, rapid, rapid_filter
from transopt.problem.objective.movement import HeatPrice, Movement
from transopt.problem.objective.target import Target
from transopt.problem.objective.tracking import Tracking, filter_together, gradients
from transopt.problem.objective.weighting import ErrorFilter, highpass, pacinian

N, M, L, DT_S = 40, 15, 3, 1e-4


def drawn(seed: int, *shape: int) -> FloatArray:
    return np.random.default_rng(seed).normal(size=shape)


def tap(seed: int) -> Target:
    """A target with lost samples and a tail."""
    return Target(drawn(seed, N), drawn(seed + 10, M), drawn(seed + 20, L))


def response(by: ErrorFilter | None, size: int) -> FloatArray:
    """Impulse response by its difference equation."""
    if by is None:
        return np.eye(1, size)[0]
    return np.asarray(signal.lfilter(by.b, by.a, np.eye(1, size)[0]))


TERMS = {
    "plain": (ErrorTerm("plain", np.linspace(0.0, 2.0, N), before=0.5, after=0.3),),
    "rapid": (ErrorTerm("rapid", np.linspace(0.0, 2.0, N), before=0.5, after=0.3, error_filter=pacinian(DT_S)),),
    "both": (
        ErrorTerm("plain", np.where(np.arange(N) < 20, 0.09, 0.0), before=0.09, after=0.0),
        ErrorTerm("rapid", np.ones(N), error_filter=highpass(20.0, DT_S)),
    ),
}


@pytest.mark.parametrize("kind", TERMS)
def test_costs_filtered_together_are_those_filtered_alone(kind: str) -> None:
    others = TERMS["plain"]  # terms of their own, in the same call
    together = [Tracking(tap(seed), TERMS[kind]) for seed in range(5)] + [Tracking(tap(5), others)]
    filter_together(together)
    for seed, found in enumerate(together):
        alone = Tracking(tap(seed), found.terms)
        np.testing.assert_allclose(found.wanted, alone.wanted, rtol=1e-13, atol=1e-13)
        np.testing.assert_array_equal(found.weights, alone.weights)
        assert found.energy_m2_s4 == pytest.approx(alone.energy_m2_s4, rel=1e-13)


@pytest.mark.parametrize("kind", TERMS)
def test_tracking_is_its_formula_and_its_gradient_the_difference(kind: str) -> None:
    term = Tracking(tap(1), TERMS[kind])
    accelerations = drawn(2, 3, N + M)
    whole = np.concatenate([term.target.before_m_s2, term.target.window_m_s2, term.target.after_m_s2])

    def squares(error: FloatArray) -> float:
        found = 0.0
        for each in TERMS[kind]:
            filtered = np.convolve(response(each.error_filter, error.size), error)[: error.size]
            weights = [*[each.before] * L, *each.weights, *[each.after] * M]
            found += sum(w * e**2 for w, e in zip(weights, filtered, strict=True))
        return found

    errors = [np.append(np.zeros(L), acceleration) - whole for acceleration in accelerations]
    expected = float(np.mean([squares(error) for error in errors])) / squares(whole)
    assert term.value(accelerations) == pytest.approx(expected, rel=1e-12)
    assert term.value(np.zeros((1, N + M))) == pytest.approx(1.0, rel=1e-12)

    direction, step = drawn(3, N + M), 1e-3
    ends = [np.vstack([accelerations[0] + sign * step * direction, accelerations[1:]]) for sign in (-1, 1)]
    # The sum is quadratic, so that the central difference is its slope.
    slope = (term.value(ends[1]) - term.value(ends[0])) / (2 * step)
    by_first = gradients([term], accelerations[None], np.full(3, 1 / 3))[0, 0]
    assert float(by_first @ direction) == pytest.approx(slope, rel=1e-9)


def test_a_perfect_copy_costs_nothing_but_what_is_lost() -> None:
    target = tap(4)
    term = Tracking(target, TERMS["both"])
    found = term.value(target.continued_m_s2[None])
    alone = Tracking(replace(target, before_m_s2=np.zeros(0)), TERMS["both"])
    assert alone.value(target.continued_m_s2[None]) < 1e-24
    # The filter goes on hearing the lost samples after they are over.
    assert found * term.energy_m2_s4 > term.lost_m2_s4
    assert not replace(term, target=Target(np.zeros(N), np.zeros(M), np.zeros(L))).unit_wanted.any()


def test_the_plain_term_ends_with_the_intention_and_a_targets_never() -> None:
    grid = TimeGrid(DT_S, 600, 3e-4, 0.0, 100)
    of_a_hand, of_a_target = plain(0.09, grid, 30e-3), plain(1.0, grid, np.inf)
    np.testing.assert_array_equal(of_a_hand.weights > 0, grid.switching_times_s < 30e-3 - 1e-12)
    assert (of_a_hand.before, of_a_hand.after) == (0.09, 0.0)
    assert of_a_target.weights.min() == of_a_target.after == 1.0
    # A tap's window that ends before the intention leaves the plain error of the tail out all the same.
    short = plain(0.09, TimeGrid(DT_S, 200, 3e-4, 0.0, 100), 30e-3)
    assert (short.weights.min(), short.after) == (0.09, 0.0)


@pytest.mark.parametrize("dt_s", [1e-4, 2e-4, 3e-4, 5e-4])
def test_the_plain_term_has_no_instant_at_the_intentions_end(dt_s: float) -> None:
    """The instant at 30 ms is off by a rounding error, which may be of either sign."""
    times_s = dt_s * np.arange(-1, 199)
    assert np.count_nonzero(plain(0.09, TimeGrid(dt_s, 200, dt_s, 0.0, 0), 30e-3).weights) == np.count_nonzero(
        times_s < 30e-3 - 0.1 * dt_s
    )


@pytest.mark.parametrize("dt_s", [2e-5, 1e-4, 1e-3])
def test_the_high_pass_is_butterworths(dt_s: float) -> None:
    by = highpass(20.0, dt_s)
    b, a = signal.butter(2, 20.0, "highpass", fs=1 / dt_s)
    np.testing.assert_allclose([by.b, by.a], [b, a], rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "from_Hz", "said"),
    [
        ("loud", 20.0, r"weights\.rapid = 'loud': unknown; choose highpass, pacinian or none"),
        ("highpass", 5000.0, r"weights\.rapid_from_Hz = 5000 Hz: must be above 0 and below half the servo rate"),
    ],
)
def test_a_filter_that_there_is_not_is_refused(kind: str, from_Hz: float, said: str) -> None:
    with pytest.raises(InputError, match=said):
        rapid_filter(kind, from_Hz, DT_S)


def test_the_rapid_term_counts_every_sample_as_it_is() -> None:
    by = rapid_filter("highpass", 20.0, DT_S)
    assert by is not None
    term = rapid(by, TimeGrid(DT_S, N, 0.0, 0.0))
    assert set(term.all_weights(L, M)) == {1.0}
    assert rapid_filter("none", 20.0, DT_S) is None


def test_the_price_on_heat_is_its_formula_and_its_gradient_the_difference() -> None:
    heat, current, direction = HeatPrice(2e-3), drawn(7, N), drawn(8, N)
    assert heat.value(current) == pytest.approx(2e-3 * sum(i * i for i in current), rel=1e-12)
    slope = (heat.value(current + 1e-3 * direction) - heat.value(current - 1e-3 * direction)) / 2e-3
    assert float(heat.gradient(current) @ direction) == pytest.approx(slope, rel=1e-9)


def test_movement_is_its_formula_and_its_gradient_the_difference() -> None:
    term = Movement(rho=3e-3, stages=N, dt_s=2e-4, input_limit=1.25)
    command, direction, step = drawn(5, N), drawn(6, N), 1e-3
    movement = [command[0], *(after - before for before, after in pairwise(command))]
    expected = 3e-3 / (N * 1.25**2) * sum((dc * 1e-4 / 2e-4) ** 2 for dc in movement)
    assert term.value(command) == pytest.approx(expected, rel=1e-12)
    slope = (term.value(command + step * direction) - term.value(command - step * direction)) / (2 * step)
    assert float(term.gradient(command) @ direction) == pytest.approx(slope, rel=1e-9)


def test_a_tap_that_is_zero_where_it_counts_asks_for_nothing() -> None:
    """Beside what the weights leave of such a tap, the rounding of the rest is all."""
    late, t = np.where(np.arange(N) < N // 2, 0.0, 1.0), np.arange(N) * DT_S
    for size_m_s2, counts in ((2e-3, True), (5e-4, False)):
        target = Target(np.where(late > 0, size_m_s2, 100 * np.sin(2 * np.pi * 500 * t)))
        for scale in (1e-8, 1.0, 1e8):
            tracking = Tracking(target, (ErrorTerm("plain", scale * late, after=0.0),))
            assert tracking.counts_nothing is not counts
    assert Tracking(target, (ErrorTerm("plain", np.zeros(N), after=0.0),)).counts_nothing
    assert not Tracking(target, (ErrorTerm("plain", np.ones(N), after=0.0),)).counts_nothing
