"""Figure of a state space fitted to a measured frequency response."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MultipleLocator, NullFormatter

from transopt.base.plotting import LABEL_PT, OPTIMUM, SEED, SMALL_PT, plain, style
from transopt.identify.response_fit import ResponseFit

POINTS = 800
FALLS_TO = 1e-6  # of the largest magnitude: the logarithm of nothing has no place


def response_figure(fit: ResponseFit) -> Figure:
    """Magnitude and phase over frequency: dots as measured, a line as fitted."""
    f = fit.frequencies_Hz
    fine = np.geomspace(f[0], f[-1], POINTS)
    figure = Figure(figsize=(5.6, 5.2), layout="constrained")
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    unit = fit.plant.driven_by.unit
    at = np.concatenate([f, fine])
    order = np.argsort(at, kind="stable")
    # One unwrapping of both, so that no whole turn is between them.
    turned = np.empty(at.size)
    turned[order] = np.unwrap(np.angle(fit.plant.response(at))[order])
    off = np.angle(fit.measured / fit.plant.response(f))
    least = FALLS_TO * np.abs(fit.measured).max()
    said = f"fitted, {fit.plant.order} states, misfit {100 * fit.misfit:.2g} %"
    magnitude.loglog(f, np.maximum(np.abs(fit.measured), least), ".", color=SEED, markersize=3, label="measured")
    fitted = np.maximum(np.abs(fit.plant.response(fine)), least)
    magnitude.loglog(fine, fitted, color=OPTIMUM, linewidth=1.2, label=said)
    phase.semilogx(f, np.degrees(turned[: f.size] + off), ".", color=SEED, markersize=3)
    phase.semilogx(fine, np.degrees(turned[f.size :]), color=OPTIMUM, linewidth=1.2)
    magnitude.set_ylabel(f"acceleration [m/s$^2$ per {unit}]", fontsize=LABEL_PT)
    phase.set_ylabel("phase [deg]", fontsize=LABEL_PT)
    phase.set_xlabel("frequency [Hz]", fontsize=LABEL_PT)
    phase.yaxis.set_major_locator(MultipleLocator(90))
    phase.xaxis.set_major_formatter(FuncFormatter(plain))
    phase.xaxis.set_minor_formatter(NullFormatter())
    for axes in (magnitude, phase):
        style(axes)
    magnitude.legend(fontsize=SMALL_PT, frameon=False)
    return figure
