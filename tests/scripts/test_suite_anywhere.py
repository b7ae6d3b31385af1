"""What runs the suite elsewhere: its orders lose no test, and what a machine cannot give is said."""

from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest

FILES = {"tests/a.py": 6, "tests/b.py": 5, "tests/c.py": 1, "tests/d.py": 4}
NODES = [f"{name}::Test::test_{j}" for name, count in FILES.items() for j in range(count)]


@pytest.fixture
def old(scripts: Any) -> Any:
    """A processor of 256 bits, whose numpy has OpenBLAS."""
    return scripts.suite_anywhere.Probed(("AVX2", "FMA3"), ("0x1p0",), "Haswell")


def shuffled(scripts: Any, monkeypatch: pytest.MonkeyPatch, seed: int) -> list[str]:
    monkeypatch.setenv(scripts.shuffled.VARIABLE, str(seed))
    items = [SimpleNamespace(nodeid=node) for node in NODES]
    scripts.shuffled.pytest_collection_modifyitems(items)
    return [item.nodeid for item in items]


def test_another_order_has_the_same_tests_file_by_file(scripts: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    orders = [shuffled(scripts, monkeypatch, seed) for seed in (1, 1, 2)]
    assert orders[0] == orders[1]
    assert orders[0] != orders[2]
    for order in orders:
        assert sorted(order) == sorted(NODES)
        files = [node.split("::")[0] for node in order]
        assert files != sorted(files)
        assert sum(one != other for one, other in pairwise(files)) == len(FILES) - 1
        assert [node for node in order if "a.py" in node] != NODES[: FILES["tests/a.py"]]


def test_every_environment_has_a_name_of_its_own(scripts: Any, old: Any) -> None:
    names = [environment.name for environment in scripts.suite_anywhere.environments(old)]
    assert len(set(names)) == len(names)


def test_what_this_processor_has_not_is_skipped_by_name(scripts: Any, old: Any) -> None:
    script = scripts.suite_anywhere
    by_name = {environment.name: environment for environment in script.environments(old)}
    assert "AVX512" in script.obstacle(by_name["BLAS for SkylakeX"], old)
    assert "AVX512" in script.obstacle(by_name["numpy without AVX512"], old)
    assert by_name["numpy without AVX2"].variables == {"NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3"}
    other = script.Probed(old.found, old.exponentials, kernel="")
    assert "no OpenBLAS" in script.obstacle(by_name["BLAS for Haswell"], other)


def test_a_warning_of_numpy_stands_in_the_way(scripts: Any, old: Any) -> None:
    """Of a name that it does not know, as another version may not."""
    script = scripts.suite_anywhere
    unknown = script.Environment("unknown", {"NPY_DISABLE_CPU_FEATURES": "NO_SUCH_FEATURE"})
    assert "NO_SUCH_FEATURE" in script.obstacle(unknown, old)


def test_a_failure_is_told_in_one_line(scripts: Any) -> None:
    case = ElementTree.fromstring(
        '<testcase classname="tests.a.Test" name="test_0"><failure message="assert 1 == 2&#10;more"/></testcase>'
    )
    assert scripts.suite_anywhere.told_by(case) == "tests.a.Test::test_0: assert 1 == 2"
