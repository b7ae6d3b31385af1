"""The recordings that a scene names, from its files or simulated."""

from collections.abc import Sequence

from transopt.recordings.recording import Recording
from transopt.recordings.reference import Reference, build_reference, build_references
from transopt.recordings.tap import read_recordings
from transopt.recordings.targets import target_reference, target_references
from transopt.scene import strikes
from transopt.scene.scene import Scene


def recordings_of(scene: Scene) -> list[Recording]:
    """The taps that a scene shall reproduce: read from its files, or made by its own simulated strikes.

    Raises
    ------
    InputError : a file that cannot be read or used.
    """
    if scene.recordings.simulated is not None:
        return strikes.recordings(scene)
    return read_recordings(scene.recordings) if scene.recordings.files else []


def references_of(scene: Scene, recordings: Sequence[Recording]) -> list[Reference]:
    """What the device has to do at each speed of the scene, from its recordings, or for each of its named targets.

    Raises
    ------
    InputError : recordings that cannot serve, a target's file that cannot be read.
    """
    if scene.targets:
        return target_references(scene.targets, scene.time_grid(), scene.recordings)
    return build_references(recordings, scene.grid.speeds_m_s, scene.time_grid(), scene.recordings)


def sampled_again(scene: Scene, reference: Reference) -> Reference:
    """A reference of the scene's recordings or targets on the scene's time axis, which is another one now.

    Raises
    ------
    InputError : a recording or a target that does not fit the time axis.
    """
    grid = scene.time_grid()
    if reference.name:
        (target,) = (each for each in scene.targets if each.name == reference.name)
        return target_reference(target, grid, scene.recordings)
    return build_reference(reference.speed_m_s, reference.taps, reference.factors, grid, scene.recordings)
