"""Every code block of every page is run as a reader would run it, or says why not, or is output.

The rule: `text` and `bibtex` are output; `sh`, `python`, `toml` and `c` are run, page by page and in order, in a
folder that holds what the page assumes; a comment before the fence, `<!-- not run: WHY -->`, leaves a block out.
Output that follows a block on the page has to be what the block prints. In its short form the suite reads the blocks
only (`tests/docs/test_pages.py`); `-m long` runs them, which takes a minute.
"""

import shutil
from pathlib import Path

import pytest

from tests.benches.model_parts import amplifier_part, drive_device
from tests.docs.pages import PAGES, fenced, named
from tests.docs.reader import Reader, put_into_a_scene, unsaid
from transopt.scene.builtin import load_scene
from transopt.scene.model_file import save_part

RUN = ("sh", "python", "toml", "c")
FROM_NOTHING = ("README.md", "docs/start/")  # pages that begin in an empty folder
OWN_TAPS = "docs/start/own_taps.md"  # its reader has recorded taps, and solved scenes before
RECORDINGS = Path(__file__).parents[2] / "problems/recordings"
ON_PAPER = {page: [block for block in fenced(page) if block.language in RUN and not block.why_not] for page in PAGES}


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def assumed(tmp_path_factory: pytest.TempPathFactory, home: Path) -> Path:
    """What the first steps of the manual leave: a library, and the model file of a device."""
    folder = tmp_path_factory.mktemp("assumed")
    ended = Reader(folder, home).run("transopt", "solve")
    assert ended.returncode == 0, ended.stderr
    shutil.copy(folder / "out/wood_on_foam/library.npz", folder / "library.npz")
    save_part(folder / "MODEL.json", "device", drive_device())
    save_part(folder / "MODEL.json", "amplifier", amplifier_part())
    return folder


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("page", [page for page, own in ON_PAPER.items() if own], ids=named)
def test_the_blocks_of_a_page_run_in_their_order(
    page: Path, tmp_path: Path, home: Path, request: pytest.FixtureRequest
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
    reader = Reader(folder, home)
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
