"""Formulas as text: what they are worth, and that nothing but arithmetic is one."""

import casadi as ca
import numpy as np
import pytest

from transopt.base.arithmetic import NUMBERS, NUMPY, Formula
from transopt.base.errors import InputError
from transopt.solvers.nonlinear import CASADI

TEXTS = [
    "BL*(1 - 0.3*(x/0.6e-3)**2)",
    "0.01*tanh(v/1e-3) + abs(x)",
    "-x**2/(1 + exp(-v)) + 2",
    "sqrt(1 + x**2)*cos(3*v) - sin(x)*log(2 + v**2) + atan(+v)",
]


@pytest.mark.parametrize("text", TEXTS)
def test_numbers_arrays_and_expressions_have_one_value(text: str) -> None:
    formula = Formula(text, ("x", "v"), (("BL", 0.8),))
    x, v = 4e-4, -0.7
    scope = {name: getattr(np, {"atan": "arctan"}.get(name, name)) for name in NUMPY}
    expected = eval(text, {"__builtins__": {}}, {**scope, "x": x, "v": v, "BL": 0.8})
    assert formula({"x": x, "v": v}, NUMBERS) == pytest.approx(expected, rel=1e-14)
    assert formula({"x": np.full(3, x), "v": np.full(3, v)}, NUMPY) == pytest.approx(np.full(3, expected), rel=1e-14)
    symbols = ca.SX.sym("x"), ca.SX.sym("v")
    value = ca.Function("value", symbols, [formula(dict(zip("xv", symbols, strict=True)), CASADI)])
    assert float(value(x, v)) == pytest.approx(expected, rel=1e-14)


def test_it_knows_what_it_depends_on() -> None:
    assert Formula("K + x*0", ("x", "v"), (("K", 2.0),)).names == {"x"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("__import__('os').system('true')", "no part of a formula"),
        ("x.real", "no part of a formula"),
        ("x[0]", "no part of a formula"),
        ("[x for x in (1, 2)]", "no part of a formula"),
        ("lambda: x", "no part of a formula"),
        ("x if v else 1", "no part of a formula"),
        ("x and v", "no part of a formula"),
        ("x < 1", "no part of a formula"),
        ("tanh(x, v)", "no part of a formula"),
        ("eval(x)", "no part of a formula"),
        ("'x'", "no part of a formula"),
        ("True", "no part of a formula"),
        ("1j*x", "no part of a formula"),
        ("x // 2", "no part of a formula"),
        ("(x := 2)", "no part of a formula"),
        ("tanh", "no name that a formula may use"),
        ("BLx", "no name that a formula may use: x, v"),
        ("x +", "is no formula"),
        ("", "is no formula"),
        ("x\n+ 1; v", "is no formula"),
        ("1e999*x", "is not finite"),
        ("9" * 400, "is not finite"),
        ("-" * 60 + "x", "nested deeper"),
        ("(" * 300 + "x" + ")" * 300, "is no formula"),
        ("x+" * 600 + "x", "characters"),
        ("\x00", "is no formula"),
    ],
)
def test_what_is_no_formula_is_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        Formula(text, ("x", "v"))
    assert "\n" not in str(refused.value)
