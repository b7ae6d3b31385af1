"""Thermal resistances, time constants and resistance of a coil from a heating and cooling record.

The two-node model of `transopt.plant.coil`, with copper's resistance rise and the ripple of seed Eq. 7, is driven by
the recorded current and compared with the recorded temperatures: nonlinear least squares in the logarithms of the
thermal parameters from several starts. If `ambient_C` is recorded, the start temperatures are fitted too; if not, the
record must begin cold: ambient, winding and housing at one temperature, which is fitted, and a room's.

The resistance at 25 C and that of the leads within the voltage are unknowns too, known beforehand as far as they are
stated. Taken as exact, 1 % of them shifts the temperature by voltage over current by 2.6 K: a quarter of what the
winding of a small motor is above its housing, and so of R_wh, which fits the record almost as well.

The temperatures of row k are read at its instant; its current flows until row k + 1.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from transopt.base.signals import FloatArray, IndexArray
from transopt.identify.fit import Fit, known, quantile
from transopt.identify.heat_record import (
    COARSEST,
    DRIFT_K,
    LEAST_RISE_K,
    LEAST_STEP,
    SENSING,
    Channel,
    HeatRecord,
)
from transopt.identify.squares import Squares, by_differences, inverse
from transopt.plant.coil import COPPER_PER_K, RESISTANCE_REFERENCE_C, CoilModel

THERMAL = ("R_wh_K_W", "R_ha_K_W", "tau_w_s", "tau_h_s")
NAMES = (*THERMAL, "R_ohm")
STARTS = 5
MOST_UNCERTAIN = 0.25  # largest relative half width of an interval to design with
STEADY_TAU = 1.0  # least time of heating over the housing's time constant
MOST_MISFIT = 1.5  # largest rms of the residuals over the noise, where that is white
MANY_ROWS = 10  # in a mean, so that noise which is correlated over a few rows shows at its full size
UNLIKE = 0.1  # correlation of two residuals that counts as none
MOST_SURPRISE = 6.0  # sum of squares of the two resistances off what was stated, in standard deviations: 95 %
ROOM_C, ROOM_K = 22.0, 5.0  # where nothing says how warm a cold start is: mean and standard deviation
_CREDIBLE_K_W = (0.2, 500.0)  # thermal resistance from coil to ambient; motors of 6 mm and of 60 mm lie within
_CREDIBLE_S = (5.0, 2e4)  # time constant of a housing
_WIDEST = 10.0  # relative half widths above this are stated as this
_GROWTH = 0.03  # longest step of the simulation over the time since the current last changed
_FAR = np.log(100.0)  # bound of the search: a factor of 100 from the guess
TEMPERATURE_K = 10.0  # unit of the unknown temperatures, so that all unknowns are of similar size
_WIDE_K = 50.0  # bound of the start temperatures around the first reading


@dataclass(frozen=True)
class CoilFit(Fit):
    """The thermal model of a coil fitted to a record, with its uncertainty.

    Attributes
    ----------
    record : the fitted record.
    coil : the fitted model, start temperatures included.
    nominal : the motor's model in the surroundings of its scene, which the fit is to replace.
    leads_ohm : fitted resistance beside the winding's within the recorded voltage; 0 without a voltage.
    by_leads : share by which R_wh + R_ha would be larger if the leads had `record.leads_ohm` more than was assumed.
    surprise : squares of the deviations of both resistances from what was stated, in standard deviations, summed.
    intervals : (5, 2) 95 % intervals of `NAMES`.
    covariance : (5, 5) covariance of `NAMES`.
    misfit : rms of the residuals over the sensors' noise; 1 where the model explains all.
    starts : sum of squares reached from each start, the best first.
    winding_C, housing_C : (n,) temperatures of the model at the record's rows.
    """

    record: HeatRecord
    coil: CoilModel
    nominal: CoilModel
    leads_ohm: float
    by_leads: float
    surprise: float
    intervals: FloatArray
    covariance: FloatArray
    misfit: float
    starts: tuple[float, ...]
    winding_C: FloatArray
    housing_C: FloatArray

    def shortfalls(self) -> list[str]:
        coil, record, found = self.coil, self.record, _incredible(self.coil)
        half = (self.intervals[:, 1] - self.intervals[:, 0]) / 2
        wide = [
            f"{name} to {100 * min(h / getattr(coil, name), _WIDEST):.0f} %"
            for name, h in zip(NAMES, half, strict=True)
            if h > MOST_UNCERTAIN * getattr(coil, name)
        ]
        if record.rise_K < LEAST_RISE_K:
            found.append(
                f"the winding rises by {record.rise_K:.1f} K (at least {LEAST_RISE_K:g} K): heat with more current"
            )
        short = record.powered_s < STEADY_TAU * coil.tau_h_s
        if short:
            found.append(
                f"current flows for {record.powered_s:.0f} s, the housing is not steady before {coil.tau_h_s:.0f} s "
                f"have passed several times: heat for {2.5 * coil.tau_h_s:.0f} s and let cool as long"
            )
        if record.dt_s > COARSEST * coil.tau_w_s:
            found.append(
                f"one row in {record.dt_s:g} s, the winding's time constant is {coil.tau_w_s:.3g} s: record every "
                f"{0.1 * coil.tau_w_s:.2g} s or faster"
            )
        if coil.tau_h_s < 3 * coil.tau_w_s:
            found.append(
                "only one node shows in the record (both time constants are alike): switch the current on and off in "
                "steps, record faster, and the housing too"
            )
        if wide:
            remedy = "record heating and cooling longer, with more current"
            if record.cools_unseen:
                share = f"{100 * SENSING:g} % of the current"
                remedy = f"below {share} no temperature is known of the cooling: leave {150 * SENSING:g} % on"
            found.append(
                f"known only {', '.join(wide)} (at most {100 * MOST_UNCERTAIN:.0f} %): {remedy}"
                f"{'' if record.housing else ', or record the housing too (housing_C)'}"
            )
        if self.surprise > MOST_SURPRISE:
            found.append(
                f"stated R_25 = {record.R_ohm:g} ohm +- {100 * record.R_tolerance:g} % and at most "
                f"{record.leads_ohm:.2g} ohm of leads, but voltage over current makes them {coil.R_ohm:.3g} and "
                f"{self.leads_ohm:.2g} ohm: state --resistance-ohm {coil.R_ohm:.3g} --leads-ohm "
                f"{abs(self.leads_ohm):.2g}, or record voltage_V again, at the motor and from cold on"
            )
        most = MOST_MISFIT * self._alike_rows() ** 0.5
        if self.misfit > most:
            found.append(
                f"the model misses the record by {self.misfit:.2g} times its noise (at most {most:.2g}): did "
                "the coil begin cold, is the current as recorded, R_25 that of this motor, the ambient steady? "
                "Record ambient_C and housing_C too"
            )
        if record.ambient_drift_K > DRIFT_K:
            found.append(
                f"the ambient drifts by {record.ambient_drift_K:.1f} K (at most {DRIFT_K:g} K): shield the motor"
            )
        return found

    def _alike_rows(self) -> int:
        """Rows over which a thermometer's own filter or resolution correlates the winding's noise; 1 if it does not.

        The noise of a mean over such rows is up to sqrt(rows) times that of white noise. What is correlated for
        longer than half the winding's time constant is no noise but a misfit of the model.
        """
        known = self.record.winding.weight > 0
        off = (self.winding_C - self.record.winding.values_C)[known]
        off = off - off.mean()
        longest = min(int(self.coil.tau_w_s / (2 * self.record.dt_s)), off.size // 10)
        for rows in range(1, longest + 1):
            if off[rows:] @ off[:-rows] < UNLIKE * (off @ off):
                return rows
        return 1

    def supports(self) -> str:
        # The identified coil in the scene's surroundings, to be compared with the datasheet.
        nominal, ripple_A = self.nominal, self.record.ripple_A
        continuous_A = replace(self.coil, ambient_C=nominal.ambient_C).continuous_current_A()
        ripple = f"; fitted with {ripple_A:g} A of ripple, a design counts {nominal.ripple_A:g} A"
        return (
            f"supports temperature limits of bursts and of repeated taps; {continuous_A:.3f} A for ever hold the "
            f"winding at its {nominal.limit_C:g} C in {nominal.ambient_C:g} C"
            f"{'' if ripple_A == nominal.ripple_A else ripple}"
        )

    def stated(self) -> dict[str, Any]:
        values = {name: getattr(self.coil, name) for name in NAMES}
        return {**values, **known(NAMES, self.covariance, self.intervals)}


def _incredible(coil: CoilModel) -> list[str]:
    """Complaints about values that no motor of a haptic device has: a wrong unit can fit without any misfit."""
    bounded = (
        ("R_wh + R_ha", coil.R_wh_K_W + coil.R_ha_K_W, "K/W", _CREDIBLE_K_W, "current_A in A, the resistance in ohm"),
        ("tau_h", coil.tau_h_s, "s", _CREDIBLE_S, "time_s in s"),
    )
    return [
        f"{name} of {value:.3g} {unit} is that of no such motor ({least:g} to {most:g} {unit}): is {column}?"
        for name, value, unit, (least, most), column in bounded
        if not least <= value <= most
    ]


def _first_of_steps(record: HeatRecord) -> IndexArray:
    """(K + 1,) row at which each step of the simulation begins, and the end.

    The record is merged into few steps: short after each change of the current, then growing.
    """
    heat = record.heating_A2[:-1]
    threshold = LEAST_STEP * heat.max()
    first, changed, level = [0], 0, heat[0]
    for k in range(1, heat.size):
        if abs(heat[k] - level) > threshold:
            changed, level = k, heat[k]
            first.append(k)
        elif k - first[-1] >= max(1.0, _GROWTH * (k - changed)):
            first.append(k)
    return np.array([*first, heat.size])


class _Misfit(Squares):
    """Weighted residuals of a record, and after them what is known beforehand.

    The unknowns are the logarithms of `THERMAL`; the deviations of R_25 and of the leads from what is stated, in
    standard deviations; then temperatures in units of `TEMPERATURE_K`.
    """

    def __init__(self, record: HeatRecord) -> None:
        super().__init__(
            by_differences(lambda sets: np.array([np.append(self.residuals(one), self.prior(one)) for one in sets]))
        )
        self.record, self._first = record, _first_of_steps(record)
        rows, heat = np.diff(self._first), record.heating_A2[:-1]
        self._heating_A2, self._lengths_s = np.add.reduceat(heat, self._first[:-1]) / rows, record.dt_s * rows
        channels = {id(each): each for each in (record.winding, record.electrical) if each is not None}
        self._channels = [(0, channel, self._means(channel)) for channel in channels.values()]
        if record.housing is not None:
            self._channels.append((1, record.housing, self._means(record.housing)))

    def _means(self, channel: Channel) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Per step: total weight, weighted mean temperature, and the mean row's place within the step, 0 to 1."""
        first, rows = self._first[:-1], np.diff(self._first)
        n = self._first[-1]
        weight = channel.weight[:n]
        total = np.add.reduceat(weight, first)
        safe = np.where(total > 0, total, 1.0)
        place = (np.arange(n) - np.repeat(first, rows)) / np.repeat(rows, rows)
        return (
            total,
            np.add.reduceat(weight * channel.values_C[:n], first) / safe,
            np.add.reduceat(weight * place, first) / safe,
        )

    def coil(self, theta: FloatArray) -> CoilModel:
        """The model with unknowns theta and without a temperature limit."""
        R_wh, R_ha, tau_w, tau_h = np.exp(theta[:4]).tolist()
        ambient, winding, housing = self._temperatures(theta)
        return CoilModel(
            self.record.R_ohm * float(np.exp(self.record.R_tolerance / quantile() * theta[4])),
            R_wh,
            R_ha,
            tau_w,
            tau_h,
            limit_C=np.inf,
            ambient_C=ambient,
            start_winding_C=winding,
            start_housing_C=housing,
        )

    def _temperatures(self, theta: FloatArray) -> tuple[float, float, float]:
        if self.record.ambient_C is None:
            cold = TEMPERATURE_K * float(theta[6])
            return cold, cold, cold
        winding, housing = (TEMPERATURE_K * theta[6:]).tolist()
        return self.record.ambient_C, winding, housing

    def leads_ohm(self, theta: FloatArray) -> float:
        """Resistance beside the winding's within the voltage."""
        return float(self.record.leads_ohm / quantile() * theta[5])

    def prior(self, theta: FloatArray) -> FloatArray:
        """Unknowns off what is known of them beforehand, in standard deviations: both resistances first."""
        cold = theta[6:] if self.record.ambient_C is None else theta[:0]
        return np.append(theta[4:6], (TEMPERATURE_K * cold - ROOM_C) / ROOM_K)

    def residuals(self, theta: FloatArray) -> FloatArray:
        """Model minus record in each step of each channel, over the noise."""
        coil, stated_ohm = self.coil(theta), self.record.R_ohm
        courses = coil.simulate(self._heating_A2[None], self._lengths_s)
        parts = []
        for which, channel, (weight, mean, place) in self._channels:
            course = courses[which][0]
            expected = (1 - place) * course[:-1] + place * course[1:]
            if channel is self.record.electrical:
                warm_ohm = coil.R_ohm * (1 + COPPER_PER_K * (expected - RESISTANCE_REFERENCE_C))
                apart = (warm_ohm + self.leads_ohm(theta)) / stated_ohm - 1
                expected = RESISTANCE_REFERENCE_C + apart / COPPER_PER_K
            parts.append(np.sqrt(weight) * (expected - mean) / channel.noise_K)
        return np.concatenate(parts)

    def over_many_rows(self, theta: FloatArray) -> float:
        """Mean square of the residuals whose temperature is a mean over many rows; 0 if there are few."""
        long = np.diff(self._first) >= MANY_ROWS
        read = np.concatenate([long & (means[0] > 0) for _, _, means in self._channels])
        return float(np.mean(self.residuals(theta)[read] ** 2)) if np.count_nonzero(read) >= MANY_ROWS else 0.0

    @property
    def informed(self) -> int:
        """Number of steps, summed over the channels, in which a temperature was read."""
        return sum(int(np.count_nonzero(means[0])) for _, _, means in self._channels)


def fit_coil(record: HeatRecord, nominal: CoilModel, *, starts: int = STARTS) -> CoilFit:
    """Fit the thermal parameters and the resistance to a record.

    Parameters
    ----------
    record : see `heat_record`.
    nominal : the motor's model, which gives the limit of the winding.
    starts : number of starts, log-uniform within a factor of 3 around a guess from the record.
    """
    misfit = _Misfit(record)
    guess = _guess(record)
    reach = np.concatenate([np.full(4, _FAR), np.full(2, np.inf), np.full(guess.size - 6, _WIDE_K / TEMPERATURE_K)])
    random = np.random.default_rng(0)
    shifts = np.pad(np.log(3.0) * random.uniform(-1, 1, (starts, 4)), ((0, 0), (0, guess.size - 4)))
    shifts[0] = 0.0
    solved = misfit.searches(guess + shifts, guess - reach, guess + reach, most=60)
    theta, residuals = solved[0][0], misfit.residuals(solved[0][0])
    free = max(misfit.informed - theta.size, 1)
    excess = float(residuals @ residuals) / free
    # Noise that is not white raises the misfit above 1, most in means over many rows, and so widens the intervals.
    slopes = misfit.evaluate(theta)[1]
    slopes[: residuals.size] /= np.sqrt(max(excess, misfit.over_many_rows(theta), 1.0))
    of_log = np.append(np.ones(4), record.R_tolerance / quantile())
    whole = inverse(slopes)
    covariance = whole[:5, :5] * np.outer(of_log, of_log)
    coil = misfit.coil(theta)
    resistances = np.array([coil.R_wh_K_W, coil.R_ha_K_W])
    values = np.array([getattr(coil, name) for name in NAMES])
    half = quantile(free) * np.sqrt(np.diagonal(covariance))
    with np.errstate(over="ignore"):  # a parameter that the record does not determine
        intervals = values[:, None] * np.exp(np.clip(np.stack([-half, half], axis=1), -300, 300))
    rows = np.full(record.heating_A2.size - 1, record.dt_s)
    winding, housing = coil.simulate(record.heating_A2[None, :-1], rows)
    return CoilFit(
        record=record,
        coil=replace(coil, limit_C=nominal.limit_C),
        nominal=nominal,
        leads_ohm=misfit.leads_ohm(theta),
        # The unknowns move by their covariance with the leads, as the leads' prior moves by its deviation.
        by_leads=float(quantile() * (whole[:2, 5] @ resistances) / resistances.sum()),
        surprise=float(np.sum(misfit.prior(theta)[:2] ** 2)),
        intervals=intervals,
        covariance=np.outer(values, values) * covariance,
        misfit=float(np.sqrt(excess)),
        starts=tuple(cost for _, cost in solved),
        winding_C=winding[0],
        housing_C=housing[0],
    )


def _guess(record: HeatRecord) -> FloatArray:
    """(7,) or (8,) unknowns to start from, right to a factor of ten.

    It assigns 80 % of the rise to the housing, and takes a quarter of the heating time for its time constant.
    """
    known = record.winding.weight > 0
    cold = float(record.winding.values_C[known][:3].mean())
    hot = cold + record.rise_K
    power = record.R_ohm * (1 + COPPER_PER_K * (hot - RESISTANCE_REFERENCE_C)) * float(record.heating_A2.max())
    total = record.rise_K / power
    slow = max(record.powered_s / 4, 10 * record.dt_s)
    cold /= TEMPERATURE_K
    temperatures = [cold] if record.ambient_C is None else [cold, cold]
    return np.concatenate([np.log([0.2 * total, 0.8 * total, slow / 30, slow]), [0.0, 0.0], temperatures])
