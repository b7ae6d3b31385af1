"""Plants in files, and responses that no actuator has in the units that are stated."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import io

import transopt as to
from tests.benches.actuators import file_scene, lra_scene, ten_states
from tests.benches.libraries import proven_again
from transopt.base.errors import InputError
from transopt.plant.state_space import Output, StateSpace
from transopt.scene.builtin import load_scene
from transopt.scene.file import with_plant
from transopt.scene.keys import with_values
from transopt.scene.plant_file import save_plant
from transopt.scene.plausible_response import against_sheet, implausible_response
from transopt.scene.scene import Scene

UNITS = '[model.outputs.pull]\nunit = "N"\n'
VOLTAGE = 'input = "voltage"\n'


def arrays(plant: StateSpace) -> dict[str, Any]:
    rows = {f"output_{name}": output.row for name, output in plant.outputs.items()}
    return {**{name: getattr(plant, name) for name in "ABCD"}, **rows}


def as_npz(plant: StateSpace, path: Path) -> None:
    np.savez(path, **arrays(plant))


def as_mat(plant: StateSpace, path: Path) -> None:
    io.savemat(path, arrays(plant))


def as_csv(plant: StateSpace, path: Path) -> None:
    n = plant.order
    rows = [np.hstack([plant.A, plant.B]), np.hstack([plant.C, plant.D])]
    rows += [np.append(output.row[0], 0.0)[None] for output in plant.outputs.values()]
    head = f"a plant of {n} states\noutputs: {', '.join(plant.outputs)}"
    np.savetxt(path, np.vstack(rows), delimiter=",", fmt="%.17g", header=head)


WRITERS: dict[str, Callable[[StateSpace, Path], None]] = {".npz": as_npz, ".mat": as_mat, ".csv": as_csv}


def read(folder: Path, text: str) -> Scene:
    (folder / "mine.toml").write_text(text, encoding="utf-8")
    return load_scene(folder / "mine.toml")


def assert_same(found: StateSpace, expected: StateSpace) -> None:
    for name in "ABCD":
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-15)
    assert found.driven_by == expected.driven_by
    assert set(found.outputs) == set(expected.outputs)
    for name, output in expected.outputs.items():
        np.testing.assert_allclose(found.outputs[name].row, output.row, rtol=1e-15)
        assert (found.outputs[name].unit, found.outputs[name].follows) == (output.unit, output.follows)


@pytest.mark.parametrize("suffix", WRITERS)
def test_every_format_holds_the_same_plant(suffix: str, tmp_path: Path) -> None:
    plant = ten_states()
    WRITERS[suffix](plant, tmp_path / f"plant{suffix}")
    scene = read(tmp_path, file_scene(f"plant{suffix}", VOLTAGE + UNITS, "stroke_m = 1e-3\n"))
    assert_same(scene.plant(0.0), plant)


def test_what_is_saved_is_read_and_needs_no_file_afterwards(tmp_path: Path) -> None:
    plant = ten_states()
    save_plant(plant, tmp_path / "plant.npz")
    scene = read(tmp_path, file_scene("plant.npz", UNITS))
    (tmp_path / "plant.npz").unlink()
    assert_same(Scene.model_validate(scene.model_dump()).plant(0.0), plant)
    assert_same(with_values(scene, {"limits.voltage_V": 2.0}).plant(0.0), plant)


def test_a_plant_of_python_is_put_into_a_scene(tmp_path: Path) -> None:
    scene = read(tmp_path, lra_scene())
    assert_same(with_plant(scene, ten_states()).plant(0.0), ten_states())
    own = scene.plant(0.0)
    assert_same(with_plant(scene, own).plant(0.0), own)
    by_current = StateSpace(own.A, own.B, own.C, own.D)
    with pytest.raises(InputError, match="limits"):
        with_plant(scene, by_current)


def test_a_row_of_the_scene_stands_beside_those_of_the_file(tmp_path: Path) -> None:
    save_plant(ten_states(), tmp_path / "plant.npz")
    own = "[model.outputs.sway]\nrow = [1, 0, 0, 0, 0, 0, 0, 0, 0, 0]\nunit = 'mm'\n"
    outputs = read(tmp_path, file_scene("plant.npz", UNITS + own)).plant(0.0).outputs
    assert set(outputs) == {"position", "velocity", "pull", "sway"}


@pytest.mark.parametrize(
    ("changed", "more", "words"),
    [
        ({"A": np.eye(3, 4)}, "", r"A: of shape \(3, 4\), must be square"),
        ({"B": np.ones((9, 2))}, "", r"B: of shape \(9, 2\), must have 10 numbers, one input and one output"),
        ({"C": np.ones(9)}, "", r"C: of shape \(1, 9\), must have 10 numbers"),
        ({"D": np.ones(2)}, "", r"D: of shape \(1, 2\), must have 1 number, one input"),
        ({"B": np.full(10, np.nan)}, "", "B: holds a number that is not finite"),
        ({"A": np.array(["a"])}, "", "A: must be a matrix of real numbers"),
        ({"B": None}, "", "no B: a plant file holds the matrices A, B, C, D .* it has A, C, D"),
        ({"input": "force"}, "", "input = 'force': must be current or voltage"),
        ({"input": "current"}, VOLTAGE, "a current drives it, and the scene states input = 'voltage'"),
        (
            {},
            "[model.outputs.pull]\nrow = [1]\nunit = 'N'\n",
            "model.outputs.pull: the scene states its row as well",
        ),
        (
            {},
            "[model.outputs.pul]\nunit = 'N'\n" + UNITS,
            r"model.outputs.pul: no row output_pul .*did you mean pull",
        ),
        ({}, "", r'output_pull has no unit: add \[model.outputs.pull\] with unit = "m"'),
        ({}, "A = [[1.0]]\n", "model.A: stands in model.file = 'plant.npz' too"),
        ({"output_pull": np.ones(3)}, UNITS, r"output_pull: of shape \(1, 3\), must have 10 numbers"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(changed: dict[str, Any], more: str, words: str, tmp_path: Path) -> None:
    content = {**arrays(ten_states()), **changed}
    np.savez(tmp_path / "plant.npz", **{name: value for name, value in content.items() if value is not None})
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, file_scene("plant.npz", more))
    assert str(caught.value).isprintable()
    assert "mine.toml: model." in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1,2,3\n4,5,6\n", r"2 rows of 3 cells: the block matrix \[A B; C D\] of n states has n \+ 1 rows"),
        ("1,2\n3\n", "row 2: 1 cells, the rows above have 2"),
        ("a,b\n", "row 1: 'a,b' is not a row of numbers; put # before a remark"),
        ("", "0 rows of 1 cells"),
        ("# outputs: x\n-1,1\n1,0\n1,2\n", "output x: its last cell must be 0"),
        ("# input: force\n-1,1\n1,0\n", "input = 'force': must be current or voltage"),
    ],
)
def test_a_text_that_is_no_block_matrix(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "plant.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        read(tmp_path, file_scene("plant.csv"))


def test_a_spreadsheets_semicolons_and_the_input_in_a_comment(tmp_path: Path) -> None:
    (tmp_path / "plant.csv").write_text("# input: voltage;\n-1,5;1\n2;0\n", encoding="utf-8")
    plant = read(tmp_path, file_scene("plant.csv")).plant(0.0)
    np.testing.assert_array_equal(plant.A, [[-1.5]])
    assert plant.driven_by.unit == "V"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("gone.npz", None, "gone.npz: no such file; a plant file holds the matrices"),
        ("plant.json", b"{}", "unknown format '.json': save the matrices as .npz, .mat, .csv"),
        ("plant.npz", b"PK no zip", "not a readable NPZ file"),
        ("plant.mat", b"\0" * 300, "not a readable MAT file"),
        ("plant.csv", b"\xff\xfe", "cannot be read as text"),
    ],
)
def test_a_file_that_is_none(name: str, content: bytes | None, words: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        read(tmp_path, file_scene(name))


class TestCoilsInScenes:
    def test_the_current_of_a_coil_without_inductance_is_no_state_and_limited(self, tmp_path: Path) -> None:
        scene = read(tmp_path, lra_scene(L_H=0.0) + "current_A = 0.3\n")
        assert "current" not in scene.plant(0.0).outputs
        assert scene.limits.asked()["current_A"] == pytest.approx(0.3)


class TestPositionAndVelocity:
    LIMITS = "stroke_m = 5e-6\n"

    def scene(self, folder: Path, **changed: Any) -> Scene:
        content = {**arrays(ten_states()), **changed, "input": "voltage"}
        np.savez(folder / "plant.npz", **{name: value for name, value in content.items() if value is not None})
        return read(folder, file_scene("plant.npz", UNITS, self.LIMITS, peak_m_s2=60.0))

    def test_a_position_tells_the_velocity_of_the_same_mass(self, tmp_path: Path) -> None:
        assert_same(self.scene(tmp_path, output_velocity=None).plant(0.0), ten_states())

    @pytest.mark.parametrize("stated", ["both", "position", "another's velocity", "in a case"])
    def test_a_library_knows_what_its_scene_says_of_them(self, stated: str, tmp_path: Path) -> None:
        changed: dict[str, Any] = {}
        if stated == "position":
            changed["output_velocity"] = None
        elif stated == "another's velocity":
            changed["output_velocity"] = np.eye(1, 10, 5)
        scene = self.scene(tmp_path, **changed)
        if stated == "in a case":
            plant = ten_states()
            floating = {name: Output(o.row, o.unit) for name, o in plant.outputs.items()}
            scene = with_plant(scene, StateSpace(plant.A, plant.B, plant.C, plant.D, floating, plant.driven_by))
        library = proven_again(to.solve(scene), tmp_path)
        assert "stroke" in str(library.binding[0, 0])

    def test_a_position_that_the_input_moves_at_once_is_none(self, tmp_path: Path) -> None:
        with pytest.raises(
            InputError, match=r"outputs.position: the input changes its velocity at once, by 5\.28e\+03"
        ):
            self.scene(tmp_path, output_position=np.eye(1, 10, 3) * 6.0)


class TestResponse:
    f = np.geomspace(20, 1000, 80)

    def accelerance(self, gain: float = 0.6, f0: float = 150.0) -> np.ndarray:
        s, w = 2j * np.pi * self.f, 2 * np.pi * f0
        return gain * s**2 / (s**2 + s * w / 8 + w**2)

    def said(self, response: np.ndarray, frequency: float = 1.0, f0: float = 150.0) -> str:
        return implausible_response(frequency * self.f, response, [frequency * f0], "V")

    @pytest.mark.parametrize("gain", [0.3, 3.0, 30.0, 300.0])
    def test_actuators_pass(self, gain: float) -> None:
        assert not self.said(self.accelerance(gain))
        assert not self.said(self.accelerance(gain), f0=1e5)  # a pole of the fit where nothing was measured
        assert not implausible_response(self.f, np.full(self.f.size, gain + 0j), [], "A")

    @pytest.mark.parametrize(
        ("factor", "frequency", "words"),
        [
            (1e-3, 1.0, "1000: mm/s^2, mg or mV?"),
            (1e6, 1.0, "1000: mm/s^2, mg or mV?"),
            (1.0, 1e-3, "1000: kHz?"),
            (1.0, 1e3, "1000: kHz?"),
            (1.0, 40.0, "6.283: rad/s called Hz?"),
        ],
    )
    def test_a_wrong_unit_is_named_with_its_factor(self, factor: float, frequency: float, words: str) -> None:
        assert words in self.said(factor * self.accelerance(), frequency)

    def test_a_velocity_and_a_displacement_are_told_from_an_acceleration(self) -> None:
        w = 2 * np.pi * self.f
        assert "as a velocity, no acceleration: state its unit, or multiply it by 2 pi f" in self.said(
            1e3 * self.accelerance() / w
        )
        assert "as a displacement" in self.said(1e6 * self.accelerance() / w**2)

    def test_exchanged_columns_are_told_by_how_the_response_begins(self) -> None:
        assert "are the columns exchanged?" in implausible_response(self.f, 1 / self.accelerance(), [9.0], "V")
        above = self.f > 155  # a band that begins on the far side of a resonance falls as steeply
        assert not implausible_response(self.f[above], self.accelerance()[above], [150.0], "V")

    @pytest.mark.parametrize(
        ("ratio", "words"), [(9.81, "g and m/s^2"), (1 / 9.81, "g and m/s^2"), (1e3, "milli"), (6.28, "rad/s and Hz")]
    )
    def test_against_its_sheet(self, ratio: float, words: str) -> None:
        assert words in against_sheet(150 * ratio, 150, "resonance", "Hz")
        assert not against_sheet(1.2 * 150, 150, "resonance", "Hz")
