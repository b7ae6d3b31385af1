"""Incoming speed and contact time from encoder counts; when a transient may start."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from controller.servo.settings import Settings
from tests.benches.oracle.approach import BEND_COUNTS, NEVER, STEADY_BEND_COUNTS, Approach, Touch, Trigger
from tests.campaigns import test_from_rest as from_rest
from transopt.base.signals import FloatArray

DT_S, LEAD_S, COUNT_M, WINDOW = 1e-4, 3e-4, 24.5e-6, 100


def _approach(surface_counts: float = 0.0, window: int = WINDOW) -> Approach:
    return Approach(
        DT_S, LEAD_S, count_m=COUNT_M, surface_counts=surface_counts, window_ticks=window, least_speed_m_s=0.02
    )


def test_exact_on_a_parabola_of_whole_counts() -> None:
    fit = _approach(surface_counts=7.0)
    ticks = np.arange(150)
    # n = 3 k^2 - 1500 k + 200000: all whole, so nothing is rounded.
    for count in (3 * ticks**2 - 1500 * ticks + 200_000).tolist():
        fit.step(count)
    ahead = 149 + 3
    position, rate = 3 * ahead**2 - 1500 * ahead + 200_000, 6 * ahead - 1500
    assert fit.speed_m_s == pytest.approx(-rate * COUNT_M / DT_S, rel=1e-9)
    assert fit.phase == pytest.approx((position - 7) / rate, rel=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(-(10**6), 10**6), min_size=31, max_size=120))
def test_sliding_sums_are_the_least_squares_fit(counts: list[int]) -> None:
    fit = _approach(window=30)
    for count in counts:
        fit.step(count)
    t = np.arange(-29, 1)
    cubic, parabola = (np.polyval(np.polyfit(t, counts[-30:], degree), t) for degree in (3, 2))
    bend = float(np.linalg.norm(cubic - parabola))
    now, before = counts[-1] - counts[-16], counts[-16] - (counts[-31] if len(counts) > 30 else counts[0])
    most = BEND_COUNTS if abs(now - before) * 8 > abs(now) + 16 else STEADY_BEND_COUNTS
    assume(abs(bend - most) > 1e-6)
    kept = 15 if bend > most else 30
    slope = np.polyval(np.polyder(np.polyfit(t[-kept:], counts[-kept:], 2)), 3.0)
    assert fit.speed_m_s == pytest.approx(-slope * COUNT_M / DT_S, rel=1e-6, abs=1e-3)


@pytest.mark.parametrize("course", list(from_rest.COURSES))
@pytest.mark.parametrize("count_m", [24.5e-6, 10e-6])
def test_a_tap_from_rest_is_foreseen_and_played(course: str, count_m: float) -> None:
    servo = Settings(DT_S, LEAD_S, 4.0, count_m=count_m)
    errors_s, unplayed = from_rest.of_rest(course, servo, 40, np.random.default_rng(3))
    assert unplayed == 0
    assert from_rest.rms_us(errors_s) < 30


def test_restart_forgets_and_a_short_history_never_contacts() -> None:
    fit, fresh = _approach(), _approach()
    for k in range(250):
        fit.step(10**5 - 37 * k * k)
    fit.restart()
    for k in range(150):
        fit.step(500 - 2 * k)
        fresh.step(500 - 2 * k)
        assert (fit.speed_m_s, fit.phase) == (fresh.speed_m_s, fresh.phase)
        assert (fit.phase == NEVER) == (k < WINDOW - 1)


def _errors(speed_m_s: float, hand_m_s2: float, rng: np.random.Generator) -> FloatArray:
    """(100, 2) relative error of the speed and error of the contact time [s], when the waveform would start."""
    found = []
    for _ in range(100):
        fit = _approach()
        t = (np.arange(-WINDOW - 60, 2) + rng.uniform()) * DT_S
        acceleration = hand_m_s2 * rng.choice([-1, 1])
        z = -speed_m_s * t + 0.5 * acceleration * t**2
        for time_s, count in zip(t.tolist(), np.round(z / COUNT_M).astype(int).tolist(), strict=True):
            fit.step(count)
            if fit.phase > -1:
                found.append((fit.speed_m_s / speed_m_s - 1, time_s - fit.phase * DT_S + LEAD_S))
                break
    assert len(found) == 100
    return np.array(found)


@pytest.mark.parametrize("hand_m_s2", [0.0, 2.0])
@pytest.mark.parametrize(
    ("speed_m_s", "speed_error", "time_error_s"),
    # A tenth of a tick costs 0.8 % NRMSE, 2 % of speed cost 2 %.
    [(0.05, 0.025, 35e-6), (0.1, 0.008, 15e-6), (0.2, 0.004, 8e-6), (0.4, 0.002, 4e-6), (1.0, 0.002, 2e-6)],
)
def test_contact_is_predicted_under_an_accelerating_hand(
    speed_m_s: float, speed_error: float, time_error_s: float, hand_m_s2: float
) -> None:
    errors = _errors(speed_m_s, hand_m_s2, np.random.default_rng(1))
    rms = np.sqrt(np.mean(errors**2, axis=0))
    assert rms[0] < speed_error
    assert rms[1] < time_error_s
    assert abs(errors[:, 0].mean()) < speed_error / 2


def _touches(z_m: FloatArray) -> list[Touch]:
    """What the trigger says to a course whose speed and phase are known exactly."""
    trigger = Trigger(COUNT_M, 1e-4, 5e-4, 50)
    answers = []
    for k in range(1, z_m.size):
        rate = z_m[k] - z_m[k - 1]
        phase = 3 + z_m[k] / rate if rate < -2e-6 else NEVER
        answers.append(trigger.step(float(z_m[k]), float(-rate / DT_S), float(phase)))
    return answers


def test_one_contact_per_tap_and_a_rebound_is_chatter() -> None:
    t = np.arange(0, 0.1, DT_S)
    fall = 2e-3 - 0.1 * t[:300]
    bounce = fall[-1] + np.concatenate([np.linspace(0, 1.3e-3, 40), np.linspace(1.3e-3, -2e-4, 60)])
    rest = np.full(100, bounce[-1])
    answers = _touches(np.concatenate([fall, bounce, rest]))
    assert answers.count(Touch.CONTACT) == 1
    assert answers.count(Touch.CHATTER) == 1
    again = np.concatenate([fall, bounce, np.linspace(bounce[-1], 4e-3, 100), 4e-3 - 0.1 * t[:500]])
    assert _touches(again).count(Touch.CONTACT) == 2


def test_creeping_and_hovering_play_nothing() -> None:
    creep = np.linspace(2e-3, -1e-3, 6000)
    assert set(_touches(creep)) == {Touch.NOTHING}
    # Once touched, a press deeper is no tap either.
    press = np.concatenate([creep, creep[-1] - 0.2 * DT_S * np.arange(100)])
    assert set(_touches(press)) == {Touch.NOTHING}
    rng = np.random.default_rng(0)
    hover = np.concatenate([creep[:4200], 3e-5 * rng.standard_normal(2000)])
    assert Touch.CONTACT not in _touches(hover)[4300:]


def test_armed_too_late_for_a_contact_is_told() -> None:
    """Two ticks above the surface are too few to play, and too many to say nothing."""
    trigger = Trigger(COUNT_M, 1e-4, 5e-4, 50)
    found = [trigger.step(z, 0.3, -1.5) for z in (3e-5, 1e-5, -1e-5, -4e-5, -7e-5)]
    assert found == [Touch.NOTHING, Touch.NOTHING, Touch.CHATTER, Touch.NOTHING, Touch.NOTHING]
