"""One tap of servo and simulator without the protocol in between, compared with the simulated truth.

The commands see a device through a port and its sensors only. This module serves programs that compare servo, library
and truth.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from controller.record.metrics import align
from controller.servo.interface import Event, Fault, Notice, Output, Plant, Readings
from controller.sim.simulated_tap import AFTER_S, SimulatedTap, approach_ticks, tap_simulator
from controller.sim.simulator import Trace
from controller.sim.true_device import TrueDevice, device_of
from controller.waveforms.prediction import Prediction, predict
from transopt.base.signals import FloatArray, nrmse
from transopt.library.library import Library

UNTOUCHED_S = 0.5e-3  # margin before the lead, where the user's motion is still undriven


class Servo(Protocol):
    """The servo that plays: `firmware.core_servo.CoreServo`, or a test oracle of it."""

    def arm(self) -> object: ...

    def step(self, readings: Readings) -> Output: ...


def run(plant: Plant, servo: Servo, ticks: int, observe: Callable[[Readings, Output], None] | None = None) -> None:
    """Run plant and servo for `ticks` servo periods of virtual time.

    Parameters
    ----------
    observe : called at each tick with the readings and the servo's output.
    """
    for _ in range(ticks):
        readings = plant.readings()
        output = servo.step(readings)
        plant.advance(output.command_A)
        if observe is not None:
            observe(readings, output)


@dataclass(frozen=True)
class Played:
    """A played tap; times count from the instant at which the undriven device would have met the surface.

    Attributes
    ----------
    tap : the requested tap.
    prediction : the library's prediction.
    times_s : (K,) times of all integration steps, at which current_A and winding_C are given too.
    acceleration_m_s2 : (K,) true acceleration of the stylus.
    command_A : (T,) commands of the servo at its ticks.
    events : events of the servo in order.
    latency_s : the one shift within 1 ms that aligns played and predicted acceleration, positive if played late;
        like both errors NaN if no transient was played.
    tap_error : after that shift, against the recorded tap, until the hand's intention is over.
    playback_error : after that shift, against the library's prediction.
    """

    tap: SimulatedTap
    prediction: Prediction
    times_s: FloatArray
    acceleration_m_s2: FloatArray
    current_A: FloatArray
    winding_C: FloatArray
    command_A: FloatArray
    events: tuple[Event, ...]
    latency_s: float = float("nan")
    tap_error: float = float("nan")
    playback_error: float = float("nan")

    @property
    def played(self) -> bool:
        return not np.isnan(self.playback_error)

    @property
    def peak_m_s2(self) -> float:
        """Largest |acceleration| within the library's window."""
        first, last = self.prediction.times_s[[0, -1]]
        return float(np.abs(self.acceleration_m_s2[(self.times_s >= first) & (self.times_s <= last)]).max())

    @property
    def peak_current_A(self) -> float:
        return float(np.abs(self.current_A).max())

    @property
    def faults(self) -> tuple[Fault, ...]:
        return tuple(event.what for event in self.events if isinstance(event.what, Fault))

    @property
    def notices(self) -> Counter[Notice]:
        """Number of each notice."""
        return Counter(event.what for event in self.events if isinstance(event.what, Notice))


def _contact_s(trace: Trace, expected_s: float, lead_s: float) -> float:
    """Instant at which the undriven motor mass would meet z = 0, extrapolated from its motion before the lead."""
    k = int(np.searchsorted(trace.times_s, expected_s - lead_s - UNTOUCHED_S)) - 1
    return float(trace.times_s[k] - trace.motor_m[k] / trace.motor_m_s[k])


def play_tap(
    library: Library,
    servo: Servo,
    tap: SimulatedTap,
    *,
    device: TrueDevice | None = None,
    after_s: float = AFTER_S,
) -> Played:
    """Arm the servo, let a simulated user tap once, and compare with the library's prediction.

    The true device is that of the library's scene, or `device`: a library solved with an identified model is tried on
    the device that the model was identified from. The tap's imperfections are applied to the true device.

    Raises
    ------
    InputError : speed or grip is not finite, or the library is of a black box and no `device` is given.
    """
    prediction = predict(library, tap.speed_m_s, tap.grip_N, tap.gain)
    grid = library.time_grid()
    truth = device_of(library.scene()) if device is None else device
    simulator, expected = tap_simulator(library, tap, truth, trace=True)
    outputs: list[Output] = []
    servo.arm()
    ticks = approach_ticks(tap.speed_m_s, grid.dt_s) + int(np.ceil((grid.end_s + after_s) / grid.dt_s)) + 1
    run(simulator, servo, ticks, lambda _, output: outputs.append(output))
    trace = simulator.trace()
    times = trace.times_s - _contact_s(trace, expected, grid.lead_s)
    acceleration = trace.acceleration_m_s2
    events = tuple(event for output in outputs for event in output.events)
    commands = np.array([output.command_A for output in outputs])
    truth_of = (tap, prediction, times, acceleration, trace.current_A, trace.winding_C, commands, events)
    if prediction.silent or not np.any(prediction.acceleration_m_s2) or not np.any(trace.current_A):
        return Played(*truth_of)
    aligned = align(times, acceleration, prediction.times_s, prediction.whole_m_s2)
    first = (prediction.times_s >= 0) & (prediction.times_s < library.yardstick.intention_s)
    error = nrmse(aligned.played_m_s2[first], prediction.recorded_m_s2[first])
    return Played(*truth_of, aligned.latency_s, error, aligned.nrmse)
