"""The core on emulated processors; `tests/campaigns/test_firmware_targets.py` in short."""

from dataclasses import replace
from pathlib import Path

import pytest

from controller.firmware.build import NoCompilerError, compiler
from tests.campaigns import test_firmware_targets as firmware_targets
from tests.campaigns.test_firmware_targets import (
    TARGETS,
    Found,
    MissingToolError,
    Target,
    misses,
    need_tools,
    play,
    record,
    rows,
)
from transopt.base.errors import InputError

CORTEX_M7 = TARGETS[1]
QUICK = ("Cortex-M4F",)  # the campaign, which .ci/run runs, has all of them


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    try:
        need_tools()
        compiler()
    except (MissingToolError, NoCompilerError) as missing:
        pytest.skip(str(missing))
    return record(tmp_path_factory.mktemp("records"), seed=0, library=None, runs=2, ticks=500)


@pytest.mark.parametrize(
    "target",
    [
        pytest.param(target, id=target.name, marks=() if target.name in QUICK else (pytest.mark.long,))
        for target in TARGETS
    ],
)
def test_a_target_answers_as_the_host_does(target: Target, records: dict[str, Path], tmp_path: Path) -> None:
    found = play(target, records, tmp_path)
    assert set(found.hashes) == {"runs", "talks"}
    assert not misses({target: found})
    assert found.counts["runs servo"][0] == found.counts["talks device"][0] == 1000
    for _, average, most in found.counts.values():
        assert 0 < average <= most
    assert found.text_bytes < 43_008  # 42 of the 1024 kB of flash that an STM32F405 has
    assert 0 < found.stack_bytes < 8192
    if target.library:
        # What src/transopt_port.h promises: RAM2 of a Teensy with room for USB, and a third of 192 kB for others.
        assert found.device_bytes < (470_000 if "Teensy" in target.name else 120_000)
    assert f"{target.name} | {target.precision} | {found.text_bytes}" in "".join(rows({target: found}))


@pytest.mark.parametrize(
    ("command", "device", "held", "said"),
    [
        (500, 10_000, 5600, ""),
        (540, 10_000, 5600, "540 instructions beside the servo before the command is out"),
        (500, 10_000, 5640, "5640 instructions for which the interrupt is held"),
        (500, 16_800, 5600, "a tick of"),
    ],
)
def test_a_tick_that_is_too_long_or_kept_out_is_told(command: int, device: int, held: int, said: str) -> None:
    most = {"command_own": command, "device": device, "held": held}
    found = Found(counts={f"talks {name}": (1, 1.0, instructions) for name, instructions in most.items()})
    lines = misses({TARGETS[0]: found})
    assert len(lines) == (1 if said else 0)
    assert said in "".join(lines)


@pytest.mark.long
def test_contracted_products_would_be_seen_and_a_program_that_fails_is_told(
    records: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the ban the processor's fused multiply-add gives other bits: the hash is worth something."""
    contracted = replace(CORTEX_M7, flags=("-ffp-contract=fast",))
    found = play(contracted, records, tmp_path)
    assert not found.alike()
    assert "| NO |" in "".join(rows({CORTEX_M7: found}))
    cut = tmp_path / "cut"
    cut.write_bytes(records["runs"].read_bytes()[:-1])
    monkeypatch.setattr(firmware_targets, "compile_core", lambda *_: sorted(tmp_path.glob("*.o")))
    with pytest.raises(InputError, match="qemu-system-arm: ended with 1"):
        play(contracted, {"runs": cut}, tmp_path)


def test_missing_tools_are_named_with_their_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingToolError, match=r"arm-none-eabi-gcc: not found; install gcc-arm-none-eabi"):
        need_tools()
    with pytest.raises(pytest.skip.Exception, match="install"):
        firmware_targets.main()
