"""Formulas that a user writes as text, evaluated without executing the text as Python code.

A formula is arithmetic: numbers, names, + - * / **, parentheses and the functions of `FUNCTIONS`. Python's own parser
turns it into a syntax tree, and every node of the tree is checked. The tree is evaluated with the functions that the
caller passes: those of numpy, of `math` for single numbers, or of CasADi, so that one text gives both numbers and
symbolic expressions.
"""

import ast
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from transopt.base.errors import InputError

FUNCTIONS: Final = ("abs", "atan", "cos", "exp", "log", "sin", "sqrt", "tanh")
LONGEST = 1000  # characters of a formula
DEEPEST = 50  # depth of its tree; deeper trees could exceed Python's recursion limit

Functions = Mapping[str, Callable[[Any], Any]]  # each of `FUNCTIONS`, by name


def _size(x: Any) -> Any:
    """|x| that is compatible with complex-step differentiation: its derivative is the sign of the real part."""
    return np.where(np.real(x) < 0, -x, x)


NUMPY: Final[Functions] = MappingProxyType(
    {
        "abs": _size,
        "atan": np.arctan,
        **{name: getattr(np, name) for name in FUNCTIONS if name not in ("abs", "atan")},
    }
)
NUMBERS: Final[Functions] = MappingProxyType(
    {"abs": abs, **{name: getattr(math, name) for name in FUNCTIONS if name != "abs"}}
)

_BINARY: Final[Mapping[type[ast.operator], Callable[[Any, Any], Any]]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}

Compiled = Callable[[Mapping[str, Any], Functions], Any]


@dataclass(frozen=True)
class Formula:
    """A formula over named quantities.

    Attributes
    ----------
    text : the text as the user wrote it.
    variables : names of the variables. constants : names and values of the constants.

    Raises
    ------
    InputError : a text that is not a valid formula; the message says why.
    """

    text: str
    variables: tuple[str, ...]
    constants: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        assert self._compiled is not None  # parse now, so that an invalid text is refused at once

    @cached_property
    def names(self) -> frozenset[str]:
        """Variables that occur in the formula."""
        found = {node.id for node in ast.walk(self._tree) if isinstance(node, ast.Name)}
        return frozenset(found & set(self.variables))

    @cached_property
    def functions(self) -> frozenset[str]:
        """Functions that occur in the formula."""
        calls = (node.func for node in ast.walk(self._tree) if isinstance(node, ast.Call))
        return frozenset(function.id for function in calls if isinstance(function, ast.Name))

    def __call__(self, values: Mapping[str, Any], functions: Functions) -> Any:
        """Evaluate the formula; `values` has every variable, and `functions` can take values of their type."""
        return self._compiled({**dict(self.constants), **values}, functions)

    @cached_property
    def _tree(self) -> ast.expr:
        if len(self.text) > LONGEST:
            raise InputError(f"a formula of {len(self.text)} characters, at most {LONGEST}")
        try:
            return ast.parse(self.text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise InputError(f"{self.text!r} is no formula: write arithmetic as in 0.8*(1 - (x/1e-3)**2)") from None

    @cached_property
    def _compiled(self) -> Compiled:
        return _compiled(self._tree, (*self.variables, *dict(self.constants)), 0)


def _compiled(node: ast.expr, names: Collection[str], depth: int) -> Compiled:
    if depth > DEEPEST:
        raise InputError(f"a formula is nested deeper than {DEEPEST}: split it or write it flatter")
    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=int() | float()):
            value = _number(node.value)
            return lambda _values, _functions: value
        case ast.Name(id=name) if name in names:
            return lambda values, _functions: values[name]
        case ast.Name(id=name):
            known = ", ".join((*names, *FUNCTIONS))
            raise InputError(f"{name} is no name that a formula may use: {known}")
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            negated = _compiled(operand, names, depth + 1)
            return lambda values, functions: -negated(values, functions)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _compiled(operand, names, depth + 1)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _binary(type(op), _compiled(left, names, depth + 1), _compiled(right, names, depth + 1))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            inside = _compiled(argument, names, depth + 1)
            return lambda values, functions: functions[name](inside(values, functions))
    raise InputError(
        f"{ast.unparse(node)[:60]!r} is no part of a formula: use numbers, + - * / ** and {', '.join(FUNCTIONS)} of "
        "one argument"
    )


def _number(value: Any) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError("a number of a formula is not finite")
    return number


def _binary(op: type[ast.operator], left: Compiled, right: Compiled) -> Compiled:
    apply = _BINARY[op]
    return lambda values, functions: apply(left(values, functions), right(values, functions))
