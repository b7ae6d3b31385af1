"""A pytest plugin that takes the tests in another order: files first, then the tests within each file.

    SHUFFLED=7 python -m pytest -p tests.benches.shuffled

A test that passes only after another one hides a state that both share. The same number gives the same order in
every worker of pytest-xdist, which insists on that. Tests of one file stay together: a fixture of a module is then
made once, and `--dist loadfile` would keep them together anyway.
"""

import os
import random

import pytest

VARIABLE = "SHUFFLED"  # holds the number that the order follows from


@pytest.hookimpl(trylast=True)  # after pytest itself has sorted the tests by their fixtures
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    by_file: dict[str, list[pytest.Item]] = {}
    for item in items:
        by_file.setdefault(item.nodeid.split("::")[0], []).append(item)
    order = random.Random(int(os.environ[VARIABLE]))
    files = list(by_file.values())
    order.shuffle(files)
    for tests in files:
        order.shuffle(tests)
    items[:] = [item for tests in files for item in tests]
