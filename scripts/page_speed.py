"""Measures the page's response time in Chromium: from an input event to the frame that shows its result.

    python scripts/page_speed.py

With the page in a process of its own, as `transopt page` has it, it drags the slider of the current limit of
`wood_on_foam`, with one tap and with all twelve, by an event every 16 ms of the browser's clock, so that events come
at all phases of its frames. An event counts from the time at which it is due, also where the page is late or passes
it over for a newer one, to the end of the frame that shows its result or a newer one. The time is parted into server,
wire and page, and the processor time of server and browser is told. It also measures the time from opening the
address to the first picture. It needs the extra `page`, playwright and chromium. No test asserts these times.
"""

import os
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
from transopt.web import server
from transopt.web.serve import Page
from transopt.web.session import Message, Session

SCENE = "wood_on_foam"
SLIDER = "of-limits.current_A"
SETTLED_MS = 30_000
BOUNDS_MS = {1: 33, 12: 66}
# Notes when each request was sent and its answer came, and when the frame that shows the answer was painted.
NOTES = """
globalThis.noted = { sent: [], frames: [] };
const Socket = globalThis.WebSocket;
globalThis.WebSocket = class extends Socket {
  constructor(address) {
    super(address);
    this.addEventListener("open", () => this.addEventListener("message", ({ data, timeStamp }) => {
      if (typeof data === "string" || !globalThis.page.frame) return;
      const { number } = page.frame, painted = new MessageChannel();
      painted.port1.onmessage = () => noted.frames.push([number, timeStamp, performance.now()]);
      requestAnimationFrame(() => painted.port2.postMessage(null));
    }));
  }
  send(text) {
    const { type, id } = JSON.parse(text);
    if (type === "change") noted.sent.push([id, performance.now()]);
    super.send(text);
  }
};
"""
# Drags a slider over two fifths of its length. Returns when each event was due [ms], and the request that it became.
DRAG = """async ([slider, count]) => {
  const element = document.getElementById(slider), began = performance.now(), events = [];
  const due = (j) => began + 16 * j;
  noted.frames = [];
  for (let j = 0; j < count;) {
    await new Promise((goes) => setTimeout(goes, Math.max(due(j) - performance.now(), 0)));
    const first = j;
    while (j < count && due(j) <= performance.now()) j += 1;
    if (j === first) continue;
    element.value = element.max * (0.55 + 0.2 * Math.sin(0.37 * (j - 1)));
    element.dispatchEvent(new Event("input"));
    for (let k = first; k < j; k++) events.push([due(k), noted.sent.at(-1)[0]]);
  }
  while (!noted.frames.some(([number]) => number >= events.at(-1)[1])) await new Promise(requestAnimationFrame);
  return { events, ...noted };
}"""


@dataclass(frozen=True)
class Came:
    """Times of one drag.

    Attributes
    ----------
    taps : number of taps in the scene.
    first_ms : time from opening the page to the frame with the first picture of all taps.
    events_ms : times from the events to the frames that show their results.
    parts_ms : medians over the answers that were drawn: of the time in the server, on the wire, and in the page.
    per_s : answers drawn per second.
    spent_ms : processor time per answer of the server and of the browser.
    """

    taps: int
    first_ms: float
    events_ms: list[float]
    parts_ms: list[float]
    per_s: float
    spent_ms: tuple[float, float]


def _serve(scene: Scene, told: Connection) -> None:
    class Noting(Session):
        """A session that tells of each change how long it waited and was solved, and the process's processor time."""

        def put(self, message: Message, body: bytes = b"") -> None:
            super().put({**message, "came_s": time.perf_counter()}, body)

        def _change(self, message: Message) -> None:
            super()._change(message)
            told.send((message["id"], time.perf_counter() - message["came_s"], time.process_time()))

    server.Session = Noting  # type: ignore[misc]
    page = Page(scene)
    told.send(page.address)
    page.serve()


@contextmanager
def served(scene: Scene) -> Iterator[tuple[str, Connection]]:
    """Serve a scene in a process of its own, which waits for no other interpreter: its address, and what it tells."""
    spawning = get_context("spawn")
    told, tells = spawning.Pipe(duplex=False)
    process = spawning.Process(target=_serve, args=(scene, tells))
    process.start()
    try:
        yield told.recv(), told
    finally:
        process.terminate()
        process.join()


def measured(browser: Browser, tab: Tab, address: str, told: Connection, taps: int, events: int) -> Came:
    """Open the page, drag its slider, and read the times that were noted."""
    system = browser.new_browser_cdp_session()

    def browser_s() -> float:
        return sum(each["cpuTime"] for each in system.send("SystemInfo.getProcessInfo")["processInfo"])

    tab.add_init_script(NOTES)
    tab.goto(address)
    expect(tab.locator("#state")).to_contain_text("replayed", timeout=SETTLED_MS)
    first_ms = tab.evaluate("noted.frames[0][2]")
    tab.evaluate(DRAG, [SLIDER, 60])  # warm-up
    expect(tab.locator("#state")).to_contain_text("replayed", timeout=SETTLED_MS)
    while told.poll():
        told.recv()
    began_s = browser_s()
    course = tab.evaluate(DRAG, [SLIDER, events])
    browser_ms = 1e3 * (browser_s() - began_s)
    answers = [told.recv()]
    while answers[-1][0] < course["events"][-1][1]:
        answers.append(told.recv())
    frames, sent = course["frames"], dict(course["sent"])
    shown = [next(frame for frame in frames if frame[0] >= number) for _, number in course["events"]]
    events_ms = [frame[2] - due for (due, _), frame in zip(course["events"], shown, strict=True)]
    solved = {number: 1e3 * seconds for number, seconds, _ in answers}
    due = {number: at for at, number in reversed(course["events"])}
    parts = [
        (solved[n], came - sent[n] - solved[n], sent[n] - due[n] + painted - came)
        for n, came, painted in frames
        if n in solved and n in due
    ]
    server_ms = 1e3 * (answers[-1][2] - answers[0][2]) / (len(answers) - 1)
    lasted_s = (frames[-1][2] - course["events"][0][0]) / 1e3
    medians = np.median(parts, axis=0).tolist()
    return Came(taps, first_ms, events_ms, medians, len(frames) / lasted_s, (server_ms, browser_ms / len(frames)))


def pictured(browser: Browser, address: str, picture: Path) -> None:
    """Write a picture of a page at rest."""
    tab = browser.new_page(viewport={"width": 1280, "height": 960})
    tab.goto(address)
    expect(tab.locator("#state")).to_contain_text("replayed", timeout=SETTLED_MS)
    expect(tab.locator("#error-key option").first).to_contain_text("%")
    tab.screenshot(path=picture)
    tab.close()


def row(came: Came) -> list[str]:
    p50, p95 = np.percentile(came.events_ms, [50, 95])
    numbers = [came.first_ms, p50, p95, BOUNDS_MS[came.taps], *came.parts_ms, came.per_s, *came.spent_ms]
    return [str(came.taps), *(f"{value:.0f}" for value in numbers)]


def script(
    page: PageFile = None,
    picture: Annotated[Path | None, typer.Option(help="where the page of twelve taps is pictured, a PNG")] = None,
    events: Annotated[int, at_least(20, "of each drag")] = 400,
    chromium: Annotated[str, typer.Option(help="the browser")] = "chromium",
) -> None:
    whole = load_scene(SCENE)
    one = with_values(whole, {"grid.speeds_m_s": [0.4], "grid.grips_N": [5.0]})
    rows, load = [], os.getloadavg()[0]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which(chromium), args=["--no-sandbox"])
        for scene, taps in ((one, 1), (whole, 12)):
            with served(scene) as (address, told):
                tab = browser.new_page(viewport={"width": 1280, "height": 800})
                rows.append(row(measured(browser, tab, address, told, taps, events)))
                if picture is not None:
                    pictured(browser, address, picture)
                tab.close()
        version = browser.version
        browser.close()
    head = [
        "taps",
        "first picture, ms",
        "event to frame, median ms",
        "p95 ms",
        "p95 wanted, ms",
        "server, ms",
        "wire, ms",
        "page, ms",
        "frames/s",
        "processor of the server, ms a frame",
        "of the browser, ms a frame",
    ]
    others = f"the machine's load by others was {load:.1f}"
    lines = [*table(head, rows), "", f"Headless Chromium {version}, drawing without a graphics card; {others}."]
    print("\n".join(lines))
    write_part(page, lines)


if __name__ == "__main__":
    run(script)
