"""One tap as the page shows it: curves, figures, and the cells of its row in the table."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from transopt.base.signals import FloatArray
from transopt.base.writing import percent
from transopt.design.entry import Entry
from transopt.library.columns import COLUMNS, NAN, UNKNOWN
from transopt.problem.answer import Status
from transopt.problem.baselines import clipped_optimum
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.figures import Figures
from transopt.proof.effect import warm_up
from transopt.web.price import Priced
from transopt.web.warm import Warm

FIGURES = ("tap", "floor", "felt", "felt_dB", "speed", "bump", "heat")  # columns shared with the library's table


@dataclass(frozen=True)
class Place:
    """Identifies a tap on the page.

    Attributes
    ----------
    speed_m_s, grip_N : 0 for a named target.
    target : name of a named target; empty for a tap.
    title : name of the tap in words.
    between : whether it lies between the nodes of the scene, at the sliders of speed and grip.
    """

    speed_m_s: float
    grip_N: float
    target: str
    title: str
    between: bool = False


@dataclass(frozen=True)
class Curves:
    """The curves of one tap; without a certified optimum its own curves are NaN.

    Attributes
    ----------
    times_s : (N + M,) switching instants of window and tail.
    recorded_m_s2 : (N + M,) r, the recorded acceleration.
    optimum_m_s2, clipped_m_s2 : (N + M,) y'' of the optimum, and of the optimum without limits, clipped.
    input, clipped_input : (N + M,) input of the plant [A or V].
    input_limit : limit on the input.
    temperature_C : (N,) winding temperature at the ends of the periods; (0,) without a coil.
    temperature_limit_C : NaN without a coil.
    warm_m_s2, warm_input : (N + M,) as `optimum_m_s2` and `input`, for the transient on a warm coil; (0,) if none is
        requested.
    """

    times_s: FloatArray
    recorded_m_s2: FloatArray
    optimum_m_s2: FloatArray
    clipped_m_s2: FloatArray
    input: FloatArray
    clipped_input: FloatArray
    input_limit: float
    temperature_C: FloatArray
    temperature_limit_C: float
    warm_m_s2: FloatArray = field(default_factory=lambda: np.zeros(0))
    warm_input: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Shown:
    """One tap of an answer.

    Attributes
    ----------
    index : index of its place.
    certified : whether its certificate is accepted; otherwise it is drawn grey.
    replayed : whether it is replayed and admitted, as an entry of a library is.
    reason : why it is not certified; empty if it is.
    figures : comparison with the recorded tap; None without an optimum.
    floor, clipped : tap error of the optimum without limits, and of that optimum clipped.
    heat_A2_ms : integral of the squared current over the window.
    binds : binding limits, in words.
    curves : curves to draw; None in the answer of `settled`, which does not change them.
    warm : transient on a warm coil; None if none is requested, or the tap is not certified.
    prices : prices of the binding limits, dearest first; only when settled.
    verdict : verdict in words; only when settled.
    """

    index: int
    certified: bool
    replayed: bool
    reason: str
    figures: Figures | None
    floor: float
    clipped: float
    heat_A2_ms: float
    binds: str
    curves: Curves | None = None
    warm: Warm | None = None
    prices: tuple[Priced, ...] = ()
    verdict: str = ""

    @property
    def cells(self) -> dict[str, str]:
        """Column of the table -> text of its cell, as in all tables of the project."""
        f = self.figures
        values = {"floor": self.floor}
        if f is not None:
            values |= {"tap": f.tap_error, "felt": f.felt_error, "felt_dB": f.felt_dB, "speed": f.speed}
            values |= {"bump": f.bump_m_s2, "heat": self.heat_A2_ms / 1e3}
        found = {name: COLUMNS[name].show(values.get(name, NAN)) for name in FIGURES}
        return {**found, "clipped": percent(self.clipped), "binding": self.binds or UNKNOWN}


def shown(indices: Sequence[int], entries: Sequence[Entry]) -> list[Shown]:
    """Taps of one scene from their entries, before they are replayed."""
    clipped, certified = _clipped(entries), [entry for entry in entries if entry.designed.is_accepted]
    warm_up([entry.designed.effect for entry in certified])
    own = dict(zip(map(id, certified), _figures(certified), strict=True))
    return [
        _shown(index, entry, own.get(id(entry)), *clipped[id(entry)])
        for index, entry in zip(indices, entries, strict=True)
    ]


def _figures(entries: Sequence[Entry]) -> list[Figures]:
    """Comparison of each entry's optimum with its recorded tap, in one call, which filters them side by side."""
    if not entries:
        return []
    targets = [entry.problem.target for entry in entries]
    optima = [entry.designed.effect.lasting.acceleration_m_s2 for entry in entries]
    return entries[0].problem.yardstick.figures_of(targets, np.stack(optima))


def _clipped(entries: Sequence[Entry]) -> dict[int, tuple[float, FloatArray, FloatArray]]:
    """Entry's id -> tap error and (N + M,) acceleration and input of the clipped optimum, device by device."""
    devices: dict[int, list[Entry]] = {}
    for entry in entries:
        devices.setdefault(id(entry.problem.stage), []).append(entry)
    found = dict[int, tuple[float, FloatArray, FloatArray]]()
    for together in devices.values():
        problem = together[0].problem
        free = np.stack([entry.designed.unlimited_command for entry in together])
        commands = clipped_optimum(problem.stage, problem.grid, free, problem.limits.input_limit)
        lasting = np.concatenate([commands, np.zeros((len(together), problem.grid.after_stages))], axis=1)
        made, inputs = problem.stage.rollout(lasting)
        errors = problem.yardstick.tap_errors([entry.problem.target for entry in together], made)
        found |= zip(map(id, together), zip(errors.tolist(), made, inputs, strict=True), strict=True)
    return found


def _shown(
    index: int,
    entry: Entry,
    figures: Figures | None,
    clipped_error: float,
    clipped_m_s2: FloatArray,
    clipped_input: FloatArray,
) -> Shown:
    problem, answer, proof = entry.problem, entry.solution, entry.certificate
    grid, target, certified = problem.grid, problem.target, figures is not None
    N = grid.stages
    optimum = current = np.full(N + grid.after_stages, np.nan)
    if certified:
        lasting = entry.designed.effect.lasting
        optimum, current = lasting.acceleration_m_s2, lasting.plant_input
    thermal = problem.limits.get(TemperatureLimit.name)
    warm, limit_C = np.zeros(0), np.nan
    if isinstance(thermal, TemperatureLimit):
        limit_C = thermal.limit_C
        warm = entry.designed.effect.winding_C if certified else current[:N]
    free_m_s2 = target.lasting(target.free_m_s2)
    curves = Curves(
        times_s=np.append(grid.switching_times_s, grid.after_times_s),
        recorded_m_s2=target.lasting(target.recorded_m_s2),
        optimum_m_s2=optimum + free_m_s2,
        clipped_m_s2=clipped_m_s2 + free_m_s2,
        input=current,
        clipped_input=clipped_input,
        input_limit=problem.limits.input_limit,
        temperature_C=warm,
        temperature_limit_C=limit_C,
    )
    reason = "; ".join(dict.fromkeys([answer.status.value, *entry.designed.remarks]))
    if not certified and answer.status is Status.OPTIMAL:
        reason = f"{Status.NOT_CERTIFIED.value}: gap {proof.relative_gap:.1e}, limit {proof.GAP_TOLERANCE:.0e}"
    return Shown(
        index=index,
        certified=certified,
        replayed=False,
        reason="" if certified else reason,
        figures=figures,
        floor=entry.floor,
        clipped=clipped_error,
        heat_A2_ms=1e3 * entry.heat_A2_s if certified else np.nan,
        binds=entry.binding if certified else "",
        curves=curves,
    )


def plain(shown: Shown) -> dict[str, Any]:
    """An answer without its curves for JSON; NaN becomes null."""
    own = {name: value for name, value in vars(shown).items() if name != "curves"}
    found: dict[str, Any] = _finite(own)
    return {**found, "cells": shown.cells}


def _finite(value: Any) -> Any:
    if isinstance(value, float):  # most values
        return value if math.isfinite(value) else None
    if isinstance(value, Figures | Warm | Priced):
        value = vars(value)
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, tuple):
        return [_finite(each) for each in value]
    return value
