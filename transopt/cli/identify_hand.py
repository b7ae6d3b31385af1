"""`transopt identify hand`: taps on a real surface in, the hand over grip out."""

from pathlib import Path
from typing import Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.identified_file import check_place, finish, tell
from transopt.cli.layout import COLUMNS_HELP, UNITS_HELP, RateHz


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
    rate_Hz: RateHz = None,
) -> None:
    """Mass, damping and stiffness of the hand over grip from taps.

    Exit 1: what was found is not fit to design with.
    """
    from pydantic import ValidationError

    from transopt.base.plotting import save_figure
    from transopt.cli.questions import measurements
    from transopt.identify.hand.chain import fit_chain, hand_part
    from transopt.identify.hand.lines import fit_hand
    from transopt.identify.hand.tap import usable_taps
    from transopt.identify.measurement import split_taps
    from transopt.report import hand_fit
    from transopt.scene.fitted import complaint
    from transopt.scene.model_file import save_part

    if not 0.01 <= window <= 0.1:
        raise InputError(f"--window {window:g} s: must be 0.01 to 0.1 s")
    check_place(out)
    runs = split_taps(measurements(files, columns, units, rate_Hz), tap or ())
    with terminal.progress() as bar:
        bar.add_task("fitting", total=None)
        taps, left_out = usable_taps(runs, window)
        fit = fit_hand(taps)
        chain = fit_chain(taps, fit)
    tell(hand_fit.line_table(fit), hand_fit.chain_table(chain))
    tell(*(f"{one.name}: {one.note}" for one in taps if one.note))
    tell(*(f"left out: {line}" for line in left_out), style="yellow")
    tell(f"fourth order: {chain.word()}")
    figure = out.with_name(f"{out.stem}_hand.png")
    save_figure(hand_fit.hand_figure(fit), figure)
    used = {tap.name for tap in taps}
    try:
        part = hand_part(fit, chain, [run for run in runs if run.name in used])
    except ValidationError as error:
        tell(figure.name)
        short = [complaint(error), *fit.shortfalls(), *(chain.shortfalls() if chain.is_better else ())]
        tell(f"hand: {out} is not written: {'; '.join(short)}", style="red")
        raise typer.Exit(1) from None
    save_part(out, "hand", part)
    finish(out, figure, "hand", part)
