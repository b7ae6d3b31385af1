"""The shipped recordings."""

from pathlib import Path

import numpy as np

import problems

EXAMPLES = problems.FOLDER / "recordings"


def test_shipped_recordings_are_what_the_generator_writes(tmp_path: Path) -> None:
    from problems.generators.strikes import write_examples

    write_examples(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == sorted(path.name for path in EXAMPLES.iterdir())
    assert len(names) == 3
    for name in names:
        fresh, shipped = (np.loadtxt(f / name, delimiter=",", skiprows=4) for f in (tmp_path, EXAMPLES))
        np.testing.assert_allclose(fresh, shipped, atol=2e-4)  # the last digit may round differently elsewhere
