"""Worker processes that solve the taps of a page in parallel, each a share of them.

Most of a tap's time is spent in Python code, which threads of one process cannot run in parallel. So the server has a
crew of processes, as many as leave one core each to server and browser: on two cores none, where a process would take
the browser's time and shorten no answer. They are started with the page. Until they are ready, or while they work for
another window, the server solves all taps itself. The answers depend on the process by
less than the solver's tolerance, since each begins where its own last ones ended.
"""

import itertools
import os
import pickle
import threading
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future

from transopt.base.apart import Processes, bounded
from transopt.scene.scene import Scene
from transopt.web.service import Service, Tables
from transopt.web.shown import Shown

MOST = 3  # largest number of processes; with the server's share that is three of twelve taps each
MOST_S = 20.0  # time limit of a share, after which the process is ended and the server solves it
READY_S = 60.0

_names = itertools.count()


class Crew:
    """The processes of one page, shared by its windows.

    Parameters
    ----------
    size : number of processes; by default the number of cores minus two, at most `MOST`.
    """

    def __init__(self, size: int | None = None) -> None:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._size = min(MOST, max(cores - 2, 0)) if size is None else size
        self._at_work, self._enlisting, self._ended = threading.Lock(), threading.Lock(), threading.Event()
        self._members: list[_Member] = []

    def start(self) -> None:
        """Start the processes without waiting until they are ready."""
        threading.Thread(target=self.enlist, name="page crew", daemon=True).start()

    def enlist(self) -> None:
        """Start the missing processes, and use each one when it has loaded its modules."""
        with self._enlisting:
            lacking = 0 if self._ended.is_set() else self._size - len(self._members)
            starting = [_Member() for _ in range(lacking)]
            for member, ready in [(one, one.process.submit(_ready)) for one in starting]:
                try:
                    ready.result(READY_S)
                except (BrokenExecutor, TimeoutError):
                    member.process.shutdown(wait=False)
                    continue
                with self._at_work:
                    self._members.append(member)
            if self._ended.is_set():
                self.end()

    @property
    def numbers(self) -> list[int]:
        """Process ids of the processes that are ready."""
        return [number for member in self._members for number in member.process.numbers]

    def end(self) -> None:
        """End all processes at once."""
        self._ended.set()
        for member in self._members:
            member.process.shutdown(wait=False)

    def quick(self, name: str, service: Service, order: Sequence[int]) -> list[Shown]:
        """`Service.quick` with the taps distributed over the processes.

        Parameters
        ----------
        name : unique name of the service, by which a process knows it (`service_name`).
        """
        if len(order) < 2 or not self._at_work.acquire(blocking=False):
            return service.quick(order)
        try:
            # Neighbours in the order share a grip and so its device, which each process builds only once.
            own, *others = _shares(order, len(self._members) + 1)
            pending = [
                (member, share, member.ask(name, service, share))
                for member, share in zip(list(self._members), others, strict=False)
            ]
            found = service.quick(own)
            for member, share, answer in pending:
                found += self._answer(member, share, answer, service)
            return found
        finally:
            self._at_work.release()

    def _answer(
        self, member: "_Member", share: Sequence[int], answer: "Future[list[Shown]]", service: Service
    ) -> list[Shown]:
        try:
            return answer.result(MOST_S)
        except (BrokenExecutor, CancelledError, TimeoutError):
            # The process died or is late: its share is solved here, and a new process replaces it.
            self._members.remove(member)
            member.process.shutdown(wait=False)
            if not self._ended.is_set():
                self.start()
            return service.quick(share)


def _shares(order: Sequence[int], count: int) -> list[Sequence[int]]:
    """The order split into at most so many parts of about equal length."""
    ends = [round(j * len(order) / min(count, len(order))) for j in range(min(count, len(order)) + 1)]
    return [order[first:after] for first, after in itertools.pairwise(ends)]


class _Member:
    """One process, and the service that was last sent to it."""

    def __init__(self) -> None:
        self.process = Processes(1, quiet=True)
        self._sent: tuple[str, Tables] = "", ()

    def ask(self, name: str, service: Service, share: Sequence[int]) -> "Future[list[Shown]]":
        """Submit a share of a window's taps; the service itself is sent where the process does not have it."""
        # It does not have the service of another window, or has references on another time axis.
        whole = None if self._sent == (name, service.axis) else pickle.dumps(service)
        self._sent = name, service.axis
        state = service.scene, service.probe, service.winding_C
        return self.process.submit(_share, whole, state, list(share))


_service: list[Service] = []  # the service that was last sent to this process


def _ready() -> None:
    """Do nothing; its return shows that the process has loaded this module."""


def _share(
    whole: bytes | None,
    state: tuple[Scene, tuple[float, float] | None, float | None],
    share: list[int],
) -> list[Shown]:
    """Solve a share in a process of the crew; `state` is scene, tap between the nodes and winding temperature."""
    if whole is not None:
        _service[:] = [pickle.loads(whole)]
    (service,) = _service
    service.scene, service.probe, service.winding_C = state
    return bounded(MOST_S, lambda: service.quick(share))


def service_name() -> str:
    """A new unique name for a service."""
    return f"service {next(_names)}"
