"""Grips with different channels: each counts with what was read of it, and the device is found all the same."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benches.identification import AMPLIFIER, DEFAULT, Rig, assert_near, mismatched
from tests.transopt.identify.device.conftest import INSTRUMENT, SETTINGS
from transopt.identify.device.chain import ChainSearch, Coordinates, GripResponse, unknowns_of
from transopt.identify.device.chain_fit import fit_per_grip, refit
from transopt.identify.device.identify import identify
from transopt.identify.device.response import ACCELERATION, CURRENT, POSITION
from transopt.identify.device.response import INSTRUMENT as UNKNOWNS
from transopt.identify.device.result import Kind, device_part
from transopt.identify.device.trials import sort_trials
from transopt.identify.likelihood import Maximum
from transopt.identify.measurement import Measurement

GRIPS_N = (0.0, 1.0, 3.0, 5.0)
TRIALS = 3
DRIVES = {"both": (), "command": ("current",), "current": ("command",)}  # what is read, and what is then left out
POSITIONS = ("every trial", "all but one", "no trial")


@pytest.fixture(scope="module")
def rig() -> Rig:
    """A device 5 % off the nominal one, with an encoder."""
    return Rig(mismatched(0.05, 3), count_m=24.5e-6)


@pytest.fixture(scope="module")
def sweeps(rig: Rig) -> list[Measurement]:
    return rig.sweeps(GRIPS_N, trials=TRIALS, seed=6)


def without(run: Measurement, *channels: str) -> Measurement:
    return replace(run, **dict.fromkeys(channels))


def drawn(seed: int) -> dict[float, tuple[str, str]]:
    """Channels of each grip, drawn again until two held grips show different numbers of them."""
    random = np.random.default_rng(seed)
    while True:
        found = {grip: (str(random.choice([*DRIVES])), str(random.choice(POSITIONS))) for grip in GRIPS_N}
        counts = {(drive == "both") + (position == "every trial") for drive, position in list(found.values())[1:]}
        if len(counts) > 1:
            return found


def thinned(runs: list[Measurement], channels: dict[float, tuple[str, str]]) -> list[Measurement]:
    """The runs with the channels of their grips alone."""
    found, seen = [], set()
    for run in runs:
        drive, position = channels[run.grip_N or 0.0]
        first = run.grip_N not in seen
        seen.add(run.grip_N)
        lost = position == "no trial" or (position == "all but one" and first)
        found.append(without(run, *DRIVES[drive], *(("position",) if lost else ())))
    return found


@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(3, 20))])
def test_whatever_channels_each_grip_has_the_device_is_found(seed: int, rig: Rig, sweeps: list[Measurement]) -> None:
    channels = drawn(seed)
    bursts = thinned(rig.transients(GRIPS_N), channels)
    result = identify(thinned(sweeps, channels), bursts, SETTINGS)
    assert len({len(grip.response.outputs) for grip in result.grips}) > 1, channels
    part = device_part(result)
    for grip in (*GRIPS_N, 2.0, 4.0):
        assert_near(part.plant(grip), rig.device.plant(grip))
    assert all(error <= 0.05 for error in result.chosen.recorded.values()), channels
    assert all(0.7 < residual < 1.5 for residual in result.residuals), (channels, result.residuals)
    off = result.chain.unknowns - result.chain.coordinates.of(rig.device)
    assert np.median(np.abs(off) / np.sqrt(np.diag(result.chain.covariance))) < 2, channels


def test_a_state_space_is_found_too(rig: Rig, sweeps: list[Measurement]) -> None:
    settings = replace(SETTINGS, kind=Kind.STATE_SPACE, order=6)
    part = device_part(identify(thinned(sweeps, drawn(0)), [], settings))
    for grip in GRIPS_N[1:]:
        assert_near(part.plant(grip), rig.device.plant(grip))


def test_a_grip_without_an_encoder_is_fitted_alone_and_left_out_like_any_other(
    rig: Rig, sweeps: list[Measurement]
) -> None:
    runs = [without(run, "position") if run.grip_N == 3.0 else run for run in sweeps]
    result = identify(runs, [], SETTINGS)
    assert result.chain is not None
    measured = [grip.response for grip in result.grips]
    assert {one.grip_N for one in fit_per_grip(result.chain, measured, least_coherence=0.8)} == set(GRIPS_N[1:])
    for left_out in GRIPS_N[1:]:
        again = refit(result.chain, [one for one in measured if one.grip_N != left_out])
        assert again.scatter == pytest.approx(1.0, abs=0.3)
        assert_near(again.device.plant(2.0), rig.device.plant(2.0))


def chosen(one: GripResponse, outputs: tuple[int, ...]) -> GripResponse:
    """The response with some of its outputs alone, which follow each other."""
    first = one.outputs.index(outputs[0])
    return replace(one, outputs=outputs, data=one.data.some(outputs=slice(first, first + len(outputs))))


def test_the_sums_of_squares_of_a_grip_do_not_depend_on_the_channels_of_the_others(
    rig: Rig, sweeps: list[Measurement]
) -> None:
    held = sort_trials([run for run in sweeps if run.grip_N], [], AMPLIFIER, None).grips
    rows = ((ACCELERATION, POSITION), (CURRENT, ACCELERATION, POSITION), (ACCELERATION,))
    measured = [chosen(grip.response, outputs) for grip, outputs in zip(held, rows, strict=True)]
    coordinates = Coordinates(tuple(one.grip_N for one in measured))
    free = np.arange(coordinates.size + len(UNKNOWNS)) < coordinates.size
    at = np.concatenate([coordinates.of(rig.device), unknowns_of(INSTRUMENT)])

    def around(responses: list[GripResponse]) -> tuple[Maximum, float]:
        search = ChainSearch(responses, coordinates, INSTRUMENT, DEFAULT.force_per_current_N_A, free)
        residuals, _ = search.likelihood.evaluate(at)
        return search.likelihood.maximum_at(at, *search.bounds(at), free), float(residuals @ residuals)

    together, whole = around(measured)
    assert together.total == pytest.approx(whole)
    assert [squares.shape for squares in together.chi_square] == [(len(outputs),) for outputs in rows]
    for one, squares, points in zip(measured, together.chi_square, together.points, strict=True):
        alone, _ = around([one])
        np.testing.assert_allclose(squares, alone.chi_square[0], rtol=1e-9)
        np.testing.assert_array_equal(points, alone.points[0])
