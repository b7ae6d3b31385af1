"""`transopt identify hand`: taps on a real surface in, the hand over grip out."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.identified_file import check_place, next_step
from transopt.cli.layout import COLUMNS_HELP, UNITS_HELP, layout

if TYPE_CHECKING:
    from rich.table import Table

    from transopt.identify.hand.chain import ChainFit
    from transopt.identify.hand.lines import HandFit
    from transopt.identify.measurement import Measurement
    from transopt.scene.model_parts import HandPart

UNITS = {"mass_kg": "kg", "damping_N_s_m": "N s/m", "stiffness_N_m": "N/m"}


def identify_hand(
    files: Annotated[
        list[Path], typer.Argument(help="Taps with force_N, acceleration_m_s2 and grip_N: CSV, NPZ or MAT.")
    ],
    out: Annotated[Path, typer.Option(help="Model file; its other parts stay.")],
    window: Annotated[float, typer.Option(help="From contact on, in s; the hand answers after 0.03.")] = 0.03,
    tap: Annotated[
        list[int] | None, typer.Option(help="Which tap of files with several, counted from 1; may be repeated.")
    ] = None,
    columns: Annotated[str, typer.Option(help=COLUMNS_HELP)] = "",
    units: Annotated[str, typer.Option(help=UNITS_HELP)] = "",
) -> None:
    """Mass, damping and stiffness of the hand over grip from taps.

    Exit 1: what was found is not fit to design with.
    """
    from pydantic import ValidationError

    from transopt.base.plotting import save_figure
    from transopt.identify.hand.chain import fit_chain
    from transopt.identify.hand.lines import fit_hand
    from transopt.identify.hand.tap import usable_taps
    from transopt.identify.measurement import load_measurements, split_taps
    from transopt.report.hand_fit import hand_figure
    from transopt.scene.fitted import complaint
    from transopt.scene.model_file import save_part

    if not 0.01 <= window <= 0.1:
        raise InputError(f"--window {window:g} s: must be 0.01 to 0.1 s")
    check_place(out)
    with terminal.console().status("fitting"):
        runs = split_taps(load_measurements(files, layout(columns, units)), tap or ())
        taps, left_out = usable_taps(runs, window)
        fit = fit_hand(taps)
        chain = fit_chain(taps, fit)
    short = fit.shortfalls()

    console = terminal.console()
    console.print(line_table(fit))
    console.print(chain_table(chain))
    for one in taps:
        if one.note:
            console.print(f"{one.name}: {one.note}", highlight=False, soft_wrap=True)
    for line in left_out:
        console.print(f"left out: {line}", style="yellow", highlight=False, soft_wrap=True)
    console.print(f"fourth order: {chain.word()}", highlight=False, soft_wrap=True)
    figure = out.with_name(f"{out.stem}_hand.png")
    save_figure(hand_figure(fit), figure)
    used = {tap.name for tap in taps}
    try:
        part = hand_part(fit, chain, [run for run in runs if run.name in used])
    except ValidationError as error:
        console.print(f"{figure.name}", highlight=False, soft_wrap=True)
        text = f"hand: {out} is not written: {complaint(error)}; {'; '.join(short)}"
        console.print(text, style="red", highlight=False, soft_wrap=True)
        raise typer.Exit(1) from None
    save_part(out, "hand", part)
    console.print(f"{out}, {figure.name}", highlight=False, soft_wrap=True)
    console.print(f"hand: {part.verdict}", style="red" if short else None, highlight=False, soft_wrap=True)
    if short:
        raise typer.Exit(1)
    console.print(next_step(out), highlight=False, soft_wrap=True)


def verdict(fit: "HandFit") -> str:
    """In plain words: what the model may be used for, or why not."""
    short = fit.shortfalls()
    if short:
        return f"not to be relied upon: {'; '.join(short)}"
    return (
        f"supports designs with a second_order hand from {fit.grips_N.min():.2g} to {fit.grips_N.max():.2g} N: mass, "
        f"damping and stiffness follow grip as lines, {100 * fit.unexplained:.1f} % of the surface force is left "
        f"unexplained ({len(fit.fits)} taps)"
    )


def hand_part(fit: "HandFit", chain: "ChainFit", runs: "Sequence[Measurement]") -> "HandPart":
    """What the model file states.

    Raises
    ------
    pydantic.ValidationError : no passive hand.
    """
    from transopt.identify.hand.lines import COEFFICIENTS, grip_groups
    from transopt.scene.fitted import Source
    from transopt.scene.model_parts import HandPart

    grips = [float(fit.grips_N[group].mean()) for group in grip_groups(fit.grips_N)]
    grips[0], grips[-1] = float(fit.grips_N.min()), float(fit.grips_N.max())
    bounds = [pair for line in fit.lines for pair in line.intervals.tolist()]
    lines = {line.quantity: _line(line.line.constant, line.line.per_newton) for line in fit.lines}
    return HandPart.model_validate(
        {
            **lines,
            "intervals": dict(zip(COEFFICIENTS, bounds, strict=True)),
            "parameters": list(COEFFICIENTS),
            "covariance": fit.covariance.tolist(),
            "grips_N": grips,
            "verdict": verdict(fit),
            "shortfalls": fit.shortfalls(),
            # A file with several taps is one source.
            "sources": [
                Source(file=source, sha256=sha256).model_dump()
                for source, sha256 in dict.fromkeys((run.source, run.sha256) for run in runs)
            ],
            "fourth_order": chain_content(chain),
        }
    )


def chain_content(chain: "ChainFit") -> dict[str, object]:
    """The fourth-order hand as the model file keeps it."""
    from transopt.identify.hand.chain import NAMES

    return {
        "stylus_mass_kg": chain.stylus_mass_kg,
        "hand": {name: _line(line.constant, line.per_newton) for name, line in chain.lines.items()},
        "intervals": dict(zip(NAMES, chain.intervals.tolist(), strict=True)),
        "parameters": list(NAMES),
        "covariance": chain.covariance.tolist(),
        "undetermined": chain.undetermined,
        "nrmse": chain.unexplained,
        "verdict": chain.word(),
    }


def _line(constant: float, per_newton: float) -> dict[str, float]:
    return {"constant": constant, "per_newton": per_newton}


def line_table(fit: "HandFit") -> "Table":
    """Constants and slopes with their 95 % intervals, and how well a line describes them."""
    from rich.table import Table

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
            UNITS[line.quantity],
            f"{line.line.constant:.4g}",
            f"{low:.4g} .. {high:.4g}",
            f"{line.line.per_newton:.4g}",
            f"{slope_low:.4g} .. {slope_high:.4g}",
            f"{line.line.at(middle):.4g} at {middle:.2g} N",
            f"{lower:.4g} .. {upper:.4g}",
            f"{line.lack_of_fit_p:.2g}",
        )
    return table


def chain_table(chain: "ChainFit") -> "Table":
    """The fourth-order hand: lines with their 95 % intervals, and how well the middle is known."""
    from rich.table import Table

    title = f"fourth order (stylus - skin - hand - arm), NRMSE of the acceleration {100 * chain.unexplained:.1f} %"
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
