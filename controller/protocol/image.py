"""The library as a device stores it: int16 waveforms with one scale, axes and the feedback's norms in one block.

    header    HEADER, see IMAGE_FIELDS
    speeds    nv float64 [m/s]       grips   ng float64 [N]
    feedback  nv * ng float64 [A]    norms of the feedback's current beside each, row by row (speed), see `bank.Bank`
    waveforms nv * ng * N int16      counts; a command is count * scale_A, row by row

The norms of the transients do not travel: the device computes them from the counts, as scale_A * sqrt(sum count^2),
which bounds the current's since no amplifier of one pole makes more energy than its command has. The feedback's stand
as stated and bear on the prediction of heat alone: too small a number costs a fault by temperature, not the coil.

Little-endian; all float64 lie on multiples of 8. SHA-256 of the whole is the library's hash. What is played is
what is stored, so the Python servo too plays `bank_of(image)`, not the library's own numbers.
"""

import hashlib
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.protocol.capacity import Capacity
from controller.waveforms.bank import Bank, Method
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.writing import rounded_down

IMAGE_MAGIC = 0x4D494E54  # "TNIM"
IMAGE_VERSION = 2
# (name, struct format) in order; `flags`: bit 0 the grip is looked at, bit 1 nearest node instead of a blend.
IMAGE_FIELDS = (
    ("magic", "I"),
    ("version", "H"),
    ("flags", "H"),
    ("speeds", "H"),
    ("grips", "H"),
    ("samples", "I"),
    ("tail_samples", "I"),
    ("reserved", "I"),
    ("dt_s", "d"),
    ("lead_s", "d"),
    ("scale_A", "d"),
    ("grip_min_N", "d"),
)
HEADER = struct.Struct("<" + "".join(form for _, form in IMAGE_FIELDS))
BY_GRIP, NEAREST = 1, 2
FULL_COUNT = 32767
WALLED_COMMAND = 2.0  # of the command limit: what a transient may ask for beside a wall's feedback


class ImageError(ValueError):
    """No image of this version."""


def image_bytes(speeds: int, grips: int, samples: int) -> int:
    """Size of an image with so many nodes and samples per waveform."""
    nodes = speeds * grips
    return HEADER.size + 8 * (speeds + grips + nodes) + 2 * nodes * samples


def sha256(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()


def image_of(bank: Bank, dt_s: float, lead_s: float, tail_samples: int) -> bytes:
    """The image of a table of transients.

    Parameters
    ----------
    tail_samples : each waveform ends in at least so many zero commands, one or more.

    Raises
    ------
    InputError : no waveforms, one that is no number, or one that does not end in zeros.
    """
    command = np.asarray(bank.command_A, dtype=float)
    if command.size == 0:
        raise InputError(f"method {bank.method.value}: has no waveforms that a device could play")
    peak = float(np.max(np.abs(command)))
    if not np.isfinite(peak):
        raise InputError("library: a command is no number: solve it again")
    if not 0 < tail_samples <= command.shape[-1] or np.any(command[..., -tail_samples:]):
        raise InputError(
            f"library: the last {tail_samples} commands of a waveform are not all zero, which a device asks for: "
            f"use one written by `transopt solve`"
        )
    scale_A = peak / FULL_COUNT if peak > 0 else 1.0
    counts = np.rint(command / scale_A).astype("<i2")
    speeds, grips, samples = command.shape
    flags = BY_GRIP * bank.by_grip | NEAREST * bank.nearest
    head = HEADER.pack(
        IMAGE_MAGIC,
        IMAGE_VERSION,
        flags,
        speeds,
        grips,
        samples,
        tail_samples,
        0,
        dt_s,
        lead_s,
        scale_A,
        bank.grip_min_N,
    )
    tables = (bank.speeds_m_s, bank.grips_N, bank.feedback_A)
    return b"".join([head, *(np.asarray(table, dtype="<f8").tobytes() for table in tables), counts.tobytes()])


def _fields(image: bytes) -> dict[str, Any]:
    """The header's numbers, of an image as long as it says."""
    if len(image) < HEADER.size:
        raise ImageError(f"{len(image)} bytes")
    head = dict(zip((name for name, _ in IMAGE_FIELDS), HEADER.unpack_from(image), strict=True))
    sizes = head["speeds"], head["grips"], head["samples"]
    known = head["magic"] == IMAGE_MAGIC and head["version"] == IMAGE_VERSION
    if not known or min(sizes) < 1 or image_bytes(*sizes) != len(image):
        raise ImageError(f"magic {head['magic']:08x}, version {head['version']}, {len(image)} bytes")
    return head


def too_large(image: bytes, capacity: Capacity) -> str | None:
    """Why an image does not fit a device, with the grid and the rate that would; None if it fits.

    Raises
    ------
    ImageError : not an image.
    """
    head = _fields(image)
    nv, ng, N, dt_s = head["speeds"], head["grips"], head["samples"], head["dt_s"]
    axes_fit = nv <= capacity.speeds and ng <= capacity.grips
    if axes_fit and capacity.waveform_samples >= N and nv * ng * N <= capacity.samples:
        return None
    advice = []
    # A grid of the same proportions, then the same grid at a lower rate or over a shorter time.
    shrink = min(1.0, (capacity.samples / (N * nv * ng)) ** 0.5)
    speeds, grips = (max(1, min(int(n * shrink), most)) for n, most in ((nv, capacity.speeds), (ng, capacity.grips)))
    if capacity.waveform_samples >= N and speeds * grips * N <= capacity.samples:
        advice.append(f"a grid of {speeds} speeds x {grips} grips")
    samples = min(capacity.waveform_samples, capacity.samples // (nv * ng))
    if axes_fit and samples:
        length_ms, rate_kHz = rounded_down(samples * dt_s * 1e3), rounded_down(samples / (N * dt_s) / 1e3)
        advice.append(f"{samples} samples ({length_ms:g} ms, or {rate_kHz:g} kHz)")
    return (
        f"library: {nv} speeds x {ng} grips x {N} samples: the device holds {capacity.speeds} x {capacity.grips}, "
        f"{capacity.waveform_samples} samples each, {capacity.samples} in all: "
        + (f"{' or '.join(advice)} would fit" if advice else "use a device with more memory")
    )


def bank_of(image: bytes) -> tuple[Bank, dict[str, Any]]:
    """The table that an image holds, commands count * scale_A, and its header.

    Raises
    ------
    ImageError : not an image of this version, or not as long as it says.
    """
    head = _fields(image)
    nv, ng, N = head["speeds"], head["grips"], head["samples"]
    numbers = np.frombuffer(image, dtype="<f8", count=nv + ng + nv * ng, offset=HEADER.size)
    speeds, grips, feedback = np.split(numbers, np.cumsum([nv, ng]))
    counts: NDArray[np.int16] = np.frombuffer(
        image, dtype="<i2", count=nv * ng * N, offset=len(image) - 2 * nv * ng * N
    )
    command: FloatArray = counts.astype(float).reshape(nv, ng, N) * head["scale_A"]
    squares = np.sum(counts.astype(np.int64).reshape(nv, ng, N) ** 2, axis=-1)
    transient = head["scale_A"] * np.sqrt(squares.astype(float))
    nearest = bool(head["flags"] & NEAREST)
    table = Bank(
        method=Method.NEAREST if nearest else Method.BILINEAR,
        speeds_m_s=speeds.tolist(),
        grips_N=grips.tolist(),
        command_A=command,
        transient_A=transient.tolist(),
        feedback_A=feedback.reshape(nv, ng).tolist(),
        grip_min_N=head["grip_min_N"],
        by_grip=bool(head["flags"] & BY_GRIP),
        nearest=nearest,
    )
    return table, head
