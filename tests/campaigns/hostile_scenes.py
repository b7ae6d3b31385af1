"""Scenes that no honest user writes: absurd values, wrong types, places outside the folder, escape codes."""

import os
import random
from collections.abc import Iterator
from pathlib import Path

from tests.campaigns.hostile_cases import REFUSED, Case
from transopt.scene.builtin import SCENES

SOLVED = (0, 1)  # a result, or one that fell short and says why
SOLVE = ("transopt", "solve", "scene.toml", "--no-figures", "--out", "solved")
SHOW = ("transopt", "show", "library.npz")
VALUES = (
    "0", "-1", "1e-9", "1e-300", "1e12", "1e300", "inf", "nan", "true", '"x"', "[]", "[1, 1]", "{}", "10", "0.001",
    "20000", "1e-6", "1e6", "100", "[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]",
    "9" * 5000, "1979-05-27", '"\\u001b[31m"', "[[1.0]]",
)  # fmt: skip

# What stands in a scene that no number can: each line takes the place of the first, or stands above all.
ODD_LINES = {
    "name outside": 'name = "../../x"',
    "name with a slash": 'name = "a/b"',
    "name of dots": 'name = ".."',
    "empty name": 'name = ""',
    "long name": f'name = "{"n" * 5000}"',
    "escape codes": 'description = "\\u001b]0;owned\\u0007\\u001b[2J"',
    "zero byte in a folder": 'recordings.folder = "a\\u0000b"',
    "zero byte in a motor": 'motor = "a\\u0000b"',
    "long motor": f'motor = "{"m" * 5000}"',
    "model is a device": 'model = "/dev/zero"',
    "model is a folder": 'model = "/"',
    "own limits are a device": 'limits.own = ["/dev/zero"]',
    "deep lists": f"deep = {'[' * 5000}{']' * 5000}",
    "deep but short": f"deep = {'[' * 60}{']' * 60}",
    "deep tables": f"{'.'.join('a' * 3000)} = 1",
    "a million digits": f"hand_over_samples = {'9' * 1_000_000}",
    "two megabytes": f"# {'x' * 2_000_000}",
}


def scenes(folder: Path, count: int, chance: random.Random) -> Iterator[Case]:
    """A small scene with one or two of its values replaced, and with lines that nobody would write."""
    text = (SCENES / "single_grip.toml").read_text(encoding="utf-8").replace('"../', f'"{SCENES.parent}/')
    text += "\n[time]\nstages = 100\n" if "[time]" not in text else ""
    for j, (name, line) in enumerate(ODD_LINES.items()):
        if j >= count:
            return
        key = line.split("=")[0].strip()
        kept = [each for each in text.splitlines() if each.split("=")[0].strip() != key]
        (folder / "scene.toml").write_text("\n".join([line, *kept]), encoding="utf-8")
        yield Case(f"scene: {name}", SOLVE, REFUSED)
    yield from _special_files(folder)
    lines = text.splitlines()
    places = [k for k, line in enumerate(lines) if "=" in line and not line.startswith("#")]
    for j in range(len(ODD_LINES), count):
        changed, said = list(lines), []
        for k in chance.sample(places, chance.choice([1, 1, 2])):
            key, value = lines[k].split("=", 1)[0].strip(), chance.choice(VALUES)
            changed[k] = f"{key} = {value}"
            said.append(f"{key} = {value[:12]}")
        (folder / "scene.toml").write_text("\n".join(changed), encoding="utf-8")
        yield Case(f"scene {j}: {', '.join(said)}", SOLVE, (*SOLVED, 2))


def _special_files(folder: Path) -> Iterator[Case]:
    """Pipes, folders, devices and names that are no text, in place of every kind of file."""
    os.mkfifo(folder / "pipe.toml")
    os.mkfifo(folder / "pipe.npz")
    os.mkfifo(folder / "pipe.csv")
    (folder / "folder.npz").mkdir(exist_ok=True)
    yield Case("pipe as a scene", ("transopt", "solve", "pipe.toml", "--out", "solved"), REFUSED)
    for command in (("transopt", "show"), ("transopt", "verify"), ("transopt-play", "tap")):
        more = ("--simulate",) if command[-1] == "tap" else ()
        for file in (
            "pipe.npz",
            "folder.npz",
            "/dev/zero",
            "/dev/null",
            "absent.npz",
            "\udcff\udcfe.npz",
            "\x1b[31m.npz",
        ):
            yield Case(f"{command[-1]} of {file!a}", (*command, file, *more), REFUSED)
    for file in ("pipe.csv", "/dev/zero", "\udcff.csv", "a\nb.csv"):
        yield Case(f"taps of {file!a}", ("transopt", "taps", file, "--speed", "0.3"), REFUSED)
    (folder / "\udcff.toml").write_text("not a scene", encoding="utf-8")
    yield Case("scene under a name that is no text", ("transopt", "solve", "\udcff.toml"), REFUSED)
