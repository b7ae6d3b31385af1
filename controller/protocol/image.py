"""The library as a device stores it: int16 waveforms with one scale, axes and the feedback's norms in one block.

    header    HEADER, see IMAGE_FIELDS
    speeds    nv float64 [m/s]       grips   ng float64 [N]
    feedback  nv * ng float64 [A]    norms of the feedback's current beside each, row by row (speed), see `bank.Bank`
    scales    nv * ng float64 [A]    of the cool commands, one for each; only where cool_bits is not 0
    waveforms nv * ng * N int16      counts; a command is count * scale_A, row by row
    cool      nv * ng * N int8 or int16, as cool_bits says: counts of the cool commands, each of its own scale

A library without cool commands has cool_bits 0, and neither scales nor counts of them. Counts of the cool ones
are rounded towards zero, so that in 8 bit they ask for no more than was certified.

The norms of the transients do not travel: the device computes them from the counts, as scale * sqrt(sum count^2),
which bounds the current's since no amplifier of one pole makes more energy than its command has. The feedback's stand
as stated and bear on the prediction of heat alone: too small a number costs a fault by temperature, not the coil.

Little-endian; all float64 stand before the counts and lie on multiples of 8. SHA-256 of the whole is the library's
hash. What is played is what is stored, so the Python servo too plays `bank_of(image)`, not the library's own numbers.
"""

import hashlib
import struct
from typing import Any

import numpy as np

from controller.protocol.capacity import Capacity
from controller.waveforms.bank import Bank, Method
from transopt.base.errors import InputError
from transopt.base.signals import AnyArray, FloatArray
from transopt.base.writing import rounded_down
from transopt.plant.amplifier import Amplifier
from transopt.problem.warm_coil import currents

IMAGE_MAGIC = 0x4D494E54  # "TNIM"
IMAGE_VERSION = 3
# (name, struct format) in order; `flags`: bit 0 the grip is looked at, bit 1 nearest node instead of a blend;
# `cool_bits`: of a count of the cool commands, 0 without them.
IMAGE_FIELDS = (
    ("magic", "I"),
    ("version", "H"),
    ("flags", "H"),
    ("speeds", "H"),
    ("grips", "H"),
    ("samples", "I"),
    ("tail_samples", "I"),
    ("cool_bits", "I"),
    ("dt_s", "d"),
    ("lead_s", "d"),
    ("scale_A", "d"),
    ("grip_min_N", "d"),
)
HEADER = struct.Struct("<" + "".join(form for _, form in IMAGE_FIELDS))
BY_GRIP, NEAREST = 1, 2
FULL_COUNT = 32767
COOL_COUNTS = {8: (127, "<i1"), 16: (FULL_COUNT, "<i2")}  # largest count and its type, by `cool_bits`
ROUNDED = 1e-9  # a quotient so close to a whole number is that number
WALLED_COMMAND = 2.0  # of the command limit: what a transient may ask for beside a wall's feedback


class ImageError(ValueError):
    """No image of this version."""


def image_bytes(speeds: int, grips: int, samples: int, cool_bits: int = 0) -> int:
    """Size of an image with so many nodes and samples per waveform; a device holds the counts of `image_samples`."""
    nodes = speeds * grips
    tables = nodes if cool_bits == 0 else 2 * nodes
    return HEADER.size + 8 * (speeds + grips + tables) + (16 + cool_bits) // 8 * nodes * samples


def image_samples(speeds: int, grips: int, samples: int, cool_bits: int = 0) -> int:
    """How many int16 samples of a device's memory the waveforms take; those of 8 bit take half, rounded up."""
    count = speeds * grips * samples
    return count + (count * cool_bits + 15) // 16


def sha256(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()


def image_of(
    bank: Bank,
    dt_s: float,
    lead_s: float,
    tail_samples: int,
    *,
    cool_bits: int = 16,
    amplifier: Amplifier | None = None,
) -> bytes:
    """The image of a table of transients.

    Parameters
    ----------
    tail_samples : each waveform ends in at least so many zero commands, one or more.
    cool_bits : of a count of the cool commands, 8 or 16; 0 leaves them out. A table without them has none.
    amplifier : in which a rounded cool command makes no larger current than before; None for one without a pole.

    Raises
    ------
    InputError : no waveforms, one that is no number, or one that does not end in zeros.
    """
    command = np.asarray(bank.command_A, dtype=float)
    if command.size == 0:
        raise InputError(f"method {bank.method.value}: has no waveforms that a device could play")
    cool = None if cool_bits == 0 or bank.cool_command_A is None else np.asarray(bank.cool_command_A, dtype=float)
    for each in (command,) if cool is None else (command, cool):
        _check(each, tail_samples)
    peak = float(np.max(np.abs(command)))
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
        0 if cool is None else cool_bits,
        dt_s,
        lead_s,
        scale_A,
        bank.grip_min_N,
    )
    tables: list[Any] = [bank.speeds_m_s, bank.grips_N, bank.feedback_A]
    waveforms = [counts.tobytes()]
    if cool is not None:
        scales, cool_counts = _coarse(cool, cool_bits, amplifier, dt_s)
        tables.append(scales)
        waveforms.append(cool_counts)
    return b"".join([head, *(np.asarray(table, dtype="<f8").tobytes() for table in tables), *waveforms])


def _check(command_A: FloatArray, tail_samples: int) -> None:
    if not np.all(np.isfinite(command_A)):
        raise InputError("library: a command is no number: solve it again")
    if not 0 < tail_samples <= command_A.shape[-1] or np.any(command_A[..., -tail_samples:]):
        raise InputError(
            f"library: the last {tail_samples} commands of a waveform are not all zero, which a device asks for: "
            f"use one written by `transopt solve`"
        )


def _coarse(command_A: FloatArray, bits: int, amplifier: Amplifier | None, dt_s: float) -> tuple[FloatArray, bytes]:
    """Scales (nv, ng) and counts of waveforms that ask for no more command and no more current than these.

    A command that is rounded towards zero can make more current behind a pole, where it was to break the one before.
    The scale is then so much smaller.
    """
    full, form = COOL_COUNTS[bits]
    scales = np.max(np.abs(command_A), axis=-1) / full
    quotients = command_A / np.where(scales > 0, scales, 1.0)[..., None]
    whole = np.rint(quotients)
    counts = np.where(np.abs(quotients - whole) < ROUNDED, whole, np.trunc(quotients))

    def peaks(commands: FloatArray) -> FloatArray:
        return np.asarray(np.max(np.abs(currents(commands, amplifier, dt_s)), axis=-1))

    meant, made = peaks(command_A), peaks(counts * scales[..., None])
    return scales * np.minimum(meant / np.where(made > 0, made, 1.0), 1.0), counts.astype(form).tobytes()


def _fields(image: bytes) -> dict[str, Any]:
    """The header's numbers, of an image as long as it says."""
    if len(image) < HEADER.size:
        raise ImageError(f"{len(image)} bytes")
    head = dict(zip((name for name, _ in IMAGE_FIELDS), HEADER.unpack_from(image), strict=True))
    sizes = head["speeds"], head["grips"], head["samples"], head["cool_bits"]
    known = head["magic"] == IMAGE_MAGIC and head["version"] == IMAGE_VERSION
    known &= head["cool_bits"] in (0, *COOL_COUNTS)
    if not known or min(sizes[:3]) < 1 or image_bytes(*sizes) != len(image):
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
    bits = head["cool_bits"]
    if axes_fit and capacity.waveform_samples >= N and nv * ng * N <= capacity.samples:
        taken = image_samples(nv, ng, N, bits)
        if taken <= capacity.samples:
            return None
        coarse = bits == 16 and image_samples(nv, ng, N, 8) <= capacity.samples
        return (
            f"library: {nv} speeds x {ng} grips x {N} samples with cool commands of {bits} bit are {taken} "
            f"samples, the device holds {capacity.samples} in all: "
            + ("give the cool ones 8 bit" if coarse else "leave the cool ones out")
        )
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
    """The table that an image holds, each command its count times its scale, and the header.

    Raises
    ------
    ImageError : not an image of this version, or not as long as it says.
    """
    head = _fields(image)
    nv, ng, N = head["speeds"], head["grips"], head["samples"]
    nodes, bits = nv * ng, head["cool_bits"]
    tables = [nv, ng, nodes] if bits == 0 else [nv, ng, nodes, nodes]
    numbers = np.frombuffer(image, dtype="<f8", count=sum(tables), offset=HEADER.size)
    speeds, grips, feedback, *scales = np.split(numbers, np.cumsum(tables)[:-1])
    at = HEADER.size + numbers.nbytes

    def waveforms(form: str, offset: int, scale_A: FloatArray) -> tuple[FloatArray, list[list[float]]]:
        counts: AnyArray = np.frombuffer(image, dtype=form, count=nodes * N, offset=offset).reshape(nv, ng, N)
        squares = np.sum(counts.astype(np.int64) ** 2, axis=-1)
        return counts.astype(float) * scale_A[..., None], (scale_A * np.sqrt(squares.astype(float))).tolist()

    command, transient = waveforms("<i2", at, np.full((nv, ng), head["scale_A"]))
    cool, cool_transient = None, []  # type: FloatArray | None, list[list[float]]
    if bits != 0:
        cool, cool_transient = waveforms(COOL_COUNTS[bits][1], at + 2 * nodes * N, scales[0].reshape(nv, ng))
    nearest = bool(head["flags"] & NEAREST)
    table = Bank(
        method=Method.NEAREST if nearest else Method.BILINEAR,
        speeds_m_s=speeds.tolist(),
        grips_N=grips.tolist(),
        command_A=command,
        transient_A=transient,
        feedback_A=feedback.reshape(nv, ng).tolist(),
        grip_min_N=head["grip_min_N"],
        by_grip=bool(head["flags"] & BY_GRIP),
        nearest=nearest,
        cool_command_A=cool,
        cool_transient_A=cool_transient,
    )
    return table, head
