"""Bad records: each is named, with what to record again, and good ones raise nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.record.trial_file import write_measurement
from tests.benches.sweeps import DT_S, amplifier_trial, device_columns
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray, Signal, flat_extreme
from transopt.identify import checks
from transopt.identify.findings import Fault, Finding, refuse
from transopt.identify.measurement import Measurement, load_measurement
from transopt.identify.spectrum import TransferEstimate, Trial, check_rates, estimate_transfer

ALL = ("command", "current", "acceleration")


@pytest.fixture(scope="module")
def columns() -> dict[float, list[dict[str, FloatArray]]]:
    return {grip: [device_columns(grip, 10 * j, sign=(-1) ** j) for j in range(2)] for grip in (0.0, 1.0, 5.0)}


def run(columns: dict[str, FloatArray], grip_N: float | None = None, name: str = "trial") -> Measurement:
    signals = {
        key.split("_")[0]: Signal(0.0, DT_S, values) for key, values in columns.items() if not key.startswith("time")
    }
    return Measurement(name, name, "0" * 64, grip_N=grip_N, **signals)  # type: ignore[arg-type]


def transfer(trials: list[dict[str, FloatArray]], factor: float = 1.0) -> TransferEstimate:
    return estimate_transfer(
        [
            Trial(f"{j}", Signal(0.0, DT_S, t["current_A"]), Signal(0.0, DT_S, factor * t["acceleration_m_s2"]))
            for j, t in enumerate(trials)
        ]
    )


def only(findings: list[Finding], fault: Fault, *, fatal: bool) -> str:
    assert [finding.fault for finding in findings] == [fault]
    assert findings[0].fatal == fatal
    assert "\n" not in str(findings[0])
    return str(findings[0])


# ---------------------------------------------------------------------------------------------------- good records


@pytest.mark.parametrize("grip_N", [0.0, 1.0, 5.0])
def test_good_records_of_a_device_raise_nothing(columns: dict, grip_N: float) -> None:
    runs = [run(c, grip_N) for c in columns[grip_N]]
    assert [f for one in runs for f in checks.check_measurement(one, ALL)] == []
    assert checks.check_grips(runs) == []
    estimate = transfer(columns[grip_N])
    assert checks.check_passive("grip", estimate) == []
    trials = [
        Trial("t", Signal(0.0, DT_S, c["current_A"]), Signal(0.0, DT_S, c["current_A"])) for c in columns[grip_N]
    ]
    assert check_rates(trials) == []
    assert checks.check_cycles("grip", trials, estimate, 2.0) == []
    assert checks.check_gravity("grip", estimate, 1.3 * np.abs(estimate.response), "the model") == []
    assert checks.low_coherence("grip", estimate.between(10, 1000)) == []


# --------------------------------------------------------------------------------------------------- cycles, rates


def test_too_few_cycles_name_the_band() -> None:
    hasty = amplifier_trial(1, seconds=0.12)
    found = checks.check_cycles("all files", [hasty], estimate_transfer([hasty]), 10.0)
    message = only(found, Fault.TOO_FEW_CYCLES, fatal=False)
    assert "cycles per octave below" in message
    assert "Hz in 1 trials, must be at least 1; sweep" in message


def test_what_was_not_swept_is_not_asked_for() -> None:
    """A jump to an offset leaves lines below the sweep, as if there were cycles."""
    low_Hz = 40.0
    for offset_A in (0.0, 0.5):
        trials = [amplifier_trial(j, offset_A=offset_A, low_Hz=low_Hz) for j in range(4)]
        estimate = estimate_transfer(trials)
        from_Hz = checks.swept_from(trials, estimate)
        assert 0.5 * low_Hz < from_Hz < 1.5 * low_Hz
        assert checks.check_cycles("all files", trials, estimate, from_Hz) == []


def test_cycles_are_counted_as_they_were_played() -> None:
    seconds, low, high = 8.0, 10.0, 4000.0
    sweep = amplifier_trial(1, seconds=seconds)
    per_octave = seconds / np.log2(high / low)
    wanted = per_octave / np.log(2) * np.array([50.0, 100.0, 400.0])  # of the octave above, which has twice as many
    found = checks.cycles_per_octave([sweep], np.array([50.0, 100.0, 400.0]))
    np.testing.assert_allclose(found, wanted, rtol=0.1)
    twice = checks.cycles_per_octave([sweep, sweep], np.array([50.0, 100.0, 400.0]))
    np.testing.assert_allclose(twice, 2 * found, rtol=1e-12)


# ------------------------------------------------------------------------------------------- clipping, excitation


@pytest.mark.parametrize("limit", [0.99, 0.7, 0.3])
def test_a_clipped_accelerometer(columns: dict, limit: float) -> None:
    one = dict(columns[1.0][0])
    peak = float(np.abs(one["acceleration_m_s2"]).max())
    one["acceleration_m_s2"] = np.clip(one["acceleration_m_s2"], -limit * peak, limit * peak)
    found = checks.check_measurement(run(one), ALL)
    assert {f.fault for f in found} <= {Fault.CLIPPED}
    if limit < 0.9:
        assert len(found) == 2  # both sides
        assert found[0].fatal
        assert "acceleration: " in str(found[0])
        assert "samples at the highest value" in str(found[0])
        assert "lower the amplitude, or take a sensor of wider range, and record again" in str(found[0])


@pytest.mark.parametrize("bits", [6, 8, 12])
def test_a_coarse_converter_is_not_a_clipped_one(bits: int) -> None:
    sine = 0.9 * np.sin(2 * np.pi * 1.0 * DT_S * np.arange(20000))
    step = 2.0 / 2**bits
    assert flat_extreme(step * np.round(sine / step)).size == 0
    assert flat_extreme(step * np.round(np.minimum(sine, 0.8) / step)).size > 1000


@pytest.mark.parametrize("offset_A", [0.4, -0.4])
def test_a_quiet_monitor_of_12_bits_is_not_clipped_where_it_rests(offset_A: float) -> None:
    """A current of one sign has its extreme at rest, where the converter tells two values or three."""
    swept_A = offset_A * (1 - np.cos(2 * np.pi * 5.0 * DT_S * np.arange(10_000)))
    current_A = np.concatenate([np.zeros(500), swept_A, np.zeros(1000)])
    step_A = 22.0 / 2**12
    noisy_A = current_A + 0.4 * step_A * np.random.default_rng(1).standard_normal(current_A.size)
    one = {"command_A": current_A, "current_A": step_A * np.round(noisy_A / step_A)}
    assert checks.check_measurement(run(one), ("current",)) == []
    one["current_A"] = np.clip(one["current_A"], -0.6, 0.6)
    assert [f.fault for f in checks.check_measurement(run(one), ("current",))] == [Fault.CLIPPED]


def test_a_saturated_command() -> None:
    trial = amplifier_trial(1, amplitude_A=1.0)
    cut = {"command_A": np.clip(trial.input.values, -0.9, 0.9), "current_A": trial.output.values}
    found = checks.check_measurement(run(cut), ALL)
    assert [f.fault for f in found] == [Fault.SATURATED, Fault.SATURATED]
    assert "lower amplitude or offset and record again" in str(found[0])


@pytest.mark.parametrize("held", [4, 50])
def test_steps_between_levels_are_not_clipped(held: int) -> None:
    """A random binary sequence dwells at its extremes as a clipped sine does, and has nothing between its levels."""
    levels = np.repeat(np.random.default_rng(held).choice([-1.0, 1.0], 8000 // held), held)
    levels[:100] = levels[-100:] = 0.0
    assert checks.check_measurement(run({"voltage_V": levels}), ["voltage"]) == []
    sine = 10 * np.sin(2 * np.pi * 25 * DT_S * np.arange(20000))
    for wrong in ({"acceleration_m_s2": levels}, {"voltage_V": np.clip(sine, -1, 1)}):
        (quantity,) = (name.split("_")[0] for name in wrong)
        assert Fault.CLIPPED in {f.fault for f in checks.check_measurement(run(wrong), [quantity])}


def test_no_excitation() -> None:
    still = {"command_A": np.zeros(1000), "current_A": np.random.default_rng(0).normal(0, 0.005, 1000)}
    found = [f for f in checks.check_measurement(run(still), ALL) if f.fault is not Fault.CUT_SHORT]
    assert "command stays at 0 A" in only(found, Fault.NO_EXCITATION, fatal=True)


def test_a_record_that_is_cut_short() -> None:
    trial = amplifier_trial(1)
    found = checks.check_measurement(
        run({"command_A": trial.input.values[:9001], "current_A": trial.output.values[:9001]}), ALL
    )
    assert "record until everything rests" in only(found, Fault.CUT_SHORT, fatal=False)


# -------------------------------------------------------------------------------------------------------- jitter


@pytest.mark.parametrize(("jitter", "fatal"), [(0.03, False), (0.3, True)])
def test_jitter_says_what_it_does(tmp_path: Path, columns: dict, jitter: float, fatal: bool) -> None:
    shaken = dict(columns[1.0][0])
    shaken["time_s"] = shaken["time_s"] + DT_S * jitter * np.random.default_rng(2).uniform(
        -1, 1, shaken["time_s"].size
    )
    write_measurement(tmp_path / "j.npz", shaken, {"grip_N": 1.0})
    read = load_measurement(tmp_path / "j.npz")
    assert 0.4 * jitter < read.off_grid < jitter  # the rms of what is uniform is 0.58 of the largest
    read = replace(read, off_grid=0.25) if fatal else read
    message = only(checks.check_measurement(read, ALL), Fault.JITTER, fatal=fatal)
    assert "steps (rms) off the uniform grid, resampled to it: phases are off by" in message
    assert ("must be at most 0.2; sample by the servo's timer and record again" in message) == fatal
    write_measurement(tmp_path / "even.npz", columns[1.0][0], {"grip_N": 1.0})
    assert checks.check_measurement(load_measurement(tmp_path / "even.npz"), ALL) == []


# ----------------------------------------------------------------------------------------------- polarity, units


def test_a_current_sensor_the_wrong_way_round() -> None:
    trial = amplifier_trial(1)
    turned = Trial("turned", trial.input, trial.output.scaled(-1.0))
    found = checks.check_sign("turned", estimate_transfer([turned]))
    message = only(found, Fault.POLARITY, fatal=True)
    assert "turned: wrong polarity: from command to current: phase" in message
    assert message.endswith(
        "must be near 0; swap the leads of the current sensor or correct its sign, and record again"
    )


@pytest.mark.parametrize("grip_N", [0.0, 1.0, 5.0])
def test_an_accelerometer_the_wrong_way_round(columns: dict, grip_N: float) -> None:
    found = checks.check_passive(f"grip {grip_N:g} N", transfer(columns[grip_N], -1.0))
    assert "turn the accelerometer or swap the motor's leads" in only(found, Fault.POLARITY, fatal=True)


def test_noise_has_no_polarity(columns: dict) -> None:
    random = np.random.default_rng(5)
    blind = [{**c, "acceleration_m_s2": random.standard_normal(c["current_A"].size)} for c in columns[0.0]]
    assert checks.check_passive("grip", transfer(blind)) == []


@pytest.mark.parametrize(("factor", "ratio"), [(STANDARD_GRAVITY_M_S2, "9.8"), (1 / STANDARD_GRAVITY_M_S2, "0.102")])
@pytest.mark.parametrize("device", [0.85, 1.0, 1.15])
def test_units_off_by_gravity(columns: dict, factor: float, ratio: str, device: float) -> None:
    estimate = transfer(columns[1.0])
    found = checks.check_gravity("grip", estimate, device * np.abs(estimate.response) / factor, "the model")
    message = only(found, Fault.UNITS, fatal=True)
    assert "times that of the model, 9.81" in message
    assert "Correct its name" in message
    if device == 1.0:
        assert ratio in message


# --------------------------------------------------------------------------------------------------------- grips


def test_a_file_without_its_grip(columns: dict) -> None:
    message = only(checks.check_grips([run(columns[1.0][0], None, "a.npz")]), Fault.MISSING_GRIP, fatal=True)
    assert message == "a.npz: missing grip: no grip stated; add # grip_N: 3 (0 if nobody holds it)"


def test_a_grip_with_one_trial_or_one_polarity(columns: dict) -> None:
    first, second = columns[1.0]
    one = only(checks.check_grips([run(first, 1.0)]), Fault.MISSING_GRIP, fatal=False)
    assert one.startswith("grip 1 N: missing grip: 1 trial, at least 2 are needed")
    same = only(checks.check_grips([run(first, 1.0), run(first, 1.1)]), Fault.MISSING_GRIP, fatal=False)
    assert "all trials have one polarity" in same
    assert checks.check_grips([run(first, 1.0), run(second, 1.1)]) == []


def test_grips_that_wander_are_one_group_but_never_with_the_free_device(columns: dict) -> None:
    runs = [run(columns[1.0][0], grip) for grip in (3.1, 0.1, 0.0, 2.9, 3.0, 5.0)]
    groups = checks.by_grip(runs)
    assert [len(group) for group in groups.values()] == [1, 1, 3, 1]
    np.testing.assert_allclose(list(groups), [0.0, 0.1, 3.0, 5.0])


# ------------------------------------------------------------------------------------------------------- refusal


def test_low_coherence_names_the_stretch(columns: dict) -> None:
    estimate = transfer(columns[1.0])
    band = (estimate.frequencies_Hz > 80) & (estimate.frequencies_Hz < 120)
    found = checks.low_coherence("grip 5 N", replace(estimate, coherence=np.where(band, 0.4, 0.99)))
    message = only(found, Fault.INCOHERENT, fatal=False)
    assert message.startswith("grip 5 N: coherence low: 0.40 at 8")
    assert "Hz, must be 0.8; record again there with more current" in message


def test_refusal_shows_the_first_fatal_finding_and_keeps_the_others() -> None:
    mild = Finding(Fault.JITTER, "a", "a little", False)
    worse = Finding(Fault.CLIPPED, "b", "much", True)
    assert refuse([mild]) == [mild]
    with pytest.raises(InputError, match=r"^b: clipped sensor: much \(and 1 more such findings\)$"):
        refuse([mild, worse, worse])
