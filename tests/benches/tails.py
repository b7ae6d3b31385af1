"""Problems of the shared scenes without what comes after their windows, for tests of something else."""

from dataclasses import replace

from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem


def without_tail(problem: TransientProblem) -> TransientProblem:
    """End the objective of a problem with its window."""
    N, wall = problem.grid.stages, problem.wall
    if wall is not None:
        wall = replace(wall, nominal_m=wall.nominal_m[:N], pressing=wall.pressing[:N])
    grid = replace(problem.grid, after_stages=0)
    return replace(problem, grid=grid, target=Target(problem.reference_m_s2), wall=wall)
