"""Limits on stroke and velocity: the optimum by another method too, and what the device does in between."""

from pathlib import Path

import numpy as np
import pytest

from tests.benches import dense
from tests.benches.libraries import proven_again
from transopt.design.build import build_library
from transopt.design.entry import Entry
from transopt.problem.answer import OBJECTIVE_SCALE, Status
from transopt.recordings.recording import Recording
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
