"""The threads of linear algebra: one, and as many as the user has asked for."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from transopt.base.threads import THREADS, one_thread

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
