"""`transopt identify`: one subcommand per part of the model file."""

import typer

from transopt.cli.identify_amplifier import identify_amplifier
from transopt.cli.identify_coil import identify_coil
from transopt.cli.identify_device import identify_device
from transopt.cli.identify_hand import identify_hand

app = typer.Typer(
    no_args_is_help=True,
    help="From recorded sweeps, taps and heating to a model file for scenes.",
    epilog="Example: transopt identify device sweeps/*.npz --out mine.json",
)
app.command("amplifier", epilog="Example: transopt identify amplifier sweeps/*.npz --out mine.json")(
    identify_amplifier
)
app.command("device", epilog="Example: transopt identify device sweeps/*.npz --out mine.json")(identify_device)
app.command("hand", epilog="Example: transopt identify hand taps/*.npz --out mine.json")(identify_hand)
app.command("coil", epilog="Example: transopt identify coil heat.npz --out mine.json")(identify_coil)
