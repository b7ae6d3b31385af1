"""The inverse question: scan, bisection, evidence."""

import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benches.study import plain, serial
from transopt.base.errors import InputError
from transopt.scene.scene import Scene
from transopt.study.axes import parse_axis
from transopt.study.figures import entry_grid, question_figure
from transopt.study.inverse import Answer, answer, parse_question, parse_requirement
from transopt.study.plan import Plan
from transopt.study.session import run_plan, run_question


class TestSearch:
    """Against made-up errors, two entries at every value."""

    def ask(
        self,
        scene: Scene,
        error: Callable[[float], float],
        span: str,
        require: str = "tap_error<=0.1",
        **options: Any,
    ) -> Answer:
        question = parse_question(scene, f"limits.current_A={span}", [require], **{"greatest": False, **options})

        def rows(value: float) -> list[dict[str, str]]:
            common = {"speed_m_s": "0.4", "target": "", "reason": "", "status": "OPTIMAL"}
            worse = {**common, "grip_N": "5.0", "tap_error": repr(error(value))}
            if np.isnan(error(value)):
                worse.update(status="INFEASIBLE", tap_error="", reason="no way")
            return [{**common, "grip_N": "1.0", "tap_error": "0.01"}, worse]

        return answer(question, lambda values: [rows(value) for value in values])

    def test_least_with_evidence_on_both_sides(self, scene: Scene) -> None:
        found = self.ask(scene, lambda A: 1 / (5 * A), "1:6:0.001")
        assert found.met.value == pytest.approx(2.0, abs=1e-3)
        assert found.met.value >= 2.0 > found.missed.value
        assert found.met.value - found.missed.value <= 1e-3
        assert found.worst(found.missed)["grip_N"] == "5.0"
        assert found.crossings == 1
        assert "2.00" in found.sentences[0]
        assert len(found.tried) < 25

    def test_greatest(self, scene: Scene) -> None:
        found = self.ask(scene, lambda A: A / 40, "1:6:0.001", greatest=True)
        assert found.met.value == pytest.approx(4.0, abs=1e-3)
        assert found.met.value <= 4.0 < found.missed.value

    def test_error_that_is_not_monotone(self, scene: Scene) -> None:
        def error(A: float) -> float:
            return 0.05 if 2 <= A <= 3 or A >= 5 else 0.5

        least = self.ask(scene, error, "1:6:0.001")
        greatest = self.ask(scene, error, "1:6:0.001", greatest=True)
        assert least.met.value == pytest.approx(2.0, abs=1e-3)
        assert least.crossings == 3
        assert any("3 times: the error is not monotone" in sentence for sentence in least.sentences)
        assert (greatest.met.value, greatest.missed) == (6.0, None)

    def test_none_and_the_end_of_the_range(self, scene: Scene) -> None:
        none = self.ask(scene, lambda A: 0.2 + abs(A - 3.5), "1:6")
        assert none.met is None
        assert "No limits.current_A of 9 tried from 1 to 6 A meets tap_error <= 10 %" in none.sentences[0]
        assert "nearest is 3.5 A" in none.sentences[0]
        flat = dict[bool, Answer]()
        for greatest in (False, True):
            flat[greatest] = self.ask(scene, lambda A: max(0.2, 0.5 - A / 10) - 1e-7 * A, "1:9", greatest=greatest)
        assert "nearest is 3.0 A" in flat[False].sentences[0], "what costs least of those that do as well"
        assert "nearest is 9.0 A" in flat[True].sentences[0]
        every = self.ask(scene, lambda A: 0.05, "1:6")
        assert (every.met.value, every.missed, len(every.tried)) == (1.0, None, 9)
        assert "the end of the range itself" in " ".join(every.sentences)

    def test_a_refusal_is_a_miss_that_tells_its_reason(self, scene: Scene) -> None:
        found = self.ask(scene, lambda A: np.nan if A < 2.5 else 0.05, "1:6:0.01")
        assert found.met.value == pytest.approx(2.5, abs=0.01)
        assert "INFEASIBLE: no way" in " ".join(found.sentences)

    def test_where_all_is_refused_nothing_is_nearest(self, scene: Scene, tmp_path: Path) -> None:
        question = parse_question(scene, "limits.stroke_m=1e-4:4e-3", ["felt_error<=5%"], greatest=False)
        row = {
            "speed_m_s": "0.2",
            "target": "",
            "grip_N": "5",
            "status": "INFEASIBLE",
            "felt_error": "1.3",
            "reason": "no",
        }
        found = answer(question, lambda values: [[row] for _ in values])
        (told,) = found.sentences
        assert "each has an entry without a certified answer, as 0.0001 m: 0.2 m/s, 5 N (INFEASIBLE: no)." in told
        question_figure(found, "stroke [m]").savefig(tmp_path / "answer.png")

    def test_whole_numbers(self, scene: Scene) -> None:
        question = parse_question(scene, "time.stages=100:600", ["tap_error>=0.3"], greatest=False)
        asked: list[float] = []

        def rows(value: float) -> list[dict[str, str]]:
            asked.append(value)
            entry = {"speed_m_s": "1", "target": "", "grip_N": "1"}
            return [{**entry, "status": "OPTIMAL", "tap_error": repr(value / 1000), "reason": ""}]

        found = answer(question, lambda values: [rows(value) for value in values])
        assert (found.met.value, found.missed.value) == (300, 299)
        assert all(isinstance(value, int) for value in asked)


class TestAnswers:
    def test_against_a_fine_scan_and_again_after_a_kill(self, short: Scene, tmp_path: Path) -> None:
        plan = Plan(short, (), (0.4,), (1.0, 5.0))
        question = parse_question(short, "limits.current_A=2:6:0.01", ["tap_error<=0.48"], greatest=False)
        found = run_question(plan, question, tmp_path / "ask", serial())

        axis = parse_axis(short, "--vary", "limits.current_A=2:6:161")
        near = [A for A in axis.values if abs(A - found.met.value) < 0.3]
        axis = replace(axis, values=tuple(near), labels=tuple(map(repr, near)))
        scanned = replace(plan, axes=(axis,))
        rows = run_plan(scanned, tmp_path / "scan", serial())
        error = entry_grid(scanned, rows, "tap_error").max(axis=(1, 2))
        least = min(A for A, e in zip(near, error, strict=True) if e <= 0.48)
        assert found.missed.value < least <= found.met.value + 0.025
        assert {row["status"] for row in found.met.rows + found.missed.rows} == {"OPTIMAL"}

        path = tmp_path / "ask" / "rows.csv"
        before = plain(path)
        with closing(sqlite3.connect(tmp_path / "ask" / "study.sqlite")) as file, file:
            file.execute('DELETE FROM rows WHERE "index" >= ?', [2 * len(before) // 3])
        again = run_question(plan, question, tmp_path / "ask", serial())
        assert (again.met.value, again.missed.value) == (found.met.value, found.missed.value)
        assert plain(path) == before

    @pytest.mark.parametrize(
        ("key", "words"),
        [
            ("motor.R_ohm=1:2", "one row of a datasheet"),
            ("weights.rapid=1:2", "not a number that can be solved for"),
            ("limits.beta=1", "give KEY=LOW:HIGH or KEY=LOW:HIGH:TOLERANCE"),
            ("limits.beta=1:2:3", "TOLERANCE must be above 0 and at most HIGH - LOW = 1"),
        ],
    )
    def test_refusals(self, scene: Scene, key: str, words: str) -> None:
        with pytest.raises(InputError, match=words):
            parse_question(scene, key, ["tap_error<=0.1"], greatest=False)


def test_a_share_is_stated_and_shown_in_percent() -> None:
    asked = parse_requirement("tap_error<=30%")
    assert asked.bound == pytest.approx(0.3)
    assert asked.text == "tap_error <= 30 %"
    assert asked.in_words == "tap error of at most 30 %"
    assert parse_requirement("tap_error <= 0.3") == parse_requirement("tap_error <= 30 %")
    assert parse_requirement("bump_m_s2>=2.5").text == "bump_m_s2 >= 2.5 m/s^2"
    with pytest.raises(InputError) as refused:
        parse_requirement("felt_error<=30")
    for proposed in re.findall(r"felt_error<=[\d.%]+", str(refused.value).partition("write ")[2]):
        assert parse_requirement(proposed).bound == pytest.approx(0.3)
