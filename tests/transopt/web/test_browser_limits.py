"""The limits of a page in a real browser: what a hand and a keyboard do to them, and what is shown then."""

import re
from typing import Any

import pytest

import transopt as to
from tests.transopt.web.conftest import MISSING
from tests.transopt.web.windows import CURRENT, MARKS, Window, playwright, typed, violations
from transopt.library.columns import COLUMNS
from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

for _name in ("starlette", "uvicorn", "websockets"):
    pytest.importorskip(_name, reason=MISSING)

from transopt.web.serve import Page  # noqa: E402

pytestmark = MARKS


@pytest.fixture(scope="module")
def library(small: Scene) -> to.Library:
    return to.solve(small)


def test_what_is_drawn_is_the_library_of_the_scene(window: Window, address: str, library: to.Library) -> None:
    origin = address[: address.index("/", 8)]
    assert all(url.startswith((origin, "data:", "blob:")) for url in window.requests)
    assert window.see("#cells .cell").count() == 2
    assert window.see("#cells .refused").count() == 0
    shown = {
        "tap": library.tap_error,
        "floor": library.floor,
        "felt": library.felt_error,
        "speed": library.speed_change,
    }
    for iv in (0, 1):
        row = window.see("#table tbody tr").nth(iv)
        assert row.locator("th").all_inner_texts() == [f"{library.speeds_m_s[iv]:g}", "3"]
        for name, values in shown.items():
            assert row.locator(f"td.{name}").inner_text() == COLUMNS[name].show(float(values[iv, 0]))
        assert row.locator("td.state").inner_text() == "replayed"
        drawn = window.state(f"frame.taps[{iv}].input")
        assert drawn[: library.plant_input.shape[-1]] == pytest.approx(library.plant_input[iv, 0], abs=1e-4)
    assert window.inked("optimum", "#cells") > 0
    playwright.expect(window.see("#warmed")).to_be_hidden()  # the scene has no cool commands
    percent = COLUMNS["tap"].show(float(library.tap_error[1, 0]))
    assert window.see("#cells .came").nth(1).inner_text() == f"{percent} % *"
    assert f"tap error {percent} %, " in window.see("#selected").inner_text()


FRAMES = """() => ({
  frames: [...document.querySelectorAll("[data-frame]")].map((element) => Number(element.dataset.frame)),
  cell: document.querySelectorAll("#cells .came")[1].textContent.split(" ")[0],
  row: document.querySelectorAll("#table tbody tr")[1].querySelector("td.tap").textContent,
  head: document.querySelector("#selected").textContent.match(/tap error ([0-9.]+)/)[1],
  handle: document.querySelector("#handle span").textContent,
  asked: document.querySelector("[id='of-limits.current_A-number']").value,
  ratio: document.querySelector("[id='of-limits.beta-number']").value,
  limit: page.frame.taps[1].input_limit,
  height: document.documentElement.scrollHeight,
  painted: document.querySelector("#table").checkVisibility({ contentVisibilityAuto: true }),
  below: document.querySelector(".table").getBoundingClientRect().top > innerHeight,
})"""


def test_one_answer_drives_all_that_shows_a_result_also_while_dragging(window: Window, small: Scene) -> None:
    assert window.inked("start") == 0  # nothing differs from it yet
    box = window.see(CURRENT).bounding_box()
    y = box["y"] + box["height"] / 2
    window.tab.set_viewport_size({"width": 1280, "height": 700})  # the table is below
    window.tab.mouse.move(box["x"] + 0.7 * box["width"], y)
    window.tab.mouse.down()
    found = []
    for j in range(60):
        window.tab.mouse.move(box["x"] + (0.45 + 0.004 * j) * box["width"], y)
        found.append(window.tab.evaluate(FRAMES))
    assert violations(window.tab) == []
    window.tab.mouse.up()
    for sample in found:
        assert len(sample["frames"]) == 7  # two cells, two rows, title, curves, state
        assert len(set(sample["frames"])) == 1
        assert sample["cell"] == sample["row"] == sample["head"]
        assert sample["handle"] == f"{sample['asked']} A"
        assert sample["height"] == found[0]["height"]  # nothing is pushed about
        assert sample["below"]
        assert float(sample["ratio"]) == pytest.approx(sample["limit"] / small.limits.steady_input, rel=1e-3)
    assert len({sample["frames"][0] for sample in found}) > 3  # it was drawn meanwhile
    assert len({sample["asked"] for sample in found}) > 30
    assert sum(sample["painted"] for sample in found) < len(found) / 2  # some, where the slider rests for a moment
    window.rests()
    window.says("#selected", "as opened 29.6 %")
    assert window.tab.evaluate(FRAMES)["painted"]
    assert window.inked("start") > 0
    assert window.inked("limit") > 0


def test_while_dragging_what_is_looked_at_comes_and_at_rest_all(window: Window) -> None:
    samples = window.state("frame.times.length")
    box = window.see(CURRENT).bounding_box()
    y = box["y"] + box["height"] / 2
    window.tab.mouse.move(box["x"] + 0.7 * box["width"], y)
    window.tab.mouse.down()
    sizes, ends = [], []
    for j in range(90):
        window.tab.mouse.move(box["x"] + (0.45 + 0.003 * j) * box["width"], y)
        if j == 60:
            window.see("[data-look=whole]").evaluate("button => button.click()")
        sizes.append(window.state("frame.times.length"))
        ends.append(window.state("frame.times.at(-1)"))
    window.tab.mouse.up()
    assert min(sizes[:60]) < samples / 4
    assert min(ends[:60]) >= 0.02
    assert sizes[-1] == samples
    window.see("[data-look=first]").click()
    window.rests()
    assert window.state("frame.times.length") == window.state("start.times.length") == samples
    assert window.state("frame.taps[1].input.length") == samples
    window.says("#selected", "as opened 29.6 %")


HIDDEN = """() => {
  const cells = document.querySelector("#cells"), hidden = [];
  for (const element of document.querySelectorAll("aside input, aside select, aside button, aside summary")) {
    if (!element.checkVisibility() || element.disabled) continue;
    scrollTo(0, document.documentElement.scrollHeight);
    element.focus();
    const { top, bottom } = element.getBoundingClientRect(), taps = cells.getBoundingClientRect();
    const seen = taps.top >= 0 && taps.bottom <= innerHeight / 2 && top >= taps.bottom && bottom <= innerHeight;
    if (!seen) hidden.push(element.id);
  }
  return hidden;
}"""


def test_in_a_narrow_window_all_taps_stay_in_sight_of_every_control(window: Window) -> None:
    for width, height in ((400, 800), (640, 700)):
        window.tab.set_viewport_size({"width": width, "height": height})
        assert window.tab.evaluate(HIDDEN) == []
    # The selected tap is in sight where not all have room.
    window.tab.evaluate("() => { document.querySelector('#cells').style.width = '160px'; }")
    for selected in (0, 1):
        window.see("#table tbody tr").nth(selected).click()
        ends = "cell => [...'left right'.split(' ')].map(side => cell.getBoundingClientRect()[side])"
        cell, cells = (window.see(name).evaluate(ends) for name in ("#cells [aria-selected=true]", "#cells"))
        assert cells[0] - 1 <= cell[0] < cell[1] <= cells[1] + 1  # places are whole pixels
    window.tab.set_viewport_size({"width": 800, "height": 380})  # too low for both
    assert len(window.tab.evaluate(HIDDEN)) > 10


def focused(window: Window) -> str:
    """What has the focus, by the name that it goes by; BODY for nothing."""
    return str(
        window.tab.evaluate(
            "() => { const a = document.activeElement; return a === document.body ? 'BODY' : a.id"
            " || Object.values(a.dataset).join() || a.ariaLabel || a.textContent; }"
        )
    )


def test_every_control_is_reached_by_the_keyboard_and_moves(window: Window) -> None:
    for group in window.see("details").all():
        group.evaluate("group => { group.open = true; }")
    wanted = window.tab.evaluate(
        "() => [...document.querySelectorAll('button, input, select, summary, [tabindex]')].filter((element) =>"
        " element.tabIndex >= 0 && !element.disabled && element.checkVisibility({ visibilityProperty: true })).length"
    )
    visited = []
    while not visited or visited[-1] != "BODY":
        window.tab.keyboard.press("Tab")
        visited.append(
            "BODY" if window.tab.evaluate("() => document.activeElement === document.body") else focused(window)
        )
        assert len(visited) < 200
    assert len(visited) >= wanted
    assert {"undo", "plot", "handle", "of-limits.current_A", "of-limits.current_A-number", "files"} <= {
        *visited,
        "undo",
    }
    for slider in window.see("#sliders input[type=range]:enabled").all():
        key = slider.get_attribute("id").removeprefix("of-")
        before = slider.get_attribute("aria-valuetext")
        assert window.tab.locator(f"label[for='of-{key}']").inner_text().strip()
        slider.focus()
        slider.press("PageUp" if slider.input_value() == slider.get_attribute("min") else "PageDown")
        playwright.expect(slider).not_to_have_attribute("aria-valuetext", before)
        assert key in window.state("requested.changes") or key in ("limits.beta", "limits.current_A")
    for choice in window.see("#sliders select").all():
        choice.select_option(index=choice.locator("option").count() - 1)
    window.says("#state", re.compile("of 2 certified"))


def test_numbers_are_typed_and_steps_undone_and_done_again(window: Window) -> None:
    values = [f"{2 + 0.1 * j:.4g}" for j in range(20)]
    for value in values:
        typed(window, value)
    number = window.see("[id='of-limits.current_A-number']")
    for value in [*reversed(values[:-1]), "4"]:
        window.see("#undo").click()
        assert number.input_value() == value
    assert window.see("#undo").is_disabled()
    for value in values:
        window.tab.keyboard.press("Control+Shift+Z")
        assert number.input_value() == value
    assert window.see("#redo").is_disabled()
    window.rests()
    assert window.limit() == pytest.approx(float(values[-1]))
    window.see("[data-key='limits.current_A'] .back").click()
    window.rests()
    assert number.input_value() == "4"
    assert window.state("requested.changes") == {}
    assert window.limit() == pytest.approx(4.0)


def test_a_number_that_is_being_typed_outlives_the_answer_to_the_one_before(window: Window) -> None:
    typed(window, "3")
    number = window.see("[id='of-limits.current_A-number']")
    number.fill("2.7")
    window.rests()
    assert window.limit() == pytest.approx(3.0)
    assert number.input_value() == "2.7"
    number.press("Enter")
    window.rests()
    assert window.limit() == pytest.approx(2.7)


def test_what_is_refused_is_said_at_its_field_and_a_limit_is_switched_on_and_off(window: Window) -> None:
    for text, words in (("-1", "current = -1"), ("1e3", "peak current of 10 A"), ("four", "is no number")):
        typed(window, text)
        window.says("[data-key='limits.current_A'] .note", words)
        assert window.limit() == pytest.approx(4.0)
    typed(window, "4")
    playwright.expect(window.see("[data-key='limits.current_A'] .note")).to_have_count(0)
    row = window.see("[data-key='limits.supply_V']")
    row.locator("input[type=checkbox]").check()
    window.rests()
    assert window.state("requested.changes")["limits.supply_V"] == pytest.approx(10, rel=0.02)
    row.locator("input[type=checkbox]").uncheck()
    assert row.locator("input.number").input_value() == ""
    assert window.state("requested.changes") == {}


def test_the_limit_is_dragged_in_the_plot_by_pointer_and_by_keys(window: Window) -> None:
    window.see("#handle").scroll_into_view_if_needed()
    box = window.see("#handle").bounding_box()
    assert window.limit() == pytest.approx(4.0)
    window.tab.mouse.move(box["x"] + 300, box["y"] + 12)
    window.tab.mouse.down()
    window.tab.mouse.move(box["x"] + 300, box["y"] + 30, steps=8)
    window.tab.mouse.up()
    window.rests()
    dragged = window.limit()
    assert 1.0 < dragged < 3.9
    window.see("#handle").focus()
    window.tab.keyboard.press("ArrowUp")
    window.says("#handle span", f"{float(f'{1.02 * dragged:.3g}'):g} A")
    assert window.see("#handle").get_attribute("aria-valuetext")
    window.see("#undo").click()
    window.says("#handle span", f"{float(f'{dragged:.3g}'):g} A")


def test_time_is_zoomed_and_read(window: Window) -> None:
    window.says("#looked-at", "to 20 ms")
    window.see("#plot").focus()
    for key, words in (("End", "to 109.7 ms"), ("Home", "to 20 ms"), ("+", "to 16."), ("PageDown", "to 23.")):
        window.tab.keyboard.press(key)
        window.says("#looked-at", words)
    window.tab.keyboard.press("ArrowRight")
    window.says("#read", re.compile(r"ms: recorded -?[0-9.]+ g, optimum"))
    window.see("[data-look=whole]").click()
    box = window.see("#plot").bounding_box()
    window.tab.mouse.move(box["x"] + 100, box["y"] + 60)
    window.tab.mouse.down()
    window.tab.mouse.move(box["x"] + 300, box["y"] + 60, steps=4)
    window.tab.mouse.up()
    assert window.see("#looked-at").inner_text() != "-0.2 to 109.7 ms"
    assert window.inked("clipped") > 0
    window.see("[data-curve=clipped]").click()
    assert window.inked("clipped") == 0


def test_the_error_is_asked_for_instead(window: Window) -> None:
    playwright.expect(window.see("#error-key option").first).to_contain_text(" to ")
    window.see("#error-key").select_option("limits.current_A")
    window.see("#error-number").fill("25")
    window.see("#error-number").press("Enter")
    window.says("#answer", "takes a current of")
    window.rests()
    assert window.limit() > 4.0
    assert window.state("frame.taps[1].figures.tap_error") <= 0.25
    window.see("#cells .cell").first.click()
    window.says("#answer", "Nothing need be done")
    playwright.expect(window.see("#error-key option").first).to_contain_text(" to ")
    window.see("#error-key").select_option("limits.current_A")
    window.see("#error-number").fill("40")
    window.see("#error-number").press("Enter")
    window.says("#answer", "already")
    before = window.limit()
    window.see("#error-set").click()
    window.rests()
    assert window.limit() < before


def test_a_tap_between_the_nodes(window: Window) -> None:
    window.see("#probe").check()
    playwright.expect(window.see("#cells .cell")).to_have_count(3)
    window.says("#state", "3 of 3 certified")
    before = window.see("#cells .place").inner_text()
    window.see("#probe-speed_m_s").press("PageUp")
    playwright.expect(window.see("#cells .place")).not_to_have_text(before)
    typed_speed = window.see("#probe-speed_m_s-number")
    typed_speed.fill("9")
    typed_speed.press("Enter")
    window.says("#probes .note", "outside of the recorded ones")
    window.see("#probe").uncheck()
    playwright.expect(window.see("#cells .cell")).to_have_count(2)


def test_a_warm_coil_is_played_beside_the_optimum(browser: Any, small: Scene) -> None:
    with Page(with_values(small, {"grid.cool_share": 0.36})) as served:
        window = Window(browser, served.address)
        playwright.expect(window.see("#key .warm")).to_be_hidden()
        window.see("#warm").check()
        playwright.expect(window.see("#key .warm")).to_be_visible()
        window.says("#selected", "of the cool command: tap error")
        window.rests()
        assert window.state("frame.taps[1].warm_input.length") == window.state("frame.taps[1].input.length")
        part = window.state("frame.taps[1].warm.cooled")
        assert 0 < part < 1
        window.says("#selected", f"{100 * part:.1f} % of the cool command: tap error")
        played = window.state("frame.taps[1].warm.figures.tap_error")
        assert window.see("#table tbody tr").nth(1).locator("td.warm").inner_text() == f"{100 * played:.1f}"
        assert window.state("frame.taps[1].warm.heat_A2_ms") < window.state("frame.taps[1].heat_A2_ms")
        window.see("#winding").fill("0")
        window.says("#selected", "on the warm coil the first command: tap error")
        assert window.see("#winding-number").input_value() == "25"
        window.see("#warm").uncheck()
        playwright.expect(window.see("#key .warm")).to_be_hidden()
        window.rests()
        assert window.state("frame.taps[1].warm") is None
        assert window.errors == []
        window.tab.close()


def test_what_is_not_certified_is_grey_and_says_why(browser: Any) -> None:
    one = {"grid.speeds_m_s": [0.4], "grid.grips_N": [5.0]}
    scene = with_values(load_scene("low_supply"), {"limits.supply_V": 0.3, **one})
    with Page(scene) as served:
        window = Window(browser, served.address)
        assert window.see("#cells .refused").count() == 1
        assert window.inked("clipped", "#cells") == window.inked("recorded", "#cells") == 0
        window.says("#reason", "supply")
        window.says("#reason", "would do")
        playwright.expect(window.see("#detail")).to_have_class(re.compile("refused"))
        assert window.state("frame.taps[0].certified") is False
        assert window.errors == []
        window.tab.close()
