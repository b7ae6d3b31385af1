"""The shape of a problem's program, its size and sparsity, found without stating the program."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from transopt.problem.limits.own import LawRow
from transopt.problem.objective.tail import tail
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import Layout, layout, linear_stage
from transopt.solvers.stated_rows import stated_rows


@dataclass(frozen=True)
class RowShape:
    """The part of a limit's row that determines the sparsity of the program."""

    name: str
    states: tuple[bool, ...]
    first: int
    motor: int

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(1, n) mask of the states on which the value depends."""
        return np.array([self.states])


@dataclass(frozen=True)
class LawShape:
    """The part of a nonlinear limit that determines the program: its function as text, and its number of outputs."""

    name: str
    text: str
    outputs: int


@dataclass(frozen=True)
class Shape:
    """Size and sparsity of the program; problems of one shape share one solver object.

    Attributes
    ----------
    rows : bounded sums of several variables: name, states that the sum depends on, first stage. A limit on a single
        variable is a box and not a row.
    laws : bounded nonlinear functions of outputs.
    ends : number of terms that weigh the state at the end of the window.
    nodes : number of thermal states; 0 without a temperature limit.
    repeated : whether taps repeat without end, so that the temperatures are periodic.
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
        """Number of controls: the movements and, with the temperature, the magnitude of the mean current."""
        return self.layout.motors + int(self.nodes > 0)

    @property
    def variables(self) -> int:
        """Number of variables of one stage."""
        return self.controls + self.layout.states + self.nodes

    @property
    def first(self) -> int:
        """Number of variables before those of the first stage: th_0 where taps repeat."""
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
    """Size of a solved program: states per stage, variables, and constraint rows in all."""

    states: int
    variables: int
    rows: int


def size(problem: TransientProblem) -> Size:
    """Size of this problem's program, counted from its shape without stating the program."""
    shape = program_shape(problem)
    N, n, m = shape.stages, shape.layout.states, shape.nodes
    dynamics, hand_over = n * N, shape.layout.motors * shape.hand_over_samples
    heat = (m + 2) * N + shape.first if m else 0  # the nodes, and two rows for the size of the mean current
    limits = sum(N - row.first for row in shape.rows) + len(shape.laws) * N
    return Size(n + m, shape.first + shape.variables * N, dynamics + hand_over + heat + limits)
