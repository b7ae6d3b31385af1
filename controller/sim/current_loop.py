"""The mean current of a motor on a PWM bridge with a PI loop: the physical model behind an amplifier's pole.

Between two samples of its PI loop the bridge applies a constant mean voltage; the motor's current follows exactly,
and jumps with the voltage if the motor has eddy currents. The ripple about the mean only heats (`plant.bridge`).
"""

import math

import numpy as np

from transopt.plant.bridge import Bridge

DUTIES = np.linspace(0.0, 1.0, 2001)  # duty cycles at which the ripple's heat is tabulated
PHASE = 0.3  # initial offset of the loop's clock from the servo's, in samples, so that the two never tick together


class CurrentLoop:
    """PI loop, bridge and winding of one motor; time advances in `advance` only.

    The loop samples between the pulses, when the jump of the current has decayed; the reading is scaled to be right
    for a steady current.

    Parameters
    ----------
    bridge : with the motor's nominal values, to which the loop is tuned.
    faster : factor on the loop's gain.

    Attributes
    ----------
    bridge : as given.
    voltage_V : present voltage on the motor, mean over a pulse's period.
    """

    def __init__(self, bridge: Bridge, faster: float) -> None:
        gain, self._decay = bridge.controller()
        self._gain, self.bridge = gain * faster, bridge
        self._ripple_A2 = bridge.ripple_square_A2(bridge.rail_V * DUTIES).tolist()
        self._slow_A = self._error_A = 0.0
        self._left_s: float | None = None
        self.voltage_V = self._next_V = 0.0

    def advance(self, duration_s: float, command_A: float, emf_V: float, R_ohm: float) -> tuple[float, float]:
        """Mean current [A] and mean square current with ripple [A^2] over a time of constant command.

        Parameters
        ----------
        emf_V : back-EMF k_e w, opposed to a voltage of the same sign. R_ohm : winding resistance at its temperature.
        """
        if self._left_s is None:
            # The first call starts in equilibrium with the motor's back-EMF.
            self.voltage_V, self._next_V, self._left_s = emf_V, emf_V, PHASE * self.bridge.period_s
        jump, tau_s = self.bridge.jump_A_V, self.bridge.inductance_H / R_ohm
        left_s, total_A_s, total_A2_s = duration_s, 0.0, 0.0
        while left_s > 0:
            if self._left_s <= 0:
                self._sample(command_A, emf_V)
                self._left_s = self.bridge.period_s
            h = min(left_s, self._left_s)
            drive_V = self.voltage_V - emf_V
            end_A = drive_V / R_ohm
            away_A, lost = self._slow_A - end_A, -math.expm1(-h / tau_s)
            # i = s + (v - e - R s) / (R + R_eddy), s the current through the inductance.
            smooth, jumped_A = 1 - R_ohm * jump, drive_V * jump
            steady_A, falling_A = smooth * end_A + jumped_A, smooth * away_A
            total_A_s += steady_A * h + falling_A * tau_s * lost
            total_A2_s += steady_A**2 * h + falling_A * tau_s * lost * (2 * steady_A + falling_A * (2 - lost) / 2)
            duty = min(abs(self.voltage_V) / self.bridge.rail_V, 1.0)
            total_A2_s += self._ripple_A2[round(duty * (DUTIES.size - 1))] * h
            self._slow_A = end_A + away_A * (1 - lost)
            self._left_s -= h
            left_s -= h
        return total_A_s / duration_s, total_A2_s / duration_s

    def _sample(self, command_A: float, emf_V: float) -> None:
        """One step of the PI loop; its voltage, limited to the rail, acts from the next sample on."""
        self.voltage_V, jump = self._next_V, self.bridge.jump_A_V
        error_A = command_A - self._slow_A + emf_V * jump / (1 - self.bridge.circuit.R_ohm * jump)
        wanted_V = self.voltage_V + self._gain * (error_A - self._decay * self._error_A)
        self._next_V = float(np.clip(wanted_V, -self.bridge.rail_V, self.bridge.rail_V))
        self._error_A = error_A
