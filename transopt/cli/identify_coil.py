"""`transopt identify coil`: a heating and cooling record in, thermal resistances and time constants out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.identified_file import check_place, next_step
from transopt.cli.layout import COLUMNS_HELP, UNITS_HELP, layout
from transopt.cli.scene import DEFAULT_SCENE

if TYPE_CHECKING:
    from rich.table import Table

    from transopt.identify.coil import CoilFit
    from transopt.identify.measurement import Measurement
    from transopt.plant.coil import CoilModel
    from transopt.scene.model_parts import CoilPart

RIPPLE_A = 0.02  # `transopt.plant.coil.PWM_RIPPLE_A`, which is loaded when the command runs
UNITS = {"R_wh_K_W": "K/W", "R_ha_K_W": "K/W", "tau_w_s": "s", "tau_h_s": "s"}
MEANING = {
    "R_wh_K_W": "winding over housing",
    "R_ha_K_W": "housing over ambient",
    "tau_w_s": "winding",
    "tau_h_s": "housing",
}


def identify_coil(
    file: Annotated[Path, typer.Argument(help="Record with current_A and winding_C or voltage_V: CSV, NPZ or MAT.")],
    out: Annotated[Path, typer.Option(help="Model file; its other parts stay.")],
    scene: Annotated[str, typer.Option(help="Scene of the motor: its resistance, its limit.")] = DEFAULT_SCENE,
    resistance_ohm: Annotated[
        float | None, typer.Option(help="Resistance at 25 C, in ohm, in place of that of the scene's motor.")
    ] = None,
    ripple_A: Annotated[
        float,
        typer.Option("--ripple-A", help="PWM ripple that heats beside the recorded current; 0: a linear amplifier."),
    ] = RIPPLE_A,
    columns: Annotated[str, typer.Option(help=COLUMNS_HELP)] = "",
    units: Annotated[str, typer.Option(help=UNITS_HELP)] = "",
) -> None:
    """Thermal resistances and time constants of the coil.

    Exit 1: what was found is not fit to design with.
    """
    from dataclasses import replace

    from transopt.base.plotting import save_figure
    from transopt.identify.coil import fit_coil, heat_record
    from transopt.identify.measurement import load_measurement
    from transopt.report.coil_fit import coil_figure
    from transopt.scene.model_file import save_part

    check_place(out)
    nominal = _coil_of(scene)
    run = load_measurement(file, layout(columns, units))
    R_ohm = nominal.R_ohm if resistance_ohm is None else resistance_ohm
    fit = fit_coil(heat_record(run, R_ohm, ripple_A), limit_C=nominal.limit_C)
    # The identified coil in the scene's surroundings, to be compared with the datasheet.
    continuous_A = replace(fit.coil, ambient_C=nominal.ambient_C).continuous_current_A()
    figure = out.with_name(f"{out.stem}_coil.png")
    part = coil_part(fit, run, nominal, continuous_A)
    save_part(out, "coil", part)
    save_figure(coil_figure(fit), figure)
    console = terminal.console()
    console.print(value_table(fit))
    channels = "the winding" if fit.record.housing is None else "winding and housing"
    noise = f"noise of the winding {fit.record.winding.noise_K:.2g} K, residuals {fit.misfit:.2f} times the noise"
    console.print(f"from {channels}, {noise}", highlight=False, soft_wrap=True)
    if run.missing:
        console.print(f"note: {run.missing}", highlight=False, soft_wrap=True)
    console.print(f"{out}, {figure.name}", highlight=False, soft_wrap=True)
    short = fit.shortfalls()
    console.print(f"coil: {part.verdict}", style="red" if short else None, highlight=False, soft_wrap=True)
    if short:
        raise typer.Exit(1)
    console.print(next_step(out, None if scene == DEFAULT_SCENE else scene), highlight=False, soft_wrap=True)


def _coil_of(scene: str) -> "CoilModel":
    from transopt.scene import builtin

    coil = builtin.load_scene(scene).coil()
    if coil is None:
        raise InputError(f"--scene {scene}: states no motor, so no coil; give a scene with [motor]")
    return coil


def verdict(fit: "CoilFit", nominal: "CoilModel", continuous_A: float) -> str:
    """In plain words: what the coil's model may be used for, or why not."""
    short = fit.shortfalls()
    if short:
        return f"not to be relied upon: {'; '.join(short)}"
    ripple = (
        ""
        if fit.record.ripple_A == RIPPLE_A
        else f"; fitted with {fit.record.ripple_A:g} A of ripple, a design counts {RIPPLE_A:g} A"
    )
    return (
        f"supports temperature limits of bursts and of repeated taps; {continuous_A:.3f} A for ever hold the winding "
        f"at its {nominal.limit_C:g} C in {nominal.ambient_C:g} C{ripple}"
    )


def coil_part(fit: "CoilFit", run: "Measurement", nominal: "CoilModel", continuous_A: float) -> "CoilPart":
    """What the model file states."""
    from transopt.identify.coil import NAMES
    from transopt.scene.fitted import Source
    from transopt.scene.model_parts import CoilPart

    return CoilPart.model_validate(
        {
            **{name: getattr(fit.coil, name) for name in NAMES},
            "intervals": dict(zip(NAMES, fit.intervals.tolist(), strict=True)),
            "parameters": list(NAMES),
            "covariance": fit.covariance.tolist(),
            "verdict": verdict(fit, nominal, continuous_A),
            "shortfalls": fit.shortfalls(),
            "sources": [Source(file=run.source, sha256=run.sha256).model_dump()],
        }
    )


def value_table(fit: "CoilFit") -> "Table":
    """Values with their 95 % intervals."""
    from rich.table import Table

    from transopt.identify.coil import NAMES

    table = Table(title=f"coil of {fit.record.R_ohm:g} ohm at 25 C")
    for heading in ("quantity", "of"):
        table.add_column(heading)
    for heading in ("value", "95 %"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    for name, (low, high) in zip(NAMES, fit.intervals, strict=True):
        table.add_row(name, MEANING[name], f"{getattr(fit.coil, name):.4g}", f"{low:.4g} .. {high:.4g}", UNITS[name])
    return table
