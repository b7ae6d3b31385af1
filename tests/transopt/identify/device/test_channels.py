"""Grips with different channels, the free device and held ones: found all the same."""

from dataclasses import replace

import numpy as np
import pytest

from controller.record.excitation import sweep_command
from tests.benches.identification import AMPLIFIER, DEFAULT, DT_S, Rig, assert_near, mismatched
from tests.transopt.identify.device.conftest import INSTRUMENT, SETTINGS
from transopt.identify.device.chain import ChainSearch, Coordinates, DriveChain, GripResponse, unknowns_of
from transopt.identify.device.identify import identify
from transopt.identify.device.response import ACCELERATION, CURRENT, POSITION
from transopt.identify.device.response import INSTRUMENT as UNKNOWNS
from transopt.identify.device.result import DeviceResult, Kind, device_part
from transopt.identify.device.trials import current_follows, sort_trials
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


LOW_HZ = {True: 20.0, False: 1.0}  # a free device drifts away from what is slower
DEVICES = {
    "default": lambda seed: mismatched(0.1, seed),
    # A heavier drive behind a softer transmission, and a hand with less skin.
    "soft": lambda seed: DriveChain(
        2.0, mismatched(0.1, seed).shared * [3.0, 2.0, 0.4, 1.0], mismatched(0.1, seed).hand * 0.6
    ),
}


def recorded(drive: str, seed: int, *, encoder: bool) -> tuple[DriveChain, list[Measurement]]:
    device = DEVICES[drive](seed)
    rig = Rig(device, crossover_A=0.01, count_m=2e-6 if encoder else None)
    runs = []
    for grip in GRIPS_N:
        command = sweep_command(LOW_HZ[grip == 0], 2000.0, 2.0, 0.75, DT_S)
        runs += [rig.record(f"{grip:g}N_{j}.npz", grip, (-1) ** j * command, 1000 * seed + j) for j in range(4)]
    return device, runs


def worst_error(result: DeviceResult, device: DriveChain) -> float:
    """Largest rms over 20 to 800 Hz of the model's response less the true one, relative to the true one's."""
    frequencies = np.geomspace(20.0, 800.0, 300)
    part, errors = device_part(result), []
    for grip in GRIPS_N:
        truth = device.plant(grip).response(frequencies)
        off = np.linalg.norm(part.plant(grip).response(frequencies) - truth)
        errors.append(float(off / np.linalg.norm(truth)))
    return max(errors)


def check(drive: str, seed: int, *, encoder: bool) -> None:
    device, runs = recorded(drive, seed, encoder=encoder)
    known = replace(DEFAULT, force_per_current_N_A=device.force_per_current_N_A)
    result = identify(runs, [], replace(SETTINGS, nominal=known, kind=Kind.AUTO))
    assert result.chosen.kind is Kind.DRIVE
    assert worst_error(result, device) < 1e-3


def test_a_free_device_is_found_with_the_held_ones() -> None:
    check("default", 1, encoder=True)


@pytest.mark.long
@pytest.mark.parametrize("encoder", [True, False])
@pytest.mark.parametrize("drive", DEVICES)
@pytest.mark.parametrize("seed", range(10))
def test_every_recording_is_found_as_the_chain_it_is(drive: str, seed: int, encoder: bool) -> None:
    check(drive, seed, encoder=encoder)


def test_an_amplifier_that_is_no_pole_at_one_grip_is_taken_for_none_at_another() -> None:
    """Alone, the dead band looks like another pole where the slow part of a sweep is missing."""
    _, runs = recorded("default", 1, encoder=True)
    records = sort_trials(runs, [], AMPLIFIER, None)
    groups = [grip.fitted for grip in records.grips]
    assert current_follows(groups[:1], records.instrument)
    assert not current_follows(groups, records.instrument)
    assert not any(CURRENT in grip.response.outputs for grip in records.grips)
