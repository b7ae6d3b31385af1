"""The study `motor_selection`: motors and their best transmission ratio on a stated rail and temperature."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import optimize

from transopt.base.errors import InputError
from transopt.base.plotting import DARK, LABEL_PT, SMALL_PT, style
from transopt.base.signals import FloatArray
from transopt.base.writing import percent, table
from transopt.plant.bridge import Bridge
from transopt.scene.identified import IdentifiedModel
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.study.axes import Axis, parse_axis
from transopt.study.executors import Pool
from transopt.study.figures import entry_grid, entry_lines, heat_map, percent_axis, percent_norm
from transopt.study.plan import Plan, two_speeds
from transopt.study.report import binding_names, legend, rows_table
from transopt.study.rows import Row, entry_name, number
from transopt.study.session import run_plan

MOTORS = "faulhaber_0816k003sr,faulhaber_0816k006sr,maxon_re25_118743,maxon_re30_310009,maxon_re40_148877"
RATIOS = "transmission.ratio_1_m=15:1000:15:log"
RAIL_V, AMBIENT_C, TAPS_PER_S = 24.0, 40.0, 4.0
SWITCHING_HZ = 100e3  # below 68 kHz the model of the bridge does not hold for the smallest motor
GOAL = 0.05  # felt error of every entry; without a limit it is about 0.04


def shared_amplifier(scene: Scene) -> dict[str, float | None]:
    """Keys of the one bridge that drives all motors; its loop gain gives the scene's own motor the scene's pole.

    The delay is the scene's. A pole in the scene's model file is used for every motor.

    Raises
    ------
    InputError : the model of the bridge does not hold for the scene's own motor.
    """
    circuit, amplifier, bridge = scene.circuit(), scene.amplifier_model(), scene.bridge()
    switching_Hz = SWITCHING_HZ if bridge is None else bridge.switching_Hz
    in_file = isinstance(scene.model, IdentifiedModel) and scene.model.amplifier is not None
    if circuit is None or amplifier is None or in_file:
        return {"switching_Hz": switching_Hz}

    def missing_Hz(gain_V_A: float) -> float:
        return amplifier.pole_Hz - Bridge(circuit, RAIL_V, switching_Hz, gain_V_A).pole_Hz

    most = Bridge(circuit, RAIL_V, switching_Hz)
    gain_V_A = most.loop_gain_V_A
    if missing_Hz(gain_V_A) < 0:
        # The pole is 1 to 2.2 times the crossover frequency, which is proportional to the gain.
        gain_V_A = optimize.brentq(missing_Hz, gain_V_A * amplifier.pole_Hz / most.crossover_Hz / 3, gain_V_A)
    return {"switching_Hz": switching_Hz, "gain_V_A": gain_V_A, "pole_Hz": None, "delay_s": amplifier.delay_s}


def motor_scene(scene: Scene, motor: dict[str, Any]) -> Scene:
    """The scene with a motor used up to its own limits, on the stated rail and at the stated temperature.

    The motor's peak and the amplifier's range limit the current; endless tapping limits the coil's temperature. Pole
    and ripple follow from the motor (`shared_amplifier`).

    Raises
    ------
    InputError : the model of the bridge does not hold for the motor.
    """
    amplifier = scene.amplifier_model()
    most = motor["i_peak_A"] if amplifier is None else min(motor["i_peak_A"], amplifier.command_limit)
    return with_values(
        scene,
        {
            "motor": motor,
            "limits.steady_current_A": motor["i_continuous_A"],
            "limits.current_A": most,
            "limits.supply_V": RAIL_V,
            **{f"amplifier.{name}": value for name, value in shared_amplifier(scene).items()},
            "thermal.tap_rate_Hz": TAPS_PER_S,
            **{f"thermal.{name}_C": AMBIENT_C for name in ("ambient", "start_winding", "start_housing")},
        },
    )


@dataclass(frozen=True)
class Choice:
    """A motor at its best ratio: the least that meets the goal at every entry, else that of the least error.

    The error keeps falling with the ratio, but the hand has to move the rotor's reflected mass.

    Attributes
    ----------
    stem : name of the motor's file, without its ending.
    ratio_1_m : transmission ratio, rotor angle per displacement of the tip [1/m].
    worst : felt error of the worst entry, as a share of 1.
    force_N_A : force at the tip per current [N/A].
    mass_kg : mass at the tip: reflected inertia of the rotor plus the link [kg].
    row : row of the worst entry.
    """

    stem: str
    ratio_1_m: float
    worst: float
    force_N_A: float
    mass_kg: float
    row: Row


@dataclass(frozen=True)
class Selection:
    """Plan and rows of every motor by the name of its file, and for others the reason why there are none."""

    studies: dict[str, tuple[Plan, list[Row]]]
    refused: dict[str, str] = field(default_factory=dict)

    def errors(self) -> FloatArray:
        """(motors, ratios, speeds, grips) felt error; NaN without a certified answer."""
        return np.stack([entry_grid(plan, rows, "felt_error") for plan, rows in self.studies.values()])

    @property
    def ratios(self) -> Axis:
        return next(iter(self.studies.values()))[0].axes[0]

    def ranked(self) -> list[Choice]:
        """The best ratio of each motor that has one: those that meet the goal by mass at the tip, others by error."""
        found = []
        for (stem, (plan, rows)), error in zip(self.studies.items(), self.errors(), strict=True):
            worst = error.max(axis=(1, 2))  # NaN if one entry is refused
            if np.all(np.isnan(worst)):
                continue
            meets = np.flatnonzero(worst <= GOAL)
            j = int(meets[0]) if meets.size else int(np.nanargmin(worst))
            iv, ig = np.unravel_index(int(np.argmax(error[j])), error[j].shape)
            ratio = float(self.ratios.values[j])
            tip = with_values(plan.scene, {"transmission.ratio_1_m": ratio}).drive_at_tip()
            row = rows[plan.index(j, int(iv), int(ig))]
            found.append(Choice(stem, ratio, float(worst[j]), tip.force_per_current_N_A, tip.moving_mass_kg, row))
        return sorted(found, key=lambda c: (c.worst > GOAL, c.mass_kg if c.worst <= GOAL else c.worst))

    def figure(self) -> Figure:
        """One heat map of motors over ratios per entry."""
        error = 100 * self.errors()
        norm = percent_norm(error)
        figure = Figure(figsize=(9.6, 4.9), layout="constrained")
        plan = next(iter(self.studies.values()))[0]
        down, across = len(plan.speeds_m_s), len(plan.grips_N)
        panels = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
        stems = Axis("motor", tuple(self.studies), tuple(stem.replace("_", " ") for stem in self.studies))
        for iv, speed in enumerate(plan.speeds_m_s):
            for ig, grip in enumerate(plan.grips_N):
                mesh = heat_map(panels[iv, ig], stems, self.ratios, error[:, :, iv, ig], norm, written=False)
                panels[iv, ig].set_title(f"{speed:g} m/s, {grip:g} N", fontsize=LABEL_PT)
        figure.supxlabel("transmission ratio [1/m]", fontsize=LABEL_PT)
        bar = figure.colorbar(mesh, ax=panels, shrink=0.9)
        bar.set_label("felt error [%]; grey: not certified", fontsize=LABEL_PT)
        percent_axis(bar.ax)
        bar.ax.tick_params(labelsize=SMALL_PT)
        return figure

    def pages(self) -> dict[str, Figure]:
        """Figure per motor: error, current, voltage and temperature over the ratio."""
        return {stem: _page(plan, rows) for stem, (plan, rows) in self.studies.items()}

    def bandwidths(self) -> dict[str, tuple[float, float]]:
        """Per motor the pole of its current [Hz], and the heat added by ripple at a steady 1 A, as a share."""
        found = {}
        for stem, (plan, _) in self.studies.items():
            amplifier, bridge = plan.scene.amplifier_model(), plan.scene.bridge()
            assert amplifier is not None
            assert bridge is not None
            found[stem] = (amplifier.pole_Hz, bridge.heat_factor * (1 + bridge.ripple_A) ** 2 - 1)
        return found

    def sentence(self) -> str:
        """The finding in a few sentences."""
        best = self.ranked()
        if not best:
            return "no motor has a certified answer for every entry at any ratio"
        first, last = best[0], best[-1]
        met = sum(c.worst <= GOAL for c in best)
        poles = sorted(pole_Hz for pole_Hz, _ in self.bandwidths().values())
        return (
            f"On {RAIL_V:g} V, at {AMBIENT_C:g} C and {TAPS_PER_S:g} taps/s for ever, "
            f"{met} of {len(self.studies) + len(self.refused)} "
            f"motors bring all entries to a felt error of {100 * GOAL:g} %; the first, "
            f"{first.stem.replace('_', ' ')} at {first.ratio_1_m:.0f} 1/m, has {1e3 * first.mass_kg:.0f} g at the "
            f"tip and {percent(first.worst)} % at its worst entry, the last, {last.stem.replace('_', ' ')}, "
            f"{percent(last.worst)} % at best. One amplifier gives them poles of "
            f"{poles[0]:.0f} to {poles[-1]:.0f} Hz."
        )

    def report(self, figure: str, head: Sequence[str]) -> list[str]:
        """report.md: a ranked table, and a section per motor."""
        cells = []
        for place, c in enumerate(self.ranked(), start=1):
            plan, _ = self.studies[c.stem]
            pole_Hz, ripple = self.bandwidths()[c.stem]
            assert plan.scene.motor is not None
            cells.append(
                [
                    place,
                    plan.scene.motor.name,
                    f"{c.ratio_1_m:.0f}",
                    percent(c.worst),
                    entry_name(c.row),
                    f"{c.force_N_A:.2f}",
                    f"{1e3 * c.mass_kg:.1f}",
                    f"{pole_Hz:.0f}",
                    percent(ripple),
                    f"{number(c.row, 'peak_input'):.2f} of {plan.scene.limits.transient_input:g}",
                    f"{number(c.row, 'peak_voltage_V'):.1f}",
                    f"{number(c.row, 'peak_temperature_C'):.1f} of {plan.scene.motor.winding_max_C:g}",
                    binding_names(c.row),
                ]
            )
        columns = [
            "",
            "motor",
            "best ratio 1/m",
            "worst felt error %",
            "at",
            "N/A",
            "mass at tip g",
            "pole Hz",
            "ripple heat %",
            "peak A",
            "peak V",
            "coil C",
        ]
        first, _ = next(iter(self.studies.values()))
        bridge = first.scene.bridge()
        assert bridge is not None
        switching_Hz = bridge.switching_Hz
        lines = ["# Motor selection", "", *head, self.sentence(), "", f"![motors]({figure})", ""]
        lines += [
            f"Every motor to its own peak current or the amplifier's range, on {RAIL_V:g} V, at {AMBIENT_C:g} C, "
            f"{TAPS_PER_S:g} taps/s for ever with the coil below its limit. The taps are those recorded with the "
            "scene's own device; stiffness, damping and mass of the link are those of its transmission. Ranked by "
            f"the mass at the tip of the least ratio with at most {100 * GOAL:g} % at every entry, then by error: "
            "higher ratios err less but make the stylus heavy in the hand. Pole and ripple follow from "
            f"the motor: one bridge drives them all, switching at {switching_Hz / 1e3:g} kHz, and its current loop "
            "has the gain that gives the scene's own motor the scene's pole.",
            "",
            *table([*columns, "what binds"], cells),
            *(f"- not posed: {stem.replace('_', ' ')}: {reason}" for stem, reason in self.refused.items()),
            "",
        ]
        for stem, (plan, rows) in self.studies.items():
            assert plan.scene.motor is not None
            lines += [f"## {plan.scene.motor.name}", "", plan.scene.motor.datasheet, "", f"![{stem}]({stem}.png)", ""]
            lines += rows_table(rows, [plan.axes[0].key], plan.scene.driven_by.unit)
        return [*lines, legend(first.scene), ""]


def _page(plan: Plan, rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(9.0, 5.2), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True)
    ratios = np.array(plan.axes[0].values, dtype=float)
    motor = plan.scene.motor
    assert motor is not None
    measures = (
        ("felt_error", 100.0, "felt error [%]", None),
        ("peak_input", 1.0, "peak current [A]", plan.scene.limits.transient_input),
        ("peak_voltage_V", 1.0, "peak voltage [V]", plan.scene.limits.supply_V),
        ("peak_temperature_C", 1.0, "winding [C]", motor.winding_max_C),
    )
    for axes, (column, scale, label, limit) in zip(panels.flat, measures, strict=True):
        style(axes)
        entry_lines(axes, plan, ratios, scale * entry_grid(plan, rows, column))
        if limit is not None:
            axes.axhline(limit, color=DARK, linewidth=0.8, linestyle=":")
        axes.set_ylabel(label, fontsize=LABEL_PT)
        percent_axis(axes, x=True)
    percent_axis(panels[0, 0])
    for axes in panels[1]:
        axes.set_xlabel("transmission ratio [1/m]", fontsize=LABEL_PT)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=4, fontsize=SMALL_PT, frameon=False, title=motor.name
    )
    return figure


def motor_selection(
    scene: Scene, folder: Path, pool: Pool, search: Sequence[Path], *, motors: str = MOTORS, ratios: str = RATIOS
) -> Selection:
    """Solve every motor at every ratio, each in a folder of its own, at two speeds and the outermost grips.

    Parameters
    ----------
    search : folders whose `motors/` hold the motors' files.
    motors : names of the files, separated by commas. ratios : an axis in the form of `parse_axis`.

    Raises
    ------
    InputError : see `run_plan`; or no motor can be posed, for example with a drive that is stated at the tip.
    """
    found, refused = {}, {}
    speeds_m_s, grips_N = two_speeds(scene), tuple(dict.fromkeys(scene.axes.grips_N[at] for at in (0, -1)))
    axis = parse_axis(scene, "--study", f"motor={motors}", search)
    for stem, motor in zip(axis.labels, axis.values, strict=True):
        try:
            own = motor_scene(scene, motor)
        except InputError as error:
            refused[stem] = str(error)
            continue
        plan = Plan(own, (parse_axis(own, "--study", ratios),), speeds_m_s, grips_N)
        found[stem] = (plan, run_plan(plan, folder / stem, pool, name=stem))
    if not found:
        raise InputError("; ".join(dict.fromkeys(refused.values())))
    return Selection(found, refused)
