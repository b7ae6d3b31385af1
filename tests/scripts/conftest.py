"""Short cases of error against run time, and rows of them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.benches.scripts import script
from tests.conftest import STAGES, ProblemMaker
from transopt.design.context import Context
from transopt.problem.objective.error_term import plain, rapid, rapid_filter
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings

cases, run = script("precision.cases"), script("precision.run")


@pytest.fixture(scope="session")
def short_case(make_problem: ProblemMaker, short_scene: Scene) -> Any:
    problem = make_problem(stages=STAGES)
    return cases.make_case("short", short_scene, problem, 0.4, 5.0)


@pytest.fixture(scope="session")
def whole_case(short_scene: Scene) -> Any:
    """The short case with the tap as it was recorded, which is what a scene asks for at any servo rate."""
    problem = Context.recorded(short_scene, recordings(short_scene)).posed(0.4, 5.0).problem
    return cases.make_case("short", short_scene, problem, 0.4, 5.0)


@pytest.fixture(scope="session")
def tailed_case(make_problem: ProblemMaker, short_scene: Scene) -> Any:
    """The short case with both terms of the error, and as many instants after it, in which the tap goes on."""
    problem = make_problem(stages=STAGES)
    after = make_problem().reference_m_s2[STAGES : 2 * STAGES]
    grid = replace(problem.grid, after_stages=after.size)
    by = rapid_filter("highpass", 20.0, grid.dt_s)
    assert by is not None
    terms = plain(0.09, grid, 4e-3), rapid(by, grid)
    problem = replace(problem, target=replace(problem.target, after_m_s2=after), grid=grid, terms=terms)
    return cases.make_case("tailed", short_scene, problem, 0.4, 5.0)


@pytest.fixture
def rows_of(short_case: Any) -> Callable[..., list[Any]]:
    """Rows of methods on the short case, each setting run once after its two first runs."""

    def measured(*methods: Any) -> list[Any]:
        return run.measure(short_case, methods, run.Effort(0.0, least=1))

    return measured


@pytest.fixture
def user_file(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "mine.py"
        path.write_text(text, encoding="utf-8")
        return path

    return write
