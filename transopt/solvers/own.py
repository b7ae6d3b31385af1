"""User-defined limits: a CasADi expression of outputs, states, command and stage, analysed when it is read.

    # my_limits.py
    import transopt as to

    LIMITS = [to.own_limit("joint_force", "N", lambda s: 6e4 * s.state(1), lower=-12.0, upper=12.0)]

A scene names the file, `limits.own = ["my_limits.py"]`, and stores the limits read from it. A user of the scene, or
of a library solved from it, needs neither the file nor, if all limits are linear, CasADi.
"""

import keyword
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.discretise import AFTER
from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT
from transopt.problem.limits import KINDS
from transopt.problem.limits.row import COMMAND, HELD, VELOCITY

CURVED = 1e-12  # curvatures below this share of the largest one are rounding
TAKEN = {row for kind in KINDS for row in kind.row_names} | {"end"}
OF_A_DEVICE = re.compile(r".*_device_\d+")  # names of the rows of further devices (`limit.device_row`)


class StageSymbols:
    """What an expression may be made of, at the switching instant tau_k of stage k; each is a CasADi symbol.

    Attributes
    ----------
    stage : k, from 0.
    """

    def __init__(self) -> None:
        self.stage = ca.SX.sym("stage")
        self.used: dict[str, ca.SX] = {}

    def _output(self, name: str) -> ca.SX:
        return self.used.setdefault(name, ca.SX.sym(f"output_{len(self.used)}"))

    @property
    def current(self) -> ca.SX:
        """i(tau_k) [A]: what drives a motor, or what a voltage makes flow in a coil."""
        return self._output(CURRENT_INPUT.name)

    @property
    def voltage(self) -> ca.SX:
        """u(tau_k) [V], of an actuator that a voltage drives."""
        return self._output(VOLTAGE_INPUT.name)

    @property
    def command(self) -> ca.SX:
        """c_k, felt from tau_k on [A or V]."""
        return self._output(COMMAND)

    @property
    def previous_command(self) -> ca.SX:
        """c_(k-1), felt until tau_k [A or V]."""
        return self._output(HELD)

    @property
    def position(self) -> ca.SX:
        """z of the motor mass, the nominal motion included [m]."""
        return self._output("position")

    @property
    def velocity(self) -> ca.SX:
        """dz/dt of the motor mass, the nominal motion included [m/s]."""
        return self._output(VELOCITY)

    def output(self, name: str) -> ca.SX:
        """An output that the device names, such as "stylus position"; of a mass with the nominal motion included."""
        return self._output(name)

    def state(self, number: int) -> ca.SX:
        """State `number`, from 1, of the plant: of a chain first its elongations, then their rates."""
        return self._output(f"state {number}")

    def state_after(self, number: int) -> ca.SX:
        """State one period later, which c_k has moved by then."""
        return self._output(f"state {number}{AFTER}")


@dataclass(frozen=True)
class StatedLimit:
    """A user-defined limit, analysed: its outputs, linearity and convexity.

    Attributes
    ----------
    name, unit : name of the limit, and unit of its bounds.
    outputs : outputs on which the expression depends, in the order of its arguments.
    lower, upper : bounds; None for no bound.
    coefficients : derivatives by the outputs if the expression is linear; otherwise None.
    expression : Function (outputs (m,), k) -> value.
    convex : whether a lower and whether an upper bound leaves a convex set, as `_curvature` proves it.
    """

    name: str
    unit: str
    outputs: tuple[str, ...]
    lower: float | None
    upper: float | None
    coefficients: tuple[float, ...] | None
    expression: ca.Function
    convex: tuple[bool, bool]

    def table(self, stages: int) -> dict[str, Any]:
        """The limit as numbers and text, as a scene and a library store it."""
        offsets = None
        if self.coefficients is not None:
            nothing = np.zeros((len(self.outputs), stages))
            found = np.asarray(self.expression.map(stages)(nothing, np.arange(stages)[None])).ravel()
            offsets = [float(found[0])] if np.ptp(found) == 0 else found.tolist()
        return {
            "name": self.name,
            "unit": self.unit,
            "outputs": list(self.outputs),
            "lower": self.lower,
            "upper": self.upper,
            "coefficients": None if self.coefficients is None else list(self.coefficients),
            "offsets": offsets,
            "function": None if self.coefficients is not None else str(self.expression.serialize()),
        }


def own_limit(
    name: str,
    unit: str,
    expression: Callable[[StageSymbols], Any],
    *,
    lower: float | None = None,
    upper: float | None = None,
) -> StatedLimit:
    """State a limit lower <= expression <= upper at every switching instant.

    Parameters
    ----------
    name : of the limit, where it binds and in the library's arrays: letters, digits and underscores.
    unit : of the expression.
    expression : from a `StageSymbols` to a CasADi expression of its symbols.
    lower, upper : bounds in that unit, one at least.

    Raises
    ------
    InputError : a name that cannot be one, no bound, bounds that cross, or no scalar expression.
    """
    if not name.isidentifier() or keyword.iskeyword(name) or name in TAKEN or OF_A_DEVICE.fullmatch(name):
        raise InputError(f"limit {name!r}: the name must be a word of letters, digits and _ that no other limit has")
    if lower is None and upper is None:
        raise InputError(f"limit {name}: state lower, upper or both")
    if not (-np.inf if lower is None else lower) < (np.inf if upper is None else upper):
        raise InputError(f"limit {name}: lower = {lower} must be below upper = {upper}")
    symbols = StageSymbols()
    value = ca.SX(expression(symbols))
    if value.shape != (1, 1) or not symbols.used:
        raise InputError(f"limit {name}: the expression must be one number that depends on an output")
    u, k = ca.vertcat(*symbols.used.values()), symbols.stage
    stray = [str(each) for each in ca.symvar(value) if not ca.depends_on(ca.vertcat(u, k), each)]
    if stray:
        raise InputError(f"limit {name}: the expression has a symbol of its own, {stray[0]}")
    slope, law_of_it = ca.jacobian(value, u), ca.Function(name, [u, k], [value], ["outputs", "stage"], ["value"])
    for j, output in enumerate(symbols.used):
        if slope[j].is_zero() and ca.depends_on(value, u[j]):
            raise InputError(
                f"limit {name}: it depends on {output} only in steps (floor, sign, a comparison), which no "
                "derivative sees: state a smooth function instead, such as casadi.tanh"
            )
    coefficients = None
    if _walked(law_of_it).degree <= 1 and not ca.depends_on(slope, ca.vertcat(u, k)):
        coefficients = tuple(float(each) for each in np.asarray(ca.evalf(ca.densify(slope))).ravel())
    return StatedLimit(
        name=name,
        unit=unit,
        outputs=tuple(symbols.used),
        lower=None if lower is None else float(lower),
        upper=None if upper is None else float(upper),
        coefficients=coefficients,
        expression=law_of_it,
        convex=_curvature(law_of_it),
    )


class _Part(NamedTuple):
    """A part of an expression as a function of the outputs.

    Attributes
    ----------
    degree : that of the polynomial that it is; infinite if it is none, or not known to be one.
    convex, concave : whether it is proven to be.
    number : its value if it is a number; None if it depends on anything.
    """

    degree: float
    convex: bool
    concave: bool
    number: float | None = None

    @property
    def negated(self) -> "_Part":
        return _Part(self.degree, self.concave, self.convex)

    def times(self, number: float | None) -> "_Part":
        """This part times a number, or times an unknown number that may depend on the stage."""
        if self.degree <= 1:
            return _Part(self.degree, convex=True, concave=True)
        if number is None:
            return _Part(self.degree, convex=False, concave=False)
        return self if number >= 0 else self.negated


UNKNOWN = _Part(np.inf, convex=False, concave=False)


def _walked(expression: ca.Function) -> _Part:
    """Degree and curvature of an expression of outputs and stage by the operations that it is made of.

    Derivatives do not tell: CasADi takes the second derivative of |x| and all derivatives of floor(x) as zero.
    """
    if not expression.is_a("SXFunction"):
        return UNKNOWN
    parts = [UNKNOWN] * expression.sz_w()
    for i in range(expression.n_instructions()):
        operation, given = expression.instruction_id(i), expression.instruction_input(i)
        if operation == ca.OP_OUTPUT:
            return parts[given[0]]
        if operation == ca.OP_CONST:
            found = _Part(0, convex=True, concave=True, number=float(expression.instruction_constant(i)))
        elif operation == ca.OP_INPUT:
            found = _Part(1 - given[0], convex=True, concave=True)  # the outputs, or the stage
        else:
            found = _combined(operation, [parts[j] for j in given])
        parts[expression.instruction_output(i)[0]] = found
    return UNKNOWN


def _combined(operation: int, of: list[_Part]) -> _Part:
    """What an operation makes of one or two parts."""
    first, last = of[0], of[-1]
    if all(part.degree == 0 for part in of):
        return _Part(0, convex=True, concave=True)
    if operation == ca.OP_SUB:
        operation, last = ca.OP_ADD, last.negated
    if operation == ca.OP_ADD:
        return _Part(max(first.degree, last.degree), first.convex and last.convex, first.concave and last.concave)
    if operation == ca.OP_NEG:
        return first.negated
    if operation == ca.OP_TWICE:
        return first
    if operation == ca.OP_IF_ELSE_ZERO and first.degree == 0:
        return last  # a share of it, 0 or 1 by the stage
    if operation == ca.OP_DIV and last.degree == 0:
        return first.times(last.number)
    if operation == ca.OP_MUL:
        if first.degree == 0 or last.degree == 0:
            return last.times(first.number) if first.degree == 0 else first.times(last.number)
        return _Part(first.degree + last.degree, convex=False, concave=False)
    if operation == ca.OP_SQ:
        return _Part(2 * first.degree, convex=first.degree <= 1, concave=False)
    if operation == ca.OP_FABS:
        return _Part(np.inf, convex=first.degree <= 1, concave=False)
    if operation == ca.OP_FMAX:
        return _Part(np.inf, convex=first.convex and last.convex, concave=False)
    if operation == ca.OP_FMIN:
        return _Part(np.inf, convex=False, concave=first.concave and last.concave)
    return UNKNOWN


def _curvature(expression: ca.Function) -> tuple[bool, bool]:
    """Whether an expression is proven to be concave, and whether convex: the sets that a lower, an upper bound leave.

    A quadratic form is judged by the eigenvalues of its second derivatives, anything else by its operations.
    """
    part = _walked(expression)
    if part.degree > 2:
        return part.concave, part.convex
    u, k = ca.SX.sym("u", expression.size1_in(0)), ca.SX.sym("k")
    curvature = ca.hessian(expression(u, k), u)[0]
    if ca.depends_on(curvature, ca.vertcat(u, k)):
        return part.concave, part.convex
    values = np.linalg.eigvalsh(np.asarray(ca.evalf(ca.densify(curvature))))
    least = CURVED * float(np.abs(values).max(initial=0.0))
    return bool(values.max(initial=0.0) <= least), bool(values.min(initial=0.0) >= -least)


class CasadiLaw:
    """A nonlinear expression, evaluated from its stored text."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._value = ca.Function.deserialize(text)
        m = self._value.size1_in(0)
        u, k = ca.SX.sym("u", m), ca.SX.sym("k")
        self._slopes = ca.Function("slopes", [u, k], [ca.jacobian(self._value(u, k), u).T])

    @cached_property
    def convex(self) -> tuple[bool, bool]:
        """Whether a lower and whether an upper bound on it leaves a convex set."""
        return _curvature(self._value)

    def __reduce__(self) -> tuple[Any, ...]:
        return law, (self.text,)

    def value(self, outputs: FloatArray) -> FloatArray:
        """(N,) values of the expression at outputs (m, N)."""
        N = outputs.shape[1]
        return np.asarray(self._value.map(N)(outputs, np.arange(N)[None])).ravel()

    def slopes(self, outputs: FloatArray) -> FloatArray:
        """(m, N) derivatives of the expression by the outputs, at outputs (m, N)."""
        N = outputs.shape[1]
        return np.asarray(self._slopes.map(N)(outputs, np.arange(N)[None]))


@lru_cache(maxsize=64)
def law(text: str) -> CasadiLaw:
    """Restore the expression stored under `function` in a limit's table."""
    return CasadiLaw(text)
