"""The stroke limit: the optimum under it, by another method too, and what the device does in between."""

from pathlib import Path

import numpy as np
import pytest

from tests.benches import dense
from transopt.design.build import build_library
from transopt.design.entry import Entry
from transopt.problem.answer import OBJECTIVE_SCALE, Status
from transopt.recordings.recording import Recording
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

KEY = "limits.stroke_m"
BOUNDS_M = (4e-3, 3e-3, 2.8e-3, 2.6e-3, 2.4e-3)


def entry(scene: Scene, taps: list[Recording], key: str, bound: float, grip_N: float = 3.0) -> Entry:
    """The fastest tap of the scene over 15 ms, at one grip."""
    values = {key: bound, "time.stages": 150, "grid.grips_N": [grip_N]}
    return build_library(with_values(scene, values), taps).entries[-1][0]


@pytest.mark.parametrize("bound_m", BOUNDS_M)
def test_the_optimum_is_that_of_a_dense_solve_and_is_kept_at_all_times(
    scene: Scene, taps: list[Recording], bound_m: float
) -> None:
    found = entry(scene, taps, KEY, bound_m)
    assert found.status is Status.OPTIMAL, found.shortfalls
    assert "stroke" in found.binding
    limit = found.problem.limits["stroke"]
    assert found.played.peak(limit) <= bound_m
    assert limit.margin() < 2e-3 * bound_m
    rows, nominal = dense.within(found.problem, "stroke", [*map(float, limit.shares(limit.parts)), 1.0])
    room = bound_m - limit.margin()
    _, J = dense.optimum(found.problem, rows, -room - nominal, room - nominal)
    assert found.certificate.objective == pytest.approx(J, abs=1e-6 * max(J, OBJECTIVE_SCALE))


def test_a_wider_stroke_is_left_out_or_changes_nothing(scene: Scene, taps: list[Recording]) -> None:
    wide = entry(scene, taps, KEY, 1.0)
    assert "moves it beyond" in wide.left_out["stroke"]
    loose = entry(scene, taps, KEY, 0.02)
    assert "stroke" not in loose.binding
    # Both are proven; where the command saturates J hardly depends on how it gets there.
    assert loose.certificate.objective == pytest.approx(wide.certificate.objective, rel=1e-9)
    np.testing.assert_allclose(loose.solution.command, wide.solution.command, atol=1e-3)


def test_its_price_is_what_it_says(scene: Scene, taps: list[Recording]) -> None:
    found = entry(scene, taps, KEY, 3e-3)
    (price,) = (each for each in found.prices if each.limit == "stroke")
    assert price.unit == "m"
    freed = entry(scene, taps, KEY, price.enough * 1.001)
    assert "stroke" not in freed.binding
    held = entry(scene, taps, KEY, price.enough * 0.99)
    assert "stroke" in held.binding


def test_a_stroke_that_no_command_keeps_is_refused_by_what_it_lacks(scene: Scene, taps: list[Recording]) -> None:
    found = entry(scene, taps, KEY, 2e-4)
    assert found.status is Status.INFEASIBLE
    said = found.shortfalls[0]
    assert said.startswith("stroke")
    assert said.endswith(" ms at the least")
    least = 2e-4 + float(said.split()[1])
    assert entry(scene, taps, KEY, 1.01 * least).status is Status.OPTIMAL
    assert entry(scene, taps, KEY, 0.99 * least).status is Status.INFEASIBLE


def test_the_library_has_its_multipliers_and_checks_them(scene: Scene, taps: list[Recording], tmp_path: Path) -> None:

    from transopt.design.verify import verify_library
    from transopt.library.file import load_library

    values = {KEY: 3e-3, "time.stages": 150, "grid.grips_N": [3.0]}
    built = build_library(with_values(scene, values), taps)
    path = tmp_path / "library.npz"
    built.library.save(path)
    again = load_library(path)
    assert again.array("mu_stroke_lower").max() > 0
    assert not any(check.shortfalls for check in verify_library(again))
