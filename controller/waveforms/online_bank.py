"""A bank that solves each tap (`transopt.library.online`) where a table would blend.

In a simulation no virtual time passes during the solve. In real time it takes milliseconds, which the end of an
approach does not leave: it serves between taps, or on a host that predicts the contact.
"""

from dataclasses import dataclass, fields

import numpy as np

from controller.waveforms.bank import Bank, Play
from controller.waveforms.prediction import scene_of
from transopt.library.library import Library
from transopt.library.online import Online
from transopt.problem.warm_coil import currents, norms


@dataclass(frozen=True, kw_only=True)
class FreshBank(Bank):
    """A bank with a solver; the blend of the table is played if there is no certified answer."""

    library: Library
    solver: Online

    def at(
        self, speed_m_s: float, grip_N: float, winding_C: float | None = None, housing_C: float | None = None
    ) -> Play:
        """The optimum for a contact and a start temperature, from the node's problem posed there."""
        blend = super().at(speed_m_s, grip_N)
        if blend.silent:
            return blend
        tap = self.solver.solve(speed_m_s, grip_N, winding_C, housing_C)
        if not tap.solved:
            return blend
        amplifier, dt = self.library.amplifier(), self.library.dt_s
        transient = tap.wave.transient_command
        played, pushed = norms(
            currents(np.stack([transient, tap.wave.command - transient]), amplifier, dt), amplifier, dt
        )
        return Play(
            samples_A=transient.tolist(),
            speed_m_s=tap.wave.speed_m_s,
            grip_N=tap.wave.grip_N,
            out_of_grid=blend.out_of_grid,
            silent=False,
            transient_A=float(played),
            feedback_A=float(pushed),
        )


def fresh(library: Library, table: Bank) -> FreshBank:
    """A bank that solves for this library; `table` is its table of the method `online`.

    Raises
    ------
    InputError : the solver's extension is not built.
    """
    scene = scene_of(library)
    solver = Online(
        library, scene.plant, lambda grip: tuple(scene.plant(each) for each in scene.spread_grips_N(grip))
    )
    return FreshBank(
        **{field.name: getattr(table, field.name) for field in fields(Bank)}, library=library, solver=solver
    )
