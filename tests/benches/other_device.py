"""A held haptic drive of other make: equations and integration of its own, and what goes wrong on real ones.

Verdicts of `transopt identify` are held against it. Its equations are in other_device.c and it imports nothing of
transopt, so that a mistake in transopt's plants, sampling or fits cannot hide by being on both sides. It is compiled
with the system's C compiler at first use; where there is none, `simulate` raises `NoCompilerError`.
"""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

TICK_S = 1e-4  # servo period: a command is held for it
STEPS = 25  # of integration per tick: 4 us, of which the amplifier's delay is a whole number
STEP_S = TICK_S / STEPS
LATE_STEPS = 17  # 68 us
AMPLIFIER_HZ, ACCELEROMETER_HZ = 1050.0, 2500.0
SPREAD = 0.2  # of a true device's parameters about the default device's


class NoCompilerError(RuntimeError):
    """The machine has no C compiler."""


@dataclass(frozen=True)
class Device:
    """Numbers of one device at one grip, in the order and the units of `device` in other_device.c."""

    force_per_current: float = 1.24956  # 23.4 mN m/A at 53.4 1/m, as the scene states it
    motor_mass: float = 0.014
    stylus_mass: float = 0.026
    hand_mass: float = 0.010
    transmission_stiffness: float = 6e4
    transmission_damping: float = 8.0
    skin_stiffness: float = 9000.0
    skin_damping: float = 15.0
    arm_stiffness: float = 490.0
    arm_damping: float = 15.0
    amplifier_rate: float = 2 * np.pi * AMPLIFIER_HZ
    sensor_rate: float = 2 * np.pi * ACCELEROMETER_HZ
    mode_mass: float = 0.0
    mode_stiffness: float = 0.0
    mode_damping: float = 0.0
    friction: float = 0.0
    friction_speed: float = 5e-4
    half_gap: float = 0.0
    skin_cubic: float = 0.0
    soft_limit: float = 0.0
    drift: float = 0.0


HAND = ("hand_mass", "skin_stiffness", "skin_damping", "arm_stiffness", "arm_damping")


class _Numbers(ctypes.Structure):
    _fields_ = [(field.name, ctypes.c_double) for field in fields(Device)]


@cache
def _compiled() -> Callable[..., None]:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise NoCompilerError("no C compiler (cc, gcc, clang) on this machine")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "other_device.so"
        source = Path(__file__).with_suffix(".c")
        words = [compiler, "-std=c99", "-O2", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
        subprocess.run(words, check=True)
        function: Callable[..., None] = ctypes.CDLL(str(library)).simulate  # stays loaded without its file
    return function


@dataclass(frozen=True)
class Motion:
    """What one run did, every `stride` integration steps from the first command on.

    Attributes
    ----------
    dt_s : between the rows.
    current_A : (K,) in the coil.
    sensed_m_s2 : (K,) acceleration of the stylus behind the accelerometer's pole.
    position_m : (K,) of the motor at the tip.
    acceleration_m_s2 : (K,) of the stylus.
    """

    dt_s: float
    current_A: FloatArray
    sensed_m_s2: FloatArray
    position_m: FloatArray
    acceleration_m_s2: FloatArray


def simulate(
    device: Device,
    command_A: FloatArray,
    *,
    push_N: FloatArray | None = None,
    stride: int = STEPS,
    finer: int = 1,
) -> Motion:
    """Run a device from rest, held still.

    Parameters
    ----------
    command_A : (N,) issued at k `TICK_S` and held.
    push_N : (N,) force on the hand at the ticks, straight lines between them.
    stride : steps of `STEP_S` from row to row; a divisor of `STEPS`.
    finer : into how many parts each step is divided for the integration.

    Raises
    ------
    NoCompilerError : see the module.
    """
    command = np.ascontiguousarray(command_A, dtype=float)
    push = None if push_N is None else np.ascontiguousarray(push_N, dtype=float)
    out = np.empty((command.size * STEPS // stride, 4))
    doubles, size = ctypes.POINTER(ctypes.c_double), ctypes.c_size_t
    _compiled()(
        ctypes.byref(_Numbers(*(getattr(device, field.name) for field in fields(Device)))),
        command.ctypes.data_as(doubles),
        None if push is None else push.ctypes.data_as(doubles),
        *(size(number) for number in (command.size, finer * STEPS, finer * LATE_STEPS)),
        ctypes.c_double(STEP_S / finer),
        size(finer * stride),
        out.ctypes.data_as(doubles),
    )
    return Motion(stride * STEP_S, *out.T.copy())


@dataclass(frozen=True)
class Truth:
    """A device at every grip.

    Attributes
    ----------
    shared : at a grip of none: masses, transmission and what the effect adds; the hand's numbers are not read.
    hand : (5, 2) constant and part per newton of `HAND`.
    square_root : skin and arm go with the square root of the grip and are equal to the straight lines at 3 N.
    cubic_length_m : deflection at which a stiffening skin is twice as stiff as at rest (its force, over deflection).
    """

    shared: Device
    hand: FloatArray
    square_root: bool = False
    cubic_length_m: float = 0.0

    def at(self, grip_N: float) -> Device:
        if self.square_root:
            numbers = self.hand @ [1.0, 3.0]
            numbers[1:] *= np.sqrt(grip_N / 3.0)
        else:
            numbers = self.hand @ [1.0, grip_N]
        values = dict(zip(HAND, numbers.tolist(), strict=True))
        cubic = values["skin_stiffness"] / self.cubic_length_m**2 if self.cubic_length_m else 0.0
        return replace(self.shared, **values, skin_cubic=cubic)


DEFAULT_HAND = np.array([[0.010, 0.0], [3000.0, 2000.0], [6.0, 3.0], [160.0, 110.0], [6.0, 3.0]])


def true_device(seed: int, spread: float = SPREAD) -> Truth:
    """The default device with every parameter off by up to `spread`, its force per ampere alone being known."""
    random = np.random.default_rng([seed, 20])

    def off(value: float) -> float:
        return value * (1 + spread * random.uniform(-1, 1))

    plain = Device()
    shared = replace(
        plain,
        motor_mass=off(plain.motor_mass),
        stylus_mass=off(plain.stylus_mass),
        transmission_stiffness=off(plain.transmission_stiffness),
        transmission_damping=off(plain.transmission_damping),
    )
    return Truth(shared, DEFAULT_HAND * (1 + spread * random.uniform(-1, 1, (5, 1))))
