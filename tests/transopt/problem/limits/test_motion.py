"""Limits on stroke, velocity and a coil's current that a voltage drives: by other methods too."""

from pathlib import Path

import numpy as np
import pytest

from tests.benches import dense
from tests.benches.libraries import proven_again
from transopt.base.errors import InputError
from transopt.design.build import Build, build_library
from transopt.design.entry import Entry
from transopt.problem.answer import OBJECTIVE_SCALE, Status
from transopt.problem.limits.current import BEFORE, FollowingCurrentLimit
from transopt.recordings.recording import Recording
from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

STROKE, VELOCITY = "limits.stroke_m", "limits.velocity_m_s"


def entry(scene: Scene, taps: list[Recording], key: str, bound: float, grip_N: float = 3.0) -> Entry:
    """The fastest tap of the scene over 15 ms, at one grip."""
    values = {key: bound, "time.stages": 150, "grid.grips_N": [grip_N]}
    return build_library(with_values(scene, values), taps).entries[-1][0]


@pytest.mark.parametrize(
    ("key", "grip_N", "bound"),
    [
        *((STROKE, 3.0, bound_m) for bound_m in (4e-3, 2.4e-3)),
        *((VELOCITY, 5.0, bound_m_s) for bound_m_s in (0.4005, 0.414)),
    ],
)
def test_the_optimum_is_that_of_a_dense_solve_and_is_kept_at_all_times(
    scene: Scene, taps: list[Recording], key: str, grip_N: float, bound: float
) -> None:
    found = entry(scene, taps, key, bound, grip_N)
    name = "stroke" if key == STROKE else "velocity"
    assert found.status is Status.OPTIMAL, found.shortfalls
    assert name in found.binding
    limit = found.problem.limits[name]
    assert found.played.peak(limit) <= bound
    assert limit.margin() < 2e-3 * bound
    rows, nominal = dense.within(found.problem, name, [*map(float, limit.shares(limit.parts)), 1.0])
    room = bound - limit.margin()
    _, J = dense.optimum(found.problem, rows, -room - nominal, room - nominal)
    assert found.certificate.objective == pytest.approx(J, abs=1e-6 * max(J, OBJECTIVE_SCALE))


def test_a_wider_stroke_is_left_out_or_changes_nothing(scene: Scene, taps: list[Recording]) -> None:
    wide = entry(scene, taps, STROKE, 1.0)
    assert "moves it beyond" in wide.left_out["stroke"]
    loose = entry(scene, taps, STROKE, 0.02)
    assert "stroke" not in loose.binding
    # Both are proven; where the command saturates J hardly depends on how it gets there.
    assert loose.certificate.objective == pytest.approx(wide.certificate.objective, rel=1e-9)
    np.testing.assert_allclose(loose.solution.command, wide.solution.command, atol=1e-3)


def test_its_price_is_what_it_says(scene: Scene, taps: list[Recording]) -> None:
    found = entry(scene, taps, STROKE, 3e-3)
    (price,) = (each for each in found.prices if each.limit == "stroke")
    assert price.unit == "m"
    freed = entry(scene, taps, STROKE, price.enough * 1.001)
    assert "stroke" not in freed.binding
    # The rise is rounded up to two digits, so that it may be a tenth too large.
    held = entry(scene, taps, STROKE, 3e-3 + 0.89 * (price.enough - 3e-3))
    assert "stroke" in held.binding


def test_a_stroke_that_no_command_keeps_is_refused_by_what_it_lacks(scene: Scene, taps: list[Recording]) -> None:
    found = entry(scene, taps, STROKE, 2e-4)
    assert found.status is Status.INFEASIBLE
    said = found.shortfalls[0]
    assert said.startswith("stroke")
    assert said.endswith(" ms at the least")
    least = 2e-4 + float(said.split()[1])
    assert entry(scene, taps, STROKE, 1.01 * least).status is Status.OPTIMAL
    assert entry(scene, taps, STROKE, 0.99 * least).status is Status.INFEASIBLE


def test_the_library_has_its_multipliers_and_checks_them(scene: Scene, taps: list[Recording], tmp_path: Path) -> None:
    values = {STROKE: 3e-3, "time.stages": 150, "grid.grips_N": [3.0]}
    again = proven_again(build_library(with_values(scene, values), taps).library, tmp_path)
    assert again.array("mu_stroke_lower").max() > 0


def test_a_velocity_below_the_incoming_one_is_refused_by_name(scene: Scene, taps: list[Recording]) -> None:
    found = entry(scene, taps, VELOCITY, 0.39)
    assert found.status is Status.INFEASIBLE
    said = found.shortfalls[0]
    assert said.startswith("velocity")
    assert "motion of the incoming stylus alone" in said
    incoming = 0.39 + float(said.split()[1])
    assert entry(scene, taps, VELOCITY, 1.01 * incoming).status is Status.OPTIMAL


def test_a_velocity_far_above_all_motion_is_left_out(scene: Scene, taps: list[Recording]) -> None:
    assert "moves it beyond" in entry(scene, taps, VELOCITY, 20.0).left_out["velocity"]


R, BL = 8.0, 1.0  # of the built-in LRA
SHORT = {"model.L_H": 0.0, "time.dt_s": 1e-4, "time.stages": 150, "weights.rho": 1e-5, "weights.after_s": 5e-3}
POLE = {"amplifier": {"pole_Hz": 2000.0, "delay_s": 0.0, "command_limit_V": 5.0}}


def build(**values: object) -> Build:
    scene = with_values(
        load_scene("lra_click"), {**SHORT, **{key.replace("__", "."): v for key, v in values.items()}}
    )
    return build_library(scene, [])


def current_A(found: Build, j: int) -> np.ndarray:
    """(2 N,) current after every switching instant and before the next, by an independent discretisation."""
    problem = found.entries[j][0].problem
    command, N = found.entries[j][0].solution.command, problem.grid.stages
    velocity = dense.responses(problem).velocity @ command
    return np.concatenate([(command - BL * velocity[:N]) / R, (command - BL * velocity[1:]) / R])


@pytest.mark.parametrize("bound_A", [0.3, 0.2])
def test_a_current_is_that_of_a_dense_solve_and_is_kept_at_all_times(bound_A: float) -> None:
    found = build(limits__current_A=bound_A)
    for j, (entry,) in enumerate(found.entries):
        assert entry.status is Status.OPTIMAL, entry.shortfalls
        assert "current" in entry.binding
        problem, N = entry.problem, entry.problem.grid.stages
        velocity = dense.responses(problem).velocity
        before = np.eye(N, k=-1) - BL * velocity[:N]
        rows = np.concatenate([(np.eye(N) - BL * velocity[:N]) / R, before / R])
        stroke, _ = dense.within(problem, "stroke", [1.0])
        room = 0.6e-3 - problem.limits["stroke"].kept_back
        rows = np.concatenate([rows / (bound_A - problem.limits["current"].kept_back), stroke / room])
        _, J = dense.optimum(problem, rows, -np.ones(rows.shape[0]), np.ones(rows.shape[0]))
        assert entry.certificate.objective == pytest.approx(J, abs=1e-6 * max(J, OBJECTIVE_SCALE))
        assert np.abs(current_A(found, j)).max() == pytest.approx(bound_A, rel=5e-3)
        assert entry.played.peak(problem.limits["current"]) <= bound_A


def test_with_a_pole_the_voltage_is_what_comes_out_of_it() -> None:
    found = build(**POLE, limits__current_A=0.2, limits__voltage_V=3.0)
    for (entry,) in found.entries:
        assert entry.status is Status.OPTIMAL, entry.shortfalls
        assert "current" in entry.binding
        limit = entry.problem.limits["current"]
        assert isinstance(limit, FollowingCurrentLimit)
        assert 0.19 < entry.played.peak(limit) <= 0.2


def test_a_library_holds_it_and_verifies(tmp_path: Path) -> None:
    loaded = proven_again(build(limits__current_A=0.2).library, tmp_path)
    assert loaded.array(f"mu_{BEFORE}_upper").any() or loaded.array("mu_current_upper").any()
    free = build().library
    assert f"mu_{BEFORE}_upper" not in free.arrays()


def test_far_above_what_the_voltage_drives_it_is_left_out() -> None:
    (entry,) = build(limits__current_A=5.0).entries[0]
    assert "no command inside its limits drives more than" in entry.left_out["current"]


def test_a_small_inductance_is_the_same_limit() -> None:
    """A coil that settles in a fortieth of a period costs what one without costs, but for a twentieth kept back."""
    bounds = ((0.0, 0.22), (2e-5, 0.22), (0.0, 0.95 * 0.22))
    costs = [
        [entry.certificate.objective for (entry,) in build(model__L_H=L, limits__current_A=bound).entries]
        for L, bound in bounds
    ]
    for wide, small, narrow in zip(*costs, strict=True):
        assert wide < small < 1.05 * narrow


def test_a_coil_that_is_not_linear_needs_its_inductance() -> None:
    scene = load_scene("lra_click")
    with pytest.raises(InputError, match=r"limits.current_A: without inductance .* state model.L_H"):
        with_values(
            scene,
            {"model.L_H": 0.0, "limits.current_A": 0.2, "model.nonlinear": {"force_factor": "BL * (1 - 1e5 * x**2)"}},
        )
