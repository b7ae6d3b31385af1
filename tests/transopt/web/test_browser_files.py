"""A page's files, server and looks in a real browser: taps that come and go, what is saved, what anybody can read."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.transopt.web.conftest import MISSING
from tests.transopt.web.windows import MARKS, TAP, Window, playwright, typed, violations
from transopt.library.proven import load_proven
from transopt.scene.file import read_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

for _name in ("starlette", "uvicorn", "websockets"):
    pytest.importorskip(_name, reason=MISSING)

from transopt.web.serve import Page  # noqa: E402

pytestmark = MARKS
# The plots follow a window's new size in its next frame.
DRAWN = "() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))"


def test_scene_library_and_figure_are_saved_by_the_browser(window: Window, tmp_path: Path, small: Scene) -> None:
    files = {"save=scene": f"{small.name}.toml", "save=library": "library.npz"}
    files |= {f"figure={kind}": f"{small.name}.{kind}" for kind in ("png", "svg")}
    for button, name in files.items():
        with window.tab.expect_download() as download:
            window.see(f"[data-{button}]").click()
        assert download.value.suggested_filename == name
        download.value.save_as(tmp_path / name)
    beside = with_values(small, {"recordings.folder": str(tmp_path)})
    assert read_scene(tmp_path / f"{small.name}.toml") == beside
    assert load_proven(tmp_path / "library.npz").tap_error.shape == (2, 1)
    assert (tmp_path / f"{small.name}.png").read_bytes().startswith(b"\x89PNG")
    drawing = (tmp_path / f"{small.name}.svg").read_text()
    assert drawing.startswith("<svg")
    assert f"{small.name}, 0.4 m/s, 3 N: tap error" in drawing


def test_a_saved_figure_cuts_no_word(browser: Any, small: Scene) -> None:
    """The axis of the winding has the longest numbers, such as 25.075."""
    with Page(with_values(small, {"grid.speeds_m_s": [0.15]})) as served:
        window = Window(browser, served.address)
        with window.tab.expect_download() as download:
            window.see("[data-figure=svg]").click()
        window.tab.set_content(Path(download.value.path()).read_text())
        words = window.tab.evaluate(
            "() => [...document.querySelectorAll('text')].map((text) => [text.textContent, text.getBBox()])"
            ".map(([word, { x, width }]) => [word, x, x + width])"
        )
        window.tab.close()
    assert any(len(word) > 5 and word.replace(".", "").isdigit() for word, *_ in words), words
    assert [word for word, left, right in words if left < 0 or right > 1200] == []


def test_own_taps_are_taken_and_what_is_none_is_answered_before_it_is_sent(window: Window, tmp_path: Path) -> None:
    window.see("#files").set_input_files(str(TAP))
    window.says("#description", "tap_0_3_m_s.csv")
    playwright.expect(window.see("#cells .cell")).to_have_count(1)
    window.rests()
    assert violations(window.tab) == []
    (tmp_path / "letter.csv").write_text("Dear reader,\n")
    (tmp_path / "letter.doc").write_text("Dear reader,\n")
    with (tmp_path / "long.csv").open("wb") as long:
        long.truncate(30 * 2**20)
    for name, words in (
        ("letter.csv", "no rows of numbers"),
        ("letter.doc", "no recording"),
        ("long.csv", "30.0 MB"),
    ):
        window.see("#files").set_input_files(str(tmp_path / name))
        window.says("#message", name)
        window.says("#taps-answer", words)
        assert window.see("body").get_attribute("class") in ("", None)
        window.says("#description", "tap_0_3_m_s.csv")
        assert window.see("#cells .cell").count() == 1
    typed(window, "3")
    window.rests()
    assert window.limit() == pytest.approx(3.0)
    window.see("#reset").click()
    playwright.expect(window.see("#cells .cell")).to_have_count(2)
    window.see("#bring").click()
    playwright.expect(window.see("#cells .cell")).to_have_count(1)


def test_what_is_set_stays_with_own_taps_and_after_a_reload(window: Window) -> None:
    """The taps were designed for at the scene's 4 A while the slider showed 2.5 A."""

    def agrees(limit_A: float) -> None:
        window.rests()
        assert window.limit() == pytest.approx(limit_A)
        assert float(window.see("[id='of-limits.current_A-number']").input_value()) == pytest.approx(limit_A)

    typed(window, "2.5")
    window.rests()
    window.see("#files").set_input_files(str(TAP))
    window.says("#description", "tap_0_3_m_s.csv")
    agrees(2.5)
    window.tab.reload()
    window.says("#description", "tap_0_3_m_s.csv")
    agrees(2.5)
    window.see("#undo").click()
    playwright.expect(window.see("#redo")).to_be_enabled()
    agrees(4.0)
    window.see("#redo").click()
    agrees(2.5)


def test_a_file_that_is_not_sent_ends_the_question_of_the_one_before(window: Window, tmp_path: Path) -> None:
    text = TAP.read_text().replace("time_s,acceleration_g,position_m", "time,acceleration,position_m")
    (tmp_path / "bare.csv").write_text(text)
    (tmp_path / "letter.doc").write_text("Dear reader,\n")
    window.see("#files").set_input_files(str(tmp_path / "bare.csv"))
    window.says("#state", "your answer is needed")
    window.see("#files").set_input_files(str(tmp_path / "letter.doc"))
    window.says("#state", "refused")


def test_what_a_file_leaves_open_is_chosen_from_what_was_tried_on_it(window: Window, tmp_path: Path) -> None:
    text = TAP.read_text().replace("time_s,acceleration_g,position_m", "time,acceleration,position_m")
    (tmp_path / "bare.csv").write_text(text)
    window.see("#files").set_input_files(str(tmp_path / "bare.csv"))
    window.says("#taps-answer", "no unit stated")
    assert violations(window.tab) == []
    right = window.see("#taps-choices button", has_text="acceleration in g:")
    right.first.press("Enter")
    window.says("#description", "bare.csv")
    window.rests()
    assert window.see("#taps-choices button").count() == 0
    assert window.errors == []


def test_a_file_is_dropped_onto_the_page(window: Window) -> None:
    window.tab.evaluate(
        "text => { const data = new DataTransfer(); data.items.add(new File([text], 'dropped.csv'));"
        " dispatchEvent(new DragEvent('drop', { dataTransfer: data, cancelable: true })); }",
        TAP.read_text(),
    )
    window.says("#description", "dropped.csv")
    window.rests()


def test_a_server_that_is_lost_and_comes_back_finds_taps_and_sliders_kept(browser: Any, small: Scene) -> None:
    first = Page(small).start()
    window = Window(browser, first.address)
    window.see("#files").set_input_files(str(TAP))
    window.says("#description", "tap_0_3_m_s.csv")
    typed(window, "2.5")
    window.rests()
    port, token = int(first.address.split(":")[2].split("/")[0]), first.address.rstrip("/").rsplit("/", 1)[1]
    first.close()
    playwright.expect(window.see("#banner")).to_be_visible()
    playwright.expect(window.see("body")).to_have_class("lost")
    with Page(small, port=port, token=token):
        playwright.expect(window.see("#banner")).to_be_hidden()
        window.rests()
        window.says("#description", "tap_0_3_m_s.csv")
        assert window.see("#cells .cell").count() == 1
        assert window.limit() == pytest.approx(2.5)
        window.see("#undo").click()
        window.rests()
        assert window.limit() == pytest.approx(4.0)
        window.tab.close()


@pytest.mark.skipif(os.name != "posix", reason="kills a process")
def test_a_command_that_was_killed_and_started_again_finds_own_taps_in_the_browser(browser: Any) -> None:
    def served(port: int) -> subprocess.Popen[str]:
        words = [sys.executable, "-m", "transopt", "page", "single_grip", "--port", str(port)]
        return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)

    def address(process: subprocess.Popen[str]) -> str:
        assert process.stdout is not None
        return process.stdout.readline().split(": ", 1)[1].strip()

    with served(0) as process:
        first = address(process)
        window = Window(browser, first)
        window.see("#files").set_input_files(str(TAP))
        window.says("#description", "tap_0_3_m_s.csv")
        typed(window, "2.5")
        window.rests()
        process.kill()
    playwright.expect(window.see("#banner")).to_be_visible()
    with served(int(first.split(":")[2].split("/")[0])) as process:
        window.tab.goto(address(process))
        window.says("#description", "tap_0_3_m_s.csv")
        window.rests()
        assert window.see("#cells .cell").count() == 1
        assert window.limit() == pytest.approx(2.5)
        window.tab.close()
        process.kill()


def test_a_tap_is_heard_and_compared_at_one_gain(window: Window) -> None:
    window.see("[data-sound=optimum]").click()
    window.says("#state", "playing optimum")
    window.see("#compare").click()
    window.says("#state", "playing recorded, then optimum")


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


CONTRAST = """() => {
  const style = getComputedStyle(document.documentElement);
  const light = (name) => {
    const hex = style.getPropertyValue(`--${name}`).trim();
    const parts = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255)
      .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2];
  };
  const contrast = (a, b) => (Math.max(light(a), light(b)) + 0.05) / (Math.min(light(a), light(b)) + 0.05);
  const inks = ["ink", "quiet", "accent", "recorded", "optimum", "clipped", "start", "warm", "limit", "refused"];
  return Math.min(...inks.flatMap((ink) => ["ground", "raised"].map((ground) => contrast(ink, ground))));
}"""


def test_words_stand_out_from_their_ground_and_axe_finds_nothing(browser: Any, address: str) -> None:
    window = Window(browser, address, reduced_motion="reduce")
    for scheme in ("light", "dark"):
        window.tab.emulate_media(color_scheme=scheme)
        assert window.tab.evaluate(CONTRAST) >= 4.5
        assert violations(window.tab) == []
    window.see("#scenes").click()
    playwright.expect(window.see(".card").first).to_be_visible()
    assert violations(window.tab) == []
    window.tab.close()


def test_nothing_is_hidden_or_wider_than_the_window(browser: Any) -> None:
    cut = """() => [...document.querySelectorAll("main *")].filter((element) =>
      element.checkVisibility({ visibilityProperty: true }) && element.clientWidth && !element.closest("svg")
      && getComputedStyle(element).display !== "inline" && element.scrollWidth > element.clientWidth + 1
      && !element.matches("input, select")).map((element) => element.outerHTML.slice(0, 90))"""
    with Page("wood_on_foam") as served:
        window = Window(browser, served.address)
        for width in (1280, 640, 400):  # twice as large on a screen of 1280 px is a window of 640
            window.tab.set_viewport_size({"width": width, "height": 800})
            window.tab.evaluate(DRAWN)
            assert window.tab.evaluate("() => document.documentElement.scrollWidth") <= width
            assert window.tab.evaluate(cut) == []
        window.tab.close()


def test_another_scene_is_chosen_in_the_gallery(window: Window) -> None:
    window.see("#scenes").click()
    window.see(".card", has_text="lra_click").click()
    window.says("#name", "lra_click")
    window.rests()
    assert window.see("#cells .cell").count() == 2
    window.says("#selected", "click 250 Hz")


def test_a_gallery_that_is_closed_and_opened_while_it_loads_has_each_scene_once_with_its_own_picture(
    window: Window,
) -> None:
    """Twenty scenes stood there 60 times, and pictures came under the names of others."""

    def came() -> list[str]:
        playwright.expect(window.see("#cards .came").last).not_to_have_text("...")
        cards = window.see("#cards .card")
        return [" ".join(text.split()) for text in cards.all_inner_texts()]

    again = "() => { document.querySelector('#gallery-close').click(); document.querySelector('#scenes').click(); }"
    window.see("#scenes").click()
    for _ in range(5):
        window.tab.evaluate(again)
        window.tab.evaluate(again)
    disturbed = came()
    window.tab.reload()
    window.rests()
    window.see("#scenes").click()
    assert disturbed == came()
    assert len(disturbed) == len(set(disturbed))


def test_every_word_slider_and_column_has_a_tip(window: Window) -> None:
    for group in window.see("details").all():
        group.evaluate("group => { group.open = true; }")
    bare = window.tab.evaluate(
        """() => [...document.querySelectorAll("#sliders .control, #probes .control, .table thead .term, #key button,"
      + "aside button, aside .switch, header button")].filter((element) => !element.closest("[data-tip]")?.dataset.tip
      && !element.disabled && element.checkVisibility({ visibilityProperty: true })).map((one) => one.outerHTML)"""
    )
    assert bare == []
    window.tab.evaluate("() => scrollTo(0, 0)")
    window.see(".table thead .floor .term").focus()
    window.tab.keyboard.press("Tab")
    window.tab.keyboard.press("Shift+Tab")
    window.tab.evaluate("() => document.dispatchEvent(new Event('scroll'))")  # as the focus's own arrives: after it
    window.says("#tip", "without any limit")
    window.tab.mouse.wheel(0, 20)
    window.says("#tip", "without any limit")
    window.tab.keyboard.press("Escape")
    playwright.expect(window.see("#tip")).to_be_hidden()
    window.see("#sliders .control").first.hover()
    window.says("#tip", "limits.steady_current_A")
