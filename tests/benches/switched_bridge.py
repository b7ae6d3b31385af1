"""A motor on a PWM bridge that is switched edge by edge, by equations of its own."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.bridge import Bridge


@dataclass(frozen=True)
class Switched:
    """Current of a bridge that was switched, piece by piece between two edges.

    In each piece of length h from t on the current is `steady` + `falling` exp(-s / tau), (K,) each.
    """

    t: FloatArray
    h: FloatArray
    steady: FloatArray
    falling: FloatArray
    tau: float

    def since(self, start_s: float) -> "Switched":
        kept = self.t >= start_s
        return Switched(self.t[kept], self.h[kept], self.steady[kept], self.falling[kept], self.tau)

    def mean(self) -> float:
        lost = -np.expm1(-self.h / self.tau)
        return float((self.steady * self.h + self.falling * self.tau * lost).sum() / self.h.sum())

    def mean_square(self) -> float:
        once, twice = -np.expm1(-self.h / self.tau), -np.expm1(-2 * self.h / self.tau)
        square = self.steady**2 * self.h + self.tau * self.falling * (
            2 * self.steady * once + self.falling * twice / 2
        )
        return float(square.sum() / self.h.sum())

    def amplitude(self, frequency_Hz: float) -> float:
        """Size of the sine of this frequency in it, over whole periods."""
        w, b = 2j * np.pi * frequency_Hz, 2j * np.pi * frequency_Hz + 1 / self.tau
        pieces = self.steady * -np.expm1(-w * self.h) / w + self.falling * -np.expm1(-b * self.h) / b
        return float(2 * abs((np.exp(-w * self.t) * pieces).sum()) / self.h.sum())


def switch(
    bridge: Bridge,
    command: Callable[[float], float],
    duration_s: float,
    emf: Callable[[float], float] = lambda _: 0.0,
) -> Switched:
    """Simulate R, L, back-EMF and eddy currents on an H-bridge whose legs compare a triangular carrier.

    Twice a carrier period, where the triangle turns, the loop samples the current and fixes the voltage of the half
    period after the next. Leg A is high where the carrier is below the voltage, leg B where it is below its negative.
    """
    R, L, V, T = bridge.circuit.R_ohm, bridge.circuit.L_H, bridge.rail_V, 1 / (2 * bridge.switching_Hz)
    jump = 0.0 if bridge.R_eddy_ohm is None else 1 / (R + bridge.R_eddy_ohm)
    smooth = 1 - R * jump
    tau, a = L / (R * smooth), float(np.exp(-R * smooth * T / L))
    # Proportional gain g and a zero on R / L, as the sampled controller has them.
    gain = bridge.loop_gain_V_A * smooth * T * R / (L * (1 - a))
    slow, coming, error, pieces = 0.0, 0.0, 0.0, []
    for k in range(round(duration_s / T)):
        t, now, back = k * T, coming, emf(k * T)
        last, error = error, command(t) - (slow - jump * back / smooth)
        coming = min(max(coming + gain * (error - a * last), -V), V)
        above = abs(now) / V
        for share, volt in (((1 - above) / 2, 0.0), (above, np.copysign(V, now)), ((1 - above) / 2, 0.0)):
            h, end = share * T, (volt - back) / R
            pieces.append((t, h, smooth * end + jump * (volt - back), smooth * (slow - end)))
            slow = end + (slow - end) * float(np.exp(-h / tau))
            t += h
    return Switched(*np.array(pieces).T, tau)
