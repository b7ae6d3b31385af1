"""What report.md says beside its tables of figures."""

import re
from dataclasses import replace

import numpy as np
import pytest

import problems
from transopt.base.writing import percent
from transopt.design.build import Build, build_library
from transopt.report.markdown import build_markdown
from transopt.report.report_json import build_json
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
