"""What runs the suite elsewhere: its orders lose no test, and what a machine cannot give is said."""

from itertools import pairwise
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from tests.benches import shuffled
from tests.benches.scripts import script

suite_anywhere = script("suite_anywhere")

FILES = {"tests/a.py": 6, "tests/b.py": 5, "tests/c.py": 1, "tests/d.py": 4}
NODES = [f"{name}::Test::test_{j}" for name, count in FILES.items() for j in range(count)]


@pytest.fixture
def old() -> suite_anywhere.Probed:
    """A processor of 256 bits, whose numpy has OpenBLAS."""
    return suite_anywhere.Probed(("AVX2", "FMA3"), ("0x1p0",), "Haswell")


def shuffled_nodes(monkeypatch: pytest.MonkeyPatch, seed: int) -> list[str]:
    monkeypatch.setenv(shuffled.VARIABLE, str(seed))
    items = [SimpleNamespace(nodeid=node) for node in NODES]
    shuffled.pytest_collection_modifyitems(items)
    return [item.nodeid for item in items]


def test_another_order_has_the_same_tests_file_by_file(monkeypatch: pytest.MonkeyPatch) -> None:
    orders = [shuffled_nodes(monkeypatch, seed) for seed in (1, 1, 2)]
    assert orders[0] == orders[1]
    assert orders[0] != orders[2]
    for order in orders:
        assert sorted(order) == sorted(NODES)
        files = [node.split("::")[0] for node in order]
        assert files != sorted(files)
        assert sum(one != other for one, other in pairwise(files)) == len(FILES) - 1
        assert [node for node in order if "a.py" in node] != NODES[: FILES["tests/a.py"]]


def test_an_order_is_asked_for_as_the_plugin_reads_it(old: suite_anywhere.Probed) -> None:
    orders = [one for one in suite_anywhere.environments(old) if one.name.startswith("order")]
    assert len(orders) == 3
    for one in orders:
        assert one.arguments == ("-p", shuffled.__name__)
        assert list(one.variables) == [shuffled.VARIABLE]


def test_what_this_processor_has_not_is_skipped_by_name(old: suite_anywhere.Probed) -> None:
    by_name = {environment.name: environment for environment in suite_anywhere.environments(old)}
    assert "AVX512" in suite_anywhere.obstacle(by_name["BLAS for SkylakeX"], old)
    assert "AVX512" in suite_anywhere.obstacle(by_name["numpy without AVX512"], old)
    assert by_name["numpy without AVX2"].variables == {"NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3"}
    other = suite_anywhere.Probed(old.found, old.exponentials, kernel="")
    assert "no OpenBLAS" in suite_anywhere.obstacle(by_name["BLAS for Haswell"], other)


def test_a_warning_of_numpy_stands_in_the_way(old: suite_anywhere.Probed) -> None:
    """The warning is of a feature's name that numpy does not know, as another version may not."""
    unknown = suite_anywhere.Environment("unknown", {"NPY_DISABLE_CPU_FEATURES": "NO_SUCH_FEATURE"})
    assert "NO_SUCH_FEATURE" in suite_anywhere.obstacle(unknown, old)


def test_a_failure_is_told_in_one_line() -> None:
    case = ElementTree.fromstring(
        '<testcase classname="tests.a.Test" name="test_0"><failure message="assert 1 == 2&#10;more"/></testcase>'
    )
    assert suite_anywhere.told_by(case) == "tests.a.Test::test_0: assert 1 == 2"
