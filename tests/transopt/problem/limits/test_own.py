"""Limits of a user's own, from files outside the package: recognised, solved, certified, replayed, priced, named."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import problems
import transopt as to
from tests.benches import dense
from tests.benches.libraries import proven_again
from transopt.base.errors import InputError
from transopt.design.build import Build, build_library
from transopt.design.verify import verify_library
from transopt.library.proven import doubts
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers, Status
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify, reduced_gradient
from transopt.proof.effect import Effect
from transopt.proof.farkas import is_infeasible
from transopt.recordings.recording import Recording
from transopt.report.first import Look, lines
from transopt.scene.keys import with_values
from transopt.solvers.options import SolverOptions
from transopt.solvers.own import CasadiLaw, StageSymbols, own_limit
from transopt.solvers.prove import certified

Judge = Callable[[TransientProblem, np.ndarray, Multipliers], Certificate]

JOINT = (
    "to.own_limit('joint_force', 'N', lambda s: 6e4 * s.output('transmission stretch')"
    " + 8 * (s.output('motor velocity') - s.output('stylus velocity')), lower=-3, upper=3)"
)
AREA = "to.own_limit('area', '1', lambda s: (s.current / 4) ** 2 + (s.velocity / 0.45) ** 2, upper=1.0)"
POWER = "to.own_limit('power', 'W', lambda s: 1.25 * s.current * s.velocity, lower=-1.2)"


def solved(folder: Path, taps: list[Recording], limit: str) -> Build:
    """The fastest tap of the default scene over 15 ms, at one grip, with this limit in a file beside the scene."""
    (folder / "my_limits.py").write_text(f"import casadi as ca\nimport transopt as to\nLIMITS = [{limit}]\n")
    text = problems.scene_path("wood_on_foam").read_text(encoding="utf-8")
    text = text.replace("[limits]", '[limits]\nown = ["my_limits.py"]').replace("[1.0, 3.0, 5.0]", "[3.0]")
    text = text.replace("stages = 800", "stages = 150")
    scene = folder / "mine.toml"
    scene.write_text(text, encoding="utf-8")
    return build_library(problems.load(scene), taps)


def test_a_linear_one_is_recognised_and_solved_by_the_compiled_method(tmp_path: Path, taps: list[Recording]) -> None:
    build = solved(tmp_path, taps, JOINT)
    entry = build.entries[-1][0]
    assert entry.status is Status.OPTIMAL, entry.shortfalls
    assert "joint_force 3 N" in entry.binding
    assert [price.limit for price in entry.prices].count("joint_force") == 1
    problem, command = entry.problem, entry.solution.command
    # A dense solve finds the same, with the states from the plant's own matrices.
    force = dense.states(problem) @ np.array([6e4, 0, 0, 8, 0, 0, 0])
    _, J = dense.optimum(problem, force[:-1], np.full(150, -3.0), np.full(150, 3.0))
    assert entry.certificate.objective == pytest.approx(J, abs=1e-6 * max(J, OBJECTIVE_SCALE))
    assert np.abs(force[:-1] @ command).max() <= 3.0 + 1e-6
    # A command that leaves it, or a lost multiplier, is noticed.
    m = entry.solution.multipliers
    lost = m.with_pair("joint_force", np.zeros(150), np.zeros(150))
    assert certify(problem, command, m).accepted
    assert not certify(problem, command, lost).accepted
    assert not certify(problem, 1.01 * command, m).accepted


@pytest.mark.parametrize(
    ("lower", "upper", "named", "wider"),
    [(-0.2, None, -0.2, -1), (0.0, None, 0.0, -1), (0.3, None, 0.3, -1), (-5.0, 1.0, 1.0, 1)],
)
def test_the_price_of_one_moves_the_bound_that_binds_outwards(
    tmp_path: Path, taps: list[Recording], lower: float, upper: float | None, named: float, wider: int
) -> None:
    """The current, plus 0.5 A where the lower bound is above zero so that a current of zero keeps it."""
    more = 0.5 if lower > 0 else 0.0

    def at(low: float, up: float | None) -> Build:
        return solved(
            tmp_path, taps, f"to.own_limit('bounded', 'A', lambda s: s.current + {more}, lower={low}, upper={up})"
        )

    [price] = [each for each in at(lower, upper).entries[-1][0].prices if each.limit == "bounded"]
    assert price.bound == pytest.approx(named, abs=1e-12)
    assert price.sentence.startswith(f"bounded {named:g} A: ")
    assert wider * price.step > 0
    for bound, told in ((price.bound + price.step, price.then), (price.enough, price.there)):
        assert wider * (bound - named) > 0
        truly = at(*((bound, None) if upper is None else (lower - (bound - upper), bound))).entries[-1][0]
        assert told == pytest.approx(truly.figures.tap_error, abs=1e-6)
    assert "bounded" not in truly.slopes


@pytest.mark.parametrize("of", ["current", "command"])
def test_one_that_no_command_keeps_is_refused_with_its_sign(tmp_path: Path, taps: list[Recording], of: str) -> None:
    """The first current and the last commands are zero, so that none stays 0.3 A below or above it."""
    for bound, said in (("upper=-0.3", "over its limit -0.3 A"), ("lower=0.3", "below its limit 0.3 A")):
        entry = solved(tmp_path, taps, f"to.own_limit('held', 'A', lambda s: s.{of}, {bound})").entries[-1][0]
        assert entry.status is Status.INFEASIBLE
        assert entry.shortfalls[0].startswith(f"held 0.3 A {said} at ")


@pytest.mark.parametrize("solver", ["riccati", "casadi-ipopt"])
def test_with_an_ideal_amplifier_the_first_current_is_the_first_command(solver: str) -> None:
    values = {"grid.speeds_m_s": [0.2], "grid.grips_N": [5.0], "time.stages": 300}
    found = []
    for of in (lambda s: s.current, lambda s: s.command):
        own = [own_limit("bounded", "A", of, lower=-0.05).table(300)]
        scene = with_values(problems.load("ideal_amplifier"), {**values, "limits.own": own})
        [entry] = to.build(scene, options=SolverOptions(solver=solver)).all_entries()
        assert entry.status is Status.OPTIMAL
        assert entry.binding.startswith("bounded -0.05 A at -0.20 to -0.10")
        assert entry.solution.solver == solver
        found.append(entry.certificate.objective)
    assert found[0] == pytest.approx(found[1], rel=1e-8)


@pytest.mark.parametrize(("limit", "name", "value"), [(AREA, "area", 1.0), (POWER, "power", -1.2)])
def test_what_is_not_linear_goes_to_ipopt_and_is_certified(
    tmp_path: Path, taps: list[Recording], limit: str, name: str, value: float
) -> None:
    build = solved(tmp_path, taps, limit)
    entry = build.entries[-1][0]
    assert entry.status is (Status.OPTIMAL if name == "area" else Status.STATIONARY), entry.shortfalls
    assert entry.solution.solver == "casadi-ipopt"
    assert f"{name} {value:g}" in entry.binding
    assert entry.certificate.is_stationary
    # The bound is rigorous in either case: that of the problem without the limit, or by the gap where it is convex.
    assert entry.certificate.lower_bound <= entry.certificate.objective * (1 + 1e-9)
    assert entry.certificate.accepted == (name == "area")
    motion = entry.problem.stage.motion(entry.solution.command)
    velocity = motion.velocity_m_s + entry.problem.limits[name].rows(entry.problem)[0].nominal["velocity"]  # type: ignore[attr-defined]
    current = motion.plant_input
    taken = (current / 4) ** 2 + (velocity / 0.45) ** 2 if name == "area" else -1.25 * current * velocity
    assert taken.max() <= abs(value) * (1 + 1e-6)


def test_the_gradient_of_a_law_is_that_of_differences(tmp_path: Path, taps: list[Recording]) -> None:
    entry = solved(tmp_path, taps, POWER).entries[-1][0]
    problem, command = entry.problem, entry.solution.command
    m = entry.solution.multipliers
    (row,) = problem.limits["power"].rows(problem)
    weight = m.upper("power") - m.lower("power")

    def lagrangian(c: np.ndarray) -> float:
        motion = problem.stage.motion(c)
        return problem.objective(c, problem.accelerations(c)) + float(weight @ row.value(motion, c))

    bare = problem.replaced(problem.limits["power"])
    only = m.with_pair("current", m.upper("current") * 0, m.upper("current") * 0)
    only = only.with_pair("command", only.upper("current"), only.upper("current"))
    g = reduced_gradient(Effect(bare, command), only)
    for k in (5, 12, 20):
        step = 1e-5 * np.eye(command.size)[k]
        slope = (lagrangian(command + step) - lagrangian(command - step)) / 2e-5
        assert g[k] == pytest.approx(slope, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("limit", [JOINT, AREA])
def test_the_library_needs_no_file(tmp_path: Path, taps: list[Recording], limit: str) -> None:
    build = solved(tmp_path, taps, limit)
    (tmp_path / "my_limits.py").unlink()
    proven_again(build.library, tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("LIMITS = []", "no list LIMITS"),
        (
            "import transopt as to\nLIMITS = [to.own_limit('current', 'A', lambda s: s.current, upper=1)]",
            "no other limit",
        ),
        (
            "import transopt as to\nLIMITS = [to.own_limit('x', 'A', lambda s: s.current)]",
            "state lower, upper or both",
        ),
        ("import transopt as to\nLIMITS = [to.own_limit('x', 'A', lambda s: 1.0, upper=1)]", "depends on an output"),
        ("import nothing_of_that_name", "line 1: ModuleNotFoundError"),
    ],
)
def test_a_file_that_is_none_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "bad.py").write_text(text)
    scene = problems.scene_path("wood_on_foam").read_text().replace("[limits]", '[limits]\nown = ["bad.py"]')
    (tmp_path / "mine.toml").write_text(scene)
    with pytest.raises(InputError, match=words) as refused:
        problems.load(tmp_path / "mine.toml")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("judge", [certify, certified], ids=["python", "compiled"])
def test_a_multiplier_of_no_bound_proves_nothing(tmp_path: Path, taps: list[Recording], judge: Judge) -> None:
    """It would cost nothing and could cancel any gradient: the zero command would be optimal, or all infeasible."""
    above = "to.own_limit('above', 'A', lambda s: s.command, upper=100.0)"
    below = "to.own_limit('below', 'A', lambda s: -s.command, upper=100.0)"
    entry = solved(tmp_path, taps, f"{above}, {below}").entries[-1][0]
    assert judge(entry.problem, entry.solution.command, entry.solution.multipliers).accepted
    problem, free = entry.problem, entry.problem.free_stages

    def silenced(m: Multipliers, g: np.ndarray) -> Multipliers:
        m, g = replace(m, hand_over=-g[free:]), np.append(g[:free], 0 * g[free:])
        m = m.with_pair("above", np.maximum(g, 0.0), 0 * g)
        return m.with_pair("below", np.maximum(-g, 0.0), 0 * g)

    for share in (0.0, 0.5, -1.0):
        command, none = share * entry.solution.command, Multipliers.zero(problem)
        forged = silenced(none, reduced_gradient(Effect(problem, command), none))
        assert np.abs(reduced_gradient(Effect(problem, command), forged)).max() < 1e-12
        found = judge(problem, command, forged)
        assert not found.accepted
        assert found.lower_bound <= entry.certificate.objective * (1 + 1e-9)

    beyond = np.append(np.full(free, 5.0), np.zeros(problem.hand_over_samples))
    one = Multipliers.zero(problem).with_pair("current", 0 * beyond, 1.0 * (np.arange(beyond.size) == 60))
    ray = silenced(one, reduced_gradient(Effect(problem, beyond), one, of_limits_alone=True))
    assert not is_infeasible(problem, beyond, ray)


def test_a_point_under_a_limit_that_is_not_convex_is_called_stationary(tmp_path: Path, taps: list[Recording]) -> None:
    """The command has to stay away from 2 A, above or below: which is better, no tangent says."""
    apart = "to.own_limit('apart', 'A', lambda s: ca.fabs(s.current - 2), lower=0.5)"
    build = solved(tmp_path, taps, apart)
    entry = build.entries[-1][0]
    assert entry.status is Status.STATIONARY, entry.shortfalls
    assert not entry.certificate.accepted
    assert entry.prices == []
    library, text = build.library, " ".join(line for line, _ in lines(build, Look.of_build(build), 100))
    assert library is not None
    assert library.claim.startswith("limit that is not convex")
    assert "certified stationary" in text
    assert "optimal" not in text
    proven_again(library, tmp_path)
    said = replace(library, status=np.array([[Status.OPTIMAL.value]] * library.speeds_m_s.size))
    assert any("lower bound" in doubt for doubt in doubts(said))
    assert any(Status.STATIONARY.value in found.shortfalls[0] for found in verify_library(said) if found.shortfalls)


@pytest.mark.parametrize(
    "law",
    [
        lambda s: ca.floor(s.current),
        lambda s: ca.sign(s.current),
        lambda s: s.current > 1,
        lambda s: s.velocity + ca.ceil(s.current),
        lambda s: ca.if_else(s.current > 0, s.velocity, -s.velocity),
    ],
)
def test_what_goes_in_steps_alone_is_refused(law: Callable[[StageSymbols], ca.SX]) -> None:
    with pytest.raises(InputError, match="depends on current only in steps") as refused:
        own_limit("steps", "A", law, upper=1.0)
    assert "casadi.tanh" in str(refused.value)
    assert own_limit("smooth", "A", lambda s: ca.tanh(s.current / 0.1), upper=0.9).coefficients is None


def test_what_is_linear_and_what_is_convex() -> None:
    linear = own_limit("a", "A", lambda s: 2 * s.current - s.command + 0.1 * s.stage, upper=1.0)
    assert linear.coefficients == (2.0, -1.0)
    table = linear.table(3)
    np.testing.assert_allclose(table["offsets"], [0.0, 0.1, 0.2])
    assert own_limit("b", "", lambda s: s.current**2, upper=1.0).convex == (False, True)
    assert own_limit("c", "", lambda s: s.current * s.velocity, upper=1.0).convex == (False, False)
    assert own_limit("d", "", lambda s: s.current**4, upper=1.0).convex == (False, False)  # true, and not proven


@pytest.mark.parametrize(
    ("law", "convex"),
    [
        (lambda s: ca.fabs(s.current - 2), (False, True)),
        (lambda s: 1 - 2 * ca.fabs(s.current), (True, False)),
        (lambda s: ca.fmax(s.current, -s.velocity) / 3, (False, True)),
        (lambda s: ca.fmin(s.current, s.velocity), (True, False)),
        (lambda s: s.current + ca.fabs(s.velocity), (False, True)),
        (lambda s: ca.fabs(s.current) - ca.fabs(s.velocity), (False, False)),
        (lambda s: ca.fabs(s.current * s.velocity), (False, False)),
        (lambda s: s.stage * ca.fabs(s.current), (False, False)),
        (lambda s: s.stage * s.current, (True, True)),
        (lambda s: s.stage * s.current**2, (False, False)),
        (lambda s: (s.current + s.velocity) ** 2 - s.current**2, (False, False)),
        (lambda s: ca.if_else(s.current > 1, s.current**2, s.current), (False, False)),
        (lambda s: ca.if_else(s.stage > 1, s.current, 0.0), (True, True)),
        (lambda s: ca.sqrt(s.current), (False, False)),
    ],
)
def test_a_kink_is_no_straight_line(law: Callable[[StageSymbols], ca.SX], convex: tuple[bool, bool]) -> None:
    found = own_limit("kinked", "A", law, lower=-1.0, upper=1.0)
    assert found.coefficients is None
    assert found.convex == convex
    assert CasadiLaw(found.table(3)["function"]).convex == convex
