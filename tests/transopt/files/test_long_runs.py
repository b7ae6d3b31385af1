"""Long runs of one character in a text: each is read or refused in one pass, and keeps nobody waiting for ever.

A pattern that can match a run by two of its parts tries all divisions of it. The runs here would then take hours, and
the test's time limit would end them.
"""

from pathlib import Path

import pytest

from transopt.base.errors import InputError
from transopt.recordings.recording import load_recording

LONG = 20_000
ROWS = "".join(f"{k * 1e-4:.4f},{0.1 * (k % 7):.1f}\n" for k in range(100))
RUNS = [
    "rate" + LONG * " " + "Hz",
    "a" + LONG * " " + "x",
    LONG * "sampl_",
    LONG * "a_",
    "acc" + LONG * "/",
    LONG * "ab",
]
PLACES = {
    "remark": "# {}\ntime_s,acc_g\n" + ROWS,
    "metadata": "{}\ntime_s,acc_g\n" + ROWS,
    "name": "time_s,{}\n" + ROWS,
    "row": "time_s,acc_g\n" + ROWS + "{}\n" + ROWS,
    "footer": "time_s,acc_g\n" + ROWS + "{}\n",
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("run", RUNS, ids=lambda run: run[:5].strip())
def test_a_long_run_ends(run: str, place: str, tmp_path: Path) -> None:
    path = tmp_path / "tap.csv"
    path.write_text(PLACES[place].format(run))
    said = ""
    try:
        load_recording(path)
    except InputError as refused:
        said = str(refused)
    assert "\n" not in said
