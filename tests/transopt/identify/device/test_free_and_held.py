"""The free device and held ones in one identification: found as the chain they are, whatever the amplifier does."""

from dataclasses import replace

import numpy as np
import pytest

from controller.record.excitation import sweep_command
from tests.benches.identification import AMPLIFIER, DEFAULT, DT_S, Rig, mismatched
from tests.transopt.identify.device.conftest import SETTINGS
from transopt.identify.device.chain import DriveChain
from transopt.identify.device.identify import identify
from transopt.identify.device.response import CURRENT
from transopt.identify.device.result import DeviceResult, Kind, device_part
from transopt.identify.device.trials import current_follows, sort_trials
from transopt.identify.measurement import Measurement

GRIPS_N = (0.0, 1.0, 3.0, 5.0)
LOW_HZ = {True: 20.0, False: 1.0}  # a free device drifts away from what is slower
DRIVES = {
    "default": lambda seed: mismatched(0.1, seed),
    # A heavier drive behind a softer transmission, and a hand with less skin.
    "soft": lambda seed: DriveChain(
        2.0, mismatched(0.1, seed).shared * [3.0, 2.0, 0.4, 1.0], mismatched(0.1, seed).hand * 0.6
    ),
}


def recorded(drive: str, seed: int, *, encoder: bool) -> tuple[DriveChain, list[Measurement]]:
    device = DRIVES[drive](seed)
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
@pytest.mark.parametrize("drive", DRIVES)
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
