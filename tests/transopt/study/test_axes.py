"""What a study varies, as it is typed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import problems
from transopt.base.errors import InputError
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.study.axes import apply_settings, parse_axis
from transopt.study.figures import PercentLocator, axis_label
from transopt.study.plan import Plan

FILES = [problems.FOLDER]


class TestAxes:
    @pytest.mark.parametrize(
        ("text", "values"),
        [
            ("limits.current_A=1.25:6:20", np.linspace(1.25, 6, 20)),
            ("amplifier.pole_Hz=100:10000:3:log", (100.0, 1000.0, 10000.0)),
            ("time.stages=100:200:3", (100, 150, 200)),
            ("limits.supply_V=9, none", (9.0, None)),
            ("weights.rapid=highpass,pacinian", ("highpass", "pacinian")),
        ],
    )
    def test_values(self, scene: Scene, text: str, values: Sequence[Any]) -> None:
        axis = parse_axis(scene, "--vary", text)
        if all(isinstance(value, float) for value in values):
            assert axis.values == pytest.approx(values, rel=1e-11)
        else:
            assert axis.values == tuple(values)
        assert [type(value) for value in axis.values] == [float if isinstance(v, float) else type(v) for v in values]
        assert len(set(axis.labels)) == len(axis.values)

    def test_motors_are_swapped_whole(self, scene: Scene, tmp_path: Path) -> None:
        own = tmp_path / "own.toml"
        own.write_text((problems.FOLDER / "motors" / "maxon_re40_148877.toml").read_text(encoding="utf-8"))
        axis = parse_axis(scene, "--vary", f"motor=maxon_re25,{own}", FILES)
        assert axis.labels == ("maxon_re25_118743", "own")
        plan = Plan(scene, (axis,), (0.4,), (5.0,))
        second = with_values(scene, plan.changes(1)).motor
        assert (second.kt_Nm_A, second.rotor_kg_m2) == (60.3e-3, 13.7e-6)

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("limits.current_A", "give KEY=V1,V2"),
            ("limits.current_A=1:2", "START:STOP:COUNT"),
            ("limits.current_A=2:1:5", "START must be below STOP"),
            ("limits.current_A=1:2:1.5", "COUNT = 1.5: must be a whole number"),
            ("limits.current_A=0:2:3:log", "START must be below STOP and above 0"),
            ("limits.current_A=0:2:3", "limits.current_A = 0.0: must be greater than 0"),
            ("limits.current_A=1,1.0", "a value stands there twice"),
            ("limits.current_A=1,many", "limits.current_A = many: must be a finite number or none"),
            ("motor.kt_Nm_A=0.02", "one row of a datasheet"),
            ("motor=maxon", "several files begin so; give the path of a .toml file or one of faulhaber"),
            ("motor=escap", "no such file"),
            ("grid.grips_N=1,2", "give them with --grip"),
            ("limit.current_A=1,2", "did you mean limits.current_A"),
        ],
    )
    def test_refusals(self, scene: Scene, text: str, words: str) -> None:
        with pytest.raises(InputError, match=words.replace("(", r"\(")) as refusal:
            parse_axis(scene, "--vary", text, FILES)
        assert "\n" not in str(refusal.value)

    def test_speed_outside_the_recordings(self, scene: Scene) -> None:
        with pytest.raises(InputError, match=r"--speed 0.5: must be between 0.1 and 0.4 m/s"):
            Plan(scene, (), (0.5,), (1.0,))

    def test_without_a_folder_of_motors_a_path_is_asked_for(self, scene: Scene) -> None:
        with pytest.raises(InputError, match=r"motor = maxon_re25: no such file; give the path of a .toml file$"):
            parse_axis(scene, "--vary", "motor=maxon_re25")

    def test_settings_hold_for_all_points(self, scene: Scene) -> None:
        changed = apply_settings(scene, ["limits.current_A=2"], FILES)
        assert changed.limits.transient_input == pytest.approx(2.0)
        with pytest.raises(InputError, match="one value; --vary takes several"):
            apply_settings(scene, ["limits.current_A=2,3"])


def test_a_figure_labels_a_key_by_its_words_and_unit() -> None:
    assert axis_label("limits.current_A") == "limits: current [A]"
    assert axis_label("time.lead_s", "ms") == "time: lead [ms]"
    assert axis_label("weights.rho") == "weights: rho"
    assert axis_label("motor") == "motor"


@pytest.mark.parametrize(("low", "high", "least"), [(16.0, 34.0, 3), (0.02, 20.0, 9), (24.0, 36.0, 2)])
def test_an_axis_of_percentages_has_ticks_inside(low: float, high: float, least: int) -> None:
    ticks = [tick for tick in PercentLocator().tick_values(low, high) if low <= tick <= high]
    assert len(ticks) >= least
