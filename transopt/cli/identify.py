"""`transopt identify`: a subcommand for each part of the model file; that for a device has a file of its own."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base.errors import InputError
from transopt.cli.identified import Columns, Out, Units, check_place, draw, finish, progress, tell
from transopt.cli.identify_device import identify_device
from transopt.cli.layout import RateHz
from transopt.cli.scene import DEFAULT_SCENE

if TYPE_CHECKING:
    from transopt.plant.coil import CoilModel

RIPPLE_A = 0.02  # `transopt.plant.coil.PWM_RIPPLE_A`, which is loaded when the command runs

app = typer.Typer(
    no_args_is_help=True,
    help="From recorded sweeps, taps and heating to a model file for scenes.",
    epilog="Example: transopt identify device sweeps/*.npz --out mine.json",
)


@app.command("amplifier", epilog="Example: transopt identify amplifier sweeps/*.npz --out mine.json")
def identify_amplifier(
    files: Annotated[list[Path], typer.Argument(help="Sweeps with command_A and current_A: CSV, NPZ or MAT.")],
    out: Out,
    columns: Columns = "",
    units: Units = "",
    rate_Hz: RateHz = None,
) -> None:
    """Pole and delay of the current amplifier from swept sines.

    Exit 1: what was found is not fit to design with.
    """
    from transopt.cli.questions import measurements
    from transopt.identify.amplifier import fit_amplifier, trials_of
    from transopt.report import fits
    from transopt.scene.model_parts import AmplifierPart

    check_place(out)
    runs = measurements(files, columns, units, rate_Hz)
    with progress() as step:
        step("fitting")
        trials, findings = trials_of(runs)
        fit = fit_amplifier(trials)
    tell(fits.trial_table(fit, trials), fits.amplifier_table(fit))
    tell(*map(str, findings), style="yellow")
    tell(fits.crossover_line(fit))
    finish(out, "amplifier", AmplifierPart.model_validate(fit.content(runs)), fits.amplifier_figure(fit))


app.command("device", epilog="Example: transopt identify device sweeps/*.npz --out mine.json")(identify_device)


@app.command("hand", epilog="Example: transopt identify hand taps/*.npz --out mine.json")
def identify_hand(
    files: Annotated[
        list[Path], typer.Argument(help="Taps with force_N, acceleration_m_s2 and grip_N: CSV, NPZ or MAT.")
    ],
    out: Out,
    window: Annotated[float, typer.Option(help="From contact on, in s; the hand answers after 0.03.")] = 0.03,
    tap: Annotated[
        list[int] | None, typer.Option(help="Which tap of files with several, counted from 1; may be repeated.")
    ] = None,
    columns: Columns = "",
    units: Units = "",
    rate_Hz: RateHz = None,
    accept: Annotated[bool, typer.Option("--accept", help="Take a mass that few hands have as it is.")] = False,
) -> None:
    """Mass, damping and stiffness of the hand over grip from taps.

    Exit 1: what was found is not fit to design with.
    """
    from pydantic import ValidationError

    from transopt.cli.questions import measurements
    from transopt.identify.hand.fourth_order import fit_fourth_order, hand_part
    from transopt.identify.hand.lines import fit_hand
    from transopt.identify.hand.tap import usable_taps
    from transopt.identify.measurement import split_taps
    from transopt.report import fits
    from transopt.scene.fitted import complaint

    if not 0.01 <= window <= 0.1:
        raise InputError(f"--window {window:g} s: must be 0.01 to 0.1 s")
    check_place(out)
    runs = split_taps(measurements(files, columns, units, rate_Hz), tap or ())
    with progress() as step:
        step("fitting")
        taps, left_out = usable_taps(runs, window)
        fit = fit_hand(taps, accept=accept)
        fourth = fit_fourth_order(taps, fit)
    tell(fits.line_table(fit), fits.fourth_order_table(fourth))
    tell(*(f"{one.name}: {one.note}" for one in taps if one.note))
    tell(*(f"left out: {line}" for line in left_out), *filter(None, [fourth.braking()]), style="yellow")
    tell(f"fourth order: {fourth.word()}")
    used, figure = {tap.name for tap in taps}, fits.hand_figure(fit)
    try:
        part = hand_part(fit, fourth, [run for run in runs if run.name in used])
    except ValidationError as error:
        tell(draw(out, "hand", figure).name)
        short = [complaint(error), *fit.shortfalls(), *(fourth.shortfalls() if fourth.is_better else ())]
        tell(f"hand: {out} is not written: {'; '.join(short)}", style="red")
        raise typer.Exit(1) from None
    finish(out, "hand", part, figure)


@app.command("coil", epilog="Example: transopt identify coil heat.npz --out mine.json")
def identify_coil(
    file: Annotated[Path, typer.Argument(help="Record with current_A and winding_C or voltage_V: CSV, NPZ or MAT.")],
    out: Out,
    scene: Annotated[str, typer.Option(help="Scene of the motor: its resistance, its limit.")] = DEFAULT_SCENE,
    resistance_ohm: Annotated[
        float | None, typer.Option(help="Resistance at 25 C, in ohm, in place of that of the scene's motor.")
    ] = None,
    resistance_tolerance: Annotated[
        float | None,
        typer.Option(help="Share of the resistance within which 95 % of such motors lie; else 0.08, a datasheet's."),
    ] = None,
    leads_ohm: Annotated[
        float | None,
        typer.Option(help="Most that leads add within voltage_V; 0 at the motor; else 5 % of the resistance."),
    ] = None,
    ripple_A: Annotated[
        float,
        typer.Option("--ripple-A", help="PWM ripple that heats beside the recorded current; 0: a linear amplifier."),
    ] = RIPPLE_A,
    columns: Columns = "",
    units: Units = "",
    rate_Hz: RateHz = None,
) -> None:
    """Thermal resistances, time constants and resistance of the coil.

    Exit 1: what was found is not fit to design with.
    """
    from transopt.cli.questions import measurements
    from transopt.identify.coil import fit_coil
    from transopt.identify.heat_record import heat_record
    from transopt.report import fits
    from transopt.scene.model_parts import CoilPart

    check_place(out)
    nominal = _coil_of(scene)
    (run,) = measurements([file], columns, units, rate_Hz)
    R_ohm = nominal.R_ohm if resistance_ohm is None else resistance_ohm
    record = heat_record(run, R_ohm, ripple_A, R_tolerance=resistance_tolerance, leads_ohm=leads_ohm)
    fit = fit_coil(record, nominal)
    tell(fits.coil_table(fit), fits.noise_line(fit))
    if run.missing:
        tell(f"note: {run.missing}")
    part = CoilPart.model_validate(fit.content([run]))
    assumed = resistance_ohm is None and scene == DEFAULT_SCENE and record.electrical is None
    note = (
        f"taken for {R_ohm:g} ohm at 25 C, the default scene's motor, which temperatures cannot tell "
        "(--resistance-ohm): both thermal resistances are in inverse proportion to it"
    )
    next_scene = None if scene == DEFAULT_SCENE else scene
    finish(out, "coil", part, fits.coil_figure(fit), note if assumed else "", next_scene)


def _coil_of(scene: str) -> "CoilModel":
    from transopt.scene import builtin

    loaded = builtin.load_scene(scene)
    coil, circuit = loaded.coil(), loaded.circuit()
    if coil is None or circuit is None:
        raise InputError(f"--scene {scene}: states no motor, so no coil; give a scene with [motor]")
    # The winding's own resistance tells its temperature; how much the ripple adds to the heat is another option.
    return replace(coil, R_ohm=circuit.R_ohm)
