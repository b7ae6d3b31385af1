"""`transopt identify amplifier`: sweeps in, pole, delay and crossover out."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.cli.identified_file import check_place, next_step
from transopt.cli.layout import COLUMNS_HELP, UNITS_HELP, layout

if TYPE_CHECKING:
    from rich.table import Table

    from transopt.identify.amplifier import AmplifierFit
    from transopt.identify.checks import Finding
    from transopt.identify.measurement import Measurement
    from transopt.identify.spectrum import Trial
    from transopt.scene.model_parts import AmplifierPart


def identify_amplifier(
    files: Annotated[list[Path], typer.Argument(help="Sweeps with command_A and current_A: CSV, NPZ or MAT.")],
    out: Annotated[Path, typer.Option(help="Model file; its other parts stay.")],
    columns: Annotated[str, typer.Option(help=COLUMNS_HELP)] = "",
    units: Annotated[str, typer.Option(help=UNITS_HELP)] = "",
) -> None:
    """Pole and delay of the current amplifier from swept sines.

    Exit 1: what was found is not fit to design with.
    """
    from transopt.base.plotting import save_figure
    from transopt.identify.amplifier import fit_amplifier
    from transopt.identify.measurement import load_measurements
    from transopt.report.amplifier_fit import amplifier_figure
    from transopt.scene.model_file import save_part

    check_place(out)
    with terminal.console().status("fitting"):
        runs = load_measurements(files, layout(columns, units))
        trials, findings = prepare(runs)
        fit = fit_amplifier(trials)
    part = amplifier_part(fit, runs)
    figure = out.with_name(f"{out.stem}_amplifier.png")
    save_part(out, "amplifier", part)
    save_figure(amplifier_figure(fit), figure)
    console = terminal.console()
    console.print(trial_table(fit, trials))
    console.print(value_table(fit))
    for finding in findings:
        console.print(str(finding), style="yellow", highlight=False, soft_wrap=True)
    console.print(crossover_line(fit), highlight=False, soft_wrap=True)
    console.print(f"{out}, {figure.name}", highlight=False, soft_wrap=True)
    short = fit.shortcomings()
    console.print(f"amplifier: {part.verdict}", style="red" if short else None, highlight=False, soft_wrap=True)
    if short:
        raise typer.Exit(1)
    console.print(next_step(out), highlight=False, soft_wrap=True)


def prepare(runs: "Sequence[Measurement]") -> "tuple[list[Trial], list[Finding]]":
    """Trials from command to current, and what is wrong with them that is not fatal.

    Raises
    ------
    InputError : a finding that is.
    """
    from transopt.identify import checks
    from transopt.identify.amplifier import check_alike
    from transopt.identify.spectrum import Trial, estimate_transfer

    signals = [(run, run.require("command", "command_A"), run.require("current", "current_A")) for run in runs]
    findings = checks.refuse(
        finding for run in runs for finding in checks.check_measurement(run, ("command", "current"))
    )
    trials = [Trial(run.name, command, current) for run, command, current in signals]
    checks.refuse(checks.check_rates(trials))
    # Each by itself, so that the message names the file.
    each = [estimate_transfer([trial]) for trial in trials]
    checks.refuse(check_alike([trial.name for trial in trials], each))
    for trial, alone in zip(trials, each, strict=True):
        checks.refuse(
            checks.check_sign(
                trial.name,
                alone,
                "from command to current",
                "swap the leads of the current sensor or correct its sign, and record again",
            )
        )
    together = estimate_transfer(trials)
    low_Hz = float(together.frequencies_Hz[0])
    findings += checks.refuse(checks.check_cycles("all files", trials, together, low_Hz))
    findings += checks.low_coherence("all files", together)
    return trials, findings


def amplifier_part(fit: "AmplifierFit", runs: "Sequence[Measurement]") -> "AmplifierPart":
    """What the model file states."""
    from transopt.scene.fitted import Source
    from transopt.scene.model_parts import AmplifierPart

    low, high = fit.intervals["delay_s"]
    half_s = 0.5 * fit.dt_s
    return AmplifierPart(
        pole_Hz=fit.pole_Hz,
        delay_s=fit.delay_s,
        delay_with_hold_s=fit.delay_with_hold_s,
        gain=fit.gain,
        intervals={**fit.intervals, "delay_with_hold_s": (low + half_s, high + half_s)},
        parameters=["pole_Hz", "delay_s"],
        covariance=fit.covariance[:2, :2].tolist(),
        verdict=fit.verdict(),
        shortfalls=fit.shortcomings(),
        sources=[Source(file=run.source, sha256=run.sha256) for run in runs],
    )


def trial_table(fit: "AmplifierFit", trials: "Sequence[Trial]") -> "Table":
    """What each file played, and the gain that a linear model sees in it."""
    import numpy as np
    from rich.table import Table

    table = Table(title="trials, command to current")
    table.add_column("file")
    for heading in ("length [s]", "rate [Hz]", "peak [A]", "middle [A]", "gain with crossover"):
        table.add_column(heading, justify="right")
    for trial, gain in zip(trials, fit.trial_gains, strict=True):
        command = trial.input
        numbers = (command.values.size * command.dt_s, command.rate_Hz, np.abs(command.values).max())
        table.add_row(
            trial.name, *(f"{number:.6g}" for number in numbers), f"{np.median(command.values):.2f}", f"{gain:.4f}"
        )
    return table


def value_table(fit: "AmplifierFit") -> "Table":
    """Values with their 95 % intervals; below them what a continuous fit of the same response would say."""
    from rich.table import Table

    table = Table(title="amplifier")
    table.add_column("quantity")
    for heading in ("value", "95 % interval"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    late = (fit.delay_s, fit.intervals["delay_s"], 1e6)
    rows = [
        ("pole", fit.pole_Hz, fit.intervals["pole_Hz"], 1.0, 0.0, "Hz", ".1f"),
        ("delay beyond the hold", *late, 0.0, "us", ".2f"),
        ("delay with the hold's half sample", *late, 5e5 * fit.dt_s, "us", ".2f"),
        ("gain", fit.gain, fit.intervals["gain"], 1.0, 0.0, "", ".4f"),
    ]
    for name, value, interval, factor, more, unit, form in rows:
        found, low, high = (format(factor * number + more, form) for number in (value, *interval))
        table.add_row(name, found, f"{low} to {high}", unit)
    crossover = fit.crossover
    if crossover.shows:
        h, half = 1e3 * crossover.half_width_A, 1.96e3 * crossover.deviation_A
        table.add_row("crossover, half-width", f"{h:.2f}", f"{h - half:.2f} to {h + half:.2f}", "mA")
    table.add_section()
    continuous = f"{fit.continuous_pole_Hz:.0f} Hz and {1e6 * fit.continuous_delay_s:.1f} us"
    table.add_row("without hold and sampling in the model", continuous, "", "")
    return table


def crossover_line(fit: "AmplifierFit") -> str:
    """Whether the amplifier's dead band shows."""
    crossover = fit.crossover
    if crossover.shows:
        h = crossover.half_width_A
        # First harmonic of what a dead band takes off a sine of 1 A: 4 h / pi.
        lost = f"commands within {1e3 * h:.3g} mA of zero are lost, {400 * h / math.pi:.2g} % of a sine of 1 A"
        return f"crossover: {lost}; taken off before the fit, so that pole and delay are free of it"
    seen = f"none above {4e3 * crossover.deviation_A:.2g} mA" if crossover.deviation_A > 0 else "not to be seen"
    return f"crossover: {seen}"
