"""Presents fitted amplifiers, coils, hands and responses: tables, and a figure each."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MultipleLocator, NullFormatter

from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT, leave_room, plain, style
from transopt.base.signals import ComplexArray, FloatArray
from transopt.base.tables import Table
from transopt.plant.amplifier import Amplifier, prefilter_coefficients
from transopt.plant.second_order import SEED_HAND_DAMPING_N_S_M, SEED_HAND_MASS_KG, SEED_HAND_STIFFNESS_N_M

if TYPE_CHECKING:  # only the fit that is drawn is loaded; loading the others takes longer than drawing
    from transopt.identify.amplifier import AmplifierFit
    from transopt.identify.coil import CoilFit
    from transopt.identify.hand.fourth_order import FourthOrderFit
    from transopt.identify.hand.lines import GripLine, HandFit
    from transopt.identify.response_fit import ResponseFit
    from transopt.identify.spectrum import TransferEstimate, Trial

POINTS = 400
LEAST_DRAWN = 1e-6  # smallest share of the largest magnitude that is drawn, since the logarithm of 0 is infinite
MOST_UNKNOWN = 0.2  # of the magnitude: the figure ends where the confidence band becomes wider
MOST_POINTS = 4000  # most points of a heating record that are drawn
COIL = {  # name in `transopt.identify.coil.NAMES` -> what it belongs to, and its unit
    "R_wh_K_W": ("winding over housing", "K/W"),
    "R_ha_K_W": ("housing over ambient", "K/W"),
    "tau_w_s": ("winding", "s"),
    "tau_h_s": ("housing", "s"),
    "R_ohm": ("winding at 25 C", "ohm"),
}
HAND = {"mass_kg": ("m", "kg"), "damping_N_s_m": ("b", "N s/m"), "stiffness_N_m": ("k", "N/m")}
HAND_PANELS = (
    ("mass [kg]", SEED_HAND_MASS_KG),
    ("damping [N s/m]", SEED_HAND_DAMPING_N_S_M),
    ("stiffness [N/m]", SEED_HAND_STIFFNESS_N_M),
)


def value_table(title: str, rows: Iterable[Sequence[str]]) -> Table:
    """Fitted numbers: name, value, both ends of the 95 % interval, unit."""
    table = Table.of(title, ("quantity", "value", "95 % interval", "unit"), words=("quantity", "unit"))
    for name, value, low, high, unit in rows:
        table.add_row(name, value, f"{low} to {high}", unit)
    return table


def _magnitude_and_phase() -> tuple[Figure, Axes, Axes]:
    """An empty figure for a response over frequency."""
    figure = Figure(figsize=(5.6, 5.2))
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    leave_room(figure, left_in=0.82, right_in=0.1, below_in=0.5, above_in=0.1)
    figure.subplots_adjust(hspace=0.06)
    phase.set_ylabel("phase [deg]", fontsize=LABEL_PT)
    phase.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    phase.set_xscale("log")
    phase.yaxis.set_major_locator(MultipleLocator(90))
    phase.xaxis.set_major_formatter(FuncFormatter(plain))
    phase.xaxis.set_minor_formatter(NullFormatter())
    for axes in (magnitude, phase):
        style(axes)
    return figure, magnitude, phase


def response_figure(fit: "ResponseFit") -> Figure:
    """Magnitude and phase over frequency: measured as dots, fitted as a line."""
    f = fit.frequencies_Hz
    fine = np.geomspace(f[0], f[-1], POINTS)
    figure, magnitude, phase = _magnitude_and_phase()
    unit = fit.plant.driven_by.unit
    at = np.concatenate([f, fine])
    order = np.argsort(at, kind="stable")
    # Both are unwrapped together, so that no whole turn separates them.
    turned = np.empty(at.size)
    turned[order] = np.unwrap(np.angle(fit.plant.response(at))[order])
    off = np.angle(fit.measured / fit.plant.response(f))
    least = LEAST_DRAWN * np.abs(fit.measured).max()
    label = f"fitted, {fit.plant.order} states, misfit {100 * fit.misfit:.2g} %"
    magnitude.loglog(f, np.maximum(np.abs(fit.measured), least), ".", color=SEED, markersize=3, label="measured")
    fitted = np.maximum(np.abs(fit.plant.response(fine)), least)
    magnitude.loglog(fine, fitted, color=OPTIMUM, linewidth=1.2, label=label)
    phase.plot(f, np.degrees(turned[: f.size] + off), ".", color=SEED, markersize=3)
    phase.plot(fine, np.degrees(turned[f.size :]), color=OPTIMUM, linewidth=1.2)
    magnitude.set_ylabel(f"acceleration [m/s$^2$ per {unit}]", fontsize=LABEL_PT)
    magnitude.legend(fontsize=SMALL_PT, frameon=False)
    return figure


def amplifier_figure(fit: "AmplifierFit") -> Figure:
    """Magnitude and phase from command to measured current, without and with the prefilter before it.

    Dots: the estimate; shaded: its 95 % band; lines: the fitted pole and delay, with hold and sampling.
    """
    known = fit.estimate.half_width() < MOST_UNKNOWN * np.abs(fit.estimate.response)
    estimate = fit.estimate.between(*fit.estimate.frequencies_Hz[known][[0, -1]])
    f = estimate.frequencies_Hz
    fine = np.geomspace(f[0], f[-1], POINTS)
    figure, magnitude, phase = _magnitude_and_phase()
    label = f"fit: {fit.pole_Hz:.0f} Hz, {1e6 * fit.delay_s:.1f} us"
    _draw(magnitude, phase, estimate, OPTIMUM, "command to current")
    _line(magnitude, phase, fine, fit.response(fine), OPTIMUM, label)
    _draw(magnitude, phase, estimate.over(1 / prefilter_response(fit, f)), SEED, "after the prefilter")
    after = fit.response(fine) * prefilter_response(fit, fine)
    _line(magnitude, phase, fine, after, SEED, "fit after the prefilter")
    magnitude.set_ylabel("magnitude [dB]", fontsize=LABEL_PT)
    phase.set_xlim(f[0], f[-1])
    magnitude.legend(fontsize=SMALL_PT, frameon=False, loc="lower left")
    hold = f"delay beyond the hold; with its half sample {1e6 * fit.delay_with_hold_s:.1f} us"
    phase.text(0.02, 0.04, hold, transform=phase.transAxes, fontsize=SMALL_PT)
    return figure


def prefilter_response(fit: "AmplifierFit", frequencies_Hz: FloatArray) -> ComplexArray:
    """(m,) complex response of the prefilter that inverts the fitted pole (`transopt.plant.amplifier.prefilter`)."""
    pole = Amplifier(fit.pole_Hz, fit.delay_s, 1.0)  # the range of the command has no effect here
    now, before = prefilter_coefficients(pole, fit.dt_s)
    return np.asarray(now + before * np.exp(-2j * np.pi * frequencies_Hz * fit.dt_s))


def _draw(magnitude: Axes, phase: Axes, estimate: "TransferEstimate", colour: str, label: str) -> None:
    """Draw an estimate with its 95 % band."""
    f, size, (low, high) = estimate.frequencies_Hz, np.abs(estimate.response), estimate.magnitude_band()
    degrees, spread = np.degrees(np.unwrap(np.angle(estimate.response))), estimate.phase_half_width_deg()
    low = np.maximum(low, LEAST_DRAWN * size.max())
    magnitude.fill_between(f, 20 * np.log10(low), 20 * np.log10(high), color=colour, alpha=0.25, linewidth=0)
    magnitude.plot(f, 20 * np.log10(size), ".", color=colour, markersize=2.5, label=f"{label}, 95 % band")
    phase.fill_between(f, degrees - spread, degrees + spread, color=colour, alpha=0.25, linewidth=0)
    phase.plot(f, degrees, ".", color=colour, markersize=2.5)


def _line(magnitude: Axes, phase: Axes, f: FloatArray, response: ComplexArray, colour: str, label: str) -> None:
    """Draw a fitted response."""
    magnitude.plot(f, 20 * np.log10(np.abs(response)), color=colour, linewidth=1.1, label=label)
    phase.plot(f, np.degrees(np.unwrap(np.angle(response))), color=colour, linewidth=1.1)


def trial_table(fit: "AmplifierFit", trials: Sequence["Trial"]) -> Table:
    """The command of each file, and the gain that a linear model finds in it."""
    heads = ("file", "length [s]", "rate [Hz]", "peak [A]", "middle [A]", "gain with crossover")
    table = Table.of("trials, command to current", heads, words=("file",))
    for trial, gain in zip(trials, fit.trial_gains, strict=True):
        command = trial.input
        numbers = (command.values.size * command.dt_s, command.rate_Hz, np.abs(command.values).max())
        table.add_row(
            trial.name, *(f"{number:.6g}" for number in numbers), f"{np.median(command.values):.2f}", f"{gain:.4f}"
        )
    return table


def amplifier_table(fit: "AmplifierFit") -> Table:
    """Values with their 95 % intervals."""
    late = (fit.delay_s, fit.intervals["delay_s"], 1e6)
    rows = [
        ("pole", fit.pole_Hz, fit.intervals["pole_Hz"], 1.0, 0.0, "Hz", ".1f"),
        ("delay beyond the hold", *late, 0.0, "us", ".2f"),
        ("delay with the hold's half sample", *late, 5e5 * fit.dt_s, "us", ".2f"),
        ("gain", fit.gain, fit.intervals["gain"], 1.0, 0.0, "", ".4f"),
    ]
    crossover = fit.crossover
    if crossover.shows:
        h, half = crossover.half_width_A, 1.96 * crossover.deviation_A
        rows.append(("crossover, half-width", h, (h - half, h + half), 1e3, 0.0, "mA", ".2f"))
    cells = [
        [name, *(format(factor * number + more, form) for number in (value, *interval)), unit]
        for name, value, interval, factor, more, unit, form in rows
    ]
    return value_table("amplifier", cells)


def crossover_line(fit: "AmplifierFit") -> str:
    """Whether the amplifier's crossover dead band can be seen."""
    crossover = fit.crossover
    if crossover.shows:
        h = crossover.half_width_A
        # A dead band of half-width h reduces the first harmonic of a sine of 1 A by 4 h / pi.
        lost = f"commands within {1e3 * h:.3g} mA of zero are lost, {400 * h / np.pi:.2g} % of a sine of 1 A"
        return f"crossover: {lost}; taken off before the fit, so that pole and delay are free of it"
    seen = f"none above {4e3 * crossover.deviation_A:.2g} mA" if crossover.deviation_A > 0 else "not to be seen"
    return f"crossover: {seen}"


def coil_figure(fit: "CoilFit") -> Figure:
    """Recorded and modelled temperatures over time, their difference, and the current."""
    record = fit.record
    rows = np.arange(fit.winding_C.size)
    minutes = rows * record.dt_s / 60
    thin = slice(None, None, max(1, rows.size // MOST_POINTS))
    figure = Figure(figsize=(7.0, 5.5), layout="constrained")
    above, missed, below = figure.subplots(3, 1, sharex=True, height_ratios=[4, 1.5, 1.2])
    shown = [("winding", record.winding, fit.winding_C, OPTIMUM)]
    if record.housing is not None:
        shown.append(("housing", record.housing, fit.housing_C, CLIPPED))
    for name, channel, model, colour in shown:
        known = np.flatnonzero(channel.weight > 0)[thin]
        above.plot(
            minutes[known], channel.values_C[known], ".", color=colour, ms=2, alpha=0.3, label=f"{name}, recorded"
        )
        missed.plot(minutes[known], channel.values_C[known] - model[known], ".", color=colour, ms=2, alpha=0.3)
    above.plot(minutes, fit.winding_C, color=DARK, lw=1.0, label="model")
    above.plot(minutes, fit.housing_C, color=DARK, lw=1.0, ls="--", label="model, housing")
    missed.axhline(0.0, color=DARK, lw=0.8)
    below.plot(minutes, np.sqrt(record.heating_A2) - record.ripple_A, color=SEED, lw=1.0)
    for axes, label in ((above, "temperature [C]"), (missed, "missed by [K]"), (below, "current [A]")):
        axes.set_ylabel(label, fontsize=LABEL_PT)
        style(axes)
    below.set_xlabel("time [min]", fontsize=LABEL_PT)
    above.legend(fontsize=SMALL_PT, frameon=False, markerscale=4)
    return figure


def coil_table(fit: "CoilFit") -> Table:
    """Thermal resistances, time constants and resistance with their 95 % intervals."""
    rows = []
    for (name, (of, unit)), (low, high) in zip(COIL.items(), fit.intervals, strict=True):
        rows.append((f"{name}, {of}", f"{getattr(fit.coil, name):.4g}", f"{low:.4g}", f"{high:.4g}", unit))
    return value_table(f"coil, stated as {fit.record.R_ohm:g} ohm +- {100 * fit.record.R_tolerance:g} %", rows)


def noise_line(fit: "CoilFit") -> str:
    """Which temperatures were fitted, and how close the model comes to them."""
    channels = "the winding" if fit.record.housing is None else "winding and housing"
    noise = f"noise of the winding {fit.record.winding.noise_K:.2g} K, residuals {fit.misfit:.2f} times the noise"
    leads, most = f"{fit.leads_ohm:.2g} ohm of leads within the voltage", f"{fit.record.leads_ohm:.2g} ohm"
    more = f"at most {most} as stated: {most} more would make R_wh + R_ha {100 * fit.by_leads:.2g} % larger"
    return f"from {channels}, {noise}{'' if fit.record.electrical is None else f', {leads} ({more})'}"


def hand_figure(fit: "HandFit") -> Figure:
    """Three panels: mass, damping and stiffness per tap over grip, fitted line with 95 % band, the seed's line."""
    figure = Figure(figsize=(9.0, 3.1), layout="constrained")
    for axes, line, (label, seed) in zip(figure.subplots(1, 3), fit.lines, HAND_PANELS, strict=True):
        grip, lower, upper = line.band.T
        axes.fill_between(grip, lower, upper, color=OPTIMUM, alpha=0.25, lw=0, label="95 %")
        axes.plot(fit.grips_N, line.at_taps, ".", color=DARK, ms=4, alpha=0.6, label="tap")
        axes.plot(grip, [line.line.at(g) for g in grip], color=OPTIMUM, lw=1.5, label="line")
        axes.plot(grip, [seed.at(g) for g in grip], "--", color=SEED, lw=1.0, label="seed")
        axes.set_title(equation(line), fontsize=SMALL_PT)
        axes.set_xlabel("grip force [N]", fontsize=LABEL_PT)
        axes.set_ylabel(label, fontsize=LABEL_PT)
        axes.set_ylim(bottom=min(0.0, float(lower.min())))
        style(axes)
    figure.axes[0].legend(fontsize=SMALL_PT, frameon=False)
    return figure


def equation(line: "GripLine") -> str:
    """The line in the form of the seed's Eqs. 3-5."""
    symbol, _ = HAND[line.quantity]
    sign = "-" if line.line.per_newton < 0 else "+"
    return f"${symbol} = {line.line.constant:.4g} {sign} {abs(line.line.per_newton):.3g}\\,F$"


def line_table(fit: "HandFit") -> Table:
    """Constants and slopes with their 95 % intervals, and a test of the linear dependence on grip."""
    title = f"hand over grip F, {len(fit.fits)} taps: F_surface = m y'' + b y' + k y"
    numbers = ("constant", "95 %", "per newton", "95 %", "at the middle grip", "95 %", "line? p")
    table = Table.of(title, ("quantity", "unit", *numbers), words=("quantity", "unit"))
    for line in fit.lines:
        (low, high), (slope_low, slope_high) = line.intervals
        middle, lower, upper = line.band[line.band.shape[0] // 2]
        table.add_row(
            line.quantity,
            HAND[line.quantity][1],
            f"{line.line.constant:.4g}",
            f"{low:.4g} .. {high:.4g}",
            f"{line.line.per_newton:.4g}",
            f"{slope_low:.4g} .. {slope_high:.4g}",
            f"{line.line.at(middle):.4g} at {middle:.2g} N",
            f"{lower:.4g} .. {upper:.4g}",
            f"{line.lack_of_fit_p:.2g}",
        )
    return table


def fourth_order_table(fit: "FourthOrderFit") -> Table:
    """The fourth-order hand: lines with their 95 % intervals, and the uncertainty at the middle grip."""
    title = f"fourth order (stylus - skin - hand - arm), error of the acceleration {100 * fit.unexplained:.1f} %"
    heads = ("quantity", "constant", "95 %", "per newton", "95 %", "known to")
    table = Table.of(title, heads, words=("quantity",))
    low, high = fit.intervals[0]
    known = {name: f"{100 * share:.2g} %" for name, share in fit.uncertain.items()}
    table.add_row(
        "stylus_mass_kg", f"{fit.stylus_mass_kg:.4g}", f"{low:.4g} .. {high:.4g}", "-", "-", known["stylus_mass_kg"]
    )
    for j, (name, line) in enumerate(fit.lines.items()):
        (low, high), (slope_low, slope_high) = fit.intervals[1 + 2 * j : 3 + 2 * j]
        table.add_row(
            f"hand.{name}",
            f"{line.constant:.4g}",
            f"{low:.4g} .. {high:.4g}",
            f"{line.per_newton:.4g}",
            f"{slope_low:.4g} .. {slope_high:.4g}",
            known[f"hand.{name}"],
        )
    return table
