"""The hand over grip: a point per tap, lines with their bands (layout of the seed's Fig. 5)."""

from matplotlib.figure import Figure

from transopt.base.plotting import DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT
from transopt.identify.hand.lines import GripLine, HandFit
from transopt.plant.second_order import SEED_HAND_DAMPING_N_S_M, SEED_HAND_MASS_KG, SEED_HAND_STIFFNESS_N_M

_PANELS = (
    ("mass [kg]", SEED_HAND_MASS_KG),
    ("damping [N s/m]", SEED_HAND_DAMPING_N_S_M),
    ("stiffness [N/m]", SEED_HAND_STIFFNESS_N_M),
)


def hand_figure(fit: HandFit) -> Figure:
    """Three panels: mass, damping and stiffness of each tap over grip, the line, its 95 % band, the seed's line."""
    figure = Figure(figsize=(9.0, 3.1), layout="constrained")
    for axes, line, (label, seed) in zip(figure.subplots(1, 3), fit.lines, _PANELS, strict=True):
        grip, lower, upper = line.band.T
        axes.fill_between(grip, lower, upper, color=OPTIMUM, alpha=0.25, lw=0, label="95 %")
        axes.plot(fit.grips_N, line.at_taps, ".", color=DARK, ms=4, alpha=0.6, label="tap")
        axes.plot(grip, [line.line.at(g) for g in grip], color=OPTIMUM, lw=1.5, label="line")
        axes.plot(grip, [seed.at(g) for g in grip], "--", color=SEED, lw=1.0, label="seed")
        axes.set_title(equation(line), fontsize=SMALL_PT)
        axes.set_xlabel("grip force [N]", fontsize=LABEL_PT)
        axes.set_ylabel(label, fontsize=LABEL_PT)
        axes.set_ylim(bottom=min(0.0, float(lower.min())))
        axes.tick_params(labelsize=SMALL_PT)
        axes.grid(alpha=0.25)
    figure.axes[0].legend(fontsize=SMALL_PT, frameon=False)
    return figure


def equation(line: GripLine) -> str:
    """The line in the form of the seed's Eqs. 3-5."""
    symbol = {"mass_kg": "m", "damping_N_s_m": "b", "stiffness_N_m": "k"}[line.quantity]
    sign = "-" if line.line.per_newton < 0 else "+"
    return f"${symbol} = {line.line.constant:.4g} {sign} {abs(line.line.per_newton):.3g}\\,F$"
