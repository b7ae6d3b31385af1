"""The recordings that the points of a study use."""

import hashlib
import math
from collections.abc import Sequence

import numpy as np

from transopt.base.errors import InputError
from transopt.recordings.recording import Recording
from transopt.recordings.tap import read_recordings
from transopt.scene.keys import Changes, with_values
from transopt.scene.scene import Scene
from transopt.scene.sections import WINDOW_S
from transopt.scene.strikes import recordings as simulated_recordings
from transopt.study.axes import Axis

MARGIN_S = 5e-3  # the recordings of a simulated scene outlast its horizon by twice this


class StudyRecordings:
    """The recordings of a study: those of its scene, whatever device is varied.

    Simulated recordings are made with the scene's own device, and are long enough for the longest horizon of all
    points. All points use the same taps, so that their errors can be compared. Only if keys of `recordings` are
    varied are they simulated or read again.
    """

    def __init__(self, scene: Scene, axes: Sequence[Axis]) -> None:
        self._scene = scene
        # Cache of the last call: its changes as text, the recordings, their digest.
        self._last: tuple[str, tuple[Recording, ...], str] = ("", (), "")
        longest: dict[str, float] = {"time.dt_s": scene.time.dt_s, "time.stages": scene.time.stages or 0}
        amplifier = scene.amplifier_model()
        longest["amplifier.delay_s"] = 0.0 if amplifier is None else amplifier.delay_s
        for axis in axes:
            if axis.key in longest:
                longest[axis.key] = max(map(float, axis.values))
        # A scene without time.stages has a window of at most 80 ms, whatever its servo period.
        window_s = longest["time.dt_s"] * longest["time.stages"] or WINDOW_S
        self._longer_s = window_s + longest["amplifier.delay_s"] - scene.time.dt_s * scene.stages

    def of(self, changes: Changes) -> tuple[tuple[Recording, ...], str]:
        """The recordings for a point of the plan, and their SHA-256, which identifies them."""
        own = {key: value for key, value in changes.items() if key.startswith("recordings.")}
        if repr(own) == self._last[0]:
            return self._last[1], self._last[2]
        taken = tuple(self._take(own))
        digest = hashlib.sha256()
        for one in taken:
            digest.update(f"{one.name} {one.speed_m_s} {one.grip_N} {one.acceleration.dt_s}".encode())
            digest.update(np.ascontiguousarray(one.acceleration.values).tobytes())
        self._last = (repr(own), taken, digest.hexdigest())
        return taken, digest.hexdigest()

    def _take(self, own: Changes) -> list[Recording]:
        try:
            scene = with_values(self._scene, own)
        except InputError:
            scene = self._scene  # the point is refused for this value when it is solved
        if scene.recordings.simulated is None:
            return read_recordings(scene.recordings)
        if self._longer_s > MARGIN_S:
            stages = scene.stages + math.ceil(self._longer_s / scene.time.dt_s)
            scene = with_values(scene, {"time.stages": stages, "thermal.tap_rate_Hz": None})
        return simulated_recordings(scene)
