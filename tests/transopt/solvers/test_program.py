"""The size of a program, which is not stated for it where it is long."""

from dataclasses import replace

import casadi as ca
import pytest

from problems.stress.cases import StressCase
from problems.stress.parts import Coil, Current, Horizon, Surface
from transopt.solvers import program
from transopt.solvers.program import Size, program_shape, state_program

CASES = {
    "plain": StressCase("plain"),
    "ideal": StressCase("ideal", current=Current(pole_Hz=None)),
    "rail": StressCase("rail", current=Current(supply=2.0, slew=0.05)),
    "wall": StressCase("wall", surface=Surface(200.0)),
    "coil": StressCase("coil", coil=Coil(below_K=5.0)),
    "repeated": StressCase("repeated", coil=Coil(below_K=20.0, tap_share=0.5)),
}


@pytest.mark.parametrize("name", CASES)
def test_the_size_of_a_long_program_is_that_of_the_program(name: str) -> None:
    shape = program_shape(replace(CASES[name], horizon=Horizon(stages=90)).problem())
    stated = state_program(shape)
    rows = ca.Function("rows", [stated.x, stated.p], [stated.g])
    expected = Size(
        shape.variables - shape.controls, stated.x.numel(), stated.g.numel(), rows.jac_sparsity(0, 0).nnz()
    )
    assert shape.stages > shape.hand_over_samples + 10
    assert program._size(shape) == expected
