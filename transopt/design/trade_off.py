"""What intensity costs in waveform: the path over its price, from the nearest waveform to nearly all energy.

Every point is the optimum of L at its lam, which is the nearest waveform among all commands with as much energy: no
command within the limits has a smaller J and as many dB. So the path is the whole trade-off.
"""

from dataclasses import dataclass, replace

import numpy as np

from transopt.design.entry import Entry
from transopt.design.intensity import intense, most_price
from transopt.design.optimum import seek
from transopt.problem.answer import Status
from transopt.problem.objective.bands import Levels, levels
from transopt.proof.certify import BINDING_MULTIPLIER
from transopt.proof.designed import Designed
from transopt.solvers.options import SolverOptions, TrialOptions
from transopt.solvers.side_by_side import Search, together

POINTS = 8  # of the path, both ends among them
BEND = 1.5  # of their steps, the shorter ones first


@dataclass(frozen=True)
class TradeOffPoint:
    """One optimum of L; tap error and levels as predicted, of the entry's own device.

    Attributes
    ----------
    price : lam.
    energy_dB : what the scene's objective counts: through its error filter, the mean over the devices.
    """

    price: float
    tap_error: float
    energy_dB: float
    levels: Levels


@dataclass(frozen=True)
class TradeOff:
    """Both objectives of one entry, and what lies between them.

    Attributes
    ----------
    place, cells : which entry it is, in a sentence and in the columns of a table.
    waveform : the optimum of J.
    intensity : the one with the energy that the scene asks for, or that of r where it asks for none.
    missing_dB : of that energy, where no lam reaches it.
    path : by growing lam; points that the wanted solver does not prove are left out.
    """

    speed_m_s: float
    grip_N: float
    place: str
    cells: list[str]
    waveform: TradeOffPoint
    intensity: TradeOffPoint
    missing_dB: float
    path: tuple[TradeOffPoint, ...]


def trade_off(entry: Entry, options: SolverOptions) -> Search[TradeOff | None]:
    """Search for the path of an entry where a limit binds or intensity has a price; None elsewhere, or if refused.

    None as well where the worst of a spread of devices is least: intensity is traded for the mean alone.
    """
    binds = entry.solution.multipliers.largest > BINDING_MULTIPLIER or entry.problem.intensity > 0
    if entry.status is not Status.OPTIMAL or entry.problem.reference_is_zero or entry.problem.worst or not binds:
        return None
    problem = entry.problem.without_intensity()
    found = yield from intense(problem, options)
    if found.attained is None:
        return None
    wave = found if found.attained.price == 0 else (yield from seek(problem, options))
    # The energy in dB goes about evenly with -log(1 - lam); the path bends most near its start.
    prices = -np.expm1(np.linspace(0.0, 1.0, POINTS) ** BEND * np.log1p(-most_price(problem)))[1:]
    # A point of the path that the first method does not prove is left out: another one may take a second.
    trial = TrialOptions(options.solver, options.tolerance, options.max_iterations)
    others = together([seek(replace(problem, intensity=float(price)), trial) for price in prices if price > 0])
    ends = (_point(wave), _point(found))
    path = {point.price: point for point in (*ends, *(_point(each) for each in others if each.is_proven))}
    return TradeOff(
        speed_m_s=entry.speed_m_s,
        grip_N=entry.grip_N,
        place=entry.place,
        cells=entry.cells,
        waveform=ends[0],
        intensity=ends[1],
        missing_dB=found.attained.missing_dB,
        path=tuple(path[price] for price in sorted(path)),
    )


def _point(designed: Designed) -> TradeOffPoint:
    problem, command = designed.problem, designed.solution.command
    accelerations = problem.accelerations(command)
    own = accelerations[0, : problem.grid.stages]
    return TradeOffPoint(
        price=problem.intensity,
        tap_error=problem.yardstick.tap_error(problem.target, own),
        energy_dB=problem.tracking.energy_dB(accelerations),
        levels=levels(own, problem.reference_m_s2, problem.grid.dt_s),
    )
