"""What the page shows on a warm coil is what the servo would play there."""

import numpy as np
import pytest

import problems
import transopt as to
from controller.servo.settings import Settings
from controller.waveforms.bank import bank
from tests.benches.oracle.blend import blend_at
from tests.benches.oracle.guard import Guard
from transopt.base.errors import InputError
from transopt.proof.replay import replay
from transopt.web.service import Service
from transopt.web.shown import plain

ONE = {"grid.speeds_m_s": [0.3], "grid.grips_N": [3.0], "grid.cool_share": 0.36}
BRIDGE = {
    "amplifier": {"switching_Hz": 20e3, "command_limit_A": 6.0},
    "limits.supply_V": 14.0,
    "motor.R_eddy_ohm": 20.0,
}


@pytest.fixture(scope="module", params=[("wood_on_foam", {}), ("walled", {}), ("wood_on_foam", BRIDGE)])
def shown(request: pytest.FixtureRequest) -> tuple[Service, to.Library]:
    """Without and with a wall, and with a ripple that the device does not count."""
    name, changes = request.param
    scene = to.with_values(problems.load(name), {**ONE, **changes})
    return Service(scene), to.solve(scene)


@pytest.mark.parametrize("left_K", [0.3, 0.1, 1e-3])
def test_it_is_what_the_servo_decides_and_the_replay_plays(shown: tuple[Service, to.Library], left_K: float) -> None:
    service, library = shown
    settings, play = Settings.of(library), blend_at(bank(library), 0.3, 3.0)
    assert settings.coil is not None
    guard = Guard(settings.coil, library.dt_s, settings.withhold_K, settings.least_scale)
    guard.winding_C = guard.housing_C = guard.play_limit_C - left_K
    ticks = len(play.samples_A) + 1
    scale, cooled = guard.allowed(play.transient_A, play.cool_transient_A, play.feedback_A, ticks)
    service.change({}, winding_C=guard.winding_C)
    found = service.quick([0])[0]
    assert found.warm.scale == pytest.approx(scale, abs=1e-6)
    assert found.warm.cooled == pytest.approx(cooled, abs=1e-6)
    problem = library.problem(0, 0)
    walls = None if problem.wall is None else [problem.wall]
    blend = scale * np.array(play.blended(cooled))
    (played,) = replay(problem.stage, problem.grid, blend[None], [problem.target], None, walls=walls)
    N = problem.grid.stages
    np.testing.assert_allclose(found.curves.warm_input[:N], played.plant_input, atol=1e-5)
    assert found.warm.figures.tap_error == pytest.approx(played.figures.tap_error, abs=1e-6)
    assert found.warm.figures.felt_error == pytest.approx(played.figures.felt_error, abs=1e-6)
    assert service.settled(0).warm == found.warm


def test_a_coil_with_room_plays_the_optimum_and_one_without_nothing(shown: tuple[Service, to.Library]) -> None:
    service, _ = shown
    assert service.windings_C is not None
    cold_C, hot_C = service.windings_C
    service.change({}, winding_C=cold_C)
    whole = service.quick([0])[0]
    assert whole.warm.words == "the first command"
    np.testing.assert_allclose(whole.curves.warm_m_s2, whole.curves.optimum_m_s2, atol=1e-6)
    service.change({}, winding_C=hot_C)
    nothing = service.quick([0])[0]
    assert nothing.warm.words == "no transient"
    assert plain(nothing)["warm"]["scale"] == 0.0
    with pytest.raises(InputError, match="winding -300 C: must be -40 to 260 C"):
        service.change({}, winding_C=-300.0)
    service.change({})
    assert service.quick([0])[0].warm is None


def test_without_second_commands_no_coil_is_warm() -> None:
    service = Service(to.with_values(problems.load("wood_on_foam"), {**ONE, "grid.cool_share": None}))
    assert service.windings_C is None
    with pytest.raises(InputError, match=r"no cool commands: state grid\.cool_share"):
        service.change({}, winding_C=90.0)
