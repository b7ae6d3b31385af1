"""A hot coil's cool command: what the guard allows, and that no blend passes a limit or the predicted heat."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.protocol.image import bank_of, image_of
from controller.waveforms.bank import Bank
from tests.benches.compiled import TAIL, smooth_bank
from tests.benches.oracle.blend import Play, blend_at
from tests.benches.oracle.guard import Guard
from tests.benches.servo import AMPLIFIER
from transopt.base.signals import FloatArray
from transopt.plant.coil import CoilModel, effective_square
from transopt.problem.warm_coil import currents, norms

DT_S, CURRENT_A, COMMAND_A, LEAST = 1e-4, 4.0, 6.0, 0.25
COIL = CoilModel(R_ohm=2.18, R_wh_K_W=3.1, R_ha_K_W=14.0, tau_w_s=12.0, tau_h_s=612.0, limit_C=100.0)
SIZES = st.floats(0, 200)
BLENDS = 100_000


def guard_at(winding_C: float, housing_C: float) -> Guard:
    guard = Guard(COIL, DT_S, withhold_K=5.0, least_scale=LEAST)
    guard.winding_C, guard.housing_C = winding_C, housing_C
    return guard


@settings(max_examples=300, deadline=None)
@given(SIZES, st.one_of(SIZES, st.just(math.inf)), st.floats(0, 50), st.floats(25, 99), st.floats(25, 99))
def test_the_blend_keeps_the_margin_and_plays_whatever_scaling_plays(
    first_A: float, cool_A: float, feedback_A: float, winding_C: float, housing_C: float
) -> None:
    guard = guard_at(winding_C, housing_C)
    scale, part = guard.allowed(first_A, cool_A, feedback_A, 600)
    alone = guard.scale(first_A, feedback_A, 600)
    assert scale == 0.0 or LEAST <= scale <= 1.0 + 1e-12
    assert 0.0 <= part <= 1.0
    assert scale > 0.0 or not alone > 0.0
    if not cool_A < first_A:
        assert (scale, part) == (alone, 0.0)
    if scale > 0.0:
        norm_A = scale * (first_A if not part > 0.0 else (1 - part) * first_A + part * cool_A)
        assert guard.rise_K(norm_A, feedback_A, 600, 1.0) <= guard.play_limit_C - winding_C + 1e-9


def admissible(random: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Commands of noise that reach the command's or the current's limit, and end in zeros."""
    command = random.standard_normal(shape)
    command = np.apply_along_axis(np.convolve, -1, command, np.ones(8) / 8, mode="same")
    command[..., -TAIL:] = 0.0
    current = np.abs(currents(command, AMPLIFIER, DT_S)).max(axis=-1)
    size = np.minimum(COMMAND_A / np.abs(command).max(axis=-1), CURRENT_A / current)
    return np.asarray(size[..., None] * command)


def table_of(seed: int) -> Bank:
    random = np.random.default_rng(seed)
    shape = (4, 3, 120)
    cool = random.uniform(0.2, 1.0, (4, 3, 1)) * admissible(random, shape)
    cool[1, 1] = admissible(random, shape)[1, 1]
    bank = replace(smooth_bank(4, 3, 120), command_A=admissible(random, shape), cool_command_A=cool)
    return replace(bank, cool_transient_A=norms(currents(cool, AMPLIFIER, DT_S), AMPLIFIER, DT_S).tolist())


def drawn(bank: Bank, random: np.random.Generator) -> Play:
    return blend_at(bank, float(random.uniform(0.05, 0.6)), float(random.uniform(0.5, 7.0)))


@pytest.mark.parametrize("bits", [8, 16])
def test_no_blend_passes_a_limit(bits: int) -> None:
    """Places of a stored table, each with many parts; one count of the first waveforms is room for rounding."""
    random = np.random.default_rng(bits)
    bank, head = bank_of(image_of(table_of(bits), DT_S, 3e-4, TAIL, cool_bits=bits, amplifier=AMPLIFIER))
    parts = 100
    for _ in range(BLENDS // parts // 2):
        play = drawn(bank, random)
        part = random.uniform(0, 1, (parts, 1))
        part[:2] = ((0.0,), (1.0,))
        blends = (1 - part) * np.array(play.samples_A) + part * np.array(play.cool_samples_A)
        np.testing.assert_allclose(play.blended(float(part[2, 0])), blends[2], rtol=0, atol=1e-12)
        current = currents(blends, AMPLIFIER, DT_S)
        assert np.abs(blends).max() <= COMMAND_A + head["scale_A"]
        assert np.abs(current).max() <= CURRENT_A + head["scale_A"]
        bound_A = (1 - part[:, 0]) * play.transient_A + part[:, 0] * play.cool_transient_A
        assert np.all(norms(current, AMPLIFIER, DT_S) <= bound_A * (1 + 1e-12))
        assert not np.any(blends[:, -TAIL:])


@pytest.mark.parametrize("seed", range(6))
def test_what_is_allowed_heats_no_more_than_predicted(seed: int) -> None:
    random = np.random.default_rng(seed)
    bank = table_of(seed)
    bank, _ = bank_of(image_of(bank, DT_S, 3e-4, TAIL, cool_bits=(8, 16)[seed % 2], amplifier=AMPLIFIER))
    for left_K in np.geomspace(0.2, 2e-3, 12):
        play, start_C = drawn(bank, random), 95.0 - left_K
        ticks = len(play.samples_A) + 1
        housing_C = float(random.choice([60.0, start_C]))
        guard = guard_at(start_C, housing_C)
        scale, part = guard.allowed(play.transient_A, play.cool_transient_A, play.feedback_A, ticks)
        late, held = random.uniform(0, 1), np.array([0.0, *play.blended(part), 0.0])
        current = currents(scale * ((1 - late) * held[1:] + late * held[:-1]), AMPLIFIER, DT_S)
        fine = np.linspace(current[:-1], current[1:], 5)[:-1].T.ravel()
        coil = replace(COIL, start_winding_C=start_C, start_housing_C=housing_C)
        winding, _ = coil.simulate(effective_square(fine)[None], np.full(fine.size, DT_S / 4))
        if scale > 0:
            assert winding.max() <= guard.play_limit_C + 1e-9
