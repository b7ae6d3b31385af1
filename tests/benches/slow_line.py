"""A port with a line of a stated rate and an adapter that keeps what it has for a while, in virtual time."""

from controller.host.connection import Connection
from controller.host.driver import Device
from controller.protocol.wire import DELIMITER
from controller.sim.port import SimulatedPort, World
from tests.benches.probed import ProbedDevice
from tests.benches.virtual_link import Link, Trouble

UART_BITS, DRIVER_BYTES = 10, 4096


class SlowLine(SimulatedPort):
    """What the device sends waits in a driver's buffer, which tells the device its room as a port does.

    Parameters
    ----------
    baud : of the line. latency_s : of the adapter, each way.
    """

    name, harmless = "slow line", False

    def __init__(self, core: ProbedDevice, world: World, dt_s: float, baud: float, latency_s: float = 16e-3) -> None:
        self.link = Link(Trouble(latency_s=latency_s))
        super().__init__(core, world, dt_s, line=self.link)
        self._core, self._rate_B, self._credit_B = core, baud / UART_BITS * dt_s, 0.0
        self._waiting, self._sent = b"", b""

    def step(self) -> None:
        now_s = self.now_s()
        if arrived := self.link.to_device.arrived(now_s):
            self._core.receive(arrived)
        self.world.advance(self._core.step(self.world.readings(self.ticks)))
        self._core.ROOM_BYTES = DRIVER_BYTES - len(self._waiting)
        self._waiting += self._core.bytes_to_send()
        self._credit_B = min(self._credit_B + self._rate_B, float(len(self._waiting)))
        whole = int(self._credit_B)
        if whole:
            self._credit_B -= whole
            self._sent, self._waiting = self._sent + self._waiting[:whole], self._waiting[whole:]
            end = self._sent.rfind(DELIMITER) + 1
            self.link.device_sends(self._sent[:end], now_s)
            self._sent = self._sent[end:]
        self.ticks += 1

    def connect(self, port: str | Connection) -> Device:
        return Device(self)
