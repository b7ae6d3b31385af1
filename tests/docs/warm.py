"""Commands as children of an interpreter that has loaded what they load: half of a short one's processor time.

A child has its caller's arguments, folder, environment and standard streams, and signals as Python sets them. Its
caller ends as it does. The first run of each command is a process of its own and loads everything, as a user's.
"""

import json
import os
import select
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from transopt.base.threads import one_thread
from transopt.cli import start

BIN = Path(sys.executable).parent
COMMANDS = {"transopt": "transopt", "transopt-play": "play"}  # and their entry points
LOADED = (
    *("transopt.cli.main", "transopt.design.verify", "transopt.library.export", "transopt.report.write"),
    *("transopt.report.taps", "transopt.report.transients", "controller.cli.play", "controller.cli.bench"),
    *("matplotlib.backends.backend_agg", "scipy.signal"),
)
CALLER = """#!{python} -IS
import itertools, json, os, signal, socket, sys
words = itertools.takewhile(str.isalpha, sys.argv[1:3])
try:
    open("-".join(["{folder}/begun", "{name}", *words]), "x")
    os.execv("{program}", sys.argv)
except FileExistsError:
    there = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
there.connect("{folder}/door")
signal.pthread_sigmask(signal.SIG_BLOCK, passed_on := (signal.SIGINT, signal.SIGTERM))
asked = json.dumps(["{name}", sys.argv, os.getcwd(), dict(os.environ)])
socket.send_fds(there, [asked.encode()], [0, 1, 2])
child = int(there.recv(9))
for number in passed_on:
    signal.signal(number, lambda number, frame: os.kill(child, number))
signal.pthread_sigmask(signal.SIG_UNBLOCK, passed_on)
if (code := int(there.recv(9))) < 0:
    signal.signal(-code, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
os._exit(code)
"""


@contextmanager
def warm(folder: Path) -> Iterator[str]:
    """Put the commands into a folder, where they work until the end of the block; yield a path with it in front."""
    for name in COMMANDS:
        (folder / name).write_text(CALLER.format(python=sys.executable, program=BIN / name, folder=folder, name=name))
        (folder / name).chmod(0o755)
    command, pipe = [sys.executable, __file__, folder / "door"], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True) as loaded:
        assert loaded.stdout.readline() == b"ready\n", loaded.stderr.read()
        yield os.pathsep.join([str(folder), str(BIN), os.environ["PATH"]])


def entry_point(door: str) -> str:
    """Wait for callers while the input is open; return in each child, and there what it is to call."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(door)
        listening.listen()
        print("ready", flush=True)
        while 0 not in select.select([listening, 0], [], [])[0]:
            with listening.accept()[0] as caller:
                if os.fork():
                    continue
                asked, streams, *_ = socket.recv_fds(caller, 2**20, 3)
                if child := os.fork():  # only its parent is told how it ends
                    caller.send(b"%d" % child)
                    caller.send(b"%d" % os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
                    os._exit(0)
            for number, stream in enumerate(streams):
                os.dup2(stream, number)
                os.close(stream)
            name, sys.argv, folder, environment = json.loads(asked)
            os.chdir(folder)
            os.environ.clear()
            os.environ.update(environment)
            return COMMANDS[name]
    sys.exit()


if __name__ == "__main__":
    sys.path[0] = str(BIN)  # as where a command is started
    os.environ.update(one_thread(os.environ))  # a fork has no other thread than its own
    for module in LOADED:
        import_module(module)
    getattr(start, entry_point(sys.argv[1]))()
