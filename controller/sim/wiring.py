"""A simulated world behind the sensors that a device file describes: what a device reads before it puts it right."""

from controller.device.device_file import DeviceFile
from controller.servo.interface import Output, Readings
from controller.sim.port import World


class Wired:
    """A world of true readings, as the sensors of a device give them.

    A `controller.sim.port.World`. The world's own counts are 0 at the surface; `surface_counts` are read there.

    Parameters
    ----------
    world : with the encoder's resolution, the accelerometer's bandwidth and the noise of both in it already.
    """

    def __init__(self, world: World, device: DeviceFile) -> None:
        self._world, self._device = world, device
        # Counts are whole numbers; what is left of the surface's place is less than one.
        self._surface = round(device.encoder.surface_counts)

    def readings(self, tick: int) -> Readings:
        true = self._world.readings(tick)
        return Readings(
            tick,
            true.encoder_counts + self._surface,
            true.grip_N if self._device.grip.sensor else float("nan"),
            true.current_A,
            true.acceleration_m_s2,
            true.emergency_stop,
        )

    def advance(self, output: Output) -> None:
        self._world.advance(output)
