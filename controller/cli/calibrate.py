"""`transopt-play calibrate`: from three taps of a new user to the library of that hand.

Beside `refine` the one command of the controller that solves; what does is imported inside it.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller.cli import options
from controller.cli.port import connected, person_at
from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.cli.bench import Bench
    from controller.cli.refine_taps import Hand
    from controller.device.reading import Described
    from controller.refine.new_hand import Tried
    from transopt.base.tables import Table
    from transopt.identify.calibration import Calibration
    from transopt.library.library import Library
    from transopt.scene.population import Population

USERS = 20  # hands of simulated users that can be asked for
USERS_SEED = 1


def calibrate(
    context: typer.Context,
    library: options.LibraryFile,
    out: Annotated[Path, typer.Option(help="Folder for the hand's model.json and library.npz.")],
    simulate: options.Simulate = False,
    port: options.AnyPort = None,
    population: Annotated[
        Path | None, typer.Option(help="Population of hands, a .toml file; default the built-in stylus_grip.")
    ] = None,
    as_recorded: Annotated[
        bool,
        typer.Option(
            "--as-recorded",
            help="Track the taps as they were recorded, not what the object would do in the new hand.",
        ),
    ] = False,
    device: options.DeviceName = None,
    user: Annotated[
        int,
        options.with_simulate(
            "Whose hand it is: number 1 to 20 of the population; 0 for the hand of the true device."
        ),
    ] = 1,
    scene: options.TrueDeviceName = None,
    mismatch: options.Mismatch = 0.0,
    seed: options.Seed = 0,
    crossover: options.Crossover = 0.01,
    seconds: Annotated[float | None, options.with_port("End the taps after so many seconds.", "--for")] = None,
    reset: options.Reset = False,
) -> None:
    """Find a new user's hand from three taps on the device, solve its library, and play it beside the old one.

    Exit 1: the new library is worse than the one that was played, an entry of it is refused, or a fault or a lost
    lease ended the taps.
    """
    simulated = options.is_simulated(context, "calibrate", simulate, port)
    options.within("user", user, 0, USERS)
    options.within("for", seconds, 1.0, 1e6, " s")
    from controller.host.payload import load_playable
    from transopt.scene import builtin
    from transopt.scene.population import load_population

    loaded = load_playable(library)
    if (out / "library.npz").resolve() == library.resolve():
        raise InputError(f"--out {out}: holds the library that is played; choose another folder")
    hands = load_population(builtin.POPULATION if population is None else population)
    from controller.cli.describe import described
    from controller.refine.new_hand import drive_of

    found = described(device, library, quiet=simulated)
    if not found.device.accelerometer.sensor:
        raise InputError(
            "calibrate: accelerometer.sensor = false: an accelerometer tells most of a hand: mount one, and state it "
            "in the device file (--device)"
        )
    drive_of(loaded.scene())
    wrong = options.imperfect(found.device, mismatch, seed, crossover)
    terminal.make_folder(out)
    if simulated:
        from controller.cli.refine_taps import simulated_at
        from controller.sim.simulator import device_in, scene_like

        own = loaded.scene().striking() if scene is None else scene_like(scene)
        if user:
            own = own.in_hand(hands.drawn(USERS, USERS_SEED, loaded.grips_N.tolist())[user - 1])
        bench, hand = simulated_at(loaded, device_in(own, wrong, seed), wrong, seed, found.device)
    else:
        from controller.cli.refine_taps import PersonsHand

        assert port is not None
        bench, hand = person_at(port), PersonsHand(terminal.console())
    _calibrate(loaded, library, bench, hand, found, hands, as_recorded, out, seconds, reset)


def _calibrate(
    library: "Library",
    path: Path,
    bench: "Bench",
    hand: "Hand",
    found: "Described",
    hands: "Population",
    as_recorded: bool,
    out: Path,
    seconds: float | None,
    reset: bool,
) -> None:
    """Taps, hand, library, taps again; and what came of it."""
    from controller.cli.refine import ended_in_words
    from controller.cli.refine_taps import Taps
    from controller.refine.new_hand import calibrated, judged, nodes_to_tap, save_model, tried
    from transopt.design.another_model import built_on
    from transopt.scene.fitted import Source

    console, accelerometer = terminal.console(), found.device.accelerometer
    nodes, taps = nodes_to_tap(library, found.device)
    source = Source(file=path.name, sha256=library.content_sha256)
    model, written = out / "model.json", out / "library.npz"
    with connected(bench.port, reset) as device, ended_in_words(), hand:
        play = Taps(device, bench, hand, found.device, out, taps, seconds)
        before, settings = play.contacts(library, 0, nodes)
        result, complaints = calibrated(before, settings, library, hands, accelerometer, [source])
        for words in complaints:
            console.print(words, style="yellow")
        save_model(model, library.scene(), result.device)
        console.print(hand_table(result, hands))
        console.print(result.device.verdict)
        build = built_on(library, model, as_recorded=as_recorded)
        if build.library is None:
            refused = build.refused[0]
            reason = "; ".join(refused.shortfalls) or refused.status.value
            console.print(f"{refused.place}: refused: {reason}; {model} has the hand", style="red")
            raise typer.Exit(1)
        build.library.save(written)
        after, new_settings = play.contacts(build.library, 1, nodes)
    each = tried(nodes, build.library, before, after, (settings, new_settings), accelerometer)
    console.print(tried_table(build.library, each))
    words, good = judged(each)
    console.print(f"{out}: model.json, library.npz")
    console.print(words, style=None if good else "red")
    if not good:
        raise typer.Exit(1)


def hand_table(found: "Calibration", hands: "Population") -> "Table":
    """The hand's parameters with what is known of them, and who tells it."""
    from transopt.base.tables import Table
    from transopt.identify.device.chain import HAND, unit_of

    ends = [f"{grip:g} N" for grip in hands.grips_N]
    heads = ("parameter", "unit", *ends, f"known to %, {found.grip_N:.2g} N", "population %", "told by")
    title = f"the hand by {len(found.grips_N)} taps, and the population as prior"
    table = Table.of(title, heads, words=("parameter", "unit", "told by"))
    values = [*map(list, zip(*found.at_ends, strict=True))]
    for name, at_ends in zip(HAND, values, strict=True):
        prior, own, by_taps = found.determined[name]
        row = [f"{value:.3g}" for value in at_ends]
        table.add_row(
            name, unit_of(name), *row, f"{100 * own:.1f}", f"{100 * prior:.0f}", "taps" if by_taps else "population"
        )
    return table


def tried_table(library: "Library", each: "list[Tried]") -> "Table":
    """Both libraries, node by node."""
    from controller.refine.tables import place
    from transopt.base.tables import Table
    from transopt.base.writing import percent

    title = "played: the library as it was -> the new one, beside the tap that the new one tracks"
    table = Table.of(title, ("node", "tap %", "felt %"), words=("node",))
    for one in each:
        pairs = zip(one.before, one.after, strict=True)
        table.add_row(place(library, one.node), *(f"{percent(old)} -> {percent(new)}" for old, new in pairs))
    return table
