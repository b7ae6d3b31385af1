"""A plant by its matrices: any linear device that the other kinds do not describe, measured or modelled elsewhere."""

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
# Outputs that the nominal motion of a stylus is added to.
FOLLOWED: Mapping[str, Literal["position", "velocity"]] = {"position": "position", "velocity": "velocity"}
AT_ONCE = 1e-6  # of the sizes of row and B: beyond rounding, a position has no velocity that its states tell


class OutputTable(Section):
    """One further output of the plant: its row over the states, its unit, and what nominal motion it follows.

    Without `follows`, "position" and "velocity" are those of a mass that moves with a stylus; `follows = ""` says
    that they are against a case.

    Attributes
    ----------
    row : the output as a row over the states.
    unit : unit of the output.
    follows : nominal motion that is added; empty for a motion against a case.
    """

    row: Row
    unit: Words
    follows: Literal["", "position", "velocity"] | None = None


class Matrices(PlantKind):
    """dx/dt = A x + B u, acceleration = C x + D u, u a current or a voltage, all SI.

    A scene states the matrices or names the `file` that has them. `outputs` names what limits may be on; "position"
    and "velocity" are those that `limits.stroke_m` and `limits.velocity_m_s` bound, "current" of a coil that a
    voltage drives that of `limits.current_A`.

    Attributes
    ----------
    input : what drives the plant.
    A : rows of A in dx/dt = A x + B u.
    B : column B.
    C : row C of the acceleration, C x + D u.
    D : direct part of the acceleration.
    outputs : tables of further outputs that limits may be on.
    file : file that holds the matrices in their place.
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
            if abs(row @ B) > AT_ONCE * np.linalg.norm(row) * np.linalg.norm(B):
                raise ValueError(
                    f"outputs.{POSITION}: the input changes its velocity at once, by {row @ B:.3g} per unit (its row "
                    "times B, must be 0): give it another name, or the row of a mass's position"
                )
        return self

    @classmethod
    def of(cls, plant: StateSpace) -> Self:
        """The table that states a plant by its matrices.

        Raises
        ------
        InputError : a plant with several inputs or outputs, which a scene states only as an arm.
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
            # A position tells the velocity of the same mass.
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
