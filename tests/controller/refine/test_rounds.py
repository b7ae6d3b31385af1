"""Refinement on the device: the convergence condition holds what it says, entries stay certified, limits are kept."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

import transopt as to
from controller.refine.figure import refine_figure
from controller.refine.heard import Heard, Node, fade_of, node_near, nodes_of, smooth
from controller.refine.kept import history_of, in_meta, is_learning
from controller.refine.learner import NOT_CONFIRMED, NOT_SURE, NOT_TAPPED, NOTHING_LEFT, Learner
from controller.refine.learning import Ratio, condition, corrected, factors, ratio, through_q, widest
from controller.refine.rounds import Refined, refine
from controller.refine.tables import refine_table, summary
from tests.benches.libraries import part_of, proven_again, under
from transopt.base.errors import InputError
from transopt.base.plotting import save_figure
from transopt.base.signals import FloatArray, nrmse
from transopt.design.resolve import resolve
from transopt.design.verify import verify_library
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.library.online import Online
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers import riccati

DT = 1e-4


@pytest.fixture(scope="module")
def small(library: Library) -> Library:
    """Four nodes: 0.2 m/s, which no limit binds, and 0.4 m/s, at 3 and 5 N."""
    return part_of(library, [1, 3], [1, 2])


def flat(value: complex, deviation: float = 0.0) -> Ratio:
    f = np.linspace(20, 1000, 200)
    return Ratio(f, np.full(f.size, value, dtype=complex), np.full(f.size, deviation))


class TestCondition:
    def test_known_ratios(self) -> None:
        assert factors(flat(1.5), 1.0, limited=False)[0] == pytest.approx(0.5)
        assert factors(flat(1.5), 0.5, limited=False)[0] == pytest.approx(0.25)
        assert factors(flat(1.5), 0.5, limited=True)[0] == pytest.approx(0.75)
        assert factors(flat(1j), 1.0, limited=False)[0] == pytest.approx(np.sqrt(2))

    def test_limits_never_make_it_easier(self) -> None:
        """The triangle inequality, for any ratio and gain."""
        random = np.random.default_rng(1)
        for _ in range(50):
            value, gain = complex(*random.uniform(-2, 3, 2)), float(random.uniform(0.05, 1))
            free, limited = (factors(flat(value), gain, limited=which)[0] for which in (False, True))
            assert free <= limited + 1e-12

    def test_a_device_of_more_than_twice_the_gain_takes_half_of_it(self) -> None:
        known = widest(flat(2.2), 1.0, limited=False)
        assert (known.gain, known.met) == (0.5, True)
        assert known.factor == pytest.approx(0.1, abs=0.01)

    @pytest.mark.parametrize("limited", [False, True])
    def test_reversed_polarity_never_converges(self, limited: bool) -> None:
        known = widest(flat(-1.0), 1.0, limited=limited)
        assert not known.met
        assert known.gain == 1.0

    def test_uncertainty_counts(self) -> None:
        sure, unsure = (condition(flat(0.5, deviation), 1.0, limited=False) for deviation in (0.01, 0.3))
        assert sure.met
        assert sure.sure_factor == pytest.approx(sure.factor + 0.02, rel=0.05)
        assert not unsure.met
        assert unsure.factor < 1

    def test_q_ends_before_the_doubtful_band(self) -> None:
        f = np.linspace(20, 1000, 400)
        bad = Ratio(f, np.where(f < 400, 0.9, -1.0).astype(complex), np.zeros(f.size))
        known = condition(bad, 1.0, limited=False)
        assert 250 < known.cutoff_Hz < 300
        assert known.factor == pytest.approx(float((through_q(f, known.cutoff_Hz) * np.abs(1 - bad.value)).max()))
        assert known.met


class TestRatio:
    def test_a_known_filter_and_its_scatter(self) -> None:
        """Taps behind a resonance that the model lacks, with noise: T to its deviation and 3 % of averaging."""
        random = np.random.default_rng(3)
        b, a = signal.bilinear([1.3], [1 / (2 * np.pi * 300) ** 2, 0.6 / (2 * np.pi * 300), 1.0], fs=1 / DT)
        times = DT * np.arange(400)
        predicted, measured = [], []
        for peak in (20.0, 40.0, 60.0, 80.0) * 3:
            p = peak * np.exp(-((times - 8e-3) ** 2) / (2 * 0.3e-3**2))
            predicted.append(p)
            measured.append(signal.lfilter(b, a, p) + 0.2 * random.standard_normal(times.size))
        found = ratio(predicted, measured, DT)
        _, true = signal.freqz(b, a, found.frequencies_Hz, fs=1 / DT)
        inside = np.abs(found.value - true) <= 0.03 * np.abs(true) + 2 * found.deviation
        assert inside[found.frequencies_Hz < 600].mean() > 0.95
        assert 0 < found.deviation.max() < 0.1


class TestLearning:
    def test_the_error_shrinks_by_the_factor_at_most(self) -> None:
        """The whole recursion on a linear device, beside its own bound."""
        times = DT * np.arange(600)
        fade = np.ones(600)
        r = 50 * np.exp(-((times - 20e-3) ** 2) / (2 * 1e-3**2))

        def device(p: FloatArray) -> FloatArray:
            spectrum = np.fft.rfft(p, 8192)
            f = np.fft.rfftfreq(8192, DT)
            return np.fft.irfft(spectrum * (0.7 + 0.3j * f / (f + 200)), 8192)[:600]

        f = np.linspace(20, 1000, 200)
        known = condition(Ratio(f, 0.7 + 0.3j * f / (f + 200), np.zeros(f.size)), 1.0, limited=False)
        assert known.met
        d, sizes = np.zeros(600), []
        for _ in range(5):
            p = r + d
            after = corrected(d, known.gain * (d + device(p) - p), DT, known.cutoff_Hz, fade)
            sizes.append(float(np.linalg.norm(after - d)))
            d = after
        shrunk = np.array(sizes[1:]) / sizes[:-1]
        assert shrunk.max() <= known.factor + 0.02
        assert nrmse(device(r + d), r) < 0.02
        assert nrmse(device(r), r) > 0.2

    def test_which_node_a_tap_counts_for(self, library: Library) -> None:
        assert node_near(library, 0.21, 3.2) == (1, 1)
        assert node_near(library, 0.26, 5.4) == (2, 2)
        assert node_near(library, 0.15, 3.0) is None
        assert node_near(library, 0.2, 2.0) is None
        assert node_near(library, 0.5, 3.0) is None
        assert node_near(library, 0.45, 0.6) == (3, 0)


def wanted(library: Library, iv: int, ig: int) -> FloatArray:
    """(N,) what an entry asks of the current."""
    return library.uncorrected(iv, ig).window_m_s2


class TestResolve:
    def test_without_a_correction_nothing_changes(self, small: Library) -> None:
        zero = np.zeros(small.command.shape[2])
        again, kept = resolve(small, dict.fromkeys(nodes_of(small), zero), {"rounds": []})
        assert not kept
        for name in ("command", "tap_error", "floor", "objective", "peak_input", "mu_current_upper"):
            # A command that is as exact as its proof needs, and figures that follow from it.
            atol = 1e-6 if name == "command" else 1e-8
            np.testing.assert_allclose(again.array(name), small.array(name), rtol=1e-8, atol=atol)
        assert again.meta["left_out"] == small.meta["left_out"]

    def test_corrected_entries_are_certified_from_the_file_alone(self, small: Library, tmp_path: Path) -> None:
        asked = {(0, 0): 0.2 * wanted(small, 0, 0), (1, 1): 0.3 * wanted(small, 1, 1)}
        refined, kept = resolve(small, asked, {"rounds": []})
        assert not kept
        loaded = proven_again(refined, tmp_path)
        # What no limit binds follows its correction; what one does stays within it.
        # But for the weight of the command's movement, which is relative to the limit.
        assert nrmse(loaded.command[0, 0], 1.2 * small.command[0, 0]) < 0.02
        assert loaded.floor[0, 0] == pytest.approx(loaded.tap_error[0, 0], abs=1e-6)
        assert loaded.peak_input.max() <= loaded.input_limit + 1e-6
        np.testing.assert_array_equal(loaded.command[0, 1], small.command[0, 1])
        assert loaded.at(0.2, 3.0).command == pytest.approx(loaded.command[0, 0])

    def test_a_tap_with_a_price_on_intensity_keeps_the_floor_of_its_waveform(self, scene: Scene) -> None:
        louder = {"weights.objective": "intensity", "grid.speeds_m_s": [0.4], "grid.grips_N": [5.0]}
        priced = to.solve(with_values(scene, louder))
        assert priced.intensity[0, 0] > 0.1
        refined, kept = resolve(priced, {(0, 0): 0.002 * wanted(priced, 0, 0)}, {"rounds": []})
        assert not kept
        assert refined.floor[0, 0] == pytest.approx(priced.floor[0, 0], abs=2e-3)
        assert [entry.shortfalls for entry in verify_library(refined)] == [[]]

    @pytest.mark.skipif(not riccati.available, reason="the solver's extension is not built")
    def test_a_tap_solved_anew_asks_for_the_same(self, small: Library, scene: Scene) -> None:
        """At a node, and between nodes by a correction blended like the reference."""
        share = 0.2
        asked = {node: share * wanted(small, *node) for node in nodes_of(small)}
        refined, _ = resolve(small, asked, {"rounds": []})
        online = Online(refined, scene.plant, lambda grip: ())
        at_node = online.solve(0.2, 3.0).wave
        np.testing.assert_allclose(at_node.command, refined.command[0, 0], atol=1e-6)
        plain = Online(small, scene.plant, lambda grip: ()).solve(0.22, 4.0).wave
        between = online.solve(0.22, 4.0).wave
        # But for the weight of the command's movement, which is relative to the limit.
        assert nrmse(between.command, (1 + share) * plain.command) < 0.02

    def test_another_correction_than_the_one_solved_for_is_found_out(self, small: Library) -> None:
        refined, _ = resolve(small, {(0, 0): 0.2 * wanted(small, 0, 0)}, {"rounds": []})
        wrong = refined.correction_m_s2.copy()
        wrong[0, 0] *= 0.9
        shortfalls = verify_library(replace(refined, correction_m_s2=wrong))[0].shortfalls
        assert any("gap" in text or "target" in text for text in shortfalls), shortfalls

    def test_a_wall_is_refused(self, small: Library) -> None:
        walled = under(small, {"feedback.stiffness_N_m": 200.0})
        with pytest.raises(InputError, match="wall"):
            resolve(walled, {}, {})


class Bent:
    """A linear device in place of all the rest: a = T p with white noise on every tap.

    Parameters
    ----------
    gain : T.
    worse : round -> the node that plays with a gain of 0.3 in it, whatever was learnt.
    """

    def __init__(
        self, gain: float, worse: Mapping[int, Node] | None = None, noise_m_s2: float = 0.1, taps: int = 3
    ) -> None:
        self.gain, self.worse, self.noise_m_s2, self.taps = gain, worse or {}, noise_m_s2, taps
        self.random = np.random.default_rng(7)
        self.asked: list[list[Node]] = []

    def __call__(self, library: Library, number: int, nodes: Sequence[Node]) -> dict[Node, list[Heard]]:
        self.asked.append(list(nodes))
        grid, heard = library.time_grid(), {}
        fade = fade_of(grid.switching_times_s)
        for node in nodes:
            gain = 0.3 if self.worse.get(number) == node else self.gain
            w = (gain - 1) * smooth(library.acceleration_m_s2[node], grid.dt_s)
            noise = self.noise_m_s2 * self.random.standard_normal((self.taps, w.size))
            heard[node] = [Heard(fade * (w + smooth(each, grid.dt_s)), 0.0, 1.0) for each in noise]
        return heard


STATED: dict[str, Any] = {"source": "a test"}


@pytest.fixture(scope="module")
def refined(small: Library) -> Refined:
    return refine(small, Bent(0.8, {2: (0, 1)}), resolve, 3, STATED)


class TestRounds:
    def test_free_nodes_converge_and_limited_ones_stay_at_their_optimum(
        self, small: Library, refined: Refined
    ) -> None:
        first, last = refined.history.rounds[0], refined.history.confirmed
        assert first[0, 0].playback_error == pytest.approx(0.2, abs=0.01)
        assert last[0, 0].playback_error < 0.012
        assert not last[0, 0].limited
        assert last[1, 1].limited
        assert last[1, 1].playback_error < first[1, 1].playback_error
        for results in refined.history.rounds[1:]:
            assert all(node.condition is not None and node.condition.met for node in results.values())
        learnt = refined.history.rounds[1][0, 0].condition
        assert learnt.factor == pytest.approx(0.2, abs=0.02)

    def test_a_round_that_comes_out_worse_is_taken_back(self, small: Library) -> None:
        refined = refine(small, Bent(0.5, {2: (0, 1)}), resolve, 4, STATED)
        rounds = refined.history.rounds
        assert rounds[1][0, 1].better
        assert not rounds[2][0, 1].better
        again = rounds[3][0, 1].condition
        assert again.gain == 0.5
        assert (0, 1) in refined.better

    def test_a_right_model_is_left_alone(self, small: Library) -> None:
        """Not one node is changed by noise, and nobody is asked to tap again."""
        device = Bent(1.0, noise_m_s2=1.0)
        refined = refine(small, device, resolve, 3, STATED)
        assert device.asked == [nodes_of(small)]
        assert {course.why for course in refined.history.courses.values()} == {NOTHING_LEFT}
        np.testing.assert_array_equal(refined.library.command, small.command)
        words, good = summary(refined, Path("library.npz"))
        assert good
        assert "nothing significant is to be gained at any node" in words

    def test_only_nodes_with_something_left_are_tapped_at(self, small: Library) -> None:
        right, bent, asked = Bent(1.0), Bent(0.8), []

        def play(library: Library, number: int, nodes: Sequence[Node]) -> dict[Node, list[Heard]]:
            asked.append(list(nodes))
            return right(library, number, nodes) | bent(library, number, [node for node in nodes if node == (0, 1)])

        refined = refine(small, play, resolve, 3, STATED)
        assert refined.better == [(0, 1)]
        assert asked[1:] == [[(0, 1)]] * (len(asked) - 1)

    def test_a_gain_that_new_taps_do_not_confirm_is_taken_back(self, small: Library) -> None:
        class Fickle(Bent):
            """A device that forgets, once the learning is over, what it was taught."""

            def __call__(self, library: Library, number: int, nodes: Sequence[Node]) -> dict[Node, list[Heard]]:
                self.gain = 0.5 if number == 2 else 0.8
                return super().__call__(library, number, nodes)

        refined = refine(small, Fickle(0.8), resolve, 1, STATED)
        assert all(refined.history.rounds[1][node].better for node in nodes_of(small))
        assert not refined.better
        assert {course.why for course in refined.history.courses.values()} == {NOT_CONFIRMED}
        np.testing.assert_allclose(refined.library.command, small.command, atol=1e-6)
        assert not summary(refined, Path("library.npz"))[1]

    def test_certified_within_all_limits(self, small: Library, refined: Refined, tmp_path: Path) -> None:
        loaded = proven_again(refined.library, tmp_path)
        assert loaded.peak_input.max() <= 4 + 1e-6
        kept = loaded.meta["refinement"]
        assert kept["source"] == "a test"
        assert kept["learning"] is None
        assert {np.array(one["playback_error"]).shape for one in (*kept["rounds"], kept["confirmed"])} == {(2, 2)}
        assert kept["rounds"][0]["gain"] == [[None] * 2] * 2
        np.testing.assert_array_equal(loaded.recorded_m_s2, small.recorded_m_s2)
        # Refined once more there is little left.
        again = refine(loaded, Bent(0.8), resolve, 1, STATED)
        assert again.history.rounds[0][0, 0].playback_error == pytest.approx(
            refined.history.confirmed[0, 0].playback_error, abs=2e-3
        )

    def test_the_wrong_polarity_is_left_alone(self, small: Library) -> None:
        refined = refine(small, Bent(-1.0), resolve, 1, STATED)
        assert not refined.better
        assert {course.why for course in refined.history.courses.values()} == {NOT_SURE}
        np.testing.assert_array_equal(refined.library.command, small.command)
        words, good = summary(refined, Path("library.npz"))
        assert not good
        assert "no node became better beyond chance" in words

    def test_a_node_that_nobody_tapped_at(self, small: Library) -> None:
        class Without(Bent):
            def __call__(self, library: Library, number: int, nodes: Sequence[Node]) -> dict[Node, list[Heard]]:
                return super().__call__(library, number, [node for node in nodes if node != (1, 0)])

        refined = refine(small, Without(0.8), resolve, 1, STATED)
        assert (1, 0) not in refined.history.rounds[0]
        np.testing.assert_array_equal(refined.library.command[1, 0], small.command[1, 0])
        assert refined.library.meta["refinement"]["rounds"][0]["playback_error"][1][0] is None
        assert refined.library.meta["refinement"]["why"][1][0] == NOT_TAPPED

    def test_table_and_figure(self, refined: Refined, tmp_path: Path) -> None:
        assert refine_table(refined, "title").row_count == 4
        save_figure(refine_figure(refined), tmp_path / "refinement.png")
        assert (tmp_path / "refinement.png").stat().st_size > 10_000
        words, good = summary(refined, tmp_path / "library.npz")
        assert good
        assert "4 of 4 nodes refined, confirmed by new taps" in words
        assert f"transopt verify {tmp_path / 'library.npz'}" in words

    def test_step_by_step_with_the_state_in_the_file_is_the_same(
        self, small: Library, refined: Refined, tmp_path: Path
    ) -> None:
        """What a library between two steps carries is all that the next step needs."""
        device, present = Bent(0.8, {2: (0, 1)}), small
        history, asked = None, None
        while True:
            learner = Learner(present, resolve, 3, lambda learner: in_meta(learner, STATED), history, asked)
            learner.learn(device(learner.library, learner.number, learner.asked))
            learner.library.save(tmp_path / "step.npz")
            present = load_library(tmp_path / "step.npz")
            if learner.over:
                break
            assert is_learning(present)
            history, asked = history_of(present)
        np.testing.assert_allclose(present.command, refined.library.command, atol=1e-4)
        assert [course.why for course in learner.history.courses.values()] == [
            course.why for course in refined.history.courses.values()
        ]

    def test_a_state_that_somebody_changed(self, small: Library) -> None:
        meta = {**small.meta, "refinement": {"learning": {"asked": 3}}}
        with pytest.raises(InputError, match="begin again from the library as it was solved"):
            history_of(replace(small, meta=meta))
