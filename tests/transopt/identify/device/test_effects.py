"""What taps at full current show that no response does: told from noise, and apart by name."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from controller.record.excitation import multisine_command, multisine_period_s
from tests.benches.identification import AMPLIFIER, DEFAULT, DT_S, Rig, mismatched
from transopt.base.signals import FloatArray, Signal
from transopt.identify.device.chain import DriveChain
from transopt.identify.device.chain_fit import ChainFit, fit_chain
from transopt.identify.device.effects import (
    at_use,
    current_missed,
    distortion,
    missed,
    named,
    named_by_lines,
)
from transopt.identify.device.trials import sort_trials
from transopt.identify.measurement import Measurement
from transopt.scene.model_error import ModelError

GRIPS_N = (1.0, 3.0, 5.0)
NOTHING = ModelError(grips_N=[3.0], frequencies_Hz=[100.0], power=[[0.0]])
STEPS = 20  # of a sample: the stiffest spring of the chain is stable far below that
EFFECTS = ("friction", "backlash", "stiffening")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(mismatched(0.1, 8))


@pytest.fixture(scope="module")
def fit(rig: Rig) -> ChainFit:
    records = sort_trials(rig.sweeps(GRIPS_N), [], AMPLIFIER, None)
    return fit_chain([grip.response for grip in records.grips], records.instrument, DEFAULT)


@pytest.fixture(scope="module")
def taps(rig: Rig) -> list[Measurement]:
    return [replace(run, held_out=True) for seed in range(3) for run in rig.transients(GRIPS_N, seed=seed)]


def explicit_steps(
    chain: DriveChain, grip_N: float, current_A: FloatArray, effect: str = "", size: float = 0.0
) -> FloatArray:
    """Acceleration of the stylus with an effect inside the chain, by small explicit steps: written for this test."""
    motor, stylus, k, c = chain.shared.tolist()
    hand, skin_k, skin_c, arm_k, arm_c = chain.hand_at(grip_N).tolist()
    h = DT_S / STEPS
    found = np.empty(current_A.size)
    # Plain floats: one array for each small step would take ten times as long.
    zm = zs = zh = vm = vs = vh = 0.0
    for n, current in enumerate(current_A.tolist()):
        for step in range(STEPS):
            drawn = k * (zm - zs) + c * (vm - vs)
            skin = skin_k * (zs - zh) + skin_c * (vs - vh)
            force = chain.force_per_current_N_A * current
            if effect == "backlash":
                drawn -= size * math.tanh((zm - zs) / 1e-8)
            elif effect == "stiffening":
                skin += size * (zs - zh) ** 3
            elif effect == "friction":
                force -= size * math.tanh(vm / 1e-3)
            stylus_m_s2 = (drawn - skin) / stylus
            if step == 0:
                found[n] = stylus_m_s2
            vm += h * (force - drawn) / motor
            vs += h * stylus_m_s2
            vh += h * (skin - arm_k * zh - arm_c * vh) / hand
            zm, zs, zh = zm + h * vm, zs + h * vs, zh + h * vh
    return found


Spoil = Callable[[Measurement, str, float], Measurement]


@pytest.fixture(scope="module")
def with_effect(rig: Rig) -> Spoil:
    """A record with what an effect of some size adds: the difference of two simulations of other make."""

    @lru_cache
    def without(grip_N: float, current_A: bytes) -> FloatArray:
        return explicit_steps(rig.device, grip_N, np.frombuffer(current_A))

    def spoilt(run: Measurement, effect: str, size: float) -> Measurement:
        assert run.grip_N is not None
        current = Rig(rig.device, noise=0.0).record("", run.grip_N, run.require("command").values, 0)
        given = current.require("current").values
        added = explicit_steps(rig.device, run.grip_N, given, effect, size) - without(run.grip_N, given.tobytes())
        acceleration = run.require("acceleration")
        return replace(run, acceleration=replace(acceleration, values=acceleration.values + added))

    return spoilt


SIZES = {"friction": 0.15, "backlash": 0.1, "stiffening": 3e10}


def test_a_tap_that_the_model_explains_has_no_excess(fit: ChainFit, taps: list[Measurement]) -> None:
    found = [missed(fit.device, run.grip_N or 0.0, fit.instrument, run) for run in taps]
    assert all(abs(one.excess) < 5 * one.deviation for one in found)
    assert [tap.excess for tap in at_use(found, NOTHING)] == pytest.approx([0.0] * len(found), abs=1e-9)
    assert named(fit, []) == []


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_is_named_and_its_size_is_what_is_missed(
    effect: str, with_effect: Spoil, fit: ChainFit, taps: list[Measurement]
) -> None:
    spoilt = [with_effect(run, effect, SIZES[effect]) for run in taps[:3]]
    found = [missed(fit.device, run.grip_N or 0.0, fit.instrument, run) for run in spoilt]
    used = at_use(found, NOTHING)
    for run, clean, tap in zip(spoilt, taps, used, strict=False):
        added = run.require("acceleration").values - clean.require("acceleration").values
        whole = run.require("acceleration").values
        # The excess is counted where the tap lasts, after the high-pass.
        expected = np.linalg.norm(added) / np.linalg.norm(whole)
        assert tap.excess == pytest.approx(expected, rel=0.25)
    ((name, share),) = named(fit, [one for one, tap in zip(found, used, strict=True) if tap.excess > 0])
    assert name == effect
    assert share > 0.3


def test_an_amplifier_that_gives_way_is_known_by_its_current(
    rig: Rig, fit: ChainFit, taps: list[Measurement]
) -> None:
    run = taps[0]
    current = run.require("current")
    assert current_missed(fit.instrument, run)[0] < 0.005
    assert current_missed(fit.instrument, run)[1] < 2e-3
    soft = Signal(current.start_s, current.dt_s, 5.0 * np.tanh(current.values / 5.0))
    assert current_missed(fit.instrument, replace(run, current=soft))[0] > 0.03
    dead = Rig(rig.device, crossover_A=0.02).transients((1.0,))[0]
    assert current_missed(fit.instrument, dead)[1] == pytest.approx(0.02, rel=0.2)


def test_noise_that_no_rest_tells_gives_no_verdict(fit: ChainFit, taps: list[Measurement]) -> None:
    run = taps[0]
    signals = {name: run.require(name) for name in ("command", "current", "acceleration")}
    cut = replace(run, **{name: replace(x, values=x.values[195:320]) for name, x in signals.items()})
    assert np.isinf(missed(fit.device, 1.0, fit.instrument, cut).deviation)


def periodic(shape: Callable[[FloatArray], FloatArray], noise: float = 0.0) -> Measurement:
    """Four periods of odd lines of which every fourth is left out, through a shape and a low-pass."""
    size, random = 2000, np.random.default_rng(4)
    lines = np.array([line for line in range(1, 300, 2) if line % 8 != 5])
    spectrum = np.zeros(size // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * random.uniform(size=lines.size))
    command = np.tile(np.fft.irfft(spectrum), 4)
    command /= np.abs(command).max()
    answer = shape(command) + noise * random.standard_normal(command.size)
    return Measurement(
        name="multisine.npz",
        source="",
        sha256="0" * 64,
        command=Signal(0.0, DT_S, command),
        acceleration=Signal(0.0, DT_S, answer),
        grip_N=3.0,
        period_s=size * DT_S,
    )


def test_detection_lines_tell_even_from_odd_distortion_and_both_from_noise() -> None:
    linear, even, odd = (
        distortion(periodic(shape, noise=0.01))
        for shape in (lambda x: 3 * x, lambda x: 3 * x + 0.5 * x**2, lambda x: 3 * x - 0.5 * x**3)
    )
    assert max(linear.even, linear.odd) < 0.002
    assert even.even > 0.01 > even.odd
    assert odd.odd > 0.01 > odd.even


def test_distortion_that_the_current_has_is_the_amplifiers() -> None:
    run = periodic(lambda x: 3 * x - 0.5 * x**3, noise=0.01)
    command = run.require("command")
    bent = replace(run, current=replace(command, values=command.values - command.values**3 / 6))
    straight = replace(run, current=command)
    amplifiers, devices = distortion(bent), distortion(straight)
    assert "the amplifier gives way" in amplifiers.words()
    assert "friction, play" in devices.words()
    assert devices.current_odd < 1e-9


def multisines(rig: Rig) -> list[Measurement]:
    """One per grip, as `record sweep` plays it."""
    command = multisine_command(1.5, DT_S)
    rest = np.zeros(500)
    runs = [
        rig.record(f"multisine_{grip:g}N.npz", grip, np.concatenate([rest, command, rest]), 7) for grip in GRIPS_N
    ]
    return [replace(run, period_s=multisine_period_s(DT_S)) for run in runs]


@pytest.mark.parametrize("effect", ["friction", "stiffening"])
def test_detection_lines_name_the_cause(rig: Rig, with_effect: Spoil, fit: ChainFit, effect: str) -> None:
    size = {"friction": 0.15, "stiffening": 1e11}[effect]
    found = named_by_lines(fit, [with_effect(run, effect, size) for run in multisines(rig)])
    assert [name for name, _ in found] == [effect]


def test_detection_lines_of_a_linear_device_name_nothing(rig: Rig, fit: ChainFit) -> None:
    runs = multisines(rig)
    assert named_by_lines(fit, runs) == []
    for run in runs:
        found = distortion(run)
        assert found.largest < 2e-3


def test_a_record_that_does_not_repeat_has_no_detection_lines(taps: list[Measurement]) -> None:
    assert distortion(taps[0]) is None
