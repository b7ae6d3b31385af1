"""A quick scene, solved, and the command line in an empty folder."""

from functools import partial
from pathlib import Path

import pytest

import problems
from tests.benches.commands import Run, Terminal

EXAMPLES = problems.FOLDER / "recordings"
# One speed, one grip, from the shipped files.
QUICK = (
    problems.scene_path("own_taps")
    .read_text()
    .replace("[0.2, 0.3, 0.4]", "[0.2]")
    .replace("[1.0, 3.0, 5.0]", "[3.0]")
    .replace('folder = "../recordings"\nfiles = ["tap_*.csv"]', f'files = ["{EXAMPLES.as_posix()}/tap_0.2_m_s.csv"]')
)


@pytest.fixture
def run(terminal: Terminal) -> Run:
    """Run `transopt ARGS` in an empty folder."""
    return partial(terminal, "transopt")


@pytest.fixture(scope="module")
def quick_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "quick.toml"
    path.write_text(QUICK.replace('motor = "motors/', f'motor = "{problems.FOLDER.as_posix()}/motors/'))
    return path


@pytest.fixture
def solved(run: Run, quick_scene: Path) -> Path:
    """Folder of a solved one-entry library."""
    assert run("solve", quick_scene, "--out", "solved").code == 0
    return Path("solved")
