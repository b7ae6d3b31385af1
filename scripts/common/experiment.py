"""One tap of servo and simulator without the protocol between, and the truth of it, which no device could tell.

What the commands show comes over a port, from a device's own sensors; this is for scripts and tests that compare
servo, library and truth. Figures as in the seed paper (Fiene, Kuchenbecker, Niemeyer 2006), Sec. 6.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from controller.record.metrics import align, rate_hardness_N_m, spectral_error_dB
from controller.servo.interface import Event, Fault, Notice, Output, Readings, State
from controller.servo.loop import Clock, Observer, Servo, run
from controller.sim.simulated_tap import AFTER_S, SimulatedTap, approach_ticks, strike_real, tap_simulator
from controller.sim.simulator import Trace
from controller.sim.true_device import TrueDevice, device_of
from controller.waveforms.prediction import Prediction, predict, scene_of
from transopt.base.signals import FloatArray, nrmse
from transopt.library.library import Library
from transopt.problem.answer import verdict
from transopt.scene.scene import Scene

UNTOUCHED_S = 0.5e-3  # before the lead the motion is the user's alone


@dataclass(frozen=True)
class Metrics:
    """Figures of one tap; those that need a transient are NaN if none was played.

    Attributes
    ----------
    latency_s : the one shift within 1 ms that aligns played and predicted acceleration, positive if played late.
    nrmse : after that shift, against the library's prediction. nrmse_reference : against the recorded reference r.
    peak_m_s2, predicted_peak_m_s2, reference_peak_m_s2 : largest |acceleration|.
    spectral_error_dB : against r, see `metrics.spectral_error_dB`.
    rate_hardness_N_m : of the rendered surface. real_rate_hardness_N_m : of the object that the scene's recordings
        come from, struck by the same device; NaN if they are not simulated.
    peak_current_A : over all t. start_winding_C, peak_winding_C : true; NaN without a coil.
    estimated_winding_C : highest estimate of the servo.
    notices : how often each notice came. faults : in the order they came.
    verdict : in words.
    """

    latency_s: float
    nrmse: float
    nrmse_reference: float
    peak_m_s2: float
    predicted_peak_m_s2: float
    reference_peak_m_s2: float
    spectral_error_dB: float
    rate_hardness_N_m: float
    real_rate_hardness_N_m: float
    peak_current_A: float
    start_winding_C: float
    peak_winding_C: float
    estimated_winding_C: float
    notices: dict[Notice, int]
    faults: tuple[Fault, ...]
    verdict: str

    @property
    def played(self) -> bool:
        return not np.isnan(self.nrmse)


@dataclass(frozen=True)
class Played:
    """A tap as it went, with times from the moment at which the device would have met the surface undriven.

    Attributes
    ----------
    times_s : (K,) of the truth at every integration step; so are motor_m, current_A, winding_C.
    acceleration_m_s2 : (K,) of the stylus without the user's own share, so that it compares with the predicted y''. A
        mild, a yielding and a stopping user are all taken to go straight on: what they do otherwise is error.
    tick_times_s : (T,) of the servo; so are command_A, feedback_A, estimated_winding_C, states.
    behind_s : how far a paced run fell behind its clock.
    """

    tap: SimulatedTap
    prediction: Prediction
    metrics: Metrics
    times_s: FloatArray
    acceleration_m_s2: FloatArray
    motor_m: FloatArray
    current_A: FloatArray
    winding_C: FloatArray
    tick_times_s: FloatArray
    command_A: FloatArray
    feedback_A: FloatArray
    estimated_winding_C: FloatArray
    states: tuple[State, ...]
    events: tuple[Event, ...]
    behind_s: float


def _contact_s(trace: Trace, expected_s: float, lead_s: float) -> float:
    """When the motor mass would have met z = 0 undriven: its last straight motion before the lead, continued."""
    k = int(np.searchsorted(trace.times_s, expected_s - lead_s - UNTOUCHED_S)) - 1
    return float(trace.times_s[k] - trace.motor_m[k] / trace.motor_m_s[k])


def play_tap(
    library: Library,
    servo: Servo,
    tap: SimulatedTap,
    *,
    observe: Observer | None = None,
    clock: Clock | None = None,
    device: TrueDevice | None = None,
) -> Played:
    """Arm the servo, let a simulated user tap once, and compare with the library's prediction.

    The true device is that of the library's scene, or another `device`: a library that was solved with an identified
    model is tried on what the model was identified from. The tap's imperfections are the true device's.

    Raises
    ------
    InputError : speed or grip is not a finite number; a library of a black box, without a device to simulate.
    """
    prediction = predict(library, tap.speed_m_s, tap.grip_N, tap.gain)
    scene, grid = scene_of(library), library.time_grid()
    dt = grid.dt_s
    truth = device_of(scene) if device is None else device
    simulator, expected = tap_simulator(library, tap, truth, trace=True)
    outputs: list[Output] = []

    def note(readings: Readings, output: Output) -> None:
        outputs.append(output)
        if observe is not None:
            observe(readings, output)

    servo.arm()
    ticks = approach_ticks(tap.speed_m_s, dt) + int(np.ceil((grid.end_s + AFTER_S) / dt)) + 1
    behind = run(simulator, servo, ticks, dt, observe=note, clock=clock)

    trace = simulator.trace()
    contact = _contact_s(trace, expected, grid.lead_s)
    times = trace.times_s - contact
    acceleration = trace.acceleration_m_s2 - trace.own_m_s2
    events = tuple(event for output in outputs for event in output.events)
    force = simulator.device.force_per_current_N_A * trace.current_A
    metrics = _metrics(scene, truth, tap, prediction, times, acceleration, force, trace, outputs, events, dt)
    return Played(
        tap=tap,
        prediction=prediction,
        metrics=metrics,
        times_s=times,
        acceleration_m_s2=acceleration,
        motor_m=trace.motor_m,
        current_A=trace.current_A,
        winding_C=trace.winding_C,
        tick_times_s=np.asarray(np.arange(ticks) * dt - contact, dtype=float),
        command_A=np.array([output.command_A for output in outputs]),
        feedback_A=np.array([output.feedback_A for output in outputs]),
        estimated_winding_C=np.array([output.winding_C for output in outputs]),
        states=tuple(output.state for output in outputs),
        events=events,
        behind_s=behind,
    )


def _metrics(
    scene: Scene,
    truth: TrueDevice,
    tap: SimulatedTap,
    prediction: Prediction,
    times_s: FloatArray,
    acceleration_m_s2: FloatArray,
    force_N: FloatArray,
    trace: Trace,
    outputs: list[Output],
    events: tuple[Event, ...],
    dt_s: float,
) -> Metrics:
    faults = tuple(event.what for event in events if isinstance(event.what, Fault))
    notices = Counter(event.what for event in events if isinstance(event.what, Notice))
    reference = tap.gain * prediction.reference_m_s2
    window = (times_s >= prediction.times_s[0]) & (times_s <= prediction.times_s[-1])
    nothing = float("nan")
    latency = error = reference_error = spectral = hardness = nothing
    playable = bool(np.any(prediction.acceleration_m_s2)) and not prediction.silent
    if playable and bool(np.any(trace.current_A)):
        aligned = align(times_s, acceleration_m_s2, prediction.times_s, prediction.acceleration_m_s2)
        latency, error = aligned.latency_s, aligned.nrmse
        reference_error = nrmse(aligned.played_m_s2, reference)
        spectral = spectral_error_dB(aligned.played_m_s2, reference, dt_s)
        hardness = rate_hardness_N_m(times_s, force_N, tap.speed_m_s)
    target = scene.recordings.simulated
    real = nothing
    if target is not None:
        real = strike_real(truth, target, tap.speed_m_s, target.grip_N, 10e-3, dt_s).rate_hardness_N_m
    if faults:
        words = f"fault: {faults[0].value}"
    elif np.isnan(error):
        words = "no transient played"
    else:
        words = verdict(reference_error, prediction.floor, prediction.repeatability)
    return Metrics(
        latency_s=latency,
        nrmse=error,
        nrmse_reference=reference_error,
        peak_m_s2=float(np.abs(acceleration_m_s2[window]).max()),
        predicted_peak_m_s2=float(np.abs(prediction.acceleration_m_s2).max()),
        reference_peak_m_s2=float(np.abs(reference).max()),
        spectral_error_dB=spectral,
        rate_hardness_N_m=hardness,
        real_rate_hardness_N_m=real,
        peak_current_A=float(np.abs(trace.current_A).max()),
        start_winding_C=float(trace.winding_C[0]),
        peak_winding_C=float(trace.winding_C.max()),
        estimated_winding_C=float(max(output.winding_C for output in outputs)),
        notices=dict(notices),
        faults=faults,
        verdict=words,
    )
