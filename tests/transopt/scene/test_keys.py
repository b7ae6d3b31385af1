"""Keys of a scene by dotted path."""

import itertools
from collections.abc import Iterator
from typing import Any

import pytest

import problems
from transopt.base.errors import InputError
from transopt.base.units import unit_of
from transopt.scene.keys import check_value, find_key, keys, parse_value, with_values
from transopt.scene.scene import Scene

NOT_VARIED = ("motor.", "striker.", "recordings.speed_by_file_m_s")


def numbers(content: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every number that a scene's file may state, by dotted path."""
    for name, value in content.items():
        if isinstance(value, dict):
            yield from numbers(value, f"{prefix}{name}.")
        elif isinstance(value, int | float) or name in ("speeds_m_s", "grips_N"):
            yield f"{prefix}{name}", value


@pytest.mark.parametrize("name", problems.scene_names())
def test_every_number_of_every_scene_is_a_key_and_means_what_it_says(name: str) -> None:
    scene = problems.load(name)
    listed = {key.path: key for key in keys(scene)}
    for path, value in numbers(scene.model_dump()):
        if path.startswith(NOT_VARIED):
            continue
        key = listed[path]
        if not isinstance(value, list):
            assert key.value == value
            assert with_values(scene, {path: value}) == scene
    assert len(listed) == len(keys(scene))


def test_keys_of_tables_that_a_scene_does_not_have_are_listed_too(scene: Scene) -> None:
    listed = {key.path: key for key in keys(scene)}
    for path in ("feedback.stiffness_N_m", "robust.grip_spread", "limits.supply_V", "thermal.tap_rate_Hz"):
        assert listed[path].value is None
    assert listed["feedback.derivative_filter_Hz"].default == 500.0
    assert listed["time.lead_s"].bounds == ">= 0, <= 0.02"
    assert listed["weights.rapid"].choices == ("highpass", "pacinian", "none")
    assert listed["time.stages"].integer
    assert listed["thermal.tap_rate_Hz"].optional
    assert not any(path.startswith("motor.") for path in listed)
    assert {"motor", "transmission"} <= set(listed)


@pytest.mark.parametrize(
    ("path", "unit"),
    [
        ("limits.current_A", "A"),
        ("limits.slew_A_per_s", "A/s"),
        ("transmission.ratio_1_m", "1/m"),
        ("feedback.damping_N_s_m", "N s/m"),
        ("recordings.simulated.noise_g_rtHz", "g/sqrt(Hz)"),
        ("model.hand.skin_stiffness_N_m.constant", "N/m"),
        ("model.hand.skin_stiffness_N_m.per_newton", "N/m/N"),
        ("grid.speeds_m_s", "m/s"),
        ("limits.beta", ""),
        ("weights.rho", ""),
    ],
)
def test_unit_is_the_ending_of_the_name(path: str, unit: str) -> None:
    assert unit_of(path) == unit


class TestChanges:
    def test_one_statement_of_the_limit_takes_the_place_of_the_other(self, scene: Scene) -> None:
        assert scene.limits.beta == 3.2
        stated = with_values(scene, {"limits.current_A": 3.0})
        assert (stated.limits.beta, stated.limits.transient_input) == (None, 3.0)
        back = with_values(stated, {"limits.beta": 2.0})
        assert (back.limits.current_A, back.limits.transient_input) == (None, 2.5)

    def test_both_statements_at_once_are_refused(self, scene: Scene) -> None:
        with pytest.raises(InputError, match="give beta or current_A, not both"):
            with_values(scene, {"limits.current_A": 3.0, "limits.beta": 2.0})

    def test_whole_motor_first_then_keys_of_its_transmission(self, scene: Scene) -> None:
        other = {**scene.transmission.model_dump(), "link_mass_kg": 0.02}
        changes = {"transmission.ratio_1_m": 99.0, "transmission": other}
        for order in itertools.permutations(changes):
            changed = with_values(scene, {path: changes[path] for path in order}).transmission
            assert (changed.ratio_1_m, changed.link_mass_kg) == (99.0, 0.02)

    def test_nothing_else_changes(self, scene: Scene) -> None:
        changed = with_values(scene, {"amplifier.pole_Hz": 500.0}).model_dump()
        before = scene.model_dump()
        assert changed.pop("amplifier") == {**before.pop("amplifier"), "pole_Hz": 500.0}
        assert changed == before

    def test_other_tables_stay_the_same_objects_and_are_checked_together(self, scene: Scene) -> None:
        changed = with_values(scene, {"limits.current_A": 3.0})
        assert changed.model is scene.model
        assert changed.limits is not scene.limits
        with pytest.raises(InputError, match="i_peak_A"):
            with_values(changed, {"limits.current_A": 1e3})


class TestRefusals:
    @pytest.mark.parametrize(
        ("path", "words"),
        [
            ("motor.kt_Nm_A", "one row of a datasheet.*motor=A,B"),
            ("limits.curent_A", "did you mean limits.current_A"),
            ("pole_Hz", "did you mean amplifier.pole_Hz"),
            ("name", "no key of the scene wood_on_foam"),
        ],
    )
    def test_unknown_key(self, scene: Scene, path: str, words: str) -> None:
        with pytest.raises(InputError, match=words):
            find_key(scene, path)

    @pytest.mark.parametrize(
        ("path", "value", "words"),
        [
            ("amplifier.pole_Hz", -3.0, r"amplifier.pole_Hz = -3.0: must be greater than 0"),
            ("limits.beta", 0.5, r"limits.beta = 0.5: must be greater than or equal to 1"),
            ("time.stages", 600.5, r"time.stages = 600.5: must be a valid integer"),
            ("time.lead_s", 0.5, r"time.lead_s = 0.5: must be less than or equal to 0.02"),
            ("thermal.nodes", 3, r"thermal.nodes = 3: must be 1 or 2"),
            ("robust.samples", 99, r"robust.samples = 99: must be less than or equal to 15"),
        ],
    )
    def test_value_outside_its_bounds(self, scene: Scene, path: str, value: Any, words: str) -> None:
        with pytest.raises(InputError, match=words):
            check_value(scene, path, value)

    @pytest.mark.parametrize(
        ("path", "value"),
        [("limits.current_A", 50.0), ("thermal.tap_rate_Hz", 40.0), ("feedback.damping_N_s_m", 2.0)],
    )
    def test_value_that_only_the_rest_of_the_scene_forbids_is_no_bad_value(
        self, scene: Scene, path: str, value: Any
    ) -> None:
        check_value(scene, path, value)
        with pytest.raises(InputError):
            with_values(scene, {path: value})

    @pytest.mark.parametrize(
        ("path", "text"),
        [("limits.current_A", "much"), ("limits.current_A", "nan"), ("weights.rapid", "loud")],
    )
    def test_text_that_is_no_value(self, scene: Scene, path: str, text: str) -> None:
        with pytest.raises(InputError, match=f"{path} = {text}: must be "):
            parse_value(find_key(scene, path), text)

    def test_text_that_is(self, scene: Scene) -> None:
        assert parse_value(find_key(scene, "time.stages"), "6e2") == 600
        assert isinstance(parse_value(find_key(scene, "time.stages"), "6e2"), int)
        assert parse_value(find_key(scene, "limits.supply_V"), "none") is None
        assert parse_value(find_key(scene, "weights.rapid"), "none") == "none"
        assert parse_value(find_key(scene, "recordings.onset_s"), "0.01") == 0.01
        assert parse_value(find_key(scene, "recordings.onset_s"), "auto") == "auto"
