"""Readings at an end of the accelerometer's range, and what the commands make of the taps that they are part of."""

import math
from pathlib import Path

import numpy as np
import pytest

from controller.device.circuit import LEAST_RANGE_G
from controller.device.device_file import Accelerometer, DeviceFile
from controller.device.rail import at_rail, needed_range_g, range_in_words, why_at_rail
from tests.benches.commands import Run, assert_refused
from tests.benches.libraries import part_of
from transopt.base.signals import STANDARD_GRAVITY_M_S2, FloatArray
from transopt.library.file import load_library
from transopt.library.library import Library

G = STANDARD_GRAVITY_M_S2
TIMES_S = 1e-4 * np.arange(-50, 300)
FIVE_G = 'name = "five"\n\n[accelerometer]\nrange_g = 5.0\n'


def tap(noise_m_s2: float = 0.0) -> FloatArray:
    """(350,) a tap of 10 g at most, read above a level surface."""
    noise = noise_m_s2 * np.random.default_rng(3).standard_normal(TIMES_S.size)
    return np.where(TIMES_S < 0, 0.0, 10 * G * np.exp(-TIMES_S / 4e-3) * np.cos(600 * TIMES_S)) + noise


def test_a_number_within_the_range_counts() -> None:
    for range_g in (None, 12.0):
        assert not at_rail(tap(0.2), Accelerometer(range_g=range_g)).any()
        assert why_at_rail(TIMES_S, tap(0.2), Accelerometer(range_g=range_g)) == ""


@pytest.mark.parametrize("range_g", [None, 5.0])
@pytest.mark.parametrize("rail", [math.nan, 5 * G])
def test_readings_at_the_end_of_the_range_are_found(range_g: float | None, rail: float) -> None:
    beyond = np.abs(tap(0.2)) > 5 * G
    read = np.where(beyond, rail, tap(0.2))
    found = at_rail(read, Accelerometer(range_g=range_g))
    assert found[beyond].all()
    assert found.sum() <= beyond.sum() + 2


def test_the_range_is_that_of_the_reading_before_its_scale_and_with_gravity() -> None:
    upside_down = Accelerometer(scale=-1.0, rest_m_s2=9.81, range_g=6.0)
    within, beyond = 6.0 * 0.97 * G - 9.81, 6.0 * 0.99 * G - 9.81
    assert at_rail(np.array([within, beyond, -within - 2 * 9.81, -beyond - 2 * 9.81]), upside_down).tolist() == [
        False,
        True,
        False,
        True,
    ]


def test_an_unclipped_tap_through_a_coarse_converter_counts() -> None:
    for bits in (8, 12):
        step = 36 * G / 2**bits
        assert not at_rail(step * np.round(tap(0.2) / step), Accelerometer()).any()


def test_the_reason_names_time_and_remedy(library: Library) -> None:
    read = np.where(np.abs(tap()) > 5 * G, 5 * G, tap())
    first = f"{1e3 * TIMES_S[np.argmax(read >= 5 * G)]:.1f} ms"
    stated = why_at_rail(TIMES_S, read, Accelerometer(range_g=5.0), library)
    assert stated == f"the accelerometer was at its rail at {first}: use one with a range of 12 g or more"
    unstated = why_at_rail(TIMES_S, read, Accelerometer())
    assert unstated.startswith(f"the accelerometer stood still at +5 g from {first} on")
    assert unstated.endswith("use a wider range, or state accelerometer.range_g")


@pytest.mark.parametrize("reading", [math.nan, 20 * G])
def test_a_range_that_holds_every_tap_is_not_what_is_wrong(library: Library, reading: float) -> None:
    """A wire that comes loose while a tap plays, or a stylus that strikes something."""
    read = np.where(TIMES_S < 20e-3, tap(), reading)
    why = why_at_rail(TIMES_S, read, Accelerometer(range_g=12.0), library)
    assert why.startswith("the accelerometer was at its rail at 20.0 ms, though its range of 12 g holds every tap")
    assert "check its cable" in why
    assert "use one with" not in why


def test_a_circuit_must_read_the_built_in_taps_on_a_level_surface(library: Library) -> None:
    assert needed_range_g(library, Accelerometer(rest_m_s2=9.81)) == LEAST_RANGE_G


def test_a_library_beyond_the_stated_range_is_told_when_it_is_loaded(library: Library) -> None:
    narrow, wide, unstated = (
        DeviceFile(accelerometer=Accelerometer(range_g=range_g)) for range_g in (5.0, 16.0, None)
    )
    assert "accelerometer.range_g = 5: the taps of this library take 12 g" in range_in_words(narrow, library)
    assert range_in_words(wide, library) == range_in_words(unstated, library) == ""


def test_taps_at_the_rail_do_not_count_and_the_others_keep_their_figures(play: Run, library: Library) -> None:
    Path("five.toml").write_text(FIVE_G)
    library.save(Path("library.npz"))
    railed = play("tap", "library.npz", "--simulate", "--device", "five.toml", "--speed", 0.4, "--out", "railed")
    assert railed.code == 0, railed.err
    assert "the accelerometer was at its rail at" in railed.out
    assert Path("railed/tap.png").exists()
    slow = ("tap", "library.npz", "--simulate", "--speed", 0.1)
    known, wide = play(*slow, "--device", "five.toml"), play(*slow)
    assert known.out.partition("\n")[2] == wide.out


def test_refine_learns_from_no_reading_at_the_rail(play: Run, library: Library) -> None:
    Path("five.toml").write_text(FIVE_G)
    part_of(library, [0, 2], [1]).save(Path("library.npz"))
    arguments = ("--simulate", "--device", "five.toml", "--mismatch", 0.1, "--rounds", 1, "--out", "better")
    outcome = play("refine", "library.npz", *arguments)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "tap 4 does not count: the accelerometer was at its rail at" in outcome.out
    assert "(3 of 6 taps do not count)" in outcome.out
    assert "1 of 2 nodes refined" in outcome.out
    refined = load_library(Path("better/library.npz"))
    np.testing.assert_array_equal(refined.command[1], part_of(library, [2], [1]).command[0])


def test_where_no_tap_counts_the_reason_is_one_line(play: Run, library: Library) -> None:
    Path("five.toml").write_text(FIVE_G)
    part_of(library, [2], [0, 1, 2]).save(Path("library.npz"))
    on_five = ("library.npz", "--simulate", "--device", "five.toml", "--out", "out")
    outcome = play("refine", *on_five)
    assert outcome.code == 1
    assert "tap 1 does not count: the accelerometer was at its rail at" in outcome.out
    assert "round 0: no node has 2 taps that count" in outcome.out
    assert_refused(play("calibrate", *on_five), "calibrate: no tap counts: tap 1 does not count: the accelerometer")
