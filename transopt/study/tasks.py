"""Solves, certifies and replays entries of varied scenes; an invalid scene is distinguished from a shortfall.

A task is a small number of entries of one grip that share work: references are cached between tasks, and entries of
the same device are replayed together. Tasks and outcomes are plain values, for any executor.
"""

import itertools
import json
import threading
import time
from dataclasses import dataclass

from transopt.base.errors import InputError
from transopt.base.kept import Kept
from transopt.base.threads import one_blas_thread
from transopt.design.context import Context, Posed
from transopt.design.design import design
from transopt.recordings.recording import Recording
from transopt.scene.keys import Changes, with_values
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.study.rows import DEFECT, REFUSED, Outcome, outcome_of

KEPT_REFERENCES, KEPT_SCENES = 8, 256
# Parts of a scene that its references depend on, those of the hand's device among them.
RECORDED = ("recordings", "targets", "grid", "hand", "model", "motor", "transmission", "tip", "amplifier", "time")


@dataclass(frozen=True)
class Item:
    """One entry of a task, for a speed or for the target of that name.

    `index` is the caller's index, `point` that of its changes in the task.
    """

    index: int
    point: int
    speed_m_s: float
    target: str = ""


@dataclass(frozen=True)
class Task:
    """Entries of one grip that are solved together.

    Attributes
    ----------
    scene : the unchanged scene; its grid has the recorded speeds. points : changes of keys, one per point.
    recordings : recordings for all of its points. source : identifies scene and recordings in cache keys.
    rivals : whether baselines and prices of the limits are wanted, which cost more than the optimum.
    """

    scene: Scene
    recordings: tuple[Recording, ...]
    source: str
    grip_N: float
    points: tuple[Changes, ...]
    items: tuple[Item, ...]
    options: SolverOptions
    rivals: bool = False


_recorded: Kept[Context] = Kept(KEPT_REFERENCES)
_scenes: Kept[tuple[Scene, Scene, str]] = Kept(KEPT_SCENES)
# All problems of one shape share CasADi's solver objects. If another thread calls one before its status is read, the
# status is that of the wrong problem.
_one_at_a_time = threading.Lock()


def _context(task: Task, changes: Changes) -> Context:
    """The context of one scene of a task; the scene, and the parts that depend only on its recordings, are cached."""
    scene, recorded, key = _scenes.get(f"{task.source} {changes!r}", lambda: _scene(task, changes))
    return _recorded.get(key, lambda: Context.recorded(recorded, task.recordings)).varied(scene)


def _scene(task: Task, changes: Changes) -> tuple[Scene, Scene, str]:
    """One scene of a task, the same with the recorded grid, and the key of what depends only on recordings."""
    scene = with_values(task.scene, changes)
    recorded = scene.model_copy(update={"grid": task.scene.grid})
    of = json.dumps(recorded.model_dump(include=set(RECORDED), mode="json"), sort_keys=True)
    return scene, recorded, f"{task.source} {scene.time_grid()} {of}"


def _ended(task: Task, item: Item, error: Exception) -> Outcome:
    """The outcome of an item without an entry, with the reason."""
    if isinstance(error, InputError):
        status, reason = REFUSED, str(error)
    else:  # one entry must not stop thousands: its row names the exception
        status, reason = DEFECT, f"{type(error).__name__}: {error}"[:300]
    place = {"index": item.index, "speed_m_s": item.speed_m_s, "grip_N": task.grip_N, "target": item.target}
    return {**place, "status": status, "reason": " ".join(reason.split())}


@one_blas_thread()
def run_task(task: Task) -> list[Outcome]:
    """Solve every entry of a task, in the order of its items; an entry that fails does not raise."""
    with _one_at_a_time:
        return _run(task)


def _posed(task: Task, items: list[Item]) -> list[Posed | Exception]:
    """The problems of items of one point, which share what they can; for an item without one, the reason."""
    try:
        context = _context(task, task.points[items[0].point])
        references = [context.reference(item.speed_m_s, task.grip_N, item.target) for item in items]
        return [*context.posed_together(references, task.grip_N)]
    except Exception as error:
        return [error] if len(items) == 1 else [one for item in items for one in _posed(task, [item])]


def _run(task: Task) -> list[Outcome]:
    start = time.perf_counter()
    outcomes: dict[int, Outcome] = {}  # by position of their item
    posed: dict[int, Posed] = {}
    points = itertools.groupby(task.items, lambda item: item.point)
    for place, one in enumerate(one for _, items in points for one in _posed(task, [*items])):
        if isinstance(one, Exception):
            outcomes[place] = _ended(task, task.items[place], one)
        else:
            posed[place] = one
    failed: dict[int, Exception] = {}

    def tell(which: Posed, error: Exception) -> None:
        failed[id(which)] = error

    entries = iter(design(list(posed.values()), rivals=task.rivals, options=task.options, failed=tell))
    for place, one in posed.items():
        item = task.items[place]
        if id(one) in failed:
            outcomes[place] = _ended(task, item, failed[id(one)])
            continue
        entry = next(entries)
        try:
            outcomes[place] = outcome_of(entry, item.index, rivals=task.rivals)
        except Exception as error:
            outcomes[place] = _ended(task, item, error)
    share_ms = 1e3 * (time.perf_counter() - start) / len(task.items)
    for outcome in outcomes.values():
        if outcome.get("solver"):
            outcome["total_ms"] = share_ms
    return [outcomes[place] for place in sorted(outcomes)]
