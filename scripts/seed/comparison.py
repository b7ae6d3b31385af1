"""Taps by every method on the simulator: nominal device, random mismatched devices, and off the library's nodes."""

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass

import numpy as np

import problems
from controller.firmware.core_servo import CoreServo
from controller.host.payload import payload_of
from controller.record.metrics import MOST_SHIFT_S, align
from controller.sim.played_tap import Played, play_tap
from controller.sim.simulated_tap import AFTER_S, SimulatedTap
from controller.sim.simulator import NONE, Imperfections
from controller.waveforms.bank import Bank, Method, bank
from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.plant.wall import Wall
from transopt.study.executors import executor_pool

NOMINAL = 0  # number of the device that is as the model says; it is also the seed of its noise
MISMATCH = 0.1  # part by which every parameter of the others is off at most
EQUAL = 1e-3  # differences of tap errors below this are the sensors' noise

Condition = tuple[float, float]  # speed [m/s], grip [N]


@dataclass(frozen=True)
class Result:
    """One tap.

    Attributes
    ----------
    device : NOMINAL, or the seed of a mismatched one.
    tap_error, felt_error, speed : figures of the played acceleration beside the recorded tap
        (`transopt.problem.objective.figures`), after the one shift within 1 ms that suits this tap best.
    tap_error_unshifted : as it came.
    """

    method: str
    device: int
    speed_m_s: float
    grip_N: float
    tap_error: float
    felt_error: float
    speed: float
    tap_error_unshifted: float
    latency_s: float
    peak_current_A: float


@dataclass(frozen=True)
class Kit:
    """What every tap needs: one library, the tables of its methods, and the wall of `PROPORTIONAL`."""

    library: Library
    banks: dict[Method, Bank]
    wall: Wall

    def play(self, method: Method, device: int, condition: Condition) -> Played:
        """One tap by the hand of the recordings on one device.

        Raises
        ------
        RuntimeError : the servo went to FAULT, so that there is nothing to compare.
        """
        speed_m_s, grip_N = condition
        wall = {"wall": self.wall} if method is Method.PROPORTIONAL else {}
        given = payload_of(self.library, self.banks[method], **wall)
        imperfections = NONE if device == NOMINAL else Imperfections(mismatch=MISMATCH)
        tap = SimulatedTap(speed_m_s, grip_N, seed=device, imperfections=imperfections)
        # To the end of the tail, wherever a shift may move it.
        after_s = max(AFTER_S, self.library.time_grid().after_stages * self.library.dt_s + 2 * MOST_SHIFT_S)
        played = play_tap(self.library, CoreServo(given.settings, given.image), tap, after_s=after_s)
        if played.faults:
            raise RuntimeError(f"{method.value}, device {device}, {speed_m_s:g} m/s, {grip_N:g} N: {played.events}")
        return played


def kit(library: Library, methods: Sequence[Method]) -> Kit:
    """The wall is that of the scene `walled`: the default scene renders none."""
    wall = problems.load("walled").wall()
    assert wall is not None
    return Kit(library, {method: bank(library, method) for method in methods}, wall)


def nodes(library: Library) -> list[Condition]:
    return [(float(v), float(F)) for v in library.speeds_m_s for F in library.grips_N]


def midpoints(library: Library) -> list[Condition]:
    """The middle of every cell of the grid."""
    speeds, grips = ((n[1:] + n[:-1]) / 2 for n in (library.speeds_m_s, library.grips_N))
    return [(float(v), float(F)) for v in speeds for F in grips]


def result(library: Library, played: Played, method: Method, device: int) -> Result:
    """Every method is shifted to fit the recorded tap itself, so that none loses by a delay that nobody feels.

    Without the device's own motion a_free the played acceleration is the y'' that the yardstick of the library takes.
    """
    prediction, yardstick = played.prediction, library.yardstick
    target = library.wanted(prediction.speed_m_s, prediction.grip_N).target
    times = np.append(prediction.times_s, prediction.after_times_s)
    recorded, free = target.lasting(target.recorded_m_s2), target.lasting(target.free_m_s2)
    first = (times >= 0) & (times < yardstick.intention_s)
    aligned = align(played.times_s, played.acceleration_m_s2, times[first], recorded[first])
    shifted = np.interp(times + aligned.latency_s, played.times_s, played.acceleration_m_s2)
    as_it_came = np.interp(times, played.times_s, played.acceleration_m_s2)
    figures = yardstick.figures(target, shifted - free)
    return Result(
        method=method.value,
        device=device,
        speed_m_s=played.tap.speed_m_s,
        grip_N=played.tap.grip_N,
        tap_error=figures.tap_error,
        felt_error=figures.felt_error,
        speed=figures.speed,
        tap_error_unshifted=yardstick.tap_error(target, as_it_came - free),
        latency_s=aligned.latency_s,
        peak_current_A=played.peak_current_A,
    )


# ------------------------------------------------------------------------------------------------ many taps


def _taps(own: Kit, method: Method, device: int, conditions: Sequence[Condition]) -> list[Result]:
    return [result(own.library, own.play(method, device, condition), method, device) for condition in conditions]


def compare(
    own: Kit,
    conditions: Sequence[Condition],
    devices: Sequence[int],
    *,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Result]:
    """Every method of the kit on every device under every condition.

    Parameters
    ----------
    jobs : processes. progress : called with the taps done and all taps.
    """
    pool = executor_pool("serial" if jobs == 1 else "processes", jobs)
    try:
        tasks = [
            pool.executor.submit(_taps, own, method, device, conditions) for device in devices for method in own.banks
        ]
        for done, _ in enumerate(as_completed(tasks), 1):
            progress(done * len(conditions), len(tasks) * len(conditions))
        return [one for task in tasks for one in task.result()]
    finally:
        pool.close()


# ------------------------------------------------------------------------------------------------ summary


@dataclass(frozen=True)
class Summary:
    """One method over all conditions; tap error after the shift unless named otherwise, NaN without such devices.

    Attributes
    ----------
    nominal, nominal_worst : mean and largest over the conditions.
    mean, worst_device, worst_tap : over the mismatched devices: mean over devices and conditions, the largest mean
        that one device has over its conditions, the largest single tap.
    nominal_unshifted, mean_unshifted : the same two means as the taps came.
    felt_nominal, felt_mean, speed_nominal, speed_mean : the same two means of felt error and of speed.
    ahead, ahead_unshifted : mismatched taps in which this method came nearer to the reference than the optimum on the
        same device, by more than `EQUAL`; after the shift and as they came. taps : mismatched taps.
    """

    method: str
    nominal: float
    nominal_worst: float
    mean: float
    worst_device: float
    worst_tap: float
    nominal_unshifted: float
    mean_unshifted: float
    felt_nominal: float
    felt_mean: float
    speed_nominal: float
    speed_mean: float
    ahead: int
    ahead_unshifted: int
    taps: int


def _table(results: Sequence[Result], method: str, field: str, nominal: bool) -> FloatArray:
    """(devices, conditions) of one method, in the order of `compare`."""
    chosen = [r for r in results if r.method == method and (r.device == NOMINAL) == nominal]
    devices = dict.fromkeys(r.device for r in chosen)
    return np.array([[getattr(r, field) for r in chosen if r.device == device] for device in devices])


def summarise(results: Sequence[Result]) -> list[Summary]:
    """One summary per method, in the order of the results; the optimum has to be among them."""
    compared = ("tap_error", "tap_error_unshifted")
    best, best_came = (_table(results, Method.BILINEAR.value, name, False) for name in compared)
    summaries = []
    for method in dict.fromkeys(r.method for r in results):
        (nominal, others), (nominal_came, others_came), felt, speed = (
            tuple(_table(results, method, name, which) for which in (True, False))
            for name in (*compared, "felt_error", "speed")
        )
        summaries.append(
            Summary(
                method=method,
                nominal=_of(np.mean, nominal),
                nominal_worst=_of(np.max, nominal),
                mean=_of(np.mean, others),
                worst_device=_of(np.max, others.mean(axis=-1)) if others.size else float("nan"),
                worst_tap=_of(np.max, others),
                nominal_unshifted=_of(np.mean, nominal_came),
                mean_unshifted=_of(np.mean, others_came),
                felt_nominal=_of(np.mean, felt[0]),
                felt_mean=_of(np.mean, felt[1]),
                speed_nominal=_of(np.mean, speed[0]),
                speed_mean=_of(np.mean, speed[1]),
                ahead=int(np.sum(others < best - EQUAL)),
                ahead_unshifted=int(np.sum(others_came < best_came - EQUAL)),
                taps=others.size,
            )
        )
    return summaries


def _of(figure: Callable[[FloatArray], float], values: FloatArray) -> float:
    return float(figure(values)) if values.size else float("nan")


# Figures that are the better the smaller they are.
FIGURES = (
    *("nominal", "nominal_worst", "mean", "worst_device", "worst_tap", "nominal_unshifted", "mean_unshifted"),
    *("felt_nominal", "felt_mean"),
)


def exceptions(summaries: Sequence[Summary]) -> list[tuple[str, str, float, float]]:
    """Cases in which a method is ahead of the optimum: method, figure, its value, the optimum's."""
    optimum = next(s for s in summaries if s.method == Method.BILINEAR.value)
    return [
        (s.method, figure, getattr(s, figure), getattr(optimum, figure))
        for s in summaries
        for figure in FIGURES
        if getattr(s, figure) < getattr(optimum, figure)
    ]
