"""`transopt plant fit` and `plant sweep`: a state space for a scene, from a measured response or a recorded sweep."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.layout import RateHz, layout

if TYPE_CHECKING:
    from transopt.identify.measured_response import MeasuredResponse
    from transopt.identify.response_fit import ResponseFit

COLUMNS_HELP = 'Names of the file\'s columns, in order, "-" skips one: frequency_Hz,-,real,imag.'
UNITS_HELP = "Units of columns that state none: magnitude=g/V,phase=deg."
SWEEP_COLUMNS_HELP = 'Names of the file\'s columns, in order, "-" skips one: time_s,voltage_V,acceleration_g.'
SWEEP_UNITS_HELP = "Units of columns that state none: time=s,voltage=V,acceleration=g."
ACCEPTED = "correct it; if it is right, --accept takes it"
Out = Annotated[Path, typer.Option(help="Plant file, .npz. A PNG is written beside it.")]
Band = Annotated[
    tuple[float, float] | None,
    typer.Option("--band-Hz", help="Lowest and highest frequency that count. Default: all."),
]
DelayS = Annotated[
    float,
    typer.Option("--delay-s", help="Pure delay in the response, taken out; a scene has it as amplifier.delay_s."),
]
Resonance = Annotated[
    float | None, typer.Option("--resonance-Hz", help="Resonance by the datasheet: a contradiction is named.")
]
RatedG = Annotated[
    float | None, typer.Option("--rms-g", help="Acceleration by the datasheet at --rms-V or --rms-A, rms, in g.")
]
RatedV = Annotated[
    float | None, typer.Option("--rms-V", help="Voltage of the datasheet's sine at the resonance, rms.")
]
RatedA = Annotated[float | None, typer.Option("--rms-A", help="Current of that sine, in its place.")]
Accept = Annotated[bool, typer.Option("--accept", help="Take a response as it is, even one that no actuator has.")]


def plant_fit(
    response: Annotated[
        Path, typer.Argument(help="Acceleration over input: CSV, NPZ, MAT, or a universal file (dataset 58).")
    ],
    order: Annotated[int, typer.Option(help="Number of states: two for each resonance, one for a coil's L / R.")],
    out: Out,
    driven_by: Annotated[
        str | None,
        typer.Option("--input", help="What the response is to: current or voltage. Default: the file's, or current."),
    ] = None,
    band_Hz: Band = None,
    delay_s: DelayS = 0.0,
    scale: Annotated[float, typer.Option(help="What makes m/s^2 per A or V of the file's numbers.")] = 1.0,
    columns: Annotated[str, typer.Option(help=COLUMNS_HELP)] = "",
    units: Annotated[str, typer.Option(help=UNITS_HELP)] = "",
    resonance_Hz: Resonance = None,
    rms_V: RatedV = None,
    rms_A: RatedA = None,
    rms_g: RatedG = None,
    accept: Accept = False,
    channel: Annotated[
        int | None,
        typer.Option(metavar="<int>", help="Which response of a universal file with several, counted from 1.", min=1),
    ] = None,
) -> None:
    """Fit a stable real state space to a measured response, say how far off it is, and write it if it may be used.

    Exit 1: the fit is not fit to design with; no plant is written.
    """
    import numpy as np

    from transopt.cli.questions import answered
    from transopt.files.unclear import Answer
    from transopt.identify.measured_response import WORDS, MeasuredResponse, read_response
    from transopt.identify.response_fit import fit_response
    from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT

    inputs = {each.name: each for each in (CURRENT_INPUT, VOLTAGE_INPUT)}
    _check_options(driven_by, out, delay_s)

    def read(answer: Answer) -> MeasuredResponse:
        how = layout(columns, units, answer=answer if channel is None else {"channel": channel, **answer})
        return read_response(response, how, scale=scale, driven_by=driven_by or "")

    measured = answered(read, WORDS, summary, units=units)
    driven_by = measured.driven_by or CURRENT_INPUT.name
    f = measured.frequencies_Hz
    undelayed = measured.response * np.exp(2j * np.pi * f * delay_s)
    fit = fit_response(f, undelayed, order, inputs[driven_by], band_Hz)
    wrong = _implausible(fit, resonance_Hz, rms_g, rms_V if driven_by == "voltage" else rms_A)
    _refuse(response, wrong or _turned(fit, measured.turned) or _late(fit, delay_s), accept=accept)
    _say_and_save(fit, f"{order} states to {fit.frequencies_Hz.size} points", measured.notes, out, delay_s)


def plant_sweep(
    sweep: Annotated[
        Path, typer.Argument(help="Time, voltage or current, and acceleration of one sweep: any file of a recording.")
    ],
    out: Out,
    order: Annotated[
        int | None, typer.Option(help="Number of states. Default: the least that follows the record.")
    ] = None,
    driven_by: Annotated[
        str | None,
        typer.Option("--input", help="What drives the plant: voltage or current. Default: the voltage if recorded."),
    ] = None,
    band_Hz: Band = None,
    delay_s: DelayS = 0.0,
    columns: Annotated[str, typer.Option(help=SWEEP_COLUMNS_HELP)] = "",
    units: Annotated[str, typer.Option(help=SWEEP_UNITS_HELP)] = "",
    rate_Hz: RateHz = None,
    resonance_Hz: Resonance = None,
    rms_V: RatedV = None,
    rms_A: RatedA = None,
    rms_g: RatedG = None,
    accept: Accept = False,
) -> None:
    """Make a state space of a recorded sweep, of a sine or of noise, and write it if it may be used.

    Exit 1: the fit is not fit to design with; no plant is written.
    """
    from transopt.cli.questions import measurements
    from transopt.identify.sweep_fit import fit_sweep

    _check_options(driven_by, out, delay_s)
    (measured,) = measurements([sweep], columns, units, rate_Hz)
    swept = fit_sweep(measured, order, driven_by or "", band_Hz, delay_s)
    fit = swept.fit
    by_voltage = fit.plant.driven_by.unit == "V"
    wrong = _implausible(fit, resonance_Hz, rms_g, rms_V if by_voltage else rms_A)
    _refuse(sweep, wrong or _late(fit, delay_s), accept=accept)
    made_of = f"{fit.plant.order} states to {swept.answered} of {swept.bands} bands of the sweep"
    _say_and_save(fit, made_of, swept.notes, out, delay_s, f"+-{100 * swept.unsure:.2g} % by the record's noise")


def _check_options(driven_by: str | None, out: Path, delay_s: float) -> None:
    from transopt.base.sizes import LONGEST_DELAY_S

    if driven_by not in (None, "current", "voltage"):
        raise InputError(f"--input {driven_by}: unknown; choose current, voltage")
    if out.suffix.lower() != ".npz":
        raise InputError(f"--out {out}: a plant file that is written ends in .npz")
    if not 0 <= delay_s <= LONGEST_DELAY_S:
        raise InputError(f"--delay-s {delay_s:g}: must be 0 to {LONGEST_DELAY_S:g} s")
    terminal.make_folder(out.parent)


def _implausible(fit: "ResponseFit", resonance_Hz: float | None, rms_g: float | None, rms_input: float | None) -> str:
    """Why no actuator has this response, or how it contradicts the data sheet; empty if neither."""
    import numpy as np

    from transopt.base.signals import STANDARD_GRAVITY_M_S2
    from transopt.scene.plausible_response import against_sheet, implausible_response

    unit = fit.plant.driven_by.unit
    found = [each for each, _ in fit.resonances()]
    wrong = implausible_response(fit.frequencies_Hz, fit.measured, found, unit)
    if not wrong and resonance_Hz and found:
        nearest = min(found, key=lambda each: abs(np.log(each / resonance_Hz)))
        wrong = against_sheet(nearest, resonance_Hz, "resonance", "Hz")
        if not wrong:
            off = f"{100 * (nearest / resonance_Hz - 1):+.2g} %"
            terminal.console().print(f"by the sheet {resonance_Hz:g} Hz; measured {nearest:.4g} Hz, {off}")
    if not wrong and rms_g:
        if not rms_input:
            raise InputError(f"--rms-g {rms_g:g}: at which sine? state --rms-{unit} as well")
        at_Hz = np.array([resonance_Hz or fit.frequencies_Hz[np.abs(fit.measured).argmax()]])
        gain = abs(fit.plant.response(at_Hz)[0]) / STANDARD_GRAVITY_M_S2
        wrong = against_sheet(gain, rms_g / rms_input, f"response at {at_Hz[0]:.4g} Hz", f"g/{unit}")
    return wrong


def _turned(fit: "ResponseFit", turned_by: str) -> str:
    """What to state where a fit may not be used and one to the response of the other sign of the phase may."""
    from transopt.identify.response_fit import fit_response

    if fit.fit_to_design_with:
        return ""
    other = fit_response(fit.frequencies_Hz, fit.measured.conj(), fit.plant.order, fit.plant.driven_by)
    if not other.fit_to_design_with:
        return ""
    misfits = f"{100 * fit.misfit:.2g} %, {100 * other.misfit:.2g} % with it turned"
    return f"the phase has the other sign: misfit {misfits}; next: {turned_by}"


def _late(fit: "ResponseFit", delay_s: float) -> str:
    """What to state where the fit spends states on a dead time beyond the stated one; empty where it does not."""
    from transopt.identify.dead_time import dead_time

    found = dead_time(fit)
    if found is None:
        return ""
    return (
        f"the response is late by a dead time of {1e3 * found.delay_s:.3g} ms, which the fit's {fit.plant.order} "
        f"states imitate: --delay-s {delay_s + found.delay_s:.3g} --order {found.order} takes it out"
    )


def _refuse(source: Path, wrong: str, *, accept: bool) -> None:
    """Refuse a response for what is wrong with it, unless that is accepted."""
    if wrong and not accept:
        raise InputError(f"{source}: {wrong}; {ACCEPTED}")
    if wrong:
        terminal.console().print(f"accepted as it is: {wrong}", style="yellow")


def _say_and_save(
    fit: "ResponseFit", states: str, notes: Sequence[str], out: Path, delay_s: float, sure: str = ""
) -> None:
    """Print what was found, draw it, and write the plant if it may be used."""
    import numpy as np

    from transopt.base.plotting import save_figure
    from transopt.base.writing import percent
    from transopt.report.fits import response_figure
    from transopt.scene.plant_file import save_plant

    console = terminal.console()

    def line(text: str, style: str | None = None) -> None:
        console.print(text, style=style)

    picture = out.with_name(f"{out.stem}.png")
    save_figure(response_figure(fit), picture)
    for note in notes:
        line(note, "yellow")
    line(f"{states}, {fit.frequencies_Hz[0]:.4g} to {fit.frequencies_Hz[-1]:.4g} Hz")
    pairs = ", ".join(f"{at:.4g} Hz (Q {quality:.3g})" for at, quality in fit.resonances())
    line(f"resonances: {pairs or 'none'}")
    line(
        "no acceleration under a constant input, as of what a spring holds"
        if fit.at_rest
        else f"{abs(fit.plant.response(np.zeros(1))[0]):.3g} m/s^2 per {fit.plant.driven_by.unit} under a constant "
        "input, where nothing was measured"
    )
    worst = f"at most {percent(fit.worst)} % of the largest response, at {fit.worst_Hz:.4g} Hz"
    if fit.worst == 0:
        worst = "nowhere more than the noise"
    line(f"misfit {percent(fit.misfit)} % (rms), {worst}" + (f"; {sure}" if sure else ""))
    if not fit.fit_to_design_with:
        line(f"{picture}; {out} is not written")
        line(f"not fit to design with: {unfit_advice(fit.misfit, fit.plant.order)}", "red")
        raise typer.Exit(1)
    save_plant(fit.plant, out)
    line(f"{out}, {picture.name}")
    stated = f'[model] with kind = "state_space" and file = "{out.name}"'
    delayed = f", and amplifier.delay_s = {delay_s:g}" if delay_s else ""
    line(f"fit to design with; next, in a scene: {stated}{delayed}")


def summary(found: "MeasuredResponse") -> str:
    """What was read, in a few words."""
    f = found.frequencies_Hz
    peak = abs(found.response).max()
    return f"{f.size} points, {f[0]:.4g} to {f[-1]:.4g} Hz, at most {peak:.3g} m/s^2 per A or V"


def unfit_advice(misfit: float, order: int) -> str:
    """Why a fit may not be used, and what to do."""
    from transopt.identify.response_fit import HIGHEST_ORDER, MOST_MISFIT

    more = min(order + 2, HIGHEST_ORDER)
    return (
        f"misfit {100 * misfit:.2g} %, at most {100 * MOST_MISFIT:g} %; next: look at the figure, then --order "
        f"{more} for a resonance more, --delay-s for a phase that falls in proportion to frequency, or a narrower "
        "--band-Hz"
    )
