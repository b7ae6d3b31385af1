"""From a scene of an arm with several motors to its library: every entry designed, proven and replayed."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.machine import versions
from transopt.base.shown import cut, wrapped
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.base.writing import percent
from transopt.design.context import wanted_of
from transopt.design.optimum import optimum
from transopt.library.arm import SCHEMA, ArmLibrary
from transopt.problem.answer import Status
from transopt.problem.problem import TransientProblem
from transopt.proof.admit import admit
from transopt.proof.certify import Effect, binding_limits, certify
from transopt.proof.designed import Designed
from transopt.proof.replay import Replay
from transopt.proof.several import replay_several
from transopt.recordings.recording import Recording
from transopt.recordings.references import References
from transopt.scene.builtin import load_scene
from transopt.scene.recordings import recordings_of, references_of
from transopt.scene.scene import Scene
from transopt.solvers import unlimited
from transopt.solvers.options import SolverOptions

FIGURES_AGREE = 1e-6  # of figures made again, relative to 1: the floor is solved for anew


@dataclass(frozen=True)
class ArmEntry:
    """The answer for one speed, grip, normal and posture.

    Attributes
    ----------
    node : indices of speed, grip, normal and posture.
    designed : the answer with its proof. played : its replay.
    status, shortfalls : whether it may stand in a library, and what speaks against it.
    """

    node: tuple[int, int, int, int]
    designed: Designed
    played: Replay
    status: Status
    shortfalls: list[str]

    @property
    def admitted(self) -> bool:
        """Whether it may stand in a library."""
        return self.status is Status.OPTIMAL

    @property
    def problem(self) -> TransientProblem:
        """Problem with every limit of the scene."""
        return self.designed.problem

    @property
    def tangential_error(self) -> float:
        """Acceleration across the normal over the intention, over |r|."""
        return across(self.problem, self.played.acceleration_m_s2)[0]

    @property
    def direction_rad(self) -> float:
        """Angle by which the acceleration is off the normal."""
        return across(self.problem, self.played.acceleration_m_s2)[1]

    @property
    def binding(self) -> str:
        """The limits that bind, and when."""
        answer = self.designed.solution
        return binding_limits(self.problem, answer.command, answer.multipliers, effect=self.designed.effect)


def across(problem: TransientProblem, accelerations_m_s2: FloatArray) -> tuple[float, float]:
    """Size of the acceleration across the normal over the intention, over |r|, and its angle to the normal [rad].

    Parameters
    ----------
    accelerations_m_s2 : (p, N) y'' at the switching instants; the hand's own motion is along the normal.
    """
    tau = problem.grid.switching_times_s
    first = (tau >= 0) & (tau < problem.intention_s)
    target, N = problem.target, problem.grid.stages
    whole = accelerations_m_s2[:, :N] + target.of_window(target.free_m_s2)
    tangential = float(np.linalg.norm(whole[1:, first]))
    size = float(np.linalg.norm(target.of_window(target.recorded_m_s2)[0, first]))
    angle = float(np.arctan2(tangential, np.linalg.norm(whole[0, first])))
    return tangential / size if size > 0 else 0.0, angle


@dataclass(frozen=True)
class ArmBuild:
    """A designed library of an arm; `library` only if every entry is admitted."""

    scene: Scene
    entries: list[ArmEntry]
    library: ArmLibrary | None
    elapsed_s: float

    def __repr__(self) -> str:
        found = [entry for entry in self.entries if entry.admitted]
        errors = [entry.played.figures.tap_error for entry in found]
        said = f", tap error {percent(min(errors))} to {percent(max(errors))} %" if errors else ""
        return wrapped(
            f"ArmBuild({cut(self.scene.name)}: {len(found)} of {len(self.entries)} entries certified and replayed"
            f"{said}; {self.elapsed_s:.2f} s)"
        )


@dataclass(frozen=True)
class ArmContext:
    """Problems of a scene of an arm."""

    scene: Scene
    references: References

    @cached_property
    def shape(self) -> tuple[int, int, int, int]:
        """Sizes of the axes: speeds, grips, normals, postures."""
        grid, arm = self.scene.grid, self.scene.arm()
        return len(grid.speeds_m_s), len(grid.grips_N), len(arm.normals), len(arm.postures_deg)

    def problems(self, ig: int, io: int, iq: int) -> list[TransientProblem]:
        """The problems of all speeds at a grip, normal and posture, which share one device."""
        grip, arm, posing = self.scene.grid.grips_N[ig], self.scene.arm(), self.scene.arm_posing()
        stage = posing.stage(arm.plant_at(grip, arm.place(iq, io)))
        return [posing.problem(wanted_of(self.references.at(v, grip)), stage) for v in self.scene.grid.speeds_m_s]


@one_blas_thread()
def build_arm(
    scene: Scene | str | Path,
    recordings: Sequence[Recording] | None = None,
    *,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> ArmBuild:
    """Design, certify and replay every entry of a scene of an arm; the answer has the refused ones too.

    Parameters
    ----------
    recordings : to be reproduced in place of those that the scene names.
    progress : called with the number of entries that have just been finished.

    Raises
    ------
    InputError : a scene of another plant, recordings that cannot serve.
    """
    start, options = time.perf_counter(), SolverOptions() if options is None else options
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    loaded.arm()
    taps = recordings_of(loaded) if recordings is None else recordings
    context = ArmContext(loaded, references_of(loaded, taps))
    entries = []
    for ig, io, iq in np.ndindex(*context.shape[1:]):
        found = _designed(context.problems(ig, io, iq), options)
        entries += [ArmEntry((iv, ig, io, iq), *each) for iv, each in enumerate(found)]
        progress(len(found))
    admitted = all(entry.admitted for entry in entries)
    library = _library(context, entries, [tap.name for tap in taps]) if admitted else None
    return ArmBuild(loaded, entries, library, time.perf_counter() - start)


def _designed(
    problems: Sequence[TransientProblem], options: SolverOptions
) -> list[tuple[Designed, Replay, Status, list[str]]]:
    answers = [optimum(problem, options) for problem in problems]
    commands = np.stack([np.nan_to_num(each.solution.command) for each in answers])
    replays = replay_several(problems, commands)
    return [(each, played, *admit(each, played)) for each, played in zip(answers, replays, strict=True)]


def solve_arm(
    scene: Scene | str | Path,
    recordings: Sequence[Recording] | None = None,
    *,
    options: SolverOptions | None = None,
) -> ArmLibrary:
    """The library of a scene of an arm, every entry certified and replayed; parameters as of `build_arm`.

    Raises
    ------
    InputError : what `build_arm` refuses; or entries that are refused, with the first one's reason.
    """
    made = build_arm(scene, recordings, options=options)
    if made.library is None:
        refused = [entry for entry in made.entries if not entry.admitted]
        raise InputError(
            f"{made.scene.name}: {len(refused)} of {len(made.entries)} entries refused, the first for "
            f"{cut('; '.join(refused[0].shortfalls) or refused[0].status.value, 200)}"
        )
    return made.library


def _library(context: ArmContext, entries: Sequence[ArmEntry], taps: list[str]) -> ArmLibrary:
    scene, arm, shape = context.scene, context.scene.arm(), context.shape
    of_node = {entry.node: entry for entry in entries}
    nodes = [*np.ndindex(*shape)]

    def over_nodes(value: Callable[[ArmEntry], Any], axes: int = 4) -> NDArray[Any]:
        """Stack what entries have over the first axes, along the others taken at the first node."""
        found = [value(of_node[node]) for node in nodes if not any(node[axes:])]
        return np.array(found).reshape(*shape[:axes], *np.shape(found[0]))

    def of_devices(name: str) -> FloatArray:
        found = [getattr(of_node[0, *node].problem.stage.plant, name) for node in np.ndindex(*shape[1:])]
        return np.array(found).reshape(*shape[1:], *found[0].shape)

    targets = {
        f"{kind}{part}_m_s2": over_nodes(attrgetter(f"problem.target.{field}"), 2)
        for kind, before in (("target", ""), ("free", "free_"))
        for part, field in (
            ("", f"{before}window_m_s2"),
            ("_after", f"{before}after_m_s2"),
            ("_before", f"{before}before_m_s2"),
        )
    }
    figures = {
        "tap_error": "played.figures.tap_error",
        "tangential_error": "tangential_error",
        "direction_rad": "direction_rad",
        "felt_error": "played.figures.felt_error",
        "felt_dB": "played.figures.felt_dB",
        "floor": "designed.floor",
        "peak_input": "played.peak_input",
        "objective": "designed.certificate.objective",
        "duality_gap": "designed.certificate.duality_gap",
        "command": "designed.solution.command",
        "plant_input": "designed.effect.motion.plant_input",
        "acceleration_m_s2": "designed.effect.motion.acceleration_m_s2",
        "mu_end": "designed.solution.multipliers.hand_over",
        "binding": "binding",
    }
    rows = [row.name for _, row in entries[0].problem.rows()]
    multipliers = {
        f"mu_{row}_{side}": over_nodes(partial(_multiplier, row, side)) for row in rows for side in ("lower", "upper")
    }
    places = [[arm.place(iq, io) for iq in range(shape[3])] for io in range(shape[2])]
    arrays = {
        "speeds_m_s": np.array(scene.grid.speeds_m_s),
        "grips_N": np.array(scene.grid.grips_N),
        "normals": np.array([row[0].normal for row in places]),
        "postures_rad": np.array([place.posture_rad for place in places[0]]),
        **targets,
        **{name: over_nodes(attrgetter(path)) for name, path in figures.items()},
        **{f"plant_{name}": of_devices(name) for name in "ABCD"},
    }
    known = [
        [context.references.at(v, grip).slow_part_known for grip in scene.grid.grips_N] for v in scene.grid.speeds_m_s
    ]
    meta = {
        "schema": SCHEMA,
        "scene": scene.model_dump(mode="json"),
        "recordings": taps,
        "slow_part_known": known,
        "versions": versions("transopt", "numpy"),
    }
    return ArmLibrary(arrays, multipliers, meta)


def _multiplier(row: str, side: str, entry: ArmEntry) -> FloatArray:
    found: FloatArray = getattr(entry.designed.solution.multipliers, side)(row)
    return found


@dataclass(frozen=True)
class ArmCheck:
    """What verifying one entry of a file has found.

    Attributes
    ----------
    place : which entry. gap : relative, made again. tap_error : of the new replay.
    shortfalls : what speaks against it, one sentence each.
    """

    place: str
    gap: float
    tap_error: float
    shortfalls: list[str]


@one_blas_thread()
def verify_arm(library: ArmLibrary, progress: Callable[[int], None] = lambda done: None) -> list[ArmCheck]:
    """Certify and replay every entry of a library of an arm again, from its arrays and its scene alone."""
    checks = []
    for ig, io, iq in np.ndindex(*library.command.shape[1:4]):
        nodes = [(iv, ig, io, iq) for iv in range(library.command.shape[0])]
        problems = [library.problem(node) for node in nodes]
        replays = replay_several(problems, np.stack([library.command[node] for node in nodes]))
        checks += [_checked(library, *each) for each in zip(nodes, problems, replays, strict=True)]
        progress(len(nodes))
    return checks


def _floor(problem: TransientProblem) -> float:
    """Tap error of the optimum without limits."""
    (free,) = unlimited.solve([problem])
    return problem.tap_error(Effect(problem, free.command).motion.acceleration_m_s2)


def _checked(
    library: ArmLibrary, node: tuple[int, int, int, int], problem: TransientProblem, played: Replay
) -> ArmCheck:
    command, multipliers, said = library.command[node], library.multipliers_at(node), list[str]()
    effect = Effect(problem, command)
    proof = certify(problem, command, multipliers, effect=effect)
    if not proof.accepted:
        said.append(
            f"not certified: gap {proof.relative_gap:.1e}, limit {proof.GAP_TOLERANCE:.0e}, {proof.excess:.1e} times "
            "what is tolerated of limits"
        )
    predicted = library.arrays["acceleration_m_s2"][node]
    said += played.shortfalls(problem, command, predicted)
    tangential, angle = across(problem, played.acceleration_m_s2)
    again = {
        "tap_error": played.figures.tap_error,
        "tangential_error": tangential,
        "direction_rad": angle,
        "felt_error": played.figures.felt_error,
        "felt_dB": played.figures.felt_dB,
        "floor": _floor(problem),
        "peak_input": played.peak_input,
        "objective": proof.objective,
        "duality_gap": proof.duality_gap,
    }
    for name, value in again.items():
        stated = float(library.arrays[name][node])
        if not abs(stated - value) <= FIGURES_AGREE * max(1.0, abs(value)):
            said.append(f"{name} is stated as {stated:.9g} and comes out as {value:.9g}")
    binding = binding_limits(problem, command, multipliers, effect=effect)
    if binding != library.arrays["binding"][node]:
        said.append(
            f"binding is stated as {cut(str(library.arrays['binding'][node]))!r} and comes out as {binding!r}"
        )
    return ArmCheck(library.place(node), proof.relative_gap, played.figures.tap_error, said)
