"""`transopt-device`: a device with a simulated stylus in a simulated hand, to be opened like one on a serial port.

What is served is the C core with a compiled plant, in real time; it is compiled on first use.
"""

import math
import subprocess
import sys
import tempfile
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller.cli.options import within
from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from controller.sim.simulator import Simulator
    from controller.sim.user import StillHand, TapsInTurn

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
DT_S = 1e-4
TAPS = ("0.1,3", "0.2,3", "0.3,3", "0.4,3")


def _taps(lines: list[str]) -> list[tuple[float, float]]:
    taps = []
    for words in lines:
        speed, _, grip = words.partition(",")
        try:
            taps.append((float(speed), float(grip)))
        except ValueError:
            raise InputError(f"--tap {words}: must be SPEED,GRIP in m/s and N, like 0.2,3") from None
        within("tap", taps[-1][0], 0.02, 2.0, " m/s")
        within("tap", taps[-1][1], 0.0, 50.0, " N")
    return taps


def simulated(
    like: str | Path | None,
    taps: list[tuple[float, float]],
    rest_s: float,
    mismatch: float,
    seed: int,
    hold_N: float | None = None,
) -> "tuple[Simulator, TapsInTurn | StillHand]":
    """The device of a library or a scene, the default device without, in the hand of a user who taps in turn.

    Between two rounds the hand rests for `rest_s`, so that the device can be armed. With `hold_N` it only holds.

    Raises
    ------
    InputError : the file is none of these.
    """
    from controller.sim.simulator import Imperfections, Simulator, scene_like
    from controller.sim.true_device import DEFAULT_DEVICE, device_of
    from controller.sim.user import StillHand, TapsInTurn

    device = DEFAULT_DEVICE
    if like is not None:
        # The compiled plant moves by matrices alone: it has the pole that a bridge's loop amounts to.
        device = replace(device_of(scene_like(like)), bridge=None)
    user: TapsInTurn | StillHand
    if hold_N is None:
        round_s = TapsInTurn(taps).period_s + rest_s
        user = TapsInTurn(taps, math.ceil(round_s / DT_S) * DT_S)
    else:
        user = StillHand(hold_N)
    return Simulator(device, user, DT_S, imperfections=Imperfections(mismatch=mismatch), seed=seed), user


def _run_compiled(program: Path, options: list[str], plant: bytes) -> int:
    """Start the compiled device, pass the user's lines on to it and wait for its end."""
    with tempfile.TemporaryDirectory(prefix="transopt-device-") as folder:
        path = Path(folder) / "plant"
        path.write_bytes(plant)
        running = subprocess.Popen([str(program), "--plant", str(path), *options], stdin=subprocess.PIPE, text=True)
        assert running.stdin is not None
        given = running.stdin

        def pass_on() -> None:
            for line in sys.stdin:
                try:
                    given.write(line)
                    given.flush()
                except OSError:
                    return

        threading.Thread(target=pass_on, daemon=True).start()
        try:
            return running.wait()
        except KeyboardInterrupt:
            return 0
        finally:
            running.terminate()
            running.wait()


@app.command(epilog="Example: transopt-device --like wood_on_foam --listen localhost:5333")
def device(
    listen: Annotated[str | None, typer.Option(help="HOST:PORT of a socket instead of a pseudo-terminal.")] = None,
    like: Annotated[
        str | None, typer.Option(help="Whose device it is: built-in scene, .toml or library.npz.")
    ] = None,
    tap: Annotated[
        list[str] | None, typer.Option(help="SPEED,GRIP in m/s and N; give several, done in turn.")
    ] = None,
    hold: Annotated[float | None, typer.Option(help="The hand only holds, still, with this grip in N.")] = None,
    rest: Annotated[float, typer.Option(help="How long the hand is still after each round of taps, in s.")] = 2.0,
    mismatch: Annotated[float, typer.Option(help="Every parameter is off by up to this part.")] = 0.0,
    delay_ms: Annotated[float, typer.Option(help="Delay of the line, each way.")] = 0.0,
    loss: Annotated[float, typer.Option(help="Part of the frames that get lost.")] = 0.0,
    corruption: Annotated[float, typer.Option(help="Part of the frames that get damaged.")] = 0.0,
    reset_every: Annotated[float, typer.Option(help="Power off and on so often, in s; 0 never.")] = 0.0,
    vouches: Annotated[
        bool, typer.Option("--vouches", help="It arms without a check: nothing is wired that could be wired wrong.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of noise, mismatch and the line's troubles.")] = 0,
) -> None:
    """Serve a simulated device; the first line says where. While it runs: reset, quit."""
    from controller.firmware.build import CORE, FIRMWARE, build, sources
    from controller.sim.plant_file import plant_bytes

    for name, value, high in (("mismatch", mismatch, 0.5), ("loss", loss, 1.0), ("corruption", corruption, 1.0)):
        within(name, value, 0.0, high)
    within("delay-ms", delay_ms, 0.0, 1e4, " ms")
    within("rest", rest, 0.0, 600.0, " s")
    if hold is not None:
        within("hold", hold, 0.5, 50.0, " N")
        if tap:
            raise InputError("--tap beside --hold: the hand taps or only holds; give one of them")
    within("reset-every", reset_every, 0.0, 1e6, " s")
    within("seed", seed, 0, 2**31 - 1)
    simulator, user = simulated(like, _taps(list(tap or TAPS)), rest, mismatch, seed, hold)
    program = build("transopt-device", [*sources(CORE), *sources(FIRMWARE / "host")])
    numbers = {
        "--delay-ms": delay_ms,
        "--loss": loss,
        "--corruption": corruption,
        "--reset-every": reset_every,
        "--seed": seed,
        "--boot": _boot(),
        "--simulated": float(vouches),
    }
    options = [word for name, value in numbers.items() for word in (name, repr(value))]
    done = _run_compiled(
        program,
        [*options, *([] if listen is None else ["--listen", listen])],
        plant_bytes(simulator, user, user.period_s),
    )
    if done > 0:
        raise typer.Exit(2)


def _boot() -> int:
    """Another number at every start."""
    import secrets

    return secrets.randbelow(1 << 31)


def main() -> None:
    """Entry point."""
    terminal.run(app, "transopt-device")


if __name__ == "__main__":
    main()
