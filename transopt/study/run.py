"""Runs tasks on an executor with bounded memory; survives dying workers, and a stop loses no results."""

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait

from transopt.base.errors import InputError
from transopt.study.executors import Pool
from transopt.study.rows import Outcome
from transopt.study.tasks import Task, run_task

AHEAD = 3  # tasks submitted per worker: none idles while results are written, and memory stays bounded
MOST_DEATHS = 3  # deaths of workers without a finished task in between
LOOK_S = 0.5  # time between two looks at a cluster that does not answer
MOST_LOOKS = 120
GRACE_S = 0.2  # time that a stop grants to tasks that have started

Write = Callable[[list[Outcome]], object]


def _kept(text: str) -> str:
    return f"{text}; the rows so far are kept, the same command goes on from there"


class _UnderWay:
    """Tasks submitted to an executor, and those to submit again because their worker died."""

    def __init__(self, pool: Pool, tasks: Iterator[Task]) -> None:
        self._pool, self._tasks = pool, tasks
        self._futures: dict[Future[list[Outcome]], Task] = {}
        self._again: list[Task] = []
        self._deaths = self._looks = 0

    def fill(self) -> bool:
        """Submit tasks up to `AHEAD` per worker; returns whether any is under way."""
        most = AHEAD * max(self._pool.workers(), 1)
        while len(self._futures) < most:
            task = self._again.pop() if self._again else next(self._tasks, None)
            if task is None:
                break
            try:
                self._futures[self._pool.executor.submit(run_task, task)] = task
            except BrokenExecutor:
                self._died(task)
        return bool(self._futures)

    def _died(self, task: Task) -> None:
        """Submit a task again after its worker died, unless workers keep dying."""
        self._again.append(task)
        self._deaths += 1
        if self._deaths > MOST_DEATHS:
            died = f"{self._pool.name}: a worker died {self._deaths} times in a row"
            raise InputError(_kept(f"{died} (out of memory? fewer --jobs take less)"))

    def write_finished(self, write: Write) -> None:
        """Write the outcomes of finished tasks; none if a worker died or `LOOK_S` have passed.

        A task counts as under way until its outcomes are written, so that a stop in between does not lose them.
        """
        done, _ = wait(self._futures, timeout=LOOK_S, return_when=FIRST_COMPLETED)
        self._looks = self._looks + 1 if not done and self._pool.workers() == 0 else 0
        if self._looks > MOST_LOOKS:
            raise InputError(_kept(f"{self._pool.name}: no worker for {MOST_LOOKS * LOOK_S:g} s"))
        for future in done:
            try:
                outcomes = future.result()
            except BrokenExecutor:
                self._died(self._futures.pop(future))
                continue
            except Exception as error:
                reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
                raise InputError(_kept(f"{self._pool.name}: a task could not be run ({reason})")) from None
            write(outcomes)
            del self._futures[future]
            self._deaths = 0

    def cancel(self) -> list[Future[list[Outcome]]]:
        """Cancel tasks that have not started; returns those that have."""
        return [future for future in self._futures if not future.cancel()]

    def stop(self, write: Write) -> None:
        """Cancel tasks that have not started, and write the others if they finish at once."""
        done, _ = wait(self.cancel(), timeout=GRACE_S)
        for future in done:
            if future.exception() is None:
                write(future.result())


def execute(pool: Pool, tasks: Iterator[Task], write: Write) -> None:
    """Run tasks and pass on their outcomes, in the order in which they finish.

    A stop (Ctrl-C, or anything else that raises KeyboardInterrupt or SystemExit) gives running tasks `GRACE_S` to
    finish; outcomes may then be written a second time. Tasks that take longer are solved again by the next run; their
    workers end when the pool is closed.

    Raises
    ------
    InputError : workers keep dying, or none is left.
    """
    under_way = _UnderWay(pool, tasks)
    try:
        while under_way.fill():
            under_way.write_finished(write)
    except (KeyboardInterrupt, SystemExit):
        under_way.stop(write)
        raise
    finally:
        under_way.cancel()
