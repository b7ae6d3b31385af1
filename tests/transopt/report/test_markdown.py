"""Words of a report, the first look, and files that come together."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import problems
import transopt as to
from transopt.base.axes import Axes
from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.writing import percent
from transopt.design.build import Build, build_library
from transopt.design.price import Price
from transopt.library.columns import TableRow
from transopt.report.first import MOST_ROWS, Look, head, lines, matrix, next_commands, priced, worst_line
from transopt.report.markdown import build_markdown
from transopt.report.report_json import build_json
from transopt.report.tables import warnings
from transopt.report.write import publish
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings


def section(text: str, head: str) -> list[str]:
    """Lines of a section, up to the next head."""
    lines = text.split(f"## {head}\n", 1)[1].splitlines()
    return lines[: next((at for at, line in enumerate(lines) if line.startswith("## ")), len(lines))]


@pytest.fixture(scope="module")
def tapping() -> Build:
    """The entry whose steady state is at the winding's limit, and the stroke limited as well."""
    data = problems.load("rapid_tapping").model_dump()
    data["grid"].update(speeds_m_s=[0.4], grips_N=[5.0])
    data["limits"]["stroke_m"] = 0.04
    scene = Scene.model_validate(data)
    return build_library(scene, recordings(scene))


class TestPrices:
    def test_a_row_for_each_limit_that_binds(self, tapping: Build) -> None:
        """A row says what the price's sentence does: the limit, a step more, and from where on it would not bind."""
        (entry,) = tapping.all_entries()
        rows = [
            line
            for line in section(build_markdown(tapping), "What binds, and what more would buy")
            if "| 0.4" in line
        ]
        assert {price.limit for price in entry.prices} >= {"current", "coil"}
        for row, price in zip(rows, entry.prices, strict=True):
            cells = [cell.strip() for cell in row.strip("|").split("|")]
            assert cells == [
                "0.4",
                "5",
                price.stated,
                percent(price.tap_error),
                price.more,
                percent(price.then),
                price.free_from,
                percent(price.there),
            ]
        coil = next(price for price in entry.prices if price.limit == "coil")
        assert (coil.stated, coil.more) == ("coil 100 C", "10 K")

    def test_what_is_not_certified_is_called_so(self, tapping: Build) -> None:
        (entry,) = tapping.all_entries()
        unknown = replace(entry.prices[0], then=np.nan, enough=np.nan, there=np.nan)
        text = build_markdown(replace(tapping, entries=[[entry.stating(prices=[unknown])]]))
        (row,) = (line for line in section(text, "What binds, and what more would buy") if "| 0.4" in line)
        assert row.count("not certified") == 3
        assert '"then": null' in build_json(replace(tapping, entries=[[entry.stating(prices=[unknown])]]))


class TestCertificates:
    def test_margins_stand_beside_them(self, tapping: Build) -> None:
        """0.02 % of the 75 K that the winding may rise in its steady state, and micrometres of the stroke."""
        (said,) = (line for line in section(build_markdown(tapping), "Certificates") if "the problem keeps" in line)
        assert "coil 0.015 K" in said
        assert re.search(r"stroke 1\.\de-06 m", said)

    def test_a_problem_that_keeps_nothing_says_nothing(self, build: Build) -> None:
        assert "the problem keeps" not in build_markdown(build, full=False)


def test_a_scene_without_a_description_has_a_report(build: Build) -> None:
    plain = replace(build, scene=build.scene.model_copy(update={"description": ""}))
    assert build_markdown(plain, full=False).startswith("# wood_on_foam\n\nThe recordings are **simulated**")


def written(path: Path) -> None:
    path.write_text("new")


def test_everything_comes_at_the_end_and_what_is_stale_goes(tmp_path: Path) -> None:
    (tmp_path / "stale").write_text("old")

    def last(path: Path) -> None:
        assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["stale"]
        written(path)

    publish(tmp_path, {"a": written, "b": last}, ["stale"])
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys("ab", "new")


def test_a_folder_that_is_gone_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="gone: cannot be written"):
        publish(tmp_path / "gone", {"a": written})


def test_no_error_names_the_place_beside(tmp_path: Path) -> None:
    def fails(path: Path) -> None:
        with whole_file(path) as file:
            file.write(b"half")
            raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match=r"a: cannot be written .No space left") as caught:
        publish(tmp_path, {"a": fails})
    assert str(caught.value).startswith(f"{tmp_path / 'a'}:")
    assert list(tmp_path.iterdir()) == []


FINE, WEAK = "felt within 1.6 dB", "too weak by 2.4 dB, most at 160 Hz; held back by current"
BINDS = "command +6 A at -0.13 ms; current +4 A at 1.17 to 3.17 ms"


def row(tap: float, verdict: str = FINE, refusal: str = "", **values: Any) -> TableRow:
    return TableRow((), {"tap": tap, "floor": 0.2, "felt": tap / 2, "verdict": verdict, **values}, refusal)


def look(rows: Sequence[Sequence[TableRow]], axes: Axes | None = None) -> Look:
    if axes is None:
        speeds, grips = (tuple(0.1 * (k + 1) for k in range(count)) for count in (len(rows), len(rows[0])))
        axes = Axes(speeds, grips)
    return Look("scene", axes, rows, "proven optimal")


def price(**values: float) -> Price:
    stated = {"bound": 4.0, "tap_error": 0.3, "step": 1.0, "then": 0.25, "enough": 6.0, "there": 0.2, "tried": np.inf}
    return Price("current", "A", "A", **{**stated, **values})


def numbers(line: str) -> list[str]:
    return re.findall(r"(\d+\.\d+)\*", line)


def test_all_is_well() -> None:
    found = look([[row(0.2), row(0.2)]])
    assert head(found) == "scene: 2 taps, all proven optimal."
    assert worst_line(found, ()).endswith("held back by no limit: the waveform ends while the hand still pushes.")
    assert head(look([[row(0.2)]])) == "scene: 1 tap, proven optimal."


def test_what_is_poor_comes_before_what_is_proven() -> None:
    for poor, why in (
        (row(0.6), "60.0 % of it is missing"),
        (row(0.3, verdict=WEAK), "too weak by 2.4 dB"),
        (row(0.3, felt=0.7), "its waveform is 70.0 % off where fingers feel"),
        (row(0.3, after=0.8), "an error of 80.0 % of it follows after the waveform"),
    ):
        found = look([[row(0.2), poor]])
        said = head(found)
        assert said.startswith("scene: 1 of 2 taps is poor: at 0.1 m/s, 0.2 N ")
        assert said.index(why) < said.index("The limits allow no better: all are proven optimal.")
        assert "!" in matrix(found, 80)[1]
    held = look([[row(0.3, held=BINDS, verdict=WEAK)]])
    assert "30.0*!" in matrix(held, 80)[1]


def test_what_is_refused_comes_first_and_is_marked() -> None:
    refused = row(np.nan, refusal="no command meets all limits")
    found = look([[row(0.2), refused], [row(0.3), row(0.6)]])
    assert head(found).startswith("scene: 1 of 4 taps refused, so no library is written")
    assert matrix(found, 80)[1].split()[-2:] == ["20.0", "x"]
    nothing = look([[refused]])
    assert nothing.worst is None
    assert worst_line(nothing, ()) == ""


def test_a_mark_says_which_limit_holds_back_and_a_floor_has_none() -> None:
    found = look([[row(0.3, held=BINDS), row(0.2)]])
    assert found.held(0, 0) == ["6 A command", "4 A current"]
    assert found.held(0, 1) == []
    supply = look([[row(0.3, held="supply -9 V with the copper at 100 C at -0.13 ms; supply +9 V at 1 ms")]])
    assert supply.held(0, 0) == ["9 V supply"]
    own = look([[row(0.3, held="knee 0.2 at 3 ms")]])
    assert own.held(0, 0) == ["0.2 knee"]


@pytest.mark.parametrize("width", [60, 100, 160])
@pytest.mark.parametrize("shape", [(1, 1), (4, 3), (12, 1), (40, 1), (3, 60), (40, 25)])
def test_any_grid_fits_and_shows_ends_and_worst(shape: tuple[int, int], width: int) -> None:
    rng = np.random.default_rng(shape[0])
    errors = rng.uniform(0.1, 0.4, shape)
    worst = np.unravel_index(int(np.argmax(errors)), shape)
    found = look([[row(error, floor=0.05, held=BINDS) for error in each] for each in errors])
    shown = matrix(found, width)
    assert max(map(len, shown)) <= width
    assert len(shown) <= MOST_ROWS + 2
    there = {float(number) for line in shown[1:] for number in numbers(line)}
    for corner in (errors[0, 0], errors[-1, -1], errors[0, -1], errors[worst]):
        assert float(f"{100 * corner:.1f}") in there
    all_shown = sum(len(numbers(line)) for line in shown[1:]) == errors.size
    assert shown[-1].endswith("--table has all)") is not all_shown


def test_one_grip_is_a_line_of_speeds_and_nobodys_is_called_free() -> None:
    found = look([[row(0.2)] for _ in range(4)], Axes((0.1, 0.2, 0.3, 0.4), (0.0,)))
    first, second = matrix(found, 80)
    assert first.split() == ["tap", "error", "%", *(word for v in (0.1, 0.2, 0.3, 0.4) for word in (f"{v}", "m/s"))]
    assert second.startswith("free")


def test_targets_are_lines() -> None:
    found = look([[row(0.2)], [row(0.3, held=BINDS)]], Axes((0.0, 0.0), (0.0,), ("click", "a" * 90)))
    shown = matrix(found, 60)
    assert [line.split()[-1] for line in shown] == ["%", "20.0", "30.0*"]
    assert max(map(len, shown)) <= 60
    assert head(found) == "scene: 2 targets, all proven optimal."


def test_the_sentence_says_what_more_of_the_dearest_limit_buys() -> None:
    found = look([[row(0.2), row(0.3, held=BINDS)]])
    said = worst_line(found, [price()])
    assert said.startswith(
        "Worst: 0.1 m/s, 0.2 N: 30.0 % (felt 15.0 %). The 4 A current limit costs most: with 5 A 25.0 %;"
    )
    assert said.endswith("from about 6 A on it no longer matters.")
    assert "no certified answer with 5 A" in worst_line(found, [price(then=np.nan)])
    assert "still binds at 120 A" in worst_line(found, [price(enough=np.inf, tried=120.0)])
    # A floor that is higher than all that limits cost: both entries are named.
    two = look([[row(0.4, floor=0.4), row(0.3, held=BINDS)]])
    said = worst_line(two, [price()])
    assert "0.1 m/s, 0.1 N: 40.0 %" in said
    assert "costs most at 0.1 m/s, 0.2 N, 30.0 %: with 5 A" in said


def test_build_and_library_say_the_same() -> None:
    scene = with_values(to.load_scene("wood_on_foam"), {"grid.speeds_m_s": [0.2, 0.4], "grid.grips_N": [5.0]})
    build = to.build(scene)
    assert build.library is not None
    of_build = lines(build, Look.of_build(build), 80)
    of_library = lines(build.library, Look.of_library(build.library, proven=True), 80)
    assert of_build[1:] == of_library[1:]
    assert "The 4 A current limit costs most: with 5 A 27.9 %" in of_library[-1][0]
    assert "not checked" in head(Look.of_library(build.library, proven=False))


def test_a_short_stroke_holds_back_a_tap_with_less_error_than_its_floor() -> None:
    changes = {"grid.speeds_m_s": [0.1], "limits.stroke_m": 1e-3}
    build = to.build(with_values(to.load_scene("single_grip"), changes))
    ((entry,),) = build.entries
    assert entry.figures.tap_error < entry.floor
    assert entry.unlimited_objective < 0.1 * entry.certificate.objective
    assert entry.verdict.endswith("held back by stroke and command")
    assert build.library is not None
    look = Look.of_library(build.library, proven=False)
    assert look.held(0, 0) == Look.of_build(build).held(0, 0) == ["0.001 m stroke", "6 A command"]
    assert look.poor == [(0, 0)]
    assert "held back by the 0.001 m stroke" in worst_line(look, priced(build.library, look))
    (said,) = warnings(build)
    assert said.endswith("the 0.001 m stroke and the 6 A command limits bind")
    # What the manual says of this line: widen the limit, or tap more slowly.
    for change in ({"limits.stroke_m": 4e-3}, {"grid.speeds_m_s": [0.03]}):
        assert not warnings(to.build(with_values(build.scene, change)))


@pytest.mark.parametrize(("scene", "is_played"), [("wood_on_foam", True), ("hot_coil", True), ("small_coil", False)])
def test_no_tap_is_proposed_on_a_coil_that_withholds_all(scene: str, is_played: bool) -> None:
    proposed = next_commands(Path("a b.npz"), to.load_scene(scene))
    assert all("'a b.npz'" in command for command in proposed)
    assert any(command.startswith("transopt-play tap") for command in proposed) == is_played
