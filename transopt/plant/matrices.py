"""A plant stated by its matrices: any linear device that no other kind describes, measured or modelled elsewhere."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from transopt.base.section import Finite, Section, Words
from transopt.base.sizes import MOST_STATES
from transopt.plant.kind import PlantKind, Share
from transopt.plant.motor import Tip
from transopt.plant.state_space import CURRENT_INPUT, POSITION, VELOCITY, VOLTAGE_INPUT, Input, Output, StateSpace

Row = Annotated[list[Finite], Field(min_length=1, max_length=MOST_STATES)]
Rows = Annotated[list[Row], Field(min_length=1, max_length=MOST_STATES)]
# Outputs to which the nominal motion of the stylus is added by default.
FOLLOWED: Mapping[str, Literal["position", "velocity"]] = {"position": "position", "velocity": "velocity"}
# Largest |row B| over |row| |B| of a position. Above this rounding the input acts directly on the velocity, which
# is then no function of the states.
MAX_FEEDTHROUGH = 1e-6


class OutputTable(Section):
    """One further output of the plant: its row over the states, its unit, and the nominal motion that is added to it.

    Without `follows`, the outputs "position" and "velocity" are those of a mass that moves with a stylus. With
    `follows = ""` they are relative to a case.

    Attributes
    ----------
    row : the output as a row over the states.
    unit : unit of the output.
    follows : nominal motion that is added, "position" or "velocity"; empty for a motion against a case.
    """

    row: Row
    unit: Words
    follows: Literal["", "position", "velocity"] | None = None


class Matrices(PlantKind):
    """dx/dt = A x + B u, acceleration = C x + D u, u a current or a voltage, all SI.

    A scene states the matrices or names a `file` that has them. Limits may be stated on the outputs in `outputs`:
    `limits.stroke_m` bounds "position", `limits.velocity_m_s` bounds "velocity", and for a voltage-driven coil
    `limits.current_A` bounds "current".

    A device with several drives has a column of B for each, and may have a row of C for each of several
    accelerations. The first of them follows the target, the others are held at zero, as `weights.tangential` says.

    Attributes
    ----------
    input : input of the plant, a current or a voltage.
    A : rows of A in dx/dt = A x + B u.
    B : column B, or its rows, which have a number for each of several drives.
    C : row C of the acceleration, C x + D u, or a row for each of several accelerations.
    D : direct part of the acceleration, or its rows; 0 for all.
    motor_shares : share of the transient limit that each of several drives has, where they are not equally strong.
    outputs : tables of further outputs, on which limits may be stated.
    file : file that contains the matrices, in place of the keys.
    """

    driven_at_tip: ClassVar[bool] = False
    held_by_hand: ClassVar[bool] = False

    kind: Literal["state_space"]
    input: Literal["current", "voltage"] = "current"
    A: Rows
    B: Row | Rows
    C: Row | Rows
    D: Finite | Rows = 0.0
    motor_shares: Annotated[list[Share], Field(max_length=MOST_STATES)] = Field(default_factory=list)
    outputs: Annotated[dict[Words, OutputTable], Field(max_length=MOST_STATES)] = Field(default_factory=dict)
    file: Words = ""

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        n, B, C = len(self.A), _rows(self.B, column=True), _rows(self.C)
        of_states = {"A": self.A, "C": C, **{name: [o.row] for name, o in self.outputs.items()}}
        if not isinstance(self.B[0], list):
            of_states["B"] = [self.B]
        for name, matrix in of_states.items():
            odd = next((len(row) for row in matrix if len(row) != n), None)
            if odd is not None:
                raise ValueError(f"{name}: a row of {odd} numbers, A has {n} states: every row needs {n}")
        m, p = len(B[0]), len(C)
        if p > 1 and m == 1:
            raise ValueError(f"C: {p} rows need several drives: give B a row of numbers for each state, or C one row")
        sized = {"B": (B, n)} | ({} if self.D == 0 else {"D": (_rows(self.D), p)})
        for name, (matrix, rows) in sized.items():
            if len(matrix) != rows or any(len(row) != m for row in matrix):
                size = f"{rows} row{'s' * (rows > 1)} of {m} number{'s' * (m > 1)}"
                raise ValueError(f"{name}: B has {m} column{'s' * (m > 1)}, so it needs {size}")
        if self.motor_shares and len(self.motor_shares) != m:
            raise ValueError(f"motor_shares: {len(self.motor_shares)} of them, B has {m} columns: give one for each")
        if POSITION in self.outputs:
            row = np.array(self.outputs[POSITION].row)
            made, most = row @ np.array(B), np.linalg.norm(row) * np.linalg.norm(B, axis=0)
            if (np.abs(made) > MAX_FEEDTHROUGH * most).any():
                raise ValueError(
                    f"outputs.{POSITION}: the input changes its velocity at once, by {np.abs(made).max():.3g} per "
                    "unit (its row times B, must be 0): give it another name, or the row of a mass's position"
                )
        return self

    @property
    def shares(self) -> list[float]:
        motors = len(_rows(self.B, column=True)[0])
        return (self.motor_shares or [1.0] * motors) if motors > 1 else []

    @property
    def directions(self) -> int:
        return len(_rows(self.C))

    @classmethod
    def of(cls, plant: StateSpace) -> Self:
        """The table `[model]` of a plant."""
        several = (plant.motors, plant.tracked) != (1, 1)
        return cls(
            kind="state_space",
            input="voltage" if plant.driven_by == VOLTAGE_INPUT else "current",
            A=plant.A.tolist(),
            B=(plant.B if several else plant.B[:, 0]).tolist(),
            C=(plant.C if several else plant.C[0]).tolist(),
            D=plant.D.tolist() if several else float(plant.D[0, 0]),
            outputs={
                name: OutputTable(row=output.row[0].tolist(), unit=output.unit, follows=output.follows)
                for name, output in plant.outputs.items()
            },
        )

    @property
    def driven_by(self) -> Input:
        return VOLTAGE_INPUT if self.input == "voltage" else CURRENT_INPUT

    def plant(self, grip_N: float, tip: Tip | None, *, struck: bool = False) -> StateSpace:
        outputs = {
            name: Output(
                np.array([table.row]), table.unit, FOLLOWED.get(name, "") if table.follows is None else table.follows
            )
            for name, table in self.outputs.items()
        }
        if POSITION in outputs and VELOCITY not in outputs:
            # The velocity of the same mass is the position's derivative.
            position = outputs[POSITION]
            outputs[VELOCITY] = Output(position.row @ np.array(self.A), "m/s", VELOCITY if position.follows else "")
        B, C = np.array(_rows(self.B, column=True)), np.array(_rows(self.C))
        return StateSpace(
            A=np.array(self.A),
            B=B,
            C=C,
            D=np.zeros((C.shape[0], B.shape[1])) if self.D == 0 else np.array(_rows(self.D)),
            outputs=outputs,
            driven_by=self.driven_by,
        )


def _rows(stated: float | list[float] | list[list[float]], *, column: bool = False) -> list[list[float]]:
    """A matrix row by row, of which a scene states a single number, a single row or a single `column` as such."""
    if not isinstance(stated, list):
        return [[stated]]
    vector = [each for each in stated if not isinstance(each, list)]
    if not vector:
        return [each for each in stated if isinstance(each, list)]
    return [[each] for each in vector] if column else [vector]
