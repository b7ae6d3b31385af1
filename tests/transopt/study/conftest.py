"""A small study, and one folder of its rows."""

from pathlib import Path

import pytest

from tests.benches.study import serial, short_scene, two_keys
from transopt.scene.scene import Scene
from transopt.study.plan import Plan
from transopt.study.session import run_plan


@pytest.fixture(scope="session")
def short(scene: Scene) -> Scene:
    return short_scene(scene)


@pytest.fixture(scope="session")
def small(short: Scene) -> Plan:
    return two_keys(short)


@pytest.fixture(scope="session")
def finished(small: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all rows of the small study; not to be changed."""
    out = tmp_path_factory.mktemp("study") / "small"
    run_plan(small, out, serial())
    return out
