"""The most probable hand behind played taps: it is found, its intervals hold, and the population fills the gaps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.identify.calibration import Calibration, PlayedRecord, calibrate
from transopt.identify.device.chain import HAND, log_slopes
from transopt.identify.device.response import ACCELERATION, CURRENT, POSITION, Instrument, courses, responses
from transopt.library.library import Library
from transopt.plant.amplifier import Amplifier
from transopt.plant.hand import HandSection
from transopt.scene.builtin import POPULATION
from transopt.scene.model_parts import DriveDevice
from transopt.scene.population import Population, load_population
from transopt.scene.scene import Scene

DT_S, POLE_HZ, NOISE_M_S2, COUNT_M = 1e-4, 2500.0, 0.2, 24.5e-6
AMPLIFIER = Amplifier(1050.0, 68e-6, 6.0)
INSTRUMENT = Instrument(DT_S, AMPLIFIER, POLE_HZ)
BEFORE, AFTER = 500, 303


@pytest.fixture(scope="module")
def population() -> Population:
    return load_population(POPULATION)


@pytest.fixture(scope="module")
def drive(scene: Scene, population: Population) -> DriveDevice:
    tip, model = scene.drive_at_tip(), scene.model
    stated = {"force_per_current_N_A": tip.force_per_current_N_A, "moving_mass_kg": tip.moving_mass_kg}
    joint = {"transmission_stiffness_N_m": tip.stiffness_N_m, "transmission_damping_N_s_m": tip.damping_N_s_m}
    nothing = {"nrmse": {}, "intervals": {}, "parameters": [], "covariance": [], "verdict": "", "sources": []}
    own = {"kind": "drive", "stylus_mass_kg": model.stylus_mass_kg, "grips_N": [1.0, 3.0, 5.0]}  # type: ignore[union-attr]
    hand = population.hand(population.mean()).model_dump()
    return DriveDevice.model_validate({**own, **stated, **joint, **nothing, "hand": hand})


def truth_of(hand: HandSection, population: Population) -> FloatArray:
    return np.log([hand.line(name).at(grip) for grip in population.grips_N for name in HAND])


def record(
    scene: Scene, library: Library, hand: HandSection, place: tuple[int, int], seed: int, *, dead_A: float = 0.0
) -> PlayedRecord:
    """A tap by equations of other make: the chain mode by mode, in 25 steps to a tick.

    The current has a dead band, the stylus comes with a speed and an acceleration of its own.
    """
    iv, ig = place
    grip, random = float(library.grips_N[ig]), np.random.default_rng(seed)
    command = np.concatenate([np.zeros(BEFORE), library.command[iv, ig]])[: BEFORE + AFTER]
    plant, fine = scene.in_hand(hand).plant(grip), 25
    h, late = DT_S / fine, round(AMPLIFIER.delay_s / DT_S * fine)
    felt = np.repeat(command - np.clip(command, -dead_A, dead_A), fine)
    felt = np.append(np.zeros(late), felt)[: felt.size]
    w = 2 * np.pi * AMPLIFIER.pole_Hz
    current = signal.lfilter([0, 1 - np.exp(-w * h)], [1, -np.exp(-w * h)], felt)
    p = 2 * np.pi * POLE_HZ
    rates, modes = np.linalg.eig(plant.A)
    driven, rows = np.linalg.solve(modes, plant.B[:, 0]), np.vstack([plant.C, plant.Ce]) @ modes
    mean = (current + np.append(0.0, current[:-1])) / 2
    out = np.zeros((felt.size, 2))
    for rate, push, row in zip(rates, driven, rows.T, strict=True):
        gone = np.exp(rate * h)
        out += np.outer(signal.lfilter([push * (gone - 1) / rate], [1, -gone], mean), row).real
    sensed = signal.lfilter([1 - np.exp(-p * h)], [1, -np.exp(-p * h)], (out[:, 0] + np.append(0.0, out[:-1, 0])) / 2)
    at, n = slice(None, None, fine), command.size
    t = (np.arange(n) - BEFORE) * DT_S
    own = -0.2 * t + 0.7 * t**2 / 2
    kept = np.exp(-p * DT_S)
    noise = signal.lfilter([np.sqrt(1 - kept**2)], [1, -kept], NOISE_M_S2 * random.standard_normal(n))
    return PlayedRecord(
        grip_N=grip * (1 + 0.02 * random.standard_normal()),
        dt_s=DT_S,
        command_A=command,
        current_A=current[at] + 0.005 * random.standard_normal(n),
        acceleration_m_s2=sensed[at] + 9.81 + noise,
        position_m=np.round((out[at, 1] + own) / COUNT_M) * COUNT_M,
        first=BEFORE,
        acceleration_noise_m_s2=NOISE_M_S2,
        position_noise_m=COUNT_M / np.sqrt(12),
    )


class TestCourses:
    def test_a_steady_tone_has_the_amplitude_and_phase_of_the_response(self, drive: DriveDevice) -> None:
        plant, f = drive.plant(3.0), 200.0
        t = np.arange(4000) * DT_S
        found = courses(plant, INSTRUMENT, np.sin(2 * np.pi * f * t))[0]
        value = responses(plant, INSTRUMENT, np.array([f]), position=True)[0][:, 0]
        late = t > 0.3
        for row in (CURRENT, ACCELERATION, POSITION):
            wanted = (value[row] * np.exp(2j * np.pi * f * t[late])).imag
            tone = found[row, late] - found[row, late].mean()  # the position drifts to where the arm holds it
            assert np.abs(tone - wanted).max() < 1e-3 * abs(value[row])

    def test_slopes_are_those_of_differences(self, drive: DriveDevice) -> None:
        values = np.array([0.014, 0.026, 6e4, 8.0, 0.01, 9e3, 15.0, 490.0, 15.0])
        command = np.random.default_rng(0).standard_normal(60)
        plant, slopes = log_slopes(values, 1.25)
        found = courses(plant, INSTRUMENT, command, slopes)
        for j in range(values.size):
            up, down = (
                courses(log_slopes(values * np.exp(sign * 1e-5 * np.eye(9)[j]), 1.25)[0], INSTRUMENT, command)[0]
                for sign in (1, -1)
            )
            assert found[1 + j] == pytest.approx((up - down) / 2e-5, abs=1e-6 * np.abs(found[1 + j]).max() + 1e-9)

    def test_a_ramped_input_moves_a_hand_as_scipy_says(self) -> None:
        """Stylus, skin, hand and arm under a force that is linear between samples, and their slopes."""
        force = np.append(0.0, np.random.default_rng(0).standard_normal(199).cumsum())
        values, stylus = np.array([0.04, 0.17, 1e4, 20.0, 150.0, 9.0]), ("stylus_mass_kg",)
        for dt_s in (1e-4, 5e-4):
            plant, slopes = log_slopes(values, 1.0, stylus)
            found = courses(plant, Instrument(dt_s), force, slopes, ramped=True)[:, ACCELERATION]
            _, wanted, _ = signal.lsim((plant.A, plant.B, plant.C, plant.D), force, dt_s * np.arange(200))
            assert found[0] == pytest.approx(wanted, abs=1e-11 * np.abs(wanted).max())
            for j in range(values.size):
                up, down = (
                    log_slopes(values * np.exp(sign * 1e-5 * np.eye(6)[j]), 1.0, stylus)[0] for sign in (1, -1)
                )
                up_s, down_s = (courses(one, Instrument(dt_s), force, ramped=True)[0, 1] for one in (up, down))
                assert found[1 + j] == pytest.approx((up_s - down_s) / 2e-5, abs=1e-6 * np.abs(found[1 + j]).max())


def three(scene: Scene, library: Library, hand: HandSection, seed: int) -> list[PlayedRecord]:
    return [record(scene, library, hand, (1, ig), 10 * seed + ig, dead_A=0.01) for ig in range(3)]


def test_hands_are_found_and_the_intervals_hold(
    scene: Scene, library: Library, drive: DriveDevice, population: Population
) -> None:
    squares = []
    for seed, hand in enumerate(population.drawn(3, 31, scene.grid.grips_N)):
        found = calibrate(three(scene, library, hand, seed), drive, INSTRUMENT, population, [])
        off = found.logarithms - truth_of(hand, population)
        assert np.abs(off[[3, 4, 8, 9]]).max() < 0.08  # the arm, which the position tells
        assert max(found.scatter) < 1.5
        assert all(by_taps for _, _, by_taps in found.determined.values())
        squares.append(float(off @ np.linalg.solve(found.covariance, off)))
    # 30 squares of normal numbers: between 15 and 51 in 98 of 100.
    assert 10 < sum(squares) < 57


def test_where_nothing_was_played_the_population_speaks(
    scene: Scene, library: Library, drive: DriveDevice, population: Population
) -> None:
    one = record(scene, library, population.hand(population.mean()), (1, 1), 3)
    still = replace(one, command_A=0 * one.command_A, current_A=np.full(one.current_A.size, 0.02))
    quiet = replace(still, acceleration_m_s2=np.random.default_rng(1).normal(9.81, 0.2, one.current_A.size))
    at_rest = replace(quiet, position_m=np.round(-0.2 * DT_S * np.arange(one.current_A.size) / COUNT_M) * COUNT_M)
    found = calibrate([at_rest], drive, INSTRUMENT, population, [])
    assert found.logarithms == pytest.approx(population.mean(), abs=1e-6)
    assert found.covariance == pytest.approx(population.covariance(), abs=1e-9)
    assert not any(by_taps for _, _, by_taps in found.determined.values())
    assert "left to the population: mass_kg, skin_stiffness_N_m" in found.in_words
    assert "at other grips the population speaks" in found.in_words


def test_a_drive_that_is_another_one_weakens_the_taps_and_is_said(
    scene: Scene, library: Library, drive: DriveDevice, population: Population
) -> None:
    hand = population.drawn(1, 32, scene.grid.grips_N)[0]
    taps = three(scene, library, hand, 1)
    heavy = drive.model_copy(update={"stylus_mass_kg": 1.4 * drive.stylus_mass_kg, "transmission_stiffness_N_m": 2e4})
    right, wrong = (calibrate(taps, each, INSTRUMENT, population, []) for each in (drive, heavy))
    assert "as far from any such hand" not in right.in_words
    assert "as far from any such hand as the sensors' noise explains" in wrong.in_words
    assert np.all(wrong.deviation > right.deviation)


def test_the_model_file_states_the_hand_with_its_covariance(
    scene: Scene, library: Library, drive: DriveDevice, population: Population
) -> None:
    hand = population.drawn(1, 33, scene.grid.grips_N)[0]
    found: Calibration = calibrate(three(scene, library, hand, 2), drive, INSTRUMENT, population, [])
    device = found.device
    assert device.verdict == found.in_words
    light, firm = found.at_ends
    for j, name in enumerate(HAND):
        line = device.hand.line(name)
        assert (line.at(1.0), line.at(5.0)) == pytest.approx((light[j], firm[j]))
        assert device.intervals[f"hand.{name}.constant"][0] < line.constant
    assert device.parameters[0] == "hand.mass_kg.constant"
    # The covariance of constant + per_newton is that of the value at 1 N.
    at = np.array([1.0, 1.0])
    part = np.array(device.covariance)[:2, :2]
    assert at @ part @ at == pytest.approx(found.covariance[0, 0] * light[0] ** 2)


def test_without_taps_there_is_no_hand(drive: DriveDevice, population: Population) -> None:
    with pytest.raises(InputError, match="no tap was played to its end"):
        calibrate([], drive, INSTRUMENT, population, [])


def test_grips_where_the_hand_is_not_passive_are_refused(
    scene: Scene, library: Library, drive: DriveDevice, population: Population
) -> None:
    tap = record(scene, library, population.hand(population.mean()), (1, 1), 4)
    far = drive.model_copy(update={"grips_N": [1.0, 40.0]})
    steep = population.model_dump()
    steep["skin_damping_N_s_m"]["median"] = [21.0, 9.0]
    with pytest.raises(InputError, match=r"linear in grip from 1 and 5 N, and not passive farther out \("):
        calibrate([tap], far, INSTRUMENT, Population.model_validate(steep), [])
