"""The figure of a build's entries, drawn like a library's."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from transopt.base.axes import Axes
from transopt.base.signals import FloatArray
from transopt.design.entry import Entry
from transopt.library.figures import Transients, transients_figure
from transopt.problem.answer import Status


def entries_figure(entries: Sequence[Sequence[Entry]]) -> Figure:
    """Waveforms of entries (nv, ng), speeds outermost; of a refused one, which has no waveform, the reference."""
    first = entries[0][0].problem
    (bound,) = first.limits.input.row_names

    def drawn(entry: Entry) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N + M,) acceleration and input, and (N,) the multiplier of the input's limit."""
        N, M = first.grid.stages, first.grid.after_stages
        if entry.status is not Status.OPTIMAL:
            nothing = np.full(N + M, np.nan)
            return nothing, nothing, np.zeros(N)
        multipliers = entry.solution.multipliers
        pushed = np.maximum(multipliers.lower(bound), multipliers.upper(bound))
        acceleration, current = entry.problem.stage.rollout(entry.problem.continued(entry.solution.command))
        return acceleration, current, pushed

    cells = [[drawn(entry) for entry in row] for row in entries]
    acceleration, current, multiplier = (np.array([[cell[j] for cell in row] for row in cells]) for j in range(3))
    return transients_figure(
        Transients(
            grid=first.grid,
            axes=Axes(
                tuple(row[0].speed_m_s for row in entries),
                tuple(entry.grip_N for entry in entries[0]),
                tuple(row[0].target for row in entries if row[0].target),
            ),
            driven_by=first.driven_by,
            reference_m_s2=np.stack([row[0].problem.target.continued_m_s2 for row in entries]),
            acceleration_m_s2=acceleration,
            plant_input=current,
            limit=first.limits.input_limit,
            input_multiplier=multiplier,
            hand_over_samples=first.hand_over_samples,
        )
    )
