"""A simulated world behind the sensors that a device file describes: what a device reads before it puts it right."""

from dataclasses import replace

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
        true, device = self._world.readings(tick), self._device
        grip, accelerometer = device.grip, device.accelerometer
        nothing = float("nan")
        return Readings(
            tick,
            device.encoder.direction * (true.encoder_counts + self._surface),
            (true.grip_N + grip.zero_N) / grip.scale if grip.sensor else nothing,
            true.current_A / device.amplifier.monitor_scale,
            (true.acceleration_m_s2 + accelerometer.rest_m_s2) / accelerometer.scale if accelerometer.sensor else 0.0,
            true.emergency_stop,
        )

    def advance(self, output: Output) -> None:
        scale = self._device.amplifier.scale
        self._world.advance(output if scale == 1.0 else replace(output, command_A=scale * output.command_A))
