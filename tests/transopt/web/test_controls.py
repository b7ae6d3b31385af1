"""Sliders follow from the scene, whatever scene it is."""

import pytest

from transopt.scene.builtin import load_scene, scene_names
from transopt.scene.keys import with_values
from transopt.web.controls import controls, input_key


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_takes_both_ends_of_all_its_sliders(name: str) -> None:
    scene = load_scene(name)
    found = {control.key: control for control in controls(scene)}
    assert input_key(scene) in found
    assert "weights.rho" in found
    for control in found.values():
        for share in (0.0, 1.0) if control.value is not None and not control.choices else ():
            with_values(scene, {control.key: control.at(share)})


def test_a_stated_number_lies_on_its_slider(small: object) -> None:
    for control in controls(load_scene("lra_click")):
        if isinstance(control.value, float):
            assert control.low <= control.value <= control.high, control.key


def test_units_and_words_are_those_of_the_scenes_own_input() -> None:
    by_voltage = {control.key: control for control in controls(load_scene("lra_click"))}
    assert by_voltage["limits.voltage_V"].unit == "V"
    assert by_voltage["limits.slew_V_per_s"].unit == "V/s"
    assert "limits.beta" not in by_voltage
    by_current = {control.key: control for control in controls(load_scene("wood_on_foam"))}
    assert by_current["limits.current_A"].value == pytest.approx(4.0)
    assert by_current["limits.supply_V"].value is None
    assert by_current["limits.supply_V"].optional
    assert "limits.voltage_V" not in by_current


def test_a_slider_ends_where_the_motor_does() -> None:
    scene = load_scene("wood_on_foam")
    assert scene.motor is not None
    (current,) = [control for control in controls(scene) if control.key == "limits.current_A"]
    assert current.high <= scene.motor.i_peak_A
    assert current.high > 0.95 * scene.motor.i_peak_A
