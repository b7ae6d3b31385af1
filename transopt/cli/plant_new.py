"""`transopt plant`, and of its commands `new`: a commented scene from the values of a datasheet."""

import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from transopt.base import asking, terminal
from transopt.base.errors import InputError
from transopt.cli.plant_fit import ACCEPTED, plant_fit, plant_sweep
from transopt.cli.scene import ACCEPT_HELP, FORCE_HELP, write_new

if TYPE_CHECKING:
    from transopt.scene.datasheet import Datasheet

app = typer.Typer(
    no_args_is_help=True,
    help="Actuators: a scene from a datasheet, a state space from a measured response or a recorded sweep.",
    epilog="Example: transopt plant new lra --resonance-Hz 150 --quality 8 --moving-mass-kg 0.003 --case-mass-kg 0.1 "
    "--force-factor-N-A 0.8 --R-ohm 8 --rated 2.5 --peak 3",
)


@app.command(
    "new",
    epilog="Example: transopt plant new lra --resonance-Hz 150 --quality 8 --moving-mass-kg 0.003 --case-mass-kg 0.1 "
    "--force-factor-N-A 0.8 --R-ohm 8 --L-H 1e-4 --rated 2.5 --peak 3 --stroke-m 6e-4",
)
def plant_new(
    context: typer.Context,
    name: Annotated[Path, typer.Argument(help="The scene to write: lra writes lra.toml.")],
    kind: Annotated[str, typer.Option(help="inertial (an LRA), voice_coil or shaker.")] = "inertial",
    driven_by: Annotated[str, typer.Option("--input", help="What the driver sets: voltage or current.")] = "voltage",
    resonance_Hz: Annotated[
        float | None, typer.Option("--resonance-Hz", help="Resonance f0, terminals open.")
    ] = None,
    quality: Annotated[float | None, typer.Option(help="Quality Q of that resonance, terminals open.")] = None,
    damping_N_s_m: Annotated[
        float | None,
        typer.Option("--damping-N-s-m", help="Damper, in place of f0 and Q where there is no spring; 0: none."),
    ] = None,
    moving_mass_kg: Annotated[
        float | None, typer.Option("--moving-mass-kg", help="Moving mass; of a shaker the bare table with its coil.")
    ] = None,
    payload_kg: Annotated[float | None, typer.Option("--payload-kg", help="What stands on a shaker's table.")] = None,
    case_mass_kg: Annotated[
        float | None, typer.Option("--case-mass-kg", help="Case with all that shakes with it, as a phone or a jig.")
    ] = None,
    force_factor_N_A: Annotated[
        float | None, typer.Option("--force-factor-N-A", "--BL", help="Force factor BL in N/A, T m or V s/m.")
    ] = None,
    R_ohm: Annotated[float | None, typer.Option("--R-ohm", help="Resistance of the coil.")] = None,
    L_H: Annotated[float | None, typer.Option("--L-H", help="Inductance of the coil; without it 0.")] = None,
    rated: Annotated[
        float | None,
        typer.Option(help="What it stands for ever, in V or A, as the peak of a sine (1.414 times its rms)."),
    ] = None,
    rms_V: Annotated[
        float | None, typer.Option("--rms-V", help="Rated voltage of an LRA's sine at resonance, rms.")
    ] = None,
    rms_A: Annotated[float | None, typer.Option("--rms-A", help="Rated current of that sine, rms.")] = None,
    rms_g: Annotated[
        float | None, typer.Option("--rms-g", help="Rated acceleration of the jig by that sine, rms, in g.")
    ] = None,
    rise_s: Annotated[
        float | None, typer.Option("--rise-s", help="Time from rest to 90 % of it, by that sine alone.")
    ] = None,
    brake_s: Annotated[
        float | None, typer.Option("--brake-s", help="Time from it to 10 %, the driver holding 0 V.")
    ] = None,
    quality_electrical: Annotated[
        float | None, typer.Option("--quality-electrical", "--Qes", help="Quality by the driven coil alone, Qes.")
    ] = None,
    quality_total: Annotated[
        float | None, typer.Option("--quality-total", "--Qts", help="Quality with the driven coil, Qts.")
    ] = None,
    stiffness_N_m: Annotated[
        float | None, typer.Option("--stiffness-N-m", help="Stiffness of the suspension: 1000 over Cms in mm/N.")
    ] = None,
    peak: Annotated[float | None, typer.Option(help="The most that the driver may ever put out, in V or A.")] = None,
    stroke_m: Annotated[
        float | None, typer.Option("--stroke-m", help="From rest to the stop, in either direction.")
    ] = None,
    frequency_Hz: Annotated[
        float | None,
        typer.Option("--frequency-Hz", help="Frequency of the first target; default resonance or 100 Hz."),
    ] = None,
    rate_Hz: Annotated[
        float | None, typer.Option("--rate-Hz", help="Rate of the driver's samples; default 48000, else 10000 Hz.")
    ] = None,
    accept: Annotated[bool, typer.Option("--accept", help=ACCEPT_HELP)] = False,
    force: Annotated[bool, typer.Option("--force", help=FORCE_HELP)] = False,
) -> None:
    """Write a commented scene of an actuator from its datasheet; on a terminal what is missing is asked for.

    Moving mass, BL, Q, resistance and f0 follow from the rated sine, its rise and brake time, Qes, Qts and stiffness.
    """
    from transopt.scene.datasheet import KINDS, Datasheet, needed, scene_text

    for option, word, known in (("--kind", kind, KINDS), ("--input", driven_by, ("voltage", "current"))):
        if word not in known:
            raise InputError(f"{option} {word}: unknown; choose {', '.join(known)}")
    # The options for numbers are called as the keys of the datasheet, and as those of `transopt.scene.rated`.
    options = {str(each.name): context.params[str(each.name)] for each in context.command.params}
    numbers = {name: value for name, value in options.items() if isinstance(value, float)}
    given = {name: value for name, value in numbers.items() if name not in Datasheet.model_fields}
    stated = {"kind": kind, "input": driven_by, **{key: numbers[key] for key in numbers if key not in given}}
    _is_odd({**stated, **given}, accept)  # before anything is made of it
    if given:
        stated = _completed(stated, given)
    file = name if name.suffix == ".toml" else name.with_name(f"{name.name}.toml")
    missing = [key for key in needed(kind, driven_by) if key not in stated]
    if missing and asking.on_a_terminal():
        stated = _asked(stated, set(needed(kind, driven_by)))
    elif missing:
        raise InputError(
            f"{', '.join(map(option_of, missing))}: missing for --kind {kind} --input {driven_by}; state what the "
            "datasheet says, or call the command on a terminal, which asks for it"
        )
    odd = _is_odd(stated, accept)
    text = scene_text(_sheet(stated), file.stem)
    write_new(file, f'implausible = "accept"\n{text}' if odd else text, force=force)
    typer.echo(f"{file} written; edit its targets, then: transopt solve {shlex.quote(str(file))}")


app.command("fit", epilog="Example: transopt plant fit response.csv --order 4 --out plant.npz --input voltage")(
    plant_fit
)
app.command("sweep", epilog="Example: transopt plant sweep sweep.csv --out plant.npz --resonance-Hz 150")(plant_sweep)


def _completed(stated: dict[str, Any], further: dict[str, float]) -> dict[str, Any]:
    """What is stated with what follows from the further numbers of a sheet, which is printed with how sure it is."""
    from transopt.base.units import unit_of
    from transopt.scene.rated import UNKNOWN, UNSURE, WORDS, Rating, completed, rated_swing_m

    if stated["kind"] == "inertial" and "case_mass_kg" not in stated:
        raise InputError(
            f"{option_of(next(iter(further)))}: an LRA shakes a jig, often of 0.1 kg: state --case-mass-kg"
        )
    numbers = {key: value for key, value in {**stated, **further}.items() if isinstance(value, float)}
    zero = ("L_H", "payload_kg")
    if bad := next((key for key, value in numbers.items() if not 0 < value < float("inf") and key not in zero), None):
        raise InputError(f"{option_of(bad)} {numbers[bad]:g}: must be above 0 and finite")
    rating = Rating(stated.get("case_mass_kg"), stated.get("L_H", 0.0), further.get("rms_V"), further.get("rms_A"))
    found, console = completed(numbers, rating), terminal.console()
    if found.note:
        console.print(f"note: {found.note}")
    for key in (key for key in UNKNOWN if key not in stated):
        sure, swing = found.deviations[key], ""
        if key == "moving_mass_kg" and rating.jig_kg is not None and "rms_g" in further:
            by_mass = partial(rated_swing_m, rating.jig_kg, found.values["resonance_Hz"], further["rms_g"])
            own, light = (1e3 * by_mass(share * found.values[key]) for share in (1.0, 0.1))
            swing = f"it would swing {own:.2g} mm at the rating, a tenth of it {light:.2g} mm; "
        about = (
            f"+-{100 * sure:.0f} %" if sure < UNSURE else f"a guess: {swing}measure it, and state {option_of(key)}"
        )
        console.print(f"{WORDS[key]} {found.values[key]:.3g} {unit_of(key)}".rstrip() + f": {about}")
    volts = "rms_V" in further and stated["input"] == "voltage"
    peak = {"rated": 2**0.5 * further["rms_V"]} if volts else {}
    return {**peak, **{key: float(f"{found.values[key]:.4g}") for key in UNKNOWN}, **stated}


def option_of(key: str) -> str:
    """The option of a key of the datasheet."""
    return f"--{key.replace('_', '-')}"


def _is_odd(stated: dict[str, Any], accept: bool) -> bool:
    """Whether a datasheet states what no device has."""
    from transopt.scene.plausible import implausible

    unit = "V" if stated["input"] == "voltage" else "A"
    # The unit of these two is that of the input, and their names do not end in it.
    content = {f"{key}_{unit}" if key in ("rated", "peak") else key: value for key, value in stated.items()}
    found = implausible(content)
    if found and not accept:
        key, sentence = found[0].split(" = ", 1)
        option = option_of(key.removesuffix(f"_{unit}") if key.startswith(("rated", "peak")) else key)
        raise InputError(f"{option} = {sentence}; {ACCEPTED}")
    return bool(found)


def _sheet(stated: dict[str, Any]) -> "Datasheet":
    """The datasheet, checked."""
    from pydantic import ValidationError

    from transopt.scene.datasheet import Datasheet

    try:
        return Datasheet.model_validate(stated)
    except ValidationError as error:
        first = error.errors()[0]
        message = first["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
        where = f"{option_of(str(first['loc'][0]))} {first['input']}: " if first["loc"] else ""
        for key in sorted(Datasheet.model_fields, key=len, reverse=True):
            if "_" in key:
                message = message.replace(key, option_of(key))
        raise InputError(f"{where}{message}") from None


def _asked(stated: dict[str, Any], must: set[str]) -> dict[str, Any]:
    """What the command line states, and what a person answers for the rest, key by key."""
    from transopt.base.units import unit_of
    from transopt.scene.datasheet import Datasheet

    driven_by = "V" if stated["input"] == "voltage" else "A"
    found = dict(stated)
    how = f"kind {stated['kind']}, driven by a {stated['input']}; an empty answer takes what is in brackets"
    terminal.console().print(how)
    for key, field in Datasheet.model_fields.items():
        if key in found or not _asked_for(key, found):
            continue
        unit = driven_by if key in ("rated", "peak") else unit_of(key)
        # What the others of a pair leave open is needed as well.
        required = key in {*must, "quality", "damping_N_s_m"}
        value = asking.answer(
            key,
            (field.description or "").removesuffix(" [V or A]"),
            unit,
            field.default if not field.is_required() else None,
            _positive if key not in ("L_H", "payload_kg", "damping_N_s_m") else _not_negative,
            without="plant new: no answers came; type them, or state the options",
            needed=required,
        )
        if value is not None:
            found[key] = value
    return found


def _asked_for(key: str, found: dict[str, Any]) -> bool:
    """Whether a key means anything beside what is known already."""
    match key:
        case "quality":
            return "resonance_Hz" in found
        case "damping_N_s_m":
            return "resonance_Hz" not in found
        case "payload_kg":
            return bool(found["kind"] == "shaker")
        case "case_mass_kg":
            return bool(found["kind"] != "shaker")
        case "R_ohm" | "L_H":
            return bool(found["input"] == "voltage")
    return True


def _positive(text: str) -> float:
    value = _not_negative(text)
    if value == 0:
        raise ValueError("must be a number above 0")
    return value


def _not_negative(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf"):
        raise ValueError("must be a number, not below 0")
    return value
