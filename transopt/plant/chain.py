"""Chains of masses, springs and dampers from motor current to stylus acceleration.

Every model of a device whose masses are known is such a chain (`transopt.plant.second_order`, `fourth_order`,
`drive`). All masses are positive, all stiffnesses and dampings at least zero, so that a chain is passive.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.state_space import POSITION, VELOCITY, Output, StateSpace


@dataclass(frozen=True)
class Link:
    """Spring and damper between two neighbours of a chain, or between the last mass and the ground."""

    stiffness_N_m: float
    damping_N_s_m: float


def chain(
    masses_kg: Sequence[float],
    links: Sequence[Link],
    *,
    force_per_current_N_A: float,
    driven: int = 0,
    stylus: int,
    names: Sequence[str] = (),
    further: Mapping[str, Output] = MappingProxyType({}),
) -> StateSpace:
    """Assemble a chain of masses; link j joins mass j and mass j + 1, link n joins mass n and the ground.

    The ground is the motion that the hand intends; all displacements are relative to it. States: the n elongations
    e_j = z_j - z_(j+1) (e_n = z_n), then their n rates de_j/dt. The position and the velocity of a mass are sums of
    them. Positions and velocities as states would lose the digits of a stiff link: its force is a large number times
    the small difference of two nearly equal motions. With n - 1 links the chain is free, and the last elongation is
    the position of the last mass, on which nothing depends.

    Parameters
    ----------
    masses_kg : n masses, > 0.
    links : n or n - 1 links, stiffness and damping >= 0.
    force_per_current_N_A : force on the driven mass per ampere.
    driven : index of the mass that the motor's force acts on.
    stylus : index of the mass whose acceleration is the output.
    names : names of the masses. The model has the outputs "NAME position" and "NAME velocity" for each named mass,
        and "position" and "velocity" of the first mass, which the encoder reads.
    further : outputs besides these.

    Raises
    ------
    InputError : a parameter that would make the chain non-passive.
    """
    n = len(masses_kg)
    for j, mass in enumerate(masses_kg):
        if not 0 < mass < np.inf:
            raise InputError(f"model: mass {j + 1} of the chain = {mass:g} kg: must be > 0 and finite")
    for j, link in enumerate(links):
        for field in ("stiffness_N_m", "damping_N_s_m"):
            value = getattr(link, field)
            if not 0 <= value < np.inf:
                raise InputError(
                    f"model: {field} of link {j + 1} of the chain = {value:g}: must be >= 0 and finite (passive)"
                )
    inverse_mass = 1.0 / np.asarray(masses_kg, dtype=float)
    difference = _difference(n)
    joined = difference[: len(links)]
    stiffness = np.array([link.stiffness_N_m for link in links])
    damping = np.array([link.damping_N_s_m for link in links])

    # Accelerations of the masses, by the states and by the current.
    by_state, by_current = np.zeros((n, 2 * n)), np.zeros((n, 1))
    by_state[:, : len(links)] = -inverse_mass[:, None] * joined.T * stiffness
    by_state[:, n : n + len(links)] = -inverse_mass[:, None] * joined.T * damping
    by_current[driven] = force_per_current_N_A * inverse_mass[driven]
    A = np.concatenate([np.eye(n, 2 * n, n), difference @ by_state])
    B = np.concatenate([np.zeros((n, 1)), difference @ by_current])
    row = slice(stylus, stylus + 1)
    return StateSpace(A, B, by_state[row], by_current[row], {**_outputs(n, tuple(names)), **further})


@lru_cache(maxsize=16)
def _difference(n: int) -> FloatArray:
    """(n, n) whose row j gives the elongation of link j from the positions."""
    found = np.eye(n) - np.eye(n, k=1)
    found.flags.writeable = False  # all chains of n masses share it
    return found


@lru_cache(maxsize=16)
def _outputs(n: int, names: tuple[str, ...]) -> Mapping[str, Output]:
    """Positions and velocities of n masses by the names of the first ones, which all chains of them share."""
    outputs: dict[str, Output] = {}
    for mass, name in ((0, ""), *enumerate(names)):
        position, velocity = np.zeros((1, 2 * n)), np.zeros((1, 2 * n))
        position[0, mass:n] = velocity[0, n + mass :] = 1.0
        position.flags.writeable = velocity.flags.writeable = False
        outputs[f"{name} {POSITION}".strip()] = Output(position, "m", POSITION)
        outputs[f"{name} {VELOCITY}".strip()] = Output(velocity, "m/s", VELOCITY)
    return MappingProxyType(outputs)
