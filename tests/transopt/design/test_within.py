"""Limits stated within a servo period: what their margin costs, and that they are kept at all times."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import linalg

import problems
from tests.benches import dense
from tests.benches.libraries import proven_again
from transopt.base.errors import InputError
from transopt.design.build import build_library
from transopt.design.context import Context
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.design.optimum import optimum
from transopt.design.within import AIM, MOST_COST, margin_cost
from transopt.library.library import Library
from transopt.library.online import Online
from transopt.library.proven import doubts
from transopt.problem.answer import Status
from transopt.problem.limits.output import PARTS, OutputLimit
from transopt.proof.certify import certify
from transopt.recordings.recording import Recording
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers.choose import solve
from transopt.solvers.options import SolverOptions, TrialOptions

FINE = 64  # instants of a period at which an output is looked at
WORDS = {"stroke": "limits.stroke_m", "velocity": "limits.velocity_m_s", "current": "limits.current_A"}


def clicks(name: str, dt_s: float, changes: dict[str, Any], lasts_s: float = 16e-3) -> Scene:
    """A built-in scene of an actuator on another time axis, its first target alone."""
    scene = problems.load(name)
    axis = {"time.dt_s": dt_s, "time.stages": round(lasts_s / dt_s), "weights.after_s": 8e-3}
    return with_values(scene.model_copy(update={"targets": scene.targets[:1]}), {**axis, **changes})


def entry_of(scene: Scene, taps: list[Recording] | None = None) -> Entry:
    entry = build_library(scene, taps or []).entries[-1][-1]
    assert entry.status is Status.OPTIMAL, entry.shortfalls
    return entry


def course(entry: Entry, name: str) -> np.ndarray:
    """(FINE N + 1,) what a limit bounds, by an own simulation of plant and amplifier in fine steps."""
    problem = entry.problem
    plant, amplifier, command = problem.stage.plant, problem.stage.amplifier, entry.solution.command
    n, w = plant.order, 0.0 if amplifier is None else 2 * np.pi * amplifier.pole_Hz
    flow = np.zeros((n + 2, n + 2))
    flow[:n, :n], flow[n, n:] = plant.A, (-w, w)
    flow[:n, n + int(amplifier is None)] = plant.B[:, 0]
    step, x, row = (
        linalg.expm(flow * problem.grid.dt_s / FINE),
        np.zeros(n + 2),
        plant.output(dense.OUTPUTS[name]).row[0],
    )
    found = [0.0]
    for held in command:
        x[-1] = held
        for _ in range(FINE):
            x = step @ x
            found.append(float(row @ x[:n]))
    limit = problem.limits[name]
    assert isinstance(limit, OutputLimit)
    at = np.arange(len(found)) / FINE
    return np.array(found) + np.interp(at, np.arange(limit.nominal.size), limit.nominal)


def unhindered(scene: Scene, name: str) -> float:
    """The largest size of an output in the design without the limit on it."""
    entry = entry_of(with_values(scene, {WORDS[name]: 10.0}))
    return float(np.abs(course(entry, name)).max())


def drawn_scene(seed: int) -> tuple[Scene, str]:
    """An actuator with numbers drawn by lot, on a coarse time axis, and the limit that binds it."""
    lot = np.random.default_rng(seed)
    resonance, dt_s = lot.uniform(110, 250), float(lot.choice([1e-4, 2e-4, 4e-4]))
    model = {"resonance_Hz": resonance, "quality": lot.uniform(3, 25), "moving_mass_kg": lot.uniform(1e-3, 6e-3)}
    changes: dict[str, Any] = {f"model.{key}": value for key, value in model.items()}
    name = "velocity" if seed % 2 else "stroke"
    if seed % 3 == 0:
        changes["amplifier"] = {"pole_Hz": lot.uniform(2e3, 1e4), "delay_s": 0.0, "command_limit_V": 4.0}
    changes |= {"limits.stroke_m": None, "weights.calm": lot.uniform(1, 30)}
    scene = clicks("lra_click", dt_s, changes)
    target = scene.targets[0].model_copy(
        update={"frequency_Hz": resonance * lot.uniform(1, 1.6), "cycles": 1.5, "peak_m_s2": lot.uniform(2, 7)}
    )
    scene = scene.model_copy(update={"targets": [target]})
    return with_values(scene, {WORDS[name]: lot.uniform(0.3, 0.85) * unhindered(scene, name)}), name


def off_dense(entry: Entry, name: str) -> float:
    """How far J lies above that of a dense program with the limit as stated, at instants of a period, and no margin.

    They are 8; in periods of 0.4 ms what such a program leaves of the limit between them is worth 0.5 % of J itself.
    """
    parts = 8 if entry.problem.grid.dt_s < 3e-4 else 32
    rows, nominal = dense.within(entry.problem, name, list(np.arange(1, parts + 1) / parts))
    bound = entry.problem.limits[name].stated
    _, J = dense.optimum(entry.problem, rows, -bound - nominal, bound - nominal)
    return entry.certificate.objective / J - 1


def check(entry: Entry, name: str) -> None:
    assert -1e-6 < off_dense(entry, name) < MOST_COST
    bound = entry.problem.limits[name].stated
    assert 0.98 * bound < np.abs(course(entry, name)).max() <= bound * (1 + 1e-6)
    assert entry.certificate.accepted
    assert name in entry.binding


@pytest.mark.parametrize("seed", [0, 1, 4, 9])
def test_the_margin_costs_next_to_nothing_and_the_limit_is_kept_at_all_times(seed: int) -> None:
    scene, name = drawn_scene(seed)
    check(entry_of(scene), name)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(200, 300))
def test_the_margin_costs_next_to_nothing_for_many_actuators(seed: int) -> None:
    scene, name = drawn_scene(seed)
    check(entry_of(scene), name)


@pytest.mark.parametrize(("R_ohm", "limit_A"), [(8.0, 0.25), (16.0, 0.15)])
def test_the_current_of_a_coil_much_faster_than_the_servo_too(R_ohm: float, limit_A: float) -> None:
    """The chord of a servo period had kept back so much of the limit that J was up to 1.9 % larger."""
    coil = {"model.R_ohm": R_ohm, "limits.voltage_V": 6.0, "limits.current_A": limit_A}
    check(entry_of(clicks("lra_click", 2e-4, {**coil, "limits.stroke_m": None, "weights.calm": 1.0})), "current")


@pytest.mark.parametrize("speed_limit_m_s", [0.403, 0.412])
def test_a_stylus_too(scene: Scene, taps: list[Recording], speed_limit_m_s: float) -> None:
    values = {"limits.velocity_m_s": speed_limit_m_s, "time.stages": 150, "grid.grips_N": [5.0]}
    entry = entry_of(with_values(scene, values), taps)
    assert entry.problem.parts["velocity"] > 1
    check(entry, "velocity")


@pytest.mark.parametrize(
    ("name", "parts"),
    [("stroke", 1), ("stroke", 4), ("velocity", 16), ("velocity", 1), ("current", 1), ("current", 8)],
)
def test_no_command_leaves_the_chord_by_more_than_what_is_kept_back(name: str, parts: int) -> None:
    """Commands by lot, and those that are worst for one instant: full size, with the signs of its response."""
    scene = clicks("lra_click", 2e-4, {"limits.stroke_m": None, WORDS[name]: 2e-4 if name == "stroke" else 0.1})
    problem = entry_of(scene).problem.within({name: parts})
    limit, stage = problem.limits[name], problem.stage
    assert isinstance(limit, OutputLimit)
    edges = [float(share) for share in (0, *limit.shares(parts), 1)]
    row, lot = stage.outputs[limit.output], np.random.default_rng(1)
    commands, impulse = 3.0 * np.sign(lot.normal(size=(40, 80))), np.eye(1, 80)[0]
    worst, bound = 0.0, limit.limit - limit.margin()
    for first, last in pairwise(edges):
        inside = np.linspace(first, last, 41)
        flows = [linalg.expm(stage.flow * problem.grid.dt_s * at)[:-1] for at in inside]

        def along(command: np.ndarray, flows: list[np.ndarray] = flows) -> np.ndarray:
            x = np.column_stack([stage.states(command), command])
            return np.array([x @ (row @ flow) for flow in flows])

        bend = along(impulse)[20] - (along(impulse)[0] + along(impulse)[-1]) / 2
        for command in (*commands, 3.0 * np.sign(bend[::-1])):
            courses = along(command)
            # So that it keeps the limit at the instants, as every admissible command does.
            courses *= min(1.0, bound / np.abs(courses[[0, -1]]).max())
            chord = np.outer(1 - np.linspace(0, 1, 41), courses[0]) + np.outer(np.linspace(0, 1, 41), courses[-1])
            beyond = np.abs(courses) - np.abs(courses[[0, -1]]).max(axis=0)
            worst = max(worst, float((np.abs(courses - chord) if limit.straight else beyond).max()))
    assert worst <= limit.excursion() * (1 + (0 if parts > 1 else 1e-2))


@pytest.mark.parametrize("name", ["lra_click", "voice_coil_thud", "shaker_pulse"])
def test_where_it_costs_little_it_is_left_out_and_said(name: str) -> None:
    made = build_library(problems.load(name), [])
    assert "instants_within" not in made.library.arrays()
    assert not [array for array in made.library.arrays() if "_of_" in array]
    for entry in made.all_entries():
        assert set(entry.problem.parts.values()) == {1}
        assert "cost at most" in entry.left_out["stroke at more instants"]


def test_both_programs_have_the_rows_within() -> None:
    scene, name = drawn_scene(4)
    problem = entry_of(scene).problem
    found = []
    for solver in ("riccati", "casadi-piqp"):
        answer = solve(problem, SolverOptions(solver))
        proof = certify(problem, answer.command, answer.multipliers)
        assert (answer.solver, proof.accepted) == (solver, True)
        assert f"{name}_1_of_2" in answer.multipliers.pairs
        found.append(proof.objective)
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def test_a_limit_that_only_its_margin_stands_in_the_way_of_is_kept(scene: Scene, taps: list[Recording]) -> None:
    """At 0.4 ms the margin of 0.02 m/s leaves less than the incoming 0.4 m/s, and no command brakes so soon."""
    values = {"limits.velocity_m_s": 0.405, "time.dt_s": 4e-4, "time.stages": 38, "grid.grips_N": [5.0]}
    context = Context.recorded(with_values(scene, values), taps)
    brief = optimum(context.posed(0.4, 5.0).problem, TrialOptions())  # which looks at no further instants
    assert not brief.is_proven
    entry = design([context.posed(0.4, 5.0)])[0]
    assert entry.status is Status.OPTIMAL, entry.shortfalls
    assert np.abs(course(entry, "velocity")).max() <= 0.405 * (1 + 1e-6)


@pytest.fixture(scope="module")
def library() -> Library:
    scene = clicks("lra_click", 2e-4, {"limits.stroke_m": 1e-4})
    made = build_library(scene.model_copy(update={"targets": problems.load("lra_click").targets}), []).library
    assert made is not None
    return made


class TestLibrary:
    def test_is_proven_from_its_file(self, library: Library, tmp_path: Path) -> None:
        again = proven_again(library, tmp_path)
        assert [again.problem(iv, 0).parts for iv in range(2)] == [{"stroke": 4}, {"stroke": 8}]
        assert again.array("mu_stroke_1_of_4_upper").max() > 1

    @pytest.mark.parametrize("forged", ["multiplier", "command", "fewer", "more", "none", "odd"])
    def test_is_refused_where_it_was_changed(self, library: Library, forged: str) -> None:
        within, multipliers = library.instants_within.copy(), dict(library.multipliers_of)
        command, meta = library.command.copy(), dict(library.meta)
        if forged == "multiplier":
            name = max((n for n in multipliers if "_of_" in n), key=lambda n: float(multipliers[n].max()))
            multipliers[name] = np.zeros_like(multipliers[name])
        elif forged == "command":
            command *= 1.01
        else:
            stated = {"fewer": 1.0, "more": 7.0, "none": 0.0, "odd": 2.0}[forged]
            within[0, 0, 1] = stated
            meta["instants_within"] = max(stated, meta["instants_within"])
        changed = replace(library, instants_within=within, command=command, multipliers_of=multipliers, meta=meta)
        assert list(doubts(changed))

    def test_a_number_of_instants_that_none_has_is_refused(self, library: Library, tmp_path: Path) -> None:
        for said in (10**9, 2, "3", True):
            meta = {**library.meta, "instants_within": said}
            with pytest.raises(InputError, match=r"instants_within = .*: must be one of 0, 1, 3, 7, 15, 31"):
                replace(library, meta=meta).save(tmp_path / "library.npz")


def test_a_tap_between_the_nodes_is_solved_with_the_instants_of_the_nodes(
    scene: Scene, taps: list[Recording]
) -> None:
    values = {"limits.velocity_m_s": 0.41, "time.stages": 150, "grid.grips_N": [4.0, 5.0]}
    library = build_library(with_values(scene, values), taps).library
    assert library.instants_within[..., 2].max() > 0
    tap = Online(library).solve(0.39, 4.5)
    assert tap.certificate is not None, tap.remark
    assert tap.certificate.accepted


def test_a_second_command_and_devices_of_a_spread_have_them_too(tmp_path: Path) -> None:
    spread = {"robust": {"resonance_spread": 0.04, "samples": 2}, "weights.calm": 1.0}
    made = build_library(clicks("lra_click", 2e-4, {"limits.stroke_m": 1e-4, **spread}), [])
    entry = made.entries[0][0]
    assert entry.status is Status.OPTIMAL, entry.shortfalls
    (limit,) = (limit for limit in entry.problem.limits if isinstance(limit, OutputLimit))
    assert limit.parts in PARTS[1:]
    assert len(limit.rows(entry.problem)) == limit.parts * len(entry.problem.devices)
    cost = margin_cost(limit, entry.problem, entry.solution.multipliers)
    assert cost <= 1.01 * AIM * entry.certificate.objective
    proven_again(made.library, tmp_path)
