"""The compiled certificate states what `proof.certify` states, of answers and of what only looks like one."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from problems.stress.draw import drawn
from tests.benches import arms
from tests.benches.limits import aiming_in_window
from tests.conftest import ProblemMaker
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.optimum import optimum
from transopt.plant.discretise import discretise
from transopt.plant.state_space import StateSpace
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify, certify_all
from transopt.proof.effect import TEMPERATURE, Effect
from transopt.solvers import prove
from transopt.solvers.choose import solve
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions
from transopt.solvers.prove import certified

pytestmark = pytest.mark.skipif(not extension.available, reason="the extension is not built")

Tried = tuple[FloatArray, Multipliers]


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """No other certificate is asked."""

    def asked(answers: Sequence[object]) -> list[Certificate]:
        assert not answers, "left to the other certificate"
        return []

    monkeypatch.setattr(prove, "certify_all", asked)


def test_without_the_extension_the_other_certificate_judges(
    make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = make_problem()
    found = solve(problem, SolverOptions())
    monkeypatch.setattr(prove, "available", False)
    monkeypatch.setattr(extension, "_LIBRARY", None)
    assert_same(
        certified(problem, found.command, found.multipliers), certify(problem, found.command, found.multipliers)
    )


def around(problem: TransientProblem, command: FloatArray, m: Multipliers) -> Iterator[Tried]:
    """An answer, and what is a little or far away from it."""
    random, unit = np.random.default_rng(0), problem.limits.input_limit
    yield command, m
    for size in (1e-6, 1e-2):
        yield command + size * unit * random.standard_normal(command.shape), m
        pairs = {
            row: (low, high + size / unit * random.random(high.size)) if row != TEMPERATURE else (low, high)
            for row, (low, high) in m.pairs.items()
        }
        yield command, replace(m, pairs=pairs)
        yield command, replace(m, hand_over=m.hand_over + size / unit * random.standard_normal(m.hand_over.shape))


def assert_same(one: Certificate, other: Certificate) -> None:
    assert one.accepted is other.accepted
    size = max(other.objective, OBJECTIVE_SCALE)
    near = 1e-8 * size + 1e-4 * (other.duality_gap if np.isfinite(other.duality_gap) else 0.0)
    assert one.objective == pytest.approx(other.objective, rel=0, abs=1e-8 * size, nan_ok=True)
    assert one.merit == pytest.approx(other.merit, rel=0, abs=1e-8 * size, nan_ok=True)
    assert one.duality_gap == pytest.approx(other.duality_gap, rel=0, abs=near)
    assert one.lower_bound == pytest.approx(other.lower_bound, rel=0, abs=near)
    assert one.excess == pytest.approx(other.excess, rel=1e-6, abs=1e-6)
    assert one.violations == pytest.approx(other.violations, rel=1e-6, abs=1e-12)


def test_agrees_on_random_problems_and_around_their_answers() -> None:
    judged = accepted = 0
    for index in range(80):
        case = drawn(11, index)
        if case.horizon.stages > 40:
            continue
        try:
            problem = case.problem()
        except InputError:
            continue
        designed = optimum(problem, SolverOptions())
        problem, answer = designed.problem, designed.solution
        for command, multipliers in around(problem, answer.command, answer.multipliers):
            other = certify(problem, command, multipliers)
            assert_same(certified(problem, command, multipliers), other)
            judged, accepted = judged + 1, accepted + other.accepted
    assert 0.05 < accepted / judged < 0.7
    assert judged > 100


@pytest.mark.usefixtures("compiled")
class TestByTheCall:
    @pytest.mark.parametrize(
        "variant",
        [
            {},
            {"current_A": 1.25},
            {"slew_A_per_s": 5000.0},
            {"ideal": True},
            {"stages": 30},
        ],
    )
    def test_agrees_on_a_tap(self, make_problem: ProblemMaker, variant: dict[str, float | bool]) -> None:
        problem = make_problem(0.4, 5.0, **variant)  # type: ignore[arg-type]
        answer = solve(problem)
        for command, multipliers in around(problem, answer.command, answer.multipliers):
            assert_same(certified(problem, command, multipliers), certify(problem, command, multipliers))

    def test_knows_spread_heat_price_and_intensity(self, make_problem: ProblemMaker) -> None:
        problem = make_problem(0.4, 5.0, stages=60)
        others = {"spread": (make_problem(0.4, 3.0).stage,)}, {"heat_price": 1e-3}, {"intensity": 0.3}
        for changed in (replace(problem, **each) for each in others):  # type: ignore[arg-type]
            answer = solve(changed)
            for command, multipliers in around(changed, answer.command, answer.multipliers):
                assert_same(certified(changed, command, multipliers), certify(changed, command, multipliers))


@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("seed", [1, 4, 6])
def test_agrees_on_several_motors(seed: int) -> None:
    problem = arms.drawn(seed)
    answer = solve(problem)
    assert answer.multipliers.largest > 0
    for command, multipliers in around(problem, answer.command, answer.multipliers):
        assert_same(certified(problem, command, multipliers), certify(problem, command, multipliers))


@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("damping", [1 + 1.5e-7, 1 + 3e-7, 1 + 1e-3])
@pytest.mark.parametrize("rate_rad_s", [30.0, 100.0])
def test_does_not_share_the_rounding_of_nearly_parallel_modes(
    make_problem: ProblemMaker, damping: float, rate_rad_s: float
) -> None:
    problem, per_A = make_problem(0.4, 5.0), np.array([[400.0]])
    row = np.array([[-(rate_rad_s**2), -2 * damping * rate_rad_s]])
    plant = StateSpace(np.vstack([[[0.0, 1.0]], row]), np.vstack([[[0.0]], per_A]), row, per_A)
    nearly_critical = replace(problem, stage=discretise(plant, problem.stage.amplifier, problem.grid.dt_s))
    answer = solve(nearly_critical)
    found = certified(nearly_critical, answer.command, answer.multipliers)
    other = certify(nearly_critical, answer.command, answer.multipliers)
    assert found.accepted
    assert other.accepted
    assert other.merit == pytest.approx(found.merit, rel=0, abs=1e-8 * OBJECTIVE_SCALE)


@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("shares", [(0.5, 0.5), (0.2, 0.8), (1.0, 0.0)])
def test_the_worst_of_two_devices(make_problem: ProblemMaker, shares: tuple[float, float]) -> None:
    """Whatever the shares are, the worst device's loss lies above the mean, and the gap holds the difference."""
    problem = make_problem(0.4, 5.0, stages=60)
    several = replace(problem, spread=(make_problem(0.4, 4.0, stages=60).stage,), shares=np.array(shares))
    answer, worst = solve(several), replace(several, worst=True)
    for command, m in around(worst, answer.command, answer.multipliers):
        found = certified(worst, command, m)
        assert_same(found, certify(worst, command, m))
        assert found.duality_gap >= certified(several, command, m).duality_gap


def test_what_the_call_does_not_know_is_left_to_the_other(
    make_problem: ProblemMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = make_problem(0.4, 5.0, stages=60)
    answer, asked = solve(problem), list[Effect]()

    def judge(answers: Sequence[tuple[Effect, Multipliers]]) -> list[Certificate]:
        asked.extend(effect for effect, _ in answers)
        return certify_all(answers)

    monkeypatch.setattr(prove, "certify_all", judge)
    hot = answer.multipliers.with_pair(TEMPERATURE, np.zeros(60), np.ones(60))
    silent = aiming_in_window(problem, np.zeros(60))
    extended = replace(problem, stage=problem.stage.extended())
    with np.errstate(all="raise"):
        certified(problem, answer.command, hot)
        certified(silent, np.zeros(60), Multipliers.zero(silent))
        certified(extended, answer.command.astype(np.longdouble), answer.multipliers)
        assert not certified(problem, np.full(60, np.nan), answer.multipliers).accepted
        assert not certified(problem, answer.command[:-1], answer.multipliers).accepted
    assert len(asked) == 5
    monkeypatch.setattr(prove, "available", False)
    assert certified(problem, answer.command, answer.multipliers).accepted
    assert len(asked) == 6
