"""How an identified coil is shown: its values, and the heating record with what the model makes of it."""

import numpy as np
from matplotlib.figure import Figure

from transopt.base.plotting import CLIPPED, DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT
from transopt.base.tables import Table
from transopt.identify.coil import NAMES, CoilFit

_MOST_POINTS = 4000
UNITS = {"R_wh_K_W": "K/W", "R_ha_K_W": "K/W", "tau_w_s": "s", "tau_h_s": "s"}
MEANING = {
    "R_wh_K_W": "winding over housing",
    "R_ha_K_W": "housing over ambient",
    "tau_w_s": "winding",
    "tau_h_s": "housing",
}


def coil_figure(fit: CoilFit) -> Figure:
    """Recorded and modelled temperatures over time, their difference, and the current."""
    record = fit.record
    rows = np.arange(fit.winding_C.size)
    minutes = rows * record.dt_s / 60
    thin = slice(None, None, max(1, rows.size // _MOST_POINTS))
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
        axes.tick_params(labelsize=SMALL_PT)
        axes.grid(alpha=0.25)
    below.set_xlabel("time [min]", fontsize=LABEL_PT)
    above.legend(fontsize=SMALL_PT, frameon=False, markerscale=4)
    return figure


def value_table(fit: CoilFit) -> Table:
    """Values with their 95 % intervals."""
    table = Table(title=f"coil of {fit.record.R_ohm:g} ohm at 25 C")
    for heading in ("quantity", "of"):
        table.add_column(heading)
    for heading in ("value", "95 %"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    for name, (low, high) in zip(NAMES, fit.intervals, strict=True):
        table.add_row(name, MEANING[name], f"{getattr(fit.coil, name):.4g}", f"{low:.4g} .. {high:.4g}", UNITS[name])
    return table


def noise_line(fit: CoilFit) -> str:
    """Which temperatures were fitted, and how near the model comes to them."""
    channels = "the winding" if fit.record.housing is None else "winding and housing"
    noise = f"noise of the winding {fit.record.winding.noise_K:.2g} K, residuals {fit.misfit:.2f} times the noise"
    return f"from {channels}, {noise}"
