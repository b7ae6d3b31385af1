"""Measured frequency responses, acceleration over current or voltage: read from CSV, text, NPZ, MAT and UFF files.

Tables have a column of frequencies and either magnitude and phase or real and imaginary part, with names and units as
instruments write them (`transopt.files.names`). A universal file holds a response in its dataset 58
(`transopt.files.universal_file`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from transopt.base.errors import InputError
from transopt.base.files import read_file
from transopt.base.shown import brief
from transopt.base.signals import ComplexArray, FloatArray
from transopt.base.sizes import MOST_RECORD_BYTES
from transopt.files.formats import read_raw, refuse_idle
from transopt.files.names import Layout, Meaning, Vocabulary, quote
from transopt.files.raw_table import MIN_SAMPLES, RawTable
from transopt.files.unclear import in_file
from transopt.files.units import INPUTS, RATIOS, TURNED, parts

LARGEST = 1e9  # m/s^2 per A or V: far above every actuator, and its square does not overflow
WORDS = Vocabulary(
    columns=(
        *("frequency_Hz", "frequency_kHz"),
        *("magnitude", "magnitude_m_s2", "magnitude_g", "magnitude_dB"),
        *("phase_deg", "phase_rad"),
        *("real", "imaginary", "imag"),
    ),
    header={},
    required=("frequency",),
    step_s=(0.0, 0.0),
)
PAIRS = (("real", "imaginary"), ("magnitude", "phase"))


@dataclass(frozen=True)
class MeasuredResponse:
    """A frequency response as measured.

    Attributes
    ----------
    frequencies_Hz : (m,) increasing, above 0.
    response : (m,) complex acceleration over input [m/s^2 per A or V].
    driven_by : input of the response, "current" or "voltage", if file or user state it; else empty.
    notes : what a user should know about the units, one sentence each.
    turned : what reads the response with the other sign of its phase.
    """

    frequencies_Hz: FloatArray
    response: ComplexArray
    driven_by: str = ""
    notes: tuple[str, ...] = ()
    turned: str = ""

    __repr__ = brief


def read_response(
    path: Path, layout: Layout | None = None, *, scale: float = 1.0, driven_by: str = ""
) -> MeasuredResponse:
    """Read one response; the format follows from the suffix.

    Parameters
    ----------
    path : .csv, .txt, .dat, .npz, .mat (-v6 or -v7), .unv, .uff or .u58.
    layout : names and units of columns that the file does not state.
    scale : factor that converts the response to m/s^2 per A or V.
    driven_by : the input that the user states, "current" or "voltage"; empty to take it from the file.

    Raises
    ------
    InputError : one line, file first, that says what is wrong; also for an option that does not apply to a response
        or contradicts the file.
    """
    data = read_file(path, MOST_RECORD_BYTES, "name a file with a measured frequency response")
    layout = layout or Layout()
    with in_file(path):
        if not (math.isfinite(scale) and scale != 0):
            raise InputError(f"--scale {scale}: must be a number other than 0")
        if path.suffix.lower() == ".wav":
            raise InputError("a WAV file holds a signal, no frequency response; export the response as CSV")
        if layout.rate_Hz is not None:
            raise InputError(f"--rate-Hz {layout.rate_Hz:g}: a response has frequencies and no times; leave it out")
        refuse_idle(layout, [path.suffix])
        with np.errstate(all="ignore"):  # an overflow from absurd values becomes inf, which the check refuses
            raw = read_raw(path.suffix, data, layout, WORDS)
            frequencies_Hz, response, meanings = _of_table(raw)
            found = _checked(frequencies_Hz, scale * response)
        _agreeing(meanings, driven_by)
    notes = [each.note for each in raw.meanings.values()]
    # A level in dB is not converted; its scale states the value at 0 dB.
    stated = next((each.stated for each in meanings.values() if each.stated and not math.isnan(each.unit.factor)), "")
    if stated and not math.isclose(abs(scale), 1.0):
        notes.append(
            f"{stated} is converted to m/s^2 per A or V, and --scale {scale:g} multiplies besides: leave it out if "
            "it stands for the unit"
        )
    per = next(iter(meanings.values())).unit.per
    driven_by, notes = driven_by or per, list(dict.fromkeys(filter(None, notes)))
    turned = _turned(raw.meanings, INPUTS[driven_by or "current"])
    return replace(found, driven_by=driven_by, notes=tuple(notes), turned=turned)


def _turned(columns: Mapping[str, Meaning], per: str) -> str:
    """What reads a response with the other sign of its phase, by the meanings of its columns.

    Parameters
    ----------
    per : unit of the input, for parts without a unit.
    """
    stated = {each.quantity: each.stated for name, each in columns.items() if not name.endswith(" part)")}
    if "phase" in stated:
        return f"--units phase={_other(stated['phase'])}"
    if "imaginary" in stated:
        unit = stated["imaginary"] or f"m/s^2/{per}"
        return f"--units real={stated['real'] or unit},imaginary={_other(unit)}"
    return "save its complex conjugate"


def _other(unit: str) -> str:
    """The unit of the other sign."""
    return unit.removeprefix(TURNED) if unit.startswith(TURNED) else f"{TURNED}{unit}"


def _agreeing(meanings: Mapping[str, Meaning], driven_by: str) -> None:
    """Refuse a stated input that contradicts the unit.

    Parameters
    ----------
    meanings : of the columns that have a unit of the response.
    """
    # Both parts of a complex array have the same unit.
    keys = ["magnitude" if name.endswith(" part)") else each.quantity for name, each in meanings.items()]
    for each in meanings.values():
        if driven_by and each.unit.per and each.unit.per != driven_by:
            unit = f"{parts(each.stated)[0]}/{INPUTS[driven_by]}"
            remedy = ",".join(f"{key}={unit}" for key in dict.fromkeys(keys))
            raise InputError(
                f"--input {driven_by}: its unit {each.stated} says that the response is to a {each.unit.per}; leave "
                f"--input out, or state --units {remedy}"
            )


def _checked(frequencies_Hz: FloatArray, response: ComplexArray) -> MeasuredResponse:
    """The points above 0 Hz, in increasing order of frequency."""
    bad = ~(np.isfinite(frequencies_Hz) & (np.abs(response) <= LARGEST))
    if bad.any():
        k = int(bad.argmax())
        raise InputError(
            f"point {k + 1}: {frequencies_Hz[k]:g} Hz, {response[k]:g}: must be finite and at most {LARGEST:g} m/s^2 "
            "per A or V in size; check units and scale"
        )
    order = np.argsort(frequencies_Hz, kind="stable")
    f, G = frequencies_Hz[order], response[order]
    f, G = f[f > 0], G[f > 0]  # an analyser's first line is at 0 Hz, where an accelerometer measures nothing
    twice = np.flatnonzero(np.diff(f) <= 0)
    if twice.size:
        raise InputError(f"{f[twice[0]]:g} Hz stands there twice; average repeated measurements first")
    if f.size < MIN_SAMPLES:
        raise InputError(f"{f.size} frequencies above 0, at least {MIN_SAMPLES} are needed; measure more")
    return MeasuredResponse(f, G)


def _of_table(raw: RawTable) -> tuple[FloatArray, ComplexArray, Mapping[str, Meaning]]:
    """Frequencies [Hz], response [m/s^2 per A or V], and the meanings of the columns in a unit of the response."""
    columns = {each.quantity: (raw.columns[name], each.unit.factor) for name, each in raw.meanings.items()}
    raw.rows()
    pair = next((pair for pair in PAIRS if all(part in columns for part in pair)), None)
    if pair is None or sum(part in columns for other in PAIRS for part in other) > 2:
        raise InputError(
            f"columns {quote(', '.join(raw.columns))}: a response has frequency_Hz and either magnitude (or "
            "magnitude_dB) and phase_deg (or phase_rad), or real and imaginary; name these by --columns, - skips one"
        )
    meanings = {name: each for name, each in raw.meanings.items() if each.quantity in RATIOS}
    if len({(each.unit.per, each.unit.slopes) for each in meanings.values()}) > 1:
        listed = " and ".join(f"{name} in {each.stated or 'no stated unit'}" for name, each in meanings.items())
        raise InputError(f"{listed}: state the unit of both by --units real=m/s^2/V,imaginary=m/s^2/V")
    values, factor = columns["frequency"]
    (one, by), (other, other_by) = columns[pair[0]], columns[pair[1]]
    frequencies_Hz = values * factor
    # Mobility and receptance are differentiated to an accelerance.
    slopes = max(each.unit.slopes for each in meanings.values())
    slope = np.asarray((2j * np.pi * frequencies_Hz) ** slopes, dtype=complex)
    if pair[0] == "real":
        return frequencies_Hz, slope * (one * by + 1j * other * other_by), meanings
    magnitude = 10 ** (one / 20) if math.isnan(by) else one * by
    if magnitude.min() < 0:
        raise InputError("a magnitude is negative: is it in dB? name the column magnitude_dB")
    G = np.asarray(slope * magnitude * np.exp(1j * other * other_by), dtype=complex)
    return frequencies_Hz, G, meanings
