"""Libraries of a nonlinear plant: from solve through verify to export, and nothing that is tampered with passes."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

import transopt as to
from tests.benches.actuators import LRA, integrated, nonlinear_scene
from tests.benches.commands import Terminal
from tests.benches.libraries import proven_again, under
from transopt.base.errors import InputError
from transopt.design.resolve import resolve
from transopt.library.library import Library
from transopt.library.posed import NONLINEAR_CLAIM
from transopt.library.proven import doubts
from transopt.plant.moving_coil import Inertial
from transopt.problem.answer import Status

DT_S, STAGES, AFTER = 2e-4, 80, 30
Tampered = Callable[[Library], Library]


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return to.solve(nonlinear_scene(tmp_path_factory.mktemp("nonlinear")))


def by_newton(command: np.ndarray) -> np.ndarray:
    """(K,) acceleration of the case at the switching instants, from the scene's own numbers."""
    return integrated(Inertial(**{**LRA, "L_H": 5e-4}), None, command, DT_S)


class TestRoundTrip:
    def test_solve_verify_show_export(self, tmp_path: Path, terminal: Terminal) -> None:
        out = tmp_path / "out"
        assert terminal("transopt", "solve", nonlinear_scene(tmp_path), "--out", out, "--no-figures").code == 0
        path = out / "library.npz"
        verified = terminal("transopt", "verify", path)
        assert verified.code == 0, verified.out
        assert "1 of 1 entries certified and replayed clean" in verified.out
        assert NONLINEAR_CLAIM in verified.out
        shown = terminal("transopt", "show", path, "--figure", out / "transients.png")
        assert shown.code == 0, shown.err
        assert "stationary" in shown.out
        assert (out / "transients.png").read_bytes().startswith(b"\x89PNG")
        compared = terminal("transopt", "compare", path, path)
        assert f"1 entry; A and B hold the same content; A and B: {NONLINEAR_CLAIM}" in " ".join(compared.out.split())
        for name in ("taps.wav", "taps.mat", "taps.csv"):
            assert terminal("transopt", "export", path, out / name).code == 0
        assert f"# {NONLINEAR_CLAIM}\n" in (out / "taps.csv").read_text()
        exported = terminal("transopt", "export", path, out / "click.h", "--drive")
        assert exported.code == 0, exported.err
        assert "transopt_drive_click" in (out / "click.h").read_text()
        assert terminal("transopt", "export", path, out / "click.wav", "--drive", "--bits", "float").code == 0
        _, samples = wavfile.read(out / "click.wav")
        command = to.load_library(path).command[0, 0]
        assert samples * 12.0 == pytest.approx(command, abs=1e-6 * 12.0)

    def test_a_drive_at_another_rate_is_played_on_the_nonlinear_plant(self, solved: Library, tmp_path: Path) -> None:
        own, twice = (
            to.export_drive(solved, tmp_path / "click.bin", rate_Hz=rate_Hz, bits="float")[1][0]
            for rate_Hz in (1 / DT_S, 2 / DT_S)
        )
        lasting = solved.lasting(0, 0)[0]
        size = np.abs(lasting).max()
        for played in (own, twice):
            assert played.acceleration_m_s2 == pytest.approx(lasting, abs=1e-5 * size)
            assert played.tap_error == pytest.approx(solved.tap_error[0, 0], rel=1e-4)
            assert not played.limits_left
        _, [halved] = to.export_drive(solved, tmp_path / "click.bin", rate_Hz=1e3, bits="float")
        expected = by_newton(np.repeat(halved.drive.values, 5))
        found = halved.acceleration_m_s2[: expected.size]
        assert found == pytest.approx(expected[: found.size], abs=1e-5 * np.abs(expected).max())


class TestLibrary:
    def test_is_a_stationary_point_with_the_linear_design_beside_it(self, solved: Library, tmp_path: Path) -> None:
        assert solved.nonlinear
        assert solved.status[0, 0] == Status.STATIONARY.value
        assert solved.tap_error[0, 0] <= 0.5 * solved.tap_error_linear[0, 0]
        assert solved.tap_error_promised[0, 0] < solved.tap_error_linear[0, 0]
        assert not solved.lower_bound.any()
        assert "nonlinear plant, stationary points" in " ".join(repr(solved).split())
        assert proven_again(solved, tmp_path).scene().nonlinear

    def test_acceleration_is_that_of_the_equations_of_motion(self, solved: Library) -> None:
        lasting = by_newton(np.append(solved.command[0, 0], np.zeros(AFTER)))
        size = np.abs(lasting).max()
        assert solved.acceleration_m_s2[0, 0] == pytest.approx(lasting[:STAGES], abs=1e-6 * size)
        assert solved.lasting(0, 0)[0] == pytest.approx(lasting, abs=1e-6 * size)
        error = lasting[:STAGES] - solved.target_m_s2[0, 0]
        assert solved.tap_error[0, 0] == pytest.approx(
            np.linalg.norm(error) / np.linalg.norm(solved.target_m_s2[0, 0]), rel=1e-5
        )
        linear = by_newton(solved.linear_command[0, 0]) - solved.target_m_s2[0, 0]
        assert solved.tap_error_linear[0, 0] == pytest.approx(
            np.linalg.norm(linear) / np.linalg.norm(solved.target_m_s2[0, 0]), rel=1e-5
        )

    @pytest.mark.parametrize(
        ("what", "said"),
        [
            (lambda library: replace(library, command=0.9999 * library.command), "no stationary point"),
            (lambda library: replace(library, command=-library.command), "no stationary point"),
            (lambda library: replace(library, tap_error=0.5 * library.tap_error), "tap_error says"),
            (
                lambda library: replace(library, tap_error_linear=2 * library.tap_error_linear),
                "tap_error_linear says",
            ),
            (
                lambda library: replace(library, linear_command=0.9 * library.linear_command),
                "tap_error_promised says",
            ),
        ],
        ids=["perturbed command", "flipped sign", "tap error", "error of the linear design", "linear command"],
    )
    def test_what_was_tampered_with_falls_short(
        self, solved: Library, tmp_path: Path, what: Tampered, said: str
    ) -> None:
        what(solved).save(tmp_path / "library.npz")
        [check] = to.verify(to.load_library(tmp_path / "library.npz"))
        assert any(said in each for each in check.shortfalls)

    @pytest.mark.parametrize(
        ("what", "said"),
        [
            (lambda library: replace(library, status=np.array([["optimal"]])), "its status is: optimal"),
            (lambda library: replace(library, lower_bound=library.lower_bound + 0.9), "lower_bound says"),
            (lambda library: replace(library, acceleration_m_s2=1.001 * library.acceleration_m_s2), "is off by"),
            (lambda library: replace(library, mu_end=library.mu_end + 1e-3), "no stationary point"),
            (lambda library: under(library, {"model.nonlinear": None}), "not certified: a limit is violated"),
            (lambda library: under(library, {"model.nonlinear.force_factor": "BL"}), "not certified: "),
            (lambda library: replace(library, substeps=library.substeps + 0.5), "must be a whole number"),
            (lambda library: replace(library, substeps=0 * library.substeps), "must be a whole number from 1 to 32"),
        ],
        ids=["status", "bound", "prediction", "multiplier", "linear", "formula", "half a step", "no step"],
    )
    def test_what_does_not_follow_is_doubted(self, solved: Library, what: Tampered, said: str) -> None:
        assert said in next(doubts(what(solved)))

    def test_steps_that_no_design_takes_are_refused_when_it_is_read(self, solved: Library, tmp_path: Path) -> None:
        replace(solved, substeps=solved.substeps + 100).save(tmp_path / "library.npz")
        with pytest.raises(InputError, match=r"substeps = .*: must be a whole number from 1 to 32"):
            to.load_library(tmp_path / "library.npz")

    def test_what_takes_linear_plants_alone_refuses_it(self, solved: Library, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="online: this library's plant is nonlinear"):
            to.Online(solved)
        with pytest.raises(InputError, match="refine: this library's plant is nonlinear"):
            resolve(solved, {}, {})
        with pytest.raises(InputError, match="grid_tolerance are for speeds"):
            to.solve(nonlinear_scene(tmp_path), grid_tolerance=0.02)

    def test_solve_says_what_is_not_proven(self, tmp_path: Path) -> None:
        with pytest.raises(
            InputError, match=r"1 of 1 entries refused, the first at click: IPOPT: .*transopt\.build returns all"
        ):
            to.solve(nonlinear_scene(tmp_path), options=to.SolverOptions(max_iterations=2))


def test_what_has_no_motion_has_no_error(tmp_path: Path) -> None:
    """BL(x) is not defined beyond 0.605 mm, where the seed's clipped inversion takes the mass."""
    swap = ("BL*(1 - 0.3*(x/0.6e-3)**2)", "BL*sqrt(1 - (x/0.605e-3)**2)")
    built = to.build(nonlinear_scene(tmp_path, swap))
    [[entry]] = built.entries
    assert np.isnan([entry.baselines.seed.tap_error, entry.baselines.seed_steady.tap_error]).all()
    proven_again(built.library, tmp_path)
