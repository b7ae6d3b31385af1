"""`transopt plant`: an actuator from its datasheet, or from a measured frequency response."""

import typer

from transopt.cli.plant_fit import plant_fit, plant_sweep
from transopt.cli.plant_new import plant_new

app = typer.Typer(
    no_args_is_help=True,
    help="Actuators: a scene from a datasheet, a state space from a measured response or a recorded sweep.",
    epilog="Example: transopt plant new lra --resonance-Hz 150 --quality 8 --moving-mass-kg 0.003 --case-mass-kg 0.1 "
    "--force-factor-N-A 0.8 --R-ohm 8 --rated 2.5 --peak 3",
)
app.command(
    "new",
    epilog="Example: transopt plant new lra --resonance-Hz 150 --quality 8 --moving-mass-kg 0.003 --case-mass-kg 0.1 "
    "--force-factor-N-A 0.8 --R-ohm 8 --L-H 1e-4 --rated 2.5 --peak 3 --stroke-m 6e-4",
)(plant_new)
app.command("fit", epilog="Example: transopt plant fit response.csv --order 4 --out plant.npz --input voltage")(
    plant_fit
)
app.command("sweep", epilog="Example: transopt plant sweep sweep.csv --out plant.npz --resonance-Hz 150")(plant_sweep)
