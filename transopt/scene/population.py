"""A population of hands: the distribution of a hand's parameters over the users of a device, as a file.

The logarithms of the five parameters at two grips are normally distributed. Between the two grips a hand is linear in
grip, like every hand. A population is the prior of a calibration (`transopt.identify.calibration`) and the spread
of a robust design (`robust.population`); tests of both draw hands from it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from transopt.base.errors import InputError
from transopt.base.section import Positive, Section, Words
from transopt.base.signals import FloatArray
from transopt.base.toml import read_section
from transopt.plant.hand import HandSection, LinearParameter

PARAMETERS = tuple(HandSection.model_fields)
MAX_DRAWS = 50  # for each hand that is wanted, until it is passive at all grips
WIDEST = 1.0  # largest standard deviation of a logarithm: then a tenth of all hands is off by a factor of five

Ends = Annotated[list[Positive], Field(min_length=2, max_length=2)]
Deviation = Annotated[float, Field(ge=0, le=WIDEST)]


class Spread(Section):
    """One parameter over the population.

    Attributes
    ----------
    median : medians at the two grips of the population [the parameter's own SI unit].
    spread : standard deviation of the natural logarithm from hand to hand.
    tilt : standard deviation of the logarithm of the value at the second grip over that at the first.
    source : source of the numbers.
    """

    median: Ends
    spread: Deviation
    tilt: Deviation = 0.0
    source: Words


class Correlation(Section):
    """Correlation of the logarithms of two parameters, the same at both grips."""

    of: tuple[str, str]
    value: Annotated[float, Field(gt=-1, lt=1)]
    source: Words


class Population(Section):
    """The content of a population file.

    Attributes
    ----------
    grips_N : the two grips at which the parameters are stated.
    """

    description: Words = ""
    grips_N: Ends
    mass_kg: Spread
    skin_stiffness_N_m: Spread
    skin_damping_N_s_m: Spread
    arm_stiffness_N_m: Spread
    arm_damping_N_s_m: Spread
    correlations: Annotated[list[Correlation], Field(max_length=10)] = Field(default_factory=list)

    @model_validator(mode="after")
    def _possible_spread(self) -> Self:
        if not self.grips_N[0] < self.grips_N[1]:
            raise ValueError("grips_N: must be two grips, the light one first")
        for each in self.correlations:
            unknown = next((name for name in each.of if name not in PARAMETERS), None)
            if unknown is not None or each.of[0] == each.of[1]:
                raise ValueError(f"correlations: of = {list(each.of)}: name two of {', '.join(PARAMETERS)}")
        if np.linalg.eigvalsh(self._correlation())[0] < 0:
            raise ValueError("correlations: contradict each other (a negative eigenvalue): lower the largest of them")
        return self

    @property
    def _spreads(self) -> list[Spread]:
        return [getattr(self, name) for name in PARAMETERS]

    def _correlation(self) -> FloatArray:
        found = np.eye(len(PARAMETERS))
        for each in self.correlations:
            j, k = (PARAMETERS.index(name) for name in each.of)
            found[j, k] = found[k, j] = each.value
        return found

    def mean(self) -> FloatArray:
        """(10,) logarithms of the median hand: `PARAMETERS` at the first grip, then at the second."""
        return np.log([spread.median[end] for end in range(2) for spread in self._spreads])

    def covariance(self) -> FloatArray:
        """(10, 10) covariance of these logarithms."""
        spread = np.array([each.spread for each in self._spreads])
        tilt = np.array([each.tilt for each in self._spreads])
        together = np.outer(spread, spread) * self._correlation()
        return np.asarray(np.kron(np.ones((2, 2)), together) + np.kron([[1, -1], [-1, 1]], np.diag(tilt**2) / 4))

    def factor(self) -> FloatArray:
        """(10, 10) L with L L' = covariance; columns of directions without spread are zero."""
        size, along = np.linalg.eigh(self.covariance())
        return np.asarray(along * np.sqrt(np.maximum(size, 0.0)))

    def hand(self, logarithms: FloatArray) -> HandSection:
        """The hand with these logarithms (10,), ordered as `mean`."""
        light, firm = np.exp(logarithms).reshape(2, -1)
        slope = (firm - light) / (self.grips_N[1] - self.grips_N[0])
        values = zip(PARAMETERS, light - slope * self.grips_N[0], slope, strict=True)
        lines = {name: LinearParameter(constant=float(c), per_newton=float(s)) for name, c, s in values}
        return HandSection(**lines)

    def drawn(self, count: int, seed: int, grips_N: Sequence[float], wider: float = 1.0) -> list[HandSection]:
        """Random hands of the population that are passive at these grips, in pairs of opposite deviations.

        Parameters
        ----------
        seed : the same seed draws the same hands.
        wider : factor on all deviations.

        Raises
        ------
        InputError : too few draws are passive at these grips.
        """
        random, factor, found = np.random.default_rng(seed), wider * self.factor(), list[HandSection]()
        for _ in range(MAX_DRAWS * count):
            off = factor @ random.standard_normal(factor.shape[1])
            found += [hand for sign in (1.0, -1.0) if _passive(hand := self.hand(self.mean() + sign * off), grips_N)]
            if len(found) >= count:
                return found[:count]
        grips = ", ".join(f"{grip:g}" for grip in grips_N)
        raise InputError(
            f"population: its hands are stated at {self.grips_N[0]:g} and {self.grips_N[1]:g} N and hardly any is "
            f"passive at {grips} N: keep the grips nearer to these two, or the spreads smaller"
        )


def _passive(hand: HandSection, grips_N: Sequence[float]) -> bool:
    return all(hand.line(name).at(grip) > 0 for name in PARAMETERS for grip in grips_N)


def load_population(path: Path) -> Population:
    """Read and check a population file.

    Raises
    ------
    InputError : one line: file, key, what is wrong.
    """
    return read_section(path, Population, "a population is a TOML file, as the built-in stylus_grip.toml")[0]
