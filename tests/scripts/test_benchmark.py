"""The problems that the benchmark times."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benches.scripts import script
from transopt.problem.answer import Status
from transopt.scene.scene import Scene
from transopt.solvers import riccati
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions

cases = script("common.benchmark_cases")
pytestmark = pytest.mark.skipif(not riccati.available, reason="the extension is not built")


def test_iterations_do_not_grow_with_the_length_of_a_row_of_taps(scene: Scene) -> None:
    """From the third tap on nothing new happens: how long a horizon takes grows as its stages do."""
    in_a_row, tap = script("benchmark").in_a_row, cases.entry(scene, 0.4, 5.0)
    few, many = (solve(in_a_row(tap, taps * tap.grid.stages), SolverOptions("riccati")) for taps in (3, 6))
    assert few.status is many.status is Status.OPTIMAL
    assert many.iterations <= few.iterations + 2


def test_the_answer_is_the_ratios_of_the_saturated_tap() -> None:
    """The page has them below its table, so that both pages name one figure."""
    times = {"riccati": 2.0, "piqp": 130.0, "opti-ipopt": 1700.0}
    one = cases.row("saturated", "riccati", "", cases.STAGES, np.ones(1))
    rows = [replace(one, method=name, median_ms=each) for name, each in times.items()]
    rows.append(replace(one, case="thermal", median_ms=9.0))
    told = "65.0 times as fast as the PIQP wheel on a saturated tap, 850.0 times as Opti and IPOPT."
    assert script("benchmark").answer(rows) == told
