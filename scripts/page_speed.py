"""Measures the page's response time in Chromium: from an input event to the frame after the plots are drawn.

    python scripts/page_speed.py

With the page in a process of its own, as `transopt page` has it, it drags the slider of the current limit of
`wood_on_foam`, with one tap and with all twelve: with single events, and with events as fast as the browser accepts
them. It also measures the time from opening the address to the first picture. It needs the extra `page`, playwright
and chromium. No test asserts these times.
"""

import math
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from common.command import at_least, run
from common.page import PageFile, write_part
from playwright.sync_api import Browser, expect, sync_playwright
from playwright.sync_api import Page as Tab

from transopt.base.writing import table
from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.web.serve import Page

SCENE = "wood_on_foam"
SLIDER = "[id='of-limits.current_A']"
FIRST = "performance.getEntriesByName('first picture')[0].startTime"
MEASURED = "performance.getEntriesByType('measure').map(entry => [entry.startTime, entry.duration])"
SETTLED_MS = 30_000
SINGLE_S = 0.12  # between events that come one by one
BOUNDS_MS = {1: 33, 12: 66}


@dataclass(frozen=True)
class Came:
    """Times of one drag.

    Attributes
    ----------
    taps : number of taps in the scene.
    first_ms : time from opening the page to the frame with the first picture of all taps.
    single_ms : times from single events to the frame.
    dragged_ms : the same for events answered during a continuous drag.
    per_s : answers drawn per second of that drag.
    """

    taps: int
    first_ms: float
    single_ms: list[float]
    dragged_ms: list[float]
    per_s: float


def _serve(scene: Scene, told: Connection) -> None:
    page = Page(scene)
    told.send(page.address)
    page.serve()


@contextmanager
def served(scene: Scene) -> Iterator[str]:
    """Serve a scene in another process, which does not wait for this one's interpreter, and yield its address."""
    spawning = get_context("spawn")
    told, tells = spawning.Pipe(duplex=False)
    process = spawning.Process(target=_serve, args=(scene, tells))
    process.start()
    try:
        yield told.recv()
    finally:
        process.terminate()
        process.join()


def measured(tab: Tab, address: str, taps: int, events: int) -> Came:
    """Open the page, drag its slider, and read the times that the page measured."""
    tab.goto(address)
    expect(tab.locator("#state")).to_contain_text("replayed", timeout=SETTLED_MS)
    box = tab.locator(SLIDER).bounding_box()
    assert box is not None
    y, width = box["y"] + box["height"] / 2, box["width"]

    def x(j: int) -> float:
        return float(box["x"] + width * (0.55 + 0.2 * math.sin(0.37 * j)))

    def drag(count: int, pause_s: float) -> tuple[list[float], float]:
        tab.mouse.move(x(0), y)
        tab.mouse.down()
        tab.evaluate("performance.clearMeasures()")
        began = time.perf_counter()
        for j in range(1, count + 1):
            tab.mouse.move(x(j), y)
            time.sleep(pause_s)
        lasted = time.perf_counter() - began
        found = tab.evaluate(MEASURED)
        tab.mouse.up()
        expect(tab.locator("#state")).to_contain_text("replayed", timeout=SETTLED_MS)
        return [duration for _, duration in found], len(found) / lasted

    first = tab.evaluate(FIRST)
    drag(30, 0.03)  # warm-up
    single, _ = drag(events, SINGLE_S)
    dragged, per_s = drag(4 * events, 0.008)
    return Came(taps, first, single, dragged, per_s)


def pictured(browser: Browser, address: str, picture: Path) -> None:
    """Write a picture of a page at rest."""
    tab = browser.new_page(viewport={"width": 1280, "height": 960})
    tab.goto(address)
    expect(tab.locator("#state")).to_contain_text("replayed", timeout=SETTLED_MS)
    expect(tab.locator("#error-key option").first).to_contain_text("%")
    tab.screenshot(path=picture)
    tab.close()


def row(came: Came) -> list[str]:
    p50, p95 = np.percentile(came.single_ms, [50, 95])
    q50, q95 = np.percentile(came.dragged_ms, [50, 95])
    numbers = [f"{value:.0f}" for value in (came.first_ms, p50, p95, q50, q95, came.per_s)]
    return [str(came.taps), *numbers, str(BOUNDS_MS[came.taps])]


def script(
    page: PageFile = None,
    picture: Annotated[Path | None, typer.Option(help="where the page of twelve taps is pictured, a PNG")] = None,
    events: Annotated[int, at_least(20, "of each drag")] = 100,
    chromium: Annotated[str, typer.Option(help="the browser")] = "chromium",
) -> None:
    whole = load_scene(SCENE)
    one = with_values(whole, {"grid.speeds_m_s": [0.4], "grid.grips_N": [5.0]})
    rows = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which(chromium), args=["--no-sandbox"])
        for scene, taps in ((one, 1), (whole, 12)):
            with served(scene) as address:
                tab = browser.new_page(viewport={"width": 1280, "height": 800})
                rows.append(row(measured(tab, address, taps, events)))
                if picture is not None:
                    pictured(browser, address, picture)
                tab.close()
        version = browser.version
        browser.close()
    head = [
        "taps",
        "first picture, ms",
        "one by one, median ms",
        "p95 ms",
        "dragged, median ms",
        "p95 ms",
        "updates/s",
        "p95 wanted, ms",
    ]
    lines = [*table(head, rows), "", f"Headless Chromium {version}, drawing without a graphics card."]
    print("\n".join(lines))
    write_part(page, lines)


if __name__ == "__main__":
    run(script)
