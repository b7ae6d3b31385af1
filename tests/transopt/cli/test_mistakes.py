"""The likeliest mistakes of a person: each ends in one line that says what is wrong, where, and what to do."""

import math
import shutil
from pathlib import Path

import pytest

from controller.device.circuit_file import CIRCUITS
from tests.benches.commands import Terminal, assert_refused
from tests.benches.places import ROOT
from transopt.library.library import Library

SCENE = (ROOT / "problems/scenes/wood_on_foam.toml").read_text(encoding="utf-8")
TAP = (ROOT / "problems/recordings/tap_0.2_m_s.csv").read_text(encoding="utf-8")
SIMULATED = SCENE[SCENE.index("# The undriven device") : SCENE.index("[model]")]
TIMES = [f"{1e-4 * k:.4f}" for k in range(1000)]
# File -> what stands in it, beside a library.npz and a folder `out` with one in it.
FILES = {
    "mine.toml": SCENE,
    "open.toml": SCENE.replace("[grid]", "[grid"),
    "comma.toml": SCENE.replace("stylus_mass_kg = 0.026", "stylus_mass_kg = 0,026"),
    "unit.toml": SCENE.replace("stylus_mass_kg = 0.026", 'stylus_mass_kg = "26 g"'),
    "gram.toml": SCENE.replace("stylus_mass_kg = 0.026", "stylus_mass_kg = 26.0"),
    "cm.toml": SCENE.replace("[0.1, 0.2, 0.3, 0.4]", "[10, 20, 30, 40]"),
    "none.toml": SCENE.replace(SIMULATED, ""),
    "lost.toml": SCENE.replace(SIMULATED, "").replace("[recordings]", '[recordings]\nfiles = ["taps/*.csv"]'),
    "circuit.toml": CIRCUITS["escon_re25"].read_text(encoding="utf-8"),
    "volt.toml": SCENE.replace("beta = 3.2", "voltage_V = 12.0"),
    "tap.csv": TAP,
    "empty.csv": "",
    "head.csv": "time_s,acceleration_g\n",
    "bare.csv": "\n".join(f"{t},{math.sin(float(t)):.4f}" for t in TIMES),
    "unitless.csv": "\n".join(["time,acc", *(f"{t},0.1" for t in TIMES)]),
    "flat.csv": "\n".join(["# speed_m_s: 0.2", "time_s,acceleration_g", *(f"{t},1.0" for t in TIMES)]),
    "speedless.csv": "\n".join(
        ",".join(line.split(",")[:2]) for line in TAP.splitlines() if not line.startswith("# speed")
    ),
    "model.json": "{}",
    "response.csv": "\n".join(["frequency_Hz,magnitude", *(f"{f},1.0" for f in range(20, 500, 5))]),
    "text.txt": "hello",
}
LRA = "--resonance-Hz 150 --quality 8 --force-factor-N-A 0.8 --R-ohm 8 --peak 3"
MISTAKES = {
    # a word
    "transopt tap library.npz --simulate": ("tap: a command of transopt-play", "type transopt-play tap"),
    "transopt-play solve": ("solve: a command of transopt", "type transopt solve"),
    "transopt slove": ("slove: no such command", "did you mean solve?"),
    "transopt identify tap.csv": ("no such command", "choose one of amplifier, device, hand, coil"),
    "transopt solve mine.toml --ouput x": ("--ouput: no such option", "did you mean --out?"),
    "transopt taps tap.csv --rate 10000": ("--rate: no such option", "did you mean --rate-Hz"),
    "transopt solve wood_on_foma": ("no built-in scene", "did you mean wood_on_foam?"),
    "transopt solve mine.toml --solver ipopt": ("--solver ipopt", "casadi-ipopt"),
    "transopt study --study lede --out x": ("no such study", "did you mean lead?"),
    "transopt plant new lra --kind coil": ("--kind coil", "choose inertial, voice_coil, shaker"),
    # a file, a folder
    "transopt solve mine": ("mine: no built-in scene", "did you mean mine.toml?"),
    "transopt solve nowhere.toml": ("nowhere.toml: no such file", "`transopt scene list`"),
    "transopt solve tap.csv": ("tap.csv: no scene", "`transopt taps tap.csv --scene mine.toml`"),
    "transopt solve library.npz": ("library.npz: no scene", "`transopt show library.npz`"),
    "transopt solve mine.toml --out text.txt": ("--out text.txt", "choose another folder"),
    "transopt solve mine.toml --model none.json": ("none.json: no such file", "`transopt identify device"),
    "transopt solve mine.toml --model model.json": ("model.json: no model file", "`transopt identify`"),
    "transopt show": ("'library'", "give a library.npz written by `transopt solve`"),
    "transopt show out": ("out: a folder", "did you mean out/library.npz?"),
    "transopt show mine.toml": ("mine.toml: ", "give a library.npz written by `transopt solve`"),
    "transopt show none.npz": ("none.npz: no such file", "give a library.npz"),
    "transopt-play tap out --simulate": ("out: a folder", "did you mean out/library.npz?"),
    "transopt export library.npz x.xlsx": ("x.xlsx: ", ".mat, .csv, .wav, .h"),
    "transopt export library.npz nowhere/x.mat": ("there is no folder nowhere", "create it"),
    "transopt scene new mine.toml": ("mine.toml: exists already", "--force"),
    "transopt scene new other": ("other: ", "name it other.toml"),
    "transopt-play device new new.toml --from circuit.toml": (
        "a circuit file",
        "device circuit circuit.toml` writes offered",
    ),
    "transopt-play device show never.toml": ("never.toml: no such file", "`transopt-play device new FILE`"),
    # a scene
    "transopt solve open.toml": ("open.toml: not valid TOML", ": [grid"),
    "transopt solve comma.toml": ("comma.toml: not valid TOML", "stylus_mass_kg = 0,026", "a decimal point"),
    "transopt solve unit.toml": ("model.stylus_mass_kg = '26 g'", "without quotes and unit"),
    "transopt solve gram.toml": ("model.stylus_mass_kg = 26 kg", "did you mean 26 g", "--accept"),
    "transopt solve cm.toml": ("grid.speeds_m_s = 10 m/s", "did you mean 10 cm/s", "--accept"),
    "transopt solve none.toml": ("none.toml: recordings", "files or a simulated table"),
    "transopt solve lost.toml": ("'taps/*.csv' matches no file", "--recordings FOLDER"),
    "transopt solve volt.toml": ("limits.voltage_V", "state its limits in A"),
    # recordings
    "transopt taps": ("no recording named", "--template tap.csv"),
    "transopt taps none.csv": ("none.csv: no such file", "tap_*.csv"),
    "transopt taps empty.csv": ("empty.csv: is empty", "export it again"),
    "transopt taps head.csv": ("head.csv: 0 samples", "record a longer piece"),
    "transopt taps bare.csv": ("no row of names", "--columns 'time"),
    "transopt taps unitless.csv": ("no unit stated", "--units 'time=s,acceleration="),
    "transopt taps flat.csv": ("flat.csv: ", "constant", "sensor connected"),
    "transopt taps speedless.csv": ("no incoming speed", "--speed 0.2"),
    "transopt taps tap.csv --units acceleration=gg": ("'gg' is no unit", "m/s^2, g"),
    "transopt taps library.npz": ("a library of currents, no recording", "`transopt show` prints it"),
    "transopt taps mine.toml": ("unknown format '.toml'", "export it as CSV"),
    # a study, a datasheet
    "transopt study": ("study: say what to vary", "--vary limits.current_A=3,4,5 --out cost"),
    "transopt study --vary limits.current_A=3,4": ("--out: give a folder", "--out cost"),
    "transopt study --vary limits.curent_A=3,4 --out x": ("limits.curent_A", "did you mean limits.current_A"),
    "transopt study --vary limits.current_A=2-5 --out x": ("a range is START:STOP:COUNT", "2:5:5"),
    "transopt study --vary limits.current_A=2..4 --out x": ("write limits.current_A=2:4:5", "limits.current_A=2,4"),
    "transopt study --vary motor.R_ohm=1,2 --out x": ("motor.R_ohm", "motor=A,B"),
    f"transopt plant new lra {LRA} --moving-mass-kg 3 --case-mass-kg 0.1": ("3 kg", "did you mean 3 g", "--accept"),
    "transopt plant fit response.csv --order 4 --out p.npz": ("frequency_Hz, magnitude", "phase_deg", "--columns"),
    # a device
    "transopt-play tap library.npz": ("name one device", "--simulate, or --port PORT"),
    "transopt-play check": ("'--port'", "`transopt-play ports` lists the ports"),
    "transopt-play tap library.npz --port /dev/ttyNOWHERE": ("no such port; ", "there"),
    "transopt-play tap library.npz --simulate --speed 20": ("--speed 20", "0.03 to 4.5 m/s"),
    "transopt-play record sweep --simulate --grips 1 3 5 --out s": ("(3 5)", "as 1,3,5"),
    "transopt-play tap library.npz --simulate --device device.toml": ("device.toml: no such file", "device new FILE"),
}


@pytest.fixture(scope="module")
def desk(library: Library, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what a person has there."""
    folder = tmp_path_factory.mktemp("desk")
    for name, content in FILES.items():
        (folder / name).write_text(content, encoding="utf-8")
    library.save(folder / "library.npz")
    (folder / "out").mkdir()
    shutil.copy(folder / "library.npz", folder / "out")
    return folder


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_named_with_what_to_do(
    line: str, desk: Path, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(desk)
    before = sorted(desk.rglob("*"))
    assert_refused(terminal(*line.split()), *MISTAKES[line])
    assert sorted(desk.rglob("*")) == before, "a refused command leaves nothing behind"
