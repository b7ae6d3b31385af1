"""Designs for a nonlinear plant, each beside what the linear design gives on that plant."""

import time
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import cut, html_table, wrapped
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.base.writing import percent
from transopt.design.nonlinear_library import nonlinear_library
from transopt.design.optimum import Designed, optimum
from transopt.design.posed import entry_problem, scene_stage
from transopt.library.columns import EntryTable, TableRow
from transopt.library.library import Library
from transopt.plant.nonlinear import NonlinearCoil
from transopt.plant.nonlinear_stage import NonlinearStage
from transopt.problem.answer import Certificate, Solution, Status
from transopt.problem.nonlinear import NonlinearProblem
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import Effect, binding_limits
from transopt.proof.nonlinear import certify_nonlinear
from transopt.proof.nonlinear_replay import replay_nonlinear
from transopt.proof.replay import Replay
from transopt.recordings.targets import target_references
from transopt.scene.builtin import load_scene
from transopt.scene.scene import Scene
from transopt.solvers.choose import check_name
from transopt.solvers.nonlinear import solve
from transopt.solvers.options import SolverOptions


@dataclass(frozen=True)
class NonlinearEntry:
    """One target on a nonlinear plant: its own design, and the linear design beside it.

    Attributes
    ----------
    target : its name.
    problem : J, limits and the nonlinear stage.
    solution : command (N,) [A or V] and multipliers of the nonlinear program.
    certificate : that the command is a stationary point, by the adjoint; its lower bound is minus infinity.
    predicted_m_s2, plant_input : (N,) y'' and input of the command at the switching instants, by the nonlinear stage.
    off_replay : largest difference of that y'' to the replay's, relative to its peak: the stage's own error.
    played : the command on the nonlinear plant in continuous time.
    designed : the linear design, the optimum for the plant as it is at rest.
    linear_command : (N,) its command.
    linear_promised : NRMSE that the linear plant would have under it.
    linear_played : what it does on the nonlinear plant.
    status : STATIONARY where all is proven and played, else why not.
    shortfalls : what speaks against the entry, one sentence each.
    binding : the limits that bind, and when.
    """

    target: str
    problem: NonlinearProblem
    solution: Solution
    certificate: Certificate
    predicted_m_s2: FloatArray
    plant_input: FloatArray
    off_replay: float
    played: Replay
    designed: Designed
    linear_command: FloatArray
    linear_promised: float
    linear_played: Replay
    status: Status
    shortfalls: list[str]
    binding: str

    def __repr__(self) -> str:
        found = (
            f"NRMSE {percent(self.nrmse)} %, of the linear design {percent(self.linear_nrmse)} %; "
            f"binds: {cut(self.binding)}"
            if self.status is Status.STATIONARY
            else f"refused: {cut('; '.join(self.shortfalls) or self.status.value)}"
        )
        return wrapped(f"NonlinearEntry({cut(self.target)}: {found})")

    @property
    def row(self) -> TableRow:
        """What tables show of it; the figures of a refused design are shown too."""
        return TableRow(
            place=(self.target,),
            nrmse=self.nrmse,
            after=self.played.nrmse_after,
            after_peak_m_s2=self.played.error_peak_after_m_s2,
            linear=(self.linear_promised, self.linear_nrmse),
            linear_after=self.linear_played.nrmse_after,
            peak_input=self.played.peak_input,
            violation=self.certificate.primal_violation,
            relative_gap=self.certificate.relative_gap,
            solve_time_s=self.solution.solve_time_s,
            binding=self.binding,
            result="; ".join([self.status.value, *self.shortfalls]),
        )

    @property
    def nrmse(self) -> float:
        """NRMSE of the nonlinear design, played on the nonlinear plant."""
        return self.played.nrmse

    @property
    def linear_nrmse(self) -> float:
        """NRMSE of the linear design, played on the nonlinear plant."""
        return self.linear_played.nrmse

    @cached_property
    def linear_leaves(self) -> list[str]:
        """Limits that the linear design leaves on the nonlinear plant, one sentence each."""
        limits = self.problem.linear.limits
        return [
            limit.replayed(self.linear_played.peak(limit)) for limit in limits if self.linear_played.leaves(limit)
        ]


@dataclass(frozen=True)
class NonlinearDesign:
    """Every target of a scene on its nonlinear plant.

    Attributes
    ----------
    scene : with its table `model.nonlinear`.
    entries : in the order of the scene's targets.
    library : of the nonlinear design; None unless every entry is proven.
    elapsed_s : wall time of it all.
    """

    scene: Scene
    entries: tuple[NonlinearEntry, ...]
    library: Library | None
    elapsed_s: float

    def __repr__(self) -> str:
        return wrapped(
            f"NonlinearDesign({cut(self.scene.name)}: {len(self.proven)} of {len(self.entries)} targets certified "
            f"stationary and replayed; {self.elapsed_s:.2f} s)"
        )

    def _repr_html_(self) -> str:
        """Table in a notebook."""
        return html_table(repr(self), self.table.heads, self.table.cells)

    @property
    def table(self) -> EntryTable:
        """All targets, in columns of `transopt.library.columns.COLUMNS`."""
        rows = [entry.row for entry in self.entries]
        return EntryTable(self.scene.axes.columns, COLUMNS, rows, self.scene.driven_by.unit)

    @property
    def proven(self) -> tuple[NonlinearEntry, ...]:
        """Entries that are certified stationary and replayed clean."""
        return tuple(entry for entry in self.entries if entry.status is Status.STATIONARY)

    @property
    def commands(self) -> FloatArray:
        """(targets, N) commands of the nonlinear design [A or V]."""
        return np.stack([entry.solution.command for entry in self.entries])

    def command(self, target: str) -> FloatArray:
        """(N,) command of one target [A or V], issued at -lead + k dt and held.

        Raises
        ------
        InputError : a target that the scene does not have, or one whose design is not proven.
        """
        entry = next((each for each in self.entries if each.target == target), None)
        if entry is None:
            raise InputError(f"{target}: no target of this scene: {', '.join(each.target for each in self.entries)}")
        if entry.status is not Status.STATIONARY:
            raise InputError(f"{target}: refused: {'; '.join(entry.shortfalls) or entry.status.value}")
        return entry.solution.command


COLUMNS = ("linear", "nrmse", "linear_after", "after", "ms", "gap", "result")


@one_blas_thread()
def design_nonlinear(scene: Scene | str | Path, *, options: SolverOptions | None = None) -> NonlinearDesign:
    """Design every target of a scene for its nonlinear plant, certify and replay it, beside the linear design.

    The linear optimum of the plant at rest is found first; its command, rolled out, is where IPOPT begins on the
    nonlinear program. Both commands are then played on the nonlinear plant.

    Parameters
    ----------
    scene : a scene with `[[targets]]` and `[model.nonlinear]`, or the path of its .toml file.
    options : tolerance and largest number of iterations of IPOPT; its `solver` is that of the linear design.

    Raises
    ------
    InputError : a scene without `model.nonlinear`, or with a part that no nonlinear plant can have yet; a target that
        cannot serve.
    """
    began = time.perf_counter()
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    options = SolverOptions() if options is None else options
    check_name(options.solver)
    plant = loaded.nonlinear_plant()
    linear = loaded.at_rest()
    stage = scene_stage(linear, 0.0)
    references = target_references(linear.targets, linear.time_grid(), linear.recordings)
    entries = tuple(
        design_entry(reference.name, entry_problem(linear, stage, reference), plant, options)
        for reference in references
    )
    proven = all(entry.status is Status.STATIONARY for entry in entries)
    library = nonlinear_library(loaded, references, entries, options) if proven else None
    return NonlinearDesign(loaded, entries, library, time.perf_counter() - began)


def design_entry(
    target: str, problem: TransientProblem, plant: NonlinearCoil, options: SolverOptions
) -> NonlinearEntry:
    """One entry on a nonlinear plant.

    Parameters
    ----------
    problem : of the plant as it is at rest.

    Raises
    ------
    InputError : a target that is zero.
    """
    if problem.reference_is_zero:
        raise InputError(f"targets.{target}: is zero throughout: there is nothing to design; take it out")
    designed = optimum(problem, options)
    at_rest = np.nan_to_num(designed.solution.command)
    stage = NonlinearStage(plant, problem.stage.amplifier, problem.grid.dt_s, 1, tuple(problem.stage.outputs))
    posed, found = solve(NonlinearProblem(problem, stage), at_rest, options)
    command = np.nan_to_num(found.command)
    effect = posed.effect(command)
    motion = effect.motion
    linear_played, played = replay_nonlinear(posed, [at_rest, command])
    off = float(np.abs(motion.acceleration_m_s2 - played.acceleration_m_s2).max())
    certificate = certify_nonlinear(posed, found.command, found.multipliers, effect=effect)
    shortfalls = played.shortfalls(problem, command, motion.acceleration_m_s2)
    status = Status.STATIONARY
    if found.status is not Status.OPTIMAL:
        status, shortfalls = found.status, [f"IPOPT: {found.message}", *shortfalls]
    elif not certificate.is_stationary:
        status = Status.NOT_CERTIFIED
        shortfalls = [f"gap {certificate.relative_gap:.1e}, limit {certificate.GAP_TOLERANCE:.0e}", *shortfalls]
    elif shortfalls:
        status = Status.REPLAY_VIOLATION
    return NonlinearEntry(
        target=target,
        problem=posed,
        solution=found,
        certificate=certificate,
        predicted_m_s2=motion.acceleration_m_s2,
        plant_input=motion.plant_input,
        off_replay=off / max(played.scale_m_s2, np.finfo(float).tiny),
        played=played,
        designed=designed,
        linear_command=at_rest,
        linear_promised=problem.target.nrmse(problem.stage.rollout(at_rest)[0]),
        linear_played=linear_played,
        status=status,
        shortfalls=shortfalls,
        binding=binding_limits(problem, command, found.multipliers, effect=Effect(problem, command, motion)),
    )
