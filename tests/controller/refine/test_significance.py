"""What stands out of the scatter: noise alone hardly ever does, whatever its kind, and what is there does."""

import numpy as np
import pytest

from controller.refine.significance import LEVEL, Scatter, Tapped, Window
from transopt.base.signals import FloatArray

DT = 1e-4
TIMES = DT * np.arange(-3, 597)
WINDOW = Window.over(TIMES)
NODES, TAPS = 6, 3


def tapped(difference: FloatArray, noise: FloatArray, predicted: FloatArray | None = None) -> Tapped:
    """Taps that differ from their prediction by a mean (K,) and noise (n, K)."""
    return Tapped(
        correction_m_s2=np.zeros(TIMES.size),
        predicted=np.zeros(WINDOW.size) if predicted is None else predicted,
        differences=difference + noise,
        reference=1e4,
        peak_current_A=1.0,
    )


def white(random: np.random.Generator) -> FloatArray:
    return random.standard_normal((TAPS, WINDOW.size))


def together(random: np.random.Generator) -> FloatArray:
    """All coefficients scatter as one, as those of a hand that varies from tap to tap do."""
    shape = np.sin(np.arange(WINDOW.size))
    return random.standard_normal((TAPS, 1)) * shape


def test_cosines_keep_the_energy() -> None:
    random = np.random.default_rng(1)
    coefficients = random.standard_normal(WINDOW.size)
    values = WINDOW.values(coefficients)
    assert values @ values == pytest.approx(coefficients @ coefficients)
    np.testing.assert_allclose(WINDOW.coefficients(values), coefficients, atol=1e-12)
    assert not values[TIMES > 36e-3].any()
    assert [band.start for band in WINDOW.bands[1:]] == [band.stop for band in WINDOW.bands[:-1]]


@pytest.mark.parametrize("kind", [white, together])
def test_noise_is_not_taken_for_a_difference(kind) -> None:  # type: ignore[no-untyped-def]
    """In a round of 6 nodes anything stands out with a chance of 1 %: of 200 rounds in 2 on average, in 8 never."""
    random, rounds, alarms = np.random.default_rng(2), 200, 0
    for _ in range(rounds):
        nodes = [tapped(np.zeros(WINDOW.size), kind(random)) for _ in range(NODES)]
        scatter = Scatter(WINDOW.bands, nodes)
        alarms += any(scatter.standing_out(node.difference, node, NODES).any() for node in nodes)
    assert alarms <= 4 * LEVEL * rounds


def test_what_is_there_stands_out_and_nothing_beside_it() -> None:
    random = np.random.default_rng(3)
    difference = np.zeros(WINDOW.size)
    band = WINDOW.bands[2]
    difference[band] = 5.0
    nodes = [tapped(difference, white(random)) for _ in range(NODES)]
    part = Scatter(WINDOW.bands, nodes).standing_out(nodes[0].difference, nodes[0], NODES)
    # The mean square of the signal over that of signal and noise: 25 / (25 + 1/3).
    assert part[band] == pytest.approx(25 / (25 + 1 / TAPS), abs=0.02)
    assert not np.delete(part, np.arange(band.start, band.stop)).any()


def test_the_squared_error_has_no_bias_and_its_deviation_is_true() -> None:
    random, error = np.random.default_rng(4), np.full(WINDOW.size, 2.0)
    all_taps = [tapped(error, white(random)) for _ in range(400)]
    found = np.array([one.squared_in([slice(None)]) for one in all_taps])
    assert found.mean() == pytest.approx(float(error @ error) / 1e4, abs=4 * found.std() / 20)
    scatter = Scatter(WINDOW.bands, all_taps)
    deviations = [scatter.gain(one, one).deviation / np.sqrt(2) for one in all_taps]
    assert np.mean(deviations) == pytest.approx(float(found.std()), rel=0.2)


def test_gains_of_chance_and_of_more() -> None:
    random = np.random.default_rng(5)
    error = np.full(WINDOW.size, 2.0)
    same = [(tapped(error, white(random)), tapped(error, white(random))) for _ in range(300)]
    scatter = Scatter(WINDOW.bands, [one for pair in same for one in pair])
    chances = np.array([scatter.gain(*pair).by_chance for pair in same])
    assert np.mean(chances < LEVEL) <= 3 * LEVEL
    assert np.mean(chances) == pytest.approx(0.5, abs=0.1)
    worse, better = tapped(error, white(random)), tapped(0.5 * error, white(random))
    assert scatter.gain(worse, better).by_chance < LEVEL
    assert scatter.gain(better, worse).worse_by_chance < LEVEL


def test_a_gain_in_one_band_is_seen_beside_a_large_error_elsewhere() -> None:
    random = np.random.default_rng(6)
    error, design = np.zeros(WINDOW.size), np.zeros(WINDOW.size)
    error[WINDOW.bands[0]], error[WINDOW.bands[4]] = 60.0, 2.0
    design[WINDOW.bands[4]] = -2.0
    before = tapped(error, 3 * white(random))
    after = tapped(error, 3 * white(random), predicted=design)
    scatter = Scatter(WINDOW.bands, [tapped(error, 3 * white(random)) for _ in range(50)])
    limited, whole = scatter.gain(before, after, where_changed=True), scatter.gain(before, after)
    assert limited.deviation < whole.deviation / 5
