"""Scenes: what they state, what is wrong in them, the built-in ones, and a scene as text."""

import codecs
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import problems
from transopt.base.errors import InputError
from transopt.base.toml_edit import edited
from transopt.base.units import LARGEST, LARGEST_PLAIN, beyond, largest, unit_of
from transopt.design.context import Context
from transopt.problem.limits import posed
from transopt.problem.limits.limit import Limits, Setting
from transopt.scene import builtin
from transopt.scene.builtin import FOLDER, load_scene, scene_names, scene_path
from transopt.scene.file import read_scene, scene_text
from transopt.scene.keys import keys, with_values
from transopt.scene.recordings import recordings_of
from transopt.scene.scene import Scene

TEXT = problems.scene_path("wood_on_foam").read_text()


def limits_of(scene: Scene) -> Limits:
    """The limits of a tap under the lightest grip that asks for no motion at all."""
    grid, stage = scene.time_grid(), Context(scene).stage(scene.grid.grips_N[0])
    nothing = np.zeros(grid.stages)
    setting = Setting(stage, grid, scene.circuit(), scene.coil(), scene.budget(), None, nothing, nothing, nothing)
    return posed(scene.limits.asked(), setting)


@pytest.mark.parametrize("name", problems.scene_names())
def test_every_built_in_scene_loads_and_its_plants_are_passive(name: str) -> None:
    scene = problems.load(name)
    assert scene.name == name
    assert scene.description
    for grip in scene.grid.grips_N:
        scene.plant(grip)
    if scene.model.kind != "arm":  # whose limits are those of each motor
        assert scene.driven_by.name in limits_of(scene)
    scene.coil()


def test_the_default_limits_are_the_seeds(tmp_path: Path) -> None:
    scene = problems.load("wood_on_foam")
    assert limits_of(scene).input_limit == pytest.approx(4.0, rel=1e-15)
    assert scene.time_grid().lead_s == 3e-4


def test_no_built_in_scene_states_its_lead_so_that_a_copy_with_another_delay_has_the_right_one() -> None:
    taps = [name for name in problems.scene_names() if not problems.load(name).targets]
    assert all("lead_s" not in problems.scene_path(name).read_text() for name in taps)


@pytest.mark.parametrize(
    ("delay_s", "dt_s", "lead_s"),
    [
        (68e-6, 1e-4, 3e-4),
        (0.0, 1e-4, 2e-4),
        (1e-4, 1e-4, 3e-4),  # just three periods, whatever rounding says
        (100.1e-6, 1e-4, 4e-4),
        (1e-3, 1e-4, 1.2e-3),
        (68e-6, 2.5e-5, 2.75e-4),
        (19.8e-3, 1e-4, 20e-3),
    ],
)
def test_a_lead_that_is_not_stated_covers_the_delay(scene: Scene, delay_s: float, dt_s: float, lead_s: float) -> None:
    """The least whole number of periods that is at least the delay and 0.2 ms."""
    found = with_values(scene, {"amplifier.delay_s": delay_s, "time.dt_s": dt_s, "weights.after_s": 0.01})
    assert found.time.lead_s is None
    assert found.time_grid().lead_s == lead_s
    assert found.time_grid().before_times_s.size == 0


def test_a_lead_that_is_stated_stays(scene: Scene) -> None:
    found = with_values(scene, {"amplifier.delay_s": 9e-3, "time.lead_s": 0.0}).time_grid()
    assert (found.lead_s, found.before_times_s.size) == (0.0, 90)


def test_what_is_looked_at_after_the_waveform(scene: Scene) -> None:
    for after_s, dt_s, samples in ((None, 1e-4, 300), (0.0, 1e-4, 0), (0.03, 5e-5, 600), (0.0124, 1e-3, 12)):
        changes = {"time.dt_s": dt_s, **({} if after_s is None else {"weights.after_s": after_s})}
        assert with_values(scene, changes).time_grid().after_stages == samples


def test_an_objective_reaches_the_problems(scene: Scene) -> None:
    assert (scene.posing().objective, scene.posing().intensity_dB) == ("waveform", 0.0)
    asked = with_values(scene, {"weights.objective": "intensity", "weights.intensity_dB": 1.5}).posing()
    assert (asked.objective, asked.intensity_dB) == ("intensity", 1.5)


def test_a_description_is_no_duty(tmp_path: Path) -> None:
    path = tmp_path / "plain.toml"
    path.write_text(re.sub("^description.*$", "", TEXT, flags=re.MULTILINE))
    scene = problems.load(path)
    assert scene.description == ""
    assert repr(scene).startswith("Scene(plain; 4 speeds")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "beta = 3.2",
            "betta = 3.2",
            r"limits.betta: unknown key \(did you mean beta\?\); known here: steady_current_A, beta, current_A",
        ),
        ("[0.1, 0.2", "[0.1, 0.1", r"grid.speeds_m_s = \[0.1, 0.1, 0.3, 0.4\]: must be strictly increasing"),
        ("[0.1, 0.2", "[0.2, 0.1", r"grid.speeds_m_s = .*strictly increasing"),
        ("[0.1, 0.2", "[0.0, 0.2", r"grid.speeds_m_s#1 = 0.0: must be greater than or equal to 0.0001"),
        ("grips_N = [1.0", "grips_N = [-1.0", r"grid.grips_N#1 = -1.0: must be greater than or equal to 0"),
        ("grips_N = [1.0", "grips_N = [0.0", r"grip 0\) needs a scene of its own"),
        ("grips_N = [1.0", "grips_N = [0.2", r"0.2 N is below grip_min_N = 0.5 N.* lower grip_min_N"),
        ("[1.0, 3.0, 5.0]", "[]", r"grid.grips_N = \[\]"),
        ("pole_Hz = 1050.0", "pole_Hz = -1.0", r"amplifier.pole_Hz = -1.0: must be greater than 0 Hz$"),
        ("pole_Hz = 1050.0", "", r"amplifier.pole_Hz: missing"),
        (
            "steady_current_A = 1.25",
            "steady_current_A = 0.0",
            r"limits.steady_current_A = 0.0: must be greater than 0",
        ),
        ("beta = 3.2", "beta = 3.2\ncurrent_A = 4.0", r"limits: give beta or current_A, not both"),
        ("rho = 1e-3", "rho = nan", r"weights.rho = nan: must be a finite number"),
        ('"drive"', '"dirve"', r"model: .*'second_order', 'fourth_order', 'drive'"),
        ("stylus_mass_kg = 0.026", "stylus_mass_kg = 0.0", r"model.stylus_mass_kg = 0.0: must be greater than 0"),
        ("motors/maxon", "motors/maxxon", r"no such file in .* [(]did you mean motors/maxon_re25_118743"),
        ("[amplifier]", "[tip]\nforce_per_current_N_A = 1.0\nmoving_mass_kg = 0.1\n[amplifier]", "give exactly one"),
        (
            "transmissions/phantom",
            "transmissions/fantom",
            r"transmission = 'transmissions/fantom_class.toml': no such",
        ),
        ("stages = 800", "stages = 5", r"hand_over_samples = 10: must not exceed time.stages = 5"),
        ("[grid]", "[grid", r"not valid TOML"),
        ("[grid]", 'model = "m.json"\n[grid]', r"states a model file .* and \[model\] tables: write model_file = "),
        ("stages = 800", "lead_s = 0.2", r"time.lead_s = 0.2: must be less than or equal to 0.02"),
        (
            "delay_s = 68e-6",
            "delay_s = 19.9e-3",
            r"time.lead_s: the amplifier's delay of 19.9 ms .* take a lead of 20.1",
        ),
        ("[weights]", "[weights]\nafter_s = 0.6", r"weights.after_s = 0.6: must be less than or equal to 0.5"),
        ("[weights]", "[weights]\nafter_s = -1e-3", r"weights.after_s = -0.001: must be greater than or equal to 0"),
        ("dt_s = 1e-4", "dt_s = 5e-6", r"weights.after_s = 0.03 s: 6000 samples of 5e-06 s, at most 3000: lower"),
        (
            "[weights]",
            '[weights]\nobjective = "loud"',
            r"weights.objective = 'loud': must be 'waveform' or 'intensity'",
        ),
        ("[weights]", "[weights]\nintensity_dB = 60", r"weights.intensity_dB = 60: must be less than or equal to 20"),
        ("seed = 1", "seed = -1", r"recordings.simulated.seed = -1"),
        ("[grid]", "[wall]\nstiffness_N_m = 500\n\n[grid]", r"wall: a virtual wall is the table \[feedback\]"),
        ("[limits]", "[limits]\nwinding_limit_C = 80", r"limits.winding_limit_C: .* is motor.winding_max_C$"),
        ("[weights]", "[weights]\nafter_s = 5", r"equal to 0.5 s \(did you mean 5 ms\?\)"),
        ("[limits]", "[limits]\ncurrent_A = -1\nstrok = 3", r"limits.strok: .*\(and 1 more: limits.current_A\)$"),
        ("[grid]", "[gird]", r"gird: unknown key \(did you mean grid\?\); known here: name, description, grid"),
        (
            "skin_stiffness",
            "skin_stifness",
            r"skin_stifness_N_m: unknown key \(did you mean skin_stiffness_N_m",
        ),
        ('"drive"', '"second_order"', r"model.stylus_mass_kg: unknown key; known here: kind \(and 1 more: "),
        (
            "beta = 3.2",
            "beta = 32.0",
            r"beta = 32: makes 40 A .*, above the motor's i_peak_A = 10 A: lower it to 8 or",
        ),
        (
            "beta = 3.2",
            "current_A = 11.0",
            r"limits.current_A = 11: above .* i_peak_A = 10 A: lower it to 10 or less",
        ),
        ("[recordings]", '[recordings]\nfiles = ["a.csv"]', r"recordings: give either files or a simulated table"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    path = tmp_path / "mine.toml"
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(InputError) as refused:
        problems.load(path)
    text = str(refused.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    assert re.search(message, text), text


def test_parameters_that_are_not_passive_at_a_grip_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        TEXT.replace(
            "skin_stiffness_N_m = { constant = 3000.0, per_newton = 2000.0 }",
            "skin_stiffness_N_m = { constant = 3000.0, per_newton = -2000.0 }",
        )
    )
    scene = problems.load(path)
    with pytest.raises(InputError, match=r"stiffness_N_m of link 2 .* = -3000: must be >= 0"):
        scene.plant(3.0)


def test_paths_count_from_the_scene_file(tmp_path: Path) -> None:
    motor = (problems.FOLDER / "motors" / "maxon_re25_118743.toml").read_text()
    (tmp_path / "motor.toml").write_text(motor.replace("R_ohm = 2.18", "R_ohm = 3.0"))
    path = tmp_path / "mine.toml"
    simulated = TEXT[TEXT.index("[recordings.simulated]") : TEXT.index("[model]")]
    path.write_text(
        TEXT.replace(simulated, 'files = ["a.csv"]\nfolder = "taps"\n').replace(
            "motors/maxon_re25_118743.toml", "motor.toml"
        )
    )
    scene = problems.load(path)
    assert scene.motor.R_ohm == 3.0
    assert Path(scene.recordings.folder) == (tmp_path / "taps").resolve()


def test_a_drive_stated_at_the_tip(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    tip = "[tip]\nforce_per_current_N_A = 1.25\nmoving_mass_kg = 0.014\nstiffness_N_m = 6e4\ndamping_N_s_m = 8.0\n\n"
    lines = [line for line in TEXT.splitlines() if not line.startswith(("motor =", "transmission ="))]
    path.write_text("\n".join(lines).replace("[amplifier]", tip + "[amplifier]"))
    scene = read_scene(path)
    assert scene.coil() is None
    assert scene.drive_at_tip().force_per_current_N_A == 1.25
    path.write_text(path.read_text().replace("stiffness_N_m = 6e4\ndamping_N_s_m = 8.0\n", ""))
    with pytest.raises(InputError, match=r"needs tip.stiffness_N_m"):
        read_scene(path)


def test_motor_without_transmission_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("\n".join(line for line in TEXT.splitlines() if not line.startswith("transmission =")))
    with pytest.raises(InputError, match="motor and transmission belong together"):
        problems.load(path)


def test_an_ideal_amplifier_is_stated_never_assumed(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    without = TEXT[: TEXT.index("[amplifier]")] + TEXT[TEXT.index("[limits]") :]
    path.write_text(without)
    with pytest.raises(InputError, match="amplifier: missing"):
        problems.load(path)
    path.write_text('amplifier = "ideal"\n' + without)
    scene = problems.load(path)
    assert scene.amplifier_model() is None
    assert scene.time_grid().delay_s == 0.0
    assert "command" not in limits_of(scene)


def test_a_scene_as_editors_on_windows_save_it_is_the_same(tmp_path: Path) -> None:
    (tmp_path / "plain.toml").write_text(TEXT)
    (tmp_path / "marked.toml").write_bytes(codecs.BOM_UTF8 + TEXT.replace("\n", "\r\n").encode())
    plain, marked = (problems.load(tmp_path / f"{name}.toml") for name in ("plain", "marked"))
    assert marked.model_copy(update={"name": plain.name}) == plain


def test_files_that_are_no_scene(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_scene(tmp_path / "absent.toml")
    with pytest.raises(InputError, match="a folder, not a file"):
        read_scene(tmp_path)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"cannot be read as text .* save it as UTF-8"):
        read_scene(binary)


def test_the_folder_is_that_of_the_package_problems() -> None:
    assert Path(problems.__file__).parent == builtin.FOLDER
    assert builtin.scene_names() == sorted(path.stem for path in (builtin.FOLDER / "scenes").glob("*.toml"))
    assert "wood_on_foam" in builtin.scene_names()


def test_a_path_is_read_and_finds_built_in_motors(tmp_path: Path) -> None:
    file = tmp_path / "mine.TOML"
    file.write_text(builtin.scene_path("wood_on_foam").read_text(encoding="utf-8"), encoding="utf-8")
    assert builtin.load_scene(str(file)).motor == builtin.load_scene("wood_on_foam").motor
    assert builtin.load_scene(file).name == "mine"


def test_recordings_are_read_or_simulated_as_the_scene_says(scene: Scene) -> None:
    assert recordings_of(scene)[0].name == "wood_on_foam_0.1_m_s_1_N_1"
    own = builtin.load_scene("own_taps")
    assert own.recordings.simulated is None
    assert all(tap.source.endswith(".csv") for tap in recordings_of(own))


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_comes_back(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    (tmp_path / f"{name}.toml").write_text(scene_text(scene), encoding="utf-8")
    assert read_scene(tmp_path / f"{name}.toml") == scene


def test_words_are_escaped(tmp_path: Path) -> None:
    said = 'a "quote", a \\ and a\ttab\nand é'
    scene = with_values(load_scene("lra_click"), {"description": said})
    (tmp_path / "scene.toml").write_text(scene_text(scene), encoding="utf-8")
    assert read_scene(tmp_path / "scene.toml").description == said


CHANGES = {"weights.rho": 2e-3, "thermal.headroom_K": None, "limits.stroke_m": 0.02, "robust.relative": None}


@pytest.mark.parametrize("name", [name for name in scene_names() if load_scene(name).model.kind != "arm"])
def test_an_edited_file_states_what_was_asked_for_and_keeps_its_comments(name: str, tmp_path: Path) -> None:
    text = scene_path(name).read_text(encoding="utf-8")
    found = edited(text, {**CHANGES, "name": name})
    (tmp_path / "other.toml").write_text(found, encoding="utf-8")
    scene = read_scene(tmp_path / "other.toml", search=[FOLDER])
    asked = {**CHANGES, "recordings.folder": scene.recordings.folder}
    del asked["robust.relative"]
    assert scene == with_values(load_scene(name), asked)
    kept = {line for line in found.splitlines() if line.startswith("#")}
    assert {line for line in text.splitlines() if line.startswith("#")} <= kept


def test_every_number_of_a_scene_has_an_upper_bound(scene: Scene) -> None:
    for key in keys(scene):
        assert not key.number or "<" in key.bounds or "one of" in key.bounds or key.unit == "", key.path


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("limits.current_A", 1e6, "must be finite and at most 10000 A"),
        ("time.dt_s", 1e-9, "must be greater than or equal to 0.000001"),
        ("time.stages", 10**6, "must be less than or equal to 20000"),
        ("model.hand.arm_stiffness_N_m.per_newton", 1e20, "at most 1e+10 N/m"),
        ("model.hand.mass_kg.constant", -1e9, "at most 100000 kg in size"),
        ("recordings.simulated.repeats", 10**9, "less than or equal to 100"),
        ("amplifier.delay_s", 10.0, "less than or equal to 1"),
    ],
)
def test_beyond_it_the_line_says_so(scene: Scene, path: str, value: Any, words: str) -> None:
    with pytest.raises(InputError) as caught:
        with_values(scene, {path: value})
    assert words in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_long_horizon_and_a_large_library(scene: Scene) -> None:
    with pytest.raises(InputError, match=r"20000 stages of 0\.001 s are 20 s: must be at most 10 s"):
        with_values(scene, {"time.stages": 20_000, "time.dt_s": 1e-3})
    speeds = [0.1 + 1e-3 * j for j in range(400)]
    with pytest.raises(InputError, match="24000000 commands, at most 2000000"):
        with_values(scene, {"grid.speeds_m_s": speeds, "time.stages": 20_000})


@pytest.mark.parametrize("name", ["../../x", "a/b", "a\\b", "..", "", " ", "a\nb", "\x1b[31m", "n" * 101])
def test_a_name_is_that_of_a_folder(scene: Scene, name: str) -> None:
    with pytest.raises(ValidationError, match="name"):
        Scene.model_validate({**scene.model_dump(), "name": name})


def test_words_may_have_lines_but_no_control_characters(scene: Scene) -> None:
    content = scene.model_dump()
    assert Scene.model_validate({**content, "description": "two\n\tlines, é"}).description == "two\n\tlines, é"
    with pytest.raises(ValidationError, match="control character"):
        Scene.model_validate({**content, "description": "\x1b]0;owned\x07"})


def test_units() -> None:
    assert largest(unit_of("a.hand.mass_kg.per_newton")) == LARGEST["kg"]
    assert largest(unit_of("weights.rho")) == LARGEST_PLAIN
    assert beyond("x_A", [1.0, {"a": [1e9]}])
    assert beyond("x_A", float("nan"))
    assert not beyond("x_A", [True, "1e9", None, -1e4])
    assert not beyond("A", [[1e6]]), "a matrix has no unit"
