"""The threads of linear algebra, and a cache that threads share."""

import os
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import transopt as to
from transopt.base.kept import Kept
from transopt.base.threads import THREADS, one_blas_thread, one_thread
from transopt.study.axes import parse_axis
from transopt.study.executors import executor_pool
from transopt.study.plan import Plan
from transopt.study.session import run_plan
from transopt.web.service import Service

COUNTED = """\
import os
from transopt.base import terminal

def main():
    import numpy as np
    matrix = np.ones((1000, 1000))
    matrix @ matrix
    print(len(os.listdir("/proc/self/task")))

terminal.run(main)
"""


def threads(**stated: str) -> int:
    """Threads of a command that has multiplied matrices, in an environment that states these variables alone."""
    others = {name: value for name, value in os.environ.items() if name not in THREADS}
    ended = subprocess.run(
        [sys.executable, "-c", COUNTED], env={**others, **stated}, capture_output=True, text=True, check=True
    )
    return int(ended.stdout)


@pytest.mark.parametrize("name", THREADS)
def test_a_number_that_the_user_has_stated_stays(name: str) -> None:
    assert one_thread({name: "3"}) == {}


def test_without_one_every_library_has_one_thread() -> None:
    assert one_thread({"PATH": "/bin"}) == dict.fromkeys(THREADS, "1")


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted as Linux shows them")
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core has one thread in any case")
def test_a_command_computes_in_one_thread() -> None:
    assert threads() == 1


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted as Linux shows them")
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core has one thread in any case")
@pytest.mark.parametrize("name", ["OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"])
def test_a_command_takes_the_threads_that_the_user_allows(name: str) -> None:
    assert threads(**{name: "2"}) == 2


def replayed(library: to.Library) -> object:
    """A tap of the library, played again."""
    problem = library.problem(0, 0)
    return to.replay(problem.stage, problem.grid, np.zeros((1, problem.grid.stages)), [problem.target], None)


def studied(library: to.Library) -> object:
    """A study of one entry, as its executor in this process runs it."""
    plan = Plan(library.scene(), (parse_axis(library.scene(), "--vary", "limits.current_A=2"),), (0.2,), (3.0,))
    with tempfile.TemporaryDirectory() as folder:
        return run_plan(plan, Path(folder), executor_pool("serial", 1))


DOORS: dict[str, Callable[[to.Library], object]] = {
    "solve": lambda library: to.solve(library.scene()),
    "build": lambda library: to.build(library.scene()),
    "verify": to.verify,
    "online": lambda library: to.Online(library).solve(0.2, 3.0),
    "solve_problem": lambda library: to.solve_problem(library.problem(0, 0)),
    "replay": replayed,
    "study": studied,
    "page, at once": lambda library: Service(library.scene()).quick([0]),
    "page, settled": lambda library: Service(library.scene()).settled(0),
}


def counts() -> set[int]:
    """Threads of every library of linear algebra in this process."""
    return {found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"}


@pytest.fixture(scope="module")
def small() -> to.Library:
    scene = to.load_scene("wood_on_foam")
    grid = scene.grid.model_copy(update={"speeds_m_s": [0.2], "grips_N": [3.0]})
    library = to.solve(scene.model_copy(update={"grid": grid}))
    to.Online(library)  # which imports what it solves with: an import is no step into physics
    return library


@pytest.mark.parametrize("door", DOORS)
def test_every_way_in_from_python_has_one_thread_and_gives_back_what_was_there(
    door: str, small: to.Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    inside: list[set[int]] = []

    def watch(frame: FrameType, event: str, argument: object) -> None:
        """What is in force at the first step into physics or proof."""
        if event == "call" and re.search(r"transopt/(proof|solvers/(?!options))", frame.f_code.co_filename):
            sys.setprofile(None)
            inside.append(counts())

    with threadpool_limits(limits=2, user_api="blas"):
        before = counts()
        sys.setprofile(watch)
        try:
            DOORS[door](small)
        finally:
            sys.setprofile(None)
        assert inside == [{1}]
        assert counts() == before


def test_an_exception_gives_the_threads_back_and_nobody_takes_them_from_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    with threadpool_limits(limits=2, user_api="blas"):
        before = counts()
        with one_blas_thread():
            with pytest.raises(ZeroDivisionError), one_blas_thread():
                raise ZeroDivisionError
            assert counts() == {1}
        assert counts() == before


def test_a_search_that_fails_leaves_later_calls_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)

    def broken() -> None:
        raise OSError("no libraries to be seen")

    with threadpool_limits(limits=2, user_api="blas"):
        with monkeypatch.context() as patched:
            patched.setattr("threadpoolctl.ThreadpoolController", broken)
            patched.setattr("transopt.base.threads._HELD._modules", 0)
            with pytest.raises(OSError, match="no libraries"), one_blas_thread():
                pass
        with one_blas_thread():
            assert counts() == {1}


def test_a_number_that_the_user_has_stated_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    with threadpool_limits(limits=2, user_api="blas"):
        before = counts()
        with one_blas_thread():
            assert counts() == before


def test_the_most_recent_values_are_kept() -> None:
    kept, made = Kept[str](2), list[str]()

    def get(key: str) -> str:
        return kept.get(key, lambda: made.append(key) or key.upper())

    assert [get(key) for key in "abab"] == ["A", "B", "A", "B"]
    assert made == ["a", "b"]
    assert get("a") == "A"
    assert get("c") == "C"  # drops b, which was read before a
    assert get("a") == "A"
    assert made == ["a", "b", "c"]
    get("b")
    assert made == ["a", "b", "c", "b"]


def test_several_threads_share_one() -> None:
    kept, wrong = Kept[int](3), list[tuple[int, int]]()

    def read(first: int) -> None:
        for number in range(first, first + 3000):
            key = number % 7
            if (found := kept.get(key, lambda key=key: key + 100)) != key + 100:
                wrong.append((key, found))

    threads = [threading.Thread(target=read, args=(first,)) for first in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert not wrong
