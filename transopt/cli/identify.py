"""`transopt identify`: one subcommand per part of the model file."""

import typer

from transopt.cli import identify_amplifier as amplifier_command
from transopt.cli import identify_coil as coil_command
from transopt.cli import identify_device as device_command
from transopt.cli import identify_hand as hand_command

app = typer.Typer(no_args_is_help=True, help="From recorded sweeps, taps and heating to a model file for scenes.")
app.command("amplifier")(amplifier_command.identify_amplifier)
app.command("device")(device_command.identify_device)
app.command("hand")(hand_command.identify_hand)
app.command("coil")(coil_command.identify_coil)
