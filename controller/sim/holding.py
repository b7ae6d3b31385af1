"""Worlds behind the port `sim:`: a hand that holds the stylus still, and a device file's raw readings."""

from controller.device.device_file import DeviceFile
from controller.servo.interface import Output, Readings, State
from controller.sim.port import World
from controller.sim.sensors import noise_seed
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.tapping import straight_way
from controller.sim.true_device import TrueDevice
from controller.sim.user import StillHand


class HoldingHand:
    """A hand that takes hold of the stylus at each request, or lets go at 0 N; a `controller.sim.port.World`.

    Each hold is a separate simulation with its own noise. Before the device is armed nothing is integrated: the
    sensors read, without noise, the place where the stylus is held, or its way back there.

    Parameters
    ----------
    device : the true device, mismatch included.
    imperfections : those of the sensors; its mismatch is already in `device`.
    """

    def __init__(self, device: TrueDevice, dt_s: float, imperfections: Imperfections, seed: int) -> None:
        self._device, self._dt_s, self._imperfections, self._seed = device, dt_s, imperfections, seed
        self._holds = self._counts = 0
        self.hold(0.0)
        self._way.clear()

    def hold(self, grip_N: float) -> None:
        """Hold the stylus still with this grip at its initial place."""
        self._simulator = Simulator(
            self._device,
            StillHand(grip_N),
            self._dt_s,
            imperfections=self._imperfections,
            seed=noise_seed(self._seed, self._holds),
            steps=1,  # the intention rests, so the linear flow is exact over any step
        )
        self._holds += 1
        self._grip_N, self._moves = grip_N, False
        there = self._simulator.readings().encoder_counts
        self._way = straight_way(self._counts, there, self._dt_s, self._simulator.sensors.count_m)
        self._counts = there

    def readings(self, tick: int) -> Readings:
        if not self._moves:
            return Readings(tick, self._way[-1] if self._way else self._counts, self._grip_N, 0.0, 0.0)
        read = self._simulator.readings()
        self._counts = read.encoder_counts
        return Readings(tick, read.encoder_counts, read.grip_N, read.current_A, read.acceleration_m_s2)

    def advance(self, output: Output) -> None:
        """One servo period; once the device has been armed, the stylus may move and keeps ringing."""
        self._moves = self._moves or output.state in (State.ARMED, State.PLAYING)
        if self._moves:
            self._simulator.advance(output.command_A)
        elif self._way:
            self._way.pop()


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
        self._world.advance(output if scale == 1.0 else output._replace(command_A=scale * output.command_A))
