"""The design of library entries: optimum, floor, baselines, certificate, replay, admission."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from transopt.base.axes import Axes
from transopt.base.shown import cut, html_figure, html_table, wrapped
from transopt.base.signals import FloatArray
from transopt.base.writing import percent
from transopt.design.attained import Attained
from transopt.design.explain import Remedy
from transopt.design.intensity import best
from transopt.design.optimum import Designed
from transopt.design.posed import entry_problem, scene_stage, spread_stages
from transopt.design.price import Price, binding, prices
from transopt.design.verify import admit
from transopt.library.columns import NAN, EntryTable, TableRow
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import acting_states
from transopt.problem.answer import Certificate, Multipliers, Solution, Status, verdict
from transopt.problem.baselines import clipped_optimum, seed_inversion
from transopt.problem.limits import kinds_of
from transopt.problem.objective.bands import Levels, levels
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import Box, binding_limits, boxes
from transopt.proof.continuous import Accurate, accurate
from transopt.proof.replay import Replay, errors_of, replay, replayed_errors
from transopt.recordings.reference import Reference
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.solvers.program import Size, size

if TYPE_CHECKING:  # nothing is drawn while a library is solved
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Baselines:
    """NRMSE of the two other methods after replay, at the transient limit and at the steady limit."""

    seed: float
    clipped: float
    seed_steady: float
    clipped_steady: float


@dataclass(frozen=True)
class SpreadErrors:
    """Errors of a robust entry over its devices: of the design for the node alone, and of its own.

    Each is the root of what a device loses in J (`Tracking.losses`), so that what comes after the window, or after
    the end of a target, counts as much as the scene has it count.

    Attributes
    ----------
    nominal, robust : of the entry's own device, for which the nominal design was made.
    nominal_rms, robust_rms : root of the mean square over the devices; a robust design minimises this or the worst.
    nominal_worst, robust_worst : the largest over the devices.
    """

    nominal: float
    nominal_rms: float
    nominal_worst: float
    robust: float
    robust_rms: float
    robust_worst: float


@dataclass(frozen=True)
class Entry:
    """One (speed, grip) of a library, with everything that is said about it.

    Attributes
    ----------
    speed_m_s, grip_N : that it is for; 0 where it is for a named target.
    target : its name; empty for a tap.
    predicted_m_s2, plant_input : (N,) y'' and i of the command at the switching instants.
    floor : NRMSE of the unlimited optimum. free_peak : its peak current.
    transient_command : (N,) the command without the wall's predicted feedback; the command itself without a wall.
    status, shortfalls : admission; shortfalls is empty for an OPTIMAL entry.
    remedies : what would do for a refused one, or what was tried; empty where nothing was.
    prices : what each limit that binds costs.
    left_out : part of the problem -> why it is not in it.
    solved : the problem that a program was made of; None where one linear solve was enough.
    spread : errors over the spread of devices; None for an entry designed for one device.
    attained : what was found of the energy that was asked for; None where the scene asks for none.
    """

    speed_m_s: float
    grip_N: float
    target: str
    problem: TransientProblem
    solution: Solution
    certificate: Certificate
    played: Replay
    predicted_m_s2: FloatArray
    plant_input: FloatArray
    transient_command: FloatArray
    floor: float
    free_peak: float
    baselines: Baselines
    repeatability: float
    status: Status
    shortfalls: list[str]
    binding: str
    prices: list[Price]
    left_out: dict[str, str]
    solved: TransientProblem | None
    spread: SpreadErrors | None
    remedies: tuple[Remedy, ...] = ()
    attained: Attained | None = None

    def __repr__(self) -> str:
        found = (
            f"NRMSE {percent(self.nrmse)} %, floor {percent(self.floor)} %; {self.verdict}; "
            f"binds: {cut(self.binding)}"
            if self.status is Status.OPTIMAL
            else f"refused: {cut('; '.join(self.shortfalls) or self.status.value)}"
        )
        return wrapped(f"Entry({self.place}: {found})")

    @property
    def place(self) -> str:
        """Which entry it is, in a sentence."""
        return self._axes.place(0, 0)

    @property
    def cells(self) -> list[str]:
        """Which entry it is, in the columns of a table (`Axes.columns`)."""
        return self._axes.cells(0, 0)

    @property
    def _axes(self) -> Axes:
        return Axes((self.speed_m_s,), (self.grip_N,), (self.target,) if self.target else ())

    @property
    def row(self) -> TableRow:
        """What tables show of it."""
        b, looked = self.baselines, self.problem.grid.after_stages > 0
        admitted = self.status is Status.OPTIMAL
        return TableRow(
            place=tuple(self.cells),
            nrmse=self.nrmse,
            floor=self.floor,
            after=self.played.nrmse_after if looked else NAN,
            after_peak_m_s2=self.played.error_peak_after_m_s2 if looked else NAN,
            seed=(b.seed, b.seed_steady),
            clipped=(b.clipped, b.clipped_steady),
            repeatability=self.repeatability,
            peak_input=self.played.peak_input,
            winding_C=self.played.winding_C,
            violation=self.certificate.primal_violation,
            relative_gap=self.certificate.relative_gap,
            solve_time_s=self.solution.solve_time_s,
            binding=self.binding,
            verdict=self.verdict,
            refusal="" if admitted else self.status.value,
        )

    @property
    def unit(self) -> str:
        """Unit of the commands: "A" or "V"."""
        return self.problem.driven_by.unit

    def _repr_html_(self) -> str:
        """Table, a row for each column, and figure in a notebook."""
        names = ("nrmse", "floor", "after", "after_peak", "seed", "clipped", "peak", "gap", "binding", "verdict")
        shown = EntryTable((), names, (self.row,), self.unit)
        rows = [["entry", self.place], *map(list, zip(shown.heads, shown.figures(self.row), strict=True))]
        rows += [["why it is refused", said] for said in self.shortfalls]
        return html_table(repr(self), ["", ""], rows) + html_figure(self.plot())

    def plot(self) -> "Figure":
        """The waveform over time: acceleration beside its reference, current beside its limit.

        The figure is matplotlib's; `savefig` writes it to a file.
        """
        from transopt.report.transients import entries_figure

        return entries_figure([[self]])

    @cached_property
    def size(self) -> Size | None:
        """Size of the program that was solved; None where one linear solve was enough."""
        return None if self.solved is None else size(self.solved)

    @property
    def nrmse(self) -> float:
        return self.played.nrmse

    @property
    def energy_dB(self) -> float:
        """Energy of the tap within the window over the recorded one's."""
        return energy_dB(self.problem, self.solution.command)

    @property
    def weighted_nrmse(self) -> float:
        """NRMSE as the scene's error filter hears it; the plain one without a filter."""
        return self.nrmse if self.problem.reference_is_zero else self.problem.tracking.nrmse(self.predicted_m_s2)

    @property
    def slopes(self) -> dict[str, float]:
        """Limit that binds -> by how much J falls per unit by which it is raised, from the multipliers alone.

        It is the slope at the limit as it stands. What a step buys is less, since the slope flattens on the way: see
        `prices`, which are solved for.
        """
        if self.problem.reference_is_zero:
            return {}
        return binding(self.problem, self.solution.command, self.solution.multipliers)

    def boxes(self, command: FloatArray | None = None) -> list[Box]:
        """Every limit along a command, with its bounds.

        Parameters
        ----------
        command : (N,) another command in this entry's problem, without multipliers; by default the entry's own.
        """
        problem, solution = self.problem, self.solution
        multipliers = solution.multipliers if command is None else Multipliers.zero(problem)
        command = solution.command if command is None else command
        return boxes(problem, command, problem.stage.motion(command), multipliers)

    @cached_property
    def levels(self) -> Levels:
        """Energies of the prediction over those of r: broadband, as felt, band by band."""
        return levels(self.predicted_m_s2, self.problem.reference_m_s2, self.problem.grid.dt_s)

    @property
    def verdict(self) -> str:
        if self.status is not Status.OPTIMAL:
            return "refused"
        if self.problem.reference_is_zero:
            return "zero reference"
        return verdict(self.nrmse, self.floor, self.repeatability, self.levels)


def energy_dB(problem: TransientProblem, command: FloatArray) -> float:
    """Energy of y'' over that of r within the window, as the error filter hears it [dB]; 0 where r is zero."""
    if problem.reference_is_zero:
        return 0.0
    return problem.tracking.energy_dB(problem.accelerations(command))


def left_out_by_scene(scene: Scene, problem: TransientProblem) -> dict[str, str]:
    """Parts that the scene does not ask for."""
    plant = problem.stage.plant
    # A black box has no position, and the state of its other grip that a node does not need is none.
    idle = int(np.sum(~acting_states(plant))) if plant.Ce.any() else 0
    parts = {
        "feedback": (problem.wall is None, "the scene has no wall"),
        "position": (
            problem.wall is None and not problem.stage.outputs,
            "nothing in the scene depends on it" + (f": {idle} state fewer" if idle else ""),
        ),
        "amplifier": (problem.stage.amplifier is None, "ideal in the scene"),
        "hand": (scene.grid.grips_N[0] == 0, "free device, grip 0"),
        "weighting": (problem.error_filter is None, "the scene weighs all frequencies alike"),
    }
    limits = {
        kind.name: (kind.name not in problem.limits, kind.said_without)
        for kind in kinds_of(problem.driven_by)
        if kind.said_without
    }
    parts = {**parts, **limits}
    return {part: reason for part, (missing, reason) in parts.items() if missing}


def design_grip(scene: Scene, grip_N: float, references: Sequence[Reference], options: SolverOptions) -> list[Entry]:
    """All entries of one grip, in the order of the references.

    Solved one by one with one solver object; the optimum and the baselines of all speeds are replayed together.
    """
    stage = scene_stage(scene, grip_N)
    spread = spread_stages(scene, grip_N)
    objective = scene.weights.objective
    problems = [entry_problem(scene, stage, reference, spread) for reference in references]
    designed = [best(problem, options, objective=objective) for problem in problems]
    replays, rivals = played_with_rivals(scene.limits.steady_input, scene.coil(), designed)
    return [
        _entry(scene, grip_N, reference, d, played, baselines, options)
        for reference, d, played, baselines in zip(references, designed, replays, rivals, strict=True)
    ]


def replayed(coil: CoilModel | None, designed: Sequence[Designed]) -> list[Replay]:
    """Replays of optima, through the wall if there is one; all of one device, time axis and tap rate."""
    return _replayed(coil, designed, _transients(designed), None)


def played_with_rivals(
    steady_input: float, coil: CoilModel | None, designed: Sequence[Designed]
) -> tuple[list[Replay], list[Baselines]]:
    """Replays of optima as of `replayed`, and the two other methods at the transient limit and at the steady one.

    The rivals know no wall. Without one all commands go through one simulation.
    """
    first = designed[0].problem
    transients, rivals = _transients(designed), rivals_of(steady_input, designed)
    targets = [d.problem.target for d in designed] * (len(rivals) // len(designed))
    if first.wall is None:
        together, M = accurate(first.stage, first.grid, np.concatenate([transients, rivals]), None), len(designed)
        replays = _replayed(coil, designed, transients, together.of(slice(M)))
        errors = errors_of(together.of(slice(M, None)), first.grid, targets)
    else:
        replays = _replayed(coil, designed, transients, None)
        errors = replayed_errors(first.stage, first.grid, rivals, targets)
    return replays, [Baselines(*(float(error) for error in each)) for each in errors.reshape(-1, len(designed)).T]


def _transients(designed: Sequence[Designed]) -> FloatArray:
    """(M, N) what is played of each optimum, beside the wall's feedback."""
    # A solver that broke down returns NaN, which no integrator needs to see.
    commands = [np.nan_to_num(d.solution.command, nan=0.0, posinf=0.0, neginf=0.0) for d in designed]
    return np.stack([d.problem.transient_command(c) for d, c in zip(designed, commands, strict=True)])


def _replayed(
    coil: CoilModel | None, designed: Sequence[Designed], transients: FloatArray, simulated: Accurate | None
) -> list[Replay]:
    problems = [d.problem for d in designed]
    budgets = [p.thermal.budget for p in problems if p.thermal is not None]
    walls = [p.wall for p in problems if p.wall is not None]
    return replay(
        problems[0].stage,
        problems[0].grid,
        transients,
        [problem.target for problem in problems],
        coil,
        limits=[problem.limits for problem in problems],
        walls=walls or None,
        budgets=budgets or None,
        simulated=simulated,
        spread=problems[0].spread,
    )


def rivals_of(steady_input: float, designed: Sequence[Designed]) -> FloatArray:
    """(4 M, N) commands of the two other methods, in the order of `Baselines`, each of all entries."""
    first = designed[0].problem
    references = np.stack([d.problem.reference_m_s2 for d in designed])
    free = np.stack([d.unlimited_command for d in designed])
    # Both limits at once: what is clipped at them is the same.
    limits = np.array([first.limits.input_limit, steady_input])[:, None, None]
    seed = seed_inversion(first.stage, first.grid, references, limits, first.hand_over_samples)
    clipped = clipped_optimum(first.stage, first.grid, free, limits)
    return np.stack([seed, clipped], axis=1).reshape(-1, first.grid.stages)  # limit, method, entry


def _spread_errors(problem: TransientProblem, nominal: FloatArray, command: FloatArray) -> SpreadErrors | None:
    """Over the devices of a robust entry, of its command and of the command designed for the node alone."""
    if not problem.spread:
        return None
    own, robust = (np.sqrt(problem.tracking.losses(problem.accelerations(c))) for c in (nominal, command))

    def rms(errors: FloatArray) -> float:
        return float(np.sqrt(np.mean(errors**2)))

    return SpreadErrors(
        nominal=float(own[0]),
        nominal_rms=rms(own),
        nominal_worst=float(own.max()),
        robust=float(robust[0]),
        robust_rms=rms(robust),
        robust_worst=float(robust.max()),
    )


def _entry(
    scene: Scene,
    grip_N: float,
    reference: Reference,
    designed: Designed,
    played: Replay,
    baselines: Baselines,
    options: SolverOptions,
) -> Entry:
    problem, solution, effect = designed.problem, designed.solution, designed.effect
    command, predicted = solution.command, effect.motion.acceleration_m_s2
    status, shortfalls = admit(solution.status, designed.certificate, played, problem, command, predicted)
    spread = None
    if problem.spread and status is Status.OPTIMAL:
        # Made for the node alone, and asked for the same.
        nominal = best(problem.alone(), options, objective=scene.weights.objective).solution.command
        spread = _spread_errors(problem, nominal, command)
    return Entry(
        speed_m_s=reference.speed_m_s,
        grip_N=grip_N,
        target=reference.name,
        problem=problem,
        solution=solution,
        certificate=designed.certificate,
        played=played,
        predicted_m_s2=predicted,
        plant_input=effect.motion.plant_input,
        transient_command=problem.transient_command(command),
        floor=designed.floor,
        free_peak=designed.free_peak,
        baselines=baselines,
        repeatability=reference.repeatability,
        status=status,
        shortfalls=[*designed.remarks, *(text for text in shortfalls if not designed.remarks)],
        binding=binding_limits(problem, command, solution.multipliers, effect=effect),
        prices=prices(problem, command, solution.multipliers, designed.unlimited_command, options, effect=effect)
        if status is Status.OPTIMAL
        else [],
        left_out={**left_out_by_scene(scene, problem), **designed.left_out},
        solved=designed.solved,
        spread=spread,
        attained=designed.attained,
    )
