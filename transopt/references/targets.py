"""Named targets: motions other than taps that an actuator shall make, such as a click, a thud, a texture.

A target has no incoming speed, no grip and no hand: it begins at time 0, and the motor has to make all of it. It is
stated by parameters or read from a file. Shapes, over the time t from 0 on with w = 2 pi f:

- burst: an envelope times sin(w t) over the stated number of cycles, the envelope `flat`, `half_sine` or `hann`;
- decay: exp(-t / tau) sin(w t), how a struck object rings (Wellman and Howe 1995; Okamura et al. 2001);
- half_sine: sin(pi t / T), the classical shock pulse of shaker tests (IEC 60068-2-27), T half a period of f.

Each is scaled so that its largest value is the stated peak.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from transopt.base.errors import InputError
from transopt.base.filters import lowpass
from transopt.base.section import Finite, Name, NonNegative, Positive, Section, Words
from transopt.base.signals import FloatArray, Signal
from transopt.plant.time_grid import TimeGrid
from transopt.recordings.recording import load_recording
from transopt.recordings.settings import Recordings
from transopt.references.reference import Reference
from transopt.references.references import References

FINE = 4000  # number of instants at which the largest value of a shape is searched
GONE = 1e-4  # of its peak: a decay ends at this level


class TargetTable(Section):
    """One named target: its shape and numbers, or a file that holds it.

    `file` is read like a recording, with the keys of `[recordings]`; `start_s` is the instant in it at which the
    target begins, `length_s` how long it is, `scale` what it is multiplied with.

    Attributes
    ----------
    name : name of the target, its waveform and its files.
    shape : a sine under an envelope, a sine that dies away, or half a sine.
    frequency_Hz : frequency of the sine.
    cycles : periods of a burst.
    envelope : envelope of a burst.
    decay_s : time constant of a decay.
    peak_m_s2 : largest acceleration of the shape.
    file : recording of the target, in place of a shape.
    start_s : instant in the file at which the target begins.
    length_s : how long the target is in the file.
    scale : factor on the file.
    """

    name: Name
    shape: Literal["burst", "decay", "half_sine"] | None = None
    frequency_Hz: Annotated[float, Field(ge=0.1, le=1e5)] | None = None
    cycles: Annotated[float, Field(gt=0, le=1e4)] | None = None
    envelope: Literal["flat", "half_sine", "hann"] = "hann"
    decay_s: Positive | None = None
    peak_m_s2: Finite | None = None
    file: Words | None = None
    start_s: NonNegative = 0.0
    length_s: Positive | None = None
    scale: Finite = 1.0

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if (self.shape is None) == (self.file is None):
            raise ValueError(f"{self.name}: give either shape or file, not both and not neither")
        needed = {
            "burst": ("frequency_Hz", "cycles"),
            "decay": ("frequency_Hz", "decay_s"),
            "half_sine": ("frequency_Hz",),
        }
        for key in (*needed.get(self.shape or "", ()), *(["peak_m_s2"] if self.shape else [])):
            if getattr(self, key) is None:
                raise ValueError(f"{self.name}: shape = {self.shape} needs {key}")
        if self.peak_m_s2 == 0 or self.scale == 0:
            raise ValueError(f"{self.name}: a target of zero asks for nothing: give peak_m_s2 and scale other than 0")
        return self

    @property
    def lasts_s(self) -> float:
        """Duration of a shape; a decay ends at the share `GONE` of its peak."""
        assert self.frequency_Hz is not None
        if self.shape == "decay":
            assert self.decay_s is not None
            return float(-np.log(GONE) * self.decay_s)
        return 0.5 / self.frequency_Hz if self.shape == "half_sine" else (self.cycles or 0.0) / self.frequency_Hz

    def course(self, times_s: FloatArray) -> FloatArray:
        """Acceleration of a shape at these instants, in an array of the same shape [m/s^2]."""
        found = self._form(np.linspace(0.0, self.lasts_s, FINE))
        assert self.peak_m_s2 is not None
        inside = (times_s >= 0) & (times_s <= self.lasts_s)
        return np.asarray(np.where(inside, self._form(times_s), 0.0) * (self.peak_m_s2 / np.abs(found).max()))

    def _form(self, t: FloatArray) -> FloatArray:
        assert self.frequency_Hz is not None
        carrier = np.sin(2 * np.pi * self.frequency_Hz * t)
        if self.shape == "decay":
            assert self.decay_s is not None
            return np.asarray(np.exp(-np.maximum(t, 0.0) / self.decay_s) * carrier)
        if self.shape == "half_sine" or self.envelope == "flat":
            return np.asarray(carrier)
        bell = np.sin(np.pi * t / self.lasts_s)
        return np.asarray(carrier * (bell if self.envelope == "half_sine" else bell**2))


def _of_file(target: TargetTable, settings: Recordings) -> tuple[Signal, str]:
    """The acceleration in a target's file, low-passed, and the file's SHA-256."""
    assert target.file is not None
    path = Path(settings.folder) / target.file
    recording = load_recording(path, settings.layout())
    signal = recording.acceleration
    begins, ends = target.start_s, signal.end_s if target.length_s is None else target.start_s + target.length_s
    if not signal.start_s <= begins < ends <= signal.end_s + signal.dt_s:
        raise InputError(
            f"targets.{target.name}: {path} lasts from {signal.start_s:g} to {signal.end_s:g} s, the target from "
            f"{begins:g} to {ends:g} s: change start_s and length_s"
        )
    return lowpass(signal, settings.lowpass_Hz), recording.sha256


def target_reference(target: TargetTable, grid: TimeGrid, settings: Recordings) -> Reference:
    """The reference of a target at the switching instants.

    Raises
    ------
    InputError : the file cannot be read or is too short; the target lasts longer than the waveform.
    """
    signal: Signal | None = None
    sha256 = ""
    if target.file is None:
        ends_s = target.lasts_s
    else:
        signal, sha256 = _of_file(target, settings)
        ends_s = (signal.end_s if target.length_s is None else target.start_s + target.length_s) - target.start_s
    if ends_s > grid.end_s:
        shorten = "shorten the target" if target.file is None else f"state length_s of the target in {target.file}"
        raise InputError(
            f"targets.{target.name}: lasts {ends_s * 1e3:.4g} ms, the waveform ends at {grid.end_s * 1e3:.4g} ms: "
            f"raise time.stages or {shorten}"
        )

    def at(instants_s: FloatArray) -> FloatArray:
        if signal is None:
            return target.course(instants_s)
        inside = (instants_s >= 0) & (instants_s <= ends_s)
        values = np.zeros(instants_s.shape)
        values[inside] = target.scale * signal.at(instants_s[inside] + target.start_s)
        return values

    now, after = at(grid.switching_times_s), at(grid.after_times_s)
    before = at(grid.before_times_s)
    nothing = np.zeros(grid.stages)
    return Reference(
        speed_m_s=0.0,
        grip_N=0.0,
        recorded_m_s2=now,
        recorded_before_m_s2=before,
        recorded_after_m_s2=after,
        free_m_s2=nothing,
        free_before_m_s2=np.zeros_like(before),
        free_after_m_s2=np.zeros_like(after),
        nominal_position_m=nothing,
        nominal_velocity_m_s=nothing,
        nominal_position_at_ticks_m=np.zeros(grid.stages + grid.after_stages),
        repeatability=float("nan"),
        repeatability_unaligned=float("nan"),
        taps=(),
        factors=np.zeros(0),
        name=target.name,
        ends_s=ends_s,
        peak_m_s2=float(np.abs(at(np.linspace(0.0, ends_s, FINE))).max()),
        sha256=sha256,
    )


def target_references(targets: Sequence[TargetTable], grid: TimeGrid, settings: Recordings) -> References:
    """The references of all targets of a scene.

    Raises
    ------
    InputError : see `target_reference`.
    """
    return References(tuple(target_reference(target, grid, settings) for target in targets))
