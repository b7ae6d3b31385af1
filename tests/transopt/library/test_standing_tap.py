"""Taps whose stages are made in arrays allocated once, against the general way of `Online`."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from transopt.design.optimum import optimum
from transopt.library.library import Library
from transopt.library.online import Online
from transopt.library.standing_tap import StandingTap
from transopt.plant.second_order import second_order
from transopt.plant.state_space import StateSpace
from transopt.solvers.native import extension
from transopt.solvers.options import SolverOptions

pytestmark = pytest.mark.skipif(not extension.available, reason="the extension is not built")


@pytest.fixture
def general(library: Library) -> Online:
    found = Online(library)
    found._found_standing = {(): None}
    return found


@pytest.fixture
def standing(library: Library, monkeypatch: pytest.MonkeyPatch) -> Online:
    found = Online(library)

    def never(*_: object) -> None:
        raise AssertionError("solved in general")

    monkeypatch.setattr(found, "_in_general", never)
    return found


def test_they_are_those_of_the_general_way(library: Library, standing: Online, general: Online) -> None:
    draws, taps = np.random.default_rng(5), [(0.1, 1.0), (0.1, 5.0), (0.4, 1.0), (0.4, 5.0), (0.3, 3.0)]
    for speed, grip in [*taps, *draws.uniform((0.1, 1.0), (0.4, 5.0), (25, 2)).tolist()]:
        own, other = standing.solve(speed, grip), general.solve(speed, grip)
        assert own.certificate.accepted
        assert own.certificate.objective == pytest.approx(other.certificate.objective, rel=1e-9, abs=1e-12)
        assert set(own.certificate.violations) == set(other.certificate.violations)
        assert own.certificate.excess <= 1e-3
        np.testing.assert_allclose(own.wave.command, other.wave.command, atol=2e-5)


def test_a_warm_winding_is_looked_at(library: Library, standing: Online) -> None:
    """0.4 K below the limit a bound no longer tells that a tap, which warms it by 0.3 K, keeps it."""
    hot = library.coil().limit_C - 0.4
    own, cold = standing.solve(0.4, 5.0, hot, hot), standing.solve(0.4, 5.0)
    np.testing.assert_array_equal(own.wave.command, cold.wave.command)
    with pytest.raises(AssertionError, match="solved in general"):
        standing.solve(0.4, 5.0, hot + 0.2, hot + 0.2)


@pytest.mark.parametrize("attempts", [(None, 0), (10, 20, 300, 0), (0,), (500,)])
def test_the_order_of_trial_changes_no_answer(
    standing: Online, monkeypatch: pytest.MonkeyPatch, attempts: tuple[int | None, ...]
) -> None:
    taps = [(0.4, 5.0), (0.27, 4.7), (0.12, 1.5)]
    own = [standing.solve(*tap) for tap in taps]
    monkeypatch.setattr(StandingTap, "_attempts", lambda *_: iter(attempts))
    for tap, known in zip(taps, own, strict=True):
        found = standing.solve(*tap)
        assert found.certificate.objective == pytest.approx(known.certificate.objective, rel=1e-8)
        np.testing.assert_allclose(found.wave.command, known.wave.command, atol=1e-4)


def test_no_answer_shares_memory_with_the_next(standing: Online) -> None:
    first = standing.solve(0.4, 5.0)
    command = first.wave.command.copy()
    standing.solve(0.2, 2.0)
    np.testing.assert_array_equal(first.wave.command, command)


def test_neither_earlier_taps_nor_other_threads_change_an_answer(library: Library) -> None:
    solver, draws = Online(library), np.random.default_rng(8)
    taps = [(*tap, None, None, None) for tap in draws.uniform((0.1, 1.0), (0.4, 5.0), (12, 2)).tolist()]
    taps += [(0.4, 5.0, None, None, {"current_A": 3.0}), (0.3, 4.0, None, None, {"current_A": 3.5}), taps[0]]
    known = [solver.solve(*tap).wave.command for tap in taps]

    def again(seed: int) -> None:
        for i in np.random.default_rng(seed).permutation(len(taps)):
            np.testing.assert_allclose(solver.solve(*taps[i]).wave.command, known[i], rtol=0, atol=1e-12)

    again(0)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(again, range(1, 9)))


@pytest.mark.parametrize("wrong", ["order", "defective"])
def test_a_device_of_another_kind_is_left_to_the_general_way(library: Library, wrong: str) -> None:
    """A caller's device may have other states at some grip, or none that modes tell apart."""
    scene = library.scene()

    def plant(grip_N: float) -> StateSpace:
        usual = scene.plant(grip_N)
        if not 2.0 < grip_N < 3.0:
            return usual
        if wrong == "order":
            return second_order(grip_N, force_per_current_N_A=5.0)
        # Twice the same oscillation: a resonance that drives a resonance.
        A = np.kron(np.eye(3), np.array([[0.0, 1.0], [-4e4, -80.0]]))
        A[1, 2] = A[3, 4] = 3e4
        B, C = np.eye(6, 1, -5), np.eye(1, 6)
        return replace(usual, A=A, B=B, C=C @ A, D=C @ B)

    solver = Online(library, plant)
    tap = solver.solve(0.3, 2.5)
    problem = solver._posed(library.posing(), 0.3, 2.5, library.coil())
    cold = optimum(problem, SolverOptions())
    assert tap.certificate.objective == pytest.approx(cold.certificate.objective, rel=1e-6)
    assert solver.solve(0.3, 3.5).wave.command == pytest.approx(
        Online(library).solve(0.3, 3.5).wave.command, abs=1e-9
    )
