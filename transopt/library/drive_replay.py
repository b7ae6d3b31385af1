"""Replay of a drive: how saturation, rounding and the driver's rate change an entry.

A driver holds each sample over a period of its own, so the samples pass through amplifier and plant by the exact
zero-order hold of that period (`discretise`). The target is known at the design's instants, which lie anywhere within
the driver's periods: a hold over part of a period gives the state at such an instant.

The design kept the limits with its own commands, not with these samples; the independent replay checks the limits at
every fine step. On a nonlinear plant the samples pass through its stage over the driver's period, and its own replay
checks the limits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from transopt.base.arithmetic import NUMPY
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.library.drive import Drive, Driver
from transopt.library.library import Library
from transopt.library.trade import TradeFigures, entry_trade
from transopt.plant.discretise import discretise
from transopt.plant.nonlinear_stage import NonlinearStage, resolved
from transopt.plant.time_grid import TimeGrid
from transopt.problem.limits import posed
from transopt.problem.limits.limit import Limit, Limits, Setting
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.figures import Yardstick
from transopt.problem.objective.target import Target
from transopt.proof.replay import replay

# Limits not checked for samples: the slew rate, because the step between samples depends on the driver's rate;
# and the coil's temperature, because taking means can only lower it.
NOT_WATCHED = (SlewLimit.name, TemperatureLimit.name)
# Share of a limit by which samples may exceed it, besides half a count for limits in the driver's unit. Amplifiers
# and drivers are not more exact, and the design's own margins hold for the design's rate only.
EXCUSED = 1e-3
SAME = 9  # decimals, in driver periods, to which two instants within a period are considered equal


@dataclass(frozen=True)
class PlayedDrive:
    """The motion and the figures of an entry played through a driver.

    Attributes
    ----------
    drive : the samples played.
    acceleration_m_s2 : (N + M,) y'' at the design's switching instants, in the window and after it.
    tap_error, error_after : in the window and after it, defined as for the design.
    tap_error_designed : tap error of the design.
    figures : the trade's figures of this acceleration.
    limits_left : one sentence for each limit of the scene that is exceeded. For a library with a wall no limit is
        checked, because the wall's feedback follows the device's own motion.
    """

    drive: Drive
    acceleration_m_s2: FloatArray
    tap_error: float
    error_after: float
    tap_error_designed: float
    figures: TradeFigures
    limits_left: tuple[str, ...]

    __repr__ = brief


def _within(grid: TimeGrid, driver: Driver) -> tuple[NDArray[np.intp], FloatArray]:
    """(N + M,) index of the driver's sample held at each design instant, and the elapsed share of its period.

    The driver's first sample acts from tau_0 on. At a switch the new sample counts, as in the design.
    """
    periods = grid.dt_s * driver.rate_Hz * np.arange(grid.stages + grid.after_stages)
    sample = np.floor(periods + 10.0**-SAME).astype(np.intp)
    return sample, np.round(np.maximum(periods - sample, 0.0), SAME)


def _linear_accelerations(library: Library, drive: Drive) -> FloatArray:
    """(N + M,) y'' of a drive on the linear plant at one grip, at the design's instants."""
    plant, amplifier, driver = library.plant(drive.ig), library.amplifier(), drive.driver
    stage, (sample, share) = discretise(plant, amplifier, 1 / driver.rate_Hz), _within(library.time_grid(), driver)
    output = _lasting(drive.values, sample)
    states, held = stage.states(output)[sample], output[sample]
    for part in np.unique(share[share > 0]):
        at, within = share == part, discretise(plant, amplifier, float(part) / driver.rate_Hz)
        states[at] = states[at] @ within.A.T + held[at, None] * within.B[:, 0]
    return np.asarray(states @ stage.C[0] + held * stage.D[0, 0])


def _lasting(values: FloatArray, sample: NDArray[np.intp]) -> FloatArray:
    """A driver's output (m,), padded with zeros at least up to the last sample needed."""
    return np.pad(values, (0, max(int(sample[-1]) + 1 - values.size, 0)))


def _over_period(stage: NonlinearStage, driver: Driver, output: FloatArray) -> NonlinearStage:
    """The device over a period of the driver, in as many steps as its output (m,) needs."""
    return resolved(replace(stage, dt_s=1 / driver.rate_Hz), output)[0]


def _nonlinear_accelerations(library: Library, drive: Drive) -> FloatArray:
    """(N + M,) y'' of a drive on the nonlinear plant, at the design's instants; NaN where it is not finite."""
    # Only a library of a nonlinear plant needs this import.
    from transopt.library.nonlinear import nonlinear_problem

    problem, driver = nonlinear_problem(library, drive.iv, drive.ig), drive.driver
    sample, share = _within(problem.linear.grid, driver)
    output = _lasting(drive.values, sample)
    over_period = _over_period(problem.stage, driver, output)
    states, found = over_period.states(output)[sample], np.empty(sample.size)
    with np.errstate(all="ignore"):  # an overflow shows as a value that is not finite
        for part in np.unique(share):
            at = share == part
            held, z = output[sample[at]], list(states[at].T)
            if part > 0:
                z = replace(over_period, dt_s=float(part) / driver.rate_Hz).step(z, held, NUMPY)
            found[at] = over_period.acceleration(z, held, NUMPY)
    return found


def limits_left(library: Library, drive: Drive) -> tuple[str, ...]:
    """One sentence for each limit that the samples exceed by more than `EXCUSED` and half a count.

    The limits `NOT_WATCHED` are left out; for a library with a wall no limit is checked.
    """
    posing = library.posing()
    if posing.wall is not None:
        return ()
    design, values = posing.grid, drive.values
    grid = TimeGrid(1 / drive.driver.rate_Hz, values.size, design.lead_s, design.delay_s)
    stage = replace(posing, grid=grid).stage(library.plant(drive.ig))
    wanted = library.wanted_of(drive.iv, drive.ig)
    nominal_m, nominal_m_s = (
        np.interp(grid.switching_times_s, design.switching_times_s, course)
        for course in (wanted.nominal_position_m, wanted.nominal_velocity_m_s)
    )
    nothing = np.zeros(values.size)
    setting = Setting(
        stage=stage,
        grid=grid,
        circuit=posing.circuit,
        coil=posing.coil,
        budget=posing.budget,
        wall=None,
        reference_m_s2=nothing,
        nominal_m=nominal_m,
        nominal_m_s=nominal_m_s,
    )
    limits = Limits(
        tuple(limit for limit in posed(posing.asked, setting, posing.law_of) if limit.name not in NOT_WATCHED)
    )
    if library.nonlinear:
        from transopt.library.nonlinear import nonlinear_problem
        from transopt.proof.nonlinear_replay import played_nonlinear

        device = _over_period(nonlinear_problem(library, drive.iv, drive.ig).stage, drive.driver, values)
        (found,) = played_nonlinear(device, stage, Yardstick(grid), Target(nothing), limits, [values])
    else:
        (found,) = replay(stage, grid, values[None], [Target(nothing)], None, limits=[limits])

    def most(limit: Limit) -> float:
        rounded = drive.driver.scale / 2 if limit.unit == drive.driver.unit else 0.0
        return limit.stated + max(limit.replay_tolerance, EXCUSED * abs(limit.stated)) + rounded

    # A comparison with NaN is false, so NaN counts as exceeding the limit.
    return tuple(limit.replayed(found.peak(limit)) for limit in limits if not found.peak(limit) <= most(limit))


def played(library: Library, drives: Sequence[Drive]) -> list[PlayedDrive]:
    """Replay drives of a library, all for the same driver."""
    accelerations = _nonlinear_accelerations if library.nonlinear else _linear_accelerations
    found = []
    for drive in drives:
        acceleration = accelerations(library, drive)
        found_figures = library.yardstick.figures(library.uncorrected(drive.iv, drive.ig), acceleration)
        found.append(
            PlayedDrive(
                drive=drive,
                acceleration_m_s2=acceleration,
                tap_error=found_figures.tap_error,
                error_after=found_figures.error_after,
                tap_error_designed=float(library.tap_error[drive.iv, drive.ig]),
                figures=entry_trade(library, drive.iv, drive.ig, acceleration),
                limits_left=limits_left(library, drive),
            )
        )
    return found
