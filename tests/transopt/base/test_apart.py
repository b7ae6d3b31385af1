"""Calls in a process of their own: answers, errors and warnings as here; ended by time, by death, by a signal."""

import math
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import pytest

from transopt.base import apart

PATIENCE_S = 60.0


def test_the_answer_and_the_process_are_kept() -> None:
    assert apart.call(math.sqrt, 4.0, within_s=PATIENCE_S) == 2.0
    first = apart.call(os.getpid, within_s=PATIENCE_S)
    assert first != os.getpid()
    assert apart.call(os.getpid, within_s=PATIENCE_S) == first


def test_an_exception_is_raised_here_and_ends_nothing() -> None:
    first = apart.call(os.getpid, within_s=PATIENCE_S)
    with pytest.raises(ValueError, match="math domain error"):
        apart.call(math.sqrt, -1.0, within_s=PATIENCE_S)
    assert apart.call(os.getpid, within_s=PATIENCE_S) == first


def test_an_answer_that_cannot_be_sent_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="PicklingError"):
        apart.call(eval, "lambda: 0", within_s=PATIENCE_S)


def test_warnings_come_through_and_printing_does_not(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.warns(UserWarning, match="rounding"):
        apart.call(warnings.warn, "rounding", within_s=PATIENCE_S)
    apart.call(os.system, "echo loud; echo loud >&2", within_s=PATIENCE_S)
    assert capfd.readouterr() == ("", "")


def test_what_is_late_is_ended_and_the_next_call_answered() -> None:
    first = apart.call(os.getpid, within_s=PATIENCE_S)
    with pytest.raises(apart.UnansweredError, match=r"no answer within 0\.1 s"):
        apart.call(time.sleep, 600.0, within_s=0.1)
    assert apart.call(os.getpid, within_s=PATIENCE_S) != first


def test_a_process_that_dies_is_told_by_its_code() -> None:
    with pytest.raises(apart.UnansweredError, match="ended with code 7"):
        apart.call(os._exit, 7, within_s=PATIENCE_S)
    assert apart.call(math.sqrt, 9.0, within_s=PATIENCE_S) == 3.0


def test_a_signal_ends_the_wait_and_the_process() -> None:
    first = apart.call(os.getpid, within_s=PATIENCE_S)
    threading.Timer(0.2, signal.raise_signal, [signal.SIGINT]).start()
    with pytest.raises(KeyboardInterrupt):
        apart.call(time.sleep, 600.0, within_s=PATIENCE_S)
    assert apart.call(os.getpid, within_s=PATIENCE_S) != first


def test_calls_of_several_threads_are_answered_in_turn() -> None:
    found: dict[int, float] = {}
    threads = [
        threading.Thread(target=lambda j=j: found.update({j: apart.call(math.sqrt, float(j), within_s=PATIENCE_S)}))
        for j in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {j: math.sqrt(j) for j in range(8)}


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork")
def test_a_fork_of_this_process_has_one_of_its_own() -> None:
    program = (
        "import os; from transopt.base import apart\n"
        "first = apart.call(os.getpid, within_s=60.0)\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    other = apart.call(os.getpid, within_s=60.0)\n"
        "    apart.end()\n"
        "    os._exit(int(other == first))\n"
        "assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0\n"
        "assert apart.call(os.getpid, within_s=60.0) == first\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_it_does_not_outlive_the_one_who_calls() -> None:
    """Killed in the middle of a call, that one can end nothing any more; its end of the line closes."""
    program = (
        "import os, sys, time; from transopt.base import apart\n"
        "print(apart.call(os.getpid, within_s=60.0), flush=True)\n"
        "apart.call(time.sleep, 600.0, within_s=600.0)\n"
    )
    caller = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert caller.stdout is not None
    with caller.stdout as said:
        other = int(said.readline())
        caller.kill()
        caller.wait()
        deadline = time.monotonic() + PATIENCE_S
        while _lives(other):
            assert time.monotonic() < deadline


def _lives(process: int) -> bool:
    """Whether it runs; one that has ended may still be listed, until somebody asks for its exit code."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    listed = Path(f"/proc/{process}/stat")
    return not (listed.exists() and listed.read_text().rpartition(")")[2].split()[0] == "Z")


@pytest.mark.skipif(os.name != "posix", reason="asks the system by a signal")
def test_at_the_end_no_process_is_left() -> None:
    of_calls, own = apart.call(os.getpid, within_s=PATIENCE_S), apart.Process()
    own.ask(time.sleep, 600.0, within_s=600.0)
    apart.end()
    for number in (of_calls, own.number):
        with pytest.raises(ProcessLookupError):
            os.kill(number, 0)
    with pytest.raises(apart.UnansweredError):
        own.answer()
    assert apart.call(math.sqrt, 4.0, within_s=PATIENCE_S) == 2.0
