"""Limits on the motion where one command serves a spread of devices: each device keeps them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate

import problems
from tests.benches import dense
from tests.benches.libraries import proven_again, rewritten
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.build import Build, build_library
from transopt.design.entry import Entry
from transopt.design.optimum import optimum
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.library.online import Online
from transopt.plant.discretise import StageModel
from transopt.problem.answer import OBJECTIVE_SCALE, Status
from transopt.problem.limits.output import OutputLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify
from transopt.recordings.recording import Recording
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions

SHORT = {"time.stages": 150, "grid.grips_N": [3.0], "robust": {"grip_spread": 0.4, "samples": 4}}
STROKE_M = 2.7e-3


@pytest.fixture(scope="module")
def build(scene: Scene, taps: list[Recording]) -> Build:
    return build_library(with_values(scene, {**SHORT, "limits.stroke_m": STROKE_M}), taps)


@pytest.fixture(scope="module")
def entry(build: Build) -> Entry:
    """The fastest tap, whose stroke binds on another device than its own."""
    return build.entries[-1][0]


@pytest.fixture(scope="module")
def library(build: Build) -> Library:
    assert build.library is not None
    return build.library


def positions_m(
    problem: TransientProblem, device: StageModel, command: FloatArray, nominal: FloatArray
) -> FloatArray:
    """|z| at nine instants of every period by DOP853: held commands, a straight nominal motion."""
    plant, amplifier, dt = device.plant, device.amplifier, problem.grid.dt_s
    w, x, n = amplifier.rate_rad_s, np.zeros(plant.order + 1), plant.order
    found = []
    for k, held in enumerate(command):

        def flow(_: float, x: FloatArray, held: float = held) -> FloatArray:
            return np.append(plant.A @ x[:n] + plant.B[:, 0] * x[n], w * (held - x[n]))

        at = np.linspace(0, dt, 9)
        run = integrate.solve_ivp(flow, (0, dt), x, method="DOP853", t_eval=at, rtol=1e-9, atol=1e-12)
        straight = nominal[k] + (nominal[k + 1] - nominal[k]) * at / dt
        found.append(np.abs(plant.Ce[0] @ run.y[:n] + straight))
        x = run.y[:, -1]
    return np.concatenate(found)


def test_the_optimum_is_that_of_a_dense_solve_with_the_rows_of_every_device(entry: Entry) -> None:
    problem, limit = entry.problem, entry.problem.limits["stroke"]
    assert entry.status is Status.OPTIMAL, entry.shortfalls
    assert isinstance(limit, OutputLimit)
    rows, lower, upper = [], [], []
    for j, device in enumerate(problem.devices):
        room = STROKE_M - limit.margin(j)
        rows.append(dense.responses(problem, device).position[1:])
        lower.append(-room - limit.nominal[1:])
        upper.append(room - limit.nominal[1:])
    _, J = dense.optimum(problem, *(np.concatenate(each) for each in (rows, lower, upper)))
    assert entry.certificate.objective == pytest.approx(J, abs=1e-6 * max(J, OBJECTIVE_SCALE))
    assert "of the spread" in entry.binding


def test_every_device_keeps_it_at_all_times(entry: Entry) -> None:
    problem, limit = entry.problem, entry.problem.limits["stroke"]
    assert isinstance(limit, OutputLimit)
    peaks = [positions_m(problem, d, entry.solution.command, limit.nominal).max() for d in problem.devices]
    assert max(peaks) <= STROKE_M
    assert max(peaks) > 0.99 * STROKE_M
    assert np.argmax(peaks) > 0
    # The replay follows them all, by a simulation of its own.
    assert entry.played.peak(limit) == pytest.approx(max(peaks), rel=1e-3)


def test_the_limit_of_the_own_device_alone_would_be_left_by_another(entry: Entry) -> None:
    problem, limit = entry.problem, entry.problem.limits["stroke"]
    assert isinstance(limit, OutputLimit)
    alone = optimum(problem.alone(), SolverOptions()).solution.command
    assert max(positions_m(problem, d, alone, limit.nominal).max() for d in problem.devices) > 1.005 * STROKE_M
    assert not certify(problem, alone, entry.solution.multipliers).accepted


def test_what_a_device_bears_is_part_of_the_proof(entry: Entry) -> None:
    problem, multipliers = entry.problem, entry.solution.multipliers
    (row,) = (name for name in multipliers.pairs if "_device_" in name and multipliers.lower(name).max() > 1e-6)
    nothing = np.zeros(problem.grid.stages)
    assert certify(problem, entry.solution.command, multipliers).accepted
    without = multipliers.with_pair(row, nothing, nothing)
    assert not certify(problem, entry.solution.command, without).accepted


@pytest.mark.parametrize("solver", ["casadi-piqp", "casadi-ipopt"])
def test_other_methods_find_the_same(entry: Entry, solver: str) -> None:
    other = optimum(entry.problem, SolverOptions(solver))
    assert certify(entry.problem, other.solution.command, other.solution.multipliers).accepted
    assert other.certificate.objective == pytest.approx(entry.certificate.objective, rel=1e-6)


@pytest.mark.parametrize(
    ("limits", "name"),
    [({"limits.velocity_m_s": 0.405}, "velocity"), ({"limits.supply_V": 8.0}, "supply")],
)
def test_other_limits_on_the_motion_hold_for_every_device_too(
    scene: Scene, taps: list[Recording], limits: dict[str, float], name: str
) -> None:
    found = build_library(with_values(scene, {**SHORT, **limits}), taps).entries[-1][0]
    assert found.status is Status.OPTIMAL, found.shortfalls
    devices = {row.device for limit, row in found.problem.rows() if limit.name == name}
    assert devices == {0, 1, 2, 3, 4}
    assert name in found.binding
    bound = found.problem.limits[name]
    assert found.played.peak(bound) <= bound.stated + bound.replay_tolerance


SPEED = "to.own_limit('speed', 'm/s', lambda s: s.velocity, lower=-0.405, upper=0.405)"
AREA = "to.own_limit('area', '1', lambda s: (s.current / 4) ** 2 + (s.velocity / 0.5) ** 2, upper=1.0)"


@pytest.mark.parametrize(("limit", "name", "most"), [(SPEED, "speed", 0.405), (AREA, "area", 1.0)])
def test_a_limit_of_a_users_own_on_the_motion_holds_for_every_device(
    tmp_path: Path, taps: list[Recording], limit: str, name: str, most: float
) -> None:
    (tmp_path / "my_limits.py").write_text(f"import transopt as to\nLIMITS = [{limit}]\n")
    text = problems.scene_path("wood_on_foam").read_text(encoding="utf-8")
    text = text.replace("[limits]", '[limits]\nown = ["my_limits.py"]').replace("[1.0, 3.0, 5.0]", "[3.0]")
    text = text.replace("stages = 800", "stages = 150") + "\n[robust]\ngrip_spread = 0.4\nsamples = 4\n"
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    entry = build_library(problems.load(tmp_path / "mine.toml"), taps).entries[-1][0]
    assert entry.status is Status.OPTIMAL, entry.shortfalls
    rows, command = [row for own, row in entry.problem.rows() if own.name == name], entry.solution.command
    assert [row.device for row in rows] == [0, 1, 2, 3, 4]
    values = [row.value(entry.problem.devices[row.device].motion(command), command) for row in rows]
    assert max(np.abs(value).max() for value in values) == pytest.approx(most, rel=1e-5)
    assert np.argmax([np.abs(value).max() for value in values]) > 0
    assert f"{name} {'-' if name == 'speed' else ''}{most:g}" in entry.binding


class TestLibrary:
    def test_is_saved_and_verified(self, library: Library, tmp_path: Path) -> None:
        read = proven_again(library, tmp_path)
        assert read.multipliers_of["mu_stroke_device_4_upper"].shape == read.command.shape

    @pytest.mark.parametrize("how", ["gone", "short", "not finite"])
    def test_multipliers_that_are_none_are_refused(self, library: Library, tmp_path: Path, how: str) -> None:
        name, multipliers = "mu_stroke_device_2_lower", dict(library.multipliers_of)
        multipliers[name] = {
            "short": library.array(name)[..., 1:],
            "not finite": np.full_like(library.array(name), np.nan),
        }.get(how, library.array(name))
        path = tmp_path / "library.npz"
        replace(library, multipliers_of=multipliers).save(path)
        if how == "gone":
            rewritten(path, drop=name)
        with pytest.raises(InputError, match=name):
            load_library(path)

    @pytest.mark.skipif(not extension.available, reason="the extension is not built")
    def test_online_keeps_it_on_every_device(self, library: Library) -> None:
        tap = Online(library).solve(0.38, 3.0, limits={"stroke_m": 2.75e-3})
        assert tap.certificate is not None, tap.remark
        assert tap.certificate.accepted


def test_what_all_devices_share_has_one_row(scene: Scene, taps: list[Recording]) -> None:
    made = build_library(with_values(scene, SHORT), taps)
    assert {row.device for _, row in made.entries[0][0].problem.rows()} == {0}
    assert not [name for name in made.library.arrays() if "_device_" in name]


COIL = "to.own_limit('coil_current', 'A', lambda s: s.current, lower=-0.25, upper=0.25)"


def test_the_current_of_a_coil_that_a_voltage_drives_is_each_devices_own(tmp_path: Path) -> None:
    (tmp_path / "my_limits.py").write_text(f"import transopt as to\nLIMITS = [{COIL}]\n")
    text = problems.scene_path("lra_click").read_text(encoding="utf-8")
    text = text.replace("[limits]", '[limits]\nown = ["my_limits.py"]\ncurrent_A = 0.3')
    text = text.replace("stages = 2880", "stages = 400").replace("2.0833333333333333e-05", "1e-4")
    text = text.replace("dt_s = 2.0833333333333333e-5 ", "dt_s = 1e-4 ")
    text += "\n[robust]\nresonance_spread = 0.04\nsamples = 2\n"
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    scene = problems.load(tmp_path / "mine.toml")
    made = build_library(scene, [])
    entry = made.entries[0][0]
    assert entry.status is Status.OPTIMAL, entry.shortfalls
    devices = len(entry.problem.devices)
    for name in ("coil_current", "current", "stroke"):
        found = [row.device for limit, row in entry.problem.rows() if limit.name == name]
        each = entry.problem.parts.get(name, 1)
        assert found == [device for device in range(devices) for _ in range(each)], name
    proven_again(made.library, tmp_path)
