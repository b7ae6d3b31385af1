"""A simulated hand that holds the stylus still, as firmly as it is asked: a world behind the port `sim:`."""

from controller.servo.interface import Output, Readings, State
from controller.sim.sensors import noise_seed
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.tapping import straight_way
from controller.sim.true_device import TrueDevice
from controller.sim.user import StillHand


class HoldingHand:
    """Takes hold of the stylus anew at each request, or lets go of it at 0 N.

    A `controller.sim.port.World`. Each hold is a simulation of its own, with its own noise. While the device is not
    armed nothing is integrated: the sensors say without noise where the stylus is held, and on its way back there.

    Parameters
    ----------
    device : the true one, mismatch included.
    imperfections : of the sensors; their own mismatch is not put on again.
    """

    def __init__(self, device: TrueDevice, dt_s: float, imperfections: Imperfections, seed: int) -> None:
        self._device, self._dt_s, self._imperfections, self._seed = device, dt_s, imperfections, seed
        self._holds = self._counts = 0
        self.hold(0.0)
        self._way.clear()

    def hold(self, grip_N: float) -> None:
        """Still, with this grip, where the stylus hung at first."""
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
        """One servo period; an armed device may move the stylus, and what has moved rings on."""
        self._moves = self._moves or output.state in (State.ARMED, State.PLAYING)
        if self._moves:
            self._simulator.advance(output.command_A)
        elif self._way:
            self._way.pop()
