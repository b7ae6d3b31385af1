"""No entry ends without a name: walls after the waveform, what warms within a period, what has no digits left."""

import itertools
import re
from dataclasses import replace

import pytest

import problems
from problems.stress.draw import drawn
from problems.stress.judge import judge
from transopt.design.build import build_library
from transopt.design.optimum import optimum
from transopt.problem.answer import Status
from transopt.recordings.recording import Recording
from transopt.scene import strikes
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

STEADY_A = (0.2, 0.25, 0.3, 0.4, 0.6)
STIFFNESS_N_M = (50.0, 100.0, 200.0, 300.0, 500.0)


@pytest.fixture(scope="module")
def walled() -> tuple[Scene, list[Recording]]:
    scene = problems.load("walled")
    return scene, strikes.recordings(scene)


def statuses(
    walled: tuple[Scene, list[Recording]], steady_A: float, stiffness_N_m: float, after_s: float = 0.03
) -> dict[Status, list[str]]:
    """Status -> what is said of the entries that end with it, at the fastest speed."""
    scene, recordings = walled
    data = scene.model_dump()
    data["limits"]["steady_current_A"] = steady_A
    data["feedback"]["stiffness_N_m"] = stiffness_N_m
    data["weights"]["after_s"] = after_s
    build = build_library(Scene.model_validate(data), recordings)
    found: dict[Status, list[str]] = {}
    for entry in build.all_entries():
        found.setdefault(entry.status, []).extend(entry.shortfalls)
    return found


def test_what_the_wall_asks_for_after_the_waveform_is_the_hand_overs(walled: tuple[Scene, list[Recording]]) -> None:
    """27 mA over 0.96 A within the last period: the problem states no limit there."""
    found = statuses(walled, 0.3, 50.0, after_s=0.0)
    assert set(found) == {Status.OPTIMAL, Status.HAND_OVER}
    said, would_do = found[Status.HAND_OVER]
    assert said.startswith(
        "hand-over: within 20 ms after the last command the wall alone brings the current 0.0266 A "
    )
    assert "over its limit 0.96 A, with feedback.stiffness_N_m = 50 N/m" in said
    assert would_do.startswith("feedback.stiffness_N_m = ")
    assert would_do.endswith(" would do")


@pytest.mark.long
@pytest.mark.parametrize(("steady_A", "stiffness_N_m"), list(itertools.product(STEADY_A, STIFFNESS_N_M)))
def test_walls_under_small_currents_are_solved_or_refused_by_name(
    walled: tuple[Scene, list[Recording]], steady_A: float, stiffness_N_m: float
) -> None:
    assert set(statuses(walled, steady_A, stiffness_N_m)) <= {Status.OPTIMAL, Status.HAND_OVER, Status.INFEASIBLE}


@pytest.mark.parametrize(
    ("seed", "case", "ends"),
    [
        (31337, 2082, "HAND_OVER"),  # the wall's current after the waveform, and a winding warmer within a period
        (31337, 5922, "HAND_OVER"),
        (31337, 228, "HAND_OVER"),  # current and command
        (71, 774, "HAND_OVER"),  # at the end of the last period
        (31337, 1830, "UNSTABLE_WALL"),  # and a pause that heats without bound
        (31337, 63, "INFEASIBLE"),  # the coil is too hot without any transient
        (5, 249, "certified"),  # ripple of a current that changes its sign
        (
            31337,
            87,
            "certified",
        ),  # a coil current that leaves its limit between the switching instants, and is stated there
        (20261122, 188, "certified"),  # more energy asked for than any price finds
        (20261122, 1869, "certified"),  # rounding makes its gradient, with a temperature limit that does not bind
        (1, 585, "UNSTABLE_WALL"),  # what comes after the waveform grows without bound
        (31337, 4772, "certified"),  # one thermal node: its bound was above its value
        (555, 68, "certified"),
        (71, 28, "certified"),
        (424242, 1984, "certified"),  # an unlimited optimum that only strong damping finds
        (8675309, 1298, "certified"),  # the wall's ticks settle after seven solves
        (8675309, 1887, "certified"),  # a last digit too hot
    ],
)
def test_hard_cases(seed: int, case: int, ends: str) -> None:
    found = judge(drawn(seed, case))
    assert not found.bad, found.detail
    assert ends in found.kind
    # What would do is said by what was tried, and by nothing else.
    assert not re.search("; lower |loosen|tighten|choose|rescale|report", found.detail)


def test_under_a_wall_that_grows_by_itself_only_without_it_a_larger_weight_helps() -> None:
    case = drawn(1, 585)
    found = judge(
        replace(
            case,
            horizon=replace(case.horizon, after=0, lost=False),
            demand=replace(case.demand, price=0.0, asked_dB=None),
        )
    )
    assert not found.bad, found.detail
    assert "PRECISION" in found.kind


def test_a_wall_that_grows_by_itself_is_not_called_too_deep_which_it_is_as_well() -> None:
    designed = optimum(drawn(8675309, 46).problem(), SolverOptions())
    assert designed.solution.status is Status.UNSTABLE_WALL
