"""Calls in a process of their own: answers, errors and warnings as here; ended by time, by death, by a signal."""

import math
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import CancelledError
from pathlib import Path

import pytest

from transopt.base import apart

PATIENCE_S = 60.0
ROOT = Path(__file__).parents[3]


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
    with pytest.raises(apart.UnansweredError, match=r"no answer within 1 s$"):
        apart.call(time.sleep, 600.0, within_s=0.1)
    assert apart.call(os.getpid, within_s=PATIENCE_S) != first


@pytest.mark.skipif(sys.platform == "win32", reason="Windows counts no processor time of a process")
def test_a_call_is_bounded_by_the_processor_time_that_it_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(apart, "SHARED", 600.0)  # of this process: the clock would end the call much later
    with pytest.raises(apart.UnansweredError, match=r"no answer within 1 s of a processor$"):
        apart.call(sum, range(10**12), within_s=1.0)
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
    of_calls, own = apart.call(os.getpid, within_s=PATIENCE_S), apart.Processes(1)
    number = own.submit(os.getpid).result()
    asleep = own.submit(time.sleep, 600.0)
    apart.end()
    for each in (of_calls, number):
        with pytest.raises(ProcessLookupError):
            os.kill(each, 0)
    with pytest.raises((apart.UnansweredError, CancelledError)):
        asleep.result()
    assert apart.call(math.sqrt, 4.0, within_s=PATIENCE_S) == 2.0


@pytest.fixture
def two() -> Iterator[apart.Processes]:
    executor = apart.Processes(2)
    yield executor
    executor.shutdown(wait=False)


def test_one_that_dies_is_told_by_its_code_and_the_others_go_on(two: apart.Processes) -> None:
    slow, dies = two.submit(time.sleep, 1.0), two.submit(os._exit, 7)
    with pytest.raises(apart.UnansweredError, match="its process ended with code 7"):
        dies.result()
    assert slow.result() is None
    assert two.submit(math.sqrt, 4.0).result() == 2.0


def test_tasks_have_no_deadline_of_their_own(two: apart.Processes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(apart, "START_S", 0.0)
    assert two.submit(time.sleep, 0.5).result() is None


def test_what_a_task_prints_goes_to_the_standard_error(
    two: apart.Processes, capfd: pytest.CaptureFixture[str]
) -> None:
    two.submit(os.system, "echo from native code; echo and its errors >&2").result()
    two.submit(print, "from Python").result()
    assert capfd.readouterr() == ("", "from native code\nand its errors\nfrom Python\n")


def test_a_task_finds_nothing_to_read(two: apart.Processes) -> None:
    with pytest.raises(EOFError):
        two.submit(input).result()


def test_a_call_that_cannot_be_sent_is_an_error_and_ends_nothing(two: apart.Processes) -> None:
    assert isinstance(two.submit(lambda: 0).exception(), AttributeError | pickle.PicklingError)
    assert two.submit(math.sqrt, 4.0).result() == 2.0


class Unreadable:
    """An argument that can be sent, and raises where it is received."""

    def __reduce__(self) -> tuple[object, tuple[int, int]]:
        return divmod, (1, 0)


def test_a_call_that_cannot_be_read_says_why_and_ends_nothing(two: apart.Processes) -> None:
    with pytest.raises(ZeroDivisionError):
        two.submit(id, Unreadable()).result()
    assert two.submit(math.sqrt, 4.0).result() == 2.0


def test_a_shutdown_waits_for_what_was_asked_and_takes_no_more() -> None:
    with apart.Processes(1) as executor:
        asked = [executor.submit(math.sqrt, float(j)) for j in range(4)]
    assert [answer.result() for answer in asked] == [math.sqrt(j) for j in range(4)]
    assert executor.numbers == []
    with pytest.raises(RuntimeError, match="after the shutdown"):
        executor.submit(math.sqrt, 4.0)


MAIN = """\
from transopt.base.apart import Processes

def triple(number):
    return 3 * number

def asked():
    with Processes(1) as executor:
        print(executor.submit(triple, 14).result())

"""


def _main(tmp_path: Path, last: str, *how: str) -> "subprocess.CompletedProcess[str]":
    (tmp_path / "program.py").write_text(MAIN + last)
    paths = os.pathsep.join([str(ROOT), str(tmp_path)])
    return subprocess.run(
        [sys.executable, *how],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("how", [("program.py",), ("-m", "program")])
def test_a_function_of_the_main_program_is_found(tmp_path: Path, how: tuple[str, ...]) -> None:
    ended = _main(tmp_path, "if __name__ == '__main__':\n    asked()\n", *how)
    assert (ended.stdout, ended.stderr, ended.returncode) == ("42\n", "", 0)


def test_a_main_program_that_would_start_itself_without_end_is_told_so(tmp_path: Path) -> None:
    ended = _main(tmp_path, "asked()\n", "program.py")
    assert ended.returncode == 1
    assert "RuntimeError: the main program starts processes while it is loaded" in ended.stderr


def test_a_main_program_is_not_run_again_for_functions_of_modules(tmp_path: Path) -> None:
    ended = _main(tmp_path, "import math\ntriple = math.sqrt\nprint('runs')\nasked()\n", "program.py")
    assert (ended.stdout, ended.stderr) == ("runs\n3.7416573867739413\n", "")
