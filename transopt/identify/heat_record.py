"""A recorded heating of the coil: the heating current and the measured temperatures."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray, Signal
from transopt.identify.measurement import BY_NAME, Measurement
from transopt.plant.coil import COPPER_PER_K, PWM_RIPPLE_A, RESISTANCE_REFERENCE_C, effective_square

LEAST_RISE_K, LEAST_RISE_NOISE = 10.0, 5.0
COARSEST = 0.2  # largest time between two rows over the winding's time constant
DRIFT_K = 2.0  # largest drift of the ambient; the model takes it as constant
SENSING = 0.2  # share of the largest current below which voltage over current gives no temperature
R_TOLERANCE = 0.08  # of a resistance at 25 C by the datasheet, in which 95 % of such motors lie
LEADS = 0.05  # of that resistance: what 95 % of the leads between motor and voltmeter stay below
_CREDIBLE_C = (-50.0, 400.0)  # temperature of a winding
LEAST_STEP = 0.1  # least change of the heating, over its maximum, that counts as a step
_LEAST_NOISE_K = 1e-3
MOST_RIPPLE_A = 0.5
MOST_TOLERANCE = 0.5


@dataclass(frozen=True)
class Channel:
    """One recorded temperature.

    Attributes
    ----------
    values_C : (n,) temperature of each row.
    weight : (n,) weight of each row; 0 where the temperature is not known.
    noise_K : rms noise of a row of weight 1.
    """

    values_C: FloatArray
    weight: FloatArray
    noise_K: float


@dataclass(frozen=True)
class HeatRecord:
    """A heating and cooling record, ready for the fit.

    Attributes
    ----------
    dt_s : time between rows.
    heating_A2 : (n,) i_eff^2 from each row to the next.
    winding, housing : recorded temperatures; None where the housing was not recorded.
    ambient_C : mean; None if not recorded.
    ambient_drift_K : range of the ambient.
    R_ohm : resistance at 25 C as stated.
    R_tolerance : share of `R_ohm` within which the true one lies with a probability of 95 %.
    leads_ohm : resistance in `voltage_V` beside the winding's stays within this with a probability of 95 %.
    ripple_A : PWM ripple of the amplifier, which heats in addition to the recorded current.
    electrical : temperature by voltage over current for a winding of `R_ohm` without leads; None without a voltage.
        It is `winding` where the winding has no thermometer.
    """

    dt_s: float
    heating_A2: FloatArray
    winding: Channel
    housing: Channel | None
    ambient_C: float | None
    ambient_drift_K: float
    R_ohm: float
    R_tolerance: float
    leads_ohm: float
    ripple_A: float
    electrical: Channel | None

    @cached_property
    def rise_K(self) -> float:
        """Rise from the first rows to the hottest hundredth of the rows: of means, since noise sets an extreme."""
        known = self.winding.values_C[self.winding.weight > 0]
        few = max(known.size // 100, 3)
        return float(np.sort(known)[-few:].mean() - known[:few].mean())

    @cached_property
    def powered_s(self) -> float:
        """Time during which the heating is above half of its maximum."""
        return float(self.dt_s * np.count_nonzero(self.heating_A2 > 0.5 * self.heating_A2.max()))

    @property
    def cools_unseen(self) -> bool:
        """Whether no temperature of the winding is known at less than half of the heating."""
        cooling = self.heating_A2 < 0.5 * self.heating_A2.max()
        return not np.any(self.winding.weight[cooling] > 0)


def heat_record(
    run: Measurement,
    R_ohm: float,
    ripple_A: float = PWM_RIPPLE_A,
    *,
    R_tolerance: float | None = None,
    leads_ohm: float | None = None,
) -> HeatRecord:
    """The heating record of a file; without `winding_C` the winding's temperature follows from voltage over current.

    Parameters
    ----------
    R_ohm : resistance at 25 C, > 0.
    R_tolerance : share of `R_ohm` within which the true one lies with a probability of 95 %; None for `R_TOLERANCE`.
    leads_ohm : 95 % bound of the leads' resistance within `voltage_V`; None for `LEADS` of `R_ohm`.
    ripple_A : PWM ripple that heats in addition to the recorded current; 0 for a linear amplifier, or where the
        recorded current is an rms value that includes the ripple.

    Raises
    ------
    InputError : a column is missing, nothing heats, or the temperature does not rise out of its noise.
    """
    current = run.require("current")
    if not 0 < R_ohm < np.inf:
        raise InputError(f"--resistance-ohm {R_ohm:g}: must be > 0 and finite")
    R_tolerance = R_TOLERANCE if R_tolerance is None else R_tolerance
    if not 0 <= R_tolerance <= MOST_TOLERANCE:
        raise InputError(
            f"--resistance-tolerance {R_tolerance:g}: must be 0 to {MOST_TOLERANCE:g} of the resistance; a datasheet "
            f"is good to {R_TOLERANCE:g}"
        )
    leads_ohm = LEADS * R_ohm if leads_ohm is None else leads_ohm
    if not 0 <= leads_ohm < np.inf:
        raise InputError(f"--leads-ohm {leads_ohm:g}: must be >= 0 and finite; 0 if measured at the motor")
    if not 0 <= ripple_A <= MOST_RIPPLE_A:
        raise InputError(f"--ripple-A {ripple_A:g} A: must be 0 to {MOST_RIPPLE_A:g} A; 0 for a linear amplifier")
    largest = float(np.abs(current.values).max())
    if not largest > max(ripple_A, PWM_RIPPLE_A):
        raise InputError(
            f"{run.name}: current stays below {largest:.2g} A: nothing heats the coil; record current_A "
            "while it is heated"
        )
    electrical = None if run.voltage is None else _electrical(run.name, current.values, run.voltage.values, R_ohm)
    winding = electrical if run.winding is None else _channel(run.winding)
    if winding is None:
        raise InputError(f"{run.name}: neither winding_C nor voltage_V: record one of them, or {BY_NAME}")
    ambient = run.ambient
    record = HeatRecord(
        dt_s=current.dt_s,
        heating_A2=effective_square(current.values, ripple_A),
        winding=winding,
        housing=None if run.housing is None else _channel(run.housing),
        ambient_C=None if ambient is None else float(ambient.values.mean()),
        ambient_drift_K=0.0 if ambient is None else _drift(ambient.values),
        R_ohm=R_ohm,
        R_tolerance=R_tolerance,
        leads_ohm=leads_ohm,
        ripple_A=ripple_A,
        electrical=electrical,
    )
    if np.ptp(record.heating_A2) < LEAST_STEP * record.heating_A2.max():
        raise InputError(
            f"{run.name}: no step: the current stays at {np.abs(current.values).mean():.3g} A throughout; record "
            "from before it is switched on until long after it is switched off"
        )
    least = LEAST_RISE_NOISE * winding.noise_K
    if record.rise_K < least:
        raise InputError(
            f"{run.name}: the winding rises by {record.rise_K:.2g} K, its noise is {winding.noise_K:.2g} K: at least "
            f"{least:.2g} K are needed; heat longer and with more current"
        )
    return record


def _drift(ambient_C: FloatArray) -> float:
    """Range [K] of the means over tenths of the record."""
    return float(np.ptp([part.mean() for part in np.array_split(ambient_C, min(10, ambient_C.size))]))


def _channel(x: Signal) -> Channel:
    return Channel(x.values, np.ones(x.values.size), _noise(x.values))


def _noise(values: FloatArray) -> float:
    """Standard deviation of the rows' noise, from second differences, which a smooth course hardly affects.

    Rounding hides noise below the resolution, and leaves the uniform error of the smallest step of the values.
    """
    steps = np.diff(np.unique(values))
    rounding = float(steps.min()) / np.sqrt(12) if steps.size else 0.0
    return max(float(np.sqrt(np.median(np.diff(values, 2) ** 2) / 6 / 0.4549)), rounding, _LEAST_NOISE_K)


def _electrical(name: str, current_A: FloatArray, voltage_V: FloatArray, R_ohm: float) -> Channel:
    """Winding temperature from voltage over current, where enough flows; its variance is proportional to 1 / i^2.

    Noise of the current biases the temperature by (noise / i)^2 / alpha: 0.1 K for 5 mA in 0.25 A; hence `SENSING`.
    """
    share = np.abs(current_A) / np.abs(current_A).max()
    known = share > SENSING
    resistance = np.where(known, voltage_V / np.where(known, current_A, 1.0), R_ohm)
    temperature = RESISTANCE_REFERENCE_C + (resistance / R_ohm - 1) / COPPER_PER_K
    strong = temperature[share > 0.5]
    if strong.size < 4 or not _CREDIBLE_C[0] < float(np.median(strong)) < _CREDIBLE_C[1]:
        raise InputError(
            f"{name}: voltage over current is {np.median(resistance[known]):.3g} ohm, which makes the winding "
            f"{np.median(temperature[known]):.0f} C at R_25 = {R_ohm:g} ohm: check sign and unit of voltage_V and "
            "the resistance at 25 C of this motor (--resistance-ohm)"
        )
    return Channel(temperature, np.where(known, share**2, 0.0), _noise(strong))
