"""Designs for an actuator whose force factor, spring and friction are not constant, beside the linear designs.

    python -m pytest -m long -n 0 tests/campaigns/test_nonlinear_plant.py
        --campaign="[--plants force,spring,friction] [--rate-hz 10000] [--json FILE]"

The actuator is an LRA with its case; its force factor falls by 30 % at full stroke (`force`), its spring stiffens by
50 % there besides (`spring`), and it rubs with 0.04 N besides (`friction`). The targets take it
near full stroke. Every design is played on the nonlinear plant by DOP853. Printed are the tap error that the linear
design promises, the one it has when it is played, and that of the nonlinear design, with IPOPT's time and the gap
of its certificate. Exit code 1: a design is not proven, or its error is more than half of the linear design's.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

import pytest
import typer

from tests.benches.actuators import LRA
from tests.campaigns.harness import JsonFile, at_least, long_form, show, words_of, write_json
from transopt.base.errors import InputError
from transopt.design.solve import design_nonlinear
from transopt.problem.answer import Status
from transopt.scene.scene import Scene

FORCE = {"force_factor": "BL*(1 - 0.3*(x/0.6e-3)**2)"}
SPRING = {**FORCE, "stiffness": "K*(1 + 0.5*(x/0.6e-3)**2)"}
FRICTION = {**SPRING, "friction": "0.04*tanh(v/5e-3)"}
PLANTS = {"force": FORCE, "spring": SPRING, "friction": FRICTION}
Target = dict[str, str | float]
CLICK: Target = {"name": "click 250 Hz", "shape": "burst", "frequency_Hz": 250, "cycles": 3, "peak_m_s2": 30.0}
TARGETS: tuple[Target, ...] = (
    {"name": "burst 150 Hz", "shape": "burst", "frequency_Hz": 150, "cycles": 6, "peak_m_s2": 14.5},
    CLICK,
    {"name": "thud 80 Hz", "shape": "burst", "frequency_Hz": 80, "cycles": 2, "peak_m_s2": 3.5},
)
WORST = 0.5  # of the linear design's error
HEAD = ("plant", "target", "promised %", "linear %", "nonlinear %", "of linear", "solve s", "iterations", "gap")


@dataclass(frozen=True)
class Found:
    """One target on one plant; tap errors as shares, not per cent."""

    plant: str
    target: str
    promised: float
    linear: float
    nonlinear: float
    solve_s: float
    iterations: int
    substeps: int
    off_replay: float
    gap: float
    status: str

    @property
    def halved(self) -> bool:
        """Whether it is proven, and at most half as wrong as the linear design."""
        return self.status == Status.STATIONARY.value and self.nonlinear <= WORST * self.linear

    def row(self) -> list[str]:
        """Below `HEAD`."""
        shares = (f"{1e2 * share:.2f}" for share in (self.promised, self.linear, self.nonlinear))
        of_linear = f"{self.nonlinear / self.linear:.2f}"
        solver = (f"{self.solve_s:.1f}", str(self.iterations), f"{self.gap:.0e}")
        return [self.plant, self.target, *shares, of_linear, *solver]


def scene(plant: str, rate_Hz: float = 10e3, targets: Sequence[Target] = TARGETS, window_s: float = 60e-3) -> Scene:
    """The actuator with one of the `PLANTS`."""
    return Scene.model_validate(
        {
            "name": plant,
            "amplifier": "ideal",
            "hand_over_samples": 1,
            "time": {"dt_s": 1 / rate_Hz, "stages": round(window_s * rate_Hz), "lead_s": 0.0},
            "targets": list(targets),
            "model": {**LRA, "nonlinear": PLANTS[plant]},
            "limits": {"voltage_V": 20.0, "stroke_m": 6e-4},
        }
    )


def measured(scene: Scene) -> list[Found]:
    """Both designs of every target."""
    return [
        Found(
            plant=scene.name,
            target=entry.target,
            promised=entry.linear_promised,
            linear=entry.linear_tap_error,
            nonlinear=entry.figures.tap_error,
            solve_s=entry.solution.solve_time_s,
            iterations=entry.solution.iterations,
            substeps=0 if entry.designed.nonlinear is None else entry.designed.nonlinear.stage.substeps,
            off_replay=entry.off_replay,
            gap=entry.certificate.relative_gap,
            status="; ".join([entry.status.value, *entry.shortfalls]),
        )
        for entry in design_nonlinear(scene).all_entries()
    ]


def main(
    plants: Annotated[str, typer.Option(help=f"some of {','.join(PLANTS)}")] = ",".join(PLANTS),
    rate_hz: Annotated[float, at_least(2e3, "servo rate")] = 10e3,
    json: JsonFile = None,
) -> int:
    found = [each for plant in words_of(plants, PLANTS) for each in measured(scene(plant, rate_hz))]
    show(HEAD, [each.row() for each in found])
    off, substeps = max(each.off_replay for each in found), max(each.substeps for each in found)
    print(f"the stages' y'' is off the replay's by at most {off:.0e} of its peak, with up to {substeps} substeps")
    for each in found:
        if not each.halved:
            print(
                f"{each.plant}, {each.target}: {each.status}, {each.nonlinear / each.linear:.2f} of the linear error"
            )
    write_json([asdict(each) for each in found], json)
    return 0 if off <= 1e-6 and all(each.halved for each in found) else 1


test_long_form = long_form(main)


def test_the_nonlinear_design_is_at_most_half_as_wrong_as_the_linear_one() -> None:
    (found,) = measured(scene("force", 5e3, [CLICK], 20e-3))
    assert found.halved
    assert found.nonlinear <= 0.5 * found.linear
    assert found.linear >= 0.03  # there is something to gain
    assert found.off_replay <= 1e-6
    assert found.gap <= 1e-6


def test_another_plant_is_refused() -> None:
    with pytest.raises(InputError, match="spruce: not one of force, spring, friction"):
        main(plants="spruce")
