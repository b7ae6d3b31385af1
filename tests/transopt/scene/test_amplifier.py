"""An amplifier that is stated as a bridge: what follows from the motor, what stands, and what is refused."""

import re
from typing import Any

import pytest

from tests.benches.model_parts import ON_FILE, POLE, Make, amplifier_part, assert_clean, drive_device
from transopt.base.errors import InputError
from transopt.design.solve import solve
from transopt.plant.coil import PWM_RIPPLE_A
from transopt.scene.file import read_scene, scene_text
from transopt.scene.keys import find_key, with_values
from transopt.scene.scene import Scene

BRIDGE = {
    "amplifier.pole_Hz": None,
    "amplifier.delay_s": None,
    "amplifier.switching_Hz": 22.5e3,
    "limits.supply_V": 24.0,
}


@pytest.fixture(scope="module")
def on_bridge(scene: Scene) -> Scene:
    return with_values(scene, BRIDGE)


class TestFollows:
    def test_pole_delay_and_heat_are_those_of_the_bridge(self, on_bridge: Scene) -> None:
        bridge, amplifier, coil = on_bridge.bridge(), on_bridge.amplifier_model(), on_bridge.coil()
        assert (amplifier.pole_Hz, amplifier.delay_s) == (bridge.pole_Hz, bridge.delay_s)
        assert bridge.crossover_Hz == pytest.approx(2250.0)
        assert bridge.rail_V == 24.0
        assert coil.R_ohm == pytest.approx(2.18 * bridge.heat_factor)
        assert 1.003 < bridge.heat_factor < 1.004
        assert coil.ripple_A == 0

    def test_the_gain_makes_the_pole(self, on_bridge: Scene) -> None:
        poles = [
            with_values(on_bridge, {"amplifier.gain_V_A": gain}).amplifier_model().pole_Hz  # type: ignore[union-attr]
            for gain in (0.4, 0.8, 1.6)
        ]
        assert poles[0] < poles[1] / 1.9 < poles[2] / 3.8

    def test_eddy_currents_are_the_motors(self, on_bridge: Scene) -> None:
        motor = {**on_bridge.motor.model_dump(), "R_eddy_ohm": 80.0}
        coil = with_values(on_bridge, {"motor": motor}).coil()
        assert coil.ripple_A == pytest.approx(24 * 2.18 / (2 * 82.18**2), rel=0.01)

    def test_a_stated_pole_and_delay_stand(self, scene: Scene, on_bridge: Scene) -> None:
        stated = {"amplifier.pole_Hz": 1050.0, "amplifier.delay_s": 68e-6}
        both = with_values(on_bridge, stated)
        assert both.amplifier_model() == scene.amplifier_model()
        assert both.coil() == on_bridge.coil()
        late = with_values(on_bridge, {"amplifier.delay_s": 68e-6}).amplifier_model()
        assert (late.pole_Hz, late.delay_s) == (on_bridge.bridge().pole_Hz, 68e-6)  # type: ignore[union-attr]

    def test_a_pole_in_a_model_file_stands(self, make: Make) -> None:
        parts = {"device": drive_device(), "amplifier": amplifier_part()}
        plain = make(ON_FILE, parts, (POLE, ""))
        switched = with_values(plain, {"amplifier.switching_Hz": 30e3, "limits.supply_V": 24.0})
        assert switched.amplifier_model() == plain.amplifier_model()
        assert switched.coil() != plain.coil()
        with pytest.raises(InputError, match="gain_V_A: determines the pole, which is stated too"):
            with_values(switched, {"amplifier.gain_V_A": 1.0})

    def test_without_a_bridge_the_ripple_is_the_seeds(self, scene: Scene) -> None:
        coil = scene.coil()
        assert (coil.R_ohm, coil.ripple_A) == (2.18, PWM_RIPPLE_A)

    def test_its_file_says_the_same(self, on_bridge: Scene, tmp_path: Any) -> None:
        path = tmp_path / "wood_on_foam.toml"
        path.write_text(scene_text(with_values(on_bridge, {"amplifier.gain_V_A": 1.25})))
        again = read_scene(path)
        assert again.bridge() == with_values(on_bridge, {"amplifier.gain_V_A": 1.25}).bridge()

    def test_keys_have_units_and_bounds(self, scene: Scene) -> None:
        gain, switching = (find_key(scene, f"amplifier.{name}") for name in ("gain_V_A", "switching_Hz"))
        assert (gain.unit, switching.unit) == ("V/A", "Hz")
        assert switching.interval == (10e3, 100e3)

    @pytest.mark.parametrize("hot", [False, True])
    def test_a_library_is_proven_and_checked(self, on_bridge: Scene, hot: bool) -> None:
        """Also where the coil binds, with the ripple of eddy currents."""
        changes: dict[str, Any] = {"grid.speeds_m_s": [0.4], "grid.grips_N": [3.0], "time.stages": 300}
        if hot:
            changes["motor"] = {**on_bridge.motor.model_dump(), "R_eddy_ohm": 80.0}
            changes |= {f"thermal.start_{part}_C": 99.9 for part in ("winding", "housing")}
        library = solve(with_values(on_bridge, changes))
        assert (library.peak_temperature_C[0, 0] > 99.99) == hot
        assert_clean(library)


REFUSED = [
    ({"amplifier.switching_Hz": None, "amplifier.gain_V_A": 1.0}, r"gain_V_A: .* add amplifier\.switching_Hz too"),
    ({"limits.supply_V": None}, r"switching_Hz: needs \[motor\] and the rail .* limits\.supply_V"),
    ({"amplifier.pole_Hz": 900.0}, r"amplifier\.delay_s: missing"),
    (
        {"amplifier.pole_Hz": 900.0, "amplifier.delay_s": 0.0, "amplifier.gain_V_A": 1.0},
        r"gain_V_A: determines the pole, which is stated too: take one of them out",
    ),
    ({"amplifier.switching_Hz": 9e3}, r"switching_Hz = 9000\.0: must be greater than or equal to 10000"),
    ({"amplifier.switching_Hz": 110e3}, r"switching_Hz = 110000\.0: must be less than or equal to 100000"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_what_cannot_be_is_refused_by_name(on_bridge: Scene, changes: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        with_values(on_bridge, changes)


def test_the_advice_works(on_bridge: Scene) -> None:
    """What the messages name as the next step is taken, each in turn."""
    measured = {"amplifier.pole_Hz": 1050.0, "amplifier.delay_s": 68e-6, "amplifier.switching_Hz": None}
    for changes in ({"amplifier.gain_V_A": 5.0}, {"amplifier.switching_Hz": 11e3}):
        with pytest.raises(InputError) as told:
            with_values(on_bridge, changes)
        said = str(told.value)
        assert "or state pole_Hz and delay_s as measured in place of switching_Hz and gain_V_A" in said
        with_values(on_bridge, {**changes, "amplifier.gain_V_A": None, **measured})
        if found := re.search(r"lower it to ([\d.]+) V/A", said):
            with_values(on_bridge, {**changes, "amplifier.gain_V_A": float(found[1])})
        if found := re.search(r"raise it to ([\d.]+) Hz, lower limits\.supply_V to ([\d.]+) V", said):
            with_values(on_bridge, {"amplifier.switching_Hz": float(found[1])})
            with_values(on_bridge, {**changes, "limits.supply_V": float(found[2])})


def test_a_tip_has_no_bridge(on_bridge: Scene) -> None:
    tip = {"force_per_current_N_A": 1.25, "moving_mass_kg": 0.014, "stiffness_N_m": 6e4, "damping_N_s_m": 8.0}
    with pytest.raises(InputError, match=r"needs \[motor\]"):
        with_values(on_bridge, {"motor": None, "transmission": None, "tip": tip})
