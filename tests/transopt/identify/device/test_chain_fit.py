"""The chain's parameters: found, with intervals that cover, and open where the data leave them open."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.benches.identification import DEFAULT, mismatched
from tests.transopt.identify.device.conftest import INSTRUMENT, Respond
from transopt.base.errors import InputError
from transopt.identify.device.chain import ChainSearch, Coordinates, DriveChain, unknowns_of
from transopt.identify.device.chain_fit import ChainFit, GripResponse, fit_chain, fit_per_grip, refit, scaled_to
from transopt.identify.device.response import INSTRUMENT as INSTRUMENT_UNKNOWNS

GRIPS_N = (0.0, 1.0, 3.0, 5.0)
Measured = Callable[..., list[GripResponse]]


@pytest.fixture(scope="module")
def measured(respond: Respond) -> Measured:
    """Responses of a device at several grips."""

    def make(
        device: DriveChain,
        grips_N: tuple[float, ...] = GRIPS_N,
        *,
        noise: float = 1.0,
        seed: int = 0,
        high_Hz: float = 2e3,
    ) -> list[GripResponse]:
        random = np.random.default_rng(seed)
        whole = [respond(device.plant(grip), grip, noise, random) for grip in grips_N]
        known = whole[0].data.known & (whole[0].data.frequencies_Hz[:, 0] < high_Hz)
        return [
            replace(one, estimate=one.estimate.between(0.0, high_Hz), data=replace(one.data, known=known))
            for one in whole
        ]

    return make


@pytest.fixture(scope="module")
def plain(measured: Measured) -> ChainFit:
    """The fit to the default device at the stated noise."""
    return fit_chain(measured(DEFAULT), INSTRUMENT, DEFAULT, random_starts=0)


def test_without_noise_the_device_itself_is_found(measured: Measured) -> None:
    truth = mismatched(0.3, 1)
    fit = fit_chain(measured(truth, noise=0.0), INSTRUMENT, DEFAULT)
    np.testing.assert_allclose(fit.device.shared, truth.shared, rtol=1e-4)
    for grip in (1.0, 2.0, 5.0):
        np.testing.assert_allclose(fit.device.hand_at(grip), truth.hand_at(grip), rtol=1e-3)
    assert fit.at_bounds == ()
    assert fit.starts == 1  # what is explained is sought no further


def test_a_mass_that_no_record_shows_stops_at_what_a_device_can_have(measured: Measured) -> None:
    """A search that begins at the end of another goes no further: masses of micrograms are too stiff to simulate."""
    coordinates = Coordinates((1.0, 5.0))
    free = np.ones(coordinates.size + len(INSTRUMENT_UNKNOWNS), dtype=bool)
    search = ChainSearch(measured(DEFAULT, (1.0, 5.0)), coordinates, INSTRUMENT, 1.25, free)
    masses = ["mass_kg" in name for name in coordinates.names]
    first = np.concatenate([coordinates.of(DEFAULT), unknowns_of(INSTRUMENT)])
    low, _ = search.bounds(first)
    again, _ = search.bounds(low)
    least = np.exp(again[: coordinates.size][masses])
    np.testing.assert_allclose(least, [1e-5, 2e-4, 2e-4, 2e-4], rtol=1e-6)
    smaller = low - 1.0  # whoever begins there, since the unit of force makes all masses small, may go on
    assert np.all(search.bounds(smaller)[0][: coordinates.size] < smaller[: coordinates.size])


def test_a_device_ten_times_as_heavy_is_found_from_the_nominal_one(measured: Measured) -> None:
    truth = DriveChain(1.25, 10 * DEFAULT.shared, 10 * DEFAULT.hand)
    responses = measured(truth, noise=0.01)
    near = scaled_to(DEFAULT, responses, INSTRUMENT)
    np.testing.assert_allclose(near.shared, truth.shared, rtol=0.1)
    fit = fit_chain(responses, INSTRUMENT, DEFAULT, random_starts=1)
    np.testing.assert_allclose(fit.device.shared, truth.shared, rtol=0.02)


def test_intervals_cover_the_truth(measured: Measured, plain: ChainFit) -> None:
    inside = []
    for seed in range(1, 16):
        fit = refit(plain, measured(DEFAULT, seed=seed))
        _, values, covariance, _ = fit.stated()
        _, truth, _ = fit.coordinates.stated(fit.coordinates.of(DEFAULT))
        inside.append(np.abs(values - truth) < 1.96 * np.sqrt(np.diag(covariance)))
        assert 0.8 < fit.scatter < 1.2
    assert 0.90 <= np.mean(inside) <= 0.99
    assert np.min(np.mean(inside, axis=0)) > 0.7  # no single one of the 14 parameters far off, in 15 draws


def test_what_the_band_does_not_show_is_called_unknown(measured: Measured, plain: ChainFit) -> None:
    """Below 60 Hz the transmission is rigid: its damping leaves no trace."""
    fit = fit_chain(measured(DEFAULT, (1.0, 5.0), noise=10.0, high_Hz=60.0), INSTRUMENT, DEFAULT, random_starts=0)
    assert "transmission_damping_N_s_m" in {*fit.unidentified, *fit.at_bounds}
    assert plain.unidentified == {}


def test_a_hand_that_is_no_line_over_grip_shows_against_the_fit_of_its_own_grip(
    measured: Measured, plain: ChainFit
) -> None:
    bent = DriveChain(DEFAULT.force_per_current_N_A, DEFAULT.shared, DEFAULT.hand * [[1.0, 1.0]])
    responses = measured(bent)
    softer = DriveChain(1.25, DEFAULT.shared, 0.6 * DEFAULT.hand)
    responses[2] = measured(softer)[2]
    fit = fit_chain(responses, INSTRUMENT, DEFAULT, random_starts=0)
    own = {one.grip_N: one for one in fit_per_grip(fit, responses, least_coherence=0.8)}
    assert own[3.0].scatter > 10
    assert own[3.0].own_scatter < 0.2 * own[3.0].scatter
    assert own[3.0].difference_dB > 1
    for one in fit_per_grip(plain, measured(DEFAULT), least_coherence=0.8):
        assert one.scatter == pytest.approx(one.own_scatter, rel=0.1)
        assert one.difference_dB < 0.1


def test_intervals_that_do_not_hold_the_truth_are_said_to(measured: Measured, plain: ChainFit) -> None:
    """A hand at one grip that is a few per cent off the line makes little misfit and drives the others far off."""
    assert plain.meaningless() == []
    responses = measured(DEFAULT)
    responses[2] = measured(DriveChain(1.25, DEFAULT.shared, 0.98 * DEFAULT.hand))[2]
    fit = refit(plain, responses)
    assert 1.3 < fit.scatter < 3
    _, values, covariance, _ = fit.stated()
    _, truth, _ = fit.coordinates.stated(fit.coordinates.of(DEFAULT))
    assert np.mean(np.abs(values - truth) > 1.96 * np.sqrt(np.diag(covariance))) > 0.3
    assert "intervals do not hold" in fit.meaningless()[0]


def test_noise_beyond_the_stated_one_widens_the_intervals(measured: Measured, plain: ChainFit) -> None:
    loud = fit_chain(measured(DEFAULT, noise=3.0), INSTRUMENT, DEFAULT, random_starts=0)
    ratio = np.sqrt(np.diag(loud.covariance) / np.diag(plain.covariance))
    assert np.all((ratio > 2.5) & (ratio < 3.5))


@pytest.mark.parametrize("seed", [4, 5])
def test_a_slow_accelerometer_is_none_of_the_device(respond: Respond, seed: int) -> None:
    """The first search may end at 215 Hz, in other masses: what is left then is 1.5 times the noise."""
    truth, random = mismatched(0.4, seed), np.random.default_rng(seed)
    slow = replace(INSTRUMENT, accelerometer_Hz=200.0)
    records = [respond(truth.plant(grip), grip, 1.0, random, slow) for grip in (1.0, 3.0, 5.0)]
    fit = fit_chain(records, INSTRUMENT, DEFAULT)
    (found,) = fit.nuisances
    assert (found.name, found.value) == ("accelerometer_pole", pytest.approx(200.0, rel=0.01))
    np.testing.assert_allclose(fit.device.shared, truth.shared, rtol=0.01)


def test_the_free_device_alone_is_refused_with_what_to_do(measured: Measured) -> None:
    with pytest.raises(InputError, match=r"only the free device.*record held grips"):
        fit_chain(measured(DEFAULT, (0.0,)), INSTRUMENT, DEFAULT)
