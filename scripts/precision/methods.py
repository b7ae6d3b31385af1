"""What a method is, and the methods that need nothing but this project: its solvers, Opti + IPOPT, the baselines."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from importlib import metadata
from typing import Any

import numpy as np
from common.peers import commonly_written

from precision.cases import Case
from precision.discretisations import RULES, discretised, growth
from transopt.base.signals import FloatArray
from transopt.problem.answer import Multipliers
from transopt.problem.baselines import clipped_optimum, seed_inversion
from transopt.problem.problem import TransientProblem
from transopt.solvers import unlimited
from transopt.solvers.choose import SOLVERS, capable, solve
from transopt.solvers.options import SolverOptions

TIME_LIMIT_S = 10.0  # a run that takes longer has failed
LOOSER, TIGHTEST = (1e-1, 1e-3, 1e-5, 1e-7), 1e-12  # of the project's solvers, beside their default
NONE = float("nan")  # tolerance of a method that has none to set, or of its own default


class Kind(Enum):
    """What a row stands for; the value is its name in files."""

    SOLVER = "solver"
    BASELINE = "baseline"
    DISCRETISATION = "discretisation"
    PERIOD = "control period"


class Level(Enum):
    """Which point of a method's curve a setting is."""

    DEFAULT = "default"
    HIGH = "high accuracy"
    SWEEP = "sweep"
    POINT = "point"


@dataclass(frozen=True)
class Setting:
    """One point of a method's curve."""

    options: str
    tolerance: float = NONE
    level: Level = Level.SWEEP


@dataclass(frozen=True)
class Answer:
    """What one run returns: commands (N,) [A], the method's own words, multipliers where it gives them."""

    command_A: FloatArray
    status: str
    iterations: int = -1
    multipliers: Multipliers | None = None


@dataclass(frozen=True)
class Prepared:
    """A method ready to be timed: `run` is timed, `read` turns what it returned into an answer."""

    run: Callable[[], Any]
    read: Callable[[Any], Answer] = lambda answer: answer


@dataclass(frozen=True)
class Method:
    """One curve.

    Attributes
    ----------
    settings : of a case; none where the method cannot take it.
    prepare : everything that is done once for problems of one shape. A run starts without an earlier run's answer.
    """

    name: str
    version: str
    kind: Kind
    settings: Callable[[Case], Sequence[Setting]]
    prepare: Callable[[Case, Setting], Prepared]


def error_line(error: BaseException) -> str:
    """Type and first line of an error."""
    return f"{type(error).__name__}: {(str(error).splitlines() or [''])[0][:100]}"


def failed(case: Case, status: str) -> Answer:
    """No command."""
    return Answer(np.full(case.problem.grid.stages, np.nan), status)


def sweep(default: str, tolerances: Sequence[float], high: float, name: str, more: str = "") -> list[Setting]:
    """A method's own defaults, and tolerances from loose to tight; `high` is its high-accuracy setting.

    Parameters
    ----------
    name : of the option. more : what else the high-accuracy setting sets.
    """
    found = [Setting(default, NONE, Level.DEFAULT)]
    for tolerance in tolerances:
        options = f"{name} {tolerance:g}"
        if tolerance == high:
            found.append(Setting(options + more, tolerance, Level.HIGH))
        else:
            found.append(Setting(options, tolerance))
    return found


# ------------------------------------------------------------------------------------------------ the project's


def new_tap(problem: TransientProblem) -> TransientProblem:
    """A problem as a new tap of a known device: what solvers keep of its target is computed again."""
    return replace(problem, target=replace(problem.target))


def _project(solver: str) -> Method:
    def settings(case: Case) -> list[Setting]:
        if solver not in capable(case.small):
            return []
        usual = SolverOptions().tolerance
        default = Setting(f"tolerance {usual:g}, the default tolerance", usual, Level.DEFAULT)
        others = [tolerance for tolerance in LOOSER if tolerance > usual]
        return [default, *sweep("", [*others, TIGHTEST], TIGHTEST, "tolerance")[1:]]

    def prepare(case: Case, setting: Setting) -> Prepared:
        options = SolverOptions(solver, setting.tolerance)

        def run() -> Answer:
            found = solve(new_tap(case.small), options)
            return Answer(found.command, found.message, found.iterations, found.multipliers)

        return Prepared(run)

    version = metadata.version("casadi" if solver.startswith("casadi-") else "transopt")
    return Method(solver, version, Kind.SOLVER, settings, prepare)


def project_methods() -> list[Method]:
    """Whatever `transopt.solvers` holds."""
    return [_project(solver) for solver in SOLVERS]


def opti_ipopt() -> Method:
    """The usual way of writing it; IPOPT's own tolerance is 1e-8 on its own scaling."""

    def prepare(case: Case, setting: Setting) -> Prepared:
        opti, commands = commonly_written(case.small)
        tolerance = {} if np.isnan(setting.tolerance) else {"tol": setting.tolerance}
        if setting.level is Level.HIGH:
            # Otherwise every bound is widened by 1e-8.
            tolerance["bound_relax_factor"] = 0.0
        limits = {"max_wall_time": TIME_LIMIT_S, "print_level": 0, "sb": "yes"}
        opti.solver("ipopt", {"print_time": False, "error_on_fail": False}, {**limits, **tolerance})

        def run() -> Answer:
            opti.set_initial(opti.x, 0)
            opti.solve_limited()
            statistics = opti.stats()
            command = np.asarray(opti.debug.value(commands)).ravel()
            return Answer(command, str(statistics["return_status"]), int(statistics["iter_count"]))

        return Prepared(run)

    name, more = "as commonly written, tol", ", bounds kept"
    settings = sweep("as commonly written, IPOPT's defaults", (1e-4, 1e-12), 1e-12, name, more)
    return Method("opti-ipopt", metadata.version("casadi"), Kind.SOLVER, lambda case: settings, prepare)


# ------------------------------------------------------------------------------------------------ baselines


def baselines() -> list[Method]:
    """What the optimum is compared with elsewhere: they keep current and command limits, and minimise nothing."""

    def clipped(case: Case, setting: Setting) -> Prepared:
        def run() -> Answer:
            free = unlimited.solve([case.small])[0]
            limit = case.problem.limits.input_limit
            return Answer(clipped_optimum(case.problem.stage, case.problem.grid, free.command, limit), "clipped")

        return Prepared(run)

    def seed(case: Case, setting: Setting) -> Prepared:
        problem = case.problem

        def run() -> Answer:
            limit, taper = problem.limits.input_limit, problem.hand_over_samples
            return Answer(
                seed_inversion(problem.stage, problem.grid, problem.reference_m_s2, limit, taper), "clipped"
            )

        return Prepared(run)

    version = metadata.version("transopt")
    return [
        Method(
            "clipped optimum",
            version,
            Kind.BASELINE,
            lambda case: [Setting("unlimited optimum, cut", level=Level.POINT)],
            clipped,
        ),
        Method(
            "seed inversion",
            version,
            Kind.BASELINE,
            lambda case: [Setting("the seed's, cut", level=Level.POINT)],
            seed,
        ),
    ]


# ------------------------------------------------------------------------------------------------ discretisations


def fixed_solver(case: Case) -> SolverOptions:
    """The solver of everything that is no comparison of solvers: the project's first choice for the problem."""
    return SolverOptions(next(capable(case.small)))


def discretisations() -> list[Method]:
    """Approximate the problem's stage by each rule, for one solver; the exact stage judges the command."""

    def method(name: str) -> Method:
        def prepare(case: Case, setting: Setting) -> Prepared:
            options = fixed_solver(case)

            def run() -> Answer:
                stage = discretised(RULES[name], case.small.stage)
                if (factor := growth(stage)) > 1:
                    return failed(case, f"unstable: grows by {factor:.3g} per tick")
                found = solve(replace(case.small, stage=stage), options)
                return Answer(found.command, found.message, found.iterations)

            return Prepared(run)

        def settings(case: Case) -> list[Setting]:
            options = fixed_solver(case)
            return [Setting(f"one step a tick, {options.solver}", options.tolerance, Level.POINT)]

        return Method(name, metadata.version("transopt"), Kind.DISCRETISATION, settings, prepare)

    return [method(name) for name in RULES]
