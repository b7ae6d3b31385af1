"""Reading a library file: nothing in it is used before all of it has been checked."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.library.arrays import HASH_FIELD, absent, content_hash
from transopt.library.library import ARRAYS, SCHEMA, Library
from transopt.library.meta import META_KEYS
from transopt.problem.limits.temperature import TemperatureLimit


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    advice = "give a library.npz written by `transopt solve`"
    try:
        with path.open("rb") as stream:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise InputError(f"{path}: a single array, not a library; {advice}")
            return {name: archive[name] for name in archive.files}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {advice}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: a folder, not a file; {advice}") from None
    except PermissionError:
        raise InputError(f"{path}: no permission to read it; {advice}") from None
    except ValueError as error:
        reason = "holds pickled objects, which are never loaded" if "pickle" in str(error).lower() else str(error)
        raise InputError(f"{path}: {reason}; {advice}") from None
    except (OSError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise InputError(f"{path}: damaged or not an .npz file ({error}); {advice}") from None
    except Exception as error:  # zlib.error and NotImplementedError among them: any broken archive ends here
        raise InputError(f"{path}: damaged archive ({error}); {advice}") from None


def _check_meta(path: Path, text: NDArray[Any]) -> dict[str, Any]:
    try:
        meta = json.loads(str(text))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: meta is not JSON ({error}); solve the scene again") from None
    if not isinstance(meta, dict) or meta.get("schema") != SCHEMA:
        found = meta.get("schema") if isinstance(meta, dict) else None
        raise InputError(f"{path}: schema {found}, this version reads {SCHEMA}; solve the scene again")
    missing = [key for key in META_KEYS if key not in meta]
    for key, inner in META_KEYS.items():
        # null: the scene has no such part; anything else holds the keys that are read from it.
        table = meta.get(key)
        if inner and table is not None:
            missing += [f"{key}.{name}" for name in inner if not isinstance(table, dict) or name not in table]
    if missing:
        raise InputError(f"{path}: meta lacks {', '.join(missing)}; solve the scene again")
    return meta


def _check_arrays(path: Path, arrays: dict[str, NDArray[Any]], sizes: dict[str, int]) -> None:
    """Every array against its declaration; `sizes` gets what the letters of the declared shapes stand for."""
    for name, stated in ARRAYS.items():
        if name not in arrays:
            continue
        array = arrays[name]
        if array.ndim != len(stated.shape):
            raise InputError(
                f"{path}: {name} has {array.ndim} dimensions, expected {len(stated.shape)}; solve it again"
            )
        pairs = zip(stated.shape, array.shape, strict=True)
        expected = tuple(sizes.setdefault(letter, size) for letter, size in pairs)
        if array.shape != expected:
            raise InputError(f"{path}: {name} has shape {array.shape}, expected {expected}; solve it again")
        if not stated.fits(array.dtype):
            raise InputError(f"{path}: {name} has type {array.dtype}, expected {stated.type_word}")
        if not stated.is_text and not stated.may_be_nan and not np.all(np.isfinite(array)):
            raise InputError(f"{path}: {name} holds a number that is not finite; solve the scene again")
    for name in ("speeds_m_s", "grips_N"):
        if arrays[name].size == 0 or np.any(np.diff(arrays[name]) <= 0):
            raise InputError(f"{path}: {name} is empty or not strictly increasing; solve the scene again")


def load_library(path: str | Path) -> Library:
    """Read a library file and check it whole before anything is used.

    Raises
    ------
    InputError : missing, damaged, foreign, pickled, changed since it was written, an array missing or misshapen.
    """
    path = Path(path)
    arrays = _read_arrays(path)
    for name in ("meta", HASH_FIELD):
        if name not in arrays:
            raise InputError(f"{path}: no array {name}: not a library of this project; solve the scene again")
    meta = _check_meta(path, arrays["meta"])
    optional = absent(ARRAYS, meta)
    missing = [name for name in ARRAYS if name not in arrays and name not in optional]
    if missing:
        raise InputError(f"{path}: array {missing[0]} is missing; solve the scene again")
    stored = str(arrays.pop(HASH_FIELD))
    if stored != content_hash(arrays):
        raise InputError(f"{path}: content does not match its hash: changed or damaged; solve the scene again")
    sizes = {"1": 1, "2": 2, **({} if meta["weights"]["spread"] else {"s": 0})}
    _check_arrays(path, arrays, sizes)
    for name in optional:
        arrays.setdefault(name, np.zeros([sizes[letter] for letter in ARRAYS[name].shape]))
    library = Library.of(arrays, meta)
    _check_problem(path, library)
    return library


def _check_problem(path: Path, library: Library) -> None:
    """The numbers of `meta` must make a time grid, a coil and a problem; only the first entry's is tried."""
    advice = "solve the scene again"
    if not (library.speeds_m_s[0] > 0 and library.grips_N[0] >= 0):
        raise InputError(f"{path}: speeds_m_s must be > 0 and grips_N >= 0; {advice}")
    try:
        grid = library.time_grid()
        if not (0 < grid.dt_s < np.inf and 0 <= grid.lead_s < np.inf and 0 <= grid.delay_s < np.inf):
            raise InputError("dt_s must be > 0, lead_s and delay_s >= 0, all finite")
        limits = library.meta["limits"]
        for key, value in limits.items():
            if isinstance(value, int | float) and key != TemperatureLimit.key and not 0 < value < np.inf:
                raise InputError(f"limits.{key} = {value}: must be > 0 and finite")
        thermal = library.problem(0, 0).thermal
        stated = limits["temperature_C"]
        if stated is not None and (thermal is None or stated != thermal.limit_C):
            raise InputError(f"limits.temperature_C = {stated}: the coil and its budget say otherwise")
    except (InputError, TypeError, ValueError, ArithmeticError) as error:
        raise InputError(f"{path}: meta does not describe a problem ({error}); {advice}") from None
