"""The library file: round trip, refusal of everything else, blending between nodes."""

import json
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benches.libraries import part_of, rewritten, under
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.build import Build
from transopt.design.verify import verify_library
from transopt.library.arrays import HASH_FIELD
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.library.multipliers import ARRAYS
from transopt.solvers import unlimited

# Words of the interpreter and its libraries, which say nothing to whoever gave a file.
PYTHON = re.compile(
    r"[A-Z]\w+Error|NoneType|'(str|float|int|list|dict)'|instance of|object|CRC|zip file|decompress|delimiter|char \d"
)


@pytest.fixture
def saved(saved_library: Path, tmp_path: Path) -> Path:
    """A copy, to be changed."""
    return shutil.copyfile(saved_library, tmp_path / "library.npz")


def stating(library: Library, **changed: object) -> np.ndarray:
    """The array `meta` of a library with other statements."""
    return np.array(json.dumps({**library.meta, **changed}))


def test_round_trip(library: Library, saved: Path) -> None:
    again = load_library(saved)
    assert again.meta == library.meta
    for name in ARRAYS:
        np.testing.assert_array_equal(again.array(name), library.array(name), err_msg=name)


def test_numbers_that_overflow_fall_short_without_warnings(
    library: Library, saved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Warnings are errors in tests: from Python a check prints as little as the command does."""
    monkeypatch.setattr(unlimited, "MOST_S", 0.1)  # its last resort finds no end to such numbers
    part_of(library, [3], [2]).save(saved)
    with np.load(saved) as file:
        plant = file["plant_A"].copy()
    plant[..., 0, 0] = 1e12
    assert all(check.shortfalls for check in verify_library(load_library(rewritten(saved, plant_A=plant))))


def test_file_holds_the_fields_of_design_and_no_pickles(saved: Path, library: Library) -> None:
    with np.load(saved, allow_pickle=False) as file:
        names = set(file.files)
        absent = {
            name
            for name in ARRAYS
            if ARRAYS[name].needs in ("nonlinear", "targets", "several directions", "arm")
            or (
                name.startswith(("mu_", "current_sign", "spread", "correction", "intensity", "energy_dB", "instants"))
                and not name.startswith(("mu_current_lower", "mu_current_upper", "mu_command", "mu_end"))
            )
        }
        assert len(absent) == 42
        assert names == (set(ARRAYS) - absent) | {"meta", HASH_FIELD}, "no limit but those of current and command"
        meta = json.loads(str(file["meta"]))
        assert file["command"].shape == (4, 3, 800)
    assert meta["schema"] == 4
    assert meta["scene"]["name"] == library.scene().name
    assert set(meta["versions"]) == {"transopt", "casadi", "numpy", "scipy", "python"}
    assert len(meta["sources"]) == 36
    assert "simulated" in meta["sources"][0]["origin"]


def test_target_is_what_was_recorded_less_the_free_motion(library: Library) -> None:
    assert library.recorded_before_m_s2.shape == (4, 3, 0)
    assert library.recorded_after_m_s2.shape == (4, 3, 300)
    assert library.nominal_position_at_ticks_m.shape == (4, 3, 800)
    for part in ("before_", "", "after_"):
        recorded, free, target = (getattr(library, f"{of}_{part}m_s2") for of in ("recorded", "free", "target"))
        np.testing.assert_allclose(target, recorded - free, atol=1e-12)


def test_what_comes_after_the_window_is_stored(library: Library, build: Build) -> None:
    for iv, row in enumerate(build.entries):
        for ig, entry in enumerate(row):
            made = entry.problem.accelerations(entry.solution.command)[0, 800:]
            error = made - library.target_after_m_s2[iv, ig]
            first = library.time_grid().switching_times_s < 0.03 - 1e-9
            size = np.linalg.norm(
                library.recorded_m_s2[iv, ig][first & (library.time_grid().switching_times_s > -1e-9)]
            )
            assert library.error_after[iv, ig] == pytest.approx(np.linalg.norm(error) / size, rel=1e-5)
            assert library.peak_after_m_s2[iv, ig] == pytest.approx(np.abs(error).max(), rel=1e-6)
            np.testing.assert_allclose(library.lasting(iv, ig)[0][800:], made, atol=1e-9)


def test_heat_is_the_integral_of_the_squared_current(library: Library) -> None:
    current = library.lasting(3, 2)[1][: library.command.shape[-1]]
    assert library.heat_A2_s[3, 2] == pytest.approx(1e-4 * float(current @ current), rel=1e-9)


def test_between_the_nodes_a_target_is_blended_in_speed_by_shape_and_in_grip(library: Library) -> None:
    middle = library.wanted(0.15, 2.0).target
    shapes = library.target_m_s2[:2, :2] / library.speeds_m_s[:2, None, None]
    np.testing.assert_allclose(middle.window_m_s2, 0.15 * shapes.mean(axis=(0, 1)), atol=1e-12)
    np.testing.assert_array_equal(
        library.wanted(0.2, 3.0).target.window_m_s2, library.wanted_of(1, 1).target.window_m_s2
    )


@pytest.mark.parametrize("schema", [1, 2, 3, 5, True, "4"])
def test_another_schema_ends_in_one_line(saved: Path, library: Library, schema: object) -> None:
    rewritten(saved, meta=stating(library, schema=schema))
    with pytest.raises(InputError) as caught:
        load_library(saved)
    said = f"schema {schema!r}, this version reads schema 4 alone; solve the scene again"
    assert str(caught.value) == f"{saved}: {said}"


def test_hand_over_is_zero_and_transient_is_the_command(library: Library) -> None:
    assert not library.command[..., -10:].any()
    np.testing.assert_array_equal(library.transient_command, library.command)


@pytest.mark.parametrize("field", ["command", "mu_current_upper", "plant_A", "tap_error", "meta"])
def test_any_change_is_noticed(saved: Path, library: Library, field: str) -> None:
    if field == "meta":
        changed = stating(library, derived={})
    else:
        changed = library.array(field).copy()
        changed.flat[-1] += 1e-12
    with pytest.raises(InputError, match="does not match its hash"):
        load_library(rewritten(saved, hashed=False, **{field: changed}))


Meta = dict[str, Any]


def of_scene(words: str, **change: object) -> Any:
    """A case of a scene that describes no problem, or another one."""
    return pytest.param(lambda meta: {**meta, "scene": {**meta["scene"], **change}}, words, id=f"scene {change}")


def of_form(**change: object) -> Any:
    """A case of a part of another form."""
    return pytest.param(lambda meta: {**meta, **change}, r"library\.npz: ", id=f"{change}")


def lacking(key: str) -> Any:
    """A case of a part that is not there."""
    said = f"meta lacks {key}; solve the scene again"
    return pytest.param(lambda meta: {k: v for k, v in meta.items() if k != key}, said, id=f"lacks {key}")


SCENES = [
    of_scene("meta.scene: time.dt_s", time={"dt_s": "x", "stages": 800}),
    of_scene("meta.scene: time.dt_s", time={"dt_s": -1e-4, "stages": 800}),
    of_scene("meta.scene: ", time={"dt_s": 1e-4, "stages": 10**9}),
    of_scene("meta.scene: amplifier", amplifier={"pole_Hz": "x", "delay_s": 0, "command_limit_A": 6}),
    of_scene("meta.scene: amplifier", amplifier={"pole_Hz": 1000.0, "delay_s": -1.0, "command_limit_A": 6}),
    of_scene("meta.scene: time.lead_s", amplifier={"pole_Hz": 1000.0, "delay_s": 0.9, "command_limit_A": 6}),
    of_scene("meta.scene: weights.after_s", weights={"after_s": 1e7}),
    of_scene("meta.scene: weights.after_s", weights={"after_s": float("nan")}),
    of_scene(r"acceleration_after_m_s2 has shape \(4, 3, 300\), expected \(4, 3, 200\)", weights={"after_s": 0.02}),
    of_scene("array intensity is missing", weights={"objective": "intensity"}),
    of_scene("meta.scene: feedback", feedback={"damping_N_s_m": 200.0}),
    of_scene("meta.scene: ", motor={"R_ohm": 1.0}),
    of_scene("meta.scene: unheard_of", unheard_of=1),
    of_scene("meta.scene: thermal = 3: must be a table", thermal=3),
    of_scene("meta.scene: model = 'x': must be a table", model="x"),
]
LACKING = [*map(lacking, ("scene", "derived", "left_out", "repeatability", "sources", "versions"))]
FORMS = [
    *(of_form(scene=None), of_form(scene=[]), of_form(derived=None)),
    *(of_form(repeatability=[0.1]), of_form(repeatability=["x"] * 4)),
    *(of_form(left_out=None), of_form(left_out={"limits": [1, 2]}), of_form(left_out={"limits": 3})),
    *(of_form(sources={}), of_form(versions=[]), of_form(outputs=3)),
]


class TestRefusals:
    @pytest.mark.parametrize(
        ("name", "message"),
        [("absent.npz", r"absent.npz: no such file; give a library.npz"), ("", "a folder, not a file")],
    )
    def test_no_file(self, tmp_path: Path, name: str, message: str) -> None:
        with pytest.raises(InputError, match=message):
            load_library(tmp_path / name)

    @pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 truncated"])
    def test_not_an_archive(self, tmp_path: Path, content: bytes) -> None:
        path = tmp_path / "x.npz"
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"x\.npz: ") as caught:
            load_library(path)
        assert not PYTHON.search(str(caught.value))

    def test_a_damaged_archive_is_told_without_a_word_of_python(self, saved: Path) -> None:
        data = bytearray(saved.read_bytes())
        third = len(data) // 3
        for damaged in (data[:third], data[:-30], data[:third] + bytes(2000) + data[third + 2000 :]):
            saved.write_bytes(damaged)
            with pytest.raises(InputError, match=r"damaged|not match|missing") as caught:
                load_library(saved)
            assert not PYTHON.search(str(caught.value))

    def test_single_array(self, tmp_path: Path) -> None:
        np.save(tmp_path / "x.npy", np.zeros(3))
        with pytest.raises(InputError, match="a single array, not an archive"):
            load_library(tmp_path / "x.npy")

    def test_pickle(self, saved: Path) -> None:
        with pytest.raises(InputError, match="pickled objects, which are never loaded"):
            load_library(rewritten(saved, hashed=False, command=np.array([{"a": 1}], dtype=object)))

    @pytest.mark.parametrize(
        ("name", "message"),
        [
            ("command", "array command is missing"),
            ("plant_Ce", "array plant_Ce is missing"),
            ("mu_end", "array mu_end is missing"),
            ("meta", "no array meta: not a library of this project"),
            (HASH_FIELD, f"no array {HASH_FIELD}: not a library of this project"),
        ],
    )
    def test_missing_array(self, saved: Path, name: str, message: str) -> None:
        with pytest.raises(InputError, match=message):
            load_library(rewritten(saved, drop=name))

    @pytest.mark.parametrize(
        ("name", "change", "message"),
        [
            ("plant_input", lambda x: x[:, :, :-1], r"plant_input has shape \(4, 3, 799\), expected \(4, 3, 800\)"),
            ("tap_error", np.ravel, "tap_error has 1 dimensions, expected 2"),
            ("command", lambda x: x.astype(int), "command has type int64, expected float"),
            ("command", lambda x: np.where(x == x.max(), np.nan, x), "command holds a number that is not finite"),
            ("speeds_m_s", lambda x: x[::-1], "speeds_m_s is empty or not strictly increasing"),
        ],
    )
    def test_an_array_that_cannot_be(
        self, saved: Path, library: Library, name: str, change: Callable[[FloatArray], FloatArray], message: str
    ) -> None:
        with pytest.raises(InputError, match=message):
            load_library(rewritten(saved, **{name: change(library.array(name))}))

    def test_a_floor_that_was_not_found_is_no_obstacle(self, saved: Path, library: Library) -> None:
        """The optimum without limits may stay unknown where those under the limits are proven."""
        unknown = library.floor.copy()
        unknown[0, 1] = np.nan
        again = load_library(rewritten(saved, floor=unknown))
        np.testing.assert_array_equal(again.floor, unknown)
        assert not any(entry.shortfalls for entry in verify_library(again))

    @pytest.mark.parametrize(("change", "words"), [*SCENES, *LACKING, *FORMS])
    def test_meta_that_cannot_be(
        self, saved: Path, library: Library, change: Callable[[Meta], Meta], words: str
    ) -> None:
        with pytest.raises(InputError, match=words) as caught:
            load_library(rewritten(saved, meta=np.array(json.dumps(change(library.meta)))))
        assert str(caught.value).startswith(f"{saved}: ")
        assert str(caught.value).isprintable()
        assert not PYTHON.search(str(caught.value))

    def test_a_delay_that_would_make_a_long_lost_start(self, saved: Path, library: Library) -> None:
        """L follows from the time axis; the arrays do not have it."""
        under(library, {"amplifier.delay_s": 0.05, "time.lead_s": 0.0}).save(saved)
        with pytest.raises(InputError, match=r"recorded_before_m_s2 has shape \(4, 3, 0\), expected \(4, 3, 500\)"):
            load_library(saved)

    def test_flipped_bytes(self, saved: Path, tmp_path: Path) -> None:
        whole = bytearray(saved.read_bytes())
        random = np.random.default_rng(4)
        broken = tmp_path / "broken.npz"
        data_end = zipfile.ZipFile(saved).start_dir
        for position in random.integers(0, data_end, 60):
            flipped = whole.copy()
            flipped[position] ^= 0x55
            broken.write_bytes(flipped)
            try:
                again = load_library(broken)
            except InputError:
                continue
            # Not every byte of a zip carries content (time stamps); what loads must be the same library.
            np.testing.assert_array_equal(again.command, load_library(saved).command)


class TestBlend:
    def test_nodes_are_returned_as_they_are(self, library: Library) -> None:
        waveform = library.at(0.3, 5.0)
        np.testing.assert_allclose(waveform.command, library.command[2, 2], atol=1e-15)
        assert not waveform.speed_clamped
        assert not waveform.grip_clamped

    def test_between_nodes_is_bilinear(self, library: Library) -> None:
        c = library.command
        expected = 0.75 * (0.5 * c[0, 0] + 0.5 * c[0, 1]) + 0.25 * (0.5 * c[1, 0] + 0.5 * c[1, 1])
        np.testing.assert_allclose(library.at(0.125, 2.0).command, expected, atol=1e-12)

    def test_outside_the_edge_is_taken_and_reported(self, library: Library) -> None:
        waveform = library.at(0.05, 9.0)
        np.testing.assert_array_equal(waveform.command, library.command[0, 2])
        assert (waveform.speed_m_s, waveform.grip_N) == (0.1, 5.0)
        assert waveform.speed_clamped
        assert waveform.grip_clamped

    def test_limits_survive_blending(self, library: Library) -> None:
        random = np.random.default_rng(6)
        for _ in range(50):
            grip = random.uniform(1, 5)
            command = library.at(random.uniform(0.1, 0.4), grip).command
            _, current = library.stage(0).rollout(command)
            assert np.abs(current).max() <= 4 + 1e-9
            assert np.abs(command).max() <= 6 + 1e-9

    def test_below_the_least_grip_nothing_is_played(self, library: Library) -> None:
        waveform = library.at(0.3, 0.4)
        assert waveform.silent
        assert not waveform.command.any()
        for speed in (0.0, -0.3):
            assert library.at(speed, 3.0).silent
            assert not library.at(speed, 3.0).command.any()
        edge = library.at(0.3, 0.5)
        assert not edge.silent
        np.testing.assert_array_equal(edge.command, library.command[2, 0])

    @pytest.mark.parametrize(("speed", "grip"), [(np.nan, 1.0), (0.2, np.inf)])
    def test_nonsense_is_refused(self, library: Library, speed: float, grip: float) -> None:
        with pytest.raises(InputError, match="must be a finite number"):
            library.at(speed, grip)

    def test_one_grip_and_one_speed_are_enough(self, library: Library) -> None:
        cut = {}
        for name, stated in ARRAYS.items():
            index = tuple(slice(1, 2) if letter in "vg" else slice(None) for letter in stated.letters(()))
            cut[name] = library.array(name)[index]
        small = Library.of(cut, library.meta)
        np.testing.assert_array_equal(small.at(0.9, 0.6).command, library.command[1, 1])
