"""What a refinement truly does, in short; the whole is scripts/refinement.py."""

import numpy as np
import pytest
import refinement
from refinement import NodeErrors, Outcome

from tests.benches.libraries import part_of
from tests.benches.other_device import Device, NoCompilerError, simulate
from transopt.library.library import Library


@pytest.fixture(scope="module")
def small(library: Library) -> Library:
    """0.2 and 0.4 m/s at 1 and 5 N: two nodes that no limit binds, and two that have one."""
    return part_of(library, [1, 3], [0, 2])


@pytest.fixture(autouse=True)
def _compiled() -> None:
    try:
        simulate(Device(), np.zeros(1))
    except NoCompilerError as missing:
        pytest.skip(str(missing))


@pytest.mark.parametrize("case", ["right", "varying"])
def test_where_the_model_is_right_no_node_is_truly_worse(small: Library, case: str) -> None:
    found = refinement.outcome_of(small, case, 21, taps=3, rounds=3)
    assert max(node.worse for node in found.nodes) <= refinement.WORSE


def test_friction_is_taken_out(small: Library) -> None:
    found = refinement.outcome_of(small, "friction", 21, taps=6, rounds=6)
    free = [node for node in found.nodes if not node.limited]
    assert min(node.before for node in free) > 0.03
    assert max(node.after for node in free) <= refinement.WITH_FRICTION
    assert all(node.refined and node.worse < 0 for node in free)
    assert all(node.after < node.before for node in found.nodes)


def test_a_mismatch_is_taken_out(small: Library) -> None:
    found = refinement.outcome_of(small, "mismatch", 22, taps=3, rounds=3)
    free = [node for node in found.nodes if not node.limited]
    assert all(node.after < 0.6 * node.before for node in free)
    assert all(node.worse <= refinement.WORSE for node in found.nodes)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_all_cases_are_as_asked(library: Library) -> None:
    found = [
        refinement.outcome_of(library, case, seed, 6, 6) for case in refinement.CASES for seed in (11, 12, 13, 14)
    ]
    assert [what for what, *_, as_asked in refinement.figures(found) if not as_asked] == []


def test_what_was_asked_and_what_was_reached() -> None:
    def node(before: float, after: float, *, limited: bool = False) -> NodeErrors:
        return NodeErrors(0.2, 3.0, limited, before, after, before, after, float("nan"), True, "")

    right = Outcome("right", 1, 3, [node(0.01, 0.0101), node(0.01, 0.0103)])
    friction = Outcome("friction", 1, 5, [node(0.05, 0.013), node(0.2, 0.15, limited=True)])
    asked = refinement.figures([right, friction])
    assert [reached for _, _, reached, _ in asked] == ["0.030 points", "1.30 %"]
    assert [as_asked for *_, as_asked in asked] == [False, True]
    assert refinement.rows([friction])[0][4:] == ["12.50 → 8.15", "5.00 → 1.30", "20.00 → 15.00", "0.000"]
    assert refinement.node_rows([right])[0][:3] == ["right", "0.2 m/s, 3 N", "1 of 1"]
