"""`transopt identify coil`: a heating and cooling record in, thermal resistances and time constants out."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base.errors import InputError
from transopt.cli.identified_file import check_place, finish, tell
from transopt.cli.layout import COLUMNS_HELP, UNITS_HELP, RateHz
from transopt.cli.scene import DEFAULT_SCENE

if TYPE_CHECKING:
    from transopt.plant.coil import CoilModel

RIPPLE_A = 0.02  # `transopt.plant.coil.PWM_RIPPLE_A`, which is loaded when the command runs


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
    rate_Hz: RateHz = None,
) -> None:
    """Thermal resistances and time constants of the coil.

    Exit 1: what was found is not fit to design with.
    """
    from transopt.base.plotting import save_figure
    from transopt.cli.questions import measurements
    from transopt.identify.coil import coil_part, fit_coil
    from transopt.identify.heat_record import heat_record
    from transopt.report import coil_fit
    from transopt.scene.model_file import save_part

    check_place(out)
    nominal = _coil_of(scene)
    (run,) = measurements([file], columns, units, rate_Hz)
    R_ohm = nominal.R_ohm if resistance_ohm is None else resistance_ohm
    fit = fit_coil(heat_record(run, R_ohm, ripple_A), limit_C=nominal.limit_C)
    figure = out.with_name(f"{out.stem}_coil.png")
    part = coil_part(fit, run, nominal)
    save_part(out, "coil", part)
    save_figure(coil_fit.coil_figure(fit), figure)
    tell(coil_fit.value_table(fit), coil_fit.noise_line(fit))
    if run.missing:
        tell(f"note: {run.missing}")
    finish(out, figure, "coil", part, None if scene == DEFAULT_SCENE else scene)


def _coil_of(scene: str) -> "CoilModel":
    from transopt.scene import builtin

    loaded = builtin.load_scene(scene)
    coil, circuit = loaded.coil(), loaded.circuit()
    if coil is None or circuit is None:
        raise InputError(f"--scene {scene}: states no motor, so no coil; give a scene with [motor]")
    # The winding's own resistance tells its temperature; how much the ripple adds to the heat is another option.
    return replace(coil, R_ohm=circuit.R_ohm)
