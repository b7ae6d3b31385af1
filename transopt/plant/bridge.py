"""Amplifier as what it is made of: an H-bridge with unipolar PWM under a PI current loop (seed Secs. 4.1, 4.2).

Pole, delay and ripple of the current follow from the motor's resistance and inductance, the rail, the switching
frequency and the loop's gain. Both legs compare one triangular carrier, the one with the voltage, the other with its
negative, so the motor sees a pulse of the rail twice a carrier period: pulses every T = 1 / (2 f_s).

- Loop: a PI that cancels the winding's pole, sampled between the pulses, its output one sample late. With the hold
  that is a delay of 0.75 / f_s (Holmes, Lipo, McGrath, Kong 2009, Optimized design of stationary frame three phase AC
  current regulators, IEEE Trans. Power Electronics 24(11)). Its crossover is gain / (2 pi L).
- Ripple: the periodic current of R and L under pulses of duty d; for R T << L its peak to peak value is
  V d (1 - d) / (2 L f_s) (Mohan, Undeland, Robbins 2003, Power Electronics, Sec. 7-7).
- Eddy currents act as a resistance across the inductance: the current jumps by step / (R + R_eddy) with a voltage
  step. The jump's heat grows with |i|, as in seed Eq. 7, that of the rest of the ripple with i^2.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.writing import rounded_down
from transopt.plant.circuit import Circuit

SLOWEST_SWITCHING_HZ, FASTEST_SWITCHING_HZ = 10e3, 100e3  # what the model was tried on, as all bounds here
LEAST_L_H, MOST_L_H = 0.05e-3, 2e-3
FASTEST_CROSSOVER = 0.1  # of the switching frequency; faster loops ring with their delay
MOST_RIPPLE_A = 1.0  # peak to peak, at the worst duty
MOST_LAPSE = 0.75  # T R / L; a loop that samples between longer pulses reads over 2.4 % less than the mean current
SHORT_LAPSE = 1e-3  # below it the ripple is a triangle, to 1e-7
LEAST_EDDY = 4.0  # of the winding's resistance, below which the jump is no small part of a current


@dataclass(frozen=True)
class Bridge:
    """Motor on an H-bridge with unipolar PWM and a sampled PI current loop.

    Attributes
    ----------
    circuit : the motor's terminals, R at 25 C.
    rail_V : supply that the bridge switches.
    switching_Hz : frequency of the carrier, at which each transistor switches.
    gain_V_A : proportional gain of the loop; None tunes it to the fastest crossover, a tenth of the switching
        frequency. The integral part follows from the winding: its zero lies on R / L.
    R_eddy_ohm : across the inductance; None without eddy currents.

    Raises
    ------
    InputError : a motor, rail, frequency or gain for which the model was not tried.
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
                f"{LEAST_EDDY * self.circuit.R_ohm:g} ohm on, {LEAST_EDDY:g} R_ohm: measure it anew, or take it out"
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
            # The inductance's ripple is at most V / (8 L f_s), whatever the resistance.
            left_A = MOST_RIPPLE_A - self.rail_V * self.jump_A_V
            enough_Hz = self.rail_V / (8 * self.inductance_H * left_A) if left_A > 0 else np.inf
            lowered = f"lower limits.supply_V to {rounded_down(self.rail_V * MOST_RIPPLE_A / ripple_A):g} V"
            raise InputError(
                f"{switched}: a ripple of {ripple_A:.3g} A peak to peak on a rail of {self.rail_V:g} V, at most "
                f"{MOST_RIPPLE_A:g} A: {_advice(_raised(enough_Hz), lowered)}"
            )

    @property
    def period_s(self) -> float:
        """T, from pulse to pulse and from sample to sample of the loop."""
        return 1 / (2 * self.switching_Hz)

    @property
    def jump_A_V(self) -> float:
        """1 / (R + R_eddy): how far the current jumps at a voltage step [A/V]."""
        return 0.0 if self.R_eddy_ohm is None else 1 / (self.circuit.R_ohm + self.R_eddy_ohm)

    @property
    def inductance_H(self) -> float:
        """L as the winding's time constant shows it: L (R + R_eddy) / R_eddy."""
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

        p = 2 pi f_c T R / (1 - a). The open loop of the sampled winding is then 2 pi f_c T / (z (z - 1)), with the
        sample that the output comes late.
        """
        a = float(np.exp(-self.lapse))
        return 2 * np.pi * self.crossover_Hz * self.period_s * self.circuit.R_ohm / (1 - a), a

    def response(self, frequency_Hz: FloatArray | float) -> FloatArray:
        """Complex gain from a commanded to the mean current, (...) each: sampled loop, hold of the pulse, winding."""
        R, jump = self.circuit.R_ohm, self.jump_A_V
        s, K = 2j * np.pi * np.asarray(frequency_Hz), 2 * np.pi * self.crossover_Hz * self.period_s
        z, (p, a) = np.exp(s * self.period_s), self.controller()
        voltage = p * (z - a) / (z * z - z + K) * (1 - 1 / z) / (s * self.period_s)
        return np.asarray(voltage * ((1 - R * jump) / (R + s * self.inductance_H) + jump))

    @property
    def pole_Hz(self) -> float:
        """Frequency at which the loop has lost 3 dB: 1.05 of the crossover at f_s / 100, 2.14 at f_s / 10."""
        return _pole_Hz(self)

    @property
    def delay_s(self) -> float:
        """What a pole of `pole_Hz` lacks of the loop's lag at low frequencies, 1 / (2 pi f_c)."""
        return (1 / self.crossover_Hz - 1 / self.pole_Hz) / (2 * np.pi)

    def peak_to_peak_A(self, duty: FloatArray | float) -> FloatArray:
        """(...) ripple of the current at a duty between 0 and 1.

        V / R (1 - e^(-d x)) (1 - e^(-(1 - d) x)) / (1 - e^(-x)) of the current through the inductance, x = T R / L;
        R_eddy / (R + R_eddy) of it, and the jump V / (R + R_eddy).
        """
        d, x, R = np.asarray(duty), self.lapse, self.circuit.R_ohm
        slow = np.expm1(-d * x) * np.expm1((d - 1) * x) / -np.expm1(-x) / R
        return np.asarray(self.rail_V * ((1 - R * self.jump_A_V) * slow + self.jump_A_V))

    def ripple_square_A2(self, voltage_V: FloatArray | float) -> FloatArray:
        """(...) mean square of the current about its mean, while the motor takes a mean voltage.

        Over a period the inductance gives back what it took, so the pulses bring what R and back-EMF take. With
        d = |v| / V the current through the inductance has the variance

            (V / R)^2 [ d (1 - d) - (1 - e^(-d x)) (1 - e^(-(1 - d) x)) / (x (1 - e^(-x))) ],

        p^2 / 12 of a triangle of peak to peak value p for small x. The winding's has 1 - R^2 / (R + R_eddy)^2 of it,
        and V^2 d (1 - d) / (R + R_eddy)^2 of the jumps.
        """
        d, x, R = np.minimum(np.abs(voltage_V) / self.rail_V, 1.0), self.lapse, self.circuit.R_ohm
        pulses = d * (1 - d)
        # The difference of two nearly equal numbers has no digits left for a small x.
        triangle = (pulses * x) ** 2 / 12
        exact = pulses + np.expm1(-d * x) * np.expm1((d - 1) * x) / (x * np.expm1(-x))
        slow = (self.rail_V / R) ** 2 * (triangle if x < SHORT_LAPSE else exact)
        return np.asarray((1 - (R * self.jump_A_V) ** 2) * slow + (self.rail_V * self.jump_A_V) ** 2 * pulses)

    @property
    def heat_factor(self) -> float:
        """Heat of a current with its ripple over that without, at a small duty, where it is most.

        The variance over the square of the mean current, (x / 2) coth(x / 2) - 1 of the inductance's, x = T R / L,
        which is x^2 / 12 for small x; at a duty d some (1 - d)^2 of it.
        """
        half = self.lapse / 2
        return float(1 + (1 - (self.circuit.R_ohm * self.jump_A_V) ** 2) * (half / np.tanh(half) - 1))

    @property
    def ripple_A(self) -> float:
        """Constant r of seed Eq. 7, for which `heat_factor` (|i| + r)^2 is the mean square of the current or more.

        It is what the jumps add at standstill, V R |i| / (R + R_eddy)^2 and less at a large duty.
        """
        return self.rail_V * self.circuit.R_ohm * self.jump_A_V**2 / (2 * self.heat_factor)


def _raised(least_Hz: float) -> str:
    """Advice to switch at least so fast, empty where that is beyond the model."""
    rounded_up = 100 * np.ceil(least_Hz / 100)
    return f"raise it to {rounded_up:g} Hz" if rounded_up <= FASTEST_SWITCHING_HZ else ""


def _advice(*steps: str) -> str:
    """Each step that there is, or what always is one: the amplifier as it was measured."""
    known = ", ".join(filter(None, steps))
    measured = "state pole_Hz and delay_s as measured in place of switching_Hz and gain_V_A"
    return f"{known}, or {measured}" if known else measured


@lru_cache(maxsize=64)
def _pole_Hz(bridge: Bridge) -> float:
    def above(frequency_Hz: float) -> float:
        return float(np.abs(bridge.response(frequency_Hz)) ** 2) - 0.5

    # At twice the switching frequency nothing is left of a pulse.
    return float(scipy.optimize.brentq(above, 0.5 * bridge.crossover_Hz, 1.99 * bridge.switching_Hz))
