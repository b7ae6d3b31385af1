"""The page in a real browser: what a hand and a keyboard can do, and what must not happen."""

import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.transopt.web.conftest import MISSING
from transopt.scene.builtin import load_scene
from transopt.scene.file import read_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
for _name in ("starlette", "uvicorn", "websockets", "plotly"):
    pytest.importorskip(_name, reason=MISSING)

from transopt.web.serve import Page  # noqa: E402
from transopt.web.service import Service  # noqa: E402

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
RECORDINGS = Path(__file__).parents[3] / "problems/recordings"
REST_MS = 60_000
CURRENT = "[id='of-limits.current_A']"

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine"),
    pytest.mark.timeout(300),
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as player:
        started = player.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield started
        started.close()


class Window:
    """A window of the page, and what went wrong in it."""

    def __init__(self, browser: Any, address: str, **how: Any) -> None:
        self.tab = browser.new_page(viewport={"width": 1280, "height": 800}, **how)
        self.errors: list[str] = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on("console", lambda said: self.errors.append(said.text) if said.type == "error" else None)
        self.requests: list[str] = []
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.goto(address)
        self.rests()

    def rests(self) -> None:
        """Wait until everything is certified or refused, replayed and priced."""
        self.says("#state", re.compile(r"certified and replayed|\b0 of \d+ certified"))

    def says(self, place: str, text: Any) -> None:
        playwright.expect(self.tab.locator(place)).to_contain_text(text, timeout=REST_MS)

    def see(self, place: str) -> Any:
        return self.tab.locator(place)

    def state(self, expression: str) -> Any:
        return self.tab.evaluate(f"() => page.{expression}")

    def limit(self) -> float:
        return float(self.state("taps[page.selected].input_limit"))


@pytest.fixture
def window(browser: Any, address: str) -> Iterator[Window]:
    opened = Window(browser, address)
    yield opened
    assert opened.errors == []
    opened.tab.close()


def test_everything_comes_from_this_machine_and_is_certified(window: Window, address: str, small: Scene) -> None:
    origin = address[: address.index("/", 8)]
    assert all(url.startswith((origin, "data:", "blob:")) for url in window.requests)
    assert window.see("#cells .cell").count() == 2
    assert window.see("#cells .refused").count() == 0
    cells = window.see("#table tbody tr").nth(1).locator("td").all_inner_texts()
    assert cells[:2] == ["0.4", "3"]
    assert float(cells[2]) == pytest.approx(100 * Service(small).quick(1).figures.tap_error, abs=0.06)
    assert "certified, replayed" in cells[-1]


def test_every_slider_moves_by_the_keyboard_and_is_named(window: Window) -> None:
    for group in window.see("#sliders details").all():
        group.evaluate("group => { group.open = true; }")
    sliders = window.see("#sliders input[type=range]:enabled")
    for slider in sliders.all():
        key = slider.get_attribute("id").removeprefix("of-")
        before = slider.get_attribute("aria-valuetext")
        assert window.tab.locator(f"label[for='of-{key}']").inner_text().strip()
        slider.focus()
        towards = "ArrowRight" if slider.input_value() == slider.get_attribute("min") else "ArrowLeft"
        for _ in range(40):
            slider.press(towards)
        playwright.expect(slider).not_to_have_attribute("aria-valuetext", before)
        assert key in window.state("kept")
    for choice in window.see("#sliders select").all():
        choice.select_option(index=choice.locator("option").count() - 1)
    window.says("#state", re.compile("of 2 certified"))


def test_a_limit_that_is_not_stated_is_switched_on_and_off(window: Window) -> None:
    row = window.see("[data-key='limits.supply_V']")
    row.locator("input[type=checkbox]").check()
    playwright.expect(row.locator("output")).to_contain_text("V")
    window.says("#state", "certified and replayed")
    assert window.state("kept")["limits.supply_V"] == pytest.approx(10, rel=0.02)
    row.locator("input[type=checkbox]").uncheck()
    playwright.expect(row.locator("output")).to_have_text("not stated")


def test_the_limit_is_dragged_in_the_plot_by_pointer_and_by_keys(window: Window) -> None:
    box = window.see("#handle").bounding_box()
    assert window.limit() == pytest.approx(4.0)
    window.tab.mouse.move(box["x"] + 300, box["y"] + 12)
    window.tab.mouse.down()
    window.tab.mouse.move(box["x"] + 300, box["y"] + 40, steps=8)
    window.tab.mouse.up()
    playwright.expect(window.see("[data-key='limits.current_A'] output")).not_to_have_text("4 A")
    window.rests()
    dragged = window.limit()
    assert 1.0 < dragged < 3.9
    window.see("#handle").focus()
    window.tab.keyboard.press("ArrowUp")
    window.says("#handle span", f"{float(f'{1.02 * dragged:.3g}'):g} A")
    assert window.see("#handle").get_attribute("aria-valuetext")


def test_the_error_is_dragged_instead(window: Window) -> None:
    window.see("#error").focus()
    window.see("#error").press("ArrowLeft")
    window.says("#answer", "takes a current of")
    window.rests()
    assert window.limit() > 4.0
    wanted = float(window.see("#error-value").inner_text().split()[0]) / 100
    assert window.state("taps[1].figures.tap_error") <= wanted


def test_a_tap_between_the_nodes(window: Window) -> None:
    window.see("#probe").check()
    playwright.expect(window.see("#cells .cell")).to_have_count(3)
    window.says("#state", "3 of 3 certified")
    speed = window.see("#probe-speed_m_s")
    before = window.see("#cells .place").nth(2).inner_text()
    speed.focus()
    speed.press("PageUp")
    playwright.expect(window.see("#cells .place").nth(2)).not_to_have_text(before)
    window.see("#probe").uncheck()
    playwright.expect(window.see("#cells .cell")).to_have_count(2)


def test_a_warm_coil_is_played_beside_the_optimum(browser: Any, small: Scene) -> None:
    with Page(with_values(small, {"grid.cool_share": 0.36})) as served:
        window = Window(browser, served.address)
        playwright.expect(window.see("#key .warm")).to_be_hidden()
        window.see("#warm").check()
        playwright.expect(window.see("#key .warm")).to_be_visible()
        window.says("#selected", "of the second: tap error")
        window.rests()
        assert window.state("taps[1].warm_input.length") == window.state("taps[1].input.length")
        part = window.state("taps[1].warm.cooled")
        assert 0 < part < 1
        cells = window.see("#table tbody tr").nth(1).locator("td").all_inner_texts()
        assert f"{100 * part:.1f} % of the second: tap error" in cells[-2]
        assert window.state("taps[1].warm.heat_A2_ms") < window.state("taps[1].heat_A2_ms")
        window.see("#winding").fill("0")
        window.says("#selected", "on the warm coil the first command: tap error")
        window.says("#winding-value", "25 C")
        window.see("#warm").uncheck()
        playwright.expect(window.see("#key .warm")).to_be_hidden()
        window.rests()
        assert window.state("taps[1].warm") is None
        assert window.errors == []
        window.tab.close()


def test_a_scene_without_second_commands_has_no_warm_coil(window: Window) -> None:
    playwright.expect(window.see("#warmed")).to_be_hidden()


def test_what_is_not_certified_is_grey_and_says_why(browser: Any) -> None:
    one = {"grid.speeds_m_s": [0.4], "grid.grips_N": [5.0]}
    scene = with_values(load_scene("low_supply"), {"limits.supply_V": 0.3, **one})
    with Page(scene) as served:
        window = Window(browser, served.address)
        assert window.see("#cells .refused").count() == 1
        window.says("#reason", "supply")
        window.says("#reason", "would do")
        playwright.expect(window.see("#detail")).to_have_class(re.compile("refused"))
        assert window.state("taps[0].certified") is False
        assert window.errors == []
        window.tab.close()


def test_the_scene_and_the_library_are_saved_by_the_browser(window: Window, tmp_path: Path, small: Scene) -> None:
    for button, name in (("[data-save=scene]", f"{small.name}.toml"), ("[data-save=library]", "library.npz")):
        with window.tab.expect_download() as download:
            window.see(button).click()
        assert download.value.suggested_filename == name
        download.value.save_as(tmp_path / name)
    assert read_scene(tmp_path / f"{small.name}.toml") == small
    from transopt.library.proven import load_proven

    assert load_proven(tmp_path / "library.npz").tap_error.shape == (2, 1)


@pytest.mark.parametrize(("kind", "begins"), [("png", b"\x89PNG"), ("svg", b"<svg")])
def test_the_figure_is_saved(window: Window, tmp_path: Path, kind: str, begins: bytes) -> None:
    with window.tab.expect_download() as download:
        window.see(f"[data-figure={kind}]").click()
    download.value.save_as(tmp_path / "figure")
    assert (tmp_path / "figure").read_bytes().startswith(begins)


def test_own_taps_are_taken_and_what_is_none_is_refused(window: Window, tmp_path: Path) -> None:
    window.see("#files").set_input_files(str(RECORDINGS / "tap_0.3_m_s.csv"))
    window.says("#description", "tap_0_3_m_s.csv")
    playwright.expect(window.see("#cells .cell")).to_have_count(1)
    window.rests()
    (tmp_path / "letter.csv").write_text("Dear reader,\n")
    window.see("#files").set_input_files(str(tmp_path / "letter.csv"))
    window.says("#message", "letter.csv")
    assert window.see("#cells .cell").count() == 1
    window.see("#reset").click()
    playwright.expect(window.see("#cells .cell")).to_have_count(2)


def test_a_file_is_dropped_onto_the_page(window: Window) -> None:
    text = json.dumps((RECORDINGS / "tap_0.3_m_s.csv").read_text())
    window.tab.evaluate(
        "() => { const data = new DataTransfer();"
        f" data.items.add(new File([{text}], 'dropped.csv'));"
        " dispatchEvent(new DragEvent('drop', { dataTransfer: data, cancelable: true })); }"
    )
    window.says("#description", "dropped.csv")
    window.rests()


def test_a_tap_is_heard_and_compared_at_one_gain(window: Window) -> None:
    window.see("[data-sound=optimum]").click()
    window.says("#state", "playing optimum")
    window.see("#compare").click()
    window.says("#state", "playing recorded, then optimum")


def test_a_lost_server_is_said_and_found_again_with_what_was_changed(browser: Any, small: Scene) -> None:
    first = Page(small).start()
    window = Window(browser, first.address)
    window.see(CURRENT).focus()
    window.see(CURRENT).press("PageDown")
    window.rests()
    limit = window.limit()
    assert limit < 4.0
    port, token = int(first.address.split(":")[2].split("/")[0]), first.address.rstrip("/").rsplit("/", 1)[1]
    first.close()
    playwright.expect(window.see("#banner")).to_be_visible(timeout=REST_MS)
    playwright.expect(window.see("body")).to_have_class("lost")
    with Page(small, port=port, token=token):
        playwright.expect(window.see("#banner")).to_be_hidden(timeout=REST_MS)
        window.rests()
        assert window.limit() == pytest.approx(limit)
        window.tab.close()


def test_a_page_of_another_origin_reaches_nothing(browser: Any, address: str, tmp_path: Path) -> None:
    tab = browser.new_page()
    (tmp_path / "evil.html").write_text("<!doctype html><title>evil</title>")
    tab.goto((tmp_path / "evil.html").as_uri())
    closed = tab.evaluate(
        "address => new Promise(done => { const socket = new WebSocket(address);"
        " socket.onopen = () => done('open'); socket.onclose = () => done('closed'); })",
        address.replace("http:", "ws:") + "window",
    )
    assert closed == "closed"
    read = "address => fetch(address).then(answer => answer.text(), () => 'refused')"
    assert tab.evaluate(read, address) == "refused"
    tab.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_stand_out_from_their_ground(browser: Any, address: str, scheme: str) -> None:
    window = Window(browser, address, color_scheme=scheme, reduced_motion="reduce")
    least = window.tab.evaluate(
        """() => {
      const style = getComputedStyle(document.documentElement);
      const light = (name) => {
        const hex = style.getPropertyValue(`--${name}`).trim();
        const parts = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255)
          .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
        return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2];
      };
      const contrast = (a, b) => (Math.max(light(a), light(b)) + 0.05) / (Math.min(light(a), light(b)) + 0.05);
      const inks = ["ink", "quiet", "accent", "recorded", "optimum", "clipped", "warm", "limit", "refused"];
      return Math.min(...inks.flatMap((ink) => ["ground", "raised"].map((ground) => contrast(ink, ground))));
    }"""
    )
    assert least >= 4.5
    unnamed = window.tab.evaluate(
        "() => [...document.querySelectorAll('input, select, button, [role=slider]')].filter((element) =>"
        " !element.labels?.length && !element.getAttribute('aria-label') && !element.textContent.trim()).length"
    )
    assert unnamed == 0
    window.tab.close()


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_wider_than_the_window(browser: Any, address: str, width: int) -> None:
    window = Window(browser, address)
    window.tab.set_viewport_size({"width": width, "height": 844})
    assert window.tab.evaluate("() => document.documentElement.scrollWidth") <= width
    window.tab.close()
