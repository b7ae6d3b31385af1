"""The current of a motor on a PWM bridge, pulse by pulse in the mean: what stands behind an amplifier's pole.

Between two samples of its PI loop the bridge puts a mean voltage on the motor, whose current follows exactly; it
jumps with the voltage where the motor has eddy currents. The ripple about this mean only heats (`plant.bridge`).
"""

import math

import numpy as np

from transopt.plant.bridge import Bridge

DUTIES = np.linspace(0.0, 1.0, 2001)  # at which the ripple's heat is tabulated
PHASE = 0.3  # of a sample, at which the clocks of loop and servo start apart: they shall never tick together


class CurrentLoop:
    """PI loop, bridge and winding of one motor; time passes in `advance` alone.

    Between the pulses, where the loop samples, the jump of a current is over; the reading is scaled so that it is
    right for a steady current.

    Parameters
    ----------
    bridge : with the motor's nominal values, to which the loop is tuned.
    faster : the loop's gain over that of the bridge.

    Attributes
    ----------
    bridge : as given.
    voltage_V : on the motor now, in the mean over a pulse's period.
    """

    def __init__(self, bridge: Bridge, faster: float) -> None:
        gain, self._decay = bridge.controller()
        self._gain, self.bridge = gain * faster, bridge
        self._ripple_A2 = bridge.ripple_square_A2(bridge.rail_V * DUTIES).tolist()
        self._slow_A = self._error_A = 0.0
        self._left_s: float | None = None
        self.voltage_V = self._next_V = 0.0

    def advance(self, duration_s: float, command_A: float, emf_V: float, R_ohm: float) -> tuple[float, float]:
        """Mean of the current [A] and of its square, ripple included [A^2], over a time of one command.

        Parameters
        ----------
        emf_V : k_e w, against which a voltage of the same sign drives. R_ohm : of the copper as warm as it is.
        """
        if self._left_s is None:
            # The motor has turned before time began.
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
        """One step of the PI; what it finds acts from the next sample on, within the rail."""
        self.voltage_V, jump = self._next_V, self.bridge.jump_A_V
        error_A = command_A - self._slow_A + emf_V * jump / (1 - self.bridge.circuit.R_ohm * jump)
        wanted_V = self.voltage_V + self._gain * (error_A - self._decay * self._error_A)
        self._next_V = float(np.clip(wanted_V, -self.bridge.rail_V, self.bridge.rail_V))
        self._error_A = error_A
