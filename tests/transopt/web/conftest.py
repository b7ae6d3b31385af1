"""A page of a small scene."""

from collections.abc import Iterator

import pytest

from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.web.service import Service

MISSING = "the extra `page` is not installed"


@pytest.fixture(scope="session")
def small() -> Scene:
    """Two speeds and one grip of the default scene: its limit binds at the faster."""
    return with_values(load_scene("wood_on_foam"), {"grid.speeds_m_s": [0.2, 0.4], "grid.grips_N": [3.0]})


@pytest.fixture
def service(small: Scene) -> Service:
    return Service(small)


@pytest.fixture(scope="module")
def address(small: Scene) -> Iterator[str]:
    """Yield the address of a page that is served to all tests of a file; each window has its own sliders."""
    for name in ("starlette", "uvicorn", "websockets"):
        pytest.importorskip(name, reason=MISSING)
    from transopt.web.serve import Page

    with Page(small) as served:
        yield served.address
