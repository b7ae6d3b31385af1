"""The seed's experiment in short form: one saturated entry, one mismatched device, a few methods."""

import csv
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import image

from controller.waveforms.bank import Method
from tests.benches.scripts import script
from transopt.scene.scene import Scene

figures, comparison, device = script("seed_figures"), script("seed.comparison"), script("seed.device")
command = script("common.command")

SATURATED = (0.4, 5.0)
BRIEF = device.Recorded(sweep_s=1.0, trials=2, grips_N=(0.0, 3.0), hand_grips_N=(1.0, 3.0, 5.0), taps=18)
METHODS = (
    Method.BILINEAR,
    Method.SEED_INVERSION,
    Method.BLIND,
    Method.PROPORTIONAL,
)


@pytest.fixture(scope="module")
def written(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that the command writes, on the corner of the grid where the current limit binds."""
    out = tmp_path_factory.mktemp("seed")
    grid = scene.grid.model_copy(update={"speeds_m_s": [0.3, 0.4], "grips_N": [1.0, 5.0]})
    library, steady = figures.libraries(scene.model_copy(update={"grid": grid}))
    experiment = figures.Experiment(library, steady, [SATURATED], METHODS, devices=1, jobs=1)
    figures.write_all(experiment, out, "the command", recorded=BRIEF)
    return out


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


class TestFiles:
    def test_every_figure_that_the_text_shows_is_there_and_whole(self, written: Path) -> None:
        text = (written / "seed.md").read_text(encoding="utf-8")
        shown = re.findall(r"\]\((\w+\.png)\)", text)
        assert {name[:5] for name in shown} == {"fig01", "fig05", "fig06", "fig07", "fig10", "metho"}
        for name in shown:
            assert np.ptp(image.imread(written / name)) > 0
        tables = {"taps.csv", "methods.csv", "off_nodes.csv", "limits.csv"}
        assert {path.name for path in written.iterdir()} == {*shown, *tables, "seed.md"}

    def test_text_names_command_machine_and_versions(self, written: Path) -> None:
        text = (written / "seed.md").read_text(encoding="utf-8")
        for word in (
            "the command",
            "cores",
            "python 3",
            "casadi",
            "numpy",
            "at most" if "except" in text else "less tap and felt error",
        ):
            assert word in text

    def test_rows(self, written: Path) -> None:
        taps = rows_of(written / "taps.csv")
        assert [(row["method"], row["device"]) for row in taps] == [
            (method.value, device) for device in ("0", "1") for method in METHODS
        ]
        assert {(row["speed_m_s"], row["grip_N"]) for row in taps} == {("0.4", "5.0")}
        assert [row["method"] for row in rows_of(written / "methods.csv")] == [method.value for method in METHODS]
        assert len(rows_of(written / "off_nodes.csv")) == len(METHODS)


class TestWhatTheExperimentShows:
    def test_optimum_ahead_of_every_other_method_where_the_limit_binds(self, written: Path) -> None:
        best, *others = rows_of(written / "methods.csv")
        for row in others:
            for figure in comparison.FIGURES:
                assert float(best[figure]) < float(row[figure]), (row["method"], figure)
            assert row["ahead"] == row["ahead_unshifted"] == "0"

    def test_limits(self, written: Path) -> None:
        [row] = rows_of(written / "limits.csv")
        assert float(row["needed_A"]) == pytest.approx(6.44, abs=0.1)
        assert float(row["optimum"]) == pytest.approx(0.362, abs=0.005)
        assert float(row["optimum"]) < float(row["seed"]) < float(row["optimum_steady"]) < float(row["seed_steady"])
        assert float(row["optimum"]) < float(row["blind"])
        # The seed's inversion pushes to the end, and what it lets go of then is felt as a second tap.
        assert 4 * float(row["optimum_felt"]) < float(row["seed_felt"])
        assert float(row["playback_error"]) < 0.01
        assert abs(float(row["latency_s"])) < 20e-6

    def test_proportional_alone_pushes_but_does_not_tap(self, written: Path) -> None:
        for row in rows_of(written / "taps.csv"):
            if row["method"] == "proportional":
                assert float(row["tap_error"]) > 0.9
                assert float(row["felt_error"]) == pytest.approx(1.0, abs=0.05)
                assert float(row["peak_current_A"]) > 0.5


class TestSummary:
    def results(self, **errors: list[list[float]]) -> list[Any]:
        """Made-up taps: per method a row per device, the nominal one first.

        The unshifted errors are twice as large, the felt ones three times.
        """
        return [
            comparison.Result(method, device, 0.1 * (j + 1), 3.0, value, 3 * value, 1 - value, 2 * value, 0.0, 1.0)
            for method, table in errors.items()
            for device, row in enumerate(table)
            for j, value in enumerate(row)
        ]

    def test_means_worst_cases_and_exceptions(self) -> None:
        results = self.results(
            bilinear=[[0.1, 0.3], [0.2, 0.4], [0.1, 0.1]], blind=[[0.2, 0.3], [0.1999, 0.3], [0.5, 0.5]]
        )
        optimum, blind = comparison.summarise(results)
        assert (optimum.nominal, optimum.nominal_worst) == pytest.approx((0.2, 0.3))
        assert (optimum.mean, optimum.worst_device, optimum.worst_tap) == pytest.approx((0.2, 0.3, 0.4))
        assert (optimum.nominal_unshifted, optimum.mean_unshifted) == pytest.approx((0.4, 0.4))
        assert (optimum.felt_nominal, optimum.felt_mean) == pytest.approx((0.6, 0.6))
        assert (optimum.speed_nominal, optimum.speed_mean) == pytest.approx((0.8, 0.8))
        assert (optimum.ahead, blind.ahead, blind.ahead_unshifted, blind.taps) == (
            0,
            1,
            1,
            4,
        )  # 0.1999 against 0.2 is no difference
        assert comparison.exceptions([optimum, blind]) == []
        better = self.results(bilinear=[[0.3], [0.3]], blind=[[0.4], [0.2]])
        found = comparison.exceptions(comparison.summarise(better))
        assert [figure for _, figure, _, _ in found] == [
            "mean",
            "worst_device",
            "worst_tap",
            "mean_unshifted",
            "felt_mean",
        ]

    def test_nominal_device_alone(self) -> None:
        [optimum] = comparison.summarise(self.results(bilinear=[[0.1, 0.2]]))
        assert optimum.nominal == pytest.approx(0.15)
        assert np.isnan(optimum.mean)
        assert comparison.exceptions([optimum]) == []


class TestDevice:
    def test_the_prefilter_makes_the_amplifier_faster_and_the_dead_band_shows_around_zero_alone(
        self, scene: Scene
    ) -> None:
        sweeps = device.amplifier_sweeps(scene, BRIEF)
        assert [each.offset_A for each in sweeps] == [1.0, 0.0, -1.0]
        gains = []
        for each in sweeps:
            # A pole and the hold of a sample: 3 dB at about the pole, and beyond half the sweep with the inverse.
            assert 0.85 * 1050 < device.widest(each.before) < 1.05 * 1050
            assert device.widest(each.after) > 2 * device.widest(each.before)
            slow = (each.before.frequencies_Hz > 30) & (each.before.frequencies_Hz < 80)
            gains.append(float(np.abs(each.before.response[slow]).mean()))
        # The describing function of a dead band h at an amplitude A: 1 - 4 h / (pi A).
        lost = 4 * 0.01 / (np.pi * device.AMPLIFIER_A)
        assert gains == pytest.approx([1.0, 1.0 - lost, 1.0], abs=4e-3)

    def test_the_hand_over_grip_has_the_signs_of_the_seeds(self, scene: Scene) -> None:
        fit = device.hand_fit(scene, BRIEF)
        mass, damping, stiffness = (line.line for line in fit.lines)
        assert mass.per_newton < 0 < min(damping.per_newton, stiffness.per_newton)
        assert fit.unexplained < 0.05

    def test_a_firm_grip_asks_the_surface_for_more_force(self, scene: Scene) -> None:
        soft, firm = (device.real_tap(scene, 0.3, grip) for grip in (device.SOFT_N, device.FIRM_N))
        assert firm.peak_N > 1.3 * soft.peak_N
        assert firm.peak_g == pytest.approx(soft.peak_g, rel=0.15)

    def test_sweep_finds_the_model(self, scene: Scene) -> None:
        found = device.sweep_response(scene, 3.0, device.Recorded(trials=2))
        size_dB, phase_deg = device.deviation(scene, 3.0, found, 10.0)
        assert size_dB < 0.5
        assert phase_deg < 3.0
        assert found.coherence[found.frequencies_Hz > 10].min() > 0.9

    def test_grips_as_the_design_states_them(self, scene: Scene) -> None:
        for grip in (0.5, 1.0, 3.0, 5.0):
            shape = device.shape(scene, grip)
            assert 36 < shape.slow_dB_decade < 40
            assert 13.5 < shape.fast_dB_decade < 24
            assert shape.at_80_Hz_g_A == pytest.approx(3.0, abs=0.3)
            assert shape.resonance_Hz == pytest.approx(390, abs=10)
            assert 8 <= shape.resonance_g_A <= 9


class TestCommandLine:
    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["--devices", "0"], "'--devices'"),
            (["--jobs", "0"], "'--jobs'"),
            (["--out", "file"], "--out file: cannot be written"),
        ],
    )
    def test_bad_input(
        self,
        arguments: list[str],
        words: str,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")  # which the command would set for good
        Path("file").touch()
        monkeypatch.setattr(sys, "argv", ["seed_figures.py", "--out", "out", *arguments])
        with pytest.raises(SystemExit) as stop:
            command.run(figures.main)
        assert stop.value.code == 2
        assert words in capsys.readouterr().err
