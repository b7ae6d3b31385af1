"""Exports: what a reader of each format gets is what stands in the library."""

import itertools
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import loadmat, wavfile

import transopt as to
from tests.benches.actuators import clicks
from tests.benches.libraries import resized, under
from transopt.base.errors import InputError
from transopt.library.export import export_library
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.problem.baselines import seed_inversion
from transopt.scene.keys import with_values

DT_S, LEAD_S = 1e-4, 3e-4
AMPLIFIER = {"pole_Hz": 1050.0, "delay_s": 68e-6, "command_limit_A": 6.0}
EPSILON = 2.0**-24  # relative rounding of one single-precision operation
COMPILERS = {"gcc": ["-std=c99", "-x", "c"], "g++": ["-std=c++11", "-x", "c++"]}
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]


Make = Callable[..., Library]


@pytest.fixture
def make_library(library: Library) -> Make:
    """The solved library on other nodes."""

    def make(
        speeds: Sequence[float] = (0.1, 0.3),
        grips: Sequence[float] = (1.0, 4.0),
        amplifier: dict[str, float] | None = AMPLIFIER,
        name: str = "wood",
    ) -> Library:
        stated = {"name": name, "amplifier": "ideal" if amplifier is None else amplifier, "time.lead_s": LEAD_S}
        sized = under(resized(library, len(speeds), len(grips)), stated)
        meta = {**sized.meta, "left_out": {"temperature": "it is cold"}}
        return replace(sized, speeds_m_s=np.array(speeds), grips_N=np.array(grips), meta=meta)

    return make


def content_hash(library: Library, folder: Path) -> str:
    """Give the content hash as it stands in library.npz."""
    library.save(folder / "hash.npz")
    with np.load(folder / "hash.npz") as file:
        return str(file["content_sha256"])


# --- writing -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["taps.txt", "taps", ".h", "taps.h.gz"])
def test_an_unknown_suffix_is_refused_with_the_four_that_are_known(
    make_library: Make, tmp_path: Path, name: str
) -> None:
    with pytest.raises(InputError) as caught:
        export_library(make_library(), tmp_path / name)
    message = str(caught.value)
    assert "\n" not in message
    assert all(suffix in message for suffix in (name, ".mat", ".csv", ".wav", ".h"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".mat", ".CSV", ".Wav", ".H"])
def test_a_file_is_written_whole_or_not_at_all(
    make_library: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    library, path = make_library(), tmp_path / f"taps{suffix}"
    path.write_text("old")

    def full(source: object, target: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", full)
        with pytest.raises(InputError, match=re.escape(f"{path}: cannot be written (No space left on device); ")):
            export_library(library, path)
    assert path.read_text() == "old"
    export_library(library, path)
    assert path.stat().st_size > 1000
    assert [found.name for found in tmp_path.iterdir()] == [path.name]


def test_no_folder_or_a_folder_in_the_way(make_library: Make, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no folder .*missing: create it, or choose another"):
        export_library(make_library(), tmp_path / "missing" / "taps.h")
    (tmp_path / "taps.h").mkdir()
    with pytest.raises(InputError, match=r"\(a folder, a pipe or a device is there\); choose another"):
        export_library(make_library(), tmp_path / "taps.h")
    assert [path.name for path in tmp_path.iterdir()] == ["taps.h"]


# --- MAT -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("slew_A_per_s", "grips"), [(None, (1.0, 4.0)), (2e4, (1.0, 4.0)), (None, (3.0,))])
def test_mat_holds_every_array_of_the_file_under_its_name(
    make_library: Make, tmp_path: Path, slew_A_per_s: float | None, grips: tuple[float, ...]
) -> None:
    library = under(make_library(grips=grips), {"limits.slew_A_per_s": slew_A_per_s})
    export_library(library, tmp_path / "taps.mat")
    library.save(tmp_path / "library.npz")
    load_library(tmp_path / "library.npz")  # accepts the synthetic library
    read = loadmat(tmp_path / "taps.mat")
    with np.load(tmp_path / "library.npz") as stored:
        assert {name for name in read if not name.startswith("__")} == set(stored.files)
        # Names longer than 31 characters would be cut by old readers.
        assert max(map(len, stored.files)) <= 31
        assert read["content_sha256"].item() == str(stored["content_sha256"])
        assert json.loads(read["meta"].item()) == library.meta
        for name in set(stored.files) - {"meta", "content_sha256"}:
            wanted = stored[name]
            if wanted.dtype.kind == "U":
                texts = [str(cell.item()) if cell.size else "" for cell in read[name].ravel()]
                assert (read[name].shape, texts) == (wanted.shape, wanted.ravel().tolist())
            else:
                np.testing.assert_array_equal(read[name], np.atleast_2d(wanted), err_msg=name, strict=True)


# --- CSV -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("amplifier", [AMPLIFIER, None])
def test_csv_reads_back_to_the_last_digit(
    make_library: Make, tmp_path: Path, amplifier: dict[str, float] | None
) -> None:
    library = make_library((0.1, 0.2, 0.3), amplifier=amplifier, name="Härte 1,2,3")  # must not break a comment
    export_library(library, tmp_path / "taps.csv")
    lines = (tmp_path / "taps.csv").read_text().splitlines()
    comments = list(itertools.takewhile(lambda line: line.startswith("# "), lines))
    assert content_hash(library, tmp_path) in comments[0]
    stated = {key: float(value) for key, _, value in (line[2:].partition(": ") for line in comments[-3:])}
    assert stated == {"dt_s": DT_S, "lead_s": LEAD_S, "delay_s": 0.0 if amplifier is None else 68e-6}

    names = lines[len(comments)].split(",")
    table = np.loadtxt(lines[len(comments) + 1 :], delimiter=",")
    nv, ng, N = library.command.shape
    assert table.shape == (nv * ng * N, len(names))
    columns = dict(zip(names, table.T.reshape(len(names), nv, ng, N), strict=True))
    for name, array in (
        ("command_A", "command"),
        ("transient_command_A", "transient_command"),
        ("current_A", "plant_input"),
        *((f"{name}_m_s2", f"{name}_m_s2") for name in ("acceleration", "recorded", "free", "target")),
    ):
        np.testing.assert_array_equal(columns.pop(name), library.array(array), err_msg=name)
    grid = library.time_grid()
    wanted = {
        "speed_m_s": library.speeds_m_s[:, None, None],
        "grip_N": library.grips_N[:, None],
        "k": np.arange(N),
        "issue_time_s": grid.issue_times_s,
        "switching_time_s": grid.switching_times_s,
    }
    assert columns.keys() == wanted.keys()
    for name, values in wanted.items():
        np.testing.assert_array_equal(columns[name], np.broadcast_to(values, (nv, ng, N)), err_msg=name)


# --- WAV -----------------------------------------------------------------------------------------------------


def sounds(path: Path, library: Library) -> NDArray[np.float64]:
    """(nv, ng, 3, samples) recorded, inversion, optimum with the silence after each, in counts."""
    rate, data = wavfile.read(path)
    assert (rate, str(data.dtype), data.ndim) == (48000, "int16", 1)
    nv, ng, N = library.command.shape
    return np.asarray(data, dtype=float).reshape(nv, ng, 3, round((N * DT_S + 0.3) * 48000))


def test_wav_plays_recorded_inversion_optimum_on_one_scale(make_library: Make, tmp_path: Path) -> None:
    library = make_library()
    r, free = library.recorded_m_s2, library.free_m_s2
    # An optimum that is smooth and differs by grip, so that order and loudness of all sounds are seen.
    library = replace(library, acceleration_m_s2=r * np.array([0.5, 2.0])[:, None] - free)
    export_library(library, tmp_path / "taps.wav")
    heard = sounds(tmp_path / "taps.wav", library)
    assert np.abs(heard).max() == round(10 ** (-1 / 20) * 32767)
    N = r.shape[2]
    # The resampling filter rings for 1 ms into the silences before and after a sound.
    assert not heard[..., round((N * DT_S + 2e-3) * 48000) : -round(2e-3 * 48000)].any()

    inversion = np.empty_like(library.command)
    for iv, ig in np.ndindex(2, 2):
        target = r[iv, ig] - free[iv, ig]
        c = seed_inversion(library.stage(ig), library.time_grid(), target, 4.0, library.hand_over_samples)
        inversion[iv, ig] = library.stage(ig).rollout(c)[0]
    wanted = np.stack([r, inversion + free, library.acceleration_m_s2 + free], axis=2)
    # 10 kHz and 48 kHz meet every 5 and 24 samples, where a band-limited signal keeps its value.
    meeting = heard[..., : round(N * 4.8) : 24]
    counts_per_m_s2 = np.abs(heard).max() / np.abs(wanted).max()
    np.testing.assert_allclose(meeting / counts_per_m_s2, wanted[..., ::5], atol=0.02 * np.abs(wanted).max())


@pytest.mark.parametrize("grips", [(3.0,), (1.0, 4.0)])
def test_wav_of_a_zero_library_is_silence(make_library: Make, tmp_path: Path, grips: tuple[float, ...]) -> None:
    library = make_library((0.2,), grips)
    silent = {name: 0.0 * getattr(library, name) for name in ("recorded_m_s2", "free_m_s2", "acceleration_m_s2")}
    library = replace(library, **silent)
    export_library(library, tmp_path / "taps.wav")
    assert not sounds(tmp_path / "taps.wav", library).any()


# --- C header ------------------------------------------------------------------------------------------------

Grid = tuple[tuple[float, ...], tuple[float, ...]]
GRIDS: list[Grid] = [
    ((0.1, 0.3), (1.0, 4.0)),
    ((0.1, 0.25, 0.3, 0.45), (0.5, 1.0, 4.0)),
    ((0.2,), (3.0,)),
    ((0.1, 0.3), (2.0,)),
    ((0.2,), (1.0, 4.0)),
    ((0.1, 0.3), (0.0,)),  # the free device
]
PROGRAM = """\
#include "taps.h"
#include "taps.h"
#include <stdio.h>
int32_t samples_in_other_unit(void);
int main(void)
{
    float speed, grip;
    int k;
    if (samples_in_other_unit() != TRANSOPT_SAMPLES) return 1;
    printf("%.9g\\n", (double)TRANSOPT_SCALE_A);
    while (scanf("%f %f %d", &speed, &grip, &k) == 3)
        printf("%.9g\\n", (double)transopt_command(speed, grip, (int32_t)k));
    return 0;
}
"""
OTHER_UNIT = """\
#include "taps.h"
int32_t samples_in_other_unit(void);
int32_t samples_in_other_unit(void) { return TRANSOPT_SAMPLES; }
"""


@pytest.fixture
def compiler(request: pytest.FixtureRequest) -> list[str]:
    """C, or where a test asks for it C++."""
    name = str(getattr(request, "param", "gcc"))
    if shutil.which(name) is None:
        pytest.skip(f"no {name} on this machine")
    return [name, "-O2", *WARNINGS, *COMPILERS[name]]


def run_header(
    library: Library,
    compiler: list[str],
    folder: Path,
    points: Sequence[tuple[float, float, int]],
    *,
    second: bool = False,
) -> tuple[float, NDArray[np.float64]]:
    """Amperes per count, and the commands [A] at (speed, grip, k) that the compiled header returns."""
    program = PROGRAM
    if second:
        program = program.replace("_SCALE_A", "_COOL_SCALE_A").replace("transopt_command", "transopt_cool_command")
    export_library(library, folder / "taps.h")
    (folder / "main.c").write_text(program)
    (folder / "other.c").write_text(OTHER_UNIT)  # a second translation unit, which never calls the function
    build = [*compiler, "main.c", "other.c", "-o", "program"]
    built = subprocess.run(build, cwd=folder, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    text = "".join(f"{speed!r} {grip!r} {k}\n" for speed, grip, k in points)
    ran = subprocess.run([folder / "program"], input=text, capture_output=True, text=True, check=True)
    scale, *commands = map(float, ran.stdout.split())
    assert len(commands) == len(points)
    return scale, np.array(commands)


def random_points(library: Library, count: int = 400) -> list[tuple[float, float, int]]:
    """On, between and beyond the nodes, below the least grip; exact in single precision."""
    rng = np.random.default_rng(2)
    v, g, N = library.speeds_m_s, library.grips_N, library.command.shape[2]
    speeds = np.concatenate([rng.uniform(-0.2, 1.5 * v[-1], count), rng.choice(v, count // 4)])
    grips = np.concatenate([rng.uniform(-0.5, 1.5 * g[-1] + 1, count), rng.choice(g, count // 4)])
    k = rng.integers(-3, N + 3, speeds.size)
    single = (speeds.astype(np.float32).tolist(), grips.astype(np.float32).tolist(), k.tolist())
    return list(zip(*single, strict=True))


def expected(library: Library, points: Sequence[tuple[float, float, int]]) -> NDArray[np.float64]:
    N, held = library.command.shape[2], library.grips_N[0] > 0
    silent = library.grip_min_N if held else -np.inf
    return np.array([library.at(v, g).command[k] if 0 <= k < N and g >= silent else 0.0 for v, g, k in points])


def tolerance_A(library: Library, scale_A: float) -> float:
    """Half a count, plus single-precision rounding.

    A blend has at most 16 rounded operations on values up to twice the peak. Rounding nodes and x moves a
    weight by a few epsilon times x over the spacing, and a weight moves the command by up to twice the peak.
    """
    axes = [nodes for nodes in (library.speeds_m_s, library.grips_N) if nodes.size > 1]
    spans = [float(4 * (nodes[-1] + 1) / np.diff(nodes).min()) for nodes in axes]
    peak = float(np.abs(library.command).max())
    return scale_A / 2 + EPSILON * 2 * peak * (16 + sum(spans))


@pytest.mark.parametrize(
    ("compiler", "case"),
    [*(("gcc", case) for case in GRIDS), ("g++", GRIDS[0])],
    ids=str,
    indirect=["compiler"],
)
def test_header_agrees_with_the_library_to_half_a_count(
    case: Grid, compiler: list[str], make_library: Make, tmp_path: Path
) -> None:
    library = make_library(*case)
    points = random_points(library)
    scale, commands = run_header(library, compiler, tmp_path, points)
    assert scale == pytest.approx(np.abs(library.command).max() / 32767, rel=1e-6)
    wanted = expected(library, points)
    assert np.count_nonzero(wanted) > 100
    assert np.abs(commands - wanted).max() <= tolerance_A(library, scale)
    np.testing.assert_array_equal(commands[wanted == 0], 0.0)


@pytest.mark.parametrize("grips", [(1.0, 4.0), (3.0,), (0.0,)])
def test_header_is_silent_for_nan_and_outside_the_waveform(
    grips: tuple[float, ...], compiler: list[str], make_library: Make, tmp_path: Path
) -> None:
    library = make_library(grips=grips)
    nan, g, N = np.nan, grips[-1], library.command.shape[2]
    silent = [(nan, g, 5), (0.2, nan, 5), (nan, nan, 5)]
    silent += [(0.2, g, k) for k in (-(2**31), -1, N, 2**31 - 1)]
    if grips[0] > 0:
        silent += [(0.2, 0.4999, 5), (0.2, -1.0, 5), (0.2, -np.inf, 5)]
    playing = [(np.inf, g, 5), (-np.inf, g, 5), (0.2, np.inf, 5), (0.0, g, 5), (-1.0, g, 5), (0.2, max(0.5, g), 0)]
    if grips[0] == 0:
        playing += [(0.2, -0.01, 5)]  # an unloaded sensor's offset
    _, commands = run_header(library, compiler, tmp_path, silent + playing)
    np.testing.assert_array_equal(commands[: len(silent)], 0.0)
    # Library.at takes no infinite values; 9 m/s and 9 N lie just as well beyond the grid.
    edges = [(float(np.clip(v, -9, 9)), float(np.clip(grip, -9, 9)), k) for v, grip, k in playing]
    np.testing.assert_allclose(commands[len(silent) :], expected(library, edges), atol=1e-4)


@pytest.mark.parametrize("amplifier", [AMPLIFIER | {"command_limit_A": 1.5}, None], ids=["amplifier", "ideal"])
def test_header_plays_the_transient_clamped_to_the_command_limit(
    amplifier: dict[str, float] | None, compiler: list[str], make_library: Make, tmp_path: Path
) -> None:
    # An ideal amplifier's command is the current.
    limited = {"limits.beta": None, "limits.current_A": 4.0 if amplifier else 1.5}
    library = under(make_library(amplifier=amplifier), {"feedback": {"stiffness_N_m": 1000.0}, **limited})
    library = replace(library, transient_command=40 * library.command)
    points = random_points(library)
    scale, commands = run_header(library, compiler, tmp_path, points)
    wanted = np.clip(40 * expected(library, points), -1.5, 1.5)
    assert np.abs(commands - wanted).max() <= tolerance_A(library, scale)
    assert {-1.5, 1.5} <= set(commands)


def test_second_commands_leave_in_every_format(compiler: list[str], tmp_path: Path) -> None:
    small = {"grid.speeds_m_s": [0.2, 0.4], "grid.grips_N": [1.0, 5.0], "time.stages": 200, "grid.cool_share": 0.4}
    library = to.solve(with_values(to.load_scene("wood_on_foam"), small))
    cool = library.cool
    for second, of in ((False, library), (True, cool)):
        points = random_points(of)
        scale, commands = run_header(library, compiler, tmp_path, points, second=second)
        assert np.abs(commands - expected(of, points)).max() <= tolerance_A(of, scale)
    export_library(library, tmp_path / "library.csv")
    lines = [line for line in (tmp_path / "library.csv").read_text().splitlines() if not line.startswith("#")]
    rows = np.genfromtxt(lines, delimiter=",", names=True)
    np.testing.assert_array_equal(rows["cool_command_A"], cool.command.ravel())
    export_library(library, tmp_path / "library.mat")
    found = loadmat(tmp_path / "library.mat")
    np.testing.assert_array_equal(found["cool_command"], cool.command)
    assert found["cool_status"].ravel()[0].item() == "optimal"


def test_header_of_named_targets_plays_each_by_its_number(compiler: list[str], tmp_path: Path) -> None:
    library = clicks()
    targets, N = library.command.shape[0], library.command.shape[2]
    export_library(library, tmp_path / "taps.h")
    program = PROGRAM.replace("float speed, grip;", "int target;").replace("SCALE_A", "SCALE_V")
    program = program.replace("%f %f %d", "%d %d").replace("&speed, &grip", "&target")
    (tmp_path / "main.c").write_text(program.replace("(speed, grip,", "((int32_t)target,").replace("== 3", "== 2"))
    (tmp_path / "other.c").write_text(OTHER_UNIT)
    subprocess.run([*compiler, "main.c", "other.c", "-o", "program"], cwd=tmp_path, check=True)
    asked = list(itertools.product(range(-1, targets + 1), range(-1, N + 1)))
    text = "".join(f"{target} {k}\n" for target, k in asked)
    ran = subprocess.run([tmp_path / "program"], input=text, capture_output=True, text=True, check=True)
    scale, *found = map(float, ran.stdout.split())
    wanted = np.pad(library.command[:, 0], 1)
    assert np.abs(np.reshape(found, wanted.shape) - wanted).max() <= scale / 2 * (1 + 1e-3)


def test_header_of_a_zero_library_is_silent(compiler: list[str], make_library: Make, tmp_path: Path) -> None:
    library = make_library()
    library = replace(library, transient_command=np.zeros_like(library.command))
    scale, commands = run_header(library, compiler, tmp_path, random_points(library))
    assert not np.any([scale, *commands])


@pytest.mark.parametrize("compiler", COMPILERS, indirect=True)
def test_header_survives_any_scene_name_and_says_what_it_is(
    compiler: list[str], make_library: Make, tmp_path: Path
) -> None:
    library = make_library(name="a ;) #error Härte @")
    run_header(library, compiler, tmp_path, [])
    text = (tmp_path / "taps.h").read_text(encoding="ascii")
    comment = text.partition("*/")[0]
    assert content_hash(library, tmp_path) in comment
    assert f"transopt {library.meta['versions']['transopt']}" in comment
    assert re.findall(r"#include.*", text) == ["#include <stdint.h>"]


def test_headers_of_two_libraries_collide_instead_of_hiding_each_other(
    compiler: list[str], make_library: Make, tmp_path: Path
) -> None:
    export_library(make_library(), tmp_path / "held.h")
    export_library(make_library(grips=(0.0,)), tmp_path / "free.h")
    (tmp_path / "main.c").write_text('#include "held.h"\n#include "free.h"\n')
    built = subprocess.run([*compiler, "-c", "main.c"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert built.returncode != 0
    assert "redefin" in built.stderr


def test_header_refuses_nodes_that_single_precision_cannot_tell_apart(make_library: Make, tmp_path: Path) -> None:
    library = make_library(speeds=(0.1, 0.1 + 1e-10))
    with pytest.raises(InputError, match=r"speeds_m_s: 0\.1\d* and 0\.1\d* are the same number in single precision"):
        export_library(library, tmp_path / "taps.h")
    assert not list(tmp_path.iterdir())
