"""Finds a command's device and who holds it: a port and a person, or the port `sim:` and a simulated hand.

What the commands do then is the same for both.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from rich.console import Console

from controller.device.device_file import BUILT_IN, DeviceFile
from controller.host.connection import Connection
from controller.host.payload import Payload, excitation_settings_of
from controller.servo.interface import State
from controller.servo.settings import Settings
from controller.sim.holding import HoldingHand, Wired
from controller.sim.port import Clock, SimulatedPort, core_end
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections, device_in
from controller.sim.tapping import SETTLE_S, TappingHand, tap_of
from controller.sim.true_device import TrueDevice
from transopt.scene.scene import Scene


def _nobody(grip_N: float | None) -> None:
    """A hand that taps is not asked to hold."""


@dataclass(frozen=True)
class Bench:
    """A device and whoever holds it.

    Attributes
    ----------
    port : by its name, or open.
    console : for what happens on the way; silent where nobody has to act on it.
    hold : asks for the stylus to be held still at a grip [N], to be let go at 0, to be held in any way at None.
    done : whether the run ends, given whether enough was played: with a person then, with a simulated hand once it
        has done all its taps and is at rest.
    remark : on the run, once it is over; empty without one.
    """

    port: str | Connection
    console: Console
    hold: Callable[[float | None], None] = _nobody
    done: Callable[[bool], bool] = lambda enough: enough
    remark: Callable[[], str] = lambda: ""

    @property
    def name(self) -> str:
        """Name of the port."""
        return self.port if isinstance(self.port, str) else self.port.name


def simulated_bench(
    given: Payload,
    device: TrueDevice,
    taps: Iterable[SimulatedTap],
    *,
    described: DeviceFile = BUILT_IN,
    clock: Clock | None = None,
    tapped: Callable[[], None] = lambda: None,
) -> tuple[Bench, TappingHand]:
    """The compiled core on a true device in a hand that taps once it is armed.

    Parameters
    ----------
    given : what the device shall play; others of its size and settings may follow.
    device : the true one, before the imperfections of the taps.
    described : how its sensors and its amplifier are wired.
    clock : paces the run; without one it takes no longer than it has to.
    tapped : called after each tap.

    Raises
    ------
    InputError : there is no C compiler.
    """
    dt_s, taps = given.settings.dt_s, list(taps)
    hand = TappingHand(dt_s, (tap_of(given.library, device, tap) for tap in taps), tapped=tapped)
    end = core_end(given.settings, len(given.image) // 2)
    port = SimulatedPort(end, Wired(hand, described), dt_s, clock=clock)

    def fell_behind() -> str:
        return "" if clock is None else f"fell behind the clock by {port.behind_s * 1e3:.1f} ms at most"

    bench = Bench(port, Console(quiet=True), done=lambda _: hand.done, remark=fell_behind)
    return bench, hand


def striking_bench(dt_s: float, described: DeviceFile = BUILT_IN) -> tuple[Bench, TappingHand]:
    """The compiled core, which is never armed, in a hand that strikes real objects.

    Raises
    ------
    InputError : there is no C compiler.
    """
    hand = TappingHand(dt_s, when=State.IDLE, pause_s=SETTLE_S)
    port = SimulatedPort(core_end(Settings(dt_s, 0.0, 1.0)), Wired(hand, described), dt_s)
    return Bench(port, Console(quiet=True), done=lambda _: hand.done), hand


def holding_bench(
    scene: Scene, wrong: Imperfections, seed: int, longest_s: float, described: DeviceFile = BUILT_IN
) -> tuple[Bench, Settings]:
    """The compiled core on a scene's device, which is held still, and its settings for excitations.

    Parameters
    ----------
    wrong : with the true device.
    longest_s : of the excitations.
    described : how its sensors and its amplifier are wired.

    Raises
    ------
    InputError : there is no C compiler.
    """
    dt_s = scene.time.dt_s
    settings = excitation_settings_of(scene, wrong.mismatch, described)
    hand = HoldingHand(device_in(scene, wrong, seed), dt_s, replace(wrong, mismatch=0.0), seed)
    port = SimulatedPort(core_end(settings, longest=round(longest_s / dt_s)), Wired(hand, described), dt_s)
    return Bench(port, Console(quiet=True), hold=lambda grip_N: hand.hold(grip_N or 0.0)), settings
