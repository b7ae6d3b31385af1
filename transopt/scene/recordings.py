"""The recordings that a scene names, from its files or simulated."""

from collections.abc import Sequence

from transopt.recordings.recording import Recording
from transopt.recordings.reference import Reference, build_references
from transopt.recordings.tap import read_recordings
from transopt.recordings.targets import target_references
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
