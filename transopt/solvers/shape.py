"""What fixes the size and the sparsity of a problem's program, read off the problem without stating the program."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from transopt.problem.limits.own import LawRow
from transopt.problem.objective.tail import tail
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import Layout, layout, linear_stage
from transopt.solvers.stage_data import stated_rows


@dataclass(frozen=True)
class RowShape:
    """What of a limit's row fixes the sparsity of the program."""

    name: str
    states: tuple[bool, ...]
    first: int
    motor: int

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(1, n) states that the value depends on."""
        return np.array([self.states])


@dataclass(frozen=True)
class LawShape:
    """What of a limit that is not linear fixes the program: its function, of so many outputs, as text."""

    name: str
    text: str
    outputs: int


@dataclass(frozen=True)
class Shape:
    """What fixes the sparsity of the program; problems of one shape share one solver object.

    Attributes
    ----------
    rows : sums of several outputs that are bounded, each by its name, the states that it depends on, and its first
        stage; what bounds one variable alone is a box on it and no row.
    laws : functions of outputs that are bounded.
    ends : rows of what is led to a target after the window.
    nodes : thermal states, 0 without.
    repeated : taps repeat for ever.
    """

    stages: int
    layout: Layout
    hand_over_samples: int
    rows: tuple["RowShape", ...]
    laws: tuple["LawShape", ...]
    ends: int
    nodes: int
    repeated: bool

    @property
    def controls(self) -> int:
        """Movements, and with the temperature the size of the mean current."""
        return self.layout.motors + int(self.nodes > 0)

    @property
    def variables(self) -> int:
        """Variables of one stage."""
        return self.controls + self.layout.states + self.nodes

    @property
    def first(self) -> int:
        """Variables in front of the first stage."""
        return self.nodes if self.repeated else 0

    @property
    def command(self) -> int:
        """Index of the first command among a stage's variables."""
        return self.controls + self.layout.states - self.layout.motors

    @property
    def commands(self) -> slice:
        """Indices of all commands among a stage's variables."""
        return slice(self.command, self.command + self.layout.motors)


def program_shape(problem: TransientProblem) -> Shape:
    thermal, stage = problem.thermal, linear_stage(problem)
    rows = [row for row in stated_rows(problem, stage) if not row.single]
    return Shape(
        stages=problem.grid.stages,
        layout=layout(problem),
        hand_over_samples=problem.hand_over_samples,
        rows=tuple(RowShape(row.name, tuple((row.G != 0).tolist()), 0 if row.d else 1, row.motor) for row in rows),
        laws=tuple(
            LawShape(row.name, row.law.text, len(row.outputs)) for _, row in problem.rows() if isinstance(row, LawRow)
        ),
        ends=tail(problem, stage).target.size,
        nodes=0 if thermal is None else thermal.model.nodes,
        repeated=thermal is not None and thermal.model.closure is not None,
    )


@dataclass(frozen=True)
class Size:
    """How large a solved program is: states per stage, all its variables, rows of its constraints."""

    states: int
    variables: int
    rows: int


def size(problem: TransientProblem) -> Size:
    """Size of the program that states this problem, counted from its shape: nothing is stated for it."""
    shape = program_shape(problem)
    N, n, m = shape.stages, shape.layout.states, shape.nodes
    dynamics, hand_over = n * N, shape.layout.motors * shape.hand_over_samples
    heat = (m + 2) * N + shape.first if m else 0  # the nodes, and two rows for the size of the mean current
    limits = sum(N - row.first for row in shape.rows) + len(shape.laws) * N
    return Size(n + m, shape.first + shape.variables * N, dynamics + hand_over + heat + limits)
