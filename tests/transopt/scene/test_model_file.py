"""Model files: what is read is what was written, and nothing else is taken for one."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from tests.benches.model_parts import amplifier_part, coil_part, drive_device, hand_part, state_space_device
from transopt.base.errors import InputError
from transopt.scene.model_file import load_model, save_part
from transopt.scene.model_parts import AnyModelPart, ModelPartName

Content = dict[str, Any]
ALL: list[tuple[ModelPartName, AnyModelPart]] = [
    ("amplifier", amplifier_part()),
    ("device", drive_device()),
    ("hand", hand_part()),
    ("coil", coil_part()),
]


@pytest.fixture
def full(tmp_path: Path) -> Path:
    path = tmp_path / "MODEL.json"
    for name, part in ALL:
        save_part(path, name, part)
    return path


def test_what_is_read_is_what_was_written(full: Path) -> None:
    read = load_model(full)
    for name, part in ALL:
        assert getattr(read, name) == part
    assert {"transopt", "numpy", "scipy", "python"} <= set(read.versions)
    assert json.loads(full.read_text())["schema"] == 1
    full.write_text("\ufeff" + full.read_text(), encoding="utf-8")  # as an editor of Windows saves it
    assert load_model(full) == read


def test_a_part_takes_the_place_of_its_own_kind_only(full: Path) -> None:
    box = state_space_device()
    save_part(full, "device", box)
    read = load_model(full)
    assert read.device == box
    assert (read.amplifier, read.hand, read.coil) == (ALL[0][1], ALL[2][1], ALL[3][1])


def test_a_part_is_written_where_it_belongs(tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="coil"):
        save_part(tmp_path / "m.json", "coil", hand_part())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("damaged", "message"),
    [
        ("", "damaged or no model file"),
        ("[" * 100_000, "damaged or no model file"),
        ("[1, 2]", "schema is missing"),
        ('{"amplifier": {}}', "schema is missing"),
        ('{"schema": 2, "versions": {}}', "schema = 2"),
        ('{"schema": 1, "versions": {}, "moter": {}}', "moter: unknown field"),
        ('{"schema": 1, "versions": {"x": NaN}}', "NaN is not a finite number"),
    ],
)
def test_a_damaged_file_is_refused_and_not_overwritten(tmp_path: Path, damaged: str, message: str) -> None:
    path = tmp_path / "MODEL.json"
    path.write_text(damaged)
    for use in (load_model, lambda p: save_part(p, "coil", coil_part())):
        with pytest.raises(InputError, match=message) as caught:
            use(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "identify" in str(caught.value)
        assert "\n" not in str(caught.value)
    assert path.read_text() == damaged
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_not_there_or_no_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_model(tmp_path / "none.json")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        load_model(tmp_path / "binary.json")
    with pytest.raises(InputError, match="a folder, not a file"):
        load_model(tmp_path)


def _set(path: str, value: Any) -> Callable[[Content], None]:
    def change(content: Content) -> None:
        *tables, last = path.split(".")
        for key in tables:
            content = content[key]
        content[last] = value

    return change


def _asymmetric(content: Content) -> None:
    content["coil"]["covariance"][0][1] = 1e-3


def _indefinite(content: Content) -> None:
    variance = [content["coil"]["covariance"][j][j] for j in (0, 1)]
    content["coil"]["covariance"][0][1] = content["coil"]["covariance"][1][0] = 1.1 * np.sqrt(np.prod(variance))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("amplifier.pole_Hz", -1.0), r"amplifier\.pole_Hz = -1\.0: must be greater than 0"),
        (_set("amplifier.pole_Hz", 1e999), "Infinity is not a finite number"),
        (_set("amplifier.delay_s", "68 us"), r"amplifier\.delay_s = '68 us': must be a valid number"),
        (_set("amplifier.pole", 1.0), r"amplifier\.pole: unknown field"),
        (_set("amplifier.intervals.pole_Hz", [2.0, 1.0]), "lower bound 2 is above its upper bound 1"),
        (_set("amplifier.parameters", ["pole_Hz", "pole"]), "pole is no number of this part; known: pole_Hz"),
        (_set("amplifier.parameters", ["pole_Hz", "pole_Hz"]), "twice"),
        (_set("coil.parameters", ["R_wh_K_W"]), "covariance: must be 1 by 1"),
        (_asymmetric, "not symmetric"),
        (_indefinite, "negative eigenvalue"),
        (_set("coil.covariance", (-np.eye(4)).tolist()), "negative variance of R_wh_K_W"),
        (_set("coil.sources", [{"file": "x.csv", "sha256": "12"}]), r"coil\.sources\.0\.sha256"),
        (_set("device.kind", "box"), "device"),
        (_set("device.moving_mass_kg", 0.0), r"device\.moving_mass_kg = 0\.0"),
        (_set("device.grips_N", [3.0, 1.0]), "strictly increasing"),
        (_set("device.nrmse", {"firm": 0.1}), "'firm' is not a grip"),
        (_set("device.hand.arm_stiffness_N_m", {"constant": -400.0, "per_newton": 110.0}), "at 1 N: .*passive"),
        (_set("hand.mass_kg", {"constant": 0.2, "per_newton": -0.1}), "at 7 N: .*must be > 0"),
        (_set("hand.grips_N", [0.0, 1.0]), "0 N"),
    ],
)
def test_each_wrong_value_is_named(full: Path, change: Callable[[Content], None], message: str) -> None:
    content = json.loads(full.read_text())
    change(content)
    full.write_text(json.dumps(content))
    with pytest.raises(InputError, match=message) as caught:
        load_model(full)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("device.order", 5), "A at 1 N: must be 5 by 5"),
        (_set("device.grips_N", [1.0, 3.0]), "A: 3 matrices for 2 grips"),
        (_set("device.A", np.broadcast_to(1e-3 * np.eye(6), (3, 6, 6)).tolist()), "not stable"),
    ],
)
def test_a_black_box_is_stable_and_of_its_order(
    tmp_path: Path, change: Callable[[Content], None], message: str
) -> None:
    path = tmp_path / "MODEL.json"
    save_part(path, "device", state_space_device())
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        load_model(path)


def test_draws_have_the_covariance_of_the_file() -> None:
    """L L' = covariance in raw units, over eight orders of magnitude and for parameters that err together."""
    part = drive_device()
    random = np.random.default_rng(2)
    p = len(part.parameters)
    size = np.sqrt(np.diag(part.covariance))
    mixing = random.normal(size=(p, p - 3))  # of less than full rank
    covariance = (size[:, None] * (mixing @ mixing.T) * size) / p
    part = part.model_copy(update={"covariance": covariance.tolist()})
    L = part.factor()
    assert np.allclose((L @ L.T) / np.outer(size, size), covariance / np.outer(size, size), atol=1e-12)


def test_other_values_are_checked_like_a_file() -> None:
    part = drive_device()
    values = part.values()
    assert part.with_values(values) == part
    moved = part.with_values(1.01 * values)
    assert moved.hand.arm_damping_N_s_m.per_newton == pytest.approx(1.01 * part.hand.arm_damping_N_s_m.per_newton)
    assert moved.force_per_current_N_A == part.force_per_current_N_A
    with pytest.raises(InputError, match="moving_mass_kg"):
        part.with_values(-values)


@pytest.mark.parametrize("grip_N", [0.0, 0.85, 5.6])
def test_grips_that_were_not_recorded_are_refused(grip_N: float) -> None:
    for device in (drive_device(), state_space_device()):
        with pytest.raises(InputError, match="record"):
            device.plant(grip_N)
        assert device.plant(0.9).order == device.plant(5.5).order


def test_a_black_box_blends_its_outputs_between_grips() -> None:
    device, f = state_space_device(), np.geomspace(5, 1000, 40)
    for j, grip_N in enumerate(device.grips_N):
        assert np.allclose(device.plant(grip_N).response(f), device.node(j).response(f), rtol=1e-12)
    between = 0.75 * device.node(0).response(f) + 0.25 * device.node(1).response(f)
    assert np.allclose(device.plant(1.5).response(f), between, rtol=1e-12)


def test_the_error_of_a_model_is_that_of_its_grip() -> None:
    device = drive_device(grips_N=[0.0, 1.0, 3.0]).model_copy(update={"nrmse": {"0": 0.5, "3": 0.04, "1": 0.02}})
    assert [device.error_at(F) for F in (0, 0.95, 2, 3)] == pytest.approx([0.5, 0.02, 0.03, 0.04])
    assert np.isnan(device.model_copy(update={"nrmse": {}}).error_at(1.0))
