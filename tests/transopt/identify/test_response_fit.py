"""A state space from a frequency response: what was put in is found, stable, and its misfit is the true one."""

import numpy as np
import pytest

from tests.benches.actuators import ten_states
from transopt.base.errors import InputError
from transopt.base.signals import ComplexArray, FloatArray
from transopt.identify.response_fit import HIGHEST_ORDER, MOST_MISFIT, ResponseFit, fit_response
from transopt.plant.moving_coil import Inertial, VoiceCoil
from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT

F_HZ = np.geomspace(20, 2000, 400)
LRA = Inertial(
    kind="inertial",
    resonance_Hz=150,
    quality=8,
    moving_mass_kg=0.003,
    case_mass_kg=0.1,
    force_factor_N_A=0.8,
    R_ohm=8.0,
    L_H=2e-3,
)


def fitted(response: ComplexArray, order: int, frequencies_Hz: FloatArray = F_HZ) -> ResponseFit:
    return fit_response(frequencies_Hz, response, order, VOLTAGE_INPUT)


def test_ten_states_are_found_again() -> None:
    plant = ten_states()
    fit = fitted(plant.response(F_HZ), 10)
    assert fit.misfit < 1e-9
    assert fit.at_rest
    expected = np.sort_complex(np.linalg.eigvals(plant.A))
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(fit.plant.A)), expected, rtol=1e-6)
    # Between the points, and below and above the band.
    elsewhere = np.geomspace(1, 1e4, 777)
    np.testing.assert_allclose(
        fit.plant.response(elsewhere), plant.response(elsewhere), atol=1e-6 * np.abs(plant.response(F_HZ)).max()
    )
    assert fit.plant.driven_by == VOLTAGE_INPUT
    found = dict(fit.resonances())
    assert sorted(found) == pytest.approx([60, 140, 310, 520, 900], rel=1e-6)
    assert [found[f] for f in sorted(found)] == pytest.approx([4, 8, 12, 10, 15], rel=1e-5)


def test_an_odd_order_has_the_coils_real_pole() -> None:
    plant = LRA.plant(0.0, None)
    fit = fitted(plant.response(F_HZ), 3)
    assert fit.misfit < 1e-9
    expected = np.sort_complex(np.linalg.eigvals(plant.A))
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(fit.plant.A)), expected, rtol=1e-6)


def test_what_no_spring_holds_is_not_asked_to_rest() -> None:
    free = VoiceCoil(
        kind="voice_coil", input="current", moving_mass_kg=0.05, damping_N_s_m=20.0, force_factor_N_A=5.0
    ).plant(0.0, None)
    fit = fit_response(F_HZ, free.response(F_HZ), 1, CURRENT_INPUT)
    assert fit.misfit < 1e-9
    assert not fit.at_rest
    # One state more than there is: the two zeros would cost the low end of the band.
    assert not fit_response(F_HZ, free.response(F_HZ), 2, CURRENT_INPUT).at_rest


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("order", [2, 5, 10, 14])
def test_it_is_stable_and_real_whatever_it_is_given(seed: int, order: int) -> None:
    """Also of noise alone and of orders beyond what is there; the misfit that is stated is that of its matrices."""
    noise = np.random.default_rng(seed)
    f = np.linspace(20, 2000, 150)
    share = (0.02, 1.0)[seed % 2]
    clean = ten_states().response(f)
    size = np.sqrt(np.mean(np.abs(clean) ** 2) / 2)
    response = clean + share * size * (noise.normal(size=f.size) + 1j * noise.normal(size=f.size))
    fit = fitted(response, order, f)
    assert np.linalg.eigvals(fit.plant.A).real.max() < 0
    assert all(np.isrealobj(getattr(fit.plant, name)) for name in "ABCD")
    off = np.linalg.norm(fit.plant.response(f) - response) / np.linalg.norm(response)
    assert fit.misfit == pytest.approx(off, rel=1e-9)
    # No resonance is narrower than half the distance of the points.
    assert all(at / quality > 0.49 * (f[1] - f[0]) for at, quality in fit.resonances())
    if order >= 10 and share < 1:
        assert fit.misfit < 1.5 * share
        true = np.linalg.norm(fit.plant.response(f) - clean) / np.linalg.norm(clean)
        assert true < share, "150 points of noise average out"


def test_too_few_states_are_no_base_of_a_design() -> None:
    fit = fitted(ten_states().response(F_HZ), 4)
    assert fit.misfit > MOST_MISFIT
    assert not fit.fit_to_design_with
    assert fit.worst > 0.05


def test_only_the_band_counts() -> None:
    response = ten_states().response(F_HZ)
    spoiled = np.where(F_HZ > 250, 1e3, response)
    fit = fit_response(F_HZ, spoiled, 10, VOLTAGE_INPUT, (20.0, 250.0))
    assert fit.frequencies_Hz[-1] <= 250
    assert fit.misfit < 1e-3


@pytest.mark.parametrize(
    ("order", "band", "said"),
    [
        (0, None, f"--order 0: must be 1 to {HIGHEST_ORDER}"),
        (HIGHEST_ORDER + 1, None, "--order 41: must be"),
        (4, (300.0, 200.0), "--band-Hz 300 200: must be two frequencies above 0, the lower one first"),
        (10, (100.0, 110.0), "--order 10: needs 22 points, 8 from 100 to 110 Hz: lower it, or widen"),
    ],
)
def test_refusals(order: int, band: tuple[float, float] | None, said: str) -> None:
    with pytest.raises(InputError, match=said):
        fit_response(F_HZ, ten_states().response(F_HZ), order, VOLTAGE_INPUT, band)
    with pytest.raises(InputError, match="zero at every frequency"):
        fit_response(F_HZ, np.zeros(F_HZ.size, dtype=complex), 2, VOLTAGE_INPUT)
