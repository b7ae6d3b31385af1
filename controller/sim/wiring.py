"""A simulated world behind the sensors of a device file: the raw readings, before the device calibrates them."""

from dataclasses import replace

from controller.device.device_file import DeviceFile
from controller.servo.interface import Output, Readings
from controller.sim.port import World


class Wired:
    """A world whose calibrated readings are turned into raw ones of a device; a `controller.sim.port.World`.

    The inner world's counts are 0 at the surface; the raw encoder reads `surface_counts` there.

    Parameters
    ----------
    world : includes the encoder's resolution, the accelerometer's bandwidth and the noise of both.
    """

    def __init__(self, world: World, device: DeviceFile) -> None:
        self._world, self._device = world, device
        # Counts are whole numbers, so the surface is rounded; the error is below one count.
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
