"""`transopt plant fit`: from a measured frequency response to a state space that a scene can name."""

from pathlib import Path
from typing import Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.layout import layout

COLUMNS_HELP = 'Names of the file\'s columns, in order, "-" skips one: frequency_Hz,magnitude_dB,phase_deg.'
UNITS_HELP = "Units of columns that state none: magnitude=g/V,phase=deg."


def plant_fit(
    response: Annotated[
        Path, typer.Argument(help="Acceleration over input: CSV, NPZ, MAT, or a universal file (dataset 58).")
    ],
    order: Annotated[int, typer.Option(help="Number of states: two for each resonance, one for a coil's L / R.")],
    out: Annotated[Path, typer.Option(help="Plant file, .npz. A PNG is written beside it.")],
    driven_by: Annotated[
        str | None,
        typer.Option("--input", help="What the response is to: current or voltage. Default: the file's, or current."),
    ] = None,
    band_Hz: Annotated[
        tuple[float, float] | None,
        typer.Option("--band-Hz", help="Lowest and highest frequency that count. Default: all."),
    ] = None,
    delay_s: Annotated[
        float,
        typer.Option("--delay-s", help="Pure delay in the response, taken out; a scene has it as amplifier.delay_s."),
    ] = 0.0,
    scale: Annotated[float, typer.Option(help="What makes m/s^2 per A or V of the file's numbers.")] = 1.0,
    columns: Annotated[str, typer.Option(help=COLUMNS_HELP)] = "",
    units: Annotated[str, typer.Option(help=UNITS_HELP)] = "",
) -> None:
    """Fit a stable real state space to a measured response, say how far off it is, and write it if it may be used.

    Exit 1: the fit is not fit to design with; no plant is written.
    """
    import numpy as np

    from transopt.base.plotting import save_figure
    from transopt.base.sizes import LONGEST_DELAY_S
    from transopt.identify.response_fit import fit_response
    from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT
    from transopt.recordings.response import read_response
    from transopt.report.response_fit import response_figure
    from transopt.scene.plant_file import save_plant

    console = terminal.console()
    inputs = {each.name: each for each in (CURRENT_INPUT, VOLTAGE_INPUT)}
    if driven_by is not None and driven_by not in inputs:
        raise InputError(f"--input {driven_by}: unknown; choose {', '.join(inputs)}")
    if out.suffix.lower() != ".npz":
        raise InputError(f"--out {out}: a plant file that is written ends in .npz")
    if not 0 <= delay_s <= LONGEST_DELAY_S:
        raise InputError(f"--delay-s {delay_s:g}: must be 0 to {LONGEST_DELAY_S:g} s")
    terminal.make_folder(out.parent)
    measured = read_response(response, layout(columns, units), scale=scale, driven_by=driven_by or "")
    driven_by = measured.driven_by or CURRENT_INPUT.name
    f = measured.frequencies_Hz
    undelayed = measured.response * np.exp(2j * np.pi * f * delay_s)
    fit = fit_response(f, undelayed, order, inputs[driven_by], band_Hz)
    picture = out.with_name(f"{out.stem}.png")
    save_figure(response_figure(fit), picture)

    def line(text: str, style: str | None = None) -> None:
        console.print(text, style=style, highlight=False, soft_wrap=True)

    band = f"{fit.frequencies_Hz[0]:.4g} to {fit.frequencies_Hz[-1]:.4g} Hz"
    for note in measured.notes:
        line(note, "yellow")
    line(f"{order} states to {fit.frequencies_Hz.size} points, {band}")
    pairs = ", ".join(f"{at:.4g} Hz (Q {quality:.3g})" for at, quality in fit.resonances())
    line(f"resonances: {pairs or 'none'}")
    line(
        "no acceleration under a constant input, as of what a spring holds"
        if fit.at_rest
        else f"{abs(fit.plant.response(np.zeros(1))[0]):.3g} m/s^2 per {fit.plant.driven_by.unit} under a constant "
        "input, where nothing was measured"
    )
    misfit = f"misfit {100 * fit.misfit:.2g} % (rms), at most {100 * fit.worst:.2g} % of the largest response, "
    line(f"{misfit}at {fit.worst_Hz:.4g} Hz")
    if not fit.fit_to_design_with:
        line(f"{picture}; {out} is not written")
        line(f"not fit to design with: {unfit_advice(fit.misfit, order)}", "red")
        raise typer.Exit(1)
    save_plant(fit.plant, out)
    line(f"{out}, {picture.name}")
    line(f'fit to design with; next, in a scene: [model] with kind = "state_space" and file = "{out.name}"')


def unfit_advice(misfit: float, order: int) -> str:
    """Why a fit may not be used, and what to do."""
    from transopt.identify.response_fit import HIGHEST_ORDER, MOST_MISFIT

    more = min(order + 2, HIGHEST_ORDER)
    return (
        f"misfit {100 * misfit:.2g} %, at most {100 * MOST_MISFIT:g} %; next: look at the figure, then --order "
        f"{more} for a resonance more, --delay-s for a phase that falls in proportion to frequency, or a narrower "
        "--band-Hz"
    )
