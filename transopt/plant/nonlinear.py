"""A moving coil with a displacement-dependent force factor and stiffness, and with friction.

With x the displacement of the moving part, v = dx/dt and i the coil's current,

    x'' = F / mu,   F = BL(x) i - K(x) x - c v - f(v),
    L di/dt = u - R i - BL(x) v   if a voltage u is the input,

in the notation of `transopt.plant.moving_coil`, the special case BL(x) = BL, K(x) = K, f = 0. The large-signal model
of a loudspeaker (Klippel, "Loudspeaker nonlinearities: causes, parameters, symptoms", J. Audio Eng. Soc. 54, 2006)
has such BL(x) and K(x); f is friction beyond the damping c, such as dry friction f0 tanh(v / v0).

The equations are written over the components of the state and over functions that the caller passes
(`transopt.base.arithmetic`), so the same code evaluates numbers, vectors over all instants and CasADi expressions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from pydantic import field_validator, model_validator

from transopt.base.arithmetic import NUMBERS, NUMPY, Formula, Functions
from transopt.base.errors import InputError
from transopt.base.section import Section, Words
from transopt.plant.state_space import StateSpace

VARIABLES = ("x", "v", "i")  # [m], [m/s], [A]
CONSTANTS = ("BL", "K", "C")  # of the linear model: [N/A], [N/m], [N s/m]
COMPLEX_STEP = 1e-40  # of a variable in its own unit: its square is negligible, so a derivative is exact to rounding
AGREEMENT = 1e-6  # relative tolerance between a formula at rest and the linear model's constant
PROBED_M_S = np.geomspace(1e-4, 1.0, 41)  # speeds at which friction is checked to oppose the motion
PROBED_PLACES = 21  # over the stroke
LEAST_N = 1e-9  # friction that counts as one


class Nonlinear(Section):
    """Formulas in place of constants: BL(x), K(x), and a friction force in addition to the damping.

    Each is arithmetic over x [m], v [m/s], i [A], the linear model's BL [N/A], K [N/m] and C [N s/m], and the
    functions abs, atan, cos, exp, log, sin, sqrt, tanh. At rest the first two must equal the linear model's values.

    Attributes
    ----------
    force_factor : BL as a function of x, in N/A.
    stiffness : K as a function of x, in N/m.
    friction : force that opposes the motion, in addition to the damping, in N.
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
    """The nonlinear plant dx/dt = f(x, u), with its linearisation at rest.

    Attributes
    ----------
    linear : linear model; states x, v and, for a voltage input and an inductance, i.
    moved_kg : mu, the reduced mass for the relative motion.
    accelerated_kg : mass whose acceleration is tracked.
    force_factor_N_A, stiffness_N_m, damping_N_s_m : constants of the linear model.
    R_ohm : None for a current input.
    L_H : 0 for a coil whose current follows without lag.
    force_factor, stiffness, friction : formulas; None for the linear model's constant, or for no friction.

    Raises
    ------
    InputError : a formula that contradicts the linear model at rest, or a friction in the direction of the motion.
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
        self.check_friction(0.0)

    def check_friction(self, stroke_m: float) -> None:
        """Refuse a friction that, somewhere within a stroke, acts without motion or in its direction."""
        if self.friction is None:
            return
        for x in np.unique([0.0, *np.linspace(-stroke_m, stroke_m, PROBED_PLACES)]).tolist():
            still = _at("friction", self.friction, 0.0, x)
            if not abs(still) <= LEAST_N:
                raise InputError(
                    f"model.nonlinear.friction: {still:.4g} N at x = {x:.4g} m without motion; it must be zero at "
                    "v = 0: take out what depends on x alone"
                )
            for v in np.concatenate([PROBED_M_S, -PROBED_M_S]).tolist():
                force = _at("friction", self.friction, v, x)
                if not force * np.sign(v) >= -LEAST_N:
                    raise InputError(
                        f"model.nonlinear.friction: {force:.4g} N at x = {x:.4g} m, v = {v:.4g} m/s pushes; it is "
                        "the force against the motion, within limits.stroke_m too: turn its sign there"
                    )

    @property
    def _formulas(self) -> tuple[Formula | None, ...]:
        return self.force_factor, self.stiffness, self.friction

    @property
    def follows_at_once(self) -> bool:
        """Whether the coil's current is no state but follows from voltage and velocity."""
        return self.R_ohm is not None and self.L_H == 0

    @property
    def friction_slope_N_s_m(self) -> float:
        """Derivative of the friction by the velocity at rest; 0 without friction."""
        if self.friction is None:
            return 0.0
        return float(np.imag(self.friction({"x": 0.0, "v": COMPLEX_STEP * 1j, "i": 0.0}, NUMPY))) / COMPLEX_STEP

    @property
    def kinked(self) -> bool:
        """Whether a formula has |x|, whose slope jumps."""
        return any(formula is not None and "abs" in formula.functions for formula in self._formulas)

    def _parts(self, states: Sequence[Any], u: Any, functions: Functions) -> tuple[Any, Any, Any]:
        """BL(x), the coil's current, and the force F."""
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
        """dx/dt minus the linear model's A x + B u; zero for the position."""
        A, B = self.linear.A, self.linear.B[:, 0]
        rates = self.rate(states, u, functions)
        linear = [_combined(A[j], states) + float(B[j]) * u for j in range(1, B.size)]
        return [0.0, *(rate - own for rate, own in zip(rates[1:], linear, strict=True))]

    def acceleration(self, states: Sequence[Any], u: Any, functions: Functions) -> Any:
        """The tracked acceleration [m/s^2]."""
        return self._parts(states, u, functions)[2] / self.accelerated_kg


def _combined(row: Sequence[float], states: Sequence[Any]) -> Any:
    return sum((float(by) * state for by, state in zip(row, states, strict=True) if by != 0), start=0.0)


def _at(key: str, formula: Formula, v: float, x: float = 0.0) -> float:
    """A formula's value at a velocity, a displacement and i = 0."""
    try:
        value = float(np.real(formula({"x": x, "v": v, "i": 0.0}, NUMBERS)))
    except (ArithmeticError, ValueError, TypeError):
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"model.nonlinear.{key}: has no value at x = {x:g}, v = {v:g} m/s: rewrite it")
    return value
