"""A simulated hand that holds the stylus still with a requested grip: a world behind the port `sim:`."""

from controller.servo.interface import Output, Readings, State
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
