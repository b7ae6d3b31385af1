"""Problems of several motors drawn at random, near-singular postures and unequal motors among them: all proven."""

import time
from collections import Counter

import numpy as np
import pytest

from tests.benches.arms import drawn
from transopt.problem.answer import Status
from transopt.proof.effect import Effect
from transopt.proof.farkas import is_infeasible
from transopt.proof.replay import replayed
from transopt.solvers.choose import solve_certified
from transopt.solvers.options import SolverOptions

CASES, EVERY = 1000, 20  # of each seed, and of them those that are replayed as well


def judged(number: int) -> str:
    """What a drawn problem ends as; "bad" where the answer is neither proven nor refused with a proof."""
    problem = drawn(number, fewest=1)
    found = solve_certified([problem], SolverOptions())[0]
    answer = found.solution
    if answer.status is Status.INFEASIBLE:
        return "infeasible" if is_infeasible(problem, answer.command, answer.multipliers) else "bad"
    if not found.proof.accepted:
        return "bad"
    if number % EVERY == 0 and problem.stage.motors > 1:
        (played,) = replayed([problem], answer.command[None])
        predicted = Effect(problem, answer.command).motion.acceleration_m_s2
        if played.shortfalls(problem, answer.command, predicted):
            return "bad"
    return answer.solver


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_every_drawn_problem_is_proven_or_refused_with_a_proof(seed: int) -> None:
    numbers = np.random.default_rng(seed).integers(2**31, size=CASES).tolist()
    start = time.process_time()
    found = Counter(map(judged, numbers))
    print(f"seed {seed}: {dict(found)}, {time.process_time() - start:.0f} s")
    assert found["bad"] == 0
