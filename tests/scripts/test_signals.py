"""Ctrl-C and SIGTERM at a few random instants of a command and of long searches: the script's short form."""

from pathlib import Path

import pytest
from signals import campaign, commands, line

from transopt.solvers import riccati


@pytest.mark.skipif(not Path("/proc").exists(), reason="what is left is looked for in /proc")
@pytest.mark.skipif(not riccati.available, reason="the extension is not built")
def test_each_ends_in_time_loses_nothing_and_leaves_nothing(tmp_path: Path) -> None:
    searches = [command for command in commands() if command.endless]
    assert len(searches) == 4
    solve = line("transopt solve --no-figures --solver casadi-ipopt --out out", "out")
    for ended in campaign([solve, *searches], 10, 3, 2, tmp_path):
        assert not ended.complaints, f"{ended.command.name}, {ended.signal.name} after {ended.after_s:.3f} s"
