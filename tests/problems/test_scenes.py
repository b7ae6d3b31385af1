"""Every built-in scene solves, is proven, and shows what it says; every motor is one row of its datasheet."""

import tomllib
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import problems
from tests.benches.independent import assert_independent_check_is_clean
from tests.transopt.design.test_build import assert_entries_are_proven
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.design.build import Build, build_library
from transopt.design.verify import verify_library
from transopt.plant.motor import Motor
from transopt.recordings.tap import read_recordings
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings, strike

# The recordings of this scene are not part of the package; test_build.py solves it where they are at hand.
# An arm has several motors and a library of its own kind: tests/transopt/library/test_arm.py.
ELSEWHERE = {"measured_impacts", "stylus_3d"}
SCENES = [name for name in problems.scene_names() if name not in ELSEWHERE]
MOTORS = sorted((problems.FOLDER / "motors").glob("*.toml"))


def load(name: str) -> Scene:
    return problems.load(name)


@cache
def built(name: str) -> Build:
    scene = load(name)
    taps = recordings(scene) if scene.recordings.simulated else read_recordings(scene.recordings)
    return build_library(scene, taps)


def modes_Hz(scene: Scene, grip_N: float) -> FloatArray:
    """Natural frequencies of the oscillating modes."""
    poles = np.linalg.eigvals(scene.plant(grip_N).A)
    return np.unique(np.abs(poles[poles.imag > 0])) / (2 * np.pi)


def by_node(build: Build, field: str) -> dict[tuple[float, float], Any]:
    return {(entry.speed_m_s, entry.grip_N): getattr(entry, field) for entry in build.all_entries()}


def is_bound(build: Build) -> dict[tuple[float, float], bool]:
    return {(entry.speed_m_s, entry.grip_N): entry.binding != "none" for entry in build.all_entries()}


class Strike(NamedTuple):
    peak_g: FloatArray  # (V,)
    pulse_ms: FloatArray  # (V,) width at a tenth of the peak
    late_g: FloatArray  # (V,) largest |a| from 10 to 12 ms


def struck(scene: Scene, grip_N: float = 3.0) -> Strike:
    """The simulated taps of the grid's speeds at one grip, without noise."""
    target = scene.recordings.simulated
    assert target is not None
    speeds = np.array(scene.grid.speeds_m_s)
    times, acceleration, _ = strike(scene.plant(grip_N, struck=True), target, speeds, 0.03)
    g = acceleration / STANDARD_GRAVITY_M_S2
    peak = g.max(axis=1)
    above = g > 0.1 * peak[:, None]
    first = above.argmax(axis=1)
    last = np.array([start + np.argmin(row[start:]) for start, row in zip(first, above, strict=True)])
    late = np.abs(g[:, (times > 0.010) & (times < 0.012)]).max(axis=1)
    return Strike(peak, 1e3 * (times[last] - times[first]), late)


@pytest.mark.parametrize("name", SCENES)
def test_scene_is_solved_and_proven(name: str, tmp_path: Path) -> None:
    build = built(name)
    assert not build.refused
    assert_entries_are_proven(build)
    assert all(not entry.shortfalls for entry in build.all_entries())
    assert build.library is not None
    if not build.scene.targets:  # the others are solved another way in test_actuators.py
        assert_independent_check_is_clean(build.library, tmp_path / "library.npz")


@pytest.mark.parametrize("name", SCENES)
def test_simulated_sensor_is_not_clipped(name: str) -> None:
    scene = load(name)
    if scene.recordings.simulated is None:
        pytest.skip("recordings from files")
    limit = scene.recordings.simulated.range_g * STANDARD_GRAVITY_M_S2
    assert max(np.abs(tap.acceleration.values).max() for tap in recordings(scene)) < limit


@pytest.mark.parametrize("name", problems.scene_names())
def test_description_is_one_line(name: str) -> None:
    description = load(name).description
    assert 20 <= len(description) <= 100
    assert "\n" not in description


class TestWhatEachSceneShows:
    def test_firm_fast_saturates_everywhere(self) -> None:
        assert all(is_bound(built("firm_fast")).values())
        for entry in built("firm_fast").entries[-1]:
            assert "command" in entry.binding
            for rival in (entry.baselines.seed, entry.baselines.clipped):
                assert entry.figures.tap_error < 0.9 * rival.tap_error
                assert entry.figures.felt_error < 0.7 * rival.felt_error

    def test_stiff_drive_has_a_mode_above_nyquist(self) -> None:
        scene = load("stiff_drive")
        for grip in scene.grid.grips_N:
            assert modes_Hz(scene, grip).max() > 0.5 / scene.time.dt_s
        bound = is_bound(built("stiff_drive"))
        assert not any(bound[0.2, grip] for grip in (1, 5))
        assert all(bound[0.4, grip] for grip in (1, 5))

    def test_free_stylus_has_no_hand(self) -> None:
        scene = load("free_stylus")
        assert scene.grid.grips_N == [0]
        assert scene.plant(0).order == 4
        assert scene.plant(1).order == 6
        assert not any(is_bound(built("free_stylus")).values())

    def test_ideal_amplifier_costs_nothing_that_is_planned_for(self) -> None:
        ideal, real = built("ideal_amplifier"), built("wood_on_foam")
        assert ideal.library.amplifier() is None
        assert all(not check.shortfalls for check in verify_library(ideal.library))
        ours, theirs = by_node(ideal, "figures"), by_node(real, "figures")
        assert all(abs(ours[node].tap_error - theirs[node].tap_error) < 0.005 for node in ours)
        assert all(abs(ours[node].felt_error - theirs[node].felt_error) < 0.005 for node in ours)
        seed, seed_real = by_node(ideal, "baselines"), by_node(real, "baselines")
        assert all(seed[0.2, F].seed.tap_error < seed_real[0.2, F].seed.tap_error - 0.02 for F in (1.0, 5.0))

    def test_hard_metal_is_short_and_rings(self) -> None:
        tap = struck(load("hard_metal"))
        np.testing.assert_allclose(tap.peak_g, [3.4, 7.6, 17], rtol=0.03)
        assert np.all((tap.pulse_ms > 0.9) & (tap.pulse_ms < 1.3))
        assert np.all(tap.late_g > 0.15 * tap.peak_g)
        build = built("hard_metal")
        assert {speed for (speed, _), bound in is_bound(build).items() if bound} == {0.08}
        assert all("current" in entry.binding and "command" in entry.binding for entry in build.entries[-1])

    def test_soft_rubber_is_long_and_does_not_ring(self) -> None:
        tap = struck(load("soft_rubber"))
        np.testing.assert_allclose(tap.peak_g, [0.71, 1.64, 3.82], rtol=0.03)
        assert np.all((tap.pulse_ms > 13) & (tap.pulse_ms < 19))
        build = built("soft_rubber")
        assert [node for node, bound in is_bound(build).items() if bound] == [(0.4, 5)]
        for light, firm in build.entries:
            assert firm.played.peak_input > 1.3 * light.played.peak_input

    def test_hot_coil_is_bound_by_its_temperature(self) -> None:
        build = built("hot_coil")
        hot = [entry for entry in build.all_entries() if "coil" in entry.binding]
        assert len(hot) == 6
        for entry in hot:
            assert entry.played.winding_C == pytest.approx(90.03, abs=1e-3)
            assert entry.certificate.relative_bound <= 2e-3
            assert entry.size.states == 12
            price = next(price for price in entry.prices if price.limit == "coil")
            assert price.then < price.tap_error - 0.01
            assert 90.03 < price.enough < 90.4

    def test_rapid_tapping_is_bound_by_the_steady_state(self) -> None:
        build = built("rapid_tapping")
        bound = {node for node, entry in by_node(build, "binding").items() if "coil" in str(entry)}
        assert bound == {(0.2, 5.0), (0.4, 1.0), (0.4, 5.0)}
        steady = by_node(build, "played")
        assert steady[0.4, 5.0].winding_C == pytest.approx(100, abs=0.02)
        assert steady[0.4, 5.0].winding_C > steady[0.4, 5.0].housing_C > 60
        # One tap from a cold start heats it by a quarter of a kelvin.
        assert built("wood_on_foam").entries[3][2].played.winding_C < 25.3

    def test_small_coil_keeps_its_absolute_limit(self) -> None:
        build = built("small_coil")
        assert [str(binding).split(" ")[0] for binding in by_node(build, "binding").values()].count("coil") == 3
        assert max(entry.played.winding_C for entry in build.all_entries()) == pytest.approx(85, abs=1e-3)

    def test_low_supply_is_bound_by_its_rail(self) -> None:
        build = built("low_supply")
        for entry in build.entries[1]:
            assert "supply +9 V" in entry.binding
            assert entry.played.reached["supply"] == pytest.approx(9, abs=9e-3)
        assert build.entries[0][0].binding == "none"

    def test_walled_hands_over_to_its_wall(self) -> None:
        build = built("walled")
        library = build.library
        h = build.scene.hand_over_samples
        assert not library.transient_command[..., -h:].any()
        # What is left at the end is the spring: 0.1 to 0.6 A, more for faster taps, which go deeper.
        left = library.command[..., -1]
        assert np.all(left > 0.05)
        assert np.all(np.diff(left, axis=0) > 0)
        assert np.abs(library.transient_command - library.command).max() > 0.3

    def test_single_grip_is_one_column_of_the_default_scene(self) -> None:
        library, default = built("single_grip").library, built("wood_on_foam").library
        assert library.command.shape[:2] == (4, 1)
        np.testing.assert_allclose(library.command[:, 0], default.command[:, 1], atol=1e-6)

    def test_second_order_is_a_whole_hand_at_its_floor_and_saturated(self) -> None:
        scene, build = load("second_order"), built("second_order")
        assert scene.plant(2).order == 2
        tap = struck(scene)
        np.testing.assert_allclose(tap.peak_g, [4.2, 8.6, 13], rtol=0.03)
        np.testing.assert_allclose(tap.pulse_ms, 10, atol=0.7)
        bound = is_bound(build)
        assert not any(bound[0.2, grip] for grip in (2, 6))
        assert all(bound[speed, grip] for speed in (0.4, 0.6) for grip in (2, 6))
        assert all(entry.figures.tap_error > 0.4 for entry in build.entries[-1])


# What a datasheet says of friction: at its nominal speed the motor also heats by what it draws idling. Volts, ampere
# idling, rpm idling and nominal.
FRICTION = {
    "faulhaber_0816k003sr": (3, 0.016, 13250, 2540),
    "faulhaber_0816k006sr": (6, 0.0083, 13500, 2660),
    "maxon_re25_118743": (12, 0.0263, 4860, 3800),
    "maxon_re30_310009": (48, 0.0786, 8490, 7760),
    "maxon_re40_148877": (48, 0.0686, 7590, 7000),
}


@pytest.mark.parametrize("path", MOTORS, ids=lambda path: path.stem)
class TestMotors:
    def load(self, path: Path) -> Motor:
        return Motor.model_validate(tomllib.loads(path.read_text()))

    def test_thermal_model_returns_the_continuous_current(self, path: Path) -> None:
        """R_th (i^2 R + friction) = rise; at standstill, where a haptic device works, friction is nothing."""
        motor = self.load(path)
        coil = load("wood_on_foam").model_copy(update={"motor": motor}).coil()
        still_A = coil.continuous_current_A()
        volts, idle_A, idle_rpm, nominal_rpm = FRICTION[path.stem]
        allowed_W = (motor.winding_max_C - 25) / (motor.R_wh_K_W + motor.R_ha_K_W)
        friction_W = volts * idle_A * nominal_rpm / idle_rpm
        assert still_A * np.sqrt(1 - friction_W / allowed_W) == pytest.approx(motor.i_continuous_A, rel=0.04)
        assert 0.96 * motor.i_continuous_A < still_A < 1.13 * motor.i_continuous_A

    def test_winding_heats_before_the_housing(self, path: Path) -> None:
        motor = self.load(path)
        assert motor.tau_w_s < 0.1 * motor.tau_h_s
        assert motor.i_continuous_A < motor.i_peak_A

    def test_time_constants_are_those_of_a_coreless_motor(self, path: Path) -> None:
        """R J / k_t^2 and L / R: a digit that slipped shows here, since both vary little from size to size."""
        motor = self.load(path)
        assert 2e-3 < motor.R_ohm * motor.rotor_kg_m2 / motor.kt_Nm_A**2 < 8e-3
        assert 5e-6 < motor.L_H / motor.R_ohm < 5e-4

    def test_datasheet_is_named(self, path: Path) -> None:
        motor = self.load(path)
        assert motor.name.split(",")[0].split()[1] in motor.datasheet
        assert path.stem.split("_")[-1].upper() in motor.datasheet


def test_motors_cover_the_sizes() -> None:
    """From vibrotactile, where the winding heats within seconds, to the whole hand."""
    motors = [Motor.model_validate(tomllib.loads(path.read_text())) for path in MOTORS]
    assert len(motors) >= 5
    assert min(motor.tau_w_s for motor in motors) < 5
    assert max(motor.kt_Nm_A * motor.i_continuous_A for motor in motors) > 0.15


EXAMPLES = problems.FOLDER / "recordings"


def test_shipped_recordings_are_what_the_generator_writes(tmp_path: Path) -> None:
    from problems.generators.strikes import write_examples

    write_examples(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == sorted(path.name for path in EXAMPLES.iterdir())
    assert len(names) == 3
    for name in names:
        fresh, shipped = (np.loadtxt(f / name, delimiter=",", skiprows=4) for f in (tmp_path, EXAMPLES))
        np.testing.assert_allclose(fresh, shipped, atol=2e-4)  # the last digit may round differently elsewhere
