"""Actuators that are no stylus on a motor: clicks of an LRA against a dense program, other inputs, other words."""

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import problems
from tests.benches import dense
from transopt.base.errors import InputError
from transopt.design.build import Build, build_library
from transopt.design.verify import verify_library
from transopt.library.export import export_library
from transopt.library.library import Library
from transopt.plant.state_space import StateSpace
from transopt.problem.answer import Status
from transopt.report.comparison import Comparison
from transopt.report.markdown import build_markdown
from transopt.report.report_json import build_json
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

SHORT = {"time.dt_s": 1e-4, "time.stages": 160, "weights.after_s": 8e-3}  # 16 ms at 10 kHz


def lra(changes: dict[str, Any] | None = None) -> Scene:
    """The built-in LRA, on a time axis that a dense program can have."""
    return with_values(problems.load("lra_click"), {**SHORT, **(changes or {})})


def built(scene: Scene) -> Build:
    build = build_library(scene, [])
    assert not build.refused
    return build


@pytest.fixture(scope="module")
def click() -> Build:
    return built(lra())


@pytest.mark.parametrize("stroke_m", [0.1e-3, 0.3e-3])
def test_a_click_is_the_optimum_of_a_dense_program_and_keeps_its_stroke_at_all_times(stroke_m: float) -> None:
    for (entry,) in built(lra({"limits.stroke_m": stroke_m})).entries:
        problem, limit = entry.problem, entry.problem.limits["stroke"]
        parts = problem.parts["stroke"]
        rows, _ = dense.within(problem, "stroke", [j / parts for j in range(1, parts + 1)])
        kept = np.full(rows.shape[0], limit.stated - limit.kept_back)
        command, J = dense.optimum(problem, rows, -kept, kept)
        assert entry.certificate.objective == pytest.approx(J, rel=1e-6)
        assert np.abs(entry.solution.command - command).max() < 1e-2 * 3.0  # J is flat in the command
        assert entry.status is Status.OPTIMAL
        largest = largest_stroke_m(problem.stage.plant, entry.solution.command, problem.grid.dt_s)
        assert largest <= stroke_m * (1 + 1e-6)
        if stroke_m == 0.1e-3:  # it binds, but for what is kept back for the time between the instants
            assert largest >= 0.98 * stroke_m
            assert "stroke" in entry.binding


def largest_stroke_m(plant: StateSpace, command: np.ndarray, dt_s: float) -> float:
    """Largest size of the position at 21 instants of every period, by DOP853 on the plant's matrices."""
    state, largest = np.zeros(plant.order), 0.0
    for held in command:
        run = solve_ivp(
            lambda _, x, held=held: plant.A @ x + plant.B[:, 0] * held,
            (0.0, dt_s),
            state,
            method="DOP853",
            rtol=1e-10,
            atol=1e-14,
            t_eval=np.linspace(0.0, dt_s, 21),
        )
        largest = max(largest, float(np.abs(plant.outputs["position"].row[0] @ run.y).max()))
        state = run.y[:, -1]
    return largest


class TestLibrary:
    def test_has_no_speeds_to_ask_for(self, click: Build) -> None:
        with pytest.raises(InputError, match="no speeds but targets: ask for one of click 150 Hz, click 250 Hz"):
            click.library.at(0.2, 3.0)

    def test_is_not_compared_with_currents(self, click: Build, library: Library) -> None:
        assert click.library is not None
        with pytest.raises(
            InputError, match="of A are by target, those of B by speed m/s and grip N: nothing to compare"
        ):
            Comparison.of(click.library, library)


class TestWords:
    def test_no_ampere_where_there_are_volts(self, click: Build, tmp_path: Path) -> None:
        assert click.library is not None
        export_library(click.library, tmp_path / "x.csv")
        head = (tmp_path / "x.csv").read_text().splitlines()[6]
        assert head.startswith("target,k,issue_time_s,switching_time_s,command_V,transient_command_V,voltage_V,")
        report = build_markdown(click, full=False)
        table = report.split("## Certificates")[0]
        for amperes in (" A |", "[A]", "peak A", "current", "speed m/s", "grip N"):
            assert amperes not in table, amperes
        rows = json.loads(build_json(click))["entries"]
        assert {"target", "peak_voltage_V", "free_peak_voltage_V"} <= set(rows[0])
        assert not any("current" in key or key.endswith("_A") for key in rows[0])
        assert "limit 3 V" in repr(click.library)
        assert "m/s" not in repr(click)


class TestScene:
    @pytest.mark.parametrize(
        ("changes", "said"),
        [
            (
                {"limits.voltage_V": None, "limits.steady_voltage_V": None},
                "limits.voltage_V: missing; a voltage drives",
            ),
            ({"limits.beta": 3.0}, "limits.beta: belongs to a motor that a current drives"),
            ({"limits.supply_V": 5.0}, "limits.supply_V: belongs to a motor"),
            ({"weights.heat_price": 1e-4}, "weights.heat_price: belongs to a motor that a current drives"),
            ({"limits.steady_voltage_V": 4.0}, "steady_voltage_V = 4 V: above voltage_V = 3 V"),
            ({"limits.sag": [[0.0, 1.2]]}, "limits.sag: must be pairs"),
            ({"grid.grips_N": [3.0]}, "grid.grips_N: named targets are for a device that no hand holds"),
            ({"grid.speeds_m_s": [0.3]}, "grid.speeds_m_s: named targets have no speed"),
            ({"model.R_ohm": None}, "R_ohm: missing; a voltage drives the coil"),
            ({"model.input": "current"}, "limits.voltage_V: a current drives"),
            ({"time.stages": 40}, "targets.click 150 Hz: lasts 13.33 ms, the waveform ends at"),
            ({"tip": {"force_per_current_N_A": 1.0, "moving_mass_kg": 0.1}}, "is a whole actuator"),
        ],
    )
    def test_what_contradicts_is_refused_in_one_line(self, changes: dict[str, Any], said: str) -> None:
        with pytest.raises(InputError) as refused:
            build_library(lra(changes), [])
        assert said in str(refused.value)
        assert "\n" not in str(refused.value)

    def test_a_current_through_the_same_coil_makes_the_same_case_move(self) -> None:
        by_voltage, by_current = (
            lra(),
            lra(
                {
                    "model.input": "current",
                    "limits.voltage_V": None,
                    "limits.steady_voltage_V": None,
                    "limits.steady_current_A": 0.4,
                    "limits.current_A": 0.4,
                }
            ),
        )
        f = np.array([80.0, 150.0, 400.0])
        s, plant = 2j * np.pi * f, by_voltage.plant(0.0)
        i_by_u = (plant.outputs["current"].row @ np.linalg.solve(s[:, None, None] * np.eye(3) - plant.A, plant.B))[
            :, 0, 0
        ]
        np.testing.assert_allclose(plant.response(f), i_by_u * by_current.plant(0.0).response(f), rtol=1e-10)


class TestSag:
    def test_the_supply_is_kept_at_all_times(self) -> None:
        course = [[0.0, 1.0], [0.004, 0.5], [0.016, 0.9]]
        scene = lra({"limits.sag": course, "amplifier": {"pole_Hz": 5e3, "delay_s": 2e-5, "command_limit_V": 9.0}})
        times, shares = np.array(course).T
        for (entry,) in built(scene).entries:
            grid, w = entry.problem.grid, 2 * np.pi * 5e3
            u = 0.0
            for k, held in enumerate(entry.solution.command):
                within = np.linspace(0.0, grid.dt_s, 11)
                felt = held + (u - held) * np.exp(-w * within)
                most = 3.0 * np.interp(k * grid.dt_s + within, times, shares)
                assert np.all(np.abs(felt) <= most * (1 + 1e-6))
                u = felt[-1]
            assert "sagging voltage" in entry.binding

    def test_costs_what_it_takes_away(self, click: Build) -> None:
        sagging = built(lra({"limits.sag": [[0.0, 0.8]]}))
        weaker = built(lra({"limits.voltage_V": 2.4, "limits.steady_voltage_V": 2.0}))
        for (one,), (other,), (free,) in zip(sagging.entries, weaker.entries, click.entries, strict=True):
            assert one.figures.tap_error == pytest.approx(
                other.figures.tap_error, rel=1e-4
            )  # the movement is weighed by the limit
            assert one.figures.tap_error > free.figures.tap_error


@pytest.mark.parametrize("window_s", [14e-3, 30e-3, 60e-3])
def test_the_calmer_the_less_is_left_behind_the_target_in_the_window_and_after_it(window_s: float) -> None:
    """A window of 14 ms is over as soon as the click at 150 Hz is: all that can ring does so after it."""
    left = []
    for weight in (1.0, 10.0, 100.0):
        scene = lra({"weights.calm": weight})
        ((entry, *_), *_) = built(with_values(scene, {"time.stages": round(window_s / scene.time.dt_s)})).entries
        problem, made = entry.problem, entry.designed.effect.lasting.acceleration_m_s2
        times = np.append(problem.grid.switching_times_s, problem.grid.after_times_s)
        off = made - np.append(problem.target.window_m_s2, problem.target.after_m_s2)
        left.append((np.sum(off[times > 2 / 150.0] ** 2), np.abs(entry.played.after_peak_m_s2)))
    energies, peaks = np.array(left).T
    assert np.all(energies[1:] < 0.2 * energies[:-1])
    # A window of 60 ms has ended long after the ringing: what is left there is next to nothing with any weight.
    assert peaks[-1] < max(0.3 * peaks[0], 1e-3 * problem.target.window_m_s2.max())


SPREAD: dict[str, Any] = {
    "limits.stroke_m": None,
    "weights.calm": 1.0,  # so that what is minimised is the error that is looked at
    "robust": {"resonance_spread": 0.04, "quality_spread": 0.25, "samples": 3},
}


class TestProduction:
    def test_the_spread_is_of_resonance_and_quality(self) -> None:
        devices = lra(SPREAD).spread(0.0)
        assert len(devices) == 8
        numbers = {(of.model.resonance_Hz, of.model.quality) for of, _ in devices}  # type: ignore[union-attr]
        assert numbers == {(f, q) for f in (144.0, 150.0, 156.0) for q in (6.0, 8.0, 10.0)} - {(150.0, 8.0)}

    def test_one_command_for_all_errs_less_on_their_mean(self) -> None:
        build, alone = built(lra(SPREAD)), built(lra({**SPREAD, "robust": None}))
        for (entry,), (other,) in zip(build.entries, alone.entries, strict=True):
            assert entry.spread is not None
            problem, command = entry.problem, other.solution.command
            # J counts what rings after the waveform, the mean over all devices.
            of_the_nominal = problem.objective(command, problem.accelerations(command))
            assert entry.certificate.objective < 0.995 * of_the_nominal
            assert other.certificate.objective < of_the_nominal
        assert "Robust against the spread" in build_markdown(build, full=False)
        assert build.library is not None
        assert all(not check.shortfalls for check in verify_library(build.library))

    def test_a_voice_coil_keeps_its_masses(self) -> None:
        coil = problems.load("voice_coil_thud").model.model_copy(update={"input": "current"})
        other = coil.produced(1.1, 0.8)  # type: ignore[union-attr]
        poles = [np.linalg.eigvals(each.plant(0.0, None).A)[0] for each in (coil, other)]
        assert abs(poles[1]) / abs(poles[0]) == pytest.approx(1.1, rel=1e-12)
        quality = [abs(pole) / (-2 * pole.real) for pole in poles]
        assert quality[1] / quality[0] == pytest.approx(0.8, rel=1e-12)


class TestCurrentDriven:
    """A voice coil on a current amplifier has what a motor has: a rail, and a winding that heats."""

    CHANGES: ClassVar[dict[str, Any]] = {
        "model.input": "current",
        "model.winding": {
            "R_wh_K_W": 8.0,
            "R_ha_K_W": 30.0,
            "tau_w_s": 2.0,
            "tau_h_s": 200.0,
            "winding_max_C": 120.0,
        },
        "amplifier": {"pole_Hz": 2e3, "delay_s": 3e-5, "command_limit_A": 2.0},
        "limits": {"steady_current_A": 0.4, "current_A": 1.0},
        "time.stages": 800,
    }

    def scene(self, further: dict[str, Any] | None = None) -> Scene:
        return with_values(problems.load("voice_coil_thud"), {**self.CHANGES, **(further or {})})

    def test_its_winding_heats_and_is_limited(self) -> None:
        build = built(self.scene({"thermal.start_winding_C": 119.995, "thermal.start_housing_C": 119.9}))
        for (entry,) in build.entries:
            assert 119.995 < entry.played.winding_C <= 120.0 + 1e-3
            assert "coil" in entry.binding
            assert entry.unit == "A"
        assert build.library.driven_by.unit == "A"
        assert all(not check.shortfalls for check in verify_library(build.library))

    def test_its_rail_is_kept(self) -> None:
        free = built(self.scene())
        tight = built(self.scene({"limits.supply_V": 5.0}))
        for (one,), (other,) in zip(free.entries, tight.entries, strict=True):
            assert other.played.reached["supply"] <= 5.0 * (1 + 1e-3)
            assert other.figures.tap_error > one.figures.tap_error
