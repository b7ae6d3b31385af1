"""A page of a small scene."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.web.service import Service

if TYPE_CHECKING:
    from tests.transopt.web.windows import Window

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


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Yield a browser without a screen, whose tabs share a process: to start one takes half of a window's time."""
    from tests.transopt.web.windows import CHROMIUM, playwright

    with playwright.sync_playwright() as player:
        started = player.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        tabs = started.new_context(viewport={"width": 1280, "height": 800})
        tabs.new_page()  # as long as one is open the process stays
        yield tabs
        started.close()


@pytest.fixture
def window(browser: Any, address: str) -> "Iterator[Window]":
    """Yield a window of the small page; no error may have come up in it."""
    from tests.transopt.web.windows import Window

    opened = Window(browser, address)
    yield opened
    opened.forgets()
    assert opened.errors == []
    opened.tab.close()
