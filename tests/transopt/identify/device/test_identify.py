"""From records to the device part of a model file: against a known truth, on records of two different simulations."""

import json
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from controller.record.excitation import sweep_command
from controller.sim.sensors import Sensors
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from controller.sim.user import StillHand
from tests.benches.identification import (
    ACCELEROMETER_HZ,
    DEFAULT,
    DT_S,
    Rig,
    assert_near,
    mismatched,
    spoilt,
)
from tests.transopt.identify.device.conftest import SETTINGS
from tests.transopt.identify.device.test_black_box import four_masses
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray, Signal
from transopt.identify.device.chain import DriveChain
from transopt.identify.device.findings import lack_of_fit
from transopt.identify.device.identify import identify
from transopt.identify.device.result import DeviceResult, Kind, device_part
from transopt.identify.device.validation import compare
from transopt.identify.findings import Fault
from transopt.identify.measurement import Measurement
from transopt.plant.state_space import StateSpace
from transopt.scene.scene import Scene

GRIPS_N = (0.0, 1.0, 3.0, 5.0)


@pytest.fixture(scope="module")
def rig() -> Rig:
    """A device 5 % off the nominal one, crossover on."""
    return Rig(mismatched(0.05, 3), crossover_A=0.01)


@pytest.fixture(scope="module")
def sweeps(rig: Rig) -> list[Measurement]:
    return rig.sweeps(GRIPS_N)


@pytest.fixture(scope="module")
def found(rig: Rig, sweeps: list[Measurement]) -> DeviceResult:
    return identify(sweeps, rig.transients((0.0, 1.0, 2.0, 3.0, 4.0, 5.0)), SETTINGS)


@pytest.fixture(scope="module")
def alone(sweeps: list[Measurement]) -> DeviceResult:
    """Without transients."""
    return identify(sweeps, [], SETTINGS)


def test_transients_outside_the_fit_are_predicted_at_recorded_grips_and_between(found: DeviceResult) -> None:
    assert set(found.chosen.recorded) == set(GRIPS_N)
    assert all(error <= 0.05 for error in found.chosen.recorded.values())
    assert set(found.chosen.between) == {2.0, 3.0, 4.0}
    assert all(error <= 0.08 for error in found.chosen.between.values())
    assert all(len(grip.fitted) == 4 for grip in found.grips)


def test_a_static_offset_of_the_accelerometer_costs_nothing(rig: Rig, found: DeviceResult) -> None:
    run = found.grips[2].kept[0]
    signal = run.require("acceleration")
    tilted = replace(run, acceleration=replace(signal, values=signal.values + 9.81))
    plain = compare(rig.device, 3.0, found.chosen.instrument, run)
    assert compare(rig.device, 3.0, found.chosen.instrument, tilted).nrmse == pytest.approx(plain.nrmse, rel=1e-6)


def test_without_transients_the_last_trial_of_each_grip_is_kept_out(alone: DeviceResult) -> None:
    for grip in alone.grips:
        assert [run.name for run in grip.kept] == [f"sweep_{grip.grip_N:g}N_3.npz"]
        assert len(grip.fitted) == 3


def test_two_trials_per_grip_leave_nothing_to_judge_by(sweeps: list[Measurement]) -> None:
    result = identify([run for run in sweeps if run.name[-5] in "01"], [], SETTINGS)
    assert "recorded trial" not in result.verdict
    assert device_part(result).nrmse == {}


def test_the_part_states_covariance_and_intervals_that_hold_the_truth(rig: Rig, found: DeviceResult) -> None:
    part = device_part(found)
    assert part.kind == "drive"
    assert len(part.parameters) == 14
    assert part.intervals["moving_mass_kg"][0] < part.moving_mass_kg < part.intervals["moving_mass_kg"][1]
    truth = dict(zip(part.parameters[:4], rig.device.shared.tolist(), strict=True))
    for name, value in truth.items():
        low, high = part.intervals[name]
        assert low - (high - low) < value < high + (high - low)
    assert len(part.sources) == 4 * 4 + 4
    assert json.loads(part.model_dump_json())["nrmse"].keys() == {"0", "1", "3", "5"}


def test_a_device_that_is_no_chain_is_given_to_the_black_box() -> None:
    """A second resonance at 150 Hz."""

    class Other(DriveChain):
        def plant(self, grip_N: float) -> StateSpace:
            return four_masses()

    rig = Rig(Other(1.25, DEFAULT.shared, DEFAULT.hand))
    result = identify(
        rig.sweeps((3.0,)), rig.transients((3.0,)), replace(SETTINGS, scene_plant=None, kind=Kind.AUTO, order=8)
    )
    assert result.chosen.kind is Kind.STATE_SPACE
    assert result.chosen.off < 0.3 * result.other.off
    [named] = [finding.text for finding in result.findings if finding.where == "further dynamics"]
    [rings] = re.findall(r"resonances of the state space: ([^;]*);", named)
    poles = np.linalg.eigvals(four_masses().A)
    true_Hz = sorted(np.abs(poles[(poles.imag > 0) & (-poles.real < 0.3 * np.abs(poles))]) / (2 * np.pi))
    assert [float(one.split()[0]) for one in rings.split(", ")] == pytest.approx(true_Hz, rel=0.02)
    part = device_part(result)
    assert part.kind == "state_space"
    assert_near(part.plant(3.0), four_masses())
    drive = identify(rig.sweeps((3.0,)), rig.transients((3.0,)), replace(SETTINGS, scene_plant=None))
    assert any("lack of fit at" in text and "at 3 N" in text for text in drive.advice)


def simulated(scene: Scene, grip_N: float, command_A: np.ndarray, seed: int, name: str) -> Measurement:
    """A record of the controller's simulator: absolute coordinates, its own integration and sensors."""
    wrong = Imperfections(crossover_A=0.01, sensors=Sensors())
    simulator = Simulator(
        device_of(scene), StillHand(grip_N, height_m=0.0), DT_S, imperfections=wrong, seed=seed, steps=1
    )
    rows = np.empty((command_A.size, 2))
    for k, command in enumerate(command_A.tolist()):
        read = simulator.readings()
        rows[k] = read.current_A, read.acceleration_m_s2
        simulator.advance(command)
    current, acceleration = (Signal(0.0, DT_S, column.copy()) for column in rows.T)
    return Measurement(
        name=name,
        source=name,
        sha256="0" * 64,
        command=Signal(0.0, DT_S, command_A),
        current=current,
        acceleration=acceleration,
        grip_N=grip_N,
        accelerometer_Hz=ACCELEROMETER_HZ,
    )


def test_records_of_the_simulator_lead_to_the_scenes_device(scene: Scene) -> None:
    """Another path through signs, read times and sensors: what it says must be what the design model says."""
    command = sweep_command(1.0, 2000.0, 1.0, 0.75, DT_S)
    runs = [
        simulated(scene, grip, (-1) ** j * command, 10 * j, f"{grip:g}N_{j}")
        for grip in (0.0, 1.0, 3.0, 5.0)
        for j in range(3)
    ]
    result = identify(runs, [], SETTINGS)
    part = device_part(result)
    for grip in (0.0, 1.0, 2.0, 3.0, 5.0):
        assert_near(part.plant(grip), scene.plant(grip))
    assert all(error <= 0.05 for error in result.chosen.recorded.values())
    assert all(0.7 < residual < 1.4 for residual in result.residuals)
    np.testing.assert_allclose(part.moving_mass_kg, scene.drive_at_tip().moving_mass_kg, rtol=0.02)


# ------------------------------------------------------------------------------------------------ bad input


def spoiled(runs: list[Measurement], which: int, spoil: Callable[[Measurement], Measurement]) -> list[Measurement]:
    return [spoil(run) if j == which else run for j, run in enumerate(runs)]


def scaled(run: Measurement, factor: float) -> Measurement:
    return replace(run, acceleration=run.require("acceleration").scaled(factor))


def driven(run: Measurement, spoil: Callable[[FloatArray], FloatArray]) -> Measurement:
    return spoilt(run, "current", spoil)


def cut(run: Measurement, samples: int) -> Measurement:
    return run.part(0, samples)


def clipped(run: Measurement) -> Measurement:
    return spoilt(run, "acceleration", lambda x: np.clip(x, -20.0, 20.0))


@pytest.fixture(scope="module")
def held(rig: Rig) -> list[Measurement]:
    return rig.sweeps((3.0,), seconds=1.0)


BAD = {
    "all reversed": (lambda runs: [scaled(run, -1.0) for run in runs], "wrong polarity.*turn the accelerometer"),
    "all in g": (lambda runs: [scaled(run, 1 / 9.80665) for run in runs], "units off by 9.81"),
    "one reversed": (lambda runs: spoiled(runs, 1, lambda run: scaled(run, -1.0)), "sweep_3N_1.npz: wrong polarity"),
    "one in g": (lambda runs: spoiled(runs, 2, lambda run: scaled(run, 1 / 9.80665)), "sweep_3N_2.npz: units off"),
    "clipped": (lambda runs: spoiled(runs, 0, clipped), "sweep_3N_0.npz: clipped sensor: acceleration"),
    # The last trial of three or more is kept for validation.
    "kept one reversed": (
        lambda runs: spoiled(runs, 3, lambda run: scaled(run, -1.0)),
        "sweep_3N_3.npz: wrong polarity: .* than in the sweeps of 3 N",
    ),
    "kept one in g": (
        lambda runs: spoiled(runs, 3, lambda run: scaled(run, 1 / 9.80665)),
        "sweep_3N_3.npz: units off by 9.81: .* of the sweeps of 3 N",
    ),
    "time in ms": (
        lambda runs: [run.changed(lambda _, x: replace(x, dt_s=1e3 * x.dt_s)) for run in runs],
        "sweep_3N_0.npz: sampled too slowly: 10 Hz, .*time_ms",
    ),
    "current in mA": (
        lambda runs: [driven(run, lambda current: 1e3 * current) for run in runs],
        "sweep_3N_0.npz: current off scale.*are both in A",
    ),
    "current reversed": (
        lambda runs: spoiled(runs, 1, lambda run: driven(run, np.negative)),
        "sweep_3N_1.npz: wrong polarity: current_A is opposite to command_A",
    ),
    "current monitor dead": (
        lambda runs: spoiled(
            runs, 1, lambda run: driven(run, lambda x: 0.005 * np.random.default_rng(1).standard_normal(x.size))
        ),
        "sweep_3N_1.npz: coherence low: the measured current does not follow the command",
    ),
    "ten samples": (lambda runs: [cut(run, 10) for run in runs], "3 N: too few cycles: .* bands of frequency"),
    "a hundred samples": (lambda runs: [cut(run, 100) for run in runs], "3 N: too few cycles"),
    "no grip": (lambda runs: spoiled(runs, 0, lambda run: replace(run, grip_N=None)), "sweep_3N_0.npz: missing grip"),
    "no acceleration": (
        lambda runs: spoiled(runs, 0, lambda run: replace(run, acceleration=None)),
        "sweep_3N_0.npz: no column acceleration_m_s2",
    ),
    "nothing driven": (
        lambda runs: spoiled(runs, 0, lambda run: replace(run, current=None, command=None)),
        "neither current_A nor command_A",
    ),
    "two sensors": (
        lambda runs: spoiled(runs, 0, lambda run: replace(run, accelerometer_Hz=1000.0)),
        "accelerometer_Hz 2500.0.*must be one sensor",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_record_is_named_with_what_to_do(case: str, held: list[Measurement]) -> None:
    spoil, message = BAD[case]
    with pytest.raises(InputError, match=message) as raised:
        identify(spoil(held), [], SETTINGS)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("factor", "message"),
    [(-1.0, "3 N: wrong polarity: position_m"), (1e3, "3 N: position off scale: .*name it position_mm")],
)
def test_a_position_that_is_reversed_or_in_mm_is_named(rig: Rig, factor: float, message: str) -> None:
    runs = replace(rig, count_m=24.5e-6).sweeps((3.0,), seconds=1.0)
    turned = [replace(run, position=run.require("position").scaled(factor)) for run in runs]
    with pytest.raises(InputError, match=message):
        identify(turned, [], SETTINGS)


@pytest.mark.parametrize(("shift", "words"), [(1, "1 samples later"), (-1, "1 samples earlier")])
def test_a_current_that_is_read_at_another_tick_is_reported_and_taken_out(
    rig: Rig, sweeps: list[Measurement], shift: int, words: str
) -> None:
    runs = [driven(run, lambda x: np.roll(x, shift)) for run in sweeps if run.grip_N == 3.0]
    result = identify(runs, [], SETTINGS)
    findings = [str(finding) for finding in result.findings if finding.fault is Fault.SHIFTED]
    assert len(findings) == len(runs)
    assert words in findings[0]
    assert result.causes == ["read delay"]
    assert result.chain.instrument.late == pytest.approx(-shift, abs=0.01)
    assert_near(device_part(result).plant(3.0), rig.device.plant(3.0))


def test_an_accelerometer_of_unknown_bandwidth_is_reported(held: list[Measurement]) -> None:
    result = identify([replace(run, accelerometer_Hz=None) for run in held], [], SETTINGS)
    assert any(finding.fault is Fault.BANDWIDTH for finding in result.findings)


def test_lack_of_fit_names_its_band(found: DeviceResult, rig: Rig) -> None:
    soft = DriveChain(1.25, rig.device.shared, rig.device.hand * [[1.0], [0.5], [1.0], [1.0], [1.0]])
    bands = lack_of_fit(found.grips[2].response, soft, found.chosen.instrument)
    assert bands
    assert all(2 <= low <= high <= 800 for low, high in bands)
    assert lack_of_fit(found.grips[2].response, found.chosen.model, found.chosen.instrument) == []


def test_the_largest_recorded_current_of_each_grip_is_stated(found: DeviceResult, alone: DeviceResult) -> None:
    """Sweeps reach 0.75 A, the taps beside them 3 A; sensors add their noise."""
    assert found.error.recorded_A == pytest.approx([3.0] * 4, rel=0.05)
    assert alone.error.recorded_A == pytest.approx([0.75] * 4, rel=0.05)
    assert device_part(alone).error == alone.error


def test_a_burst_recorded_from_its_middle_on_is_named_and_judges_nothing(rig: Rig, sweeps: list[Measurement]) -> None:
    """Alone, it would look like an amplifier that gives way: what moves it at first is in no record."""
    whole = rig.transients((1.0, 3.0, 5.0))

    def cut(run: Measurement) -> Measurement:
        return run.changed(lambda _, x: replace(x, values=x.values[230:]))  # 3 ms into the burst, from tick 200 on

    late = [cut(run) for run in whole]
    result = identify(sweeps, [*late[:1], *whole[1:]], SETTINGS)
    (said,) = [finding for finding in result.findings if finding.where == whole[0].name]
    assert said.fault is Fault.CUT_SHORT
    assert "off its rest" in said.text
    assert "amplifier saturation" not in result.causes
    assert {tap.grip_N for tap in result.error.at_use} == {3.0, 5.0}
    # The whole ones tell of no such thing.
    assert not [f for f in result.findings if f.where in {run.name for run in whole[1:]}]
