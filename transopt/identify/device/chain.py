"""The drive chain as numbers: nine parameters at a grip, four for the free device, and their derivatives.

The chain is that of `transopt.plant.drive`: motor mass, transmission, stylus, and the seed's Fig. 4b for the
hand.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from transopt.base.signals import FloatArray
from transopt.identify.device.response import Slope
from transopt.plant.chain import Link, chain
from transopt.plant.state_space import StateSpace

SHARED = ("moving_mass_kg", "stylus_mass_kg", "transmission_stiffness_N_m", "transmission_damping_N_s_m")
HAND = ("mass_kg", "skin_stiffness_N_m", "skin_damping_N_s_m", "arm_stiffness_N_m", "arm_damping_N_s_m")
STYLUS = 1  # which of the masses it is
UNITS = {"mass_kg": "kg", "stiffness_N_m": "N/m", "damping_N_s_m": "N s/m"}


def unit_of(name: str) -> str:
    """Unit of a parameter by its name; a slope is per newton of grip."""
    unit = next(unit for ending, unit in UNITS.items() if ending in name)
    return f"{unit}/N" if name.endswith(".per_newton") else unit


@dataclass(frozen=True)
class DriveChain:
    """Motor mass - transmission - stylus - skin - hand mass - arm.

    Attributes
    ----------
    force_per_current_N_A : known, not identified: with it all masses, stiffnesses and dampings scale alike.
    shared : (4,) values of `SHARED`.
    hand : (5, 2) constant and per newton of `HAND`; (0, 2) without any.
    """

    force_per_current_N_A: float
    shared: FloatArray
    hand: FloatArray

    def hand_at(self, grip_N: float) -> FloatArray:
        """(5,) values of `HAND`."""
        return np.asarray(self.hand[:, 0] + self.hand[:, 1] * grip_N)

    def parameters(self, grip_N: float) -> FloatArray:
        """(9,) at a held grip, (4,) of the free device."""
        return np.concatenate([self.shared, self.hand_at(grip_N)]) if grip_N > 0 else self.shared

    def plant(self, grip_N: float) -> StateSpace:
        """The model of design at a grip, 0 for the free device.

        Raises
        ------
        InputError : not passive there.
        """
        return chain_of(self.parameters(grip_N), self.force_per_current_N_A)

    def with_force(self, force_per_current_N_A: float) -> "DriveChain":
        """The device of the same response with another force per ampere."""
        factor = force_per_current_N_A / self.force_per_current_N_A
        return DriveChain(force_per_current_N_A, self.shared * factor, self.hand * factor)

    def shares(self, grip_N: float) -> list[tuple[StateSpace, float]]:
        """The one plant of a grip, with its weight, as a black box that blends has several."""
        return [(self.plant(grip_N), 1.0)]


def chain_of(parameters: FloatArray, force_per_current_N_A: float) -> StateSpace:
    """The chain of (9,) or, free, (4,) parameters."""
    mass, stylus, stiffness, damping, *hand = parameters.tolist()
    masses, links = [mass, stylus], [Link(stiffness, damping)]
    if hand:
        masses.append(hand[0])
        links += [Link(hand[1], hand[2]), Link(hand[3], hand[4])]
    return chain(masses, links, force_per_current_N_A=force_per_current_N_A, stylus=STYLUS)


def log_slopes(parameters: FloatArray, force_per_current_N_A: float) -> tuple[StateSpace, tuple[Slope, ...]]:
    """A chain and its derivatives by the logarithm of each parameter, exact.

    The equation of a mass (`transopt.plant.chain`) is in proportion to 1/mass, and linear in every stiffness, whose
    column of A it is, and in every damping d, whose part of A is -d / mass times the elongation's row of its link by
    itself.

    Parameters
    ----------
    parameters : (9,) or (4,).
    """
    plant = chain_of(parameters, force_per_current_N_A)
    n, names = plant.order // 2, (*SHARED, *HAND)[: parameters.size]
    masses = parameters[[name.endswith("mass_kg") for name in names]]
    joined = np.eye(n) - np.eye(n, k=1)
    A, B = np.zeros((parameters.size, *plant.A.shape)), np.zeros((parameters.size, *plant.B.shape))
    mass = link = 0
    for j, name in enumerate(names):
        if name.endswith("mass_kg"):
            A[j, n + mass], B[j, n + mass] = -plant.A[n + mass], -plant.B[n + mass]
            mass += 1
        elif name.endswith("stiffness_N_m"):
            A[j, n:, link] = plant.A[n:, link]
        else:
            A[j, n:, n:] = -parameters[j] / masses[:, None] * np.outer(joined[link], joined[link])
            link += 1
    seen = slice(n + STYLUS, n + STYLUS + 1)
    return plant, tuple(Slope(*matrices) for matrices in zip(A, B, A[:, seen], B[:, seen], strict=True))


@dataclass(frozen=True)
class Coordinates:
    """The unknowns: logarithms of the shared parameters and of the hand's at the lowest and the highest held grip.

    Between these two grips the hand's parameters are linear, so that the chain is passive at every recorded grip
    whatever the numbers are. With one held grip the hand is taken to be the same at all.

    Attributes
    ----------
    held_N : recorded grips above 0, increasing.
    shared : names of the parameters that are alike at all grips.
    """

    held_N: tuple[float, ...]
    shared: tuple[str, ...] = SHARED

    @property
    def ends_N(self) -> tuple[float, ...]:
        """Lowest and highest held grip; fewer where fewer were recorded."""
        return self.held_N if len(self.held_N) < 2 else (self.held_N[0], self.held_N[-1])

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.shared) + len(HAND) * len(self.ends_N)

    @property
    def names(self) -> tuple[str, ...]:
        """(size,) of the unknowns."""
        return (*self.shared, *(f"hand.{name} at {grip:g} N" for grip in self.ends_N for name in HAND))

    def shares(self, grip_N: float) -> FloatArray:
        """(ends,) weight of each end in the hand at a grip."""
        if len(self.ends_N) < 2:
            return np.ones(len(self.ends_N))
        low, high = self.ends_N
        part = (grip_N - low) / (high - low)
        return np.array([1 - part, part])

    def of(self, device: DriveChain) -> FloatArray:
        """(size,) unknowns of a device that is passive at both ends."""
        values: FloatArray = np.concatenate([device.shared, *(device.hand_at(grip) for grip in self.ends_N)])
        return np.asarray(np.log(values))

    def _hand(self) -> FloatArray:
        """(2, ends) from the values at the ends to constant and per newton."""
        if len(self.ends_N) < 2:
            return np.array([[1.0], [0.0]])[:, : len(self.ends_N)]
        low, high = self.ends_N
        return np.array([[high, -low], [-1.0, 1.0]]) / (high - low)

    def device(self, unknowns: FloatArray, force_per_current_N_A: float) -> DriveChain:
        """The chain of unknowns (size,)."""
        values = np.exp(unknowns)
        ends = values[len(SHARED) :].reshape(-1, len(HAND))
        hand = (self._hand() @ ends).T if self.ends_N else np.zeros((0, 2))
        return DriveChain(force_per_current_N_A, values[: len(SHARED)], hand)

    def at(self, grip_N: float) -> FloatArray:
        """(n + 5, size) from the values at the ends to the n shared parameters and the hand's at a held grip."""
        hand = np.kron(self.shares(grip_N), np.eye(len(HAND)))
        return np.asarray(linalg.block_diag(np.eye(len(self.shared)), hand))

    def lines(self) -> tuple[tuple[str, ...], FloatArray]:
        """Names of the q numbers that a model file states, and (q, size) from the values at the ends to them."""
        parts = ("constant", "per_newton")[: len(self.ends_N)]
        names = (*self.shared, *(f"hand.{name}.{part}" for name in HAND for part in parts))
        each = self._hand()[: len(parts)]
        hand = np.einsum("ab,pe->apeb", np.eye(len(HAND)), each).reshape(
            len(HAND) * len(parts), len(HAND) * len(self.ends_N)
        )
        return names, np.asarray(linalg.block_diag(np.eye(len(self.shared)), hand))

    def stated(self, unknowns: FloatArray) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
        """Names and values (q,) as a model file states them, and d value / d unknown (q, size)."""
        names, lines = self.lines()
        matrix = lines * np.exp(unknowns)
        return names, matrix.sum(axis=1), matrix
