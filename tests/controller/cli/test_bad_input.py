"""Input that no command takes: one line that says what, and no device is touched."""

import pytest

from tests.benches.commands import Run, assert_refused
from tests.benches.desk import Desk


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("tap library.npz", "tap: name one device: --simulate, or --port PORT"),
        ("tap library.npz --simulate --port desk", "tap: name one device"),
        ("tap library.npz --port desk --speed 0.2", "--speed: on a device that is up to its user"),
        ("tap library.npz --port desk --real-time", "--real-time: "),
        ("tap library.npz --simulate --taps 2", "--taps: only with --port"),
        ("tap library.npz --simulate --for 2", "--for: only with --port"),
        ("tap library.npz --port desk --gain 1.5", "--gain 1.5: must be 0 to 1"),
        ("tap library.npz --port desk --taps 0", "--taps 0: must be 1 to "),
        ("tap library.npz --port desk --device with_gripp", "no such file (did you mean with_grip"),
        ("tap library.npz --port desk --device none.toml", "none.toml: no such file; a device file is TOML"),
        ("tap missing.npz --port desk", "missing.npz"),
        ("monitor --port desk --every 0", "--every 0: must be 1 to 65535 ticks"),
        ("monitor --port desk --for -1", "--for -1: must be "),
        ("check --port desk --skip polarity", "--skip polarity: must be one of emergency-stop"),
        ("check --port desk --step polarty", "--step polarty: must be one of link, emergency-stop"),
        ("check --port desk --grip-weight-g 1", "--grip-weight-g 1: must be 10 to 5000 g"),
        ("check --port desk --patience 0", "--patience 0: must be "),
        ("record tap --port desk --out x --trigger 0", "--trigger 0: must be "),
        ("record tap --port desk --out /proc/x", "--out /proc/x: cannot be written"),
        ("tap library.npz --port desk --out /proc/x", "--out /proc/x: cannot be written"),
        ("tap library.npz --simulate --speed 0", "--speed 0: must be 0.03 to 4.5 m/s"),
        ("tap library.npz --simulate --speed nan", "--speed nan"),
        ("tap library.npz --simulate --grip -1", "--grip -1"),
        ("tap library.npz --simulate --method magic", "--method magic: must be one of bilinear"),
        ("tap library.npz --simulate --method proportional", "--method proportional: plays a wall's feedback alone"),
        ("tap library.npz --simulate --user robot", "--user robot: must be one of recorded, brakes"),
        ("tap library.npz --simulate --out library.npz", "--out library.npz"),
        ("refine library.npz --out x", "refine: name one device"),
        ("refine library.npz --out x --simulate --port desk", "refine: name one device"),
        ("refine library.npz --out x --simulate --for 3", "--for: only with --port"),
        ("refine library.npz --out x --port desk --mismatch 0.1", "--mismatch: only with --simulate"),
        ("refine library.npz --out x --simulate --rounds 0", "--rounds 0: must be 1 to 20"),
        ("refine library.npz --out x --simulate --taps 1", "--taps 1: must be 2 to 100"),
        ("record sweep --out x", "record sweep: name one device"),
        ("record sweep --simulate --out x --for hand", "--for hand: must be one of amplifier, device"),
        ("record sweep --simulate --out x --grips a", "--grips a: must be numbers with commas between"),
        ("record sweep --simulate --out x --high 6000", "sweep: high 6000 Hz"),
        ("record sweep --simulate --out x --amplitude 5", "the current reaches 5 A, the limit is 4 A"),
        ("record sweep --simulate --out x --mismatch 2", "--mismatch 2: must be 0 to 0.5"),
        ("record sweep --simulate --out x --true-device none", "none: no built-in scene"),
        ("record sweep --port desk --out x --true-device none", "--true-device: only with --simulate"),
        ("record tap --out x", "record tap: name one device"),
        ("record tap --out x --simulate", "name either a LIBRARY whose taps are played, or --object"),
        ("record tap library.npz --out x --simulate --object", "name either a LIBRARY"),
        ("record tap library.npz --out x --port desk", "library: only with --simulate"),
        ("record tap --out x --object --port desk", "--object: only with --simulate"),
        ("record tap --out x --object --simulate --for 3", "--for: only with --port"),
        ("record tap --out x --object --simulate --grips 0,3", "--grips 0: only a sweep"),
        ("record tap --out x --object --simulate --true-device own_taps", "states no simulated object"),
        ("record tap none.npz --out x --simulate", "none.npz: no such file"),
        ("record heat --out x", "record heat: name the device"),
        ("record heat --simulate --out x --current 9", "--current 9: must be 0 to 4 A"),
        ("record heat --simulate --out x --current 2", "would pass its limit of 100 C"),
        ("record heat --simulate --out x --heating 1 --cooling 1", "fewer than ten readings"),
        ("record heat --simulate --out /proc/x", "--out /proc/x: cannot be written"),
    ],
)
def test_bad_input_is_one_line(play: Run, desk: Desk, line: str, words: str) -> None:
    assert_refused(play(*line.split()), words)
    assert desk.ticks == 0
