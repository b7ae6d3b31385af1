"""What the bring-up check makes of wrong wires: every error refused by its name, every sound device passed.

    python -m pytest -m long -n 0 tests/campaigns/test_wirings.py
        --campaign="[LIBRARY] [--jobs 2] [--json FILE]"

A device with equations of its own (`common.own_device`) and a scripted person stand behind the compiled core, in
virtual time; the check is the one that `transopt-play check` runs, the device file that of a sound device. One part
after the other is wired wrong: motor, amplifier, current monitor, encoder and accelerometer reversed, 0.3, 0.5, 2, 3
and 8 times too large, dead; the grip sensor reversed, dead, stuck, and of another scale with and without a known
weight; analog inputs exchanged; twenty pairs of errors; and ten sound devices whose every parameter is off by up to
10 %. It fails if an error passes, is called by another part's name, lets a transient at gain 1 begin, or a sound
device is refused.
"""

import itertools
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from controller.device.device_file import Accelerometer, DeviceFile
from controller.host.bringup import drop_evidence, passed, run_steps
from controller.host.check_state import Check
from controller.host.driver import Device, DeviceError
from controller.host.payload import payload_of
from controller.sim.port import SimulatedPort
from tests.benches.own_device import OwnWorld, Sensing, Truth, Wires
from tests.benches.probed import ProbedDevice
from tests.campaigns import test_desk as desk
from tests.campaigns.harness import Jobs, JsonFile, LibraryFile, Seed, each, library_of, long_form, show, write_json
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.library.library import Library

DT_S = 1e-4
PATIENCE_S = 3.0
FACTORS = (-1.0, 0.3, 0.5, 2.0, 3.0, 8.0, 0.0)
PARTS = ("motor", "amplifier", "monitor", "encoder", "accelerometer")
# How the check calls each part.
WORDS = {
    "motor": "the motor pushes",
    "amplifier": "the amplifier gives",
    "monitor": "the current monitor reads",
    "encoder": "the encoder reads",
    "accelerometer": "the accelerometer reads",
    "grip": "the grip sensor reads",
}
INPUTS = {"current_A": "monitor", "acceleration_m_s2": "accelerometer", "grip_N": "grip"}
PAIRS, SOUND, OFF = 20, 10, 0.1
WEIGHT_G = 300.0
LEVEL = DeviceFile(name="trial", accelerometer=Accelerometer(rest_m_s2=STANDARD_GRAVITY_M_S2))
UPRIGHT = DeviceFile(name="trial")


@dataclass(frozen=True)
class Case:
    """One wiring.

    Attributes
    ----------
    names : parts of which one has to be called by its name; empty for any refusal, None for a pass.
    upright : gravity does not act along the accelerometer.
    truth : of the device; None for the one that the library was solved for.
    weight_g : that the grip sensor is checked with; None without one.
    says : what some step has to say.
    seed : of noise and tremor.
    """

    name: str
    wires: Wires
    names: tuple[str, ...] | None
    upright: bool = False
    truth: Truth | None = None
    weight_g: float | None = None
    says: str = ""
    seed: int = 0


@dataclass(frozen=True)
class Outcome:
    """Outcome of one case: what the check said, whether that is right, whether gain 1 was armed."""

    case: str
    wanted: str
    said: str
    armed: bool
    right: bool


class Port(SimulatedPort):
    """A port that the host takes for one of a device that can do harm."""

    name, harmless = "own device", False


def _times(factor: float) -> str:
    return {-1.0: "reversed", 0.0: "dead"}.get(factor, f"x {factor:g}")


def cases(seed: int) -> list[Case]:
    """All wirings."""
    random = np.random.default_rng(seed)
    single = [
        Case(
            f"{part} {_times(factor)}",
            replace(Wires(), **{part: factor}),
            (part,),
            upright=bool(j % 2),
        )
        for part in PARTS
        for j, factor in enumerate(FACTORS)
    ]
    grip = [
        Case("grip reversed", Wires(grip=-1.0), ("grip",)),
        Case("grip dead", Wires(grip=0.0), ("grip",)),
        Case("grip stuck", Wires(stuck_grip_N=2.5), ("grip",)),
        *[Case(f"grip x {k:g}, weight", Wires(grip=k), ("grip",), weight_g=WEIGHT_G) for k in (0.5, 2.0)],
        Case("grip x 1.4, no weight: said not to be checked", Wires(grip=1.4), None, says="its scale is not checked"),
        Case("grip x 1, weight", Wires(), None, weight_g=WEIGHT_G),
    ]
    swapped = [
        Case(
            f"{INPUTS[one]} and {INPUTS[other]} exchanged", Wires(swapped=(one, other)), (INPUTS[one], INPUTS[other])
        )
        for one, other in itertools.combinations(INPUTS, 2)
    ]
    swapped += [
        Case("encoder with one channel", Wires(open_channel=True), ("encoder",)),
        Case("motor leads and encoder channels exchanged", Wires(motor=-1.0, encoder=-1.0), ("motor", "encoder")),
        Case("motor leads and monitor exchanged", Wires(motor=-1.0, monitor=-1.0), ("motor", "monitor", "amplifier")),
    ]
    pairs = []
    for j in range(PAIRS):
        one, other = random.choice(PARTS, 2, replace=False)
        k, m = random.choice([factor for factor in FACTORS if factor != 0.0], 2)
        wires = replace(Wires(), **{str(one): float(k), str(other): float(m)})
        pairs.append(Case(f"{one} {_times(k)}, {other} {_times(m)}", wires, (), upright=bool(j % 2)))
    # Errors that hide each other in one of the readings.
    pairs[:4] = [
        Case("amplifier x 3, monitor x 1/3", Wires(amplifier=3.0, monitor=1 / 3), ()),
        Case("motor x 2, accelerometer x 1/2", Wires(motor=2.0, accelerometer=0.5), (), upright=True),
        Case("encoder x 2, accelerometer x 2", Wires(encoder=2.0, accelerometer=2.0), (), upright=True),
        Case("amplifier x 2, motor x 1/2", Wires(amplifier=2.0, motor=0.5), ()),
    ]
    sound = [
        Case(
            f"sound, every parameter within {100 * OFF:g} %, {j + 1}",
            Wires(),
            None,
            upright=bool(j % 2),
            truth=Truth().drawn(OFF, random),
            seed=j,
        )
        for j in range(SOUND)
    ]
    return [*single, *grip, *swapped, *pairs, *sound]


def judged(library: Library, case: Case) -> Outcome:
    """Go through the check with this wiring, then try to arm in full."""
    described = UPRIGHT if case.upright else LEVEL
    gravity = 0.0 if case.upright else STANDARD_GRAVITY_M_S2
    world = OwnWorld(
        DT_S, truth=case.truth, wires=case.wires, sensing=Sensing(gravity_m_s2=gravity), seed=case.seed + 17
    )
    given = payload_of(library, device=described)
    with Device(Port(ProbedDevice(1, simulated=False), world, DT_S)) as device:
        device.configure(given.configuration)
        device.upload(given.image)
        device.set_telemetry(1)
        check = Check(
            device,
            given.settings,
            world,
            loaded=True,
            described=described,
            library=library,
            grip_weight_N=None if case.weight_g is None else 1e-3 * case.weight_g * STANDARD_GRAVITY_M_S2,
            configuration=given.configuration,
            patience_s=PATIENCE_S,
        )
        results = run_steps(check)
        good = passed(check, results)
        if not good:
            drop_evidence(check)
        armed = _armed(device)
    said = "; ".join(check.off)
    if good:
        said = "passed"
    elif not said:
        said = "; ".join(f"{result.name}: {result.seen}" for result in results if result.passed is False)
    if case.names is None:
        right = good and armed and any(case.says in result.seen for result in results)
    else:
        named = not case.names or any(WORDS[name] in said for name in case.names)
        right = not good and not armed and named
    wanted = "pass" if case.names is None else " or ".join(case.names) or "any refusal"
    return Outcome(case.name, wanted, said, armed, right)


def _armed(device: Device) -> bool:
    """Whether a tap at gain 1 could follow."""
    try:
        if device.fault is not None:
            device.reset()
        device.listen(1.0)
        device.arm(1.0)
        device.disarm()
    except DeviceError:
        return False
    return True


def main(
    library: LibraryFile = None,
    jobs: Jobs = 2,
    seed: Seed = 0,
    json: JsonFile = None,
) -> int:
    outcomes = list(each(partial(judged, library_of(library)), cases(seed), jobs))
    rows = [(o.case, o.wanted, o.said, "yes" if o.armed else "no", "right" if o.right else "WRONG") for o in outcomes]
    show(("wiring", "wanted", "the check said", "gain 1", "verdict"), rows)
    wrong = [o for o in outcomes if not o.right]
    print(f"{len(outcomes) - len(wrong)} of {len(outcomes)} right")
    write_json([o.__dict__ for o in outcomes], json)
    return 1 if wrong else 0


test_long_form = long_form(main)


SHORT = ("amplifier x 3, monitor x 1/3", "sound, every parameter within 10 %, 2", "encoder with one channel")
# Errors that hide each other, and a sound device; a part that is dead and a wrong scale: `test_bringup.py`.
QUICK = [case for case in cases(0) if case.name in SHORT]


@pytest.mark.parametrize("case", QUICK, ids=[case.name for case in QUICK])
def test_a_wiring_is_judged_right(library: Library, c_compiler: None, case: Case) -> None:
    outcome = judged(library, case)
    assert outcome.right, outcome


def test_taps_on_a_desk(library: Library, c_compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of the twelve."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(desk, "EACH", 1)
    monkeypatch.setattr(desk, "SPEEDS_M_S", (0.3,))
    assert desk.judged(library, tmp_path, 0, None) == 0
