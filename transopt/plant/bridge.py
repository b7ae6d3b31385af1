"""An amplifier modelled by its parts: an H-bridge with unipolar PWM under a PI current loop (seed Secs. 4.1, 4.2).

Pole, delay and ripple of the current follow from the motor's resistance and inductance, the rail, the switching
frequency and the loop's gain. One leg compares the voltage with a triangular carrier, the other its negative. So the
motor sees two pulses of the rail per carrier period, one every T = 1 / (2 f_s).

- Loop: a PI controller that cancels the winding's pole. It samples between the pulses, and its output acts one sample
  late. With the hold the delay is 0.75 / f_s (Holmes, Lipo, McGrath, Kong 2009, Optimized design of stationary frame
  three phase AC current regulators, IEEE Trans. Power Electronics 24(11)). Its crossover is gain / (2 pi L).
- Ripple: the periodic current of R and L under pulses of duty d; for R T << L its peak-to-peak value is
  V d (1 - d) / (2 L f_s) (Mohan, Undeland, Robbins 2003, Power Electronics, Sec. 7-7).
- Eddy currents act as a resistance across the inductance: with a voltage step the current jumps by
  step / (R + R_eddy). The heat of the jumps grows with |i|, as in seed Eq. 7; that of the remaining ripple with i^2.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.writing import rounded_down
from transopt.plant.coil import Circuit

# The bounds are the range over which the model was compared with a simulated bridge.
SLOWEST_SWITCHING_HZ, FASTEST_SWITCHING_HZ = 10e3, 100e3
LEAST_L_H, MOST_L_H = 0.05e-3, 2e-3
FASTEST_CROSSOVER = 0.1  # as a share of the switching frequency; the delay makes faster loops ring
MOST_RIPPLE_A = 1.0  # peak to peak, at the worst duty
MOST_LAPSE = 0.75  # largest T R / L: above it the loop's samples lie more than 2.4 % below the mean current
SHORT_LAPSE = 1e-3  # below this T R / L the ripple is a triangle to a relative error of 1e-7
LEAST_EDDY = 4.0  # least R_eddy over the winding's R: below it the current's jump is no small part of the current


@dataclass(frozen=True)
class Bridge:
    """Motor on an H-bridge with unipolar PWM and a sampled PI current loop.

    Attributes
    ----------
    circuit : the motor's circuit, R at 25 C.
    rail_V : supply that the bridge switches.
    switching_Hz : frequency of the carrier, at which each transistor switches.
    gain_V_A : proportional gain of the loop; None tunes it to the fastest crossover, a tenth of the switching
        frequency. The integral part follows from the winding: the controller's zero lies at R / L.
    R_eddy_ohm : resistance of eddy currents across the inductance; None without them.

    Raises
    ------
    InputError : a motor, rail, frequency or gain outside the model's range.
    """

    circuit: Circuit
    rail_V: float
    switching_Hz: float
    gain_V_A: float | None = None
    R_eddy_ohm: float | None = None

    def __post_init__(self) -> None:
        L_H, fastest_Hz = self.circuit.L_H, FASTEST_CROSSOVER * self.switching_Hz
        switched = f"amplifier.switching_Hz = {self.switching_Hz:g} Hz"
        if not LEAST_L_H <= L_H <= MOST_L_H:
            raise InputError(
                f"amplifier.switching_Hz: the motor's L_H = {L_H:g} H: the model of the bridge holds from "
                f"{LEAST_L_H:g} to {MOST_L_H:g} H: {_advice('take another motor')}"
            )
        if self.R_eddy_ohm is not None and not self.R_eddy_ohm >= LEAST_EDDY * self.circuit.R_ohm:
            raise InputError(
                f"motor.R_eddy_ohm = {self.R_eddy_ohm:g} ohm: the model of the bridge holds from "
                f"{LEAST_EDDY * self.circuit.R_ohm:g} ohm on, {LEAST_EDDY:g} R_ohm: measure it again, or take it out"
            )
        if self.crossover_Hz > fastest_Hz * (1 + 1e-9):
            most_V_A = rounded_down(2 * np.pi * fastest_Hz * self.inductance_H)
            raise InputError(
                f"amplifier.gain_V_A = {self.loop_gain_V_A:g} V/A: a crossover of {self.crossover_Hz:.4g} Hz with "
                f"{L_H:g} H, at most {fastest_Hz:g} Hz, {FASTEST_CROSSOVER:g} of switching_Hz: "
                f"{_advice(f'lower it to {most_V_A:g} V/A')}"
            )
        if self.lapse > MOST_LAPSE:
            raise InputError(
                f"{switched}: half its period, {1e6 * self.period_s:.3g} us, is more than {MOST_LAPSE:g} of the "
                f"motor's L / R = {1e6 * self.period_s / self.lapse:.3g} us: "
                f"{_advice(_raised(self.switching_Hz * self.lapse / MOST_LAPSE))}"
            )
        ripple_A = float(self.peak_to_peak_A(0.5))
        if ripple_A > MOST_RIPPLE_A:
            # The ripple through the inductance is at most V / (8 L f_s), for any resistance.
            left_A = MOST_RIPPLE_A - self.rail_V * self.jump_A_V
            enough_Hz = self.rail_V / (8 * self.inductance_H * left_A) if left_A > 0 else np.inf
            lowered = f"lower limits.supply_V to {rounded_down(self.rail_V * MOST_RIPPLE_A / ripple_A):g} V"
            raise InputError(
                f"{switched}: a ripple of {ripple_A:.3g} A peak to peak on a rail of {self.rail_V:g} V, at most "
                f"{MOST_RIPPLE_A:g} A: {_advice(_raised(enough_Hz), lowered)}"
            )

    @property
    def period_s(self) -> float:
        """T, the time between two pulses, which is also the loop's sampling period."""
        return 1 / (2 * self.switching_Hz)

    @property
    def jump_A_V(self) -> float:
        """1 / (R + R_eddy), the jump of the current per volt of a voltage step [A/V]."""
        return 0.0 if self.R_eddy_ohm is None else 1 / (self.circuit.R_ohm + self.R_eddy_ohm)

    @property
    def inductance_H(self) -> float:
        """Effective inductance L (R + R_eddy) / R_eddy, which gives the winding's time constant."""
        return self.circuit.L_H / (1 - self.circuit.R_ohm * self.jump_A_V)

    @property
    def lapse(self) -> float:
        """x = T R / L."""
        return self.period_s * self.circuit.R_ohm / self.inductance_H

    @property
    def loop_gain_V_A(self) -> float:
        """Proportional gain, as stated or tuned."""
        tuned = 2 * np.pi * FASTEST_CROSSOVER * self.switching_Hz * self.inductance_H
        return float(tuned) if self.gain_V_A is None else self.gain_V_A

    @property
    def crossover_Hz(self) -> float:
        """Frequency at which the open loop has gain 1: gain / (2 pi L)."""
        return float(self.loop_gain_V_A / (2 * np.pi * self.inductance_H))

    def controller(self) -> tuple[float, float]:
        """The PI as v_k = v_(k-1) + p (e_k - a e_(k-1)): p [V/A] and a, the winding's decay over a sample.

        p = 2 pi f_c T R / (1 - a). The open loop of the sampled winding is then 2 pi f_c T / (z (z - 1)), one sample
        of delay included.
        """
        a = float(np.exp(-self.lapse))
        return 2 * np.pi * self.crossover_Hz * self.period_s * self.circuit.R_ohm / (1 - a), a

    def response(self, frequency_Hz: FloatArray | float) -> FloatArray:
        """(...) complex gain from commanded to mean current: sampled loop, hold of the pulse, winding."""
        R, jump = self.circuit.R_ohm, self.jump_A_V
        s, K = 2j * np.pi * np.asarray(frequency_Hz), 2 * np.pi * self.crossover_Hz * self.period_s
        z, (p, a) = np.exp(s * self.period_s), self.controller()
        voltage = p * (z - a) / (z * z - z + K) * (1 - 1 / z) / (s * self.period_s)
        return np.asarray(voltage * ((1 - R * jump) / (R + s * self.inductance_H) + jump))

    @property
    def pole_Hz(self) -> float:
        """Frequency of -3 dB: 1.05 times the crossover if that is f_s / 100, 2.14 times if it is f_s / 10."""
        return _pole_Hz(self)

    @property
    def delay_s(self) -> float:
        """The loop's lag at low frequencies, 1 / (2 pi f_c), minus that of a pole at `pole_Hz`."""
        return (1 / self.crossover_Hz - 1 / self.pole_Hz) / (2 * np.pi)

    def peak_to_peak_A(self, duty: FloatArray | float) -> FloatArray:
        """(...) peak-to-peak ripple of the current at a duty between 0 and 1.

        With x = T R / L the current through the inductance has the ripple
        V / R (1 - e^(-d x)) (1 - e^(-(1 - d) x)) / (1 - e^(-x)). The winding's is R_eddy / (R + R_eddy) of it plus
        the jump V / (R + R_eddy).
        """
        d, x, R = np.asarray(duty), self.lapse, self.circuit.R_ohm
        slow = np.expm1(-d * x) * np.expm1((d - 1) * x) / -np.expm1(-x) / R
        return np.asarray(self.rail_V * ((1 - R * self.jump_A_V) * slow + self.jump_A_V))

    def ripple_square_A2(self, voltage_V: FloatArray | float) -> FloatArray:
        """(...) variance of the current within a pulse period, at a mean motor voltage v.

        Over a period the mean voltage of the inductance is zero, so the duty is d = |v| / V with v the voltage of R
        and back-EMF. The current through the inductance then has the variance

            (V / R)^2 [ d (1 - d) - (1 - e^(-d x)) (1 - e^(-(1 - d) x)) / (x (1 - e^(-x))) ],

        which for small x is p^2 / 12, that of a triangle of peak-to-peak value p. The winding's is
        1 - R^2 / (R + R_eddy)^2 of it plus V^2 d (1 - d) / (R + R_eddy)^2 from the jumps.
        """
        d, x, R = np.minimum(np.abs(voltage_V) / self.rail_V, 1.0), self.lapse, self.circuit.R_ohm
        pulses = d * (1 - d)
        # For small x the exact formula is a difference of two nearly equal numbers, which cancels.
        triangle = (pulses * x) ** 2 / 12
        exact = pulses + np.expm1(-d * x) * np.expm1((d - 1) * x) / (x * np.expm1(-x))
        slow = (self.rail_V / R) ** 2 * (triangle if x < SHORT_LAPSE else exact)
        return np.asarray((1 - (R * self.jump_A_V) ** 2) * slow + (self.rail_V * self.jump_A_V) ** 2 * pulses)

    @property
    def heat_factor(self) -> float:
        """Heat of a current with its ripple over that without, in the limit of small duty, where it is largest.

        For the current through the inductance the variance over the square of the mean is (x / 2) coth(x / 2) - 1
        with x = T R / L, x^2 / 12 for small x; at a duty d it is about (1 - d)^2 of that.
        """
        half = self.lapse / 2
        return float(1 + (1 - (self.circuit.R_ohm * self.jump_A_V) ** 2) * (half / np.tanh(half) - 1))

    @property
    def ripple_A(self) -> float:
        """Constant r of seed Eq. 7, such that `heat_factor` (|i| + r)^2 bounds the mean square of the current.

        It covers what the jumps add at standstill, V R |i| / (R + R_eddy)^2; at a large duty they add less.
        """
        return self.rail_V * self.circuit.R_ohm * self.jump_A_V**2 / (2 * self.heat_factor)


def _raised(least_Hz: float) -> str:
    """Advice to switch at this frequency or faster; empty where that is beyond the model's range."""
    rounded_up = 100 * np.ceil(least_Hz / 100)
    return f"raise it to {rounded_up:g} Hz" if rounded_up <= FASTEST_SWITCHING_HZ else ""


def _advice(*steps: str) -> str:
    """The steps that are not empty, and the one that is always possible: a measured amplifier."""
    known = ", ".join(filter(None, steps))
    measured = "state pole_Hz and delay_s as measured in place of switching_Hz and gain_V_A"
    return f"{known}, or {measured}" if known else measured


@lru_cache(maxsize=64)
def _pole_Hz(bridge: Bridge) -> float:
    def above(frequency_Hz: float) -> float:
        return float(np.abs(bridge.response(frequency_Hz)) ** 2) - 0.5

    # The hold's response is zero at twice the switching frequency, so -3 dB lies below.
    return float(scipy.optimize.brentq(above, 0.5 * bridge.crossover_Hz, 1.99 * bridge.switching_Hz))
