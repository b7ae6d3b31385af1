"""A window of the page in a browser, and what can be asked of it."""

import os
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
TAP = Path(__file__).parents[3] / "problems/recordings/tap_0.3_m_s.csv"
REST_MS = 60_000
CURRENT = "[id='of-limits.current_A']"
playwright.expect.set_options(timeout=REST_MS)  # a machine with other work takes its time

MARKS = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine"),
    pytest.mark.timeout(300),
]
INKED = """([name, place]) => {
  const canvas = document.querySelector(`${place} > canvas`);
  const colour = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const parts = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let at = 0; at < data.length; at += 4) {
    if (data[at + 3] > 150 && parts.every((part, j) => Math.abs(part - data[at + j]) < 6)) count++;
  }
  return count;
}"""


class Window:
    """A window of the page, and what went wrong in it."""

    def __init__(self, browser: Any, address: str, **media: Any) -> None:
        self.tab = browser.new_page()
        self.tab.emulate_media(**media)
        self.errors: list[str] = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on("console", lambda said: self.errors.append(said.text) if said.type == "error" else None)
        self.requests: list[str] = []
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.goto(address)
        self.rests()

    def forgets(self) -> None:
        """Delete what the page has kept in the browser, where the next window would find it."""
        self.tab.context.new_cdp_session(self.tab).send(
            "Storage.clearDataForOrigin", {"origin": self.tab.evaluate("() => origin"), "storageTypes": "all"}
        )

    def rests(self) -> None:
        """Wait until everything is certified or refused, replayed and priced."""
        self.says("#state", re.compile(r"certified and replayed|\b0 of \d+ certified"))

    def says(self, place: str, text: Any) -> None:
        playwright.expect(self.tab.locator(place)).to_contain_text(text)

    def see(self, place: str, **how: Any) -> Any:
        return self.tab.locator(place, **how)

    def state(self, expression: str) -> Any:
        return self.tab.evaluate(f"() => page.{expression}")

    def limit(self) -> float:
        return float(self.state("frame.taps[page.selected].input_limit"))

    def inked(self, curve: str, place: str = "#plot") -> int:
        """Pixels of the large plot, or of the small ones in `#cells`, that have the colour of a curve."""
        return int(self.tab.evaluate(INKED, [curve, place]))


def typed(window: Window, value: str, key: str = "limits.current_A") -> None:
    number = window.see(f"[id='of-{key}-number']")
    number.fill(value)
    number.press("Enter")


def violations(tab: Any) -> list[str]:
    """What axe finds against WCAG 2.2, levels A and AA."""
    rules = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"], "resultTypes": ["violations"]}
    found = axe.Axe().run(tab, options=rules).response["violations"]
    return [f"{each['id']}: {node['html']} {node['failureSummary']}" for each in found for node in each["nodes"]]
