"""The campaign of hostile files in short; all of it with `-m long`."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benches.places import ROOT

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the campaign forks, and its pipes are POSIX's")
KINDS = ("bit flips", "altered and hashed again", "recordings", "scenes and special files")


def campaign(folder: Path, *counts: int) -> str:
    """What the script prints, every fault of it included."""
    options = zip(("--flips", "--altered", "--recordings", "--scenes"), map(str, counts), strict=True)
    done = subprocess.run(
        [
            sys.executable,
            str(ROOT / "scripts" / "hostile_files.py"),
            *(word for option in options for word in option),
        ],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert list(folder.iterdir()) == [], "something was left behind"
    return done.stdout


def test_in_short(tmp_path: Path) -> None:
    said = campaign(tmp_path, 6, 20, 12, 12)
    for kind in KINDS:
        assert re.search(rf"^{kind}: \d+ cases, \d+ accepted, 0 wrong, at most ", said, re.MULTILINE), said


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_all_of_it(tmp_path: Path) -> None:
    campaign(tmp_path, 500, 500, 300, 100)
