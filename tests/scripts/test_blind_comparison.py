"""Taps on the compiled device: recorded and compared, and two libraries compared blindly by simulated persons."""

import csv
from pathlib import Path

import pytest

from tests.benches.scripts import script
from transopt.base.errors import InputError
from transopt.design.build import build_library
from transopt.library.library import Library
from transopt.recordings.recording import Recording
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

blind = script("blind_comparison")
Answer, Answers, Judge = blind.Answer, blind.Answers, blind.Judge
first_of, main, summary = blind.first_of, blind.main, blind.summary

CUT_A = 2.5


def built(scene: Scene, taps: list[Recording], objective: str) -> Library:
    changed = with_values(scene, {"limits.current_A": CUT_A, "weights.objective": objective})
    library = build_library(changed, taps).library
    assert library is not None
    return library


@pytest.fixture(scope="module")
def pair(scene: Scene, taps: list[Recording], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Waveform and intensity under a limit that cuts the taps."""
    folder = tmp_path_factory.mktemp("pair")
    paths = folder / "waveform.npz", folder / "intensity.npz"
    for path, objective in zip(paths, ("waveform", "intensity"), strict=True):
        built(scene, taps, objective).save(path)
    return paths


def answered(chosen: str, first: str = "A") -> Answer:
    interval = 1 if chosen == first else 2
    return Answer(0, 0, first, interval, chosen, 1, 0.3, 3.0, 0.3, 3.0, "a", "b")


@pytest.mark.usefixtures("c_compiler")
class TestSimulated:
    def test_a_person_who_goes_by_intensity_prefers_it(
        self, pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "answers.csv"
        assert main(*pair, csv_file=file, simulate=True, trials=6, taps=1, judge=Judge.INTENSITY) == 0
        rows = list(csv.DictReader(file.read_text().splitlines()))
        assert len(rows) == 6
        assert {row["first"] for row in rows} == {"A", "B"}
        assert sum(row["chosen"] == "B" for row in rows) > 3
        said = capsys.readouterr().out
        assert "B was nearer in" in said
        assert "intensity.npz" not in said

    def test_it_goes_on_where_it_was_left(self, pair: tuple[Path, Path], tmp_path: Path) -> None:
        file = tmp_path / "answers.csv"
        main(*pair, csv_file=file, simulate=True, trials=2, taps=1)
        before = file.read_text()
        main(*pair, csv_file=file, simulate=True, trials=3, taps=1)
        assert file.read_text().startswith(before)
        assert len(file.read_text().splitlines()) == 4


def test_both_orders_come_as_often_and_follow_from_the_seed() -> None:
    order = [first_of(7, trial) for trial in range(40)]
    assert order.count("A") == order.count("B") == 20
    assert order == [first_of(7, trial) for trial in range(40)]
    assert order != [first_of(8, trial) for trial in range(40)]


def test_every_answer_is_on_the_disk_at_once(tmp_path: Path) -> None:
    file = tmp_path / "answers.csv"
    answers = Answers(file, 0, ("a", "b"))
    for n, chosen in enumerate("ABB", start=1):
        answers.add(answered(chosen))
        assert Answers(file, 0, ("a", "b")).all == answers.all
        assert len(answers.all) == n


def test_the_summary_has_the_exact_interval() -> None:
    # Clopper and Pearson: 15 of 20 gives 50.9 to 91.3 %.
    said = summary([answered("B")] * 15 + [answered("A")] * 5)
    assert "B was nearer in 15 of 20 trials: 75 %, 95 % interval 51 to 91 %" in said
    assert summary([]) == "no answers"


def test_other_answers_are_not_mixed_in(tmp_path: Path) -> None:
    file = tmp_path / "answers.csv"
    Answers(file, 0, ("a", "b")).add(answered("A"))
    with pytest.raises(InputError, match="on other libraries or of seed 0: choose another file"):
        Answers(file, 0, ("a", "c"))
    with pytest.raises(InputError, match="of seed 0"):
        Answers(file, 1, ("a", "b"))
    file.write_text("something else\n1\n")
    with pytest.raises(InputError, match="no answers of a comparison"):
        Answers(file, 0, ("a", "b"))


def test_libraries_that_differ_in_more_than_waveforms_are_refused(
    pair: tuple[Path, Path], library: Library, tmp_path: Path
) -> None:
    other = tmp_path / "other.npz"
    library.save(other)
    with pytest.raises(InputError, match="make both from one scene"):
        main(pair[0], other, csv_file=tmp_path / "answers.csv", simulate=True)
    with pytest.raises(InputError, match="the same waveforms"):
        main(pair[0], pair[0], csv_file=tmp_path / "answers.csv", simulate=True)
    with pytest.raises(InputError, match="give --port PORT or --simulate"):
        main(*pair, csv_file=tmp_path / "answers.csv")


end_to_end = script("device_end_to_end")


@pytest.mark.usefixtures("c_compiler", "pseudo_terminal")
def test_a_tap_goes_over_the_line_into_a_file_and_agrees_with_its_prediction(
    library: Library, tmp_path: Path
) -> None:
    [condition] = end_to_end.recorded(library, [(0.3, 3.0)], end_to_end.IDEAL, 1, 0, tmp_path / "taps")
    assert condition.latency_rms_s < end_to_end.MOST_LATENCY_S
    assert condition.playback_errors[0] < 0.01
    # What the limits leave of it at this node is told apart from how well it is played.
    assert abs(condition.tap_error - library.tap_error[library.speeds_m_s == 0.3, library.grips_N == 3.0][0]) < 0.02
    assert condition.taps[0].contact.speed_m_s == pytest.approx(0.3, rel=0.05)
