"""Certificates: what they accept, and what must never be claimed."""

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from problems.stress.cases import StressCase
from problems.stress.parts import Coil, Current, Demand, Horizon
from tests.benches.limits import aiming_in_window, with_limit
from tests.conftest import ProblemMaker
from transopt.base.errors import InputError
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers, Solution, Status
from transopt.problem.limits import KINDS
from transopt.problem.limits.limit import SIDES
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import binding_limits, certify, certify_all, movement_bound, reduced_gradient
from transopt.proof.effect import Effect, effects, inside
from transopt.proof.farkas import is_infeasible
from transopt.solvers import unlimited
from transopt.solvers.choose import capable, check_name, solve
from transopt.solvers.options import SolverOptions
from transopt.solvers.program import state_program
from transopt.solvers.prove import certified
from transopt.solvers.statement import state

Judge = Callable[[TransientProblem, np.ndarray, Multipliers], Certificate]
VARIANTS = [
    {"speed_m_s": 0.2, "grip_N": 1.0},
    {"speed_m_s": 0.4, "grip_N": 3.0},
    {"speed_m_s": 0.4, "grip_N": 5.0, "current_A": 1.25},
    {"speed_m_s": 0.4, "grip_N": 5.0, "slew_A_per_s": 5000.0},
    {"speed_m_s": 0.4, "grip_N": 5.0, "ideal": True},
    {"speed_m_s": 0.4, "grip_N": 3.0, "stages": 30},
]


@pytest.fixture(scope="module")
def saturated(make_problem: ProblemMaker) -> tuple[TransientProblem, Solution]:
    problem = make_problem(0.4, 5.0)
    return problem, solve(problem)


@pytest.mark.parametrize("variant", VARIANTS)
def test_two_methods_agree_and_are_certified(make_problem: ProblemMaker, variant: dict) -> None:
    problem = make_problem(**variant)
    objectives = []
    for solver in ("casadi-piqp", "casadi-ipopt"):
        solution = solve(problem, SolverOptions(solver))
        certificate = certify(problem, solution.command, solution.multipliers)
        assert solution.status is Status.OPTIMAL
        assert certificate.accepted
        assert certificate.violation("A") <= 1e-6
        assert certificate.relative_gap <= 1e-6
        objectives.append(certificate.objective)
    assert abs(objectives[0] - objectives[1]) <= 1e-6 * max(objectives[0], 1e-3)


def test_certified_lower_bound_is_below_every_feasible_command(saturated: tuple[TransientProblem, Solution]) -> None:
    """J - gap bounds the optimum: random feasible commands, also close to the optimum, never fall below it."""
    problem, solution = saturated
    certificate = certify(problem, solution.command, solution.multipliers)
    random = np.random.default_rng(11)
    for size in (1e-4, 1e-2, 1.0):
        other = solution.command + size * random.standard_normal(problem.grid.stages)
        other[problem.free_stages :] = 0
        # Commands scaled into the box stay feasible, because zero is.
        _, current = problem.stage.rollout(other)
        other *= min(1.0, 4 / np.abs(current).max(), 6 / np.abs(other).max())
        acceleration, _ = problem.stage.rollout(other)
        assert problem.objective(other, acceleration) >= certificate.objective - certificate.duality_gap


@pytest.mark.parametrize("rho", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("size_A", [1e-7, 1e-5, 1e-3])
def test_the_bound_by_the_movement_holds_and_falls_with_the_square(
    make_problem: ProblemMaker, rho: float, size_A: float
) -> None:
    """The optimum itself is a command that the bound of every other one has to spare."""
    problem = replace(make_problem(0.2, 3.0), rho=rho)
    free = unlimited.solve([problem])[0]
    least = certify(problem, free.command, free.multipliers).objective
    wave = np.sin(np.linspace(0, 20 * np.pi, problem.grid.stages))
    wave[problem.free_stages :] = 0
    by_first, by_movement = [], []
    for off_A in (size_A, size_A / 10):
        command = free.command + off_A * wave
        acceleration, _ = problem.stage.rollout(command)
        g = reduced_gradient(Effect(problem, command), free.multipliers)
        by_first.append(float(np.abs(g) @ (problem.command_bound + np.abs(command))))
        by_movement.append(movement_bound(problem, g))
        proof = certify(problem, command, free.multipliers)
        assert problem.objective(command, acceleration) - by_movement[-1] <= least + 1e-14
        assert proof.lower_bound <= least + 1e-14
        assert proof.duality_gap <= by_first[-1] * (1 + 1e-12)
    assert by_first[1] == pytest.approx(by_first[0] / 10, rel=0.05)
    assert by_movement[1] == pytest.approx(by_movement[0] / 100, rel=0.05)


def test_without_a_weight_of_the_movement_only_the_first_bound_is_there(make_problem: ProblemMaker) -> None:
    problem = replace(make_problem(0.2, 3.0), rho=0.0)
    command = unlimited.solve([problem])[0].command + 1e-4
    command[problem.free_stages :] = 0
    proof = certify(problem, command, Multipliers.zero(problem))
    assert 1e-6 < proof.relative_gap < np.inf


@pytest.mark.parametrize("variant", VARIANTS)
def test_certificate_agrees_with_the_casadi_statement(make_problem: ProblemMaker, variant: dict) -> None:
    """Objective, dynamics and reduced gradient from CasADi's own functions, to 1e-12."""
    problem = make_problem(**variant)
    solution = solve(problem)
    statement = state(problem)
    shape, stage, p = statement.shape, statement.stage, statement.p
    program = state_program(shape)
    nz = shape.variables - 1
    z = np.zeros((shape.stages + 1, nz))
    movement = np.diff(solution.command, prepend=0.0) / stage.input_scale
    for k in range(shape.stages):
        z[k + 1] = stage.A @ z[k] + stage.A[:, -1] * movement[k]
    x = np.column_stack([movement, z[1:]]).ravel()

    values = ca.Function("values", [program.x, program.p], [program.f, program.g, ca.gradient(program.f, program.x)])
    f, g, by_x = (np.asarray(value).ravel() for value in values(x, p))
    motion = problem.stage.motion(solution.command)
    objective = problem.objective(solution.command, motion.acceleration_m_s2)
    assert f[0] * OBJECTIVE_SCALE == pytest.approx(objective, rel=1e-12, abs=1e-12)
    dynamics = program.rows["dynamics"]
    assert dynamics.stop - dynamics.start == shape.stages * nz
    assert np.abs(g[dynamics]).max() < 1e-12
    assert np.abs(g[program.rows["hand_over"]]).max() < 1e-12
    np.testing.assert_allclose(statement.command(x), solution.command, rtol=0, atol=1e-12)

    jacobian = program.qp_data(p=p)["A"].sparse().toarray()[dynamics] if shape.stages <= 60 else None
    if jacobian is not None:
        # Reduced gradient by the null space of the dynamics: x = X c, with dc_k = c_k - c_(k-1).
        states = np.delete(np.arange(x.size), np.arange(0, x.size, nz + 1))
        moves = np.arange(0, x.size, nz + 1)
        sensitivity = -np.linalg.solve(jacobian[:, states], jacobian[:, moves])
        by_movement = by_x[moves] + sensitivity.T @ by_x[states]
        by_command = (by_movement - np.append(by_movement[1:], 0.0)) * OBJECTIVE_SCALE / stage.input_scale
        plain = reduced_gradient(Effect(problem, solution.command), Multipliers.zero(problem))
        np.testing.assert_allclose(plain, by_command, atol=1e-12)


# Every array that multipliers may have, of limits that the problem does not have too.
ALL_PARTS = [f"{row} {side}" for kind in KINDS for row in kind.row_names for side in SIDES] + ["hand_over", "slope"]
PARTS = ["current upper", "command upper", "command lower", "hand_over"]


def multipliers_at(m: Multipliers, part: str) -> np.ndarray:
    """One array of the multipliers: "hand_over", "slope", or a row and its side."""
    row, _, side = part.partition(" ")
    return getattr(m, side)(row) if side else getattr(m, part)


def with_multipliers(m: Multipliers, part: str, array: np.ndarray) -> Multipliers:
    """Put another array in the place of the one that `multipliers_at` gives."""
    row, _, side = part.partition(" ")
    if not side:
        return replace(m, **{part: array})
    return m.with_pair(row, *((array, m.upper(row)) if side == "lower" else (m.lower(row), array)))


@pytest.mark.parametrize("judge", [certify, certified], ids=["python", "compiled"])
class TestTampering:
    """What the certificate is for: answers that are not what they claim to be."""

    @pytest.mark.parametrize(
        "change",
        [
            lambda c: c - 0.01 * (np.arange(c.size) == 5),
            lambda c: c - 0.01 * (np.arange(c.size) == 300),
            lambda c: np.roll(c, 1),
            np.negative,
            lambda c: np.where(np.arange(c.size) == 100, np.nan, c),
            lambda c: c[:-1],
        ],
        ids=["early", "late", "one tick late", "flipped", "nan", "too short"],
    )
    def test_another_command(
        self, judge: Judge, saturated: tuple[TransientProblem, Solution], change: Callable[[np.ndarray], np.ndarray]
    ) -> None:
        problem, solution = saturated
        assert judge(problem, solution.command, solution.multipliers).accepted
        assert not judge(problem, change(solution.command), solution.multipliers).accepted

    @pytest.mark.parametrize("part", PARTS)
    def test_missing_multiplier(self, judge: Judge, saturated: tuple[TransientProblem, Solution], part: str) -> None:
        problem, solution = saturated
        array = multipliers_at(solution.multipliers, part)
        assert np.any(array != 0), "the limit does not bind: the test shows nothing"
        missing = with_multipliers(solution.multipliers, part, np.zeros_like(array))
        assert not judge(problem, solution.command, missing).accepted

    @pytest.mark.parametrize("part", ["current upper", "command upper", "hand_over"])
    def test_negated_multiplier(self, judge: Judge, saturated: tuple[TransientProblem, Solution], part: str) -> None:
        problem, solution = saturated
        negated = with_multipliers(solution.multipliers, part, -multipliers_at(solution.multipliers, part))
        assert not judge(problem, solution.command, negated).accepted

    def test_swapped_multipliers(self, judge: Judge, saturated: tuple[TransientProblem, Solution]) -> None:
        problem, solution = saturated
        m = solution.multipliers
        swapped = m.with_pair("current", m.upper("current"), m.lower("current"))
        assert not judge(problem, solution.command, swapped).accepted

    @pytest.mark.parametrize("part", ALL_PARTS)
    def test_nan_in_a_multiplier(self, judge: Judge, saturated: tuple[TransientProblem, Solution], part: str) -> None:
        problem, solution = saturated
        array = multipliers_at(solution.multipliers, part).copy()
        array[-1] = np.nan
        wrong = with_multipliers(solution.multipliers, part, array)
        assert not judge(problem, solution.command, wrong).accepted

    def test_clipped_unlimited_optimum(self, judge: Judge, make_problem: ProblemMaker) -> None:
        problem = make_problem(0.4, 5.0)
        clipped = np.clip(unlimited.solve([problem])[0].command, -4, 4)
        assert not judge(problem, clipped, Multipliers.zero(problem)).accepted

    def test_command_that_does_not_end(self, judge: Judge, saturated: tuple[TransientProblem, Solution]) -> None:
        problem, solution = saturated
        command = solution.command.copy()
        command[-3] = 1e-3
        certificate = judge(problem, command, solution.multipliers)
        assert certificate.violation("A") >= 1e-3
        assert not certificate.accepted


def test_zero_reference_is_the_zero_waveform(make_problem: ProblemMaker) -> None:
    problem = aiming_in_window(make_problem(), np.full(600, 1e-9))
    solution = solve(problem)
    assert solution.status is Status.OPTIMAL
    assert not solution.command.any()
    assert certify(problem, solution.command, solution.multipliers).accepted
    assert not certify(problem, solution.command + 1e-3, solution.multipliers).accepted


def test_a_longer_horizon_is_certified_too(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.4, 5.0, stages=3000)
    solution = solve(problem)
    assert certify(problem, solution.command, solution.multipliers).accepted


def test_iteration_limit_is_not_optimal(make_problem: ProblemMaker) -> None:
    for solver in ("casadi-piqp", "casadi-ipopt"):
        solution = solve(make_problem(0.4, 5.0), SolverOptions(solver, max_iterations=2))
        assert solution.status is Status.ITERATION_LIMIT
        assert solution.message


def test_binding_names_limit_sign_and_time(saturated: tuple[TransientProblem, Solution]) -> None:
    problem, solution = saturated
    text = binding_limits(problem, solution.command, solution.multipliers)
    _, current = problem.stage.rollout(solution.command)
    at_limit = problem.grid.switching_times_s[current > 4 - 1e-6] * 1e3
    assert f"current +4 A at {at_limit[0]:.2f} to {at_limit[-1]:.2f} ms" in text
    assert "current -4 A" not in text


def test_options_are_checked() -> None:
    with pytest.raises(InputError, match="--solver osqp: unknown; choose one of riccati, casadi-piqp, casadi-ipopt"):
        check_name("osqp")
    with pytest.raises(InputError, match=r"--solver-tolerance 2: must be between 0 and 1"):
        SolverOptions(tolerance=2.0)


def test_bad_problem_data_is_refused(make_problem: ProblemMaker) -> None:
    problem = make_problem()
    with pytest.raises(InputError, match="reference_m_s2 holds a number that is not finite"):
        aiming_in_window(problem, np.full(600, np.nan))
    with pytest.raises(InputError, match=r"weights of the plain term has shape \(3,\)"):
        replace(problem, terms=(ErrorTerm("plain", np.ones(3)),))
    with pytest.raises(InputError, match="hand_over_samples = 0"):
        replace(problem, hand_over_samples=0)


def test_multipliers_beyond_all_numbers_prove_nothing(saturated: tuple[TransientProblem, Solution]) -> None:
    """A method that broke down may leave 1e300: no warning, no NaN, and no proof."""
    problem, solution = saturated
    huge = replace(solution.multipliers, hand_over=np.full(problem.hand_over_samples, 1e308))
    certificate = certify(problem, solution.command, huge)
    assert not certificate.accepted
    assert certificate.duality_gap == np.inf
    assert certificate.lower_bound == -np.inf


def test_effects_side_by_side_are_those_of_each_command(make_problem: ProblemMaker) -> None:
    problems = [make_problem(), make_problem(speed_m_s=0.2), make_problem(grip_N=1.0)]
    problems.append(replace(problems[0], rho=2 * problems[0].rho))
    random = np.random.default_rng(0)
    asked = [(problem, random.standard_normal(problem.grid.stages)) for problem in problems]
    for found, (problem, command) in zip(effects(asked), asked, strict=True):
        assert found.problem is problem
        assert found.command is command
        alone = Effect(problem, command).lasting
        for name in ("acceleration_m_s2", "plant_input", "velocity_m_s", "encoder_m"):
            wanted = getattr(alone, name)
            size = max(float(np.abs(wanted).max()), 1.0)
            np.testing.assert_allclose(getattr(found.lasting, name), wanted, rtol=0, atol=1e-12 * size)


def test_certificates_side_by_side_are_those_of_each_command(
    make_problem: ProblemMaker, walled: Callable[..., TransientProblem]
) -> None:
    """The commands are taps of one grip and of others, one over a wall, wrong answers, and one that is not finite."""
    problems = [make_problem(0.4, 5.0), make_problem(0.2, 5.0), make_problem(0.4, 1.0), walled(300.0, 0.2)]
    problems.append(replace(problems[1], intensity=0.005, intensity_dB=1.0))
    problems.append(replace(problems[0], target=replace(problems[0].target, window_m_s2=0 * problems[0].rest)))
    solutions = [solve(problem) for problem in problems]
    answers = [(Effect(of, each.command), each.multipliers) for of, each in zip(problems, solutions, strict=True)]
    (first, _), multipliers = answers[0], solutions[1].multipliers
    half = Effect(problems[0], 0.5 * first.command)
    answers += [(half, multipliers), (Effect(problems[1], first.command + np.nan), multipliers)]
    answers += [
        (effect, multipliers.with_pair("current", 1e300 * first.command, -first.command)) for effect in (first, half)
    ]
    for found, (effect, own) in zip(certify_all(answers), answers, strict=True):
        alone = certify(effect.problem, effect.command, own)
        assert found.accepted == alone.accepted
        for name in ("objective", "merit", "excess", "duality_gap", "dual_residual", "lower_bound"):
            assert getattr(found, name) == pytest.approx(getattr(alone, name), rel=1e-9, abs=1e-12, nan_ok=True), name


COIL = Coil(below_K=0.0005, nodes=1, tau_w_s=12.0, warming=50.0)


def with_headroom(problem: TransientProblem, headroom_K: np.ndarray) -> TransientProblem:
    thermal = problem.thermal
    return problem.replaced(replace(thermal, model=replace(thermal.model, headroom_K=headroom_K)))


@pytest.fixture(scope="module")
def warm() -> TransientProblem:
    """A convex coil that doing nothing keeps cool, and the limit current does not."""
    case = StressCase("coil", current=Current(limit_A=1e-3), horizon=Horizon(stages=40), coil=COIL)
    problem = case.problem()
    thermal = problem.thermal
    problem = with_limit(problem, thermal.relaxed())
    rest, full = np.zeros(40), np.full(40, 1e-3)
    full[problem.free_stages :] = 0.0
    idle, hot = (problem.thermal.temperatures_C(problem.stage.motion(c).plant_input, c) for c in (rest, full))
    limit = idle + 0.2 * (hot - idle).max()
    problem = with_headroom(problem, limit - problem.thermal.model.unpowered_C)
    assert inside(problem, rest)
    assert not inside(problem, full)
    return problem


class TestFarkas:
    def test_no_sign_of_the_ripple_proves_a_feasible_coil_infeasible(self, warm: TransientProblem) -> None:
        """The slope of |mean i| may be anything; what it leaves below the size has to count."""
        full = np.full(40, 1e-3)
        full[warm.free_stages :] = 0.0
        sign = np.sign(warm.stage.motion(full).plant_input)
        last = np.eye(40)[-1]
        for slope in (np.zeros(40), sign, -sign, *np.random.default_rng(1).uniform(-1, 1, (20, 40))):
            ray = replace(Multipliers.zero(warm), slope=slope).with_pair("temperature", np.zeros(40), last)
            assert not is_infeasible(warm, full, ray)

    def test_a_coil_that_nothing_keeps_cool_is_proven(self, warm: TransientProblem) -> None:
        frozen = with_headroom(warm, warm.thermal.model.headroom_K - 1.0)
        rest = np.zeros(40)
        ray = Multipliers.zero(frozen).with_pair("temperature", rest, np.eye(40)[-1])
        assert is_infeasible(frozen, rest, ray)

    @pytest.mark.parametrize("length", [1e-8, 1.0, 1e8])
    def test_how_long_a_ray_is_does_not_matter(self, warm: TransientProblem, length: float) -> None:
        frozen, rest = with_headroom(warm, warm.thermal.model.headroom_K - 1.0), np.zeros(40)
        hot = Multipliers.zero(frozen).with_pair("temperature", rest, length * np.eye(40)[-1])
        assert is_infeasible(frozen, rest, hot.with_pair("current", 1e-6 * length * np.ones(40), rest))


def test_no_multiplier_counts_where_there_is_no_limit() -> None:
    """Half the optimum with a multiplier on an infinite headroom that cancels its gradient is no optimum."""
    case = StressCase(
        "forged",
        current=Current(limit_A=4.0, pole_Hz=None),
        horizon=Horizon(stages=2, hand_over=1, lead_s=0.0),
        coil=Coil(below_K=20.0, nodes=1, tau_w_s=12.0, warming=0.1, tap_share=0.05),
        demand=Demand(kind="constant", speed_m_s=0.01),
    )
    problem = case.problem()
    thermal = problem.thermal
    problem = with_headroom(with_limit(problem, thermal.relaxed()), np.array([np.inf, 5.0]))
    command = 0.5 * solve(problem.without("temperature")).command
    motion = problem.stage.motion(command)
    slope = np.sign(problem.thermal.model.heating.mean_current(motion.plant_input, command))
    forged = replace(Multipliers.zero(problem), slope=slope)
    plain = reduced_gradient(Effect(problem, command), forged)
    unit = forged.with_pair("temperature", np.zeros(2), np.array([1.0, 0.0]))
    by_unit = reduced_gradient(Effect(problem, command), unit) - plain
    forged = forged.with_pair("temperature", np.zeros(2), np.array([-plain[0] / by_unit[0], 0.0]))
    forged = replace(forged, hand_over=-reduced_gradient(Effect(problem, command), forged)[1:])
    assert not certify(problem, command, forged).accepted


def test_too_many_devices_give_way_to_another_method(make_problem: ProblemMaker) -> None:
    problem = make_problem(0.4, 3.0, stages=30)
    spread = tuple(make_problem(0.4, grip, stages=30).stage for grip in np.linspace(1.0, 5.0, 20))
    many = replace(problem, spread=spread)
    assert "riccati" not in capable(many)
    answer = solve(many, SolverOptions())
    assert certify(many, answer.command, answer.multipliers).accepted
