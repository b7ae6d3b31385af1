"""`transopt identify hand`: the part and the figure it writes, its verdict and what it refuses."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import typer

from problems.generators.tapping_trials import FOURTH_ORDER_STYLUS_KG, Trials, tapping_trials, write_trials
from transopt.base.errors import InputError
from transopt.cli.identify import identify_hand
from transopt.identify.hand.fourth_order import NAMES
from transopt.identify.hand.lines import COEFFICIENTS
from transopt.scene.model_file import load_model


@pytest.fixture(scope="module")
def trials() -> Trials:
    return tapping_trials(1)


@pytest.fixture
def files(tmp_path: Path) -> Callable[[Trials], list[Path]]:
    return lambda trials: write_trials(trials, tmp_path / "session")


def test_the_command_writes_part_and_figure(
    trials: Trials, files: Callable[[Trials], list[Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "MODEL.json"
    identify_hand(files(trials)[::2], out)
    part = load_model(out).hand
    assert part.parameters == list(COEFFICIENTS)
    assert part.mass_kg.constant == pytest.approx(0.215, rel=0.06)
    assert part.grips_N[0] == trials.grip_N[::2].min()
    assert part.grips_N[-1] == trials.grip_N[::2].max()
    assert len(part.sources) == 41
    assert part.verdict.startswith("supports designs with a second_order hand")
    assert part.kind == "second_order"
    # What a scene builds from it is the hand of the lines.
    plant = part.plant(5.0, force_per_current_N_A=1.0)
    assert 1 / plant.D[0, 0] == pytest.approx(part.mass_kg.constant + 5 * part.mass_kg.per_newton, rel=1e-12)
    assert (tmp_path / "MODEL_hand.png").read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "fourth order: determined: " in printed
    assert "verdict: supports designs" in printed


def test_a_hand_of_fourth_order_is_the_hands_model(files: Callable[[Trials], list[Path]], tmp_path: Path) -> None:
    out = tmp_path / "MODEL.json"
    identify_hand(files(tapping_trials(3, hand="fourth_order"))[::2], out)
    part = load_model(out).hand
    assert part.kind == "fourth_order"
    assert part.parameters == list(NAMES)
    assert part.verdict.startswith("supports designs with a fourth_order hand from 0.95 to 10 N")
    assert part.stylus_mass_kg == pytest.approx(FOURTH_ORDER_STYLUS_KG, rel=0.03)


def test_taps_that_carry_neither_hand_end_with_those_that_would(
    files: Callable[[Trials], list[Path]], tmp_path: Path
) -> None:
    out = tmp_path / "MODEL.json"
    with pytest.raises(typer.Exit) as stop:
        identify_hand(files(tapping_trials(3, hand="fourth_order"))[::6], out)
    assert stop.value.exit_code == 1
    content = json.loads(out.read_text(encoding="utf-8"))["hand"]
    assert content["kind"] == "second_order"
    assert re.search(
        r"^not fit to design with: how this hand answers a tap at .* record \d+ taps", content["verdict"]
    )


def test_the_command_refuses_its_options(
    trials: Trials, files: Callable[[Trials], list[Path]], tmp_path: Path
) -> None:
    paths = files(trials)[:3]
    with pytest.raises(InputError, match=r"model\.toml: a model file ends in \.json"):
        identify_hand(paths, tmp_path / "model.toml")
    with pytest.raises(InputError, match=r"--window 1 s: must be 0\.01 to 0\.1 s"):
        identify_hand(paths, tmp_path / "model.json", 1.0)
    with pytest.raises(InputError, match=r"3 taps: at least 12"):
        identify_hand(paths, tmp_path / "model.json")
    assert not (tmp_path / "model.json").exists()
