"""What the page shows is what a library would hold."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import problems
import transopt as to
from tests.benches.actuators import nonlinear_scene
from transopt.base.errors import InputError
from transopt.design.build import build_library
from transopt.library.columns import EntryTable
from transopt.plant.state_space import StateSpace
from transopt.problem.answer import Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.report.tried import AskedError
from transopt.scene.recordings import recordings_of, references_of
from transopt.scene.scene import Scene
from transopt.solvers import unlimited
from transopt.web.controls import controls
from transopt.web.opening import described, opened, own_taps
from transopt.web.question import limit_for_error, movers
from transopt.web.service import Service
from transopt.web.shown import FIGURES, Shown, plain

RECORDINGS = Path(__file__).parents[3] / "problems/recordings"


def _tap_error(shown: Shown) -> float:
    assert shown.figures is not None
    return shown.figures.tap_error


@pytest.mark.parametrize("name", ["single_grip", "lra_click"])
def test_the_table_is_the_librarys(name: str) -> None:
    service, scene = opened(name), to.load_scene(name)
    build = build_library(scene, recordings_of(scene))
    entries = list(build.all_entries())
    for index in {0, len(entries) - 1}:
        entry = entries[index]
        quick, settled = service.quick([index])[0], service.settled(index)
        for shown in (quick, settled):
            assert shown.certified
            assert shown.figures is not None
            assert vars(shown.figures) == pytest.approx(vars(entry.figures), rel=1e-6, nan_ok=True)
            assert shown.floor == pytest.approx(entry.floor, rel=1e-8)
            assert shown.heat_A2_ms == pytest.approx(1e3 * entry.heat_A2_s, rel=1e-8, nan_ok=True)
            assert shown.binds == entry.binding
        assert settled.replayed
        assert settled.verdict == entry.verdict
        assert [price.sentence for price in settled.prices] == [price.sentence for price in entry.prices]


def test_a_nonlinear_plant_is_refused(tmp_path: Path) -> None:
    scene, library = nonlinear_scene(tmp_path), to.solve("lra_click")
    with pytest.raises(InputError, match="this needs a linear plant"):
        opened(scene)
    of_nonlinear = replace(library, meta={**library.meta, "scene": to.load_scene(scene).model_dump(mode="json")})
    with pytest.raises(InputError, match="page: this library's plant is nonlinear"):
        opened(of_nonlinear)


def test_a_change_is_what_the_changed_scene_is_solved_to(service: Service) -> None:
    service.change({"limits.current_A": 3.0})
    changed = to.with_values(service.opened, {"limits.current_A": 3.0})
    (entry,) = [e for e in build_library(changed, recordings_of(changed)).all_entries() if e.speed_m_s == 0.4]
    shown = service.quick([1])[0]
    assert _tap_error(shown) == pytest.approx(entry.figures.tap_error, rel=1e-8)
    assert shown.curves is not None
    np.testing.assert_allclose(shown.curves.input[: entry.plant_input.size], entry.plant_input, atol=1e-9)
    assert np.abs(shown.curves.input).max() <= 3.0 + 1e-6


def test_the_later_of_two_statements_of_one_limit_counts(service: Service) -> None:
    service.change({"limits.current_A": 3.0})
    service.change({"limits.beta": 2.0})
    assert service.scene.limits.transient_input == pytest.approx(2.5)
    service.change({"limits.current_A": 3.5})
    assert service.scene.limits.transient_input == pytest.approx(3.5)


def test_what_the_scene_does_not_take_leaves_it_as_it_was(service: Service) -> None:
    with pytest.raises(to.InputError, match="i_peak_A"):
        service.change({"limits.current_A": 1e3})
    with pytest.raises(to.InputError, match="no slider"):
        service.change({"recordings.folder": "/"})
    assert service.scene == service.opened


def test_a_tap_between_the_nodes_is_the_optimum_there(service: Service) -> None:
    service.change({}, (0.3, 3.0))
    assert [place.title for place in service.places] == ["0.2 m/s, 3 N", "0.4 m/s, 3 N", "0.3 m/s, 3 N"]
    shown = service.settled(2)
    assert shown.certified
    assert _tap_error(shown) < _tap_error(service.settled(1))
    with pytest.raises(to.InputError, match="outside of the nodes"):
        service.change({}, (0.5, 3.0))


def test_what_cannot_be_met_is_not_shown_and_says_what_would_do() -> None:
    service = opened("low_supply")
    service.change({"limits.supply_V": 0.3})
    last = len(service.places) - 1
    quick = service.quick([last])[0]
    assert not quick.certified
    assert quick.reason
    assert quick.curves is not None
    assert np.isnan(quick.curves.optimum_m_s2).all()
    settled = service.settled(last)
    assert not settled.certified
    assert "supply" in settled.reason
    assert "would do" in settled.reason or "tried in vain" in settled.reason
    assert plain(settled)["figures"] is None


def test_the_inverse_question_finds_the_limit_that_an_error_needs(service: Service) -> None:
    (control,) = [each for each in controls(service.scene) if each.key == "limits.current_A"]
    found = limit_for_error(service, 1, control, 0.25)
    assert isinstance(found.value, float)
    service.change({control.key: found.value})
    assert _tap_error(service.quick([1])[0]) <= 0.25
    service.change({control.key: found.value - 0.02})
    assert _tap_error(service.quick([1])[0]) > 0.25
    none = limit_for_error(service, 1, control, 1e-4)
    assert none.value is None
    assert "met by no" in none.words
    assert "no limit at all leaves" in none.words


def test_nothing_need_be_done_for_an_error_that_is_met(service: Service) -> None:
    (control,) = [each for each in controls(service.scene) if each.key == "limits.current_A"]
    found = limit_for_error(service, 0, control, 0.5)
    assert not found.needed
    assert "Nothing need be done" in found.words
    assert isinstance(found.value, float)
    assert found.value < 4.0


def test_what_moves_an_error_does_so_by_the_library_of_the_changed_scene(service: Service) -> None:
    found = {mover.key: mover for mover in movers(service, 1) or []}
    controlled = {each.key: each for each in service.controls}
    assert movers(service, 1, lambda: True) is None
    assert service.changes == {}
    now = _tap_error(service.quick([1])[0])
    for key in ("limits.current_A", "weights.after_s"):  # a limit, and a key of the time axis
        ends = []
        for value in (controlled[key].low, controlled[key].high):
            service.change({key: value})
            ends.append(_tap_error(service.quick([1])[0]))
        assert (found[key].best, found[key].worst) == pytest.approx((min(now, *ends), max(now, *ends)), rel=1e-8)


def test_what_makes_a_refused_tap_possible_moves_it(service: Service) -> None:
    (control,) = [each for each in service.controls if each.key == "limits.velocity_m_s"]
    service.change({control.key: 1e-3})
    (now,) = [each for each in service.controls if each.key == control.key]
    assert (now.low, now.value, now.high) == (1e-3, 1e-3, control.high)  # the slider of the page, with room for it
    (mover,) = movers(service, 1) or []
    service.change({control.key: now.high})
    assert (mover.key, mover.best) == (control.key, pytest.approx(_tap_error(service.quick([1])[0]), rel=1e-8))


def test_every_point_of_a_price_is_the_error_under_that_limit(service: Service) -> None:
    (price, *_) = [each for each in service.settled(1).prices if each.label == "current"]
    assert len(price.points) > 4
    bounds = [bound for bound, _ in price.points]
    assert bounds == sorted(bounds)
    for bound, error in (price.points[0], price.points[2], price.points[-1]):
        service.change({"limits.current_A": bound})
        assert _tap_error(service.quick([1])[0]) == pytest.approx(error, rel=1e-4)


@pytest.mark.parametrize(("bounds", "outwards"), [("lower=9.9, upper=10.5", 1), ("lower=9.8", -1), ("upper=10.5", 1)])
def test_every_point_of_an_own_limits_price_is_the_error_under_its_bound(
    tmp_path: Path, bounds: str, outwards: int
) -> None:
    """Bounds on the current plus 10 A lie far from zero: half of them is no tighter limit."""
    text = problems.scene_path("wood_on_foam").read_text(encoding="utf-8").replace("stages = 800", "stages = 150")
    scene = tmp_path / "mine.toml"
    scene.write_text(text.replace("[limits]", '[limits]\nown = ["my_limits.py"]'), encoding="utf-8")

    def under(stated: str) -> Service:
        law = f"to.own_limit('bounded', 'A', lambda s: s.current + 10, {stated})"
        (tmp_path / "my_limits.py").write_text(f"import transopt as to\nLIMITS = [{law}]\n")
        return Service(to.with_values(to.load_scene(scene), {"grid.speeds_m_s": [0.4], "grid.grips_N": [3.0]}))

    (price, *_) = under(bounds).settled(0).prices
    assert (price.label, len(price.points) > 2) == ("bounded", True)
    other = 9.9 + price.now if "," in bounds else None
    for bound, error in (price.points[0], price.points[1], price.points[-1]):
        side = "upper" if outwards > 0 else "lower"
        both = "" if other is None else f"lower={other - bound}, "
        (shown,) = under(f"{both}{side}={bound}").quick([0])
        assert _tap_error(shown) == pytest.approx(error, rel=1e-4)


def test_the_cells_are_those_of_every_other_table(service: Service) -> None:
    entry = service.entry(1)
    row = EntryTable((), FIGURES, (entry,)).figures(entry)
    assert [service.settled(1).cells[name] for name in FIGURES] == row
    assert service.quick([1])[0].cells["tap"] == row[0]


def test_own_taps_take_the_place_of_the_scenes(tmp_path: Path, small: to.Scene) -> None:
    text = (RECORDINGS / "tap_0.3_m_s.csv").read_text()
    (tmp_path / "mine.csv").write_text(text)
    service = own_taps(Service(small), tmp_path, ["mine.csv"], {})
    assert len(service.places) == 1
    assert service.places[0].speed_m_s == pytest.approx(0.3)
    assert service.quick([0])[0].certified
    (tmp_path / "none.csv").write_text("a,b\n1,2\n")
    with pytest.raises(to.InputError, match=r"none\.csv"):
        own_taps(Service(small), tmp_path, ["none.csv"], {})


def test_an_answer_that_was_tried_on_a_file_reads_it(tmp_path: Path, small: to.Scene) -> None:
    """Both of a file without units and of one whose unit is wrong."""
    text = (RECORDINGS / "tap_0.3_m_s.csv").read_text()
    for head in ("time,acceleration,position_m", "time_s,acceleration_m_s2,position_m"):
        (tmp_path / "mine.csv").write_text(text.replace("time_s,acceleration_g,position_m", head))
        with pytest.raises(AskedError) as caught:
            own_taps(Service(small), tmp_path, ["mine.csv"], {})
        (answer, _), *_ = caught.value.good
        assert own_taps(Service(small), tmp_path, ["mine.csv"], answer).quick([0])[0].certified


def test_a_library_opens_without_its_recordings(tmp_path: Path) -> None:
    library = to.solve("lra_click")
    library.save(tmp_path / "library.npz")
    service = opened(tmp_path / "library.npz")
    assert _tap_error(service.quick([0])[0]) == pytest.approx(float(library.tap_error[0, 0]), rel=1e-8)
    assert described(service)["driven_by"]["unit"] == "V"


def test_the_saved_library_is_the_one_that_is_shown(service: Service) -> None:
    told: list[tuple[int, int]] = []
    service.change({"limits.current_A": 3.0})
    library = service.library(lambda done, of: told.append((done, of)))
    assert told[0] == (0, 2)
    assert told[-1] == (2, 2)
    assert (library.status == Status.OPTIMAL.value).all()
    assert float(library.tap_error[1, 0]) == pytest.approx(_tap_error(service.quick([1])[0]), rel=1e-8)


def test_a_library_that_was_refined_on_its_device_is_said_to_be_shown_anew(library: to.Library) -> None:
    assert described(opened(library))["remarks"] == []
    learnt = replace(library, meta={**library.meta, "refinement": {"rounds": []}})
    (remark,) = described(opened(learnt))["remarks"]
    assert "refined on its device" in remark


@pytest.mark.parametrize(
    ("changes", "terms_stay"),
    [
        ({"limits.current_A": 3.0}, True),
        ({"weights.rho": 0.02}, True),
        ({"weights.plain": 0.5}, False),
        ({"limits.stroke_m": 0.01, "limits.velocity_m_s": 1.0}, True),
    ],
)
def test_what_a_change_leaves_as_it_is_stays_the_same_objects_and_answers_alike(
    small: Scene, changes: dict[str, float], terms_stay: bool
) -> None:
    between = (0.31, 3.0)
    service, fresh = Service(small), Service(small)
    service.change({}, between)
    before = service.context.posed(*between).problem
    for current_A in (2.0, 4.0):
        service.change({"limits.current_A": current_A}, between)
        service.quick([0])
    service.change(changes, between)
    fresh.change(changes, between)
    after = service.context.posed(*between).problem
    assert after.target is before.target
    assert (after.terms is before.terms) is terms_stay
    for found, expected in zip(service.quick([2, 0]), fresh.quick([2, 0]), strict=True):
        assert found.cells == expected.cells
        assert found.curves is not None
        assert expected.curves is not None
        np.testing.assert_allclose(found.curves.input, expected.curves.input, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("key", "values", "solved"),
    [
        ("thermal.start_winding_C", (50.0, 60.0), 0),
        ("limits.velocity_m_s", (0.9, 1.1), 0),
        ("limits.current_A", (3.0, 3.5), 2),  # the unit of the movement's weight
        ("weights.rho", (0.02, 0.03), 2),
    ],
)
def test_a_drag_computes_anew_only_what_its_key_changes(
    small: Scene, key: str, values: tuple[float, float], solved: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    service, fresh = Service(small), Service(small)
    service.change({key: values[0]})
    service.quick([0, 1])
    passes, plants = list[TransientProblem](), list[float]()
    solve, plant = unlimited.solve, Scene.plant

    def counted(problems: Sequence[TransientProblem], *, brief: bool = False) -> list[Solution]:
        passes.extend(problems)
        return solve(problems, brief=brief)

    def built(scene: Scene, grip_N: float, *of: tuple[float, float] | None) -> StateSpace:
        plants.append(grip_N)
        return plant(scene, grip_N, *of)

    monkeypatch.setattr(unlimited, "solve", counted)
    monkeypatch.setattr(Scene, "plant", built)
    service.change({key: values[1]})
    found = service.quick([0, 1])
    assert (len(passes), plants) == (solved, [])
    fresh.change({key: values[1]})
    for each, expected in zip(found, fresh.quick([0, 1]), strict=True):
        assert each.floor == pytest.approx(expected.floor, rel=1e-9)
        assert each.curves is not None
        assert expected.curves is not None
        np.testing.assert_allclose(each.curves.optimum_m_s2, expected.curves.optimum_m_s2, rtol=0, atol=1e-7)
        np.testing.assert_allclose(each.curves.clipped_input, expected.curves.clipped_input, rtol=0, atol=1e-9)


def test_another_device_is_built_anew(service: Service) -> None:
    context = service.context
    before = context.stage(3.0)
    heavier = context.varied(to.with_values(service.scene, {"transmission.link_mass_kg": 0.03}))
    assert heavier.stage(3.0).plant.numbers != before.plant.numbers
    assert context.varied(to.with_values(service.scene, {"weights.rho": 0.02})).stage(3.0) is before


def test_files_are_not_read_again_for_another_tail(monkeypatch: pytest.MonkeyPatch) -> None:
    service, changes = opened("own_taps"), {"weights.after_s": 0.03}
    changed = to.with_values(service.opened, changes)
    expected = references_of(changed, recordings_of(changed))
    monkeypatch.setattr("transopt.web.service.recordings_of", lambda scene: pytest.fail("read again"))
    service.change(changes)
    for cell, other in zip(service.references(service.scene), expected, strict=True):
        assert cell.recorded_after_m_s2.size == changed.time_grid().after_stages
        np.testing.assert_allclose(cell.stacked, other.stacked, rtol=1e-12, atol=1e-12)
