"""One tap as the page shows it: curves, figures, and the cells of its row in the table."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
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
from transopt.web.price import Priced
from transopt.web.warm import Warm

FIGURES = ("tap", "floor", "felt", "felt_dB", "speed", "bump", "heat")  # columns of the library's own table


@dataclass(frozen=True)
class Place:
    """Which tap it is.

    Attributes
    ----------
    speed_m_s, grip_N : 0 of a named target.
    target : its name; empty for a tap.
    title : in words.
    between : whether it lies between the nodes of the scene, where the sliders of speed and grip put it.
    """

    speed_m_s: float
    grip_N: float
    target: str
    title: str
    between: bool = False


@dataclass(frozen=True)
class Curves:
    """One tap as it is drawn; without a certified optimum its own curves are NaN.

    Attributes
    ----------
    times_s : (N + M,) the switching instants, and those after the window.
    recorded_m_s2 : (N + M,) r, the recorded acceleration.
    optimum_m_s2, clipped_m_s2 : (N + M,) y'' of the optimum, and of the unlimited one cut at the limit.
    input, clipped_input : (N + M,) what drives the plant [A or V].
    input_limit : that they stay within.
    temperature_C : (N,) of the winding at the ends of the periods; (0,) without a coil.
    temperature_limit_C : NaN without a coil.
    warm_m_s2, warm_input : (N + M,) as `optimum_m_s2` and `input`, of what is played on a coil as warm as is asked
        for; (0,) where nothing is asked.
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
    index : of the place.
    certified : whether the project's certificate is accepted; what is not is greyed.
    replayed : whether it is admitted too, as an entry of a library is.
    reason : why it is not certified; empty if it is.
    figures : how near the optimum comes to the recorded tap; None where there is none.
    floor, clipped : tap error of the optimum without limits, and of that one clipped.
    heat_A2_ms : integral of the squared current.
    binds : what holds it back, in words.
    curves : as drawn; None in the answer of `settled`, which changes no curve.
    warm : what is played on a coil as warm as is asked for; None where nothing is asked, or it is not certified.
    prices : of the limits that bind, the dearest first; known when settled.
    verdict : known when settled.
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
        """Column of the table -> what stands there, as every other table of the project has it."""
        f = self.figures
        values = {"floor": self.floor}
        if f is not None:
            values |= {"tap": f.tap_error, "felt": f.felt_error, "felt_dB": f.felt_dB, "speed": f.speed}
            values |= {"bump": f.bump_m_s2, "heat": self.heat_A2_ms / 1e3}
        found = {name: COLUMNS[name].show(values.get(name, NAN)) for name in FIGURES}
        return {**found, "clipped": percent(self.clipped), "binding": self.binds or UNKNOWN}


def shown(indices: Sequence[int], entries: Sequence[Entry]) -> list[Shown]:
    """Taps of one scene from their entries, before they are replayed."""
    clipped = _clipped(entries)
    return [_shown(index, entry, *clipped[id(entry)]) for index, entry in zip(indices, entries, strict=True)]


def _clipped(entries: Sequence[Entry]) -> dict[int, tuple[FloatArray, FloatArray]]:
    """(N + M,) acceleration and input of every unlimited optimum cut at the limit, those of one device together."""
    devices: dict[int, list[Entry]] = {}
    for entry in entries:
        devices.setdefault(id(entry.problem.stage), []).append(entry)
    found = {}
    for together in devices.values():
        problem = together[0].problem
        free = np.stack([entry.designed.unlimited_command for entry in together])
        commands = clipped_optimum(problem.stage, problem.grid, free, problem.limits.input_limit)
        lasting = np.pad(commands, ((0, 0), (0, problem.grid.after_stages)))
        for entry, *rolled in zip(together, *problem.stage.rollout(lasting), strict=True):
            found[id(entry)] = rolled[0], rolled[1]
    return found


def _shown(index: int, entry: Entry, clipped_m_s2: FloatArray, clipped_input: FloatArray) -> Shown:
    problem, answer, proof = entry.problem, entry.solution, entry.certificate
    grid, target = problem.grid, problem.target
    N = grid.stages
    certified = answer.status is Status.OPTIMAL and (proof.accepted or _bent(entry))
    optimum = current = np.full(N + grid.after_stages, np.nan)
    if certified:
        lasting = entry.designed.effect.lasting
        optimum, current = lasting.acceleration_m_s2, lasting.plant_input
    thermal = problem.limits.get(TemperatureLimit.name)
    warm, limit_C = np.zeros(0), np.nan
    if isinstance(thermal, TemperatureLimit):
        limit_C = thermal.limit_C
        warm = thermal.temperatures_C(current[:N], answer.command) if certified else current[:N]
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
    said = "; ".join(dict.fromkeys([answer.status.value, *entry.designed.remarks]))
    if not certified and answer.status is Status.OPTIMAL:
        said = f"{Status.NOT_CERTIFIED.value}: gap {proof.relative_gap:.1e}, limit {proof.GAP_TOLERANCE:.0e}"
    return Shown(
        index=index,
        certified=certified,
        replayed=False,
        reason="" if certified else said,
        figures=problem.figures(optimum) if certified else None,
        floor=entry.floor,
        clipped=problem.yardstick.tap_error(target, clipped_m_s2),
        heat_A2_ms=1e3 * entry.heat_A2_s if certified else np.nan,
        binds=entry.binding if certified else "",
        curves=curves,
    )


def _bent(entry: Entry) -> bool:
    """Whether the answer is a stationary point under a limit of a user's own, of which nobody can promise more."""
    own = any(name != TemperatureLimit.name for name in entry.problem.nonlinear)
    return entry.certificate.is_stationary and own


def plain(shown: Shown) -> dict[str, Any]:
    """An answer without its curves, as JSON has it: null where there is no number."""
    own = asdict(replace(shown, curves=None))
    del own["curves"]
    found: dict[str, Any] = _finite(own)
    return {**found, "cells": shown.cells}


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value
