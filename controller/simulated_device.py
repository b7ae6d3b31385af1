"""Which simulated device a command means: a scene's, with what is wrong with it."""

from pathlib import Path

from controller.open_loop import true_device
from controller.options import within
from controller.prediction import scene_of
from controller.simulator import Imperfections
from controller.truth import Device, device_of
from transopt.library_file import load_library
from transopt.scene import Scene


def find_scene(scene: str) -> Scene:
    """A scene by built-in name or by path.

    Raises
    ------
    InputError : there is none, or it cannot be used.
    """
    import problems
    from transopt.scene_file import load_scene

    path = Path(scene) if scene.lower().endswith(".toml") else problems.scene_path(scene)
    return load_scene(path, search=[problems.FOLDER])


def scene_like(named: str | Path) -> Scene:
    """A scene by built-in name or by path, or the one that a library was solved from.

    Raises
    ------
    InputError : it is none of these.
    """
    path = Path(named)
    return scene_of(load_library(path)) if path.suffix.lower() == ".npz" else find_scene(str(named))


def imperfect(mismatch: float, seed: int, crossover: float) -> Imperfections:
    """From the options --mismatch, --seed and --crossover.

    Raises
    ------
    InputError : a number out of its range.
    """
    within("mismatch", mismatch, 0.0, 0.5, ", the part by which parameters are off")
    within("crossover", crossover, 0.0, 1.0, " A")
    within("seed", seed, 0, 2**63 - 1)
    return Imperfections(mismatch=mismatch, crossover_A=crossover)


def device_in(scene: Scene, wrong: Imperfections, seed: int) -> Device:
    """The true device of a scene: that of `transopt-play tap --simulate` with the same mismatch and seed."""
    return true_device(device_of(scene), wrong, seed)
