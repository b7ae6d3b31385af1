"""Error against run time in short form: the QP, the judge, the methods, the arithmetic, the command."""

import csv
import importlib
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy import sparse

import problems
from tests.conftest import ProblemMaker
from transopt.certify import certify
from transopt.discretise import discretise
from transopt.errors import InputError
from transopt.heat import Budget, thermal_limit
from transopt.problem import TransientProblem
from transopt.scene import Scene
from transopt.scene_file import load_scene
from transopt.solvers import SolverOptions, solve

SCRIPTS = Path(__file__).parents[1] / "scripts"
STAGES = 60  # 6 ms, of which 2 saturate
WHEELS = ("piqp", "clarabel", "osqp", "daqp")


class Scripts:
    """The script and its parts, found beside it as when it is called by its path."""

    def __getattr__(self, name: str) -> ModuleType:
        return importlib.import_module(name)


@pytest.fixture(scope="module")
def scripts() -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        yield Scripts()


@pytest.fixture(scope="module")
def short_scene(scene: Scene) -> Scene:
    return scene.model_copy(update={"time": scene.time.model_copy(update={"stages": STAGES})})


@pytest.fixture(scope="module")
def case(scripts: Any, make_problem: ProblemMaker, short_scene: Scene) -> Any:
    problem = make_problem(stages=STAGES)
    return scripts.ert_cases.make_case("short", short_scene, problem, 0.4, 5.0)


@pytest.fixture(scope="module")
def hot_problem(make_problem: ProblemMaker, scene: Scene) -> TransientProblem:
    """The coil's temperature binds, so that there is no QP."""
    problem, coil = make_problem(stages=STAGES), scene.coil()
    assert coil is not None
    limit = thermal_limit(coil, scene.amplifier_model(), problem.grid, Budget(headroom_K=0.02))
    return replace(problem, thermal=limit)


@pytest.fixture
def rows_of(scripts: Any, case: Any) -> Callable[..., list[Any]]:
    """Rows of methods on the short case, each setting run once after its two first runs."""

    def measured(*methods: Any) -> list[Any]:
        return list(scripts.ert_run.measure(case, methods, scripts.ert_run.Effort(0.0, least=1)))

    return measured


@pytest.fixture
def user_file(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "mine.py"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def point_of(qp: Any, command_A: np.ndarray) -> np.ndarray:
    """x (V,) that rolls a command out through the QP's own stage matrices."""
    state, x = np.zeros(len(qp.A_d)), []
    for movement in np.diff(command_A, prepend=0.0) / qp.current_unit_A:
        state = qp.A_d @ state + qp.B_d[:, 0] * movement
        x += [movement, *state]
    return np.array(x)


class TestQP:
    def test_objective_is_the_problems_to_rounding(self, case: Any) -> None:
        random = np.random.default_rng(0)
        for size in (0.1, 1.0, 4.0):
            command = np.append(size * random.standard_normal(STAGES - 10), np.zeros(10))
            stated = case.small.objective(command, case.small.accelerations(command))
            assert case.qp.value(point_of(case.qp, command)) == pytest.approx(stated, rel=1e-12)

    def test_rows_hold_for_what_the_stage_does_and_for_nothing_else(self, case: Any) -> None:
        qp = case.qp
        command = np.append(np.random.default_rng(1).standard_normal(STAGES - 10), np.zeros(10))
        x = point_of(qp, command)
        residual = (qp.A @ x - qp.l)[: qp.rows]
        assert np.abs(residual).max() < 1e-12
        assert np.all(qp.l[: qp.rows] == qp.u[: qp.rows])
        x[37] += 1e-3
        assert np.abs((qp.A @ x - qp.l)[: qp.rows]).max() > 1e-6

    def test_boxes_are_the_current_and_the_command_limit(self, case: Any) -> None:
        lower, upper = case.qp.bounds()
        n = len(case.qp.A_d)
        current, command = upper[n - 1 :: n + 1], upper[n :: n + 1]
        np.testing.assert_allclose(current[:-1] * case.qp.current_unit_A, 4.0)
        assert np.isinf(current[-1])  # it follows the hand-over
        np.testing.assert_allclose(command * case.qp.current_unit_A, 6.0)
        assert np.isinf(upper).sum() + 2 * STAGES - 1 == upper.size
        np.testing.assert_array_equal(lower, -upper)

    def test_reference_point_is_stationary_and_its_multipliers_certify(self, scripts: Any, case: Any) -> None:
        qp = case.qp
        assert np.abs(qp.P @ qp.solution + qp.q + qp.A.T @ qp.multipliers).max() < 1e-8
        assert qp.value(qp.solution) == pytest.approx(case.optimum.objective, rel=1e-10)
        assert qp.objective == case.optimum.objective
        np.testing.assert_allclose(qp.command(qp.solution), case.optimum.command_A, atol=1e-9)
        command = qp.command(qp.solution)
        proof = certify(case.small, command, scripts.ert_qp.project_multipliers(case.small, qp, qp.multipliers))
        assert proof.accepted
        flipped = scripts.ert_qp.project_multipliers(case.small, qp, -qp.multipliers)
        assert not certify(case.small, command, flipped).accepted

    def test_an_independent_solver_finds_the_projects_command(self, case: Any) -> None:
        clarabel = pytest.importorskip("clarabel", reason="clarabel is not installed")
        qp, settings = case.qp, clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
        A = sparse.csc_matrix(sparse.vstack([qp.A, -qp.A]))
        cones = [clarabel.NonnegativeConeT(2 * qp.l.size)]
        P = sparse.csc_matrix(sparse.triu(qp.P))
        found = clarabel.DefaultSolver(P, qp.q, A, np.append(qp.u, -qp.l), cones, settings).solve()
        np.testing.assert_allclose(qp.command(np.array(found.x)), case.optimum.command_A, atol=1e-5)

    def test_a_problem_with_a_temperature_is_refused(self, scripts: Any, hot_problem: TransientProblem) -> None:
        with pytest.raises(InputError, match="hot: has a temperature"):
            scripts.ert_qp.quadratic_program("hot", hot_problem)

    def test_dump_round_trip(self, scripts: Any, case: Any, tmp_path: Path) -> None:
        path = tmp_path / "short.npz"
        scripts.ert_qp.dump(case.qp, path)
        again = scripts.ert_qp.load(path)
        for field in fields(case.qp):
            one, other = getattr(case.qp, field.name), getattr(again, field.name)
            if sparse.issparse(one):
                assert (one != other).nnz == 0
            else:
                np.testing.assert_array_equal(one, other)

    def test_a_dump_is_enough_with_numpy_alone(self, scripts: Any, case: Any, tmp_path: Path) -> None:
        scripts.ert_qp.dump(case.qp, tmp_path / "short.npz")
        with np.load(tmp_path / "short.npz", allow_pickle=False) as file:
            data = {name: file[name] for name in file.files}
        x, value = data["solution"], 0.0
        for column, weight in enumerate(x):
            at = slice(data["P_indptr"][column], data["P_indptr"][column + 1])
            value += 0.5 * weight * float(data["P_data"][at] @ x[data["P_indices"][at]])
        value = data["objective_scale"] * (value + data["q"] @ x) + data["constant"]
        assert value == pytest.approx(float(data["objective"]), rel=1e-9)


class TestJudge:
    def test_the_optimum_has_no_error(self, scripts: Any, case: Any) -> None:
        verdict = scripts.ert_cases.judge(case.problem, case.optimum.command_A, case.optimum.objective)
        assert verdict.gap == 0.0
        assert verdict.error < 1e-12

    def test_a_command_a_thousandth_too_large_violates_by_that(self, scripts: Any, case: Any) -> None:
        verdict = scripts.ert_cases.judge(case.problem, 1.001 * case.optimum.command_A, case.optimum.objective)
        assert verdict.violation == pytest.approx(1e-3, rel=1e-6)
        assert verdict.error >= verdict.violation

    def test_a_better_objective_outside_the_limits_is_no_better(self, scripts: Any, case: Any) -> None:
        """The optimum for 4.4 A has a lower J; its distance counts by its size, and so does its violation."""
        wider = replace(case.small, limits=replace(case.small.limits, current_A=4.4, command_A=6.6))
        verdict = scripts.ert_cases.judge(case.problem, solve(wider).command_A, case.optimum.objective)
        assert verdict.gap < -0.01
        assert verdict.violation == pytest.approx(0.1, rel=1e-3)
        assert verdict.error == max(-verdict.gap, verdict.violation)
        above, below = (scripts.ert_cases.Verdict(sign * 0.5, 0.1) for sign in (1, -1))
        assert above.error == below.error == 0.5

    @pytest.mark.parametrize("broken", ["nan", "inf", "short"])
    def test_what_is_no_command_fails(self, scripts: Any, case: Any, broken: str) -> None:
        command = case.optimum.command_A.copy()
        if broken == "short":
            command = command[:-1]
        else:
            command[3] = float(broken)
        assert math.isinf(scripts.ert_cases.judge(case.problem, command, case.optimum.objective).error)

    def test_a_command_that_does_not_end_violates(self, scripts: Any, case: Any) -> None:
        command = case.optimum.command_A.copy()
        command[-1] = 0.06
        verdict = scripts.ert_cases.judge(case.problem, command, case.optimum.objective)
        assert verdict.violation == pytest.approx(0.01)

    def test_the_temperature_counts_relative_to_its_headroom(
        self, scripts: Any, case: Any, hot_problem: TransientProblem
    ) -> None:
        verdict = scripts.ert_cases.judge(hot_problem, case.optimum.command_A, case.optimum.objective)
        assert hot_problem.thermal is not None
        motion = hot_problem.stage.motion(case.optimum.command_A)
        hottest = hot_problem.thermal.temperatures_C(motion.current_A, case.optimum.command_A).max()
        assert verdict.violation == pytest.approx((hottest - hot_problem.thermal.limit_C) / 0.02, rel=1e-3)
        assert verdict.violation > 0.1

    def test_references_that_disagree_end_the_run(
        self, scripts: Any, case: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any
    ) -> None:
        def loose(problem: TransientProblem, options: SolverOptions) -> Any:
            found = solve(problem, options)
            return replace(found, command_A=0.999 * found.command_A) if options.solver == "casadi-ipopt" else found

        def short(name: str) -> Any:
            return scripts.ert_cases.make_case(name, case.scene, case.problem, 0.4, 5.0)

        monkeypatch.setattr(scripts.ert_cases, "solve", loose)
        monkeypatch.setattr(scripts.error_against_runtime, "case_of_scene", short)
        assert scripts.error_against_runtime.main(["--out", str(tmp_path), "--case", "wood_on_foam"]) == 1
        line = capsys.readouterr().err.strip()
        assert line.startswith("error: wood_on_foam: casadi-piqp at 1e-12 finds J = ")
        assert "nothing to compare with" in line
        assert "\n" not in line


class TestMethods:
    def test_the_projects_solvers_tighten(self, scripts: Any, rows_of: Any) -> None:
        rows = rows_of(*scripts.ert_methods.project_methods())
        for method in ("casadi-piqp", "casadi-fatrop", "casadi-ipopt"):
            own = {row.tolerance: row for row in rows if row.method == method}
            assert own[1e-12].level == "high accuracy"
            assert own[1e-10].level == "default"
            assert own[1e-12].error < 1e-9
            assert own[1e-12].certificate < 1e-9
            assert own[1e-1].error >= own[1e-12].error

    @pytest.mark.parametrize("name", WHEELS)
    def test_wheels_agree_and_start_cold(self, scripts: Any, case: Any, rows_of: Any, name: str) -> None:
        found, _ = scripts.ert_wheels.wheels()
        method = next((method for method in found if method.name == name), None)
        if method is None:
            pytest.skip(f"{name} is not installed")
        rows = {row.level: row for row in rows_of(method)}
        assert rows["high accuracy"].error < 1e-6
        assert name == "daqp" or rows["high accuracy"].certificate < 1e-4
        for setting in method.settings(case):
            prepared = method.prepare(case, setting)
            one, two = (prepared.read(prepared.run()) for _ in range(2))
            assert one.iterations == two.iterations
            np.testing.assert_array_equal(one.command_A, two.command_A)

    def test_hpipm_and_opti(self, scripts: Any, rows_of: Any) -> None:
        rows = rows_of(scripts.ert_wheels.hpipm(), scripts.ert_methods.opti_ipopt())
        best = {(row.method, row.level): row for row in rows}
        assert best["hpipm (CasADi)", "default"].error < 1e-9
        assert best["hpipm (CasADi)", "default"].certificate < 1e-6
        assert best["hpipm (CasADi)", "high accuracy"].error < 1e-6
        assert best["opti-ipopt", "default"].error < 1e-3
        assert best["opti-ipopt", "high accuracy"].error < 1e-7

    def test_opti_knows_the_temperature(
        self, scripts: Any, short_scene: Scene, hot_problem: TransientProblem
    ) -> None:
        hot = scripts.ert_cases.make_case("hot", short_scene, hot_problem, 0.4, 5.0)
        assert hot.qp is None
        assert "coil" in hot.binding
        assert scripts.ert_wheels.hpipm().settings(hot) == []
        opti = scripts.ert_methods.opti_ipopt()
        prepared = opti.prepare(hot, opti.settings(hot)[-1])
        answer = prepared.read(prepared.run())
        assert scripts.ert_cases.judge(hot.problem, answer.command_A, hot.optimum.objective).error < 1e-6
        solvers = {m.name for m in scripts.ert_methods.project_methods() if m.settings(hot)}
        assert solvers == {"casadi-fatrop", "casadi-ipopt"}

    def test_baselines_are_worse_and_said_so(self, scripts: Any, rows_of: Any) -> None:
        rows = rows_of(*scripts.ert_methods.baselines())
        assert [row.kind for row in rows] == ["baseline"] * 2
        for row in rows:
            assert row.error > 0.1
            assert row.nrmse_excess > 0.01

    @pytest.mark.parametrize(
        ("body", "status"),
        [
            ("return np.full(qp.q.size, np.nan)", "returned"),
            ("raise RuntimeError('no [luck]\\nat all')", "RuntimeError: no [luck]"),
            ("return np.zeros(3)", "ValueError: solve returned x of shape (3,)"),
            ("return qp.solution, np.zeros(2)", "ValueError: solve returned y of shape (2,)"),
            ("return None", "ValueError: solve returned x of shape ()"),
        ],
    )
    def test_what_returns_nothing_of_use_is_shown_as_failed(
        self, scripts: Any, rows_of: Any, user_file: Any, body: str, status: str
    ) -> None:
        (row,) = rows_of(scripts.ert_user.user_method(user_file(f"import numpy as np\ndef solve(qp):\n    {body}\n")))
        assert math.isinf(row.error)
        assert math.isinf(row.nrmse_excess)
        assert row.status.startswith(status)

    def test_zeros_are_a_poor_answer(self, scripts: Any, case: Any, rows_of: Any, user_file: Any) -> None:
        text = "import numpy as np\ndef solve(qp):\n    return np.zeros(qp.q.size)\n"
        (row,) = rows_of(scripts.ert_user.user_method(user_file(text)))
        assert row.gap == pytest.approx((1 - case.optimum.objective) / case.optimum.objective)
        assert row.violation == 0
        assert row.nrmse_excess == pytest.approx(1 - case.optimum.nrmse)

    def test_what_takes_too_long_has_failed(
        self, scripts: Any, rows_of: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(scripts.ert_run, "TIME_LIMIT_S", 0.0)
        for row in rows_of(*scripts.ert_methods.baselines()):
            assert math.isinf(row.error)
            assert row.status == "time limit of 0 s"

    def test_methods_take_turns(self, scripts: Any) -> None:
        order: list[str] = []
        methods = {name: lambda name=name: order.append(name) for name in "ab"}
        times = scripts.measuring.take_turns(methods, {"a": 3, "b": 1})
        assert order == ["a", "b", "a", "a"]
        assert {name: len(values) for name, values in times.items()} == {"a": 3, "b": 1}


class TestDiscretisations:
    def test_the_exact_one_is_the_projects(self, scripts: Any, make_problem: ProblemMaker) -> None:
        for ideal in (False, True):
            stage = make_problem(ideal=ideal).stage
            again = scripts.ert_discretisations.discretised(scripts.ert_discretisations.RULES["exact hold"], stage)
            np.testing.assert_allclose(again.A, stage.A, rtol=0, atol=1e-12 * np.abs(stage.A).max())
            np.testing.assert_allclose(again.B, stage.B, rtol=0, atol=1e-12 * np.abs(stage.B).max())

    @pytest.mark.parametrize(("name", "order"), [("Euler", 1), ("Tustin", 2), ("RK4", 4), ("Radau IIA-5", 5)])
    def test_known_orders(self, scripts: Any, make_problem: ProblemMaker, name: str, order: int) -> None:
        """Slope of the error after a fixed time against the step, small against the fastest mode."""
        problem = make_problem()
        plant, amplifier, rule = problem.stage.plant, problem.stage.amplifier, scripts.ert_discretisations.RULES[name]
        steps = np.array([4e-5, 2e-5, 1e-5])
        errors = []
        for step in steps:
            exact = discretise(plant, amplifier, step)
            stage = scripts.ert_discretisations.discretised(rule, exact)
            count = round(4e-4 / step)
            own, true = (np.linalg.matrix_power(one.A, count) for one in (stage, exact))
            errors.append(np.linalg.norm(own - true) / np.linalg.norm(true))
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert slope == pytest.approx(order, abs=0.25)
        assert scripts.ert_discretisations.ORDERS[name] == order

    def test_explicit_steps_on_a_stiff_drive_fail_and_are_shown(
        self, scripts: Any, case: Any, rows_of: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        stiff = load_scene(problems.scene_path("stiff_drive"))
        stage = discretise(stiff.plant(5.0), stiff.amplifier_model(), stiff.time.dt_s)
        own = replace(case.small, stage=stage)
        stiff_case = replace(case, problem=own, small=own)
        effort = scripts.ert_run.Effort(0.0, least=1)
        rows = {
            r.method: r for r in scripts.ert_run.measure(stiff_case, scripts.ert_methods.discretisations(), effort)
        }
        for name in ("RK4", "Euler"):
            assert math.isinf(rows[name].error)
            assert rows[name].status.startswith("unstable: grows by")
        for name in ("exact hold", "Radau IIA-5", "Tustin"):
            assert math.isfinite(rows[name].error)

    def test_errors_fall_with_the_order(self, rows_of: Any, scripts: Any) -> None:
        rows = {row.method: row.error for row in rows_of(*scripts.ert_methods.discretisations())}
        assert rows["exact hold"] < 1e-9 < rows["Radau IIA-5"] < rows["RK4"] < rows["Euler"]


class TestServoRates:
    def test_a_held_command_is_the_same_at_any_rate(self, scripts: Any, case: Any) -> None:
        command = case.optimum.command_A
        nrmse, violation = scripts.ert_periods.played(case, {10e3: command, 20e3: np.repeat(command, 2)})
        assert nrmse[10e3] == pytest.approx(nrmse[20e3], rel=1e-12)
        assert nrmse[10e3] == pytest.approx(case.optimum.nrmse, rel=0.1)
        assert abs(violation[10e3]) < 1e-9

    def test_faster_servos_come_nearer(self, scripts: Any, case: Any) -> None:
        rows = scripts.ert_periods.measure_periods(case, scripts.ert_run.Effort(0.0, least=1), (5e3, 10e3))
        slow, fast = rows
        assert (slow.method, fast.method) == ("5 kHz", "10 kHz")
        assert slow.nrmse_excess > fast.nrmse_excess > 0
        assert math.isnan(slow.error)
        assert slow.options == f"{STAGES // 2} stages, casadi-piqp"


class TestSummary:
    def row(self, scripts: Any, case: str, method: str, ms: float, error: float, level: str = "default") -> Any:
        numbers = dict.fromkeys(("tolerance", "gap", "violation", "nrmse_excess", "certificate", "setup_ms"), 0.0)
        return scripts.ert_run.Row(
            case=case,
            method=method,
            kind="solver",
            level=level,
            version="1",
            options="",
            iterations=1,
            status="",
            solve_ms=ms,
            q25_ms=ms,
            q75_ms=ms,
            runs=3,
            threads=1,
            error=error,
            **numbers,
        )

    def test_by_hand(self, scripts: Any) -> None:
        """Shift 10 ms: (20 + 10)(50 + 10)... ; a failure is charged 5000 ms."""
        rows = [
            self.row(scripts, "a", "fast", 20.0, 1e-7),
            self.row(scripts, "b", "fast", 50.0, 1e-9),
            self.row(scripts, "a", "loose", 10.0, 1e-4),
            self.row(scripts, "b", "loose", 10.0, 1e-7),
            self.row(scripts, "a", "lost", 1.0, math.inf),
            self.row(scripts, "b", "lost", 1.0, math.nan),
            self.row(scripts, "a", "partial", 1.0, 0.0),
            self.row(scripts, "a", "fast", 1.0, 0.0, level="sweep"),
            self.row(scripts, "c", "fast", 1.0, 1.0),
        ]
        fast, loose, lost = scripts.ert_summary.summarise(rows, ["a", "b"])
        assert [s.method for s in (fast, loose, lost)] == ["fast", "loose", "lost"]
        assert (fast.cases, fast.scores[1e-6].success, fast.scores[1e-3].success) == (2, 1.0, 1.0)
        assert fast.scores[1e-6].mean_ms == pytest.approx(math.sqrt(30 * 60) - 10)
        assert fast.scores[1e-6].relative == 1.0
        assert loose.scores[1e-6].success == 0.5
        assert loose.scores[1e-6].mean_ms == pytest.approx(math.sqrt(5010 * 20) - 10)
        assert loose.scores[1e-3].mean_ms == pytest.approx(10.0)
        assert loose.scores[1e-3].relative == 1.0
        assert fast.scores[1e-3].relative == pytest.approx((math.sqrt(1800) - 10) / 10)
        assert lost.scores[1e-3].success == 0.0
        assert lost.scores[1e-3].mean_ms == pytest.approx(5000.0)
        assert lost.worst == math.inf


class TestCommand:
    @pytest.fixture
    def run(
        self, scripts: Any, case: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any
    ) -> Callable[..., tuple[int, str, str]]:
        """The command with the short case in place of every scene's."""
        monkeypatch.setattr(
            scripts.error_against_runtime,
            "case_of_scene",
            lambda name: replace(case, name=name, qp=None if case.qp is None else replace(case.qp, name=name)),
        )
        monkeypatch.chdir(tmp_path)

        def call(*arguments: str) -> tuple[int, str, str]:
            monkeypatch.setattr(sys, "argv", ["error_against_runtime.py", *arguments])
            code = scripts.error_against_runtime.main()
            told = capsys.readouterr()
            return code, told.out, told.err

        return call

    def test_everything_with_a_users_method(self, scripts: Any, run: Any, user_file: Any, monkeypatch: Any) -> None:
        user_file(
            "calls = 0\n"
            "def solve(qp, tolerance=1e-6):\n"
            "    return qp.solution, qp.multipliers, {'iterations': 7, 'status': f'at {tolerance:g}'}\n"
        )
        real = scripts.ert_wheels.util.find_spec
        monkeypatch.setattr(
            scripts.ert_wheels.util, "find_spec", lambda name, *more: None if name == "osqp" else real(name, *more)
        )
        code, out, err = run(
            "--out", "out", "--dump", "qps", "--quick", "--case", "wood_on_foam", "--method", "mine.py"
        )
        assert code == 0, err
        assert "osqp; to add them: pip install '.[bench]'" in out
        assert sorted(path.name for path in Path("out").iterdir()) == [
            "error_against_runtime.md",
            "rows.csv",
            "work_precision.png",
        ]
        assert Path("qps/wood_on_foam.npz").stat().st_size > 1000
        with Path("out/rows.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert set(rows[0]) >= {
            *("case", "method", "version", "options", "tolerance", "iterations", "status", "setup_ms", "solve_ms"),
            *("q25_ms", "q75_ms", "runs", "threads", "gap", "violation", "nrmse_excess", "error"),
        }
        (own,) = (row for row in rows if row["method"] == "mine" and row["level"] == "high accuracy")
        assert float(own["error"]) < 1e-9
        assert float(own["certificate"]) < 1e-9
        assert (own["iterations"], own["status"], own["tolerance"]) == ("7", "at 1e-10", "1e-10")
        text = Path("out/error_against_runtime.md").read_text()
        for words in ("| mine | high accuracy", "osqp; `pip install '.[bench]'`", "opti-ipopt", "How to cite", "RK4"):
            assert words in text
        assert Path("out/work_precision.png").read_bytes()[:4] == b"\x89PNG"

    def test_an_nlp_is_not_dumped_and_said_so(
        self, scripts: Any, short_scene: Scene, hot_problem: TransientProblem, tmp_path: Path
    ) -> None:
        hot = scripts.ert_cases.make_case("hot_coil", short_scene, hot_problem, 0.4, 5.0)
        (line,) = scripts.error_against_runtime.dump_all([hot], tmp_path)
        assert "not dumped" in line
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            (None, "mine.py: no such file"),
            ("def solve(qp:\n", "mine.py: does not run (SyntaxError"),
            ("raise SystemExit(3)", "mine.py: does not run (SystemExit"),
            ("import nothing_of_this_name", "No module named 'nothing_of_this_name'"),
            ("solve = 3", "mine.py: defines no function solve(qp)"),
            ("def solve():\n    pass", "mine.py: solve takes no argument"),
        ],
    )
    def test_a_broken_method_file_is_refused_in_one_line(
        self, run: Any, user_file: Any, text: str | None, words: str
    ) -> None:
        if text is not None:
            user_file(text)
        code, _, err = run("--out", "out", "--method", "mine.py")
        assert code == 2
        assert err.startswith("error: --method mine.py: ")
        assert words in err
        assert err.count("\n") == 1
        assert not Path("out").exists()

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["--out", "file"], "--out file: cannot be written"),
            ([], "nothing to do: state --out DIR, --dump DIR or both"),
        ],
    )
    def test_refusals(self, run: Any, arguments: list[str], words: str) -> None:
        Path("file").write_text("in the way")
        code, _, err = run(*arguments)
        assert (code, err.count("\n")) == (2, 1)
        assert words in err

    def test_an_unknown_case_is_refused(self, scripts: Any, tmp_path: Path, capsys: Any) -> None:
        assert scripts.error_against_runtime.main(["--out", str(tmp_path), "--case", "wood"]) == 2
        assert "--case wood: unknown; choose one of wood_on_foam" in capsys.readouterr().err

    def test_what_failed_is_named_in_the_figure(self, scripts: Any, case: Any, rows_of: Any, user_file: Any) -> None:
        bad = scripts.ert_user.user_method(user_file("def solve(qp):\n    raise ValueError('lost')\n"))
        figure = scripts.ert_figure.work_precision([case], rows_of(bad, *scripts.ert_methods.baselines()))
        upper, lower = figure.axes
        assert upper.get_xlabel() == "failed: mine (ValueError)"
        names = {text.get_text() for text in lower.texts}
        assert names == {"clipped optimum", "seed inversion"}
