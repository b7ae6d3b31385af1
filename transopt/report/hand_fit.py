"""How an identified hand is shown: its tables, and a figure over grip in the layout of the seed's Fig. 5."""

from matplotlib.figure import Figure

from transopt.base.plotting import DARK, LABEL_PT, OPTIMUM, SEED, SMALL_PT
from transopt.base.tables import Table
from transopt.identify.device.chain import unit_of
from transopt.identify.hand.chain import ChainFit
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


def line_table(fit: HandFit) -> Table:
    """Constants and slopes with their 95 % intervals, and how well a line describes them."""
    table = Table(title=f"hand over grip F, {len(fit.fits)} taps: F_surface = m y'' + b y' + k y")
    for heading in ("quantity", "unit"):
        table.add_column(heading)
    for heading in ("constant", "95 %", "per newton", "95 %", "at the middle grip", "95 %", "line? p"):
        table.add_column(heading, justify="right")
    for line in fit.lines:
        (low, high), (slope_low, slope_high) = line.intervals
        middle, lower, upper = line.band[line.band.shape[0] // 2]
        table.add_row(
            line.quantity,
            unit_of(line.quantity),
            f"{line.line.constant:.4g}",
            f"{low:.4g} .. {high:.4g}",
            f"{line.line.per_newton:.4g}",
            f"{slope_low:.4g} .. {slope_high:.4g}",
            f"{line.line.at(middle):.4g} at {middle:.2g} N",
            f"{lower:.4g} .. {upper:.4g}",
            f"{line.lack_of_fit_p:.2g}",
        )
    return table


def chain_table(chain: ChainFit) -> Table:
    """The fourth-order hand: lines with their 95 % intervals, and how well the middle is known."""
    title = f"fourth order (stylus - skin - hand - arm), error of the acceleration {100 * chain.unexplained:.1f} %"
    table = Table(title=title)
    table.add_column("quantity")
    for heading in ("constant", "95 %", "per newton", "95 %", "known to"):
        table.add_column(heading, justify="right")
    low, high = chain.intervals[0]
    known = {name: f"{100 * share:.2g} %" for name, share in chain.uncertain.items()}
    table.add_row(
        "stylus_mass_kg", f"{chain.stylus_mass_kg:.4g}", f"{low:.4g} .. {high:.4g}", "-", "-", known["stylus_mass_kg"]
    )
    for j, (name, line) in enumerate(chain.lines.items()):
        (low, high), (slope_low, slope_high) = chain.intervals[1 + 2 * j : 3 + 2 * j]
        table.add_row(
            f"hand.{name}",
            f"{line.constant:.4g}",
            f"{low:.4g} .. {high:.4g}",
            f"{line.per_newton:.4g}",
            f"{slope_low:.4g} .. {slope_high:.4g}",
            known[f"hand.{name}"],
        )
    return table
