"""The recordings of a scene, read from its files or simulated, and the references made of them."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from transopt.base.errors import InputError
from transopt.base.shown import cut
from transopt.base.signals import FloatArray
from transopt.plant.intention import FreeMotion
from transopt.recordings.recording import Recording
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import read_recordings as read_files
from transopt.references.references import References, build_references
from transopt.references.references import sampled_again as taps_sampled_again
from transopt.references.targets import target_references
from transopt.scene import strikes
from transopt.scene.scene import Scene

Files = str | Path | Sequence[str | Path]


def read_recordings(given: Recordings | Files) -> list[Recording]:
    """Load the taps in files; a file with several gives one recording per tap.

    Parameters
    ----------
    given : the table `[recordings]` of a scene, or paths of files and of folders whose files are all read.

    Raises
    ------
    InputError : neither of these, or a file or a setting that `transopt.recordings.tap.read_recordings` refuses.
    """
    return read_files(given if isinstance(given, Recordings) else _of_files(given, Recordings()))


def _of_files(given: object, settings: Recordings) -> Recordings:
    """Settings by which these files are read, in place of their own files or simulated taps."""
    paths = [given] if isinstance(given, str | Path) else list(given) if isinstance(given, Sequence) else [given]
    names: list[str] = []
    for path in paths:
        if not isinstance(path, str | Path):
            raise InputError(
                f"recordings: {cut(repr(path), 60)} is neither a Recording nor the path of a file or folder"
            )
        own = Path(path).resolve()
        names += map(str, sorted(each for each in own.iterdir() if each.is_file()) if own.is_dir() else [own])
    return settings.model_copy(update={"files": tuple(names), "simulated": None})


def recordings_in(scene: Scene, given: Sequence[Recording] | Files) -> list[Recording]:
    """Recordings as they are, or those in files, which are read as the scene's table `[recordings]` says.

    Raises
    ------
    InputError : as of `read_recordings`.
    """
    if not isinstance(given, str | Path):
        loaded = [each for each in given if isinstance(each, Recording)] if isinstance(given, Sequence) else []
        if isinstance(given, Sequence) and len(loaded) == len(given):
            return loaded
    return read_files(_of_files(given, scene.recordings))


def recordings_of(scene: Scene) -> list[Recording]:
    """The taps that a scene shall reproduce, read from its files or simulated.

    Raises
    ------
    InputError : a file that cannot be read or used.
    """
    if scene.recordings.simulated is not None:
        return strikes.recordings(scene)
    return read_files(scene.recordings) if scene.recordings.files else []


class FreeOf:
    """The motion without current of the stylus in a scene's recordings, by its table `[hand]`."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._kept = scene, dict[float, FreeMotion]()

    def __call__(self, speed_m_s: float, grip_N: float, incoming_m_s2: float) -> Callable[[FloatArray], FloatArray]:
        if grip_N not in self._kept:
            self._kept[grip_N] = self._scene.free_motion(grip_N)
        return partial(self._kept[grip_N].acceleration_m_s2, speed_m_s, incoming_m_s2)


def references_of(scene: Scene, recordings: Sequence[Recording]) -> References:
    """Reference accelerations at all speeds and grips from the scene's recordings, or for each of its named targets.

    Raises
    ------
    InputError : unsuitable recordings, or a target's file that cannot be read.
    """
    if scene.targets:
        return target_references(scene.targets, scene.time_grid(), scene.recordings)
    grid = scene.grid
    return build_references(
        recordings, grid.speeds_m_s, grid.grips_N, scene.time_grid(), scene.recordings, FreeOf(scene)
    )


def sampled_again(scene: Scene, references: References) -> References:
    """References of the scene's recordings or targets, sampled on the scene's new time axis.

    Raises
    ------
    InputError : a recording or a target that does not cover the time axis.
    """
    if scene.targets:
        return references_of(scene, ())
    return taps_sampled_again(references, scene.time_grid(), FreeOf(scene))
