"""The velocity limit: the optimum under it, by another method too, and what the device does in between."""

import pytest

from tests.benches import dense
from tests.transopt.problem.limits.test_stroke import entry
from transopt.problem.answer import OBJECTIVE_SCALE, Status
from transopt.recordings.recording import Recording
from transopt.scene.scene import Scene

KEY = "limits.velocity_m_s"
BOUNDS_M_S = (0.4005, 0.402, 0.405, 0.41, 0.414)


@pytest.mark.parametrize("bound_m_s", BOUNDS_M_S)
def test_the_optimum_is_that_of_a_dense_solve_and_is_kept_at_all_times(
    scene: Scene, taps: list[Recording], bound_m_s: float
) -> None:
    found = entry(scene, taps, KEY, bound_m_s, grip_N=5.0)
    assert found.status is Status.OPTIMAL, found.shortfalls
    assert "velocity" in found.binding
    limit = found.problem.limits["velocity"]
    assert found.played.peak(limit) <= bound_m_s
    rows, nominal = dense.within(found.problem, "velocity", [*map(float, limit.shares(limit.parts)), 1.0])
    room = bound_m_s - limit.margin()
    _, J = dense.optimum(found.problem, rows, -room - nominal, room - nominal)
    assert found.certificate.objective == pytest.approx(J, abs=1e-6 * max(J, OBJECTIVE_SCALE))


def test_below_the_incoming_speed_it_is_refused_by_name(scene: Scene, taps: list[Recording]) -> None:
    found = entry(scene, taps, KEY, 0.39)
    assert found.status is Status.INFEASIBLE
    said = found.shortfalls[0]
    assert said.startswith("velocity")
    assert "motion of the incoming stylus alone" in said
    incoming = 0.39 + float(said.split()[1])
    assert entry(scene, taps, KEY, 1.01 * incoming).status is Status.OPTIMAL


def test_far_above_all_motion_it_is_left_out(scene: Scene, taps: list[Recording]) -> None:
    assert "moves it beyond" in entry(scene, taps, KEY, 20.0).left_out["velocity"]
