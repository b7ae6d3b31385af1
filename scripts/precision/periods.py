"""Poses one tap at other servo periods: another problem each, judged on one fine grid in continuous time."""

from collections.abc import Sequence
from importlib import metadata

import numpy as np
from common.measuring import take_turns

from precision.cases import Case
from precision.methods import Kind, Level
from precision.run import Effort, Row, set_up_and_run_ms, time_columns
from transopt.base.signals import FloatArray
from transopt.design.context import Context
from transopt.plant.discretise import discretise
from transopt.problem.leave_out import leave_out
from transopt.problem.problem import TransientProblem
from transopt.proof.replay import replay
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings
from transopt.solvers.choose import capable, solve
from transopt.solvers.options import SolverOptions

RATES_Hz = (2.5e3, 5e3, 10e3, 20e3)
BASE_Hz = 40e3  # what the periods are compared with
FINE_Hz = 80e3  # a whole multiple of all


def at_rate(scene: Scene, rate_Hz: float) -> Scene:
    """The scene with another servo rate, the same horizon, lead and duration of the hand-over."""
    dt_s = 1 / rate_Hz
    stages = round(scene.stages * scene.time.dt_s / dt_s)
    hand_over = int(np.ceil(scene.hand_over_samples * scene.time.dt_s / dt_s - 1e-9))
    servo = scene.time.model_copy(update={"dt_s": dt_s, "stages": stages, "lead_s": scene.lead_s})
    return scene.model_copy(update={"time": servo, "hand_over_samples": hand_over})


def _problem(case: Case, rate_Hz: float) -> TransientProblem:
    scene = at_rate(case.scene, rate_Hz)
    return Context.recorded(scene, recordings(scene)).posed(case.speed_m_s, case.grip_N).problem


def measure_periods(case: Case, effort: Effort, rates_Hz: Sequence[float] = RATES_Hz) -> list[Row]:
    """One row per servo rate: solved by the project's first choice, played on a grid of `FINE_Hz`.

    `tap_error_excess` is from the optimum of a servo of `BASE_Hz` on that grid, and may be negative; `gap` and
    `error` have no meaning here.
    """
    problems = {rate: leave_out(_problem(case, rate)).problem for rate in (*rates_Hz, BASE_Hz)}
    options = SolverOptions(next(capable(case.small)))
    answers, setup_ms, one_ms = {}, {}, {}
    for rate, problem in problems.items():
        setup_ms[rate], one_ms[rate] = set_up_and_run_ms(lambda problem=problem: solve(problem, options))
        answers[rate] = solve(problem, options)
    methods = {f"{rate:g}": lambda problem=problems[rate]: solve(problem, options) for rate in rates_Hz}
    times = take_turns(methods, {f"{rate:g}": effort.runs(one_ms[rate]) for rate in rates_Hz})

    tap_error, violation = played(case, {rate: answer.command for rate, answer in answers.items()})
    rows = []
    for rate in rates_Hz:
        rows.append(
            Row(
                case=case.name,
                method=f"{rate / 1e3:g} kHz",
                kind=Kind.PERIOD.value,
                level=Level.POINT.value,
                version=metadata.version("transopt"),
                options=f"{problems[rate].grid.stages} stages, {options.solver}",
                tolerance=options.tolerance,
                iterations=answers[rate].iterations,
                status=answers[rate].message,
                gap=float("nan"),
                violation=violation[rate],
                tap_error_excess=tap_error[rate] - tap_error[BASE_Hz],
                error=float("nan"),
                certificate=float("nan"),
                **time_columns(times[f"{rate:g}"], setup_ms[rate]),
            )
        )
    return rows


def played(case: Case, commands_A: dict[float, FloatArray]) -> tuple[dict[float, float], dict[float, float]]:
    """Tap errors of commands, by their servo rate, against the recorded tap on the fine grid; and their violation.

    A command held over its period is the same held over the fine periods within it, so one replay plays all.
    """
    scene = at_rate(case.scene, FINE_Hz)
    target = references_of(scene, recordings(scene)).at(case.speed_m_s, case.grip_N).target
    grid = scene.time_grid()
    fine = np.stack([np.repeat(c, round(FINE_Hz / rate))[: grid.stages] for rate, c in commands_A.items()])
    stage = discretise(case.problem.stage.plant, case.problem.stage.amplifier, grid.dt_s)
    budget = None if case.small.thermal is None else [case.small.thermal.budget] * len(fine)
    coil = None if case.small.thermal is None else case.small.thermal.coil
    found = replay(stage, grid, fine, [target] * len(fine), coil, budgets=budget)
    current_A, command_A = case.problem.limits.input_limit, case.problem.command_bound
    thermal = case.small.thermal
    violation = {}
    for rate, run in zip(commands_A, found, strict=True):
        excess = [0.0, run.peak_input / current_A - 1, run.peak_command / command_A - 1]
        if thermal is not None:
            headroom = float(thermal.model.headroom_K[np.isfinite(thermal.model.headroom_K)].max())
            excess.append((run.winding_C - thermal.limit_C) / headroom)
        violation[rate] = max(excess)
    return {rate: run.figures.tap_error for rate, run in zip(commands_A, found, strict=True)}, violation
