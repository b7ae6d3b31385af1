"""A plant by its matrices: any linear device that the other kinds do not describe, measured or modelled elsewhere."""

from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from transopt.base.section import Finite, Section, Words
from transopt.base.sizes import MOST_STATES
from transopt.plant.kind import PlantKind
from transopt.plant.motor import Tip
from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT, Input, Output, StateSpace

Row = Annotated[list[Finite], Field(min_length=1, max_length=MOST_STATES)]
FOLLOWED = {"position": "position", "velocity": "velocity"}  # outputs that the nominal motion of a stylus is added to


class OutputTable(Section):
    """One further output of the plant: its row over the states, and its unit."""

    row: Row
    unit: Words


class Matrices(PlantKind):
    """dx/dt = A x + B u, acceleration = C x + D u, u a current or a voltage, all SI.

    `outputs` names what limits may be on; "position" and "velocity" are those that `limits.stroke_m` and
    `limits.velocity_m_s` bound, "current" of a coil that a voltage drives that of `limits.current_A`.
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
        return self

    @property
    def driven_by(self) -> Input:
        return VOLTAGE_INPUT if self.input == "voltage" else CURRENT_INPUT

    def plant(self, grip_N: float, tip: Tip | None, *, struck: bool = False) -> StateSpace:
        outputs = {
            name: Output(np.array([table.row]), table.unit, FOLLOWED.get(name, ""))  # type: ignore[arg-type]
            for name, table in self.outputs.items()
        }
        return StateSpace(
            A=np.array(self.A),
            B=np.array(self.B)[:, None],
            C=np.array([self.C]),
            D=np.array([[self.D]]),
            outputs=outputs,
            driven_by=self.driven_by,
        )
