"""The hand that holds the stylus: skin, hand mass and arm, each parameter linear in the grip force."""

from dataclasses import dataclass

from transopt.base.section import Finite, Section
from transopt.plant.chain import Link


@dataclass(frozen=True)
class LinearInGrip:
    """A parameter of the hand, `constant + per_newton * grip`, in the parameter's own SI unit."""

    constant: float
    per_newton: float

    def at(self, grip_N: float) -> float:
        """Value of the parameter at a grip force."""
        return self.constant + self.per_newton * grip_N


class LinearParameter(Section):
    """A parameter of the hand, linear in grip force.

    Attributes
    ----------
    constant : value at a grip of zero.
    per_newton : increase per newton of grip.
    """

    constant: Finite
    per_newton: Finite = 0.0

    def linear(self) -> LinearInGrip:
        """The parameter as the models use it."""
        return LinearInGrip(self.constant, self.per_newton)


Parameter = LinearParameter | Finite


class HandSection(Section):
    """Skin and arm as functions of grip: a number, or {constant, per_newton}.

    Attributes
    ----------
    mass_kg : mass of the hand behind the skin.
    skin_stiffness_N_m : spring between stylus and hand.
    skin_damping_N_s_m : damper between stylus and hand.
    arm_stiffness_N_m : spring that holds the hand.
    arm_damping_N_s_m : damper that holds the hand.
    """

    mass_kg: Parameter
    skin_stiffness_N_m: Parameter
    skin_damping_N_s_m: Parameter
    arm_stiffness_N_m: Parameter
    arm_damping_N_s_m: Parameter

    def line(self, name: str) -> LinearInGrip:
        """One of the parameters over grip."""
        value: LinearParameter | float = getattr(self, name)
        return value.linear() if isinstance(value, LinearParameter) else LinearInGrip(value, 0.0)

    def skin(self, grip_N: float) -> Link:
        """Spring and damper of the skin, between stylus and hand mass."""
        return Link(self.line("skin_stiffness_N_m").at(grip_N), self.line("skin_damping_N_s_m").at(grip_N))

    def arm(self, grip_N: float) -> Link:
        """Spring and damper of the arm, between hand mass and intended motion."""
        return Link(self.line("arm_stiffness_N_m").at(grip_N), self.line("arm_damping_N_s_m").at(grip_N))


def held(
    masses_kg: list[float], links: list[Link], hand: HandSection, grip_N: float
) -> tuple[list[float], list[Link]]:
    """The chain extended by the hand; unchanged, with a free end, at grip 0."""
    if grip_N == 0:
        return masses_kg, links
    return [*masses_kg, hand.line("mass_kg").at(grip_N)], [*links, hand.skin(grip_N), hand.arm(grip_N)]
