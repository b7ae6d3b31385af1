"""What `identify` asks to be recorded again is recorded on simulated devices, and the complaint is gone."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from controller.host.sweeps import AFTER_S, BEFORE_S
from controller.record.sweep_plan import PlannedSweep, Purpose, Shape, sweep_plan
from problems.generators.tapping_trials import Spread, second_order_hands
from tests.benches.identification import AMPLIFIER, DEFAULT, DT_S, Rig, mismatched
from tests.benches.sweeps import amplifier_trial
from tests.transopt.identify.hand.test_fourth_order import FOAM, Session
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.identify.amplifier import fit_amplifier
from transopt.identify.device.identify import Settings, identify
from transopt.identify.device.result import Kind
from transopt.identify.device.validation import Taps
from transopt.identify.hand.lines import fit_hand
from transopt.identify.hand.tap import HandTap
from transopt.identify.measurement import Measurement

RIG = Rig(mismatched(0.05, 8))
PEAK_A = 3.0
# Taps at every grip of the scene, of 3 A.
TAPS = Taps((0.3,), (0.0, 1.0, 5.0), PEAK_A * np.hanning(600) * np.ones((3, 1, 1)), np.full((3, 1), 1e4), DT_S)
SETTINGS = Settings(
    nominal=DEFAULT,
    scene_plant=DEFAULT.plant,
    amplifier=AMPLIFIER,
    kind=Kind.DRIVE,
    random_starts=1,
    played_N=TAPS.grips_N,
    taps=lambda _: TAPS,
)
GRIPS_N = (0.0, 1.0, 3.0, 5.0)


def of_device(runs: Sequence[Measurement]) -> str:
    """All that is said of records of a device, line by line."""
    try:
        result = identify(runs, [], SETTINGS)
    except InputError as error:
        return str(error)
    return "\n".join([*map(str, result.findings), *result.advice, result.verdict, *result.short])


def recorded(rig: Rig, planned: Sequence[PlannedSweep]) -> list[Measurement]:
    """Trials as a device writes them, with rest before and ringing after."""
    found = []
    for j, trial in enumerate(planned):
        command = np.pad(trial.command(DT_S), (round(BEFORE_S / DT_S), round(AFTER_S / DT_S)))
        run = rig.record(trial.file_name, trial.grip_N, command, j)
        found.append(replace(run, held_out=trial.shape is Shape.TAP, period_s=trial.period_s(DT_S)))
    return found


def sweeps(rig: Rig, grips_N: Sequence[float], trials: int = 3, seconds: float = 2.5) -> list[Measurement]:
    return recorded(rig, sweep_plan(Purpose.DEVICE, grips_N, trials, seconds=seconds))


@cache
def whole() -> str:
    """What is said of a free device and three held grips, with taps of the current of use."""
    taps = [trial for trial in sweep_plan(Purpose.DEVICE, GRIPS_N, 1, tap_A=PEAK_A) if trial.shape is Shape.TAP]
    return of_device([*sweeps(RIG, GRIPS_N), *recorded(RIG, taps)])


ONE_GRIP = (
    r"no free device: record it too \(record sweep --grips 0\)",
    r"one held grip, 3 N: .* record at least three",
    r"the scene plays 5 N, recorded are 3 to 3 N: record there",
    r"the scene plays the free device, which was not recorded: record at grip 0",
    r"not covered: taps reach 3 A .*: add taps \(record sweep --tap-current 3\)",
)


def test_the_grips_and_taps_that_are_asked_for() -> None:
    lacking = of_device(sweeps(RIG, (3.0,)))
    for complaint in ONE_GRIP:
        assert re.search(complaint, lacking), complaint
        assert not re.search(complaint, whole()), complaint


def test_a_free_device_among_the_grips_changes_nothing_for_the_others() -> None:
    for purpose in Purpose:
        alone = sweep_plan(purpose, (1.0, 5.0), 3, tap_A=2.0)
        assert [trial for trial in sweep_plan(purpose, (0.0, 1.0, 5.0), 3, tap_A=2.0) if trial.grip_N > 0] == alone


@cache
def held(noise: float = 1.0, trials: int = 3, **sweep: float) -> str:
    """What is said of sweeps of one held grip."""
    return of_device(recorded(RIG.loud(noise), sweep_plan(Purpose.DEVICE, (3.0,), trials, **sweep)))


@cache
def of_amplifier(spoil: Callable[[FloatArray], FloatArray] = lambda x: x, **sweep: float) -> str:
    """What is said of one sweep of an amplifier whose current is spoilt."""
    trial = amplifier_trial(1, crossover_A=0.0, **sweep)
    try:
        fit = fit_amplifier([replace(trial, output=replace(trial.output, values=spoil(trial.output.values)))])
    except InputError as error:
        return str(error)
    return "\n".join(fit.shortfalls())


def of_hand(session: Session, change: Callable[[HandTap], HandTap | None] = lambda tap: tap) -> str:
    """What is said of taps of a hand of one mass; those that are changed to None were not recorded."""
    taps = [changed for tap in session.taps(81) if (changed := change(tap)) is not None]
    return "\n".join(fit_hand(taps).shortfalls())


def limited(current_A: FloatArray) -> FloatArray:
    return np.asarray(np.clip(current_A, -0.35, 0.35))


def bent(tap: HandTap) -> HandTap:
    return replace(tap, force_N=tap.force_N * (1 + 0.012 * (tap.grip_N - 4.5) ** 2))


LOUD, SHORT = 20.0, {"seconds": 0.5, "low_Hz": 2.0}
FAINT, MASS = {"seconds": 0.3, "noise_A": 0.01}, Session(hands=second_order_hands)
FEW = replace(MASS, grips=3, speeds=4, spread=Spread(0.34, 0.3, 0.3))
CASES: dict[str, tuple[str, Callable[[], str], Callable[[], str]]] = {
    "noise": (r"coherence low at .* with more current", lambda: held(LOUD), lambda: held(LOUD, amplitude_A=6.0)),
    "not swept high": (r"coherence low at .*-800 Hz at 3 N: sweep there", lambda: held(high_Hz=200.0), held),
    "not swept low": (r"coherence low at 2-\d\d.* Hz at 3 N: sweep there", lambda: held(low_Hz=20.0), held),
    "cycles, longer": (
        r"too few cycles: .* sweep 2\.7 times as long",
        lambda: held(trials=2, **SHORT),
        lambda: held(trials=2, **{**SHORT, "seconds": 2.7 * 0.5}),
    ),
    "cycles, more": (
        r"too few cycles: .* or add trials from 2 Hz on",
        lambda: held(trials=2, **SHORT),
        lambda: held(trials=7, **SHORT),
    ),
    "pole, longer": (
        r"the pole is known to .*: record longer or larger sweeps",
        lambda: of_amplifier(amplitude_A=0.05, **FAINT),
        lambda: of_amplifier(amplitude_A=0.05, **{**FAINT, "seconds": 12.0}),
    ),
    "pole, larger": (
        r"the pole is known to .*: record longer or larger sweeps",
        lambda: of_amplifier(amplitude_A=0.05, **FAINT),
        lambda: of_amplifier(amplitude_A=0.5, **FAINT),
    ),
    "faint": (
        r"at least 12 are needed; sweep with more",
        lambda: of_amplifier(amplitude_A=0.001, seconds=0.3, noise_A=0.05),
        lambda: of_amplifier(amplitude_A=1.0, seconds=0.3, noise_A=0.05),
    ),
    "supply": (
        r"drove it into its supply \(sweep with less current\)",
        lambda: of_amplifier(limited),
        lambda: of_amplifier(limited, amplitude_A=0.3),
    ),
    "few taps": (
        r"is known to .*: record about \d+ times as many taps",
        lambda: of_hand(FEW),
        lambda: of_hand(replace(FEW, speeds=4 * 2 * 3)),
    ),
    "soft object": (
        r"the force stands out of its noise up to \d\d Hz only .* on a harder object",
        lambda: of_hand(replace(MASS, target=FOAM)),
        lambda: of_hand(MASS),
    ),
    "bent": (
        r"mass_kg is no line over grip .* keep to a narrower range of grips",
        lambda: of_hand(MASS, bent),
        lambda: of_hand(replace(MASS, grips=14, speeds=4), lambda tap: bent(tap) if 3.3 < tap.grip_N < 6.0 else None),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_asked_for_is_recorded_and_the_complaint_is_gone(case: str) -> None:
    complaint, lacking, remedied = CASES[case]
    said = lacking()
    assert re.search(complaint, said), said
    said = remedied()
    assert not re.search(complaint, said), said
