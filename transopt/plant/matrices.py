"""A plant stated by its matrices: any linear device that no other kind describes, measured or modelled elsewhere."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from transopt.base.errors import InputError
from transopt.base.section import Finite, Section, Words
from transopt.base.sizes import MOST_STATES
from transopt.plant.kind import PlantKind
from transopt.plant.motor import Tip
from transopt.plant.state_space import CURRENT_INPUT, POSITION, VELOCITY, VOLTAGE_INPUT, Input, Output, StateSpace

Row = Annotated[list[Finite], Field(min_length=1, max_length=MOST_STATES)]
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

    Attributes
    ----------
    input : input of the plant, a current or a voltage.
    A : rows of A in dx/dt = A x + B u.
    B : column B.
    C : row C of the acceleration, C x + D u.
    D : direct part of the acceleration.
    outputs : tables of further outputs, on which limits may be stated.
    file : file that contains the matrices, in place of the keys.
    """

    driven_at_tip: ClassVar[bool] = False
    held_by_hand: ClassVar[bool] = False

    kind: Literal["state_space"]
    input: Literal["current", "voltage"] = "current"
    A: Annotated[list[Row], Field(min_length=1, max_length=MOST_STATES)]
    B: Row
    C: Row
    D: Finite = 0.0
    outputs: Annotated[dict[Words, OutputTable], Field(max_length=MOST_STATES)] = Field(default_factory=dict)
    file: Words = ""

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        n = len(self.A)
        rows = {"A": self.A, "B": [self.B], "C": [self.C], **{name: [o.row] for name, o in self.outputs.items()}}
        for name, matrix in rows.items():
            odd = next((len(row) for row in matrix if len(row) != n), None)
            if odd is not None:
                raise ValueError(f"{name}: a row of {odd} numbers, A has {n} states: every row needs {n}")
        if POSITION in self.outputs:
            row, B = np.array(self.outputs[POSITION].row), np.array(self.B)
            if abs(row @ B) > MAX_FEEDTHROUGH * np.linalg.norm(row) * np.linalg.norm(B):
                raise ValueError(
                    f"outputs.{POSITION}: the input changes its velocity at once, by {row @ B:.3g} per unit (its row "
                    "times B, must be 0): give it another name, or the row of a mass's position"
                )
        return self

    @classmethod
    def of(cls, plant: StateSpace) -> Self:
        """The table `[model]` of a plant.

        Raises
        ------
        InputError : a plant with several inputs or outputs, which a scene can state only as an arm.
        """
        if (plant.motors, plant.tracked) != (1, 1):
            raise InputError(
                f"plant: it has {plant.motors} inputs and {plant.tracked} outputs, and a scene's state_space has one "
                "of each: pose a TransientProblem with it by hand, or state an arm"
            )
        return cls(
            kind="state_space",
            input="voltage" if plant.driven_by == VOLTAGE_INPUT else "current",
            A=plant.A.tolist(),
            B=plant.B[:, 0].tolist(),
            C=plant.C[0].tolist(),
            D=float(plant.D[0, 0]),
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
        return StateSpace(
            A=np.array(self.A),
            B=np.array(self.B)[:, None],
            C=np.array([self.C]),
            D=np.array([[self.D]]),
            outputs=outputs,
            driven_by=self.driven_by,
        )
