"""Named studies of one key: the varied key, the figure, and a finding in words from the rows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from transopt.base.plotting import LABEL_PT, style
from transopt.base.signals import BoolArray, FloatArray
from transopt.base.writing import percent
from transopt.problem.answer import AT_FLOOR
from transopt.problem.objective.bands import JUST_NOTICED_dB
from transopt.proof.designed import TOLERANCE_dB
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.study.axes import parse_axis
from transopt.study.figures import curves, entry_grid, entry_lines, legend_above, percent_axis
from transopt.study.plan import Plan
from transopt.study.rows import Row


@dataclass(frozen=True)
class Sweep:
    """A study of one key at V of its values and E of its entries.

    Attributes
    ----------
    plan, rows : the whole study.
    used : which of all values these are. kept : (speeds, grips) which entries.
    """

    plan: Plan
    rows: Sequence[Row]
    used: BoolArray
    kept: BoolArray

    @property
    def values(self) -> list[Any]:
        """(V,) values of the key."""
        return [value for value, used in zip(self.plan.axes[0].values, self.used, strict=True) if used]

    def column(self, name: str) -> FloatArray:
        """(V, E) a column of the rows; NaN where the value is missing."""
        return entry_grid(self.plan, self.rows, name)[self.used][:, self.kept]

    @property
    def places(self) -> FloatArray:
        """(E, 2) speeds [m/s] and grips [N]."""
        places = np.meshgrid(self.plan.speeds_m_s, self.plan.grips_N, indexing="ij")
        return np.stack(places, axis=-1)[self.kept]


@dataclass(frozen=True)
class KeyStudy:
    """A named study of one key.

    Attributes
    ----------
    axis : the key and its values, in the form of `parse_axis`.
    fastest : how many of the scene's speeds are solved at every value, from the fastest on; None for all. All of its
        grips are.
    figure : draws the figure from plan and rows.
    sentence : states the finding in one or two sentences.
    changes : keys of the scene that are set for all values, the current to no more than the motor's peak.
    throughout : whether the finding is about the entries that are certified at every value that has any, or else at
        the first one.
    """

    axis: str
    figure: Callable[[Plan, Sequence[Row]], Figure]
    sentence: Callable[[Sweep], str]
    changes: tuple[tuple[str, Any], ...] = ()
    fastest: int | None = None
    throughout: bool = True

    def plan(self, scene: Scene) -> Plan:
        changes, axes, current = dict(self.changes), scene.axes, "limits.current_A"
        if scene.motor is not None and current in changes:
            changes[current] = min(changes[current], scene.motor.i_peak_A)
        changed = with_values(scene, changes) if changes else scene
        speeds_m_s = axes.speeds_m_s if self.fastest is None else axes.speeds_m_s[-self.fastest :]
        return Plan(changed, (parse_axis(changed, "--study", self.axis),), speeds_m_s, axes.grips_N)

    def finding(self, plan: Plan, rows: Sequence[Row]) -> str:
        """The finding of the entries that have one, and how many have none; empty if none has."""
        certified = np.isfinite(entry_grid(plan, rows, "tap_error"))
        used = np.asarray(certified.any(axis=(1, 2)))
        kept = np.asarray(certified[used].all(axis=0) if self.throughout else certified[np.argmax(used)])
        if not (used.any() and kept.any()):
            return ""
        said, without = [self.sentence(Sweep(plan, rows, used, kept))], "without a certified optimum"
        if not used.all():
            said.append(f"At {int(np.sum(~used))} of {used.size} values every entry is {without}.")
        if not kept.all():
            said.append(f"Left out: {int(np.sum(~kept))} of {kept.size} entries, {without} at some other value.")
        return " ".join(said)


def current_finding(of: Sweep) -> str:
    error, floor, needed, felt = map(of.column, ("tap_error", "floor", "free_peak", "felt_dB"))
    limits = of.values
    cut = int(np.sum(needed[0] > limits[0]))
    free = [A for A, e, f in zip(limits, error, floor, strict=True) if np.all(e <= f + AT_FLOOR)]
    clear = (
        f"from {free[0]:.2f} A on all are at their floor"
        if free
        else f"even at {limits[-1]:g} A some are above their floor"
    )
    strong = [A for A, dB in zip(limits, felt, strict=True) if np.all(np.abs(dB) <= JUST_NOTICED_dB)]
    fair = f"; from {strong[0]:.2f} A on all are as strong as felt, within {JUST_NOTICED_dB:g} dB" if strong else ""
    return (
        f"At {limits[0]:g} A the limit cuts {cut} of {needed[0].size} taps, and the best that is left errs by "
        f"{percent(float(error[0].min()))} to {percent(float(error[0].max()))} %{fair}; {clear}."
    )


def intensity_finding(of: Sweep) -> str:
    energy, wave, error, needed = map(of.column, ("energy_dB", "waveform_dB", "tap_error", "free_peak"))
    limits = np.array(of.values)
    asked_dB = of.plan.scene.weights.intensity_dB

    def from_on(met: Any) -> str:
        """The least limit at and above which `met` holds at every entry."""
        kept = np.logical_and.accumulate(np.all(met, axis=1)[::-1])[::-1]
        return f"{limits[int(np.argmax(kept))]:g} A" if kept.any() else f"more than {limits[-1]:g} A"

    has = energy >= asked_dB - 2 * TOLERANCE_dB
    reached = np.all(has, axis=1)
    first = int(np.argmax(reached)) if reached.any() else len(limits) - 1
    return (
        f"The energy of the recorded taps, {asked_dB:+g} dB, takes {from_on(has)} at every entry; their waveform "
        f"takes {float(np.nanmax(needed)):.2f} A. The nearest waveform has it within {JUST_NOTICED_dB:g} dB "
        f"from {from_on(wave >= asked_dB - JUST_NOTICED_dB)} on. At {limits[first]:g} A the optimum of intensity "
        f"errs by up to {percent(float(np.nanmax(error[first])))} %."
    )


def intensity_figure(plan: Plan, rows: Sequence[Row]) -> Figure:
    """Energy of the nearest waveform, and tap error of the nearest one with the wanted energy, over the limit."""
    limits = np.array(plan.axes[0].values)
    figure = Figure(figsize=(7.4, 3.7), layout="constrained")
    panels = figure.subplots(1, 2)
    drawn = (entry_grid(plan, rows, "waveform_dB"), 100 * entry_grid(plan, rows, "tap_error"))
    words = ("energy of the nearest waveform [dB]", "tap error with the energy asked for [%]")
    for axes, values, label in zip(panels, drawn, words, strict=True):
        style(axes)
        entry_lines(axes, plan, limits, values)
        axes.set_xlabel("current limit [A]", fontsize=LABEL_PT)
        axes.set_ylabel(label, fontsize=LABEL_PT)
    panels[0].axhspan(-JUST_NOTICED_dB, 0.0, color="0.93", linewidth=0)
    legend_above(figure, panels[0].get_lines(), min(len(plan.speeds_m_s), 4))
    return figure


def bandwidth_finding(of: Sweep) -> str:
    error = of.column("tap_error")
    poles = of.values
    worse = (error - error[-1]).max(axis=1)
    enough = next(f for j, f in enumerate(poles) if np.all(worse[j:] <= 0.01))
    at = int(np.argmax(error[0] - error[-1]))
    speed_m_s, grip_N = of.places[at]
    amplifier = of.plan.scene.amplifier_model()
    own = ""
    if amplifier is not None:
        costs = "nothing" if amplifier.pole_Hz >= enough else "more than that"
        own = f", and the scene's {amplifier.pole_Hz:g} Hz costs {costs}"
    found = (
        f"From {enough:.0f} Hz on no entry errs by more than one percentage point above an amplifier of "
        f"{poles[-1]:.0f} Hz: the optimum plans the lag in{own}."
    )
    if error[0][at] - error[-1][at] <= AT_FLOOR:
        return found
    return (
        f"{found} At {poles[0]:.0f} Hz the command limit holds it back, most at {speed_m_s:g} m/s and "
        f"{grip_N:g} N: {percent(float(error[0][at]))} % against {percent(float(error[-1][at]))} %."
    )


def lead_finding(of: Sweep) -> str:
    error, speeds_m_s = of.column("tap_error"), of.places[:, 0]
    leads = of.values
    slow = error[:, speeds_m_s == speeds_m_s.min()].max(axis=1)
    best = int(np.argmin(slow))
    enough = next(j for j, e in enumerate(slow) if e <= slow[best] + AT_FLOOR)
    # Entries without any lead may all be refused: the finding is then about the least that has some.
    least = "without a lead" if leads[0] == 0 else f"with a lead of {1e3 * leads[0]:g} ms"
    late_s = of.plan.scene.time_grid().delay_s - leads[0]
    why = f", since no current acts before {1e3 * late_s:.3f} ms" if late_s > 0 else ""
    first, same, last = (percent(float(each)) for each in (slow[0], slow[enough], error[-1].max()))
    return (
        f"{least.capitalize()} the slowest taps err by {first} %{why}; from {1e3 * leads[enough]:g} ms on by {same} "
        f"%, within {100 * AT_FLOOR:g} % of the least. At the fastest and firmest the current limit rules: "
        f"{percent(float(error[0].max()))} % {least}, {last} % at {1e3 * leads[-1]:g} ms."
    )


def rate_finding(of: Sweep) -> str:
    used, error = of.column("peak_input") / of.plan.scene.limits.steady_input, of.column("tap_error")
    rates = of.values
    # There is no entry at a rate at which the coil overheats without current, or no time is left for a waveform.
    at = int(np.argmax(np.nanmax(used, axis=0) - np.nanmin(used, axis=0)))
    beta, own, (speed_m_s, grip_N) = used[:, at], error[:, at], of.places[at]
    full = [f for f, b in zip(rates, beta, strict=True) if b >= np.nanmax(beta) * (1 - 1e-3)]
    there = np.flatnonzero(np.isfinite(beta))
    last = int(there[-1])
    return (
        f"At {speed_m_s:g} m/s and {grip_N:g} N the coil lets the optimum use beta = "
        f"{beta[0]:.2f} up to {full[-1]:g} taps/s and {beta[last]:.2f} at {rates[last]:g} taps/s; the error rises "
        f"from {percent(float(own[0]))} to {percent(float(own[last]))} %."
    )


def rate_figure(plan: Plan, rows: Sequence[Row]) -> Figure:
    """The beta that the optimum uses, and its error, over the tap rate; one line per entry."""
    used = entry_grid(plan, rows, "peak_input") / plan.scene.limits.steady_input
    error = 100 * entry_grid(plan, rows, "tap_error")
    rates = plan.axes[0].values
    figure = Figure(figsize=(7.4, 3.7), layout="constrained")
    panels = figure.subplots(1, 2)
    for axes, values, label in zip(
        panels, (used, error), ("greatest beta = |i| / steady current", "tap error [%], log scale"), strict=True
    ):
        style(axes)
        entry_lines(axes, plan, np.array(rates), values)
        axes.set_xlabel("taps per second, for ever", fontsize=LABEL_PT)
        axes.set_ylabel(label, fontsize=LABEL_PT)
    percent_axis(panels[1])
    panels[0].set_ylim(bottom=0)
    legend_above(figure, panels[0].get_lines(), min(len(plan.speeds_m_s), 4))
    return figure


KEY_STUDIES = {
    "current_limit": KeyStudy("limits.current_A=1.25:6:20", curves, current_finding),
    "intensity": KeyStudy(
        "limits.current_A=0.5:5.5:21", intensity_figure, intensity_finding, (("weights.objective", "intensity"),)
    ),
    "tap_rate": KeyStudy(
        "thermal.tap_rate_Hz=2:12:11",
        rate_figure,
        rate_finding,
        (("limits.current_A", 6.0),),
        fastest=2,
        throughout=False,
    ),
    "amplifier_bandwidth": KeyStudy("amplifier.pole_Hz=100:10000:13:log", curves, bandwidth_finding),
    "lead": KeyStudy("time.lead_s=0:0.001:11", curves, lead_finding),
}
