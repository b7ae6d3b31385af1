"""Summary as in qpbenchmark: success by recomputed residuals, shifted geometric mean of time, failures charged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from precision.cases import SOLVED
from precision.methods import TIME_LIMIT_S, Kind, Level
from precision.run import Row

NEARLY = 1e-3  # the looser of the two errors that count as a success
SHIFT_MS = 10.0


@dataclass(frozen=True)
class Score:
    """One setting of one method over several cases, for one error that counts as a success.

    Attributes
    ----------
    success : share of the cases. mean_ms : shifted geometric mean of the run time, failures charged the limit.
    relative : mean_ms over that of the best method.
    """

    success: float
    mean_ms: float
    relative: float


@dataclass(frozen=True)
class Summary:
    """One setting of one method; `scores` by the error that counts as a success. `worst` : largest error.

    reference : of some case it is one of the two reference solutions, from which errors are measured.
    """

    method: str
    level: str
    version: str
    options: str
    cases: int
    worst: float
    reference: bool
    scores: dict[float, Score]


def shifted_geometric_mean(values_ms: Sequence[float], shift_ms: float = SHIFT_MS) -> float:
    """exp(mean(log(v + shift))) - shift, as qpbenchmark and Mittelmann's benchmarks have it."""
    return float(np.exp(np.mean(np.log(np.asarray(values_ms) + shift_ms))) - shift_ms)


def charged_ms(row: Row, tolerance: float) -> float:
    """Run time of a success, the time limit of a failure."""
    return row.solve_ms if row.error <= tolerance else 1e3 * TIME_LIMIT_S


def summarise(rows: Sequence[Row], cases: Sequence[str]) -> list[Summary]:
    """Solvers that can take all these cases, at their default and their high-accuracy setting; the best first."""
    levels = (Level.DEFAULT.value, Level.HIGH.value)
    found: dict[tuple[str, str], dict[str, Row]] = {}
    for row in rows:
        if row.kind == Kind.SOLVER.value and row.level in levels and row.case in cases:
            found.setdefault((row.method, row.level), {})[row.case] = row
    whole = {key: list(by_case.values()) for key, by_case in found.items() if len(by_case) == len(cases)}
    tolerances = (SOLVED, NEARLY)
    means = {
        key: {t: shifted_geometric_mean([charged_ms(row, t) for row in group]) for t in tolerances}
        for key, group in whole.items()
    }
    best = {t: min((mean[t] for mean in means.values()), default=1.0) for t in tolerances}
    summaries = [
        Summary(
            method=method,
            level=level,
            version=group[0].version,
            options=group[0].options,
            cases=len(group),
            worst=max(row.error for row in group),
            reference=any(row.reference for row in group),
            scores={
                t: Score(
                    success=sum(row.error <= t for row in group) / len(group),
                    mean_ms=means[method, level][t],
                    relative=means[method, level][t] / best[t],
                )
                for t in tolerances
            },
        )
        for (method, level), group in whole.items()
    ]
    return sorted(summaries, key=lambda s: (s.scores[SOLVED].mean_ms, s.scores[NEARLY].mean_ms))
