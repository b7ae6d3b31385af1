"""`transopt identify device` and `hand`: what they write, and what they refuse."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from controller.record.trial_file import write_measurement
from problems.generators.tapping_trials import Trials, tapping_trials, write_trials
from tests.benches.identification import ACCELEROMETER_HZ, Rig, assert_near, mismatched
from transopt.base.errors import InputError
from transopt.cli.identify import identify_hand
from transopt.cli.identify_device import identify_device
from transopt.identify.hand.lines import COEFFICIENTS
from transopt.scene.model_file import load_model


@pytest.fixture(scope="module")
def rig() -> Rig:
    """A device 5 % off the nominal one, crossover on."""
    return Rig(mismatched(0.05, 3), crossover_A=0.01)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, rig: Rig) -> Path:
    place = tmp_path_factory.mktemp("records")
    for run in [*rig.sweeps((0.0, 3.0)), *rig.transients((3.0,))]:
        columns = {name: getattr(run, name).values for name in ("command", "current", "acceleration")}
        units = {"command": "command_A", "current": "current_A", "acceleration": "acceleration_m_s2"}
        write_measurement(
            place / run.name,
            {"time_s": run.require("current").times_s, **{units[name]: x for name, x in columns.items()}},
            {"grip_N": run.grip_N or 0.0, "accelerometer_Hz": ACCELEROMETER_HZ},
        )
    return place


def call(*arguments: object) -> tuple[int, str, Exception | None]:
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(identify_device)
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return result.exit_code, result.output, result.exception if isinstance(result.exception, InputError) else None


@pytest.fixture(scope="module")
def plain(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The model file without further options, and what the command says."""
    out = tmp_path_factory.mktemp("plain") / "MODEL.json"
    code, output, _ = call(*sorted(folder.glob("sweep_*")), "--out", out, "--kind", "drive")
    assert code == 0, output
    return out, output


def test_the_command_writes_model_and_figure(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "MODEL.json"
    burst = folder / "burst_3N.npz"
    code, output, _ = call(*sorted(folder.glob("sweep_*")), "--out", out, "--kind", "drive", "--validate", burst)
    assert code == 0, output
    assert "verdict: model error 1.1 % of a tap" in output  # the crossover, which the burst was commanded through
    assert "not counted: the amplifier, which is the scene's and not identified" in output
    assert "the amplifier follows no command below" in output
    assert "which sweeps cannot tell (--force-per-current)" in output
    assert "moving_mass_kg" in output
    part = load_model(out).device
    assert part.kind == "drive"
    assert part.nrmse.keys() == {"3"}
    assert (tmp_path / "MODEL_device.png").read_bytes()[:4] == b"\x89PNG"


def test_what_comes_next_is_said(plain: tuple[Path, str]) -> None:
    out, output = plain
    assert f"next: transopt solve --model {out}\n" in output
    assert output.rstrip().endswith(f'above its first [table] (all that it states may stay):\nmodel_file = "{out}"')


def test_a_force_per_ampere_scales_the_masses(folder: Path, plain: tuple[Path, str], tmp_path: Path) -> None:
    files, out = sorted(folder.glob("sweep_*")), tmp_path / "2.5.json"
    assert call(*files, "--out", out, "--kind", "drive", "--force-per-current", 2.5)[0] == 0
    scenes, twice = (load_model(path).device for path in (plain[0], out))
    assert scenes.kind == twice.kind == "drive"
    assert twice.moving_mass_kg == pytest.approx(2 * scenes.moving_mass_kg, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--out", "model.txt"), "a model file ends in .json"),
        (("--kind", "chain"), "--kind chain: unknown; choose auto, drive, state_space"),
        (("--force-per-current", "-1"), "--force-per-current -1 N/A: must be above 0"),
        (("--force-per-current", "1", "--scene", "own_taps"), "give one of them"),
        (("--kind", "drive", "--order", "6"), "leave it out with --kind drive"),
        (("--kind", "state_space", "--order", "5"), "--order 5: must be even"),
    ],
)
def test_options_that_cannot_be_are_refused_in_one_line(
    options: tuple[str, ...], message: str, folder: Path, tmp_path: Path
) -> None:
    out = () if "--out" in options else ("--out", tmp_path / "M.json")
    code, _, error = call(folder / "sweep_0N_0.npz", folder / "sweep_0N_1.npz", *out, *options)
    assert code != 0
    assert message in str(error)
    assert not (tmp_path / "M.json").exists()


def test_the_free_device_alone_gives_a_black_box(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "M.json"
    code, _, _ = call(*sorted(folder.glob("sweep_0N*")), "--out", out, "--order", "2")
    assert code == 0
    part = load_model(out).device
    assert part.kind == "state_space"
    assert_near(part.plant(0.0), mismatched(0.05, 3).plant(0.0))


def test_taps_without_a_sweep_are_refused_by_name(folder: Path, tmp_path: Path) -> None:
    out, taps = tmp_path / "M.json", []
    for name in ("burst_3N", "sweep_3N_0"):
        with np.load(folder / f"{name}.npz") as columns:
            np.savez(tmp_path / f"{name}.npz", **columns, held_out=1.0)
        taps.append(tmp_path / f"{name}.npz")
    code, _, error = call(*taps, "--out", out)
    assert code != 0
    assert "none of the 2 files is a sweep to fit to, all are held out or repeat" in str(error)
    assert not out.exists()
    # What the line tells to do.
    code, output, error = call(taps[0], *sorted(folder.glob("sweep_3N*")), "--out", out, "--kind", "drive")
    assert (code, error) == (0, None), output


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
