"""Entries of varied scenes: each solved, certified and replayed, invalid scenes told apart from what falls short.

A task is a handful of entries of one grip that can share work: stage models and references are kept from task to
task, and what has the same device is replayed together. Tasks and outcomes are plain values, for any executor.
"""

import threading
import time
from dataclasses import dataclass

from transopt.base.errors import InputError
from transopt.base.threads import one_blas_thread
from transopt.design.context import KEPT_STAGES, OF_A_STAGE, Context, Kept, Posed, as_text
from transopt.design.design import design
from transopt.plant.discretise import StageModel
from transopt.recordings.recording import Recording
from transopt.recordings.references import References
from transopt.scene.keys import Changes, with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.study.rows import DEFECT, REFUSED, Outcome, outcome_of

KEPT_REFERENCES = 8


@dataclass(frozen=True)
class Item:
    """One entry of a task: `index` is the caller's, `point` the place of its changes in the task.

    It is for a speed, or for the target of that name.
    """

    index: int
    point: int
    speed_m_s: float
    target: str = ""


@dataclass(frozen=True)
class Task:
    """Entries of one grip.

    Attributes
    ----------
    scene : with nothing changed; its grid has the recorded speeds. points : changes of keys.
    recordings : for all of its points. source : names them; what is kept of them is kept under this name.
    rivals : whether the baselines and the prices of the limits are wanted too, which cost more than the optimum.
    """

    scene: Scene
    recordings: tuple[Recording, ...]
    source: str
    grip_N: float
    points: tuple[Changes, ...]
    items: tuple[Item, ...]
    options: SolverOptions
    rivals: bool = False


_references: Kept[References] = Kept(KEPT_REFERENCES)
_stages: Kept[StageModel] = Kept(KEPT_STAGES)
# CasADi's solver objects are shared by all problems of a shape, and reading how one ended after another thread has
# called it again would tell of the wrong problem.
_one_at_a_time = threading.Lock()


def _context(task: Task, changes: Changes) -> Context:
    """One scene of a task; what it shares with the others of its device or of its recordings is kept."""
    scene = with_values(task.scene, changes)
    recorded = scene.model_copy(update={"grid": task.scene.grid})
    of = as_text(recorded, "recordings", "targets", "grid", "hand", *OF_A_STAGE)
    key = f"{task.source} {scene.time_grid()} {of}"
    return Context(scene, lambda: _references.get(key, lambda: references_of(recorded, task.recordings)), _stages)


def _ended(task: Task, item: Item, error: Exception) -> Outcome:
    """What tells that an item has no entry, and why."""
    if isinstance(error, InputError):
        status, reason = REFUSED, str(error)
    else:  # one entry must not take thousands with it: it is told, by name, in its row
        status, reason = DEFECT, f"{type(error).__name__}: {error}"[:300]
    place = {"index": item.index, "speed_m_s": item.speed_m_s, "grip_N": task.grip_N, "target": item.target}
    return {**place, "status": status, "reason": " ".join(reason.split())}


@one_blas_thread()
def run_task(task: Task) -> list[Outcome]:
    """Every entry of a task, in the order of its items; never raises for what an entry does."""
    with _one_at_a_time:
        return _run(task)


def _run(task: Task) -> list[Outcome]:
    start = time.perf_counter()
    outcomes: dict[int, Outcome] = {}  # by the place of their item
    posed: dict[int, Posed] = {}
    contexts: dict[int, Context] = {}
    for place, item in enumerate(task.items):
        try:
            if item.point not in contexts:
                contexts[item.point] = _context(task, task.points[item.point])
            posed[place] = contexts[item.point].posed(item.speed_m_s, task.grip_N, item.target)
        except Exception as error:
            outcomes[place] = _ended(task, item, error)
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
