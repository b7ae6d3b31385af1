"""A quick scene, solved, and the command line in an empty folder."""

import shutil
from functools import partial
from pathlib import Path

import pytest

import problems
from tests.benches.commands import Run, Terminal, captured

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


@pytest.fixture(scope="session")
def quick_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "quick.toml"
    path.write_text(QUICK.replace('motor = "motors/', f'motor = "{problems.FOLDER.as_posix()}/motors/'))
    return path


@pytest.fixture(scope="session")
def written(quick_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `transopt solve` writes of the quick scene, with its figures; not to be changed."""
    folder = tmp_path_factory.mktemp("written") / "solved"
    assert captured("transopt", "solve", quick_scene, "--out", folder).code == 0
    return folder


@pytest.fixture
def solved(run: Run, written: Path) -> Path:
    """Folder of a solved one-entry library, with all that is written of it."""
    return Path(shutil.copytree(written, "solved"))
