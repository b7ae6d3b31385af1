"""The size of a program, for which the program is not stated."""

from dataclasses import replace

import pytest

from problems.stress.cases import StressCase
from problems.stress.parts import Coil, Current, Horizon, Surface
from transopt.solvers.program import state_program
from transopt.solvers.shape import Size, program_shape, size

CASES = {
    "plain": StressCase("plain"),
    "ideal": StressCase("ideal", current=Current(pole_Hz=None)),
    "rail": StressCase("rail", current=Current(supply=2.0, slew=0.05)),
    "wall": StressCase("wall", surface=Surface(200.0)),
    "coil": StressCase("coil", coil=Coil(below_K=5.0)),
    "repeated": StressCase("repeated", coil=Coil(below_K=20.0, tap_share=0.5)),
}


@pytest.mark.parametrize("name", CASES)
def test_the_size_counted_is_that_of_the_program_stated(name: str) -> None:
    problem = replace(CASES[name], horizon=Horizon(stages=90)).problem()
    shape = program_shape(problem)
    stated = state_program(shape)
    assert size(problem) == Size(shape.variables - shape.controls, stated.x.numel(), stated.g.numel())
