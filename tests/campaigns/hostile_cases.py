"""Inputs that no honest user makes: damaged and altered libraries, fuzzed recordings, scenes with absurd values.

Each generator yields cases: the files that it put into a folder, the command, and the exit codes that are right.
"""

import io
import json
import random
import shlex
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat, wavfile

from tests.benches.brought_files import FILES
from transopt.files.unclear import options
from transopt.library.arrays import HASH_FIELD, content_hash
from transopt.plant.coil import CoilModel

REFUSED, DONE = (2,), (0,)
Arrays = dict[str, NDArray[Any]]

# What a library states beside what it plays, which nothing in the file could contradict.
BESIDE = (
    "solve_time_s",
    "meta.sources",
    "meta.versions",
    "meta.solver",
    "meta.left_out",
    "meta.repeatability",
    "meta.scene",
    "meta.grid_refinement",
)

RESIDUALS = ("primal_violation", "dual_residual", "duality_gap")
LEAST = np.finfo(float).tiny  # a number below it is zero in whatever unit
NOTHING = 2e-6  # of a residual or a multiplier: what the certificate tolerates is nothing to hold a file to


@dataclass(frozen=True)
class Case:
    """One command on one input.

    Attributes
    ----------
    name : what was done to the input.
    command : program and arguments; paths count from the case's folder.
    codes : exit codes that are right.
    """

    name: str
    command: tuple[str, ...]
    codes: tuple[int, ...]


def bit_flips(source: Path, folder: Path, count: int, chance: random.Random) -> Iterator[Case]:
    """A library with one to eight bits turned over: refused, unless it is a time stamp or the like."""
    whole = source.read_bytes()
    sound = _arrays(whole)
    for j in range(count):
        data = bytearray(whole)
        for _ in range(chance.randint(1, 8)):
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        (folder / "library.npz").write_bytes(data)
        yield Case(f"bit flips {j}", _reader(chance), DONE if _same(bytes(data), sound) else REFUSED)


def _arrays(data: bytes) -> Arrays:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _same(data: bytes, sound: Arrays) -> bool:
    try:
        found = _arrays(data)
    except Exception:  # whatever a damaged archive raises
        return False
    return found.keys() == sound.keys() and all(
        found[name].dtype == array.dtype and np.array_equal(found[name], array, equal_nan=_real(array))
        for name, array in sound.items()
    )


def _real(array: NDArray[Any]) -> bool:
    return array.dtype.kind == "f"


def _reader(chance: random.Random) -> tuple[str, ...]:
    """A command that uses a library."""
    return chance.choice(
        [
            ("transopt", "show", "library.npz"),
            ("transopt", "export", "library.npz", "taps.csv"),
            ("transopt", "export", "library.npz", "taps.h"),
            ("transopt", "export", "library.npz", "taps.wav"),
            ("transopt", "export", "library.npz", "taps.mat"),
            ("transopt-play", "tap", "library.npz", "--simulate", "--out", "played"),
            ("transopt", "verify", "library.npz"),
            ("transopt", "compare", "library.npz", "library.npz"),
        ]
    )


def _codes(command: tuple[str, ...], *, harmless: bool) -> tuple[int, ...]:
    """Exit codes that are right of a command on a library that reads well; `verify` lists what fails, with 1.

    `compare` shows two files beside each other and proves nothing.
    """
    if harmless or command[1] == "compare":
        return (0, 1, 2)
    return (1, 2) if command[1] == "verify" else REFUSED


def rehashed(source: Path, folder: Path, count: int, chance: random.Random) -> Iterator[Case]:
    """A library with something changed and hashed again: refused, unless nothing in the file depends on it."""
    whole, j = _arrays(source.read_bytes()), 0
    while j < count:
        arrays = {name: array.copy() for name, array in whole.items()}
        changed = _change_meta(arrays, chance) if chance.random() < 0.4 else _change_array(arrays, chance)
        if not changed:
            continue
        del arrays[HASH_FIELD]
        arrays[HASH_FIELD] = np.array(content_hash(arrays))
        np.savez(folder / "library.npz", **arrays)  # type: ignore[arg-type]
        beside = any(changed.startswith(name) for name in BESIDE)
        command = _reader(chance)
        yield Case(f"re-hashed {j}: {changed}", command, _codes(command, harmless=beside))
        j += 1


def _change_array(arrays: Arrays, chance: random.Random) -> str:
    """Another value, type or shape of one array; what was done, empty if that left it as it was."""
    name = chance.choice([name for name in arrays if name not in ("meta", HASH_FIELD)])
    array = arrays[name]
    if array.size == 0:
        return ""
    ways: list[Callable[[], tuple[str, NDArray[Any] | None]]] = [
        lambda: ("gone", None),
        lambda: ("transposed", array.T),
        lambda: ("one dimension more", array[None]),
        lambda: ("cut", array[..., :-1]),
        lambda: ("of bytes", array.astype("S8") if array.dtype.kind == "U" else array.astype("f4")),
        lambda: ("of objects", array.astype(object)),
    ]
    if array.dtype.kind == "f":
        at = tuple(chance.randrange(length) for length in array.shape)
        one = chance.choice([np.nan, np.inf, -np.inf, 1e308, 5e-324, 40.0, -1e3])
        factor = chance.choice([10.0, 1.1, 0.9, -1.0, 1e-6, 1e9])
        ways += [
            lambda: (f"{at} = {one:g}", _with(array, at, one)),
            lambda: (f"times {factor:g}", array * factor),
            lambda: ("reversed", array[..., ::-1]),
        ]
    else:
        words = chance.choice(["", "optimal", "\x1b[31mred", "x" * 999])
        ways.append(lambda: (f"all {words[:9]!r}", np.full(array.shape, words)))
    what, value = chance.choice(ways)()
    if value is None:
        del arrays[name]
        return f"{name} {what}"
    if name == "reference_raw_m_s2" and value.shape == array.shape and _bends_nothing(value - array, arrays):
        return ""
    if value.dtype == array.dtype and _alike(
        value, array, NOTHING if name in RESIDUALS or name.startswith("mu_") else LEAST
    ):
        return ""
    arrays[name] = value
    return f"{name} {what}"


def _alike(value: NDArray[Any], array: NDArray[Any], nothing: float) -> bool:
    """Whether a change is none that a figure shows: of zeros, of symmetric arrays, by less than rounding."""
    if value.shape != array.shape:
        return False
    if array.dtype.kind != "f":
        return np.array_equal(value, array)
    scale = np.nanmax(np.abs(array), initial=0.0)
    return bool(np.allclose(value, array, rtol=0, atol=max(1e-4 * scale, nothing), equal_nan=True))


def _bends_nothing(change: NDArray[Any], arrays: Arrays) -> bool:
    """Whether a recording that is changed so tells the same motion of the hand, which is all that it is held to."""
    dt_s = json.loads(str(arrays["meta"]))["dt_s"]
    most = 1e-2 * np.abs(arrays["nominal_velocity_m_s"]).max(axis=1)
    return bool(np.all(dt_s * np.abs(change).sum(axis=1) <= most))


def _with(array: NDArray[Any], at: tuple[int, ...], value: float) -> NDArray[Any]:
    changed = array.copy()
    changed[at] = value
    return changed


ODD: tuple[Any, ...] = (None, True, -1, 0, 1e-9, 1e-300, 1e12, 1e300, 40.0, 7, "x", "\x1b[2J", [], {}, [1.0], 10**400)


def _change_meta(arrays: Arrays, chance: random.Random) -> str:
    """Another number, type or nesting of one value in `meta`; what was done."""
    meta = json.loads(str(arrays["meta"]))
    table, path = meta, "meta"
    while True:
        key = chance.choice(sorted(table))
        path = f"{path}.{key}"
        if not isinstance(table[key], dict) or not table[key] or chance.random() < 0.1:
            break
        table = table[key]
    before = table[key]
    if chance.random() < 0.1 and before is not None:  # what is not stated is null, or as usual in a coil
        if path.startswith("meta.thermal.coil.") and before == getattr(CoilModel, key, None):
            return ""
        del table[key]
        what = "gone"
    elif chance.random() < 0.05:
        deep: Any = 0
        for _ in range(chance.choice([50, 900])):
            deep = [deep]
        table[key], what = deep, "nested"
    elif isinstance(before, int | float) and not isinstance(before, bool) and chance.random() < 0.5:
        table[key] = before * chance.choice([10, 1.1, 0.5, -1])
        what = f"= {table[key]}"
    else:
        table[key] = chance.choice(ODD)
        what = f"= {str(table[key])[:20]!r}"
    if key in table and table[key] == before:
        return ""
    arrays["meta"] = np.array(json.dumps(meta))
    return f"{path} {what}"


def recordings(folder: Path, count: int, chance: random.Random) -> Iterator[Case]:
    """Recordings in every format with bytes changed, cut, doubled or exchanged: read or refused, never more."""
    sound = [(suffix, data, "") for suffix, data in _sound_recordings().items()]
    sound += [(Path(each.name).suffix, each.data, options(each.right)) for each in FILES]
    bombs = _bombs()
    for j in range(count):
        if j < len(bombs):
            suffix, data = bombs[j]
            codes, right = REFUSED, ""
        else:
            suffix, whole, right = chance.choice(sound)
            data, codes = _fuzzed(whole, chance), (0, 1, 2)  # 1: read, and no tap in these units
        (folder / f"tap{suffix}").write_bytes(data)
        stated = shlex.split(right)
        if not stated and suffix in (".txt", ".dat") and chance.random() < 0.5:
            stated = ["--columns", "time_s,acceleration_m_s2"]
        if suffix == ".wav" and "--full-scale" not in stated:
            stated += ["--full-scale", "100"]
        command = ("transopt", "taps", f"tap{suffix}", "--speed", "0.2", *stated)
        yield Case(f"recording {j}{suffix}", command, codes)


def _sound_recordings() -> dict[str, bytes]:
    times = 1e-4 * np.arange(600)
    tap = 30 * np.sin(1e3 * times) * np.exp(-200 * times) + 1e-3 * np.cos(7e3 * times)
    rows = [f"{t:.6g},{a:.6g}" for t, a in zip(times, tap, strict=True)]
    plain, packed, sound = io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.savez(plain, time_s=times, acceleration_m_s2=tap)
    content: Any = {"time_s": times, "acceleration_m_s2": tap}
    savemat(packed, content, do_compression=True)
    wavfile.write(sound, 10_000, tap / 100)
    return {
        ".csv": "\n".join(["# speed_m_s: 0.3", "time_s,acceleration_m_s2", *rows]).encode(),
        ".txt": "\n".join(row.replace(",", "\t") for row in rows).encode(),
        ".npz": plain.getvalue(),
        ".mat": packed.getvalue(),
        ".wav": sound.getvalue(),
    }


def _fuzzed(data: bytes, chance: random.Random) -> bytes:
    """Some bytes changed, cut out, doubled or exchanged, the head more often than the rest."""
    content = bytearray(data)
    for _ in range(chance.randint(1, 6)):
        at = chance.randrange(min(200, len(content))) if chance.random() < 0.5 else chance.randrange(len(content))
        length = chance.choice([1, 1, 2, 4, 30])
        match chance.randrange(5):
            case 0:
                content[at] ^= 1 << chance.randrange(8)
            case 1:
                content[at : at + length] = chance.randbytes(length)
            case 2:
                del content[at : at + length]
            case 3:
                content[at:at] = content[at : at + length]
            case 4:
                content[at : at + 4] = struct.pack("<I", chance.choice([0, 2**31 - 1, 2**32 - 1, 2**24]))
        content = content or bytearray(b"0")
    return bytes(content)


def _bombs() -> list[tuple[str, bytes]]:
    """Small files that unpack to, or state, gigabytes; and files that are not what they are called."""
    zeros = bytes(2**20)
    packed = io.BytesIO()
    with (
        zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("time_s.npy", "w") as member,
    ):
        member.write(_head("<f8", (2**26,)))
        for _ in range(2**9):
            member.write(zeros)
    stated = io.BytesIO()
    with zipfile.ZipFile(stated, "w") as archive:
        for name in ("time_s.npy", "acceleration_m_s2.npy"):
            archive.writestr(name, _head("<f8", (2**40,)) + zeros[:80])
    stream = zlib.compressobj()
    # After a full flush nothing refers to what lies before: the block of one megabyte stands for any number of them.
    element = stream.compress(struct.pack("<II", 14, 2**31)) + stream.flush(zlib.Z_FULL_FLUSH)
    element += 2**10 * (stream.compress(zeros) + stream.flush(zlib.Z_FULL_FLUSH)) + stream.flush()
    matlab = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(element)) + element
    wav = b"RIFF\xff\xff\xff\xffWAVEfmt " + struct.pack("<IHHIIHH", 16, 1, 1, 10_000, 20_000, 2, 16)
    return [
        (".npz", packed.getvalue()),
        (".npz", stated.getvalue()),
        (".mat", matlab),
        (".wav", wav + b"data\xff\xff\xff\xff" + zeros[:64]),
        (".csv", b"time_s,acceleration_m_s2\n" + b"1,2\n" * 5_000_000),
        (".csv", b"," * 30_000_000),
        (".csv", b"time_s,acceleration_m_s2\n0," + b"9" * 30_000_000),
        (".csv", b"\x1b[31m\xff"),
        (".csv", b"x" * (2**26 + 1)),
    ]


def _head(descr: str, shape: tuple[int, ...]) -> bytes:
    """The head of an NPY file."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue()
