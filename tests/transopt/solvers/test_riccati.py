"""The project's own interior-point method: its stage data, its answers, its refusals, its absence."""

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

import problems
from problems.stress.cases import StressCase
from problems.stress.parts import Horizon
from tests.benches.limits import drawn_ray, with_limit, with_numbers
from tests.conftest import ProblemMaker, WalledMaker
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.build import Build
from transopt.design.context import Context
from transopt.plant.chain import Link, chain
from transopt.plant.discretise import discretise
from transopt.plant.wall import reference_course
from transopt.problem.answer import OBJECTIVE_SCALE, Status
from transopt.problem.heat import Budget
from transopt.problem.limits.temperature import temperature_limit
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout, linear_stage
from transopt.problem.wall_ticks import pressing
from transopt.proof.certify import certify
from transopt.proof.effect import Effect
from transopt.proof.farkas import is_infeasible
from transopt.report.markdown import build_markdown
from transopt.scene.recordings import recordings_of
from transopt.scene.scene import Scene
from transopt.solvers import choose, modes, riccati
from transopt.solvers.choose import solve
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions
from transopt.solvers.prove import certificates
from transopt.solvers.stage_data import Stages, stages

pytestmark = pytest.mark.skipif(not riccati.available, reason="the extension is not built")

OWN = SolverOptions("riccati")
SCENES = ("wood_on_foam", "walled", "low_supply", "ideal_amplifier", "stiff_drive", "lra_click")


@pytest.fixture(scope="module")
def hardest() -> Callable[[str], TransientProblem]:
    """The fastest tap under the firmest grip of a built-in scene, or its last target, with all its limits."""

    def make(name: str) -> TransientProblem:
        scene = problems.load(name)
        context, (speed_m_s, target) = Context.recorded(scene, recordings_of(scene)), scene.axes.rows[-1]
        problem = context.posed(speed_m_s, scene.grid.grips_N[-1], target).problem
        return (
            problem
            if problem.wall is None
            else pressing(problem, reference_course(problem.grid, problem.target.continued_m_s2))
        )

    return make


@pytest.fixture(scope="module")
def hot(scene: Scene) -> Callable[..., TransientProblem]:
    """A problem with a temperature limit beside its others."""

    def make(problem: TransientProblem, **budget: float) -> TransientProblem:
        coil = scene.coil()
        assert coil is not None
        limit = temperature_limit(coil, problem.stage.amplifier, problem.grid, Budget(**budget))
        return with_limit(problem, limit)

    return make


class TestAnswers:
    @pytest.mark.parametrize("name", ["hot_coil", "rapid_tapping", "low_supply", "walled"])
    def test_agrees_with_ipopt(self, hardest: Callable[[str], TransientProblem], name: str) -> None:
        problem = hardest(name)
        own, other = (solve(problem, SolverOptions(method)) for method in ("riccati", "casadi-ipopt"))
        proofs = [certify(problem, answer.command, answer.multipliers) for answer in (own, other)]
        assert abs(proofs[0].objective - proofs[1].objective) <= 1e-6 * max(proofs[0].objective, OBJECTIVE_SCALE)
        np.testing.assert_allclose(own.command, other.command, rtol=0, atol=3e-4)

    @pytest.mark.parametrize("stages", [11, 12, 30])
    def test_short_horizons(self, make_problem: ProblemMaker, stages: int) -> None:
        problem = make_problem(0.4, 5.0, stages=stages)
        answer = solve(problem, OWN)
        assert certify(problem, answer.command, answer.multipliers).accepted

    @pytest.mark.parametrize("limit_A", [1e-3, 0.1, 1.25])
    def test_tight_limits(self, make_problem: ProblemMaker, limit_A: float) -> None:
        problem = make_problem(0.4, 5.0, current_A=limit_A, slew_A_per_s=2000.0 * limit_A)
        answer = solve(problem, OWN)
        assert answer.iterations <= 40
        assert certify(problem, answer.command, answer.multipliers).accepted

    def test_no_smoothness_and_weights_of_zero(self, make_problem: ProblemMaker) -> None:
        problem = make_problem(0.4, 5.0)
        weights = problem.terms[0].weights.copy()
        weights[200:] = 0.0
        problem = replace(problem, terms=(ErrorTerm("plain", weights),), rho=1e-12)
        answer = solve(problem, OWN)
        assert certify(problem, answer.command, answer.multipliers).accepted

    @pytest.mark.parametrize("budget", [{"headroom_K": 0.05}, {"headroom_K": 0.01}, {"tap_rate_Hz": 12.0}])
    def test_temperature(
        self, make_problem: ProblemMaker, hot: Callable[..., TransientProblem], budget: dict
    ) -> None:
        problem = hot(make_problem(0.4, 5.0), **budget)
        own, other = (solve(problem, SolverOptions(method)) for method in ("riccati", "casadi-ipopt"))
        proofs = [certify(problem, answer.command, answer.multipliers) for answer in (own, other)]
        assert all(proof.is_stationary for proof in proofs)
        assert abs(proofs[0].objective - proofs[1].objective) <= 1e-6 * max(proofs[0].objective, OBJECTIVE_SCALE)

    def test_threads_change_no_bit(self, make_problem: ProblemMaker) -> None:
        entries = [make_problem(speed, grip) for speed in (0.3, 0.4) for grip in (1.0, 3.0, 5.0)]
        alone = [solve(entry, OWN).command for entry in entries]
        with ThreadPoolExecutor(4) as pool:
            together = list(pool.map(lambda entry: solve(entry, OWN).command, entries * 3))
        for j, command in enumerate(together):
            np.testing.assert_array_equal(command, alone[j % len(entries)])

    def test_iteration_limit_is_said(self, make_problem: ProblemMaker) -> None:
        assert solve(make_problem(0.4, 5.0), replace(OWN, max_iterations=3)).status is Status.ITERATION_LIMIT


class TestInfeasible:
    def test_a_ray_proves_it(self, walled: WalledMaker) -> None:
        """The hand-over asks for what the wall wants; a slew limit keeps the command far from it."""
        problem = walled(4000.0, 0.4, 5.0)
        problem = pressing(problem, reference_course(problem.grid, problem.target.continued_m_s2))
        answer = solve(with_numbers(problem, current_A=0.05).without("temperature"), OWN)
        assert answer.status is Status.INFEASIBLE
        assert "ray" in answer.message

    def test_nothing_proves_a_feasible_problem_infeasible(self, make_problem: ProblemMaker) -> None:
        problem = make_problem(0.4, 5.0, slew_A_per_s=5000.0)
        answer = solve(problem, OWN)
        random = np.random.default_rng(5)
        assert not is_infeasible(problem, answer.command, answer.multipliers)
        for scale in (1.0, 1e8):
            ray = drawn_ray(problem, random, scale)
            assert not is_infeasible(problem, answer.command, ray)


class TestTheLastInstant:
    """Rows hold at stage N too, after the last command."""

    @staticmethod
    def bounded(given: Stages, at: int, most: float) -> Stages:
        """Keep the first of the states below `most` at one stage, by a row behind the others."""
        arrays, n = dict(given.arrays), given.sizes["states"]
        wide = np.full((given.sizes["stages"] + 1, 1), np.inf)
        arrays["lower"] = np.concatenate([arrays["lower"], -wide], axis=1)
        wide[at] = most
        arrays["upper"] = np.concatenate([arrays["upper"], wide], axis=1)
        arrays["G"] = np.concatenate([arrays["G"], np.eye(1, n)])
        arrays |= {name: np.append(arrays[name], 0.0) for name in ("d", "d_size")}
        arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        return replace(given, sizes=given.sizes | {"rows": given.sizes["rows"] + 1}, arrays=arrays)

    @staticmethod
    def longer(given: Stages) -> Stages:
        """Add a stage at the end of the problem, where nothing moves and nothing is weighed."""
        arrays, sizes = dict(given.arrays), given.sizes | {"stages": given.sizes["stages"] + 1}
        arrays |= {name: np.append(arrays[name], 0.0) for name in ("weight", "reference", "rule_offset")}
        arrays["rule_gain"] = np.concatenate([arrays["rule_gain"], arrays["rule_gain"][-1:]])
        wide = np.full((1, given.sizes["rows"]), np.inf)
        arrays["lower"] = np.concatenate([arrays["lower"], -wide])
        arrays["upper"] = np.concatenate([arrays["upper"], wide])
        return replace(given, sizes=sizes, arrays=arrays)

    @staticmethod
    def solved(given: Stages) -> extension.Answer:
        return extension.interior_points([given], tolerance=1e-9, max_iterations=100)[0]

    @staticmethod
    def reached(given: Stages, command: NDArray[np.float64]) -> float:
        """The first of the states at stage N."""
        A, x = given.arrays["A"], np.zeros(given.sizes["states"])
        for movement in np.diff(command, prepend=0.0):
            x = A @ x + A[:, -1] * movement
        return float(x[0])

    def test_as_that_of_a_stage_more(self, make_problem: ProblemMaker) -> None:
        plain = stages(make_problem(0.4, 5.0, stages=60))
        N = plain.sizes["stages"]
        free = self.solved(plain)
        most = self.reached(plain, free.command) - 0.1 * abs(self.reached(plain, free.command))
        answer = self.solved(self.bounded(plain, N, most))
        other = self.solved(self.bounded(self.longer(plain), N, most))
        assert answer.code == other.code == extension.SOLVED
        assert self.reached(plain, answer.command) == pytest.approx(most, rel=1e-6)
        assert answer.objective == pytest.approx(other.objective, rel=1e-7)
        np.testing.assert_allclose(answer.command, other.command[:N], rtol=0, atol=1e-5)
        assert answer.upper[N, -1] == pytest.approx(other.upper[N, -1], rel=1e-4)


class TestModes:
    """The method works in the modes of a device, where a device has them, and in its states elsewhere."""

    @pytest.mark.parametrize(
        "name", ["wood_on_foam", "hot_coil", "free_stylus", "ideal_amplifier", "voice_coil_thud"]
    )
    def test_are_the_same_dynamics(self, hardest: Callable[[str], TransientProblem], name: str) -> None:
        problem = hardest(name)
        stage, given = linear_stage(problem), stages(problem)
        A, B, n = given.arrays["A"], stage.A, given.sizes["states"]
        there = np.abs(A) > 0
        there[:, -1] = False
        assert all(i == j or i ^ 1 == j for i, j in np.argwhere(there))
        command, z, x = np.random.default_rng(0).standard_normal(60), np.zeros(n), np.zeros(n)
        C = given.arrays["C"]
        for movement in np.diff(command, prepend=0.0):
            z, x = A @ z + A[:, -1] * movement, B @ x + B[:, -1] * movement
            np.testing.assert_allclose(C @ z, stage.C @ x, rtol=1e-9, atol=1e-10 * np.abs(stage.C).max())
            if given.sizes["current"] >= 0:
                assert z[given.sizes["current"]] == pytest.approx(x[layout(problem).current], abs=1e-12)

    @pytest.mark.parametrize(
        ("stylus_kg", "stiffness_N_m", "damping_N_s_m"),
        [(0.26e-3, 6e4, 3e4), (26e-3, 6e7, 3e6), (0.1e-3, 1.3e9, 3e4)],
    )
    def test_a_transmission_that_is_all_but_rigid_costs_no_digits(
        self, make_problem: ProblemMaker, stylus_kg: float, stiffness_N_m: float, damping_N_s_m: float
    ) -> None:
        """The force of a stiff link is a large number times the difference of two nearly equal motions."""
        links = [Link(stiffness_N_m, damping_N_s_m), Link(13000.0, 21.0), Link(710.0, 21.0)]
        plant = chain([0.014, stylus_kg, 0.01], links, force_per_current_N_A=1.25, stylus=1)
        problem = make_problem(0.4, 5.0)
        problem = replace(problem, stage=discretise(plant, problem.stage.amplifier, problem.grid.dt_s))
        problem = with_numbers(problem, current_A=2.0)
        answer = solve(problem, OWN)
        assert answer.status is Status.OPTIMAL
        assert np.abs(Effect(problem, answer.command).motion.plant_input).max() == pytest.approx(2.0, rel=1e-6)
        assert certify(problem, answer.command, answer.multipliers).relative_gap < 1e-8

    def test_a_delay_line_has_none(self, hardest: Callable[[str], TransientProblem]) -> None:
        problem = hardest("walled")
        np.testing.assert_array_equal(stages(problem).arrays["A"], linear_stage(problem).A)

    @pytest.mark.parametrize("name", ["wood_on_foam", "hot_coil", "low_supply"])
    def test_have_the_same_optimum_as_the_states(
        self, hardest: Callable[[str], TransientProblem], monkeypatch: pytest.MonkeyPatch, name: str
    ) -> None:
        in_modes = solve(hardest(name), OWN)
        monkeypatch.setattr(modes, "MOST_CONDITION", 0.0)
        in_states = solve(hardest(name), OWN)
        np.testing.assert_allclose(in_states.command, in_modes.command, rtol=0, atol=1e-6)


class TestMemory:
    """Results and workspace are used again by the problems of one thread."""

    def test_an_answer_knows_nothing_of_the_problem_before(self, make_problem: ProblemMaker) -> None:
        problem, other = make_problem(0.4, 3.0), make_problem(0.1, 3.0, current_A=0.3)
        (first,) = riccati.solve([problem], SolverOptions())
        riccati.solve([other], SolverOptions())
        (again,) = riccati.solve([problem], SolverOptions())
        assert again.iterations == first.iterations
        np.testing.assert_allclose(again.command, first.command, rtol=1e-12, atol=1e-14)
        for one, its in zip(first.multipliers.arrays(), again.multipliers.arrays(), strict=True):
            np.testing.assert_allclose(its, one, rtol=1e-9, atol=1e-14)

    def test_is_kept_by_each_thread_and_up_to_a_size(
        self, make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        given = stages(make_problem(0.4, 3.0, stages=40))

        def kept() -> FloatArray:
            self.solved(given)
            return extension._memory.kept

        own = kept()
        assert kept() is own
        with ThreadPoolExecutor(1) as pool:
            assert pool.submit(kept).result() is not own
        monkeypatch.setattr(extension, "MOST_KEPT_BYTES", own.nbytes)
        self.solved(stages(make_problem(0.4, 3.0, stages=4000)))
        assert extension._memory.kept is own

    @staticmethod
    def solved(given: Stages) -> extension.Answer:
        return extension.interior_points([given], tolerance=1e-9, max_iterations=60)[0]


class TestSideBySide:
    """Problems of equal sizes share the registers, and nothing else."""

    BESIDE = 9  # the widest register has eight numbers; one problem is left over

    @staticmethod
    def solved(given: list[Stages]) -> list[extension.Answer]:
        return extension.interior_points(given, tolerance=1e-9, max_iterations=60)

    @pytest.mark.parametrize("name", SCENES)
    def test_the_answers_are_those_of_each_alone(self, hardest: Callable[[str], TransientProblem], name: str) -> None:
        """Harder and easier problems: those that end first wait for the others.

        None ends at the edge of the tolerance, where the last bits of a limit decide on two steps more.
        """
        whole = hardest(name).without("temperature")
        limits = whole.limits.input_limit * np.linspace(1.0, 0.72, self.BESIDE)
        given = [stages(with_numbers(whole, current_A=limit)) for limit in limits]
        beside = self.solved(given)
        for each, found in zip(given, beside, strict=True):
            (own,) = self.solved([each])
            assert found.code == own.code
            assert found.objective == pytest.approx(own.objective, rel=1e-9)
            if found.iterations == own.iterations:  # rounding may put one below the tolerance a step earlier
                np.testing.assert_allclose(found.command, own.command, rtol=0, atol=1e-8 * np.abs(own.command).max())
            assert abs(found.iterations - own.iterations) <= 1

    def test_no_answer_depends_on_the_problems_beside_it(self, make_problem: ProblemMaker) -> None:
        """Not by a bit: on none that ends at once, breaks down, or is met by no command."""
        easy, hard = (stages(make_problem(speed, 5.0)) for speed in (0.1, 0.4))
        nothing = replace(easy, arrays=easy.arrays | {"reference": np.full_like(easy.arrays["reference"], np.nan)})
        unmet = replace(hard, arrays=hard.arrays | {name: hard.arrays[name] + 2.0 for name in ("lower", "upper")})
        wanted = self.solved([hard] * self.BESIDE)[3]
        assert wanted.code == extension.SOLVED
        for other in (easy, nothing, unmet):
            found = self.solved([other, other, other, hard, *[other] * 5])
            for one, its in zip(wanted, found[3], strict=True):
                np.testing.assert_array_equal(its, one)
            assert found[0].iterations != wanted.iterations

    def test_any_problems_are_answered_in_their_order(self, make_problem: ProblemMaker) -> None:
        given = [stages(make_problem(0.4, 5.0, stages=n)) for n in (40, 60, 40, 50, 60, 40, 60)]
        for own, beside in zip([self.solved([each])[0] for each in given], self.solved(given), strict=True):
            np.testing.assert_allclose(beside.command, own.command, atol=1e-9)
        assert not self.solved([])

    def test_the_certificates_are_those_of_each_alone(self, make_problem: ProblemMaker) -> None:
        problems = [make_problem(0.4, grip, current_A=limit) for grip in (1.0, 5.0) for limit in (9.0, 4.0, 2.0, 1.0)]
        answers = riccati.solve(problems, OWN)
        effects = [Effect(problem, answer.command) for problem, answer in zip(problems, answers, strict=True)]
        found = certificates([(effect, a.multipliers) for effect, a in zip(effects, answers, strict=True)])
        for problem, answer, proof in zip(problems, answers, found, strict=True):
            wanted = certify(problem, answer.command, answer.multipliers)
            assert proof.accepted
            assert proof.objective == pytest.approx(wanted.objective, rel=1e-9)
            assert proof.relative_gap == pytest.approx(wanted.relative_gap, abs=1e-9)
            assert proof.excess == pytest.approx(wanted.excess, abs=1e-6)


class Stopped(Exception):  # noqa: N818 - not an error
    """What the answer to the signal raises."""


@contextmanager
def signalled(after_s: float) -> Iterator[list[int]]:
    """A signal after so long, whose answer raises; what has come is listed."""
    came: list[int] = []

    def answer(number: int, _: object) -> None:
        came.append(number)
        raise Stopped

    before = signal.signal(signal.SIGINT, answer)
    timer = threading.Timer(after_s, signal.raise_signal, [signal.SIGINT])
    try:
        timer.start()
        yield came
    finally:
        timer.cancel()
        timer.join()
        signal.signal(signal.SIGINT, before)


class TestSignals:
    def test_one_that_raises_ends_the_search(self, make_problem: ProblemMaker) -> None:
        given = stages(make_problem(0.4, 5.0, current_A=1.0))

        def solved() -> extension.Answer:
            return extension.interior_points([given], tolerance=1e-9, max_iterations=60)[0]

        def search() -> None:
            while True:
                solved()

        with signalled(0.05) as came, pytest.raises(Stopped):
            search()
        assert came == [signal.SIGINT]
        assert solved().code == extension.SOLVED

    def test_the_largest_problem_does_not_hold_it_up(self) -> None:
        """One iteration of it takes a third of a second, all of them seven."""
        problem = StressCase("long", horizon=Horizon(stages=20000)).problem()
        given = stages(replace(problem, spread=(problem.stage,) * 6))
        assert given.sizes["states"] > 40
        with signalled(0.2) as came, pytest.raises(Stopped):
            extension.interior_points([given], tolerance=1e-9, max_iterations=100)
        assert came == [signal.SIGINT]


class TestAbsence:
    """Without a compiler there is no extension."""

    def test_the_casadi_methods_take_over(self, make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch) -> None:
        problem = make_problem(0.4, 5.0)
        monkeypatch.setattr(riccati, "available", False)
        assert next(choose.capable(problem)) == "casadi-piqp"
        with pytest.raises(InputError, match="--solver riccati: its extension is not built"):
            solve(problem, OWN)

    def test_the_default_and_the_report_say_so(self, build: Build, monkeypatch: pytest.MonkeyPatch) -> None:
        assert SolverOptions().solver == "riccati"
        assert "not built" not in build_markdown(build, full=False)
        monkeypatch.setattr(extension, "available", False)
        assert SolverOptions().solver == "casadi-piqp"
        assert "own solver is not built" in build_markdown(build, full=False)

    def test_one_of_another_version_is_none(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Arrays of another version may mean something else; the earliest versions have no number to ask for."""
        monkeypatch.setattr(
            extension.ct, "PyDLL", lambda path: SimpleNamespace(tr_interface=lambda: extension.INTERFACE - 1)
        )
        assert extension._library() is None
        monkeypatch.setattr(extension.ct, "PyDLL", lambda path: SimpleNamespace(tr_solve=None, tr_linear=None))
        assert extension._library() is None
