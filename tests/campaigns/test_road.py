"""The manual's road for a device of one's own, walked by its own commands, on motors that are not the built-in one.

    python -m pytest -m long -n 0 tests/campaigns/test_road.py --campaign="[--device NAME] [--out DIR]"

Every command of `docs/howto/road.md` that names this file before it is run as it stands there; only the circuit file
is changed, as its reader has to. The device has equations of its own (`benches.own_device`): another motor, encoder,
amplifier, and every parameter off by up to 10 %. A scripted person answers, touches, holds and taps. Then a library
that was solved with the true parameters is played to the same taps on the same device. It fails if a command ends
with another exit code than 0, or a tap's error is more than 2 points above that of who knows the device.
"""

import io
import re
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import chdir, redirect_stdout
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from typer import Option

from controller.device.circuit_file import load_circuit
from controller.device.reading import read_device
from controller.host.connection import Connection
from controller.host.driver import Device
from controller.host.kept import remember_pulse
from controller.servo.interface import Output, State
from tests.benches.own_device import ABOVE_M, OwnWorld, Sensing, Truth, eased
from tests.benches.probed import ProbedDevice
from tests.campaigns.harness import JsonFile, Seed, long_form, show, words_of, write_json
from tests.campaigns.test_desk import DT_S, ROW, Desk, at_the_desk, typed
from transopt.design.build import build_library
from transopt.scene.builtin import load_scene
from transopt.scene.keys import with_values
from transopt.scene.recordings import recordings_of

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "road.md"
WALK = re.compile(
    r"^<!-- not run: tests/campaigns/test_road.py walks it -->\n```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL
)
SURFACE, RATIO, OFF = 1234, 53.4, 0.1
SPEEDS_M_S, GRIPS_N = (0.11, 0.2, 0.3, 0.38), (1.0, 3.0, 5.0)
MOST_ABOVE = 0.02


@dataclass(frozen=True)
class Own:
    """A device that is not the built-in one: force on the built-in's, lines of its encoder, loop of its amplifier."""

    force: float
    lines: int
    pole_Hz: float
    delay_s: float
    example: str

    def truth(self, seed: int) -> Truth:
        drawn = Truth(force_N_A=1.25 * self.force, R_ohm=1.2, L_H=0.3e-3).drawn(OFF, np.random.default_rng(seed))
        return Truth(**{**vars(drawn), "pole_Hz": self.pole_Hz * 1.1, "delay_s": self.delay_s})


DEVICES = {
    "half": Own(0.5, 1250, 700.0, 90e-6, "escon_re25"),
    "triple": Own(3.0, 2000, 1800.0, 50e-6, "bridge_re40"),
}
MOTOR = """\
name = "own"
datasheet = "own"
R_ohm = 1.2
L_H = 0.3e-3
kt_Nm_A = {kt_Nm_A}
rotor_kg_m2 = 1.03e-6
i_continuous_A = 1.5
i_peak_A = 20.0
R_wh_K_W = 3.1
R_ha_K_W = 14.0
tau_w_s = 12.0
tau_h_s = 612.0
winding_max_C = 100.0
"""


class World(OwnWorld):
    """A device and a person who also touches the surface, and taps in turn while it is armed."""

    def __init__(self, own: Own, seed: int) -> None:
        count_m = 2 * np.pi / (4 * own.lines * RATIO)
        super().__init__(
            DT_S, truth=own.truth(seed), sensing=Sensing(count_m=count_m, surface_counts=SURFACE), seed=seed
        )
        self.taps: Iterator[tuple[float, float]] = iter(())
        self.free_s, self.touching = 0.0, False

    def asked(self, what: str) -> None:
        self.touching = what.startswith("touch")
        if self.touching:
            begin_s = self.now_s
            self.path_m = lambda t: ABOVE_M * (1 - eased(4 * (0.5 - abs((t - begin_s) % 1.0 - 0.5))))
        else:
            super().asked(what)

    def hand_m(self, time_s: float) -> float:
        # On a stop that does not give way a hand does not tremble.
        return self.path_m(time_s) if self.touching else super().hand_m(time_s)

    def begin(self, command: str) -> None:
        """Another command is typed: the stylus is held above the surface, and tapped with where it is asked for."""
        taps = [(v, g) for g in GRIPS_N for v in SPEEDS_M_S] if command in ("tap", "refine") else []
        self.taps, self.free_s, self.touching = cycle(taps), 0.0, False
        self.person.go(ABOVE_M, 0.3)

    def advance(self, output: Output) -> None:
        if output.state is State.ARMED and self.now_s >= self.free_s:
            speed, self.grip_N = next(self.taps, (0.0, self.grip_N))
            if speed:
                self.person.tap(speed)
                self.free_s = self.now_s + 2.0
        super().advance(output)


def commands() -> list[str]:
    """Every command line that is walked."""
    blocks = WALK.findall(PAGE.read_text(encoding="utf-8"))
    return [line for block in blocks for line in block.splitlines() if not line.startswith("#")]


def changed(own: Own, text: str) -> str:
    """The circuit file as the reader of the page changes the example."""
    for key, value in (
        ("motor", '"motor.toml"'),
        ("pole_Hz", own.pole_Hz),
        ("delay_s", own.delay_s),
        ("lines", own.lines),
    ):
        text, found = re.subn(rf"^{key} = [^#\n]*", f"{key} = {value} ", text, flags=re.M)
        assert found == 1, key
    return text + ("" if "[grip]" in text else "\n[grip]\nV_per_unit = 0.0537\nzero_V = 0.16\n")


def walk(own: Own, seed: int, steps: int | None = None) -> str:
    """Go through the first commands, or all, in the working folder; what the last `tap` said.

    Raises
    ------
    InputError : a command ended with another exit code than 0.
    """
    world, said = World(own, seed), ""
    Path("motor.toml").write_text(MOTOR.format(kt_Nm_A=1.25 * own.force / RATIO), encoding="utf-8")
    with at_the_desk(world, opened(world)):
        for line in commands()[:steps]:
            command, _, out = line.replace("escon_re25", own.example).replace("PORT", "desk").partition(" > ")
            words = [found for word in shlex.split(command) for found in globbed(word)]
            world.begin(words[1])
            heard = run(words)
            if out:
                Path(out).write_text(changed(own, heard), encoding="utf-8")
            said = heard if words[1] == "tap" else said
    return said


def opened(world: World) -> Callable[[str | Connection], Device]:
    """What opens the device, on hardware that the circuit file says as soon as there is one."""
    found: list[Desk] = []

    def connect(port: str | Connection) -> Device:
        if not found:
            core = ProbedDevice(1, load_circuit(Path("circuit.toml"))[0].hardware)
            found.append(Desk(core, world, DT_S))
        return found[0].connect(port)

    return connect


def globbed(word: str) -> list[str]:
    return sorted(map(str, Path().glob(word))) if "*" in word else [word]


def run(words: list[str]) -> str:
    """What a command prints, with a person who takes all that is offered."""
    print(f"$ {' '.join(words)}", flush=True)
    heard, keyboard = io.StringIO(), sys.stdin
    sys.stdin = io.StringIO("\n" * 40)
    try:
        with redirect_stdout(heard):
            typed(*words)
    finally:
        sys.stdin = keyboard
        print("\n".join(heard.getvalue().splitlines()[-12:]), flush=True)
    return heard.getvalue()


def known(own: Own, seed: int) -> str:
    """What the same taps come to with a library that was solved for the true device."""
    t, world = own.truth(seed), World(own, seed)
    motor = load_circuit(Path("circuit.toml"))[0].motor
    scene = with_values(
        load_scene("scene.toml"),
        {
            "motor.kt_Nm_A": t.force_N_A / RATIO,
            "transmission.link_mass_kg": t.motor_kg - motor.rotor_kg_m2 * RATIO**2,
            "transmission.stiffness_N_m": t.drive_N_m,
            "transmission.damping_N_s_m": t.drive_N_s_m,
            "model.stylus_mass_kg": t.stylus_kg,
            "model.hand.mass_kg": t.hand_kg,
            "model.hand.skin_stiffness_N_m.constant": t.skin_N_m,
            "model.hand.skin_stiffness_N_m.per_newton": t.skin_N_m_N,
            "model.hand.skin_damping_N_s_m.constant": t.skin_N_s_m,
            "model.hand.skin_damping_N_s_m.per_newton": t.skin_N_s_m_N,
            "model.hand.arm_stiffness_N_m.constant": t.arm_N_m,
            "model.hand.arm_stiffness_N_m.per_newton": t.arm_N_m_N,
            "model.hand.arm_damping_N_s_m.constant": t.arm_N_s_m,
            "model.hand.arm_damping_N_s_m.per_newton": t.arm_N_s_m_N,
            "amplifier.pole_Hz": t.pole_Hz,
            "amplifier.delay_s": t.delay_s,
        },
    )
    library = build_library(scene, recordings_of(scene)).library
    library.save(Path("known.npz"))
    where = ["known.npz", "--device", "device.toml", "--port", "desk"]
    with at_the_desk(world, opened(world)):
        world.begin("check")
        run(["transopt-play", "check", *where])
        world.begin("tap")
        return run(["transopt-play", "tap", *where, "--taps", "12"])


def tap_errors(said: str) -> list[tuple[float, float, float]]:
    """Speed, grip and tap error of each tap of a table."""
    rows = filter(None, map(ROW.match, said.splitlines()))
    return [(float(row[1]), float(row[2]), float(row[4]) / 100) for row in rows]


def judged(name: str, seed: int) -> tuple[int, list[dict[str, float]]]:
    """0 if all taps are as near to the best as they should be; and their errors."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        mine = tap_errors(walk(DEVICES[name], seed))
        best = tap_errors(known(DEVICES[name], seed))
    rows = [
        {"speed_m_s": v, "grip_N": g, "tap_error": own, "known": other}
        for (v, g, own), (_, _, other) in zip(mine, best, strict=True)
    ]
    show(
        ("m/s", "N", "tap error %", "who knows it %"),
        [[f"{100 * x:.2f}" if j > 1 else f"{x:.3f}" for j, x in enumerate(row.values())] for row in rows],
    )
    above = max(row["tap_error"] - row["known"] for row in rows)
    print(f"{name}, seed {seed}: at most {100 * above:.2f} points above who knows the device", flush=True)
    return int(above > MOST_ABOVE), rows


def main(
    device: Annotated[str, Option(help="half, triple, or both with a comma")] = "half,triple",
    seeds: Annotated[int, Option(help="that many devices of each, from --seed on")] = 1,
    seed: Seed = 0,
    json: JsonFile = None,
) -> int:
    results = {
        f"{name} {number}": judged(name, number)
        for name in words_of(device, DEVICES)
        for number in range(seed, seed + seeds)
    }
    write_json({name: rows for name, (_, rows) in results.items()}, json)
    return max(code for code, _ in results.values())


test_long_form = long_form(main)


def test_the_road_to_the_first_current(c_compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To the end of the first check, where each motor but the built-in one was refused."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    checks = [line for line in commands() if "transopt-play check" in line]
    remember_pulse(bytes(32), 15.0)  # on another device
    with chdir(tmp_path):
        walk(DEVICES["triple"], 0, commands().index(checks[0]) + 1)
        surface = read_device(Path("device.toml")).device.encoder.surface_counts
    assert surface == pytest.approx(SURFACE, abs=2)
