"""The hand from taps on a real surface: what is recovered, how sure, and what is refused."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from problems.generators.tapping_trials import (
    FOURTH_ORDER_HAND,
    FOURTH_ORDER_STYLUS_KG,
    Sensors,
    Spread,
    Trials,
    recorded,
    second_order_hands,
    session,
    surface,
    tapping_trials,
    taps,
)
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.base.signals import FloatArray, Signal
from transopt.identify.device.chain import HAND
from transopt.identify.hand.fourth_order import NAMES, fit_fourth_order
from transopt.identify.hand.lines import HandFit, fit_hand
from transopt.identify.hand.tap import HandTap, cut_tap, fit_tap, onset, tap_of, usable_taps
from transopt.identify.measurement import Measurement
from transopt.plant.chain import Link, chain
from transopt.plant.second_order import SEED_HAND_DAMPING_N_S_M, SEED_HAND_MASS_KG, SEED_HAND_STIFFNESS_N_M
from transopt.scene.strikes import strike

DT_S = 1e-4


def cut(trials: Trials) -> list[HandTap]:
    return [
        cut_tap(
            f"trial {j}",
            trials.force_N[j],
            trials.acceleration_m_s2[j],
            DT_S,
            grip_N=float(trials.grip_N[j]),
            accelerometer_Hz=trials.accelerometer_Hz,
        )
        for j in range(trials.grip_N.size)
    ]


@pytest.fixture(scope="module")
def trials() -> Trials:
    return tapping_trials(1)


@pytest.fixture(scope="module")
def cut_taps(trials: Trials) -> list[HandTap]:
    return cut(trials)


@pytest.fixture(scope="module")
def hand(cut_taps: list[HandTap]) -> HandFit:
    return fit_hand(cut_taps)


def measurement(trials: Trials, j: int = 40) -> Measurement:
    def signal(values: FloatArray) -> Signal:
        return Signal(0.0, DT_S, values)

    return Measurement(
        name=f"trial_{j}.npz",
        source=f"trial_{j}.npz",
        sha256="0" * 64,
        acceleration=signal(trials.acceleration_m_s2[j]),
        force=signal(trials.force_N[j]),
        position=signal(trials.position_m[j]),
        grip_N=float(trials.grip_N[j]),
        accelerometer_Hz=trials.accelerometer_Hz,
    )


# ------------------------------------------------------------------------------------------------ the generator


def test_taps_agree_with_the_generator_of_the_recordings() -> None:
    plant = chain([0.2], [Link(120.0, 8.0)], force_per_current_N_A=1.0, stylus=0)
    speeds = np.array([0.1, 0.4])
    times, force, acceleration, position = taps([plant, plant], surface(), speeds, 1e-5)
    other_times, other, encoder = strike(plant, surface(), speeds, 20e-3, 1e-5)
    some = slice(0, other_times.size)
    np.testing.assert_allclose(times[some], other_times, atol=1e-12)
    np.testing.assert_allclose(acceleration[:, some], other, atol=1e-9 * np.abs(other).max())
    np.testing.assert_allclose(position[:, some], encoder, atol=1e-12)
    # Momentum: the surface pushes the hand and what holds it.
    assert np.all(force >= 0)


# ------------------------------------------------------------------------------------------------ one tap


def test_a_quiet_tap_shows_its_hand() -> None:
    """The analytic oracle: what is left are the trapezoidal rule and the contact between two samples."""
    random = np.random.default_rng(4)
    quiet = Sensors(noise_g_rtHz=0.0, force_N=0.0)
    grips, speeds = np.array([1.0, 5.0, 10.0]), np.array([0.1, 0.25, 0.4])
    found = recorded(second_order_hands(grips, random, Spread(0, 0, 0)), grips, speeds, random, sensors=quiet)
    for j, tap in enumerate(cut(found)):
        fit = fit_tap(tap)
        assert fit.mass_kg == pytest.approx(0.215 - 0.00328 * grips[j], rel=5e-4)
        assert fit.damping_N_s_m == pytest.approx(6.713 + 0.369 * grips[j], rel=2e-3)
        assert fit.stiffness_N_m == pytest.approx(75.65 + 14.72 * grips[j], rel=5e-3)
        assert fit.unexplained < 1e-3


@pytest.mark.parametrize(("by", "word"), [(1, "later"), (-1, "earlier")])
def test_a_force_that_is_read_a_sample_apart_is_reported(trials: Trials, hand: HandFit, by: int, word: str) -> None:
    """It takes half of the spring's constant away, or adds as much, and is no hand."""
    assert not any("read about a sample" in text for text in hand.shortfalls())
    force = np.roll(trials.force_N, by, axis=1)
    force[:, [0, -1]] = trials.force_N[:, [0, -1]]
    apart = fit_hand(cut(replace(trials, force_N=force)))
    assert any(f"the force is read about a sample {word} than" in text for text in apart.shortfalls())


def test_onset_is_where_the_force_rises(trials: Trials) -> None:
    # Contact is less than a sample after 30 ms.
    assert all(abs(onset(force, DT_S) - 300) <= 4 for force in trials.force_N)
    with pytest.raises(InputError, match=r"no contact: highest .* N off its middle, noise .* N rms"):
        onset(0.05 * np.random.default_rng(0).standard_normal(500).clip(-2, 2), DT_S)


def without_pre_roll(trials: Trials, kept_ms: float) -> list[HandTap]:
    first = round((30 - kept_ms) * 1e-3 / DT_S)
    return cut(
        replace(trials, force_N=trials.force_N[:, first:], acceleration_m_s2=trials.acceleration_m_s2[:, first:])
    )


@pytest.mark.parametrize(("kept_ms", "offsets"), [(3.0, "from the"), (-0.2, "taken as 0")])
def test_a_trigger_without_pre_roll_is_read_and_said_so(
    trials: Trials, cut_taps: list[HandTap], kept_ms: float, offsets: str
) -> None:
    free = replace(
        trials,
        force_N=trials.force_N - trials.force_N[:, :200].mean(axis=1, keepdims=True),
        acceleration_m_s2=trials.acceleration_m_s2 - trials.acceleration_m_s2[:, :200].mean(axis=1, keepdims=True),
    )
    found = without_pre_roll(free, kept_ms)
    assert all("contact at the start" in tap.note and offsets in tap.note for tap in found)
    whole, late = (np.array([fit_tap(tap).mass_kg for tap in taps]) for taps in (cut_taps, found))
    np.testing.assert_allclose(late, whole, rtol=0.06)


# ------------------------------------------------------------------------------------------------ lines over grip


def test_the_lines_of_the_seed_come_back_from_81_trials(hand: HandFit) -> None:
    found = np.array([v for line in hand.lines for v in (line.line.constant, line.line.per_newton)])
    truth = np.array([0.215, -0.00328, 6.713, 0.369, 75.65, 14.72])
    deviation = np.sqrt(np.diagonal(hand.covariance))
    assert np.all(np.abs(found - truth) < 3 * deviation)
    # The lines are as precise as hands that scatter allow: 5 % and 10 % over 81 taps.
    assert deviation[0] < 0.02 * 0.215
    assert deviation[5] < 0.08 * 14.72
    assert not hand.shortfalls()
    for line in hand.lines:
        assert np.all(line.intervals[:, 0] < [line.line.constant, line.line.per_newton])
        assert np.all(line.intervals[:, 1] > [line.line.constant, line.line.per_newton])
        assert line.lack_of_fit_p > 0.01


def test_too_few_trials_or_grips_are_refused(cut_taps: list[HandTap]) -> None:
    with pytest.raises(InputError, match=r"5 taps: at least 12 are needed"):
        fit_hand(cut_taps[:5])
    with pytest.raises(InputError, match=r"only 2 different grips \(1, 10 N\): at least 3"):
        fit_hand([replace(tap, grip_N=1.0 if j % 2 else 10.0) for j, tap in enumerate(cut_taps)])


@pytest.mark.parametrize(("factor", "remedy"), [(1 / G, "kgf"), (G, "twice")])
def test_forces_off_by_gravity_are_named(cut_taps: list[HandTap], factor: float, remedy: str) -> None:
    with pytest.raises(InputError, match=rf"the taps show a mass of .*{remedy}.*[Uu]nits of force"):
        fit_hand([replace(tap, force_N=factor * tap.force_N) for tap in cut_taps])


def test_a_light_hand_is_taken_where_the_message_says(cut_taps: list[HandTap]) -> None:
    """Two fingertips on a light stylus have less than 0.03 kg, as the taps of another unit seem to."""
    light = [replace(tap, force_N=tap.force_N / G) for tap in cut_taps]
    with pytest.raises(InputError, match=r"if they are right, --accept takes it"):
        fit_hand(light)
    mass = fit_hand(light, accept=True).lines[0].line.constant
    assert mass == pytest.approx(fit_hand(cut_taps).lines[0].line.constant / G, rel=0.01)


# ------------------------------------------------------------------------------------------------ fourth order


def test_the_fourth_order_hand_comes_back_where_hands_do_not_scatter() -> None:
    found = cut(tapping_trials(1, hand="fourth_order", spread=Spread(0, 0, 0)))[::3]
    second = fit_hand(found)
    shortfalls = second.shortfalls()
    assert len(shortfalls) == 1
    assert "the stylus moves within the grip" in shortfalls[0]
    fit = fit_fourth_order(found, second, starts=3)
    assert fit.stylus_mass_kg == pytest.approx(FOURTH_ORDER_STYLUS_KG, rel=0.01)
    for name, tolerance in zip(HAND, (0.02, 0.02, 0.02, 0.1, 0.03), strict=True):
        assert fit.lines[name].at(5.5) == pytest.approx(FOURTH_ORDER_HAND.line(name).at(5.5), rel=tolerance)
    assert not fit.undetermined
    assert "3 of 3 starts" in fit.word()
    assert fit.is_better
    assert not fit.shortfalls()
    assert "misses 20 % of the acceleration" in replace(fit, unexplained=0.2).shortfalls()[0]
    truth = [FOURTH_ORDER_STYLUS_KG]
    for name in HAND:
        truth += [FOURTH_ORDER_HAND.line(name).constant, FOURTH_ORDER_HAND.line(name).per_newton]
    inside = (fit.intervals[:, 0] <= truth) & (fit.intervals[:, 1] >= truth)
    assert inside.sum() >= len(NAMES) - 2


def test_taps_of_one_rigid_mass_do_not_determine_a_skin(cut_taps: list[HandTap], hand: HandFit) -> None:
    fit = fit_fourth_order(cut_taps[::4], fit_hand(cut_taps[::4]), starts=1)
    assert "hand.skin_stiffness_N_m" in fit.undetermined
    assert "not determined by these taps" in fit.word()
    # What both models have in common is known all the same.
    total = fit.stylus_mass_kg + fit.lines["mass_kg"].at(5.5)
    assert total == pytest.approx(hand.lines[0].line.at(5.5), rel=0.1)
    for grip_N in fit.grips_N:
        assert all(line.at(grip_N) >= -1e-9 for line in fit.lines.values())


@pytest.mark.parametrize(("brake_m_s2", "said"), [(0.0, ""), (1.5, "brakes"), (-1.5, "speeds up")])
def test_a_hand_that_brakes_at_contact_is_named(
    cut_taps: list[HandTap], hand: HandFit, brake_m_s2: float, said: str
) -> None:
    """The hand's motion leaves the straight one by d, and the surface pushes with m y'' + b (y' - d') + k (y - d)."""
    braked = []
    for tap, fit in zip(cut_taps[::2], hand.fits[::2], strict=True):
        t = DT_S * np.arange(tap.force_N.size)
        less = brake_m_s2 * (fit.damping_N_s_m * t + fit.stiffness_N_m * t**2 / 2)
        braked.append(replace(tap, force_N=tap.force_N - less))
    fit = fit_fourth_order(braked, fit_hand(braked), starts=1)
    told = re.fullmatch(
        r"the hand (.*) by about (\S+) m/s\^2 from .* has about (\S+) N/m at (\S+) N, not (\S+), what.*",
        fit.braking(),
    )
    assert (told is not None) == bool(said)
    if told is not None:
        true_N_m = hand.lines[2].line.at(float(told[4]))
        assert told[1] == said
        assert float(told[2]) == pytest.approx(abs(brake_m_s2), rel=0.4)
        assert abs(float(told[3]) - true_N_m) < 0.4 * abs(float(told[5]) - true_N_m)


# ------------------------------------------------------------------------------------------------ bad input


Spoil = Callable[[Measurement], dict[str, Any]]


def part(kept: slice) -> Spoil:
    return lambda run: {
        name: replace(run.require(name), values=run.require(name).values[kept])
        for name in ("force", "acceleration", "position")
    }


def times(name: str, factor: float) -> Spoil:
    return lambda run: {name: run.require(name).scaled(factor)}


def clipped(name: str, share: float) -> Spoil:
    def cut_off(run: Measurement) -> dict[str, Any]:
        signal = run.require(name)
        return {name: replace(signal, values=np.minimum(signal.values, share * signal.values.max()))}

    return cut_off


def resampled(x: Signal, times: int) -> Signal:
    """The signal with so many samples for each, on straight lines."""
    n = x.values.size
    fine = np.interp(np.arange(n * times - times + 1) / times, np.arange(n), x.values)
    return Signal(x.start_s, x.dt_s / times, fine)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda _: {"force": None}, r"no column force_N; record it too"),
        (lambda _: {"grip_N": None}, r"no grip: state it in the file \(grip_N\)"),
        (lambda _: {"grip_N": 0.0}, r"grip_N = 0: nobody holds the stylus"),
        (lambda _: {"off_grid": 0.6}, r"0\.6 steps \(rms\) off a uniform grid: at most 0\.2; sample by a timer"),
        (clipped("force", 0.6), r"force stays at .* N for \d+ samples: clipped; .*record again"),
        (clipped("acceleration", 0.7), r"acceleration stays at .* m/s\^2 for \d+ samples: clipped"),
        (times("force", -1.0), r"wrong polarity: at impact .* turn that of force$"),
        (
            lambda run: {**times("force", -1.0)(run), "position": None},
            r"wrong polarity: .* turn that of force or acceleration",
        ),
        (times("acceleration", -1.0), r"wrong polarity: acceleration must be positive out of the object"),
        (
            times("acceleration", 1 / G),
            r"acceleration is 0\.(09|10)\d* times that of the position, .*is the column in g",
        ),
        (
            times("acceleration", G),
            r"acceleration is (9\.[3-9]|10\.[0-2])\d* times that of .* but named acceleration_g\? Correct its name",
        ),
        (times("acceleration", 1.5), r"acceleration is 1\.[45]\d* times .*must agree within 20 %"),
        (part(slice(None, 500)), r"the record ends (19\.9|20) ms after contact: 30 ms are needed"),
    ],
)
def test_bad_trials_are_named(trials: Trials, spoil: Spoil, message: str) -> None:
    good = measurement(trials)
    with pytest.raises(InputError, match=rf"^trial_40\.npz: .*{message}"):
        tap_of(replace(good, **spoil(good)))


@pytest.mark.parametrize("by_m_s2", [-2.0, 2.0])
def test_a_hand_that_comes_in_braking_has_no_wrong_scale(trials: Trials, by_m_s2: float) -> None:
    """In the frame of the hand it is the same tap; a straight line goes past the encoder by 60 %."""
    for j in (0, 4, 40, 80):
        run = measurement(trials, j)
        moved = by_m_s2 / 2 * trials.times_s**2
        own = {
            "acceleration": run.require("acceleration").with_values(trials.acceleration_m_s2[j] + by_m_s2),
            "position": run.require("position").with_values(trials.position_m[j] + moved),
        }
        found, alike = tap_of(replace(run, **own)), tap_of(run)
        np.testing.assert_allclose(found.acceleration_m_s2, alike.acceleration_m_s2, atol=1e-9)
        with pytest.raises(InputError, match="must agree within 20 %"):
            tap_of(replace(run, **own | times("acceleration", 1.5)(replace(run, **own))))


def test_a_peak_in_the_steps_of_a_coarse_converter_is_not_clipped(trials: Trials) -> None:
    """Ten bits at 100 kHz repeat the peak up to ten times; a sensor at its end stop does so much longer."""
    for j in (0, 16, 32, 48):
        fine = measurement(trials, j).changed(lambda _, x: resampled(x, 10))
        coarse = fine.changed(
            lambda _, x: replace(x, values=np.round(x.values / (step := np.ptp(x.values) / 512)) * step)
        )
        tap_of(coarse)
        with pytest.raises(InputError, match=r"force stays at .* clipped"):
            tap_of(replace(coarse, **clipped("force", 0.95)(coarse)))


def test_a_few_bad_trials_are_left_out_many_are_refused(trials: Trials) -> None:
    runs = [measurement(trials, j) for j in range(20)]
    runs[3] = replace(runs[3], grip_N=None)
    found, left_out = usable_taps(runs)
    assert len(found) == 19
    assert left_out == ["trial_3.npz: no grip: state it in the file (grip_N); the fits run over grip"]
    turned = [replace(run, **times("force", -1.0)(run)) for run in runs[:6]] + runs[6:]
    with pytest.raises(InputError, match=r"^trial_0\.npz: wrong polarity.* \(and 5 more of 20 trials\)$"):
        usable_taps(turned)


def test_lost_rows_are_passed_on_to_the_user(trials: Trials) -> None:
    said = "1 of 900 samples lost or without a time, first after row 41 (0.0039 s): interpolated"
    assert tap_of(replace(measurement(trials), missing=said)).note == said


LINES = (SEED_HAND_MASS_KG, SEED_HAND_DAMPING_N_S_M, SEED_HAND_STIFFNESS_N_M)
TRUTH = np.array([value for line in LINES for value in (line.constant, line.per_newton)])
BATCH = 5  # experiments simulated at once


def test_a_hand_that_did_not_come_in_steadily_is_named(trials: Trials) -> None:
    """It has sped up by 8 m/s^2 more at contact than 10 ms before, and goes on so."""
    tap = measurement(trials)
    x = tap.require("acceleration")
    hurried = x.with_values(x.values + 800 * (x.times_s - x.times_s[0]))
    assert "no steady approach: " in tap_of(replace(tap, acceleration=hurried, position=None)).note
    assert tap_of(tap).note == ""


def experiments(repeats: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Coefficients (R, 6) and their 95 % intervals (R, 6, 2), each of 81 simulated taps of scattering hands."""
    random, found, intervals = np.random.default_rng([seed, 2]), [], []
    while len(found) < repeats:
        batch = min(BATCH, repeats - len(found))
        drawn = zip(*(session(random) for _ in range(batch)), strict=True)
        grips, speeds = (np.concatenate(values) for values in drawn)
        trials = recorded(second_order_hands(grips, random, Spread()), grips, speeds, random)
        known = {"accelerometer_Hz": trials.accelerometer_Hz}
        dt_s = float(trials.times_s[1])
        taps = [
            cut_tap(f"{j}", force, acceleration, dt_s, grip_N=float(grip), **known)
            for j, (force, acceleration, grip) in enumerate(
                zip(trials.force_N, trials.acceleration_m_s2, trials.grip_N, strict=True)
            )
        ]
        for part in np.array_split(np.arange(grips.size), batch):
            lines = fit_hand([taps[j] for j in part]).lines
            found.append(np.array([value for one in lines for value in (one.line.constant, one.line.per_newton)]))
            intervals.append(np.concatenate([one.intervals for one in lines]))
    return np.array(found), np.array(intervals)


@pytest.mark.parametrize(
    ("repeats", "covered"),
    # At 95 % one in 10^4 falls below 6 of 10; of 200, 90 to 99 % are asked.
    [(10, (0.6, 1.0)), pytest.param(200, (0.9, 0.99), marks=(pytest.mark.long, pytest.mark.timeout(3600)))],
)
def test_intervals_cover_the_truth(repeats: int, covered: tuple[float, float]) -> None:
    found, intervals = experiments(repeats, 5)
    share = ((intervals[..., 0] <= TRUTH) & (intervals[..., 1] >= TRUTH)).mean(axis=0)
    assert np.all((share >= covered[0]) & (share <= covered[1])), share
    assert np.all(np.abs(found.mean(axis=0) - TRUTH) < found.std(axis=0, ddof=1))
