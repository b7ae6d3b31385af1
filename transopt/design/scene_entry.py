"""Entries of a scene posed with other numbers, and remedies for all refused entries of a build."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from transopt.design.context import Context, Posed, Spot
from transopt.design.entry import Entry
from transopt.design.explain import Change, Remedy, what_would_do
from transopt.design.remedy import MOST_WORK, MOTOR, STAGES, Values, Work, does, remedies
from transopt.plant.state_space import CURRENT_INPUT
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.limits.own import OwnLimit
from transopt.references.reference import Reference
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

NOT_ALL = "not all that may help was tried: the trials took all the work that an entry may"
MOST_OF_A_LIBRARY = 12 * MOST_WORK  # work of the trials for all entries of a build
BETA = "limits.beta"
OWN = f"limits.{OwnLimit.key}"
COIL = ("thermal.", *MOTOR)  # keys that matter only if the scene models the motor's coil


@dataclass(frozen=True)
class SceneEntry:
    """One entry of a scene, which can be posed with other numbers in the scene."""

    context: Context
    grip_N: float
    reference: Reference
    spot: Spot = None

    @property
    def scene(self) -> Scene:
        """The scene as it stands."""
        return self.context.scene

    def value(self, key: str) -> float | None:
        """The number at a dotted key; None if the key is absent or this entry does not depend on it."""
        if key == f"limits.{CurrentLimit.key}" and self.scene.driven_by is CURRENT_INPUT:
            return self.scene.limits.transient_input
        if key == STAGES:
            return float(self.scene.stages)
        if key.startswith(COIL) and self.scene.coil() is None:
            return None
        found: object = self.scene
        for name in key.split("."):
            found = getattr(found, name, None)
        return float(found) if isinstance(found, int | float) else None

    def posed(self, changes: Values) -> Posed:
        """Pose the entry with other numbers in the scene; a user-defined limit is removed by its name.

        Raises
        ------
        InputError : numbers that are invalid in the scene, recordings that do not fit a changed time axis.
        """
        left_out = {key.removeprefix(f"{OWN}.") for key in changes if key.startswith(f"{OWN}.")}
        values = {key: value for key, value in changes.items() if not key.startswith(f"{OWN}.")}
        scene = self.scene
        if left_out:
            scene = with_values(scene, {OWN: [x.model_dump() for x in scene.limits.own if x.name not in left_out]})
        context, reference = self.context.varied(with_values(scene, values)), self.reference
        if context.scene.time_grid() != self.scene.time_grid():
            reference = context.reference(reference.speed_m_s, self.grip_N, reference.name)
        return context.posed_as(reference, self.grip_N, self.spot)


def with_remedies(context: Context, entries: Sequence[Sequence[Entry]], options: SolverOptions) -> list[list[Entry]]:
    """The entries, speed by speed; refused ones have their remedies.

    A remedy of one entry is tried first for the next one, so that a single change may help all entries.
    """
    library, found = Work(MOST_OF_A_LIBRARY), dict[str, Remedy]()

    def does_too(posed: SceneEntry, entry: Entry, remedy: Remedy) -> bool:
        library.spend(entry, remedy.values)
        return does(posed, remedy.values, options)

    def tried(entry: Entry) -> Entry:
        if entry.admitted:
            return entry
        if not library.left:
            reason = "not tried what would do: the trials for other entries took all the work that a library may"
            return entry.stating(shortfalls=[*entry.shortfalls, reason])
        reference = context.reference(entry.speed_m_s, entry.grip_N, entry.target)
        posed = SceneEntry(context, entry.grip_N, reference, entry.spot)
        own, vain = [remedy for remedy in found.values() if does_too(posed, entry, remedy)], list[str]()
        if not own:
            work = Work(min(MOST_WORK, library.left))
            own = remedies(posed, entry, options, work)
            library.spent += work.spent
            vain = [NOT_ALL] if work.short and not any(remedy.solved for remedy in own) else []
        own = [_in_place_of_beta(context.scene, remedy) for remedy in own]
        found.update({str(remedy): remedy for remedy in own if remedy.solved})
        return entry.stating(
            remedies=tuple(own), shortfalls=list(filter(None, [*entry.shortfalls, what_would_do(own), *vain]))
        )

    return [[tried(entry) for entry in row] for row in entries]


def _in_place_of_beta(scene: Scene, remedy: Remedy) -> Remedy:
    """Let a remedy that states the limit on the current also drop beta, by which the scene states that limit."""
    if scene.limits.beta is None or f"limits.{CurrentLimit.key}" not in remedy.values or BETA in remedy.values:
        return remedy
    return replace(remedy, changes=(*remedy.changes, Change(BETA, None, "")))
