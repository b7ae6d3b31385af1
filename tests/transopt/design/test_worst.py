"""The worst of a spread of devices made least: against an interior point on the dense epigraph; its certificate."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from tests.benches import dense
from tests.benches.libraries import proven_again
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.build import Build, build_library
from transopt.design.context import Context, wanted_of
from transopt.design.optimum import optimum
from transopt.design.worst import least_worst
from transopt.library.library import Library
from transopt.library.online import Online
from transopt.library.proven import doubts
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify
from transopt.proof.designed import Designed
from transopt.recordings.recording import Recording
from transopt.report.markdown import build_markdown
from transopt.scene.keys import with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions

SHORT = {"time.stages": 200, "weights.after_s": 2e-3, "limits.current_A": 3.0}
GRIPS_N = (1.5, 2.0, 4.0, 6.0)


@pytest.fixture(scope="module")
def several(scene: Scene, taps: list[Recording]) -> TransientProblem:
    """A tap at 3 N that shall do for four other grips too, its current saturated."""
    short = with_values(scene, SHORT)
    reference = next(r for r in references_of(short, taps) if r.speed_m_s == 0.3)
    context = Context(short)
    spread = tuple(context.stage(grip) for grip in GRIPS_N)
    problem = context.posing.problem(wanted_of(reference), context.stage(3.0), spread).without("temperature")
    return replace(problem, worst=True)


@pytest.fixture(scope="module")
def found(several: TransientProblem) -> Designed:
    return least_worst(several, SolverOptions())


def epigraph(problem: TransientProblem) -> tuple[FloatArray, float]:
    """Command (N,) and its J by IPOPT: t is least with T_s(c) <= t for every device, all in the commands alone."""
    N, free, program = problem.grid.stages, problem.free_stages, dense.Program.of(problem)
    limit, most = problem.limits["current"].stated, problem.limits["command"].stated
    c, t = ca.MX.sym("c", free), ca.MX.sym("t")
    losses = []
    root = np.sqrt(program.weights / program.E)
    wanted = np.concatenate([by_root * of_term for by_root, of_term in zip(root, program.wanted, strict=True)])
    for device in range(len(problem.devices)):
        # |W (G c - r)|^2 by the triangle of W G: as a square it keeps its digits.
        rows = [by[:, None] * term[device][:, :free] for by, term in zip(root, program.filtered, strict=True)]
        Q, R = np.linalg.qr(np.concatenate(rows))
        rest = max(float(wanted @ wanted - (Q.T @ wanted) @ (Q.T @ wanted)), 0.0) + program.lost / program.E
        losses.append(ca.sumsqr(ca.DM(R) @ c - ca.DM(Q.T @ wanted)) + rest)
    moves = c - ca.vertcat(0, c[:-1])
    movement = program.by_movement * (ca.sumsqr(moves) + c[-1] ** 2)
    current = ca.DM(dense.responses(problem).current[:N, :free]) @ c
    solver = ca.nlpsol(
        "epigraph",
        "ipopt",
        {"x": ca.vertcat(c, t), "f": 1e3 * (t + movement), "g": ca.vertcat(*(each - t for each in losses), current)},
        {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "bound_relax_factor": 0.0}},
    )
    devices = len(losses)
    answer = solver(
        x0=0.0,
        lbx=np.append(np.full(free, -most), -np.inf),
        ubx=np.append(np.full(free, most), np.inf),
        lbg=np.append(np.full(devices, -np.inf), np.full(N, -limit)),
        ubg=np.append(np.zeros(devices), np.full(N, limit)),
    )
    assert solver.stats()["success"]
    return np.append(np.asarray(answer["x"]).ravel()[:free], np.zeros(N - free)), float(answer["f"]) / 1e3


class TestAgainstTheEpigraph:
    def test_the_same_worst_and_the_same_command(self, several: TransientProblem, found: Designed) -> None:
        command, J = epigraph(several)
        assert found.certificate.accepted
        assert found.certificate.objective == pytest.approx(J, rel=1e-6)
        np.testing.assert_allclose(found.solution.command, command, atol=2e-2 * np.abs(command).max())
        assert np.abs(found.solution.command).max() > several.limits["current"].stated

    def test_better_in_the_worst_and_worse_in_the_mean_than_the_mean_design(
        self, several: TransientProblem, found: Designed
    ) -> None:
        plain = optimum(replace(several, worst=False), SolverOptions())
        worst, mean = (
            several.tracking.losses(several.accelerations(each.solution.command)) for each in (found, plain)
        )
        assert worst.max() < 0.99 * mean.max()
        assert worst.mean() > mean.mean()

    def test_the_devices_with_a_share_lose_alike_and_the_others_less(self, found: Designed) -> None:
        problem = found.problem
        losses = problem.tracking.losses(problem.accelerations(found.solution.command))
        shares = problem.shared
        bear = shares > 1e-3
        assert 2 <= bear.sum() < shares.size
        assert shares.sum() == pytest.approx(1, abs=1e-12)
        np.testing.assert_allclose(losses[bear], losses.max(), rtol=1e-5)
        assert (losses <= losses.max() * (1 + 1e-12)).all()


class TestDevicesWithoutAShare:
    @pytest.fixture
    def sizes(self, monkeypatch: pytest.MonkeyPatch) -> list[int]:
        """Number of devices of every problem that the search solves."""
        found: list[int] = []

        def noted(problem: TransientProblem, options: SolverOptions) -> Designed:
            found.append(len(problem.devices))
            return optimum(problem, options)

        monkeypatch.setattr("transopt.design.worst.optimum", noted)
        return found

    def test_they_are_in_no_solve_and_in_the_proof(
        self, several: TransientProblem, found: Designed, sizes: list[int]
    ) -> None:
        again = least_worst(replace(several, shares=found.problem.shares), SolverOptions())
        assert max(sizes) == 1 + np.count_nonzero(found.problem.shared[1:] > 1e-12) < len(several.devices)
        assert again.problem.devices == several.devices
        assert again.certificate.accepted
        np.testing.assert_allclose(again.solution.command, found.solution.command, atol=1e-6)

    def test_a_limit_on_their_motion_keeps_them(
        self, several: TransientProblem, found: Designed, sizes: list[int], scene: Scene, taps: list[Recording]
    ) -> None:
        short = with_values(scene, {**SHORT, "limits.stroke_m": 0.02})
        reference = next(r for r in references_of(short, taps) if r.speed_m_s == 0.3)
        context = Context(short)
        devices = (context.stage(3.0), *(context.stage(grip) for grip in GRIPS_N))
        problem = context.posing.problem(wanted_of(reference), devices[0], devices[1:])
        assert least_worst(replace(problem, worst=True, shares=found.problem.shares), SolverOptions()).is_proven
        assert set(sizes) == {len(devices)}


class TestCertificate:
    @pytest.mark.parametrize("by", [0.01, -0.01])
    def test_other_shares_prove_nothing(self, found: Designed, by: float) -> None:
        shares = found.problem.shared.copy()
        first, second = np.argsort(shares)[-2:]
        shares[first] += by
        shares[second] -= by
        changed = replace(found.problem, shares=shares)
        assert not certify(changed, found.solution.command, found.solution.multipliers).accepted

    def test_the_mean_design_is_not_the_least_worst(self, several: TransientProblem) -> None:
        plain = optimum(replace(several, worst=False), SolverOptions())
        assert plain.certificate.accepted
        proof = certify(several, plain.solution.command, plain.solution.multipliers)
        assert not proof.accepted
        assert proof.duality_gap > 1e-3 * proof.objective

    def test_its_lower_bound_is_below_other_commands_within_the_limits(
        self, several: TransientProblem, found: Designed
    ) -> None:
        problem, own = found.problem, found.solution.command
        plain = optimum(replace(several, worst=False), SolverOptions()).solution.command
        for other in (plain, np.zeros_like(own), optimum(several.alone(), SolverOptions()).solution.command):
            for share in (1e-4, 1e-2, 0.3, 1.0):
                command = (1 - share) * own + share * other
                assert problem.objective(command, problem.accelerations(command)) >= found.certificate.lower_bound

    @pytest.mark.parametrize("shares", [np.full(4, 0.25), np.full(5, 0.25), np.array([1.2, -0.2, 0, 0, 0])])
    def test_shares_that_are_none_are_refused(self, several: TransientProblem, shares: FloatArray) -> None:
        with pytest.raises(InputError, match="shares"):
            replace(several, shares=shares)


@pytest.mark.parametrize("solver", ["casadi-piqp", "casadi-ipopt"])
def test_other_methods_take_the_shares_too(found: Designed, solver: str) -> None:
    other = optimum(replace(found.problem, worst=False), SolverOptions(solver))
    assert certify(found.problem, other.solution.command, other.solution.multipliers).accepted


ROBUST = {"robust": {"grip_spread": 0.3, "samples": 4, "minimise": "worst"}}
GRID = {"grid.grips_N": [2.0, 4.0]}


@pytest.fixture(scope="module")
def build(scene: Scene, taps: list[Recording]) -> Build:
    return build_library(with_values(scene, {**GRID, **ROBUST}), taps)


@pytest.fixture(scope="module")
def library(build: Build) -> Library:
    assert build.library is not None
    return build.library


class TestLibrary:
    def test_is_certified_saved_and_verified(self, library: Library, tmp_path: Path) -> None:
        assert proven_again(library, tmp_path).spread_share.shape == (4, 2, 4)

    def test_other_shares_in_the_file_are_found(self, library: Library) -> None:
        shares = library.spread_share.copy()
        shares[2, 1] = np.roll(shares[2, 1], 1)
        assert any("0.3" in doubt and "4" in doubt for doubt in doubts(replace(library, spread_share=shares)))

    def test_the_mean_has_no_shares_in_its_file(self, scene: Scene, taps: list[Recording], tmp_path: Path) -> None:
        mean = with_values(scene, {**GRID, "robust": {"grip_spread": 0.3, "samples": 4}})
        made = build_library(mean, taps).library
        assert "spread_share" not in proven_again(made, tmp_path).arrays()

    def test_the_report_says_what_is_least(self, build: Build) -> None:
        text = build_markdown(build, full=False)
        assert "Worst: the largest over the spread, which is what the design minimises" in text
        for entry in build.all_entries():
            assert entry.spread.robust_worst <= entry.spread.nominal_worst * (1 + 1e-6)

    @pytest.mark.skipif(not extension.available, reason="the extension is not built")
    def test_online_says_that_it_does_not_search(self, library: Library) -> None:
        with pytest.raises(InputError, match=r'minimise = "worst"'):
            Online(library)


def test_intensity_is_of_the_mean(scene: Scene) -> None:
    with pytest.raises(InputError, match=r"robust\.minimise"):
        with_values(scene, {**ROBUST, "weights.objective": "intensity"})


def test_a_wall_answers_one_device(scene: Scene) -> None:
    with pytest.raises(InputError, match="robust: feedback depends on the motion"):
        with_values(scene, {**ROBUST, "feedback": {"stiffness_N_m": 200.0, "damping_N_s_m": 0.2}})
