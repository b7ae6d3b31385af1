"""The recordings that a scene names, from its files or simulated."""

from transopt.recordings.recording import Recording
from transopt.recordings.tap import read_recordings
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
    return read_recordings(scene.recordings)
