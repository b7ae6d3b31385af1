"""The references in a library file, to solve its scene again without the recordings."""

import numpy as np

from transopt.library.library import Library
from transopt.references.reference import Reference
from transopt.references.references import References


def references_of_library(library: Library) -> References:
    """The references that a library was designed for, read from its file instead of the recordings."""
    rows, (nv, ng) = library.axes.rows, library.command.shape[:2]
    return References(
        tuple(_reference(library, iv, ig) for iv in range(nv) for ig in range(1 if rows[iv][1] else ng))
    )


def _reference(library: Library, iv: int, ig: int) -> Reference:
    """The reference of one entry."""
    wanted = library.wanted_of(iv, ig)
    speed, name = library.axes.rows[iv]
    spread = library.meta["repeatability"][iv][ig]
    return Reference(
        speed_m_s=speed,
        grip_N=float(library.grips_N[ig]),
        recorded_m_s2=library.recorded_m_s2[iv, ig],
        recorded_before_m_s2=library.recorded_before_m_s2[iv, ig],
        recorded_after_m_s2=library.recorded_after_m_s2[iv, ig],
        free_m_s2=library.free_m_s2[iv, ig],
        free_before_m_s2=library.free_before_m_s2[iv, ig],
        free_after_m_s2=library.free_after_m_s2[iv, ig],
        nominal_position_m=wanted.nominal_position_m,
        nominal_velocity_m_s=wanted.nominal_velocity_m_s,
        nominal_position_at_ticks_m=wanted.nominal_position_at_ticks_m,
        repeatability=np.nan if spread is None else spread,
        repeatability_unaligned=np.nan,
        taps=(),
        factors=np.zeros(0),
        of_grips_N=() if name else (float(library.grips_N[ig]),),
        slow_part_known=wanted.slow_part_known,
        name=name,
        ends_s=wanted.ends_s,
        peak_m_s2=float(np.abs(library.recorded_m_s2[iv, ig]).max()) if name else np.nan,
    )
