"""The short form of scripts/nonlinear_plant.py: a force factor that falls by 30 % at full stroke."""

import json
from pathlib import Path

import pytest

from scripts.nonlinear_plant import Found, main, measured
from transopt.base.errors import InputError


def test_the_nonlinear_design_is_at_most_half_as_wrong_as_the_linear_one() -> None:
    (found,) = measured("force", rate_Hz=5e3, targets=1)
    assert found.halved
    assert found.nonlinear <= 0.5 * found.linear
    assert found.linear >= 0.03  # there is something to gain
    assert found.off_replay <= 1e-6
    assert found.gap <= 1e-6


@pytest.mark.long
@pytest.mark.timeout(900)
def test_every_plant_and_target(tmp_path: Path) -> None:
    file = tmp_path / "found.json"
    assert main(json=file) == 0
    found = [Found(**row) for row in json.loads(file.read_text())]
    assert len(found) == 9
    assert all(each.halved and each.off_replay <= 1e-6 for each in found)


def test_another_plant_is_refused() -> None:
    with pytest.raises(InputError, match="--plants spruce: must be some of force, spring, friction"):
        main(plants="spruce")
