"""`transopt identify amplifier`: sweeps in, pole, delay and crossover out."""

from pathlib import Path
from typing import Annotated

import typer

from transopt.base import terminal
from transopt.cli.identified_file import check_place, finish, tell
from transopt.cli.layout import COLUMNS_HELP, UNITS_HELP, RateHz


def identify_amplifier(
    files: Annotated[list[Path], typer.Argument(help="Sweeps with command_A and current_A: CSV, NPZ or MAT.")],
    out: Annotated[Path, typer.Option(help="Model file; its other parts stay.")],
    columns: Annotated[str, typer.Option(help=COLUMNS_HELP)] = "",
    units: Annotated[str, typer.Option(help=UNITS_HELP)] = "",
    rate_Hz: RateHz = None,
) -> None:
    """Pole and delay of the current amplifier from swept sines.

    Exit 1: what was found is not fit to design with.
    """
    from transopt.base.plotting import save_figure
    from transopt.cli.questions import measurements
    from transopt.identify.amplifier import fit_amplifier, trials_of
    from transopt.report import amplifier_fit
    from transopt.scene.model_file import save_part

    check_place(out)
    runs = measurements(files, columns, units, rate_Hz)
    with terminal.progress() as bar:
        bar.add_task("fitting", total=None)
        trials, findings = trials_of(runs)
        fit = fit_amplifier(trials)
    part = fit.part(runs)
    figure = out.with_name(f"{out.stem}_amplifier.png")
    save_part(out, "amplifier", part)
    save_figure(amplifier_fit.amplifier_figure(fit), figure)
    tell(amplifier_fit.trial_table(fit, trials), amplifier_fit.value_table(fit))
    tell(*map(str, findings), style="yellow")
    tell(amplifier_fit.crossover_line(fit))
    finish(out, figure, "amplifier", part)
