"""Spring-mass-damper chains from motor current to stylus acceleration.

Every model of a device is such a chain, assembled by `chain`: the hand as one mass (`second_order`, seed Fig. 4a),
the stylus before a hand (`fourth_order`, seed Fig. 4b), and a motor that drives the stylus through a transmission
(`drive`). All masses are positive, all stiffnesses and dampings at least zero, so that a chain is passive.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray


@dataclass(frozen=True)
class StateSpace:
    """Continuous-time model from motor current to the stylus acceleration the current adds.

    dx/dt = A x + B i,  y'' = C x + D i,  encoder position = Ce x, all SI, x = 0 on the nominal motion.

    Attributes
    ----------
    A : (n, n) [1/s].
    B : (n, 1) [unit of the state/s/A].
    C : (1, n) [m/s^2 per unit of the state].
    D : (1, 1) [m/s^2/A].
    Ce : (1, n) [m per unit of the state].

    Raises
    ------
    InputError : a matrix of another shape, or with a number that is not finite.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    Ce: FloatArray

    __repr__ = brief

    def __post_init__(self) -> None:
        n = self.A.shape[0]
        shapes = {"A": (n, n), "B": (n, 1), "C": (1, n), "D": (1, 1), "Ce": (1, n)}
        for name, shape in shapes.items():
            matrix = getattr(self, name)
            if matrix.shape != shape:
                raise InputError(f"plant matrix {name} has shape {matrix.shape}, expected {shape}")
            if not np.all(np.isfinite(matrix)):
                raise InputError(f"plant matrix {name} holds a number that is not finite")

    @property
    def order(self) -> int:
        """Number of states n."""
        return int(self.A.shape[0])

    def response(self, frequencies_Hz: FloatArray) -> FloatArray:
        """(m,) complex transfer function y''/i at the given frequencies [m/s^2/A]."""
        s = 2j * np.pi * np.asarray(frequencies_Hz)
        shifted = s[:, None, None] * np.eye(self.order) - self.A
        return np.asarray((self.C @ np.linalg.solve(shifted, self.B) + self.D)[:, 0, 0])


def blended(one: StateSpace, other: StateSpace, share: float) -> StateSpace:
    """Both models side by side, their outputs weighted 1 - `share` and `share`; the orders add."""
    n, m = one.order, other.order
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[n:, n:] = one.A, other.A
    return StateSpace(
        A=A,
        B=np.vstack([one.B, other.B]),
        C=np.hstack([(1 - share) * one.C, share * other.C]),
        D=(1 - share) * one.D + share * other.D,
        Ce=np.hstack([(1 - share) * one.Ce, share * other.Ce]),
    )


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
    encoder: int = 0,
) -> StateSpace:
    """Assemble a chain of masses; link j joins mass j and mass j + 1, the last one mass and ground.

    The ground is the motion that the hand intends, so every displacement is relative to it.
    States: the n elongations e_j = z_j - z_(j+1) (e_n = z_n), then the n velocities. Elongations instead
    of positions keep a stiff transmission well conditioned; the encoder position is a sum of elongations.
    With n - 1 links the chain is free; the last elongation then only integrates the position.

    Parameters
    ----------
    masses_kg : n masses, > 0.
    links : n or n - 1 links, stiffness and damping >= 0.
    force_per_current_N_A : force on the driven mass per ampere.
    driven : index of the mass that the motor's force acts on.
    stylus : index of the mass whose acceleration is the output.
    encoder : index of the mass whose position the encoder sees.

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
    # Row j of `difference` gives the elongation of link j from the positions.
    difference = np.eye(n) - np.eye(n, k=1)
    joined = difference[: len(links)]
    stiffness = np.array([link.stiffness_N_m for link in links])
    damping = np.array([link.damping_N_s_m for link in links])

    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = difference
    A[n:, : len(links)] = -inverse_mass[:, None] * joined.T * stiffness
    A[n:, n:] = -inverse_mass[:, None] * (joined.T * damping @ joined)
    B = np.zeros((2 * n, 1))
    B[n + driven, 0] = force_per_current_N_A * inverse_mass[driven]
    Ce = np.zeros((1, 2 * n))
    Ce[0, encoder:n] = 1.0
    return StateSpace(A, B, A[n + stylus : n + stylus + 1].copy(), B[n + stylus : n + stylus + 1].copy(), Ce)


@dataclass(frozen=True)
class LinearInGrip:
    """A parameter of the hand, `constant + per_newton * grip`, in the parameter's own SI unit."""

    constant: float
    per_newton: float

    def at(self, grip_N: float) -> float:
        """Its value at a grip force."""
        return self.constant + self.per_newton * grip_N


@dataclass(frozen=True)
class Hand:
    """Grip-dependent hand: skin between stylus and hand mass, arm between hand mass and intention."""

    mass_kg: LinearInGrip
    skin_stiffness_N_m: LinearInGrip
    skin_damping_N_s_m: LinearInGrip
    arm_stiffness_N_m: LinearInGrip
    arm_damping_N_s_m: LinearInGrip

    def skin(self, grip_N: float) -> Link:
        """Between stylus and hand mass."""
        return Link(self.skin_stiffness_N_m.at(grip_N), self.skin_damping_N_s_m.at(grip_N))

    def arm(self, grip_N: float) -> Link:
        """Between hand mass and the hand's intention."""
        return Link(self.arm_stiffness_N_m.at(grip_N), self.arm_damping_N_s_m.at(grip_N))


SEED_HAND_MASS_KG = LinearInGrip(0.215, -0.00328)  # seed Eq. 3
SEED_HAND_DAMPING_N_S_M = LinearInGrip(6.713, 0.369)  # seed Eq. 4
SEED_HAND_STIFFNESS_N_M = LinearInGrip(75.65, 14.72)  # seed Eq. 5


def second_order(
    grip_N: float,
    *,
    force_per_current_N_A: float,
    mass_kg: LinearInGrip = SEED_HAND_MASS_KG,
    damping_N_s_m: LinearInGrip = SEED_HAND_DAMPING_N_S_M,
    stiffness_N_m: LinearInGrip = SEED_HAND_STIFFNESS_N_M,
) -> StateSpace:
    """Stylus and hand as one mass on one spring and damper (seed Fig. 4a), by default with the fits of Eqs. 3-5.

    The fits describe the whole hand during real taps. The mass of Eq. 3 falls to zero at a grip of 65 N.

    Raises
    ------
    InputError : parameters that are not passive at this grip.
    """
    link = Link(stiffness_N_m.at(grip_N), damping_N_s_m.at(grip_N))
    return chain([mass_kg.at(grip_N)], [link], force_per_current_N_A=force_per_current_N_A, stylus=0)


def _held(masses_kg: list[float], links: list[Link], hand: Hand, grip_N: float) -> tuple[list[float], list[Link]]:
    """The chain continued by the hand; at grip 0 nobody holds the stylus and it ends where it is, free."""
    if grip_N == 0:
        return masses_kg, links
    return [*masses_kg, hand.mass_kg.at(grip_N)], [*links, hand.skin(grip_N), hand.arm(grip_N)]


def fourth_order(
    grip_N: float, *, hand: Hand, stylus_mass_kg: float, moving_mass_kg: float, force_per_current_N_A: float
) -> StateSpace:
    """Stylus (with the drive rigidly on it) - skin - hand mass - arm (seed Fig. 4b); a free mass at grip 0.

    Raises
    ------
    InputError : parameters that are not passive at this grip.
    """
    masses, links = _held([stylus_mass_kg + moving_mass_kg], [], hand, grip_N)
    return chain(masses, links, force_per_current_N_A=force_per_current_N_A, stylus=0)


def drive(
    grip_N: float,
    *,
    hand: Hand,
    stylus_mass_kg: float,
    moving_mass_kg: float,
    transmission: Link,
    force_per_current_N_A: float,
    driven: int = 0,
) -> StateSpace:
    """Motor mass - transmission - stylus - skin - hand mass - arm; encoder on the motor mass.

    At grip 0 nobody holds the stylus, and the chain ends with it.

    Parameters
    ----------
    driven : 0 for a force on the motor mass, 1 for one on the stylus.

    Raises
    ------
    InputError : parameters that are not passive at this grip.
    """
    masses, links = _held([moving_mass_kg, stylus_mass_kg], [transmission], hand, grip_N)
    return chain(masses, links, force_per_current_N_A=force_per_current_N_A, driven=driven, stylus=1)
