"""Transients of earlier rendering methods, which did not invert recordings; all are proportional to the speed.

Each starts at the contact itself, since none of them extrapolates the approach. It is commanded directly, without an
inverse of the amplifier, and clipped at the library's current limit. Parameters that used to be tuned by feel are
fitted to the library's reference accelerations, which favours these methods.
"""

import numpy as np
import scipy

from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.plant.state_space import StateSpace

INERTIA_HZ = 100.0  # above the hand's resonance and below the transmission's, where the device acts as one mass


def inertia(library: Library) -> float:
    """m / k_f: current per acceleration of the moving mass [A s^2/m], the mean over the grips of 1 / |G(100 Hz)|."""
    plants = [
        StateSpace(library.plant_A[ig], library.plant_B[ig], library.plant_C[ig], library.plant_D[ig])
        for ig in range(library.grips_N.size)
    ]
    return float(np.mean([1 / np.abs(plant.response(np.array([INERTIA_HZ]))[0]) for plant in plants]))


def _amplitude(shape: FloatArray, library: Library) -> tuple[float, float]:
    """Least squares amplitude A of r_v = A v shape(t) for the targets r of all nodes, and the sum of squares left."""
    v, r = library.speeds_m_s, library.recorded_m_s2 - library.free_m_s2
    size = float((v @ v) * (shape @ shape)) * r.shape[1]
    amplitude = float(v @ (r @ shape).sum(axis=1)) / size if size > 0 else 0.0
    return amplitude, float(np.sum((r - amplitude * v[:, None, None] * shape) ** 2))


def _limited(command_A: FloatArray, library: Library) -> FloatArray:
    """Commands clipped at the current limit, which then bounds the current too, and zero over the hand-over."""
    limit = library.input_limit
    command = np.clip(command_A, -limit, limit)
    command[:, command.shape[1] - library.hand_over_samples :] = 0.0
    return command


def fitted_sinusoid(library: Library) -> tuple[float, float, float]:
    """Frequency [Hz], decay [1/s] and amplitude per speed [1/s] of A v exp(-B t) sin(2 pi f t), t >= 0."""
    t = library.time_grid().switching_times_s

    def shape(f_Hz: float, decay_1_s: float) -> FloatArray:
        late = np.maximum(t, 0.0)
        return np.asarray(np.exp(-decay_1_s * late) * np.sin(2 * np.pi * f_Hz * late))

    def left(logs: FloatArray) -> float:
        return _amplitude(shape(*np.exp(logs)), library)[1]

    starts = [np.log([f, b]) for f in np.geomspace(20, 500, 15) for b in np.geomspace(10, 3000, 10)]
    best = min(starts, key=left)
    f_Hz, decay = np.exp(scipy.optimize.minimize(left, best, method="Nelder-Mead", options={"xatol": 1e-6}).x)
    return float(f_Hz), float(decay), _amplitude(shape(f_Hz, decay), library)[0]


def decaying_sinusoid(library: Library, inertia_A_s2_m: float) -> FloatArray:
    """(nv, N) commands: the force A v exp(-B t) sin(2 pi f t) of Okamura et al., fitted to the references."""
    f_Hz, decay, amplitude = fitted_sinusoid(library)
    t = library.time_grid().issue_times_s
    t = np.where(np.abs(t) < 1e-9, 0.0, t)  # remove rounding at the tick of the contact
    late = np.maximum(t, 0.0)
    shape = np.exp(-decay * late) * np.sin(2 * np.pi * f_Hz * late)
    return _limited(inertia_A_s2_m * amplitude * library.speeds_m_s[:, None] * shape, library)


def _first_tick(library: Library) -> int:
    """First tick at or after the contact."""
    grid = library.time_grid()
    return int(np.ceil(grid.lead_s / grid.dt_s - 1e-6))


def fitted_pulse(library: Library) -> tuple[int, float]:
    """Width in servo periods and amplitude per speed [1/s] of the rectangle that fits the references best."""
    grid = library.time_grid()
    t = grid.switching_times_s
    shapes = [(t >= 0) & (t < width * grid.dt_s) for width in range(1, grid.stages // 2)]
    width = min(range(len(shapes)), key=lambda j: _amplitude(shapes[j].astype(float), library)[1])
    return width + 1, _amplitude(shapes[width].astype(float), library)[0]


def fixed_width_pulse(library: Library, inertia_A_s2_m: float) -> FloatArray:
    """(nv, N) commands: a rectangle of fixed width whose amplitude is proportional to the speed."""
    width, amplitude = fitted_pulse(library)
    first = _first_tick(library)
    command = np.zeros((library.speeds_m_s.size, library.command.shape[2]))
    command[:, first : first + width] = inertia_A_s2_m * amplitude * library.speeds_m_s[:, None]
    return _limited(command, library)


def momentum_cancellation(library: Library, inertia_A_s2_m: float) -> FloatArray:
    """(nv, N) commands: the shortest pulse within the current limit whose impulse is m v (Hwang et al. 2004)."""
    dt, limit = library.dt_s, library.input_limit
    first = _first_tick(library)
    command = np.zeros((library.speeds_m_s.size, library.command.shape[2]))
    for row, speed in zip(command, library.speeds_m_s, strict=True):
        # Ticks at the limit, and a last one with the rest of the impulse.
        row[first:] = np.clip(inertia_A_s2_m * speed / dt - limit * np.arange(row.size - first), 0.0, limit)
    return _limited(command, library)
