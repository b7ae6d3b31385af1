"""What a command takes of the supply, by equations of motion written anew: nothing of `transopt` integrates here.

The default device: motor mass, transmission, stylus, skin, hand mass, arm, and an amplifier of one pole. A classical
Runge-Kutta method of fourth order goes through each servo period in equal steps, many taps side by side.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.references.reference import Reference
from transopt.scene.scene import Scene

STEPS = 40  # of a servo period
COPPER_PER_K = 0.0039


@dataclass(frozen=True)
class Tap:
    """One command on one device.

    Attributes
    ----------
    command : (N,).
    """

    command: FloatArray
    grip_N: float
    pole_Hz: float
    reference: Reference


def terminal_voltages(scene: Scene, taps: Sequence[Tap], copper_C: Sequence[float]) -> FloatArray:
    """(taps, temperatures) largest |R i + L di/dt + k_e w| over all t while a command is held, by copper temperature.

    At a switching instant the voltage jumps with di/dt; both sides of the jump count.
    """
    motor, transmission, hand, dt = scene.motor, scene.transmission, scene.model.hand, scene.time.dt_s
    emf = motor.kt_Nm_A * transmission.ratio_1_m
    grip = np.array([tap.grip_N for tap in taps])

    def of_grip(key: str) -> FloatArray:
        law = getattr(hand, key)
        return np.asarray(law.constant + law.per_newton * grip)

    m = np.array([motor.rotor_kg_m2 * transmission.ratio_1_m**2 + transmission.link_mass_kg])
    stylus, palm = scene.model.stylus_mass_kg, hand.mass_kg
    k_t, b_t = transmission.stiffness_N_m, transmission.damping_N_s_m
    k_s, b_s, k_a, b_a = (
        of_grip(key) for key in ("skin_stiffness_N_m", "skin_damping_N_s_m", "arm_stiffness_N_m", "arm_damping_N_s_m")
    )
    w = 2 * np.pi * np.array([tap.pole_Hz for tap in taps])
    R = motor.R_ohm * (1 + COPPER_PER_K * (np.asarray(copper_C) - 25.0))[:, None]
    commands = np.array([tap.command for tap in taps])
    nominal = np.array([_nominal_velocity(scene, tap.reference) for tap in taps])

    def rate(x: FloatArray, c: FloatArray) -> FloatArray:
        """d/dt of (position, velocity) of motor mass, stylus and hand, and of the current; (7, taps)."""
        y0, v0, y1, v1, y2, v2, i = x
        through, skin = k_t * (y0 - y1) + b_t * (v0 - v1), k_s * (y1 - y2) + b_s * (v1 - v2)
        arm = k_a * y2 + b_a * v2
        return np.stack(
            [v0, (emf * i - through) / m, v1, (through - skin) / stylus, v2, (skin - arm) / palm, w * (c - i)]
        )

    def voltage(x: FloatArray, c: FloatArray, nominal_m_s: FloatArray) -> FloatArray:
        """(temperatures, taps)."""
        i = x[6]
        return np.abs(R * i + motor.L_H * w * (c - i) + emf * (x[1] + nominal_m_s))

    h, x, highest = dt / STEPS, np.zeros((7, len(taps))), np.zeros((len(copper_C), len(taps)))
    periods = commands.shape[1]
    for k in range(periods):
        c, start, end = commands[:, k], nominal[:, k], nominal[:, min(k + 1, periods - 1)]
        highest = np.maximum(highest, voltage(x, c, start))
        for j in range(STEPS):
            a = rate(x, c)
            b = rate(x + h / 2 * a, c)
            d = rate(x + h / 2 * b, c)
            x = x + h / 6 * (a + 2 * b + 2 * d + rate(x + h * d, c))
            highest = np.maximum(highest, voltage(x, c, start + (j + 1) / STEPS * (end - start)))
    return highest.T


def _nominal_velocity(scene: Scene, reference: Reference) -> FloatArray:
    """(N,) velocity of the hand's own motion: -v at contact, then the integral of a_free."""
    amplifier = scene.amplifier
    own, dt = reference.free_m_s2, scene.time.dt_s
    times = -scene.lead_s + amplifier.delay_s + dt * np.arange(own.size)
    course = np.append(0.0, np.cumsum(0.5 * dt * (own[1:] + own[:-1])))
    return np.asarray(course - np.interp(0.0, times, course) - reference.speed_m_s)
