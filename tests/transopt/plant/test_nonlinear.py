"""Nonlinear coils: their equations written out, the stage beside the linear one and beside an integrator."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from tests.benches.actuators import LRA, integrated
from transopt.base.errors import InputError
from transopt.plant import nonlinear_stage
from transopt.plant.amplifier import Amplifier
from transopt.plant.discretise import AFTER, Motion, discretise
from transopt.plant.moving_coil import Inertial, VoiceCoil
from transopt.plant.nonlinear import Nonlinear, NonlinearCoil
from transopt.plant.nonlinear_stage import NonlinearStage, resolved

DT_S = 1e-4
LAWS = {
    "force_factor": "BL*(1 - 0.3*(x/0.6e-3)**2)",
    "stiffness": "K*(1 + (x/1e-3)**2)",
    "friction": "0.02*tanh(v/0.05)",
}
AMPLIFIERS = {"ideal": None, "pole": Amplifier(1050.0, 68e-6, 6.0)}


def lra(**changed: Any) -> Inertial:
    return Inertial(**{**LRA, "nonlinear": LAWS, **changed})


def shaker(**changed: Any) -> VoiceCoil:
    stated = {"kind": "voice_coil", "input": "current", "moving_mass_kg": 0.05, "damping_N_s_m": 0.4}
    return VoiceCoil(**{**stated, "stiffness_N_m": 900.0, "force_factor_N_A": 2.5, "nonlinear": LAWS, **changed})


KINDS = {"inductance": lra(), "no inductance": lra(L_H=0.0), "current": shaker()}


def plant_of(kind: Inertial | VoiceCoil) -> NonlinearCoil:
    found = kind.nonlinear_plant()
    assert found is not None
    return found


def command() -> np.ndarray:
    t = np.arange(60) * DT_S
    return 2.5 * np.sin(2 * np.pi * 150 * t) * (t < 4e-3)


def by_integrator(kind: Inertial | VoiceCoil, amplifier: Amplifier | None) -> np.ndarray:
    """(N,) acceleration of the command at the switching instants."""
    return integrated(kind, amplifier, command(), DT_S, stiffening=1.0, friction_N=0.02)


@pytest.mark.parametrize("amplifier", AMPLIFIERS)
@pytest.mark.parametrize("name", KINDS)
class TestStage:
    def test_is_the_motion_by_newton(self, name: str, amplifier: str) -> None:
        stage = NonlinearStage(plant_of(KINDS[name]), AMPLIFIERS[amplifier], DT_S, 1)
        stage, error = resolved(stage, command())
        found = stage.motion(command()).acceleration_m_s2
        expected = by_integrator(KINDS[name], AMPLIFIERS[amplifier])
        off = np.abs(found - expected).max() / np.abs(expected).max()
        assert error <= 1e-6
        assert off <= 6e-7
        assert off <= 3 * error  # the estimate can be believed

    def test_without_laws_is_the_linear_stage(self, name: str, amplifier: str) -> None:
        linear = replace(plant_of(KINDS[name]), force_factor=None, stiffness=None, friction=None)
        stage = NonlinearStage(linear, AMPLIFIERS[amplifier], DT_S, 2, ("position",))
        exact = discretise(linear.linear, AMPLIFIERS[amplifier], DT_S, outputs=("position",))
        found, expected = stage.motion(command()), exact.motion(command())
        for mine, other in (
            (found.acceleration_m_s2, expected.acceleration_m_s2),
            (found.plant_input, expected.plant_input),
            (found.velocity_m_s, expected.velocity_m_s),
            (found.outputs["position" + AFTER], expected.outputs["position" + AFTER]),
        ):
            assert np.abs(mine - other).max() <= 1e-10 * np.abs(other).max()

    def test_adjoint_is_the_gradient_by_differences(self, name: str, amplifier: str) -> None:
        stage = NonlinearStage(plant_of(KINDS[name]), AMPLIFIERS[amplifier], DT_S, 4, ("position",))
        lot, c = np.random.default_rng(3), command()
        weights = lot.standard_normal((4, c.size))
        outputs = {"position" + AFTER: 1e4 * weights[3]}
        gradient = Motion(weights[0], weights[1], weights[2], np.zeros(c.size), outputs)

        def value(at: np.ndarray) -> float:
            m = stage.motion(at)
            of_motion = weights[0] @ m.acceleration_m_s2 + weights[1] @ m.plant_input + weights[2] @ m.velocity_m_s
            return float(of_motion + outputs["position" + AFTER] @ m.outputs["position" + AFTER])

        found = stage.adjoint(stage.linearised(c, stage.states(c)), gradient)
        for k in (0, 17, 59):
            step = 1e-4 * np.eye(1, c.size, k)[0]
            difference = (
                value(c - 2 * step) - 8 * value(c - step) + 8 * value(c + step) - value(c + 2 * step)
            ) / 12e-4
            assert found[k] == pytest.approx(difference, rel=1e-7, abs=1e-7 * np.abs(found).max())


@pytest.mark.parametrize("formula", ["BL*(1 - 0.3*abs(x)/1e-4)", "BL*(1 - 0.3*(x/1e-4)**2)"])
def test_the_estimated_error_is_not_exceeded_at_a_kink_either(formula: str) -> None:
    stage = NonlinearStage(plant_of(lra(nonlinear={"force_factor": formula})), None, DT_S, 1)
    finest = replace(stage, substeps=512).motion(command()).acceleration_m_s2
    for most in (1e-3, 1e-4, 2e-5, 4e-6, 1e-6):
        resolving, error = resolved(stage, command(), most)
        off = np.abs(resolving.motion(command()).acceleration_m_s2 - finest).max() / np.abs(finest).max()
        assert off <= 1.01 * error, most
        assert error <= most or resolving.substeps == 32, most


def test_the_error_of_a_step_falls_by_its_order() -> None:
    expected = by_integrator(KINDS["current"], None)
    plant, errors = plant_of(KINDS["current"]), []
    for substeps in (1, 2, 4):
        found = NonlinearStage(plant, None, DT_S, substeps).motion(command()).acceleration_m_s2
        errors.append(np.abs(found - expected).max())
    assert errors[0] / errors[1] > 12  # of order four: 16
    assert errors[1] / errors[2] > 12


@pytest.mark.parametrize("name", KINDS)
def test_periods_side_by_side_meet_where_one_after_the_other_goes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sharp = KINDS[name].model_copy(update={"nonlinear": Nonlinear(**{**LAWS, "friction": "0.02*tanh(v/1e-4)"})})
    stage, far = NonlinearStage(plant_of(sharp), AMPLIFIERS["pole"], DT_S, 4), np.full((61, 4), 1e6)
    found, from_afar = stage.states(command()), stage.states(command(), far[:, : stage.order])
    monkeypatch.setattr(nonlinear_stage, "MOST_CORRECTIONS", 0)
    expected = stage.states(command())
    size = np.abs(expected).max(axis=0)
    assert np.all(np.abs(found - expected) <= 1e-12 * size)
    assert np.all(np.abs(from_afar - expected) <= 1e-12 * size)


def test_a_motion_without_a_value_is_not_a_number() -> None:
    stage = NonlinearStage(plant_of(lra(nonlinear={"friction": "v*exp((x/1e-6)**2)"})), None, DT_S, 1)
    assert np.isnan(stage.states(np.full(50, 3.0))[-1]).all()


@pytest.mark.parametrize(
    ("laws", "said"),
    [
        ({"force_factor": "0.9*(1 - x)"}, "nonlinear.force_factor: 0.9 N/A at rest, the linear model has 0.8 N/A"),
        ({"stiffness": "K + 1"}, "nonlinear.stiffness: .* N/m at rest"),
        ({"stiffness": "K/x"}, "nonlinear.stiffness: has no value at x = 0"),
        ({"friction": "0.01"}, "nonlinear.friction: 0.01 N at rest"),
        ({"friction": "-tanh(v)"}, "turn its sign"),
        ({"friction": "v*0.05*(1 - (v/0.03)**2)*(1 - (v/0.06)**2)"}, "pushes"),  # between 0.03 and 0.06 m/s alone
        ({"friction": "log(v)"}, "nonlinear.friction: has no value"),
        ({"friction": "open('x')"}, "no part of a formula"),
        ({}, "give force_factor, stiffness or friction"),
        ({"mass": "1"}, "Extra inputs"),
    ],
)
def test_laws_that_contradict_the_linear_model_are_refused(laws: dict[str, str], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        lra(nonlinear=laws)


@pytest.mark.parametrize(
    ("friction", "said"),
    [
        ("0.1*tanh(v/1e-2)*(1 - 8*(x/0.6e-3)**2)", r"N at x = .* pushes; .* within limits\.stroke_m too"),
        ("300*x", "without motion; it must be zero"),
        ("0.1*tanh(v/1e-2)*sqrt(1 - (x/5e-4)**2)", "has no value at x = "),
    ],
)
def test_friction_is_one_over_the_whole_stroke(friction: str, said: str) -> None:
    plant = plant_of(lra(nonlinear={"friction": friction}))
    plant.check_friction(1e-5 * (friction != "300*x"))
    with pytest.raises(InputError, match=said):
        plant.check_friction(6e-4)
    plant_of(lra(nonlinear={"friction": "0.1*tanh(v/1e-2)*(1 - (x/0.6e-3)**2)"})).check_friction(6e-4)


def test_a_law_of_a_current_needs_one() -> None:
    with pytest.raises(ValidationError, match="needs L_H > 0"):
        lra(L_H=0.0, nonlinear={"force_factor": "BL*(1 - i/10)"})
    assert lra(nonlinear={"force_factor": "BL*(1 - i/10)"}).nonlinear_plant() is not None
