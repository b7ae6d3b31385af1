"""A moving coil whose force factor and stiffness change with the displacement, and that rubs.

With x the displacement of the moving part, v = dx/dt and i the coil's current,

    x'' = F / mu,   F = BL(x) i - K(x) x - c v - f(v),
    L di/dt = u - R i - BL(x) v   where a voltage u is the input,

in the words of `transopt.plant.moving_coil`, which is the same with BL(x) = BL, K(x) = K, f = 0. The large-signal
model of a loudspeaker (Klippel, "Loudspeaker nonlinearities: causes, parameters, symptoms", J. Audio Eng. Soc. 54,
2006) has BL(x) and K(x) so; f is what the damping c does not tell, such as dry friction, f0 tanh(v / v0).

Everything is written over states as a sequence of components and over the functions that are handed in
(`transopt.base.arithmetic`): the same lines are a number, a vector over all instants, or a CasADi expression.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from pydantic import field_validator, model_validator

from transopt.base.arithmetic import NUMBERS, Formula, Functions
from transopt.base.errors import InputError
from transopt.base.section import Section, Words
from transopt.plant.state_space import StateSpace

VARIABLES = ("x", "v", "i")  # [m], [m/s], [A]
CONSTANTS = ("BL", "K", "C")  # of the linear model: [N/A], [N/m], [N s/m]
AGREEMENT = 1e-6  # relative, within which a formula at rest must be what the linear model has
PROBED_M_S = (1e-3, 1e-2, 1e-1, 1.0)  # speeds at which friction must not push


class Nonlinear(Section):
    """Formulas in place of constants: BL(x), K(x), and a friction beside the damping.

    Each is arithmetic over x [m], v [m/s], i [A], the linear model's BL [N/A], K [N/m] and C [N s/m], and the
    functions abs, atan, cos, exp, log, sin, sqrt, tanh. At rest the first two must be what the linear model has.

    Attributes
    ----------
    force_factor : BL over x, in N/A.
    stiffness : K over x, in N/m.
    friction : force against the motion beside the damping, in N.
    """

    force_factor: Words | None = None
    stiffness: Words | None = None
    friction: Words | None = None

    @field_validator("*")
    @classmethod
    def _a_formula(cls, text: str | None) -> str | None:
        if text is not None:
            try:
                Formula(text, VARIABLES, tuple((name, 1.0) for name in CONSTANTS))
            except InputError as error:
                raise ValueError(str(error)) from None
        return text

    @model_validator(mode="after")
    def _of_something(self) -> Self:
        if (self.force_factor, self.stiffness, self.friction) == (None, None, None):
            raise ValueError("give force_factor, stiffness or friction, or leave the table out")
        return self


@dataclass(frozen=True)
class NonlinearCoil:
    """The plant dx/dt = f(x, u) beside the linear one that it is at rest.

    Attributes
    ----------
    linear : states x, v and, where a voltage drives a coil with an inductance, i.
    moved_kg : mu, what F accelerates against what holds it.
    accelerated_kg : what the acceleration that matters is of.
    force_factor_N_A, stiffness_N_m, damping_N_s_m : of the linear model.
    R_ohm : None where a current is the input. L_H : 0 for a coil whose current follows at once.
    force_factor, stiffness, friction : formulas; None where the linear model's constant holds, or nothing rubs.

    Raises
    ------
    InputError : a formula that is not what the linear model has at rest, or a friction that pushes.
    """

    linear: StateSpace
    moved_kg: float
    accelerated_kg: float
    force_factor_N_A: float
    stiffness_N_m: float
    damping_N_s_m: float
    R_ohm: float | None
    L_H: float
    force_factor: Formula | None
    stiffness: Formula | None
    friction: Formula | None

    def __post_init__(self) -> None:
        if self.follows_at_once and any(f is not None and "i" in f.names for f in self._formulas):
            raise InputError("model.nonlinear: i in a formula needs L_H > 0, or a current as the input")
        for key, formula, wanted, unit in (
            ("force_factor", self.force_factor, self.force_factor_N_A, "N/A"),
            ("stiffness", self.stiffness, self.stiffness_N_m, "N/m"),
            ("friction", self.friction, 0.0, "N"),
        ):
            if formula is None:
                continue
            found = _at(key, formula, 0.0)
            if not abs(found - wanted) <= AGREEMENT * max(abs(wanted), 1e-3):
                raise InputError(
                    f"model.nonlinear.{key}: {found:.6g} {unit} at rest, the linear model has {wanted:.6g} {unit}: "
                    "make them agree"
                )
        if self.friction is not None:
            for speed in PROBED_M_S:
                for v in (speed, -speed):
                    force = _at("friction", self.friction, v)
                    if not force * v >= 0:
                        raise InputError(
                            f"model.nonlinear.friction: {force:.4g} N at {v:g} m/s pushes; it is the force against "
                            "the motion: turn its sign"
                        )

    @property
    def _formulas(self) -> tuple[Formula | None, ...]:
        return self.force_factor, self.stiffness, self.friction

    @property
    def follows_at_once(self) -> bool:
        """Whether the coil's current is no state but follows from voltage and velocity."""
        return self.R_ohm is not None and self.L_H == 0

    def _parts(self, states: Sequence[Any], u: Any, functions: Functions) -> tuple[Any, Any, Any]:
        """BL(x), the current, and F."""
        x, v = states[0], states[1]
        current: Any = 0.0
        if self.R_ohm is None:
            current = u
        elif self.L_H > 0:
            current = states[2]
        values = {"x": x, "v": v, "i": current}
        BL = self.force_factor_N_A if self.force_factor is None else self.force_factor(values, functions)
        if self.follows_at_once:
            current = (u - BL * v) / self.R_ohm
        K = self.stiffness_N_m if self.stiffness is None else self.stiffness(values, functions)
        force = BL * current - K * x - self.damping_N_s_m * v
        if self.friction is not None:
            force = force - self.friction(values, functions)
        return BL, current, force

    def rate(self, states: Sequence[Any], u: Any, functions: Functions) -> list[Any]:
        """dx/dt, component by component, at the states and the input u."""
        BL, current, force = self._parts(states, u, functions)
        rates = [states[1], force / self.moved_kg]
        if self.R_ohm is not None and self.L_H > 0:
            rates.append((u - self.R_ohm * current - BL * states[1]) / self.L_H)
        return rates

    def remainder(self, states: Sequence[Any], u: Any, functions: Functions) -> list[Any]:
        """dx/dt less what the linear model makes of it, A x + B u; zero for the position."""
        A, B = self.linear.A, self.linear.B[:, 0]
        rates = self.rate(states, u, functions)
        linear = [_combined(A[j], states) + float(B[j]) * u for j in range(1, B.size)]
        return [0.0, *(rate - own for rate, own in zip(rates[1:], linear, strict=True))]

    def acceleration(self, states: Sequence[Any], u: Any, functions: Functions) -> Any:
        """The acceleration that matters [m/s^2]."""
        return self._parts(states, u, functions)[2] / self.accelerated_kg


def _combined(row: Sequence[float], states: Sequence[Any]) -> Any:
    return sum((float(by) * state for by, state in zip(row, states, strict=True) if by != 0), start=0.0)


def _at(key: str, formula: Formula, v: float) -> float:
    """A formula's value at x = 0, i = 0 and a velocity."""
    try:
        found = float(np.real(formula({"x": 0.0, "v": v, "i": 0.0}, NUMBERS)))
    except (ArithmeticError, ValueError, TypeError):
        found = np.nan
    if not np.isfinite(found):
        raise InputError(f"model.nonlinear.{key}: has no value at x = 0, v = {v:g} m/s: rewrite it")
    return found
