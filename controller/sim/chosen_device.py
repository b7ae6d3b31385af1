"""The simulated device that a command refers to: that of a scene, with its imperfections."""

from pathlib import Path

from controller.sim.simulator import Imperfections, true_device
from controller.sim.true_device import TrueDevice, device_of
from controller.waveforms.prediction import scene_of
from transopt.library.file import load_library
from transopt.scene.scene import Scene


def find_scene(scene: str) -> Scene:
    """A scene by built-in name or by path.

    Raises
    ------
    InputError : there is no such scene, or it is invalid.
    """
    from transopt.scene import builtin

    return builtin.load_scene(scene)


def scene_like(named: str | Path) -> Scene:
    """A scene by built-in name or by path, or the one that a library was solved from.

    Raises
    ------
    InputError : the name is neither a scene nor a library.
    """
    path = Path(named)
    return scene_of(load_library(path)) if path.suffix.lower() == ".npz" else find_scene(str(named))


def device_in(scene: Scene, wrong: Imperfections, seed: int) -> TrueDevice:
    """The true device of a scene: that of `transopt-play tap --simulate` with the same mismatch and seed."""
    return true_device(device_of(scene), wrong, seed)
