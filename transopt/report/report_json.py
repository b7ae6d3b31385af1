"""The text of report.json: the numbers of report.md for programs."""

import json
from dataclasses import asdict
from typing import Any

from transopt.base.files import without_nan
from transopt.design.build import Build
from transopt.design.entry import Entry
from transopt.design.refine_grid import Refinement
from transopt.problem.answer import Certificate
from transopt.report.identified import identified_rows
from transopt.report.markdown import priced_entries
from transopt.report.tables import warnings
from transopt.report.trade_off import levels_row, trade_off_row


def _certificate_row(certificate: Certificate) -> dict[str, Any]:
    """A certificate's numbers, with one violation per unit of the limits."""
    row = asdict(certificate)
    del row["violations"]
    row |= {f"primal_violation_{unit}": by for unit, by in certificate.stated_violations.items()}
    return row | {"relative_gap": certificate.relative_gap, "relative_bound": certificate.relative_bound}


def _which(entry: Entry) -> dict[str, Any]:
    """Keys that identify an entry."""
    if entry.target:
        return {"target": entry.target}
    at = {} if entry.spot is None else dict(zip(("normal", "posture"), entry.spot, strict=True))
    return {"speed_m_s": entry.speed_m_s, "grip_N": entry.grip_N, **at}


def build_json(build: Build, *, full: bool = True) -> str:
    """The text of report.json: the report's numbers, with units in their names; NaN becomes null.

    Parameters
    ----------
    full : as in `build_markdown`; values that are then not computed are null.
    """
    priced = priced_entries(build, full=full)
    peak = f"peak_{build.scene.driven_by.name}_{build.scene.driven_by.unit}"
    rows = [
        {
            **_which(e),
            "status": e.status.value,
            "shortfalls": e.shortfalls,
            "remedies": [asdict(remedy) for remedy in e.remedies],
            "verdict": e.verdict,
            **asdict(e.figures),
            **(
                {}
                if not e.problem.directions
                else {"tangential_error": e.tangential_error, "direction_rad": e.direction_rad}
            ),
            "heat_A2_s": e.heat_A2_s,
            "floor": e.floor,
            "baselines": asdict(e.baselines),
            "repeatability": e.repeatability,
            peak: e.played.peak_input,
            f"free_{peak}": e.free_peak,
            "after_peak_m_s2": e.played.after_peak_m_s2,
            "winding_C": e.played.winding_C,
            "housing_C": e.played.housing_C,
            "peak_voltage_V": e.played.reached.get("supply", float("nan")),
            "binding": e.binding,
            "prices": [asdict(price) for price in e.prices] if e in priced or not e.admitted else None,
            "size": None if e.size is None else asdict(e.size),
            "levels": levels_row(e.levels),
            "attained": None if e.attained is None else asdict(e.attained),
            "trade_off": trade_off_row(build, e) if full else None,
            "spread": None if e.spread is None else asdict(e.spread),
            "certificate": _certificate_row(e.certificate),
            "replay_step_error": e.played.step_error,
            "solver": e.solution.solver,
            "solver_message": e.solution.message,
            "solve_time_s": e.solution.solve_time_s,
            "left_out": e.left_out,
        }
        for e in build.all_entries()
    ]
    cool = [
        {
            **_which(e),
            **asdict(e.figures),
            "heat_A2_s": e.heat_A2_s,
            "heat_price": e.problem.heat_price,
            "binding": e.binding,
            "certificate": _certificate_row(e.certificate),
        }
        for row in build.cool
        for e in row
    ]
    content = {
        "scene": build.scene.name,
        "simulated_recordings": build.scene.recordings.simulated is not None,
        "identified": identified_rows(build),
        "solver": build.solver,
        "elapsed_s": build.elapsed_s,
        "warnings": warnings(build),
        "after_s": build.scene.weights.after_s,
        "lead_s": build.scene.lead_s,
        "entries": rows,
        "second_commands": cool,
        "refinement": None if build.refinement is None else _refinement_rows(build.refinement),
        "references": [
            {
                **({"target": r.name} if r.name else {"speed_m_s": r.speed_m_s, "grip_N": r.grip_N}),
                "states_grip": bool(r.of_grips_N),
                "slow_part_known": r.slow_part_known,
                "taps": [tap.recording.name for tap in r.taps],
                "scaling": r.scalings.tolist(),
                "repeatability": r.repeatability,
                "repeatability_unaligned": r.repeatability_unaligned,
                "lost_share": r.target.lost_share,
            }
            for r in build.references
        ],
    }
    return json.dumps(without_nan(content), indent=1)


def _refinement_rows(refinement: Refinement) -> dict[str, Any]:
    return {
        "tolerance": refinement.tolerance,
        "shortfall": refinement.shortfall,
        "rounds": refinement.rounds,
        "elapsed_s": refinement.elapsed_s,
        "scene_grid": refinement.recorded.model_dump(),
        "points": [asdict(point) for point in refinement.points],
    }
