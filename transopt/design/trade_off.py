"""The trade-off of waveform against intensity: optima along the price lam of intensity.

The path runs from the nearest waveform to nearly the largest energy. Each point is the optimum of L at its lam: no
admissible command with as much energy has a smaller J. The path is therefore the Pareto front of the two objectives.
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

POINTS = 8  # points of the path, both ends included
BEND = 1.5  # exponent of their spacing; above 1 the points are denser at the start


@dataclass(frozen=True)
class TradeOffPoint:
    """One optimum of L; tap error and levels are predictions for the entry's own device.

    Attributes
    ----------
    price : lam.
    energy_dB : energy as the objective counts it: through the error filter, the mean over the devices.
    """

    price: float
    tap_error: float
    energy_dB: float
    levels: Levels


@dataclass(frozen=True)
class TradeOff:
    """The optima for waveform and for intensity of one entry, and the path between them.

    Attributes
    ----------
    place, cells : the entry's speed and grip, as text and as cells of a table row.
    waveform : the optimum of J.
    intensity : the optimum with the energy that the scene asks for, or with that of r where it asks for none.
    missing_dB : shortfall of that energy, where no lam reaches it.
    path : optima by increasing lam; those that the given solver cannot prove are left out.
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
    """Compute the trade-off of an admitted entry for which a limit binds or intensity has a price; otherwise None.

    None also if the worst of a spread of devices is minimised: intensity is defined for the mean only.
    """
    binds = entry.solution.multipliers.largest > BINDING_MULTIPLIER or entry.problem.intensity > 0
    if entry.status is not Status.OPTIMAL or entry.problem.reference_is_zero or entry.problem.worst or not binds:
        return None
    problem = entry.problem.without_intensity()
    found = yield from intense(problem, options)
    if found.attained is None:
        return None
    wave = found if found.attained.price == 0 else (yield from seek(problem, options))
    # The energy in dB is about linear in -log(1 - lam); the path bends most near its start.
    prices = -np.expm1(np.linspace(0.0, 1.0, POINTS) ** BEND * np.log1p(-most_price(problem)))[1:]
    # No second solver is tried for a point that the first one does not prove: it may take a second per point.
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
    own = accelerations[0]
    return TradeOffPoint(
        price=problem.intensity,
        tap_error=problem.yardstick.tap_error(problem.target, own),
        energy_dB=problem.tracking.energy_dB(accelerations),
        levels=levels(own[: problem.grid.stages], problem.reference_m_s2, problem.grid.dt_s),
    )
