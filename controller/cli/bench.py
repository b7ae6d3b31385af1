"""Where a command finds its device and who holds it: a port and a person, or the port `sim:` and a simulated hand.

What the commands do then is the same for both.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich.console import Console

from controller.host.connection import Connection
from controller.host.payload import Payload
from controller.servo.loop import Clock
from controller.sim.port import SimulatedPort, core_end
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.tapping import TappingHand
from controller.sim.true_device import TrueDevice
from controller.sim.user import Habit


@dataclass(frozen=True)
class Bench:
    """A device and whoever holds it.

    Attributes
    ----------
    port : by its name, or open.
    console : for what happens on the way; silent where nobody has to act on it.
    done : whether the run ends, given whether enough was played: with a person then, with a simulated hand once it
        has done all its taps and is at rest.
    as_recorded : the hand is known to move as those in the library's recordings did.
    remark : on the run, once it is over; empty without one.
    """

    port: str | Connection
    console: Console
    done: Callable[[bool], bool] = lambda enough: enough
    as_recorded: bool = False
    remark: Callable[[], str] = lambda: ""


def simulated_bench(
    given: Payload,
    device: TrueDevice,
    taps: Sequence[SimulatedTap],
    *,
    clock: Clock | None = None,
    tapped: Callable[[], None] = lambda: None,
) -> tuple[Bench, TappingHand]:
    """The compiled core on a true device in a hand that taps once it is armed.

    Parameters
    ----------
    given : what the device shall play; others of its size and settings may follow.
    device : the true one, before the imperfections of the taps.
    clock : paces the run; without one it takes no longer than it has to.
    tapped : called after each tap.

    Raises
    ------
    InputError : there is no C compiler.
    """
    hand = TappingHand(given.library, device, taps, tapped)
    end = core_end(given.settings, len(given.image) // 2)
    port = SimulatedPort(end, hand, given.settings.dt_s, clock=clock)

    def fell_behind() -> str:
        return "" if clock is None else f"fell behind the clock by {port.behind_s * 1e3:.1f} ms at most"

    as_recorded = any(tap.habit is Habit.RECORDED for tap in taps)
    return Bench(port, Console(quiet=True), lambda _: hand.done, as_recorded, fell_behind), hand
