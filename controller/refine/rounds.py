"""Rounds of taps on the device, each of them with the library that was learnt from those before.

What a tap does beside its prediction, w = a - p, is measured by the device's own sensors until the hand can react,
as `controller.record.played` does it. `learning` makes of it what the next round is solved for. A node that a round
does not improve goes back to the best it had, and its gain is halved; what is returned is the best of every node.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controller.record.metrics import align
from controller.record.played import CUTOFF_HZ, before_pole, since_contact
from controller.record.recorder import Contact
from controller.refine.learning import LEAST_GAIN, Condition, Ratio, corrected, ratio, widest
from controller.servo.settings import Settings
from controller.waveforms.prediction import REACTION_S, predict
from transopt.base.signals import FloatArray, Signal, lowpass, nrmse
from transopt.library.library import Library
from transopt.library.meta import entry_left_out

FADE_S = 5e-3  # in which a correction fades out after `REACTION_S`
SPEED_PART = 0.15  # a tap this near to a node's speed counts for it, scaled
GRIP_PART, GRIP_N = 0.15, 0.5  # the same of the grip, whichever is more

Node = tuple[int, int]  # (speed, grip) by index
Resolve = Callable[[Library, Mapping[Node, FloatArray], dict[str, Any]], tuple[Library, dict[Node, str]]]


@dataclass(frozen=True)
class Heard:
    """One tap at a node, by the device's own sensors.

    Attributes
    ----------
    difference_m_s2 : (N,) w = a - p at the switching instants, at the node's speed, low-passed, faded out.
    latency_s : the one shift that was taken out.
    peak_current_A : as measured.
    """

    difference_m_s2: FloatArray
    latency_s: float
    peak_current_A: float


@dataclass(frozen=True)
class NodeRound:
    """What one round did at one node.

    Attributes
    ----------
    nrmse : measured, against r, of the mean of its taps.
    spread : standard deviation of `nrmse` from tap to tap.
    measured_m_s2 : (N,) the mean tap, low-passed; what comes after `REACTION_S` and `FADE_S` is the prediction.
    better : it is the best so far. limited : limits bind, so that it cannot get better than the optimum under them.
    condition : with which this round had been learnt; None before the first.
    """

    nrmse: float
    spread: float
    peak_current_A: float
    measured_m_s2: FloatArray
    better: bool
    limited: bool
    condition: Condition | None


Round = Mapping[Node, NodeRound]


@dataclass(frozen=True)
class Refined:
    """What came of it.

    Attributes
    ----------
    library : the best of every node. rounds : what each round measured, the first with the library as it was.
    ratios : T of each grip that was tapped at, by index, from all taps. kept : why a node was not solved again.
    """

    library: Library
    rounds: list[Round]
    ratios: dict[int, Ratio]
    kept: dict[Node, str]

    @property
    def better(self) -> list[Node]:
        """The nodes that some round after the first has made better."""
        return sorted({node for results in self.rounds[1:] for node, found in results.items() if found.better})


def nodes_of(library: Library) -> list[Node]:
    return [(iv, ig) for iv in range(library.speeds_m_s.size) for ig in range(library.grips_N.size)]


def node_near(library: Library, speed_m_s: float, grip_N: float) -> Node | None:
    """The node that a tap counts for; None if it is near to none."""
    iv = int(np.argmin(np.abs(np.log(library.speeds_m_s / max(speed_m_s, 1e-9)))))
    ig = int(np.argmin(np.abs(library.grips_N - grip_N)))
    grip = float(library.grips_N[ig])
    near = abs(speed_m_s / float(library.speeds_m_s[iv]) - 1) <= SPEED_PART
    return (iv, ig) if near and abs(grip_N - grip) <= max(GRIP_N, GRIP_PART * grip) else None


def fade_of(times_s: FloatArray) -> FloatArray:
    """(N,) 1 until a hand can react, then down to 0 within `FADE_S`."""
    after = np.clip((times_s - REACTION_S) / FADE_S, 0.0, 1.0)
    return np.asarray(0.5 * (1 + np.cos(np.pi * after)))


def smooth(values: FloatArray, dt_s: float) -> FloatArray:
    """(N,) low-passed as what is measured."""
    return lowpass(Signal(0.0, dt_s, values), CUTOFF_HZ).values


def hear(contact: Contact, library: Library, settings: Settings, node: Node, bandwidth_Hz: float) -> Heard | str:
    """What a tap at or near a node says of it; or why it says nothing.

    The prediction is that of the tap's own speed and grip; what it leaves is scaled to the node's speed.

    Parameters
    ----------
    bandwidth_Hz : of the accelerometer, one pole, which is taken out.
    """
    prediction = predict(library, contact.speed_m_s, contact.grip_N)
    if prediction.silent:
        return "the library is silent there"
    times, dt = prediction.times_s, contact.dt_s
    fade, compared = fade_of(times), times <= REACTION_S
    found = since_contact(contact, settings, float(times[0]), float(times[fade > 0][-1]))
    if isinstance(found, str):
        return found
    whole = lowpass(replace(found, values=before_pole(found.values, dt, bandwidth_Hz)), CUTOFF_HZ)
    wanted = smooth(prediction.reference_m_s2, dt)
    latency = align(whole.times_s, whole.values, times[compared], wanted[compared]).latency_s
    difference = whole.at(times + latency) - smooth(prediction.acceleration_m_s2, dt)
    scale = float(library.speeds_m_s[node[0]]) / prediction.speed_m_s
    return Heard(fade * scale * difference, latency, float(np.abs(contact.current_A).max()))


@dataclass(frozen=True)
class _Best:
    """Of one node: what it was solved for, what was heard then, how good that was."""

    correction_m_s2: FloatArray
    difference_m_s2: FloatArray
    nrmse: float
    gain: float


def _measured(library: Library, node: Node, taps: Sequence[Heard]) -> tuple[float, float, FloatArray]:
    """NRMSE of the mean tap against r until the hand can react, its deviation from tap to tap, and the mean tap."""
    grid = library.time_grid()
    compared = grid.switching_times_s <= REACTION_S
    wanted = smooth(library.reference_m_s2[node[0]], grid.dt_s)[compared]
    played = smooth(library.acceleration_m_s2[node], grid.dt_s) + [tap.difference_m_s2 for tap in taps]
    mean = np.asarray(played.mean(axis=0))
    return nrmse(mean[compared], wanted), float(np.std([nrmse(tap[compared], wanted) for tap in played])), mean


class _Ratios:
    """T of each grip from all its taps so far: the device stays what it is while the library changes."""

    def __init__(self) -> None:
        self._pairs: dict[int, list[tuple[FloatArray, FloatArray]]] = {}

    def add(self, library: Library, taps: Mapping[Node, Sequence[Heard]]) -> None:
        grid = library.time_grid()
        fade = fade_of(grid.switching_times_s)
        for node, heard in taps.items():
            p = fade * smooth(library.acceleration_m_s2[node], grid.dt_s)
            self._pairs.setdefault(node[1], []).extend((p, p + tap.difference_m_s2) for tap in heard)

    @property
    def grips(self) -> list[int]:
        return sorted(self._pairs)

    def of(self, ig: int, dt_s: float) -> Ratio:
        predicted, measured = zip(*self._pairs[ig], strict=True)
        return ratio(predicted, measured, dt_s)


def refine(
    library: Library,
    play: Callable[[Library, int], Mapping[Node, Sequence[Heard]]],
    resolve: Resolve,
    rounds: int,
    stated: dict[str, Any],
    *,
    tell: Callable[[int, Round], None] = lambda number, results: None,
) -> Refined:
    """Play, learn, solve again; `rounds` times, and play what came of it.

    Parameters
    ----------
    play : taps at each node with a library in a round, at least two at a node that is to be learnt from.
    resolve : `transopt.design.resolve.resolve`.
    stated : what `meta["refinement"]` says of device and measurement, beside the rounds.
    tell : called with each round as soon as it was played.
    """
    grid, nodes = library.time_grid(), nodes_of(library)
    fade = fade_of(grid.switching_times_s)
    best: dict[Node, _Best] = {}
    played: list[Round] = []
    kept: dict[Node, str] = {}
    present, conditions, ratios = library, dict[Node, Condition](), _Ratios()
    for number in range(rounds + 1):
        taps = {node: heard for node, heard in play(present, number).items() if len(heard) >= 2}
        results: dict[Node, NodeRound] = {}
        for node, heard in taps.items():
            error, spread, mean = _measured(present, node, heard)
            before = best.get(node)
            better = before is None or error < before.nrmse
            gain = 1.0 if before is None else before.gain
            if better:
                difference = np.mean([tap.difference_m_s2 for tap in heard], axis=0)
                best[node] = _Best(present.correction_m_s2[node], difference, error, gain)
            elif before is not None:
                best[node] = replace(before, gain=gain / 2)
            results[node] = NodeRound(
                nrmse=error,
                spread=spread,
                peak_current_A=max(tap.peak_current_A for tap in heard),
                measured_m_s2=mean,
                better=better,
                limited="limits" not in entry_left_out(present.meta, *node),
                condition=conditions.get(node),
            )
        played.append(results)
        tell(number, results)
        ratios.add(present, taps)
        if number == rounds:
            break
        found = {ig: ratios.of(ig, grid.dt_s) for ig in {ig for _, ig in taps}}
        conditions, wanted = {}, {}
        for node in nodes:
            if node not in taps or best[node].gain < LEAST_GAIN:
                continue
            state = best[node]
            known = widest(found[node[1]], state.gain, limited=results[node].limited)
            conditions[node] = known
            if known.met:
                wanted[node] = corrected(state.correction_m_s2, state.difference_m_s2, grid.dt_s, known, fade)
        present, refused = resolve(present, {**_best_of(best, present), **wanted}, {})
        kept |= refused
    final, refused = resolve(present, _best_of(best, present), {**stated, "rounds": _in_meta(library, played)})
    found = {ig: ratios.of(ig, grid.dt_s) for ig in ratios.grips}
    return Refined(final, played, found, kept | refused)


def _best_of(best: Mapping[Node, _Best], present: Library) -> dict[Node, FloatArray]:
    """Corrections of the nodes whose present one is not their best."""
    return {
        node: state.correction_m_s2
        for node, state in best.items()
        if not np.array_equal(state.correction_m_s2, present.correction_m_s2[node])
    }


def _in_meta(library: Library, rounds: Sequence[Round]) -> list[dict[str, Any]]:
    """Round by round what `meta` keeps: tables (nv, ng), null where nothing was measured."""
    nv, ng = library.speeds_m_s.size, library.grips_N.size

    def table(results: Round, value: Callable[[NodeRound], Any]) -> list[list[Any]]:
        return [[value(results[iv, ig]) if (iv, ig) in results else None for ig in range(ng)] for iv in range(nv)]

    def of_condition(name: str) -> Callable[[NodeRound], Any]:
        return lambda node: None if node.condition is None else getattr(node.condition, name)

    return [
        {
            "nrmse": table(results, lambda node: node.nrmse),
            "better": table(results, lambda node: node.better),
            "peak_current_A": table(results, lambda node: node.peak_current_A),
            **{name: table(results, of_condition(name)) for name in ("gain", "cutoff_Hz", "factor", "sure_factor")},
        }
        for results in rounds
    ]
