"""The simulated device that a command refers to: that of a scene, with its imperfections."""

from pathlib import Path

from controller.sim.simulator import Imperfections, true_device
from controller.sim.true_device import TrueDevice, device_of
from transopt.library.file import load_library
from transopt.scene.builtin import load_scene
from transopt.scene.scene import Scene


def scene_like(named: str | Path) -> Scene:
    """A scene by built-in name or by path, or the one that a library was solved from.

    Raises
    ------
    InputError : the name is neither a scene nor a library.
    """
    path = Path(named)
    return load_library(path).scene() if path.suffix.lower() == ".npz" else load_scene(str(named))


def device_in(scene: Scene, wrong: Imperfections, seed: int) -> TrueDevice:
    """The true device of a scene: that of `transopt-play tap --simulate` with the same mismatch and seed."""
    return true_device(device_of(scene), wrong, seed)
