"""The root search over the price of intensity, what its answer is worth, and the path to it."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.benches.limits import aiming_in_window
from tests.benches.quick_part import without_slow_part
from transopt.base.signals import FloatArray
from transopt.design.build import Build, build_library
from transopt.design.context import Context
from transopt.design.intensity import best, intense, most_price
from transopt.design.optimum import optimum
from transopt.problem.problem import TransientProblem
from transopt.proof.designed import Attained, Designed
from transopt.recordings.recording import Recording
from transopt.references.reference import Reference
from transopt.report.figures import trade_off_figure
from transopt.report.markdown import build_markdown
from transopt.report.report_json import build_json
from transopt.report.write import write_report
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.solvers.side_by_side import alone

OPTIONS = SolverOptions()
Posed = Callable[..., TransientProblem]


@pytest.fixture(scope="module")
def posed(scene: Scene, references: list[Reference]) -> Posed:
    def make(speed_m_s: float = 0.4, grip_N: float = 5.0, dB: float = 0.0, **changes: object) -> TransientProblem:
        changed = with_values(scene, {key.replace("__", "."): value for key, value in changes.items()})
        reference = next(r for r in references if r.speed_m_s == speed_m_s)
        if changed.feedback is not None:  # a hand that goes on for ever would press into the wall for ever
            reference = without_slow_part(reference, changed.time_grid())
        problem = Context(changed).posed_as(reference, grip_N).problem
        return replace(problem, intensity_dB=dB)

    return make


def attained(designed: Designed) -> Attained:
    assert designed.attained is not None
    return designed.attained


def J(problem: TransientProblem, command: np.ndarray) -> float:
    return problem.objective(command, problem.accelerations(command))


def energy_dB(problem: TransientProblem, command: np.ndarray) -> float:
    return problem.tracking.energy_dB(problem.accelerations(command))


@pytest.mark.parametrize("limit_A", [4.0, 2.5, 2.0])
def test_a_saturated_tap_gets_the_energy_it_is_asked_for(posed: Posed, limit_A: float) -> None:
    problem = posed(limits__current_A=limit_A)
    found = alone(intense(problem, OPTIONS))
    assert attained(found).waveform_dB < -1
    assert energy_dB(problem, found.solution.command) == pytest.approx(0.0, abs=0.01)
    assert attained(found).energy_dB == pytest.approx(energy_dB(problem, found.solution.command), abs=1e-9)
    assert found.problem.intensity == attained(found).price > 0
    assert found.certificate.accepted
    assert attained(found).problems <= 8
    assert found.certificate.objective == pytest.approx(J(problem, found.solution.command), rel=1e-9)


def test_floor_and_unlimited_optimum_stay_those_of_the_waveform(posed: Posed) -> None:
    problem = posed()
    plain, found = optimum(problem, OPTIONS), alone(intense(problem, OPTIONS))
    assert (found.floor, found.free_peak) == (plain.floor, plain.free_peak)
    np.testing.assert_array_equal(found.unlimited_command, plain.unlimited_command)
    assert attained(found).waveform_dB == pytest.approx(energy_dB(problem, plain.solution.command), abs=1e-9)


def test_a_tap_that_is_strong_enough_is_left_as_it_is(posed: Posed) -> None:
    problem = posed(speed_m_s=0.2, dB=-0.1)  # where no limit cuts it, the end of the waveform costs 0.04 dB
    found = alone(intense(problem, OPTIONS))
    np.testing.assert_array_equal(found.solution.command, optimum(problem, OPTIONS).solution.command)
    assert (attained(found).price, attained(found).problems) == (0.0, 1)
    assert "the optimum of the waveform has it" in attained(found).sentence


def test_less_than_the_waveform_has_costs_nothing_and_more_can_be_asked_for(posed: Posed) -> None:
    assert attained(alone(intense(posed(dB=-3.0), OPTIONS))).price == 0
    louder = alone(intense(posed(speed_m_s=0.2, dB=3.0), OPTIONS))
    assert attained(louder).energy_dB == pytest.approx(3.0, abs=0.01)


def test_no_command_with_as_much_energy_is_nearer(posed: Posed) -> None:
    """The claim of the certificate, tried: feasible commands that are as strong all have a larger J."""
    problem = posed(limits__current_A=2.5)
    found = alone(intense(problem, OPTIONS))
    best_A, rng = found.solution.command, np.random.default_rng(1)
    objective, level = J(problem, best_A), energy_dB(problem, best_A)
    lams = (0.7, 0.9, 0.97)
    others = [optimum(replace(problem, intensity=lam), OPTIONS).solution.command for lam in lams]
    tried = 0
    for _ in range(60):
        share = rng.uniform(0, 1)
        other = others[rng.integers(len(others))]
        command = (1 - share) * best_A + share * other  # inside every limit, being convex
        command[: problem.free_stages] += rng.normal(0, 1e-3, problem.free_stages)
        command = np.clip(command, -2.4, 2.4)
        command[problem.free_stages :] = 0.0
        if energy_dB(problem, command) >= level:
            tried += 1
            assert J(problem, command) >= objective - found.certificate.duality_gap
    assert tried > 10


def test_what_is_out_of_reach_is_stated_in_dB(posed: Posed) -> None:
    found = attained(alone(intense(posed(limits__current_A=0.5), OPTIONS)))
    assert found.price == pytest.approx(0.99)
    assert found.missing_dB > 1
    assert f"{found.missing_dB:.2f} dB are missing" in found.sentence
    assert "does not prove" in found.sentence
    assert f"{found.waveform_dB:+.2f} dB" in found.sentence


def weighed(problem: TransientProblem, weights: FloatArray) -> TransientProblem:
    """The problem with other weights (N,) of the term whose energy intensity is about."""
    return replace(problem, terms=(*problem.terms[:-1], replace(problem.terms[-1], weights=weights)))


def test_a_price_stays_below_the_smallest_weight(posed: Posed) -> None:
    problem = posed(limits__current_A=1.25)
    weights = np.where(np.arange(problem.grid.stages) < 300, 1.0, 0.5)
    found = attained(alone(intense(weighed(problem, weights), OPTIONS)))
    assert found.price < 0.5
    assert most_price(weighed(problem, 0 * weights)) == 0
    unweighted = attained(alone(intense(weighed(problem, np.maximum(weights - 0.5, 0)), OPTIONS)))
    assert unweighted.price == 0
    assert unweighted.missing_dB > 0


def test_the_filter_decides_which_energy_counts(posed: Posed) -> None:
    problem = posed(limits__current_A=2.5, weights__rapid="pacinian")
    found = alone(intense(problem, OPTIONS))
    rapid = problem.terms[-1]
    felt = rapid.filtered(problem.stage.rollout(found.solution.command)[0])
    wanted = rapid.filtered(problem.reference_m_s2)
    assert 10 * np.log10(float(felt @ felt) / float(wanted @ wanted)) == pytest.approx(0.0, abs=0.01)
    assert found.certificate.accepted


def test_a_spread_is_asked_for_its_mean_energy(posed: Posed, scene: Scene) -> None:
    problem = posed(limits__current_A=2.5)
    several = replace(problem, spread=(Context(scene).stage(4.0), Context(scene).stage(3.0)))
    found = alone(intense(several, OPTIONS))
    rapid = several.terms[-1]
    made = rapid.filtered(several.accelerations(found.solution.command)[:, : several.grid.stages])
    ratio = np.mean(np.sum(made**2, axis=-1)) / np.sum(rapid.filtered(several.reference_m_s2) ** 2)
    assert 10 * np.log10(ratio) == pytest.approx(0.0, abs=0.01)
    assert found.certificate.accepted


@pytest.mark.parametrize(
    "changes",
    [
        {"limits__slew_A_per_s": 4000.0, "limits__current_A": 2.5},
        {"limits__supply_V": 9.0},
        {"feedback": {"stiffness_N_m": 500.0, "damping_N_s_m": 5.0}, "limits__current_A": 2.5},
        {"thermal__start_winding_C": 99.95, "thermal__start_housing_C": 80.0},
    ],
    ids=["slew", "supply", "wall", "temperature"],
)
def test_every_kind_of_limit(posed: Posed, changes: dict[str, object]) -> None:
    problem = posed(**changes)
    found = alone(intense(problem, OPTIONS))
    assert found.is_proven
    assert found.certificate.is_stationary
    reached = attained(found)
    assert reached.missing_dB == 0 or reached.price == pytest.approx(most_price(problem))
    assert reached.energy_dB == pytest.approx(energy_dB(found.problem, found.solution.command), abs=1e-9)


def test_a_zero_tap_asks_for_nothing(posed: Posed) -> None:
    problem = posed()
    found = alone(intense(aiming_in_window(problem, 0 * problem.reference_m_s2), OPTIONS))
    assert not found.solution.command.any()
    assert found.attained is None


def test_the_scene_says_which_objective(scene: Scene, references: list[Reference]) -> None:
    louder = with_values(scene, {"weights.objective": "intensity", "weights.intensity_dB": 1.0})
    problem = Context(louder).posed_as(references[-1], 5.0).problem
    found = alone(best(problem, OPTIONS, objective=louder.weights.objective))
    assert attained(found).energy_dB == pytest.approx(1.0, abs=0.01)
    assert alone(best(problem, OPTIONS, objective="waveform")).attained is None


@pytest.fixture(scope="module")
def cut(scene: Scene, taps: list[Recording]) -> Build:
    return build_library(with_values(scene, {"limits.current_A": 2.5}), taps)


@pytest.fixture(scope="module")
def louder(scene: Scene, taps: list[Recording]) -> Build:
    return build_library(with_values(scene, {"limits.current_A": 1.6, "weights.objective": "intensity"}), taps)


def test_only_entries_that_a_limit_cuts_have_one(cut: Build) -> None:
    over = {(e.speed_m_s, e.grip_N) for e in cut.all_entries() if e.figures.tap_error > e.floor + 1e-3}
    assert {(t.speed_m_s, t.grip_N) for t in cut.trade_offs} == over


def test_a_path_rises_in_energy_and_in_error(cut: Build) -> None:
    for each in cut.trade_offs:
        dB, error = ([getattr(point, name) for point in each.path] for name in ("energy_dB", "tap_error"))
        assert len(dB) >= 8
        assert dB == sorted(dB)
        assert error[0] == min(error)
        assert each.path[0] == each.waveform
        assert each.path[-1].price == pytest.approx(0.99)
        assert each.intensity.energy_dB == pytest.approx(0.0, abs=0.01)


def test_a_library_of_the_objective_has_the_energy(louder: Build) -> None:
    np.testing.assert_allclose(louder.library.energy_dB, 0.0, atol=0.011)
    prices = np.array([[entry.problem.intensity for entry in row] for row in louder.entries])
    np.testing.assert_array_equal(louder.library.intensity, prices)


def test_the_report_has_both_figures_and_says_what_they_are(cut: Build, louder: Build) -> None:
    text = build_markdown(cut)
    assert "## Waveform and intensity" in text
    assert text.count("| waveform | 0 |") == text.count("| intensity |") == len(cut.trade_offs)
    rows = json.loads(build_json(cut))["entries"]
    with_path = [row for row in rows if row["trade_off"] is not None]
    assert len(with_path) == len(cut.trade_offs)
    assert set(with_path[0]["trade_off"]) == {"waveform", "intensity", "missing_dB", "path"}
    assert "250" in with_path[0]["trade_off"]["waveform"]["levels"]["thirds_dB"]
    assert "## Intensity" not in text
    assert "asked for at lam" in build_markdown(louder)


def test_nothing_is_drawn_or_written_where_nothing_binds(scene: Scene, taps: list[Recording], tmp_path: Path) -> None:
    slow = with_values(scene, {"limits.current_A": 6.0, "grid.grips_N": [1.0]})
    built = build_library(slow, taps)
    assert built.trade_offs == []
    assert "## Waveform and intensity" not in build_markdown(built)
    assert "trade_off.png" not in {path.name for path in write_report(built, tmp_path, full=True)}


def test_the_figure_has_a_line_for_every_entry(cut: Build, tmp_path: Path) -> None:
    axes = trade_off_figure(cut).axes[0]
    labels = [line.get_label() for line in axes.lines if not str(line.get_label()).startswith("_")]
    assert labels == [f"{t.speed_m_s:g} m/s, {t.grip_N:g} N" for t in cut.trade_offs]
    assert "trade_off.png" in {path.name for path in write_report(cut, tmp_path, full=True)}
