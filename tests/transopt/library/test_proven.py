"""What plays has been proven: a library that was changed and hashed again is told from one that was designed."""

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benches.actuators import CLICKS
from tests.benches.commands import Terminal, assert_refused
from tests.benches.libraries import part_of, proven_again, under
from transopt.base.errors import InputError
from transopt.design.solve import solve
from transopt.library.library import Library
from transopt.library.proven import doubts, load_proven
from transopt.scene.scene import Scene

Change = Callable[[Library], Library]


@pytest.fixture(scope="module")
def library(library: Library) -> Library:
    """Slow and fast taps under a light and a firm grip: proofs of all twelve would take three times as long."""
    return part_of(library, [0, 3], [0, 2])


def meta(library: Library, **changed: Any) -> Library:
    return replace(library, meta={**library.meta, **changed})


def derived(library: Library, **changed: Any) -> Library:
    return meta(library, derived={**library.meta["derived"], **changed})


def scaled(library: Library, **factors: float) -> Library:
    return replace(library, **{name: factor * getattr(library, name) for name, factor in factors.items()})


TENFOLD = ("command", "transient_command", "plant_input", "acceleration_m_s2", "peak_input")


def louder(library: Library) -> Library:
    """Forty amperes throughout: the limits, the scene's own, and all that follows from them."""
    stated = {
        "limits.current_A": 40.0,
        "limits.beta": None,
        "motor.i_peak_A": 50.0,
        "amplifier.command_limit_A": 60.0,
    }
    return scaled(under(library, stated), **dict.fromkeys(TENFOLD, 10.0))


def test_what_was_designed_is_proven(library: Library, tmp_path: Path) -> None:
    assert list(doubts(proven_again(library, tmp_path))) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (louder, "not certified"),
        (lambda of: under(of, {"limits.current_A": 3.9}), "not certified: a limit is violated by"),
        (lambda of: under(of, {"weights.rho": 1e-2}), "above the optimum, limit 1e-06"),
        (lambda of: scaled(of, command=1.01, transient_command=1.01), "not certified: a limit is violated by"),
        (lambda of: scaled(of, command=0.9, transient_command=0.9), "above the optimum, limit 1e-06"),
        (lambda of: scaled(of, transient_command=2), "transient_command is off by"),
        (lambda of: scaled(of, acceleration_m_s2=1.01), "acceleration_m_s2 is off by"),
        (lambda of: scaled(of, plant_input=0.5), "plant_input is off by"),
        (lambda of: scaled(of, tap_error=0.5), "tap_error says"),
        (lambda of: scaled(of, floor=2), "floor says"),
        (lambda of: scaled(of, energy=1.01), "energy says"),
        (lambda of: scaled(of, heat_A2_s=0.5), "heat_A2_s says"),
        (lambda of: scaled(of, peak_input=0.5), "peak_input says"),
        (lambda of: replace(of, peak_temperature_C=of.peak_temperature_C + 1), "peak_temperature_C says"),
        (lambda of: scaled(of, target_m_s2=0.9), "target_m_s2 is not what was recorded less a_free"),
        (lambda of: scaled(of, recorded_m_s2=0.9), "target_m_s2 is not what was recorded less a_free"),
        (lambda of: scaled(of, recorded_m_s2=0.9, free_m_s2=0.9, target_m_s2=0.9), "above the optimum"),
        (
            lambda of: replace(of, recorded_m_s2=of.recorded_m_s2 + 20, free_m_s2=of.free_m_s2 + 20),
            "is not the motion of a_free",
        ),
        (lambda of: scaled(of, nominal_velocity_m_s=-1), "nominal_velocity_m_s at 0.1 m/s"),
        (lambda of: scaled(of, plant_B=2), "plant_B at 1 N is not the device of its scene"),
        (lambda of: scaled(of, speeds_m_s=1.05), "speeds_m_s: 0.105 is no node of its scene"),
        (lambda of: under(of, {"time.lead_s": 4e-4}), "derived.lead_s is 0.0003, its scene says 0.0004"),
        (lambda of: scaled(of, target_after_m_s2=0.9), "target_after_m_s2 is not what was recorded less a_free"),
        (lambda of: scaled(of, recorded_after_m_s2=0.9, target_after_m_s2=0.9), "may lie"),
        (
            lambda of: replace(
                of, recorded_after_m_s2=of.recorded_after_m_s2 + 20, free_after_m_s2=of.free_after_m_s2 + 20
            ),
            "nominal_after_at_ticks_m at 0.1 m/s",
        ),
        (lambda of: scaled(of, nominal_after_at_ticks_m=0.9), "nominal_after_at_ticks_m at 0.1 m/s"),
        (lambda of: scaled(of, acceleration_after_m_s2=0.5), "acceleration_after_m_s2 is off by"),
        (lambda of: scaled(of, error_after=0.5), "error_after says"),
        (lambda of: scaled(of, peak_after_m_s2=1.1), "peak_after_m_s2 says"),
        (lambda of: derived(of, dt_s=2e-4), "derived.dt_s is 0.0002, its scene says 0.0001"),
        (lambda of: derived(of, exact=False), "derived.exact is False, its scene says True"),
        (
            lambda of: derived(of, limits={"plant_input": 40.0, "slew_per_s": None}),
            "derived.limits.plant_input is 40",
        ),
        (lambda of: derived(of, terms=[]), "derived.terms has other items than its scene"),
        (lambda of: derived(of, heard="all"), "derived has keys that follow from nothing: heard"),
        (lambda of: replace(of, binding=np.full_like(of.binding, "none")), "binding says 'none'"),
        (lambda of: replace(of, status=np.full_like(of.status, "solved")), "its status is: "),
        (
            lambda of: replace(of, multipliers_of={name: -1 - mu for name, mu in of.multipliers_of.items()}),
            "multipliers must be >= 0",
        ),
    ],
)
def test_what_was_changed_is_told(library: Library, tmp_path: Path, change: Change, words: str) -> None:
    changed = change(library)
    assert any(words in doubt for doubt in doubts(changed)), list(doubts(changed))[:5]
    changed.save(tmp_path / "library.npz")
    with pytest.raises(InputError) as caught:
        load_proven(tmp_path / "library.npz")
    assert str(caught.value).isprintable()
    assert "`transopt verify`" in str(caught.value)


def test_verify_lists_what_the_file_states_otherwise_than_its_scene(library: Library, terminal: Terminal) -> None:
    derived(library, hand_over_samples=5).save("changed.npz")
    outcome = terminal("transopt", "verify", "changed.npz")
    assert outcome.code == 1
    assert "derived.hand_over_samples is 5, its scene says 10" in outcome.out


def test_commands_refuse_what_is_not_proven(
    library: Library, tmp_path: Path, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scaled(library, command=1.01, transient_command=1.01).save("changed.npz")
    for program, *arguments in (
        ("transopt", "show", "changed.npz"),
        ("transopt", "export", "changed.npz", "taps.h"),
        ("transopt-play", "tap", "changed.npz", "--simulate"),
        ("transopt-play", "refine", "changed.npz", "--simulate", "--out", "better"),
    ):
        assert_refused(terminal(program, *arguments), "changed.npz: entry", "not certified")
    assert not Path("taps.h").exists()
    verified = terminal("transopt", "verify", "changed.npz")
    assert verified.code == 1
    for arguments in (("show", "changed.npz"), ("export", "changed.npz", "taps.h")):
        outcome = terminal("transopt", *arguments, "--unproven")
        assert outcome.code == 0
        assert outcome.err.startswith("not proven: ")


@pytest.mark.parametrize("limit", ["stroke_m = 6e-4", "velocity_m_s = 3.0", ""])
def test_a_mass_in_a_case_is_the_device_of_its_scene(limit: str, tmp_path: Path) -> None:
    """The device's position follows no nominal motion, which the file says whether or not a limit looks at it."""
    scene = Scene.model_validate(tomllib.loads(CLICKS.replace("stroke_m = 6e-4", limit)))
    plant = proven_again(solve(scene), tmp_path).plant(0)
    assert plant.moves_in_a_case
    assert plant.outputs["velocity"].follows == ""
