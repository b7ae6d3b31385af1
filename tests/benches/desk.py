"""A device on a desk in virtual time: compiled core, simulated stylus, and a hand that does as it is asked."""

from bisect import bisect_right
from collections.abc import Callable
from itertools import count

import pytest

from controller.cli import port as port_commands
from controller.host.connection import Connection, UnpluggedError
from controller.host.driver import Device
from controller.host.session import Session
from controller.protocol.capacity import Hardware
from controller.servo.interface import Output, Readings
from controller.sim.port import SimulatedPort
from controller.sim.simulator import Simulator
from controller.sim.true_device import device_of
from tests.benches.device import started, tokens
from tests.benches.probed import ProbedDevice
from tests.benches.virtual_link import Link
from transopt.library.library import Library
from transopt.recordings.settings import SimulatedTaps

DT_S = 1e-4
START_M = 12e-3
PORT = ("--port", "desk")


class Hand:
    """Moves by velocity knots joined by straight lines; still between two requests.

    Attributes
    ----------
    held_N : grip. pressed : of the emergency stop.
    """

    def __init__(self, held_N: float = 3.0) -> None:
        self.held_N, self.pressed = held_N, False
        self._times, self._speeds, self._places = [0.0], [0.0], [START_M]

    @property
    def place_m(self) -> float:
        """The hand will be at rest at this place."""
        return self._places[-1]

    @property
    def free_s(self) -> float:
        """The hand will be at rest from this instant on."""
        return self._times[-1]

    def go(self, now_s: float, *knots: tuple[float, float]) -> None:
        """(after so long, this velocity) ..., from where the hand is, at rest at the end."""
        for after_s, speed_m_s in ((1e-3, self._speeds[-1]), *knots):
            time_s = max(now_s, self._times[-1]) + after_s
            step_s = time_s - self._times[-1]
            self._places.append(self._places[-1] + step_s * (self._speeds[-1] + speed_m_s) / 2)
            self._times.append(time_s)
            self._speeds.append(speed_m_s)
            now_s = time_s
        assert self._speeds[-1] == 0.0

    def tap(self, now_s: float, speed_m_s: float) -> None:
        """From where it is straight in at the speed, on for 30 ms, and back."""
        v = speed_m_s
        straight_s = self._places[-1] / v + 0.03 - 0.005
        back_s = 0.3
        depth = v * (0.01 / 2 + straight_s + 0.06 / 2)
        self.go(
            now_s,
            (0.01, -v),
            (straight_s, -v),
            (0.06, 0.0),
            (0.05, 0.0),
            (back_s, 2 * depth / back_s / 2),
            (back_s, 0),
        )

    def back(self, now_s: float) -> None:
        """To where it was at first, if it is somewhere else."""
        way_m = START_M - self._places[-1]
        if abs(way_m) > 1e-6:
            self.go(now_s, (0.03, way_m / 0.1), (0.07, way_m / 0.1), (0.03, 0.0))

    def shake(self, now_s: float) -> None:
        """Out and in, by a centimetre, three times a second, for 1.5 s."""
        self.go(now_s, *((1 / 6, (-1) ** j * 0.06) for j in range(9)), (1 / 6, 0.0))

    def intention_m(self, time_s: float) -> float:
        j = bisect_right(self._times, time_s) - 1
        into_s = time_s - self._times[j]
        if j + 1 == len(self._times):
            return self._places[j]
        slope = (self._speeds[j + 1] - self._speeds[j]) / (self._times[j + 1] - self._times[j])
        return self._places[j] + into_s * (self._speeds[j] + slope * into_s / 2)

    def carried_m_s2(self, time_s: float) -> float:
        return 0.0

    def grip_N(self, time_s: float) -> float:
        return self.held_N


class Cable(SimulatedPort):
    """A simulated port that can be unplugged, and that the host takes for a device that can do harm.

    Attributes
    ----------
    gone : the cable is out.
    closed : how often the host has let go of the port.
    """

    name, harmless = "device", False
    gone, closed = False, 0

    def _need_cable(self) -> None:
        if self.gone:
            raise UnpluggedError("port: the connection is gone (test): plug the device in again")

    def step(self) -> None:
        self._need_cable()
        super().step()

    def write(self, data: bytes) -> None:
        self._need_cable()
        super().write(data)

    def close(self) -> None:
        self.closed += 1


class Desk(Cable):
    """A simulated port and the world behind it.

    Attributes
    ----------
    link : to the host. wrong : what is wrong with the sensors: applied to every tick's readings.
    motor : of the command on its way.
    each_ms : called every millisecond of virtual time, for what shall happen meanwhile.
    """

    def __init__(
        self,
        library: Library,
        *,
        samples: int | None = None,
        hardware: Hardware | None = None,
        target: SimulatedTaps | None = None,
        gravity_m_s2: float = 0.0,
        simulated: bool = True,
    ) -> None:
        self._tokens, self._boots = tokens(), count(500)
        self._samples, self._hardware, self._gravity_m_s2 = samples, hardware, gravity_m_s2
        self._simulated = simulated
        self.link = Link()
        super().__init__(self._started(), self, DT_S, line=self.link)
        self.hand = Hand()
        self.plant = Simulator(device_of(library.scene()), self.hand, DT_S, target=target, steps=1)
        self.wrong: Callable[[Readings], Readings] | None = None
        self.motor = 1.0
        self.each_ms: Callable[[], None] = lambda: None
        self.requests: list[str] = []
        self.obeys: dict[str, Callable[[], None]] = {
            "press": lambda: self._press(True),
            "release": lambda: self._press(False),
            "move": lambda: self.hand.go(self.now_s(), (0.03, 0.1), (0.07, 0.1), (0.03, 0.0)),
            "let the": lambda: self.hand.back(self.now_s()),
            "shake": lambda: self.hand.shake(self.now_s()),
            "let go": lambda: self._grip(0.0),
            "hold": lambda: self._grip(3.0),
            "put the weight": lambda: self._grip(3.0),
            "tap": lambda: self.hand.tap(self.now_s(), 0.2),
        }

    def _started(self) -> ProbedDevice:
        return started(next(self._boots), self._hardware, self._samples, simulated=self._simulated)

    def _press(self, pressed: bool) -> None:
        self.hand.pressed = pressed

    def _grip(self, held_N: float) -> None:
        self.hand.held_N = held_N

    def asked(self, what: str) -> None:
        """A person's ear."""
        self.requests.append(what)
        next(act for words, act in self.obeys.items() if what.startswith(words))()

    def restart(self) -> None:
        """Power off and on."""
        self.end = self._started()

    def readings(self, tick: int) -> Readings:
        readings = self.plant.readings()
        if self._gravity_m_s2 or self.hand.pressed:
            felt = readings.acceleration_m_s2 + self._gravity_m_s2
            readings = readings._replace(acceleration_m_s2=felt, emergency_stop=self.hand.pressed)
        return readings if self.wrong is None else self.wrong(readings)

    def advance(self, output: Output) -> None:
        self.plant.advance(self.motor * output.command_A)

    def step(self) -> None:
        super().step()
        if self.ticks % 10 == 0:
            self.each_ms()

    def connect(self, port: str | Connection = "desk") -> Device:
        return Device(self if isinstance(port, str) else port, session=Session(self._tokens))

    def pass_check(self, configuration: bytes) -> None:
        """Bring this configuration into force as if it had passed the bring-up check."""
        with self.connect() as device:
            device.configure(configuration)

    def put(self, monkeypatch: pytest.MonkeyPatch) -> "Desk":
        """Put the desk where the commands find it, under any name of a port."""
        monkeypatch.setattr(port_commands, "open_device", self.connect)
        monkeypatch.setattr(port_commands, "ConsolePerson", lambda: self)
        return self
