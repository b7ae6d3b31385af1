"""The problems that the benchmark times."""

import pytest

from tests.benches.scripts import script
from transopt.problem.answer import Status
from transopt.scene.scene import Scene
from transopt.solvers import riccati
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

pytestmark = pytest.mark.skipif(not riccati.available, reason="the extension is not built")


def test_iterations_do_not_grow_with_the_length_of_a_row_of_taps(scene: Scene) -> None:
    """From the third tap on nothing new happens: how long a horizon takes grows as its stages do."""
    in_a_row, tap = script("benchmark").in_a_row, script("common.benchmark_cases").entry(scene, 0.4, 5.0)
    few, many = (solve(in_a_row(tap, taps * tap.grid.stages), SolverOptions("riccati")) for taps in (3, 6))
    assert few.status is many.status is Status.OPTIMAL
    assert many.iterations <= few.iterations + 2
