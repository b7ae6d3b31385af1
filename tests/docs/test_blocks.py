"""Every code block of every page is run as a reader would run it, or says why not, or is output.

The rule: `text` and `bibtex` are output; `sh`, `python`, `toml` and `c` are run, page by page and in order, in a
folder that holds what the page assumes; a comment before the fence, `<!-- not run: WHY -->`, leaves a block out.
Output that follows a block on the page has to be what the block prints. In its short form the suite reads the blocks
only (`tests/docs/test_pages.py`); `-m long` runs them, which takes a minute.
"""

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.benches.model_parts import amplifier_part, drive_device
from tests.docs.pages import PAGES, fenced, named
from tests.docs.reader import Reader, put_into_a_scene, unsaid
from tests.docs.warm import warm
from transopt.scene.builtin import load_scene
from transopt.scene.model_file import save_part

RUN = ("sh", "python", "toml", "c")
FROM_NOTHING = ("README.md", "docs/start/")  # pages that begin in an empty folder
OWN_TAPS = "docs/start/own_taps.md"  # its reader has recorded taps, and solved scenes before
RECORDINGS = Path(__file__).parents[2] / "problems/recordings"
ON_PAPER = {page: [block for block in fenced(page) if block.language in RUN and not block.why_not] for page in PAGES}


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Programs have a home of their own, and the commands are on the path, loaded already."""
    home = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOME", str(home))
        patch.setenv("XDG_CACHE_HOME", str(home / "cache"))
        with warm(tmp_path_factory.mktemp("commands")) as path:
            patch.setenv("PATH", path)
            yield


@pytest.fixture(scope="module")
def assumed(tmp_path_factory: pytest.TempPathFactory, commands: None) -> Path:
    """What the first steps of the manual leave: a library, and the model file of a device."""
    folder = tmp_path_factory.mktemp("assumed")
    ended = Reader(folder).run("transopt", "solve")
    assert ended.returncode == 0, ended.stderr
    shutil.copy(folder / "out/wood_on_foam/library.npz", folder / "library.npz")
    save_part(folder / "MODEL.json", "device", drive_device())
    save_part(folder / "MODEL.json", "amplifier", amplifier_part())
    return folder


def typed(command: str, folder: Path) -> "subprocess.Popen[str]":
    """A command by itself in a folder, where an interpreter says so if it starts."""
    (folder / "sitecustomize.py").write_text("print('started', flush=True)")
    shell, environment, pipe = (
        ["bash", "-c", f"exec {command}"],
        {**os.environ, "PYTHONPATH": str(folder)},
        subprocess.PIPE,
    )
    return subprocess.Popen(shell, cwd=folder, env=environment, stdout=pipe, stderr=pipe, text=True)


@pytest.mark.long
@pytest.mark.parametrize(
    ("command", "code"),
    [("transopt scene new mine.toml", 0), ("transopt-play doctor --help", 0), ("transopt taps none.csv", 2)],
)
def test_a_command_is_first_cold_and_then_cannot_be_told_from_it(
    command: str, code: int, commands: None, tmp_path: Path
) -> None:
    ends = []
    for name in ("cold", "warm"):
        (tmp_path / name).mkdir()
        with typed(command, tmp_path / name) as process:
            out, errors = process.communicate(timeout=50)
        ends.append((out.replace(name, "cold"), errors.replace(name, "cold"), process.returncode))
    (said, *cold), warm = ends
    assert cold[-1] == code
    assert warm == (said.removeprefix("started\n"), *cold)
    assert said != warm[0]
    assert (tmp_path / "warm/mine.toml").exists() == ("new" in command)


@pytest.mark.long
def test_ctrl_c_ends_it_as_the_cold_one(commands: None, tmp_path: Path, pseudo_terminal: None) -> None:
    ends = []
    for _ in range(2):
        ours, port = os.openpty()
        with typed(f"transopt-play monitor --port {os.ttyname(port)}", tmp_path) as process:
            os.read(ours, 1)  # it has asked who is there
            process.send_signal(signal.SIGINT)
            out, errors = process.communicate(timeout=50)
        ends.append((out, errors, process.returncode))
        os.close(ours)
        os.close(port)
    assert ends[0] == (f"started\n{ends[1][0]}", *ends[1][1:])
    assert ends[0][2] == 130


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("page", [page for page, own in ON_PAPER.items() if own], ids=named)
def test_the_blocks_of_a_page_run_in_their_order(
    page: Path, tmp_path: Path, commands: None, request: pytest.FixtureRequest
) -> None:
    folder = tmp_path / "here"
    if named(page).startswith(FROM_NOTHING):
        folder.mkdir()
    else:
        shutil.copytree(request.getfixturevalue("assumed"), folder)
    if named(page) == OWN_TAPS:
        shutil.copytree(RECORDINGS, folder, dirs_exist_ok=True)
        shutil.copytree(RECORDINGS, folder / "recordings")  # where the scene that is copied there expects them
        for other in ("out/other", "mine"):
            shutil.copytree(request.getfixturevalue("assumed") / "out/wood_on_foam", folder / other)
    reader = Reader(folder)
    for block in ON_PAPER[page]:
        reader.do(block)


def test_what_a_page_quotes_is_held_to_what_is_printed() -> None:
    printed = "┃ tap ┃\n│ 36.23 % │ ok\nJ = 1.02e-3\n"
    assert unsaid("tap\n...\n36.2 % ok\nJ = 1.0e-3\n", printed) == []
    assert unsaid("36.7 % ok\n", printed) == ["36.7 % ok"]
    assert unsaid("J = 1.02e-3\ntap\n", printed) == ["tap"]


def test_tables_of_a_page_make_a_scene_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(put_into_a_scene("[limits]\nsteady_current_A = 1.25\nsupply_V = 9.0\n"))
    scene = load_scene(tmp_path / "mine.toml")
    assert scene.limits.supply_V == pytest.approx(9.0)
    assert scene.limits.beta is None
