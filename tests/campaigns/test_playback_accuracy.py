"""How well the servo plays a library on the nominal device in the hand of the recordings.

    python -m pytest -m long -n 0 tests/campaigns/test_playback_accuracy.py
        --campaign="[LIBRARY] [--phases 5] [--seeds 2] [--points 60] [--json FILE]"

At the nodes: latency and playback error after it, against the library's prediction, over contact phases within the
tick and seeds of the sensors' noise. Between them, at random speeds and grips of the grid: against the blend of the
nodes' predictions, which a device at that grip misses by the interpolation error even if all is played on time.
Of every node its tap error is printed too, which the design leaves even if it is played without any error. It fails
if a node's latency is above 20 us rms, its playback error above 3 % or its tap error 3 points above the library's, or
if a point's error is above the interpolation error plus 3 %.
"""

from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
import pytest

from controller.record.metrics import align
from controller.servo.interface import Notice
from controller.sim.played_tap import Played, play_tap
from controller.sim.simulated_tap import SimulatedTap
from controller.sim.simulator import Imperfections
from controller.waveforms.bank import Method, bank
from controller.waveforms.prediction import predict
from tests.benches.compiled import servo_of
from tests.campaigns.harness import JsonFile, LibraryFile, at_least, library_of, long_form, write_json
from transopt.base.signals import FloatArray, nrmse
from transopt.library.library import Library

MOST_LATENCY_S, MOST_ERROR = 20e-6, 0.03
SEED = 1


@dataclass(frozen=True)
class Node:
    """One node over all phases and seeds.

    Attributes
    ----------
    playback_error : the worst. tap_error : the mean. library_error : tap error as designed.
    """

    speed_m_s: float
    grip_N: float
    taps: int
    latency_rms_s: float
    latency_worst_s: float
    playback_error: float
    tap_error: float
    library_error: float
    peak_current_A: float

    @property
    def kept(self) -> bool:
        as_played = self.latency_rms_s <= MOST_LATENCY_S and self.playback_error <= MOST_ERROR
        return as_played and self.tap_error <= self.library_error + MOST_ERROR


@dataclass(frozen=True)
class Point:
    """One tap between the nodes.

    Attributes
    ----------
    playback_error : against the blended command replayed through the device of this grip.
    blend_error : against the blend of the nodes' predicted accelerations. interpolation : that replay against it.
    """

    speed_m_s: float
    grip_N: float
    latency_s: float
    playback_error: float
    blend_error: float
    interpolation: float

    @property
    def kept(self) -> bool:
        return self.blend_error <= self.interpolation + MOST_ERROR


def once(library: Library, tap: SimulatedTap) -> Played:
    """One nominal tap with a fresh servo.

    Raises
    ------
    RuntimeError : it was not played.
    """
    metrics = play_tap(library, servo_of(library), tap)
    if not metrics.played or metrics.faults:
        raise RuntimeError(f"{tap.speed_m_s:g} m/s, {tap.grip_N:g} N: {metrics.events}")
    return metrics


def at_node(library: Library, iv: int, ig: int, phases: FloatArray, seeds: int) -> Node:
    speed, grip = float(library.speeds_m_s[iv]), float(library.grips_N[ig])
    taps = [SimulatedTap(speed, grip, phase=float(phase), seed=seed) for phase in phases for seed in range(seeds)]
    found = [once(library, tap) for tap in taps]
    late = np.array([metrics.latency_s for metrics in found])
    return Node(
        speed_m_s=speed,
        grip_N=grip,
        taps=len(taps),
        latency_rms_s=float(np.sqrt(np.mean(late**2))),
        latency_worst_s=float(late[np.argmax(np.abs(late))]),
        playback_error=max(metrics.playback_error for metrics in found),
        tap_error=float(np.mean([metrics.tap_error for metrics in found])),
        library_error=float(library.tap_error[iv, ig]),
        peak_current_A=max(metrics.peak_current_A for metrics in found),
    )


def blended(library: Library, speed_m_s: float, grip_N: float) -> FloatArray:
    """(N,) predicted accelerations of the four nodes around a point, blended as the commands are."""
    by_v, by_F = (
        np.array([np.interp(value, nodes, unit) for unit in np.eye(nodes.size)])
        for value, nodes in ((speed_m_s, library.speeds_m_s), (grip_N, library.grips_N))
    )
    return np.asarray(np.einsum("v,g,vgk->k", by_v, by_F, library.acceleration_m_s2))


def between(library: Library, speed_m_s: float, grip_N: float, seed: int) -> Point:
    """One tap between the nodes, its phase drawn from the seed."""
    tap = SimulatedTap(speed_m_s, grip_N, seed=seed)
    played = play_tap(library, servo_of(library), tap)
    prediction = predict(library, speed_m_s, grip_N)
    blend = blended(library, speed_m_s, grip_N) + prediction.own_m_s2
    return Point(
        speed_m_s=speed_m_s,
        grip_N=grip_N,
        latency_s=played.latency_s,
        playback_error=played.playback_error,
        blend_error=align(played.times_s, played.acceleration_m_s2, prediction.times_s, blend).nrmse,
        interpolation=nrmse(prediction.whole_m_s2, blend),
    )


def inside(library: Library, count: int) -> FloatArray:
    """(count, 2) random speeds [m/s] and grips [N] of the grid."""
    low, high = (library.speeds_m_s[0], library.grips_N[0]), (library.speeds_m_s[-1], library.grips_N[-1])
    return np.random.default_rng(SEED).uniform(low, high, (count, 2))


def summarise(points: list[Point]) -> None:
    late = np.array([p.latency_s for p in points])
    extra = [p.blend_error - p.interpolation for p in points]
    worst = points[int(np.argmax(extra))]
    print(
        f"{len(points)} random taps between the nodes: latency {1e6 * np.sqrt(np.mean(late**2)):.1f} us rms, "
        f"{1e6 * np.abs(late).max():.1f} us at most; error at most\n"
        f"  {100 * max(p.playback_error for p in points):.2f} % against the blended command's replay,\n"
        f"  {100 * max(p.blend_error for p in points):.2f} % against the blended prediction, where interpolation "
        f"alone makes {100 * max(p.interpolation for p in points):.2f} %;\n"
        f"  largest difference of the two {100 * max(extra):.2f} % at {worst.speed_m_s:.3f} m/s, {worst.grip_N:.2f} N"
    )


def main(
    library: LibraryFile = None,
    phases: Annotated[int, at_least(1, "phases of the contact within the tick, per node")] = 5,
    seeds: Annotated[int, at_least(1, "seeds of the sensors' noise, per phase")] = 2,
    points: Annotated[int, at_least(0, "random taps between the nodes")] = 60,
    json: JsonFile = None,
) -> int:
    solved = library_of(library)
    within = np.arange(phases) / phases
    print("  m/s    N taps latency rms us worst us playback %   tap % peak A")
    nodes = []
    for iv, ig in np.ndindex(solved.tap_error.shape):
        nodes.append(n := at_node(solved, iv, ig, within, seeds))
        print(
            f"{n.speed_m_s:5g} {n.grip_N:4g} {n.taps:4d} {1e6 * n.latency_rms_s:14.1f} "
            f"{1e6 * n.latency_worst_s:8.1f} {100 * n.playback_error:10.2f} {100 * n.tap_error:7.2f} "
            f"{n.peak_current_A:.4f}{'' if n.kept else '  MISSED'}",
            flush=True,
        )
    drawn = inside(solved, points)
    found = [between(solved, float(v), float(F), seed) for seed, (v, F) in enumerate(drawn)]
    if found:
        summarise(found)
    write_json({"nodes": [asdict(n) for n in nodes], "points": [asdict(p) for p in found]}, json)
    return 0 if all(entry.kept for entry in [*nodes, *found]) else 1


test_long_form = long_form(main)


@pytest.mark.parametrize(("iv", "ig"), [(1, 1), (3, 2)])
def test_a_node_is_on_time_and_as_predicted(library: Library, c_compiler: None, iv: int, ig: int) -> None:
    node = at_node(library, iv, ig, np.array([0.0, 0.65]), seeds=1)
    assert node.latency_rms_s <= MOST_LATENCY_S
    assert node.playback_error <= MOST_ERROR
    assert node.tap_error <= library.tap_error[iv, ig] + MOST_ERROR
    assert node.peak_current_A <= 4.0 + 1e-6


def test_between_the_nodes_only_interpolation_is_added(library: Library, c_compiler: None) -> None:
    points = [between(library, float(v), float(F), seed) for seed, (v, F) in enumerate(inside(library, 3))]
    late = np.array([p.latency_s for p in points])
    assert np.sqrt(np.mean(late**2)) <= MOST_LATENCY_S
    for p in points:
        assert p.playback_error <= MOST_ERROR, p
        assert p.blend_error <= p.interpolation + MOST_ERROR, p


def test_a_mismatched_amplifier_stays_within_the_limit_it_was_told_of(library: Library, c_compiler: None) -> None:
    """Seed 3 draws a faster pole: without the tolerance its current passes the limit."""
    mismatch = 0.2
    tap = SimulatedTap(0.4, 5.0, seed=3, imperfections=Imperfections(mismatch=mismatch, crossover_A=0.0))
    servos = servo_of(library), servo_of(library, amplifier_tolerance=mismatch)
    peaks = [play_tap(library, servo, tap).peak_current_A for servo in servos]
    assert peaks[0] > 4.02
    assert peaks[1] <= 4.0 + 1e-6


def test_every_method_plays_within_the_limits(library: Library, c_compiler: None) -> None:
    for method in Method:
        m = play_tap(library, servo_of(library, bank(library, method)), SimulatedTap(0.35, 4.5))
        assert not m.faults, method
        assert m.notices[Notice.CONTACT] == 1
        assert m.played == (method is not Method.PROPORTIONAL), method
        assert m.peak_current_A <= 4.0 + 1e-6
