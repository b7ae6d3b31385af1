"""The servo in C against the Python servo; `tests/campaigns/test_device_parity.py` in short."""

import functools
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.firmware.build import CORE, FLAGS, STRICT, compiler, sources
from controller.firmware.core_device import REPLAY
from controller.protocol.codes import EVENT_CODES, EVENTS
from controller.servo.interface import Fault, Notice
from tests.benches.core_replay import EXCITE, NEGATIVE, Core, Recorder, write_runs
from tests.benches.device import need_clean
from tests.campaigns.parity_runs import random_run, tap_run
from tests.campaigns.test_device_parity import COMMAND_A, DOUBLE, FLOAT, Difference, heat_differences_K
from transopt.library.library import Library
from transopt.plant.wall import Wall

pytestmark = pytest.mark.usefixtures("c_compiler")

# exp and fmod only where a configuration is checked, never in a servo period.
MAY_CALL = {"memcpy", "memset", "memcmp", "memmove", "sqrt", "floor", "exp", "fmod"}
PROGRAM = [*sources(CORE), REPLAY / "td_replay.c", REPLAY / "replay_main.c"]
EXCITED = (1, 9, 17)  # the host starts what is played
SEEDS = (2, 5, 7, 12, 16, 23, 24, *EXCITED)


@functools.cache
def random_recorder(seed: int) -> Recorder:
    return random_run(seed, 5000)


@pytest.fixture(scope="module")
def played(library: Library) -> list[Recorder]:
    return [tap_run(library, seed) for seed in range(4)]


@pytest.fixture(scope="module", params=[DOUBLE, FLOAT], ids=["double", "single"])
def objects(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the program's object files, compiled with warnings as errors."""
    folder = tmp_path_factory.mktemp("objects")
    command = [*compiler().command, *FLAGS, *STRICT, *request.param, f"-I{CORE}", f"-I{REPLAY}", "-c"]
    done = subprocess.run([*command, *map(str, PROGRAM)], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return folder


def test_the_core_compiles_without_a_warning(objects: Path) -> None:
    assert {path.stem for path in objects.glob("*.o")} == {path.stem for path in PROGRAM}


def test_the_core_keeps_no_state_of_its_own_and_calls_next_to_nothing(objects: Path) -> None:
    core = [str(objects / f"{path.stem}.o") for path in sources(CORE)]
    said = subprocess.run(["nm", "-A", *core], capture_output=True, text=True, check=True).stdout
    symbols = [line.split()[-2:] for line in said.splitlines()]
    kinds = {kind for kind, _ in symbols}
    assert "T" in kinds
    assert not kinds & set("bBdDcCgGsS"), "variables outside any struct"
    defined = {name for kind, name in symbols if kind == "T"}
    called = {name for kind, name in symbols if kind == "U"} - defined
    assert called - {"_GLOBAL_OFFSET_TABLE_"} <= MAY_CALL


@pytest.mark.parametrize("seed", SEEDS)
def test_random_ticks_are_the_same_bit_for_bit(seed: int) -> None:
    found = Difference()
    found.add(random_recorder(seed), DOUBLE)
    assert (found.other_bits, found.other_state, found.other_events) == (0, 0, 0)


def test_taps_on_the_simulator_are_the_same_bit_for_bit(played: list[Recorder]) -> None:
    found = Difference()
    for recorder in played:
        found.add(recorder, DOUBLE)
    assert found.runs == len(played)
    assert (found.other_bits, found.other_state, found.other_events) == (0, 0, 0)


def test_single_precision_stays_within_its_bound(played: list[Recorder]) -> None:
    found = Difference()
    for recorder in (*played, *map(random_recorder, SEEDS)):
        found.add(recorder, FLOAT)
    assert 0.0 < found.command_A <= COMMAND_A
    assert 0.0 < found.winding_K <= 1e-4
    # A comparison that falls the other way is rare enough not to be among these.
    assert found.runs_apart == 0


def test_much_happens_in_these_runs() -> None:
    """Else the comparison means little."""
    seen = {
        EVENTS[int(what)] for seed in SEEDS for what in np.unique(random_recorder(seed).output_rows()["what"]) if what
    }
    assert set(Notice) - seen <= {Notice.NO_GRIP}
    assert set(Fault) - seen <= {Fault.NO_CURRENT, Fault.ENCODER_STUCK, Fault.HOST_STOP, Fault.LATE_TICK}


def test_excitations_are_among_these_runs() -> None:
    """Started, refused while one plays, with either sign, to their end, and cut short by faults."""
    for seed in EXCITED:
        recorder = random_recorder(seed)
        wished, rows = recorder.input_rows()["wishes"], recorder.output_rows()
        started = (rows["answers"] & EXCITE) > 0
        assert set((wished[started] & NEGATIVE) > 0) == {True, False}
        assert EVENT_CODES[Notice.FINISHED] in rows["what"]
        assert EVENT_CODES[Notice.CONTACT] not in rows["what"]
        assert np.any(rows["transient_A"])


@pytest.mark.parametrize("field", ["current_limit_A", "count_m", "wall"])
def test_another_configuration_gives_other_commands(field: str) -> None:
    """The comparison sees what it should see: limits are cut, counts are scaled, walls push."""
    recorder = random_recorder(2)
    changed = {
        "current_limit_A": 0.9 * recorder.settings.current_limit_A,
        "count_m": 1.001 * recorder.settings.count_m,
        "wall": Wall(1.0, 0.0, 1.25, 0, 100.0),
    }
    found = Difference()
    core = Core(replace(recorder.settings, **{field: changed[field]}), recorder.image)  # type: ignore[arg-type]
    found.count(recorder.output_rows(), core.run(recorder.input_rows()))
    assert found.other_bits > 100


def test_pieces_of_a_run_are_the_run() -> None:
    recorder = random_recorder(5)
    rows = recorder.input_rows()
    core = Core(recorder.settings, recorder.image)
    pieces = [core.run(rows[:1]), core.run(rows[1:777]), core.run(rows[777:])]
    assert np.concatenate(pieces).tobytes() == Core(recorder.settings, recorder.image).run(rows).tobytes()


def test_temperatures_agree_over_minutes() -> None:
    worst = heat_differences_K(10.0, 0)
    # The core in double forms the same products, sums and quotients as the host, in the same order and never fused:
    # the bits are the same on any processor.
    assert worst[DOUBLE] == 0.0
    assert worst[FLOAT] <= 1e-3


def test_sanitizers_find_nothing_in_single_precision(played: list[Recorder], tmp_path: Path) -> None:
    """In double precision: the whole device in `test_core_device.py`."""
    write_runs(tmp_path / "runs", [recorder.run_bytes() for recorder in (*played, *map(random_recorder, SEEDS))])
    need_clean("replay", PROGRAM, tmp_path / "runs", FLOAT)
