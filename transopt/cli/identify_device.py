"""`transopt identify device`: from sweeps at several grips to the device part of a model file."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.cli.identified import Columns, Out, Units, check_place, finish, progress
from transopt.cli.layout import RateHz
from transopt.cli.scene import DEFAULT_SCENE

if TYPE_CHECKING:
    from collections.abc import Callable

    from transopt.identify.device.chain import DriveChain
    from transopt.identify.device.identify import Settings
    from transopt.identify.device.validation import Taps
    from transopt.scene.model_parts import DevicePart
    from transopt.scene.scene import Scene

UNLIMITED_A = 1e6  # an identified amplifier states no range, and a response needs none


def identify_device(
    files: Annotated[list[Path], typer.Argument(help="Sweeps, several per grip, both polarities: CSV, NPZ, MAT.")],
    out: Out,
    scene: Annotated[
        str | None,
        typer.Option(help=f"Built-in name or .toml: force per ampere, amplifier, start. Default {DEFAULT_SCENE}."),
    ] = None,
    force_per_current: Annotated[
        float | None, typer.Option(help="Force at the tip per ampere in N/A, in place of the scene's.")
    ] = None,
    order: Annotated[int | None, typer.Option(help="Order of the state space, even. Default: found.")] = None,
    kind: Annotated[str, typer.Option(help="drive, state_space, or auto: whichever predicts better.")] = "auto",
    validate: Annotated[
        list[Path] | None,
        typer.Option(
            help="Transients to judge the model by; may be repeated. Default: the last of 3 or more trials."
        ),
    ] = None,
    columns: Columns = "",
    units: Units = "",
    rate_Hz: RateHz = None,
) -> None:
    """Identify drive and hand from swept sines, all grips together, and say what the model is good for.

    Exit 1: what was found is not fit to design with.
    """
    from transopt.cli.questions import measurements
    from transopt.identify.device.identify import identify
    from transopt.identify.device.result import Kind, device_part
    from transopt.report import device_fit

    check_place(out)
    settings = _settings(out, scene, force_per_current, order, kind)
    read = measurements((*files, *(validate or [])), columns, units, rate_Hz)
    with progress() as step:
        result = identify(read[: len(files)], read[len(files) :], settings, tick=step)
        part, figure = device_part(result), device_fit.device_figure(result)
        step("figure")
    device_fit.show(terminal.console(), result)
    drive = result.chosen.kind is Kind.DRIVE
    note = (
        f"taken for {settings.nominal.force_per_current_N_A:.4g} N/A, which sweeps cannot tell "
        "(--force-per-current): masses, springs and dampers are in proportion to it, what a current makes the "
        "stylus do is not"
    )
    finish(out, "device", part, figure, note if drive else "", scene)


def _nominal(scene: "Scene") -> "DriveChain | None":
    """The scene's drive chain, where its model is one."""
    import numpy as np

    from transopt.identify.device.chain import HAND, DriveChain
    from transopt.plant.drive import Drive

    if not isinstance(scene.model, Drive):
        return None
    tip, hand = scene.drive_at_tip(), scene.model.hand
    shared = [tip.moving_mass_kg, scene.model.stylus_mass_kg, tip.stiffness_N_m, max(tip.damping_N_s_m or 0.0, 1e-3)]
    rows = [(line.constant, line.per_newton) for line in map(hand.line, HAND)]
    return DriveChain(tip.force_per_current_N_A, np.array(shared, dtype=float), np.array(rows))


def _settings(
    out: Path, scene_name: str | None, force_per_current_N_A: float | None, order: int | None, kind: str
) -> "Settings":
    """What is known before the first record: force per ampere, amplifier, where to start."""
    from transopt.identify.device.identify import Settings
    from transopt.identify.device.result import Kind
    from transopt.plant.amplifier import Amplifier
    from transopt.scene import builtin
    from transopt.scene.model_file import load_model

    if scene_name is not None and force_per_current_N_A is not None:
        raise InputError("--scene and --force-per-current both state the force per ampere: give one of them")
    if force_per_current_N_A is not None and not 0 < force_per_current_N_A < float("inf"):
        raise InputError(f"--force-per-current {force_per_current_N_A:g} N/A: must be above 0 and finite")
    if kind not in set(Kind):
        raise InputError(f"--kind {kind}: unknown; choose {', '.join(Kind)}")
    if kind == Kind.DRIVE and order is not None:
        raise InputError("--order is that of a state space: leave it out with --kind drive")
    known = builtin.load_scene(scene_name or DEFAULT_SCENE)
    nominal = _nominal(known) or _nominal(builtin.load_scene(DEFAULT_SCENE))
    assert nominal is not None
    force = force_per_current_N_A or known.drive_at_tip().force_per_current_N_A
    amplifier = known.amplifier_model()
    if out.exists() and (part := load_model(out).amplifier) is not None:
        amplifier = Amplifier(part.pole_Hz, part.delay_s, amplifier.command_limit if amplifier else UNLIMITED_A)
    return Settings(
        nominal=nominal.with_force(force),
        # A device given by its force alone need not resemble any scene.
        scene_plant=None if force_per_current_N_A is not None else known.plant,
        amplifier=amplifier,
        kind=Kind(kind),
        order=order,
        played_N=tuple(known.grid.grips_N) if scene_name is not None else (),
        servo_s=known.time_grid().dt_s if scene_name is not None or force_per_current_N_A is None else None,
        taps=None if force_per_current_N_A is not None else _taps_of(scene_name or DEFAULT_SCENE),
    )


def _taps_of(scene_name: str) -> "Callable[[DevicePart], Taps | None]":
    """Designs the taps of a scene with a device, as `transopt solve --model` would; None where that cannot be."""

    def designed(part: "DevicePart") -> "Taps | None":
        import numpy as np

        from transopt.design.context import Context
        from transopt.design.design import design
        from transopt.identify.device.validation import Taps
        from transopt.scene import builtin
        from transopt.scene.model_file import save_part
        from transopt.scene.recordings import recordings_of

        with TemporaryDirectory() as folder:
            model = Path(folder) / "model.json"
            save_part(model, "device", part)
            try:
                scene = builtin.load_scene(scene_name, model=model)
                context = Context.recorded(scene, recordings_of(scene))
                grips, rows = scene.grid.grips_N, scene.axes.rows
                entries = [design([context.posed(v, grip, target) for v, target in rows]) for grip in grips]
            except InputError:
                return None
        return Taps(
            speeds_m_s=scene.axes.speeds_m_s,
            grips_N=tuple(grips),
            current_A=np.array([[entry.plant_input for entry in row] for row in entries]),
            energy=np.array([[np.sum(entry.predicted_m_s2**2) for entry in row] for row in entries]),
            dt_s=scene.time_grid().dt_s,
        )

    return designed
