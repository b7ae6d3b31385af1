"""The trade's figures of a click, against accelerations whose figures are known on paper."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

from tests.benches.actuators import clicks
from transopt.library.library import Library
from transopt.library.trade import TradeFigures, trade_figures, trade_of
from transopt.problem.objective.target import Target

DT_S = 1e-6
TAU_S, OMEGA = 8e-3, 2 * np.pi * 200.0
TARGET_S = 10e-3  # an asked-for pulse of constant size until then
WINDOW, AFTER = 40_000, 20_000


def ringing(t: float | np.ndarray) -> np.ndarray:
    """A decaying sinusoid from 0 on: what an actuator does that is struck once."""
    return np.exp(-np.asarray(t) / TAU_S) * np.sin(OMEGA * np.asarray(t))


@pytest.fixture(scope="module")
def figures() -> TradeFigures:
    t = DT_S * np.arange(WINDOW + AFTER)
    asked = (t <= TARGET_S + DT_S / 2).astype(float)
    return trade_of(ringing(t), Target(asked[:WINDOW], asked[WINDOW:]), DT_S)


def extreme_s(n: int) -> float:
    """The n-th extreme lies where tan(w t) = w tau."""
    return float((np.arctan(OMEGA * TAU_S) + n * np.pi) / OMEGA)


PEAK = float(ringing(extreme_s(0)))


def crossing_s(level: float, after_s: float, before_s: float) -> float:
    return float(optimize.brentq(lambda t: abs(ringing(t)) - level, after_s, before_s, xtol=1e-12))


def test_peak_and_end_of_the_target(figures: TradeFigures) -> None:
    assert figures.peak_m_s2 == pytest.approx(PEAK, rel=1e-6)
    assert figures.target_ends_s == pytest.approx(TARGET_S, abs=DT_S / 2)


def test_rise_is_from_a_tenth_to_nine_tenths_of_the_peak(figures: TradeFigures) -> None:
    wanted = crossing_s(0.9 * PEAK, 0.0, extreme_s(0)) - crossing_s(0.1 * PEAK, 0.0, extreme_s(0))
    assert figures.rise_s == pytest.approx(wanted, abs=1e-3 * DT_S)


def test_duration_and_brake_end_where_it_is_last_a_tenth_of_the_peak(figures: TradeFigures) -> None:
    last = max(n for n in range(20) if abs(ringing(extreme_s(n))) > 0.1 * PEAK)
    gone = crossing_s(0.1 * PEAK, extreme_s(last), (last + 1) * np.pi / OMEGA)
    begun = crossing_s(0.1 * PEAK, 0.0, extreme_s(0))
    assert gone > TARGET_S  # it does ring on
    assert figures.duration_s == pytest.approx(gone - begun, abs=1e-3 * DT_S)
    assert figures.brake_s == pytest.approx(gone - TARGET_S, abs=0.6 * DT_S)


def test_pulse_to_ring_is_peak_to_peak_over_peak_to_peak(figures: TradeFigures) -> None:
    # 10 ms are two whole periods: extremes 0 and 1 are the pulse's largest, 4 and 5 the ring's.
    pulse, ring = (float(ringing(extreme_s(n)) - ringing(extreme_s(n + 1))) for n in (0, 4))
    assert figures.pulse_to_ring == pytest.approx(pulse / ring, rel=1e-5)
    assert figures.pulse_to_ring == pytest.approx(np.exp(TARGET_S / TAU_S), rel=1e-5)


def test_energy_of_the_ring(figures: TradeFigures) -> None:
    def energy(from_s: float) -> float:
        """Integral of exp(-2 t / tau) sin^2(w t) from there to infinity, whole periods from 0."""
        s = 2 / TAU_S
        return float(np.exp(-s * from_s) * (1 / s - s / (s**2 + 4 * OMEGA**2)) / 2)

    left = energy(DT_S * (WINDOW + AFTER))  # 60 ms are whole periods too
    assert figures.ring_energy_m2_s3 == pytest.approx(energy(TARGET_S) - left, rel=1e-4)
    assert figures.ring_share == pytest.approx((energy(TARGET_S) - left) / (energy(0.0) - left), rel=1e-4)


def test_an_end_that_is_stated_is_taken(figures: TradeFigures) -> None:
    t = DT_S * np.arange(WINDOW + AFTER)
    asked = (t <= TARGET_S + DT_S / 2).astype(float)
    later = trade_of(ringing(t), Target(asked[:WINDOW], asked[WINDOW:]), DT_S, TARGET_S + 5e-3)
    assert later.target_ends_s == pytest.approx(TARGET_S + 5e-3, abs=DT_S / 2)
    # A period later the ring is smaller by its decay, and there is as much less to brake.
    assert later.pulse_to_ring == pytest.approx(figures.pulse_to_ring * np.exp(5e-3 / TAU_S), rel=1e-5)
    assert figures.brake_s - later.brake_s == pytest.approx(5e-3, abs=1e-3 * DT_S)


def test_what_rings_to_the_end_was_not_seen_to_brake() -> None:
    t = 1e-4 * np.arange(200)
    found = trade_of(np.sin(OMEGA * t), Target((t < 5e-3).astype(float)), 1e-4)
    assert found.brake_s == np.inf
    assert found.pulse_to_ring == pytest.approx(1.0, rel=0.01)


def test_what_ends_before_its_target_needs_no_brake_and_has_no_ring() -> None:
    t = 1e-4 * np.arange(200)
    found = trade_of(np.where(t < 5e-3, np.sin(OMEGA * t), 0.0), Target((t < 10e-3).astype(float)), 1e-4)
    assert found.brake_s == 0.0
    assert found.pulse_to_ring == np.inf
    assert found.ring_share == 0.0


def test_nothing_after_the_target_is_no_ring_of_zero() -> None:
    t = 1e-4 * np.arange(100)
    assert np.isnan(trade_of(np.sin(OMEGA * t), Target(np.ones(t.size)), 1e-4).pulse_to_ring)


def test_an_actuator_that_stands_still() -> None:
    found = trade_of(np.zeros(50), Target(np.ones(20), np.zeros(30)), 1e-4)
    assert [found.peak_m_s2, found.brake_s, found.ring_energy_m2_s3] == pytest.approx([0, 0, 0])
    assert np.isnan([found.rise_s, found.duration_s, found.pulse_to_ring]).all()


def test_a_target_of_zero() -> None:
    assert trade_of(np.zeros(50), Target(np.zeros(20)), 1e-4).target_ends_s == 0.0


def test_a_recorded_tap_ends_at_a_tenth_of_its_peak(library: Library) -> None:
    found = trade_figures(library, 1, 1)
    r = np.abs(np.append(library.target_m_s2[1, 1], library.target_after_m_s2[1, 1]))
    last = round(found.target_ends_s / library.dt_s)
    assert r[last] >= 0.1 * r.max() > r[last + 1 :].max(initial=0.0)


def test_an_entry_of_a_library_has_its_own_target() -> None:
    library = clicks()
    click, tick = (trade_figures(library, iv, 0) for iv in (0, 1))
    # A burst is over after its cycles, 10 ms and 8 ms.
    assert click.target_ends_s == pytest.approx(10e-3, abs=library.dt_s)
    assert tick.target_ends_s == pytest.approx(8e-3, abs=library.dt_s)
    assert click.peak_m_s2 > tick.peak_m_s2
    louder = replace(library, command=2 * library.command)
    assert trade_figures(louder, 0, 0).peak_m_s2 == pytest.approx(2 * click.peak_m_s2, rel=1e-9)
    assert trade_figures(louder, 0, 0).pulse_to_ring == pytest.approx(click.pulse_to_ring, rel=1e-9)
