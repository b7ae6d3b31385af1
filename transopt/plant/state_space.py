"""A device at one grip as a continuous-time state space with named outputs.

The input is a current or a voltage (`Input`), the tracked output an acceleration, that of the stylus or of a case.
Each kind of plant names its further outputs, on which limits may be stated: positions and velocities of its masses,
or the current of a voltage-driven coil. States are available by number.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray

POSITION: Final = "position"  # output: position of the mass that the encoder reads, the motor's
VELOCITY: Final = "velocity"  # output: velocity of the same mass


@dataclass(frozen=True)
class Input:
    """The kind of a plant's input, with its name and unit for reports, figures and messages.

    Attributes
    ----------
    name : "current" or "voltage".
    unit : "A" or "V".
    """

    name: str
    unit: str


CURRENT_INPUT: Final = Input("current", "A")
VOLTAGE_INPUT: Final = Input("voltage", "V")
INPUTS: Final = MappingProxyType({each.unit: each for each in (CURRENT_INPUT, VOLTAGE_INPUT)})


@dataclass(frozen=True)
class Output:
    """One named output of a plant, without direct feedthrough of the input.

    Attributes
    ----------
    row : (1, n) [unit per unit of the state].
    unit : unit of the output.
    follows : "position" or "velocity" where z_nom or its derivative has to be added, as for a mass; empty for an
        output that the nominal motion does not change, such as the stretch between two masses.
    """

    row: FloatArray
    unit: str
    follows: Literal["", "position", "velocity"] = ""

    def is_as_good_as(self, other: "Output") -> bool:
        """Whether it equals the other output up to rounding of its row."""
        close = np.allclose(self.row, other.row, rtol=1e-9, atol=1e-12 * float(np.abs(other.row).max(initial=0.0)))
        return bool(close) and (self.unit, self.follows) == (other.unit, other.follows)


@dataclass(frozen=True)
class StateSpace:
    """Continuous-time model from the input u, a current or a voltage, to the acceleration y'' that it adds.

    dx/dt = A x + B u,  y'' = C x + D u,  all SI, x = 0 on the nominal motion. A device with one motor that moves
    along one line has m = p = 1; an arm has a column of B for each motor and a row of C for each direction.

    Attributes
    ----------
    A : (n, n) [1/s].
    B : (n, m) [unit of the state/s per A or V].
    C : (p, n) [m/s^2 per unit of the state].
    D : (p, m) [m/s^2 per A or V].
    outputs : name -> further output. "position" and "velocity" are those of the mass that the encoder reads; a device
        without them, such as a black box, can have no wall and no limit on its motion. The velocities of further
        motors are "velocity 2" to "velocity m".
    driven_by : whether u is a current or a voltage.

    Raises
    ------
    InputError : a matrix of the wrong shape, or with NaN or an infinite number.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    outputs: Mapping[str, Output] = field(default_factory=dict)
    driven_by: Input = CURRENT_INPUT

    __repr__ = brief

    def __post_init__(self) -> None:
        n, m, p = self.A.shape[0], *(max(size, 1) for size in (self.B.shape[-1], self.C.shape[0]))
        shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
        named = {"A": self.A, "B": self.B, "C": self.C, "D": self.D} | {k: v.row for k, v in self.outputs.items()}
        for name, matrix in named.items():
            shape = shapes.get(name, (1, n))
            if matrix.shape != shape:
                raise InputError(f"plant matrix {name} has shape {matrix.shape}, expected {shape}")
        # All at once: a plant is made for every tap.
        if not np.isfinite(np.concatenate([matrix.ravel() for matrix in named.values()])).all():
            name = next(name for name, matrix in named.items() if not np.isfinite(matrix).all())
            raise InputError(f"plant matrix {name} holds a number that is not finite")

    @property
    def order(self) -> int:
        """Number of states n."""
        return int(self.A.shape[0])

    @property
    def motors(self) -> int:
        """Number of inputs m."""
        return int(self.B.shape[1])

    @property
    def tracked(self) -> int:
        """Number of tracked accelerations p."""
        return int(self.C.shape[0])

    @property
    def numbers(self) -> tuple[object, ...]:
        """All its numbers and names: equal for equal plants, and hashable."""
        matrices = tuple((of.shape, of.tobytes()) for of in (self.A, self.B, self.C, self.D))
        outputs = tuple((name, of.row.tobytes(), of.unit, of.follows) for name, of in self.outputs.items())
        return matrices, outputs, self.driven_by

    @classmethod
    def from_matrices(
        cls,
        A: FloatArray,
        B: FloatArray,
        C: FloatArray,
        D: FloatArray,
        Ce: FloatArray,
        outputs: Mapping[str, Output] = MappingProxyType({}),
        driven_by: Input = CURRENT_INPUT,
    ) -> "StateSpace":
        """Read a device as a library stores it: the encoder's position is Ce x, its velocity Ce A x.

        A row Ce of zeros means a device without a known position. `outputs` are its other named outputs.
        """
        if not Ce.any():
            return cls(A, B, C, D, outputs, driven_by)
        seen = {POSITION: Output(Ce, "m", POSITION), VELOCITY: Output(Ce @ A, "m/s", VELOCITY)}
        return cls(A, B, C, D, {**seen, **outputs}, driven_by)

    @property
    def Ce(self) -> FloatArray:
        """(1, n) row of the position that the encoder reads; zero if the device has none."""
        return self.outputs[POSITION].row if POSITION in self.outputs else np.zeros((1, self.order))

    @property
    def Cv(self) -> FloatArray:
        """(m, n) rows of the velocities to which the motors' back-EMFs are proportional; zero if unknown.

        The first motor's is the velocity of the mass whose position the encoder reads.
        """
        names = [VELOCITY, *(f"{VELOCITY} {j}" for j in range(2, self.motors + 1))]
        none = np.zeros((1, self.order))
        return np.concatenate([self.outputs[name].row if name in self.outputs else none for name in names])

    @property
    def moves_in_a_case(self) -> bool:
        """Whether its position is relative to a case that moves with the nominal motion: z_nom is not added then."""
        return POSITION in self.outputs and not self.outputs[POSITION].follows

    def output(self, name: str) -> Output:
        """A named output; "state 1" to "state n" are the plant's states.

        Raises
        ------
        InputError : an output that the plant does not have.
        """
        if name in self.outputs:
            return self.outputs[name]
        states = {f"state {j + 1}": j for j in range(self.order)}
        if name not in states:
            raise InputError(f"model: it has no output {name}; it has {', '.join([*self.outputs, *states])}")
        return Output(np.eye(1, self.order, states[name]), "of the state")

    def stored(self, names: Iterable[str]) -> dict[str, dict[str, Any]]:
        """Named outputs for the `meta` of a library: those that do not follow from A and Ce.

        Position and velocity are always among them if they differ from those of A and Ce, as for a mass in a case, or
        for a velocity of another mass.
        """
        implied = StateSpace.from_matrices(self.A, self.B, self.C, self.D, self.Ce).outputs
        known = [name for name, o in implied.items() if name in self.outputs and self.outputs[name].is_as_good_as(o)]
        own = [n for n in dict.fromkeys([POSITION, VELOCITY, *names]) if n in self.outputs and n not in known]
        return {name: {**asdict(self.outputs[name]), "row": self.outputs[name].row[0].tolist()} for name in own}

    def response(self, frequencies_Hz: FloatArray) -> FloatArray:
        """(f,) complex transfer function y''/u at f frequencies [m/s^2 per A or V]; (f, p, m) with several motors."""
        s = 2j * np.pi * np.asarray(frequencies_Hz)
        shifted = s[:, None, None] * np.eye(self.order) - self.A
        gain = np.asarray(self.C @ np.linalg.solve(shifted, self.B) + self.D)
        return gain[:, 0, 0] if gain.shape[1:] == (1, 1) else gain


def blended(one: StateSpace, other: StateSpace, share: float) -> StateSpace:
    """Both models in parallel, their tracked outputs weighted by 1 - `share` and `share`; the orders add."""
    n, m = one.order, other.order
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[n:, n:] = one.A, other.A
    return StateSpace(
        A=A,
        B=np.vstack([one.B, other.B]),
        C=np.hstack([(1 - share) * one.C, share * other.C]),
        D=(1 - share) * one.D + share * other.D,
        driven_by=one.driven_by,
    )


def blended_at(grips_N: Sequence[float], plants: Sequence[StateSpace], grip_N: float) -> StateSpace:
    """The plant at a grip from those at increasing grips: blended linearly, constant outside them.

    The free device, at grip 0, is blended with none. Where at least two held grips are given, every held plant has
    the order of two, also at a given grip, so that all have the same order.
    """
    first = 1 if grips_N[0] == 0 else 0
    held = grips_N[first:]
    if grip_N == 0 or len(held) == 1:
        return plants[0 if grip_N == 0 else first]
    grip = min(max(grip_N, held[0]), held[-1])
    j = min(int(np.searchsorted(held, grip, side="right")) - 1, len(held) - 2)
    return blended(plants[first + j], plants[first + j + 1], (grip - held[j]) / (held[j + 1] - held[j]))
