"""Reading a library file: nothing in it is used before all of it has been checked.

What is checked here is that the file is whole and describes a problem of a possible size. That its waveforms are
optimal and keep their limits is another question, which `transopt.library.proven` answers.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.files import check_depth, read_file
from transopt.base.npz import Archive
from transopt.base.shown import cut
from transopt.base.sizes import (
    LONGEST_AFTER_S,
    LONGEST_DELAY_S,
    LONGEST_DT_S,
    LONGEST_HORIZON_S,
    MOST_AFTER,
    MOST_COMMANDS,
    MOST_DEVICES,
    MOST_FILE_BYTES,
    MOST_NODES,
    MOST_STAGES,
    MOST_STATES,
    SHORTEST_DT_S,
)
from transopt.base.units import beyond, largest
from transopt.library.arrays import HASH_FIELD, absent, content_hash, stored_names
from transopt.library.library import ARRAYS, SCHEMAS, Library, further_arrays
from transopt.library.meta import lacking
from transopt.plant.discretise import TimeGrid, samples_after
from transopt.problem.limits.supply import COPPER, SupplyLimit
from transopt.problem.limits.temperature import TemperatureLimit

ADVICE = "give a library.npz written by `transopt solve`"
TABLES_OF_WORDS = ("scene", "left_out", "sources", "versions", "solver")  # of meta, from which nothing is computed
# What a reader of a file that may hold anything may meet.
BROKEN = (TypeError, ValueError, KeyError, IndexError, AttributeError, ArithmeticError, RecursionError, MemoryError)


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    data = read_file(path, MOST_FILE_BYTES, ADVICE)
    try:
        archive = Archive(data)
        return {name: archive[name] for name in archive}
    except ValueError as error:
        raise InputError(f"{path}: {error}; {ADVICE}") from None
    except Exception as error:  # zipfile, zlib, struct, the parser of heads: any broken archive ends here
        raise InputError(f"{path}: damaged or not an .npz file ({error}); {ADVICE}") from None


def _check_meta(path: Path, text: NDArray[Any]) -> dict[str, Any]:
    try:
        meta = json.loads(str(text))
        check_depth(meta)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: meta is not JSON ({error}); solve the scene again") from None
    schema = meta.get("schema") if isinstance(meta, dict) else None
    if not isinstance(meta, dict) or isinstance(schema, bool) or schema not in SCHEMAS:
        known = f"{', '.join(map(str, SCHEMAS[:-1]))} and {SCHEMAS[-1]}"
        raise InputError(f"{path}: schema {cut(repr(schema))}, this version reads {known}; solve the scene again")
    if missing := lacking(meta, int(schema)):
        raise InputError(f"{path}: meta lacks {', '.join(missing)}; solve the scene again")
    for place, value in _leaves({key: value for key, value in meta.items() if key not in TABLES_OF_WORDS}):
        if said := beyond(place, value):
            raise InputError(f"{path}: meta.{place} = {cut(repr(value))}: {said}, or solve the scene again")
    return meta


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted path and value of all numbers in tables and lists; the items of a list have the path of the list."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list):
        for inner in value:
            yield from _leaves(inner, place)
    elif isinstance(value, int | float):
        yield place, value


def _check_arrays(path: Path, arrays: dict[str, NDArray[Any]], names: dict[str, str], sizes: dict[str, int]) -> None:
    """Every array against its declaration; `sizes` gets what the letters of the declared shapes stand for."""
    for own_name, stated in ARRAYS.items():
        name = names[own_name]
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
        if (
            not stated.is_text
            and array.size
            and not (most := np.nanmax(np.abs(array), initial=0)) <= largest(stated.unit)
        ):
            raise InputError(
                f"{path}: {name} reaches {most:.3g} {stated.unit}, at most {largest(stated.unit):g} is possible; "
                "solve the scene again"
            )
    for what, size, most in (
        ("speeds", sizes["v"], MOST_NODES),
        ("grips", sizes["g"], MOST_NODES),
        ("stages", sizes["N"], MOST_STAGES),
        ("states", sizes["n"], MOST_STATES),
        ("further devices", sizes["s"], MOST_DEVICES),
        ("commands", sizes["v"] * sizes["g"] * sizes["N"], MOST_COMMANDS),
    ):
        if size > most:
            raise InputError(f"{path}: {size} {what}, at most {most}; solve a smaller scene")
    for name in ("speeds_m_s", "grips_N"):
        if name in arrays and (arrays[name].size == 0 or np.any(np.diff(arrays[name]) <= 0)):
            raise InputError(f"{path}: {name} is empty or not strictly increasing; solve the scene again")


def _check_multipliers(path: Path, arrays: dict[str, NDArray[Any]], shape: tuple[int, int, int]) -> None:
    """Check the multipliers of limits that not every library has: one number for every command."""
    for name, array in arrays.items():
        if array.shape != shape or array.dtype.kind != "f" or not np.all(np.isfinite(array)):
            raise InputError(f"{path}: {name} is no finite array of shape {shape}; solve the scene again")


def load_library(path: str | Path) -> Library:
    """Read a library file and check it whole before anything is used.

    Raises
    ------
    InputError : missing, damaged, foreign, pickled, changed since it was written, an array missing or misshapen, a
        number or a size that no library has.
    """
    path = Path(path)
    arrays = _read_arrays(path)
    for name in ("meta", HASH_FIELD):
        if name not in arrays:
            raise InputError(f"{path}: no array {name}: not a library of this project; solve the scene again")
    meta = _check_meta(path, arrays["meta"])
    try:
        with np.errstate(all="ignore"):  # what overflows is found as not finite
            return _checked(path, arrays, meta)
    except InputError:
        raise
    except BROKEN as error:
        raise InputError(
            f"{path}: meta does not describe a problem ({type(error).__name__}: {error}); solve the scene again"
        ) from None


def _checked(path: Path, arrays: dict[str, NDArray[Any]], meta: dict[str, Any]) -> Library:
    optional, names = absent(ARRAYS, meta), stored_names(ARRAYS, meta["schema"])
    missing = [names[name] for name in ARRAYS if names[name] not in arrays and name not in optional]
    spread = arrays[names["spread_A"]].shape[1] if names["spread_A"] in arrays else 0
    further = further_arrays(meta, spread)
    missing += [name for name in further if name not in arrays]
    if missing:
        raise InputError(f"{path}: array {missing[0]} is missing; solve the scene again")
    stored = str(arrays.pop(HASH_FIELD))
    if stored != content_hash(arrays):
        raise InputError(f"{path}: content does not match its hash: changed or damaged; solve the scene again")
    sizes = {"1": 1, "2": 2, **({} if meta["weights"]["spread"] else {"s": 0}), **_beside_the_window(path, meta)}
    _check_arrays(path, arrays, names, sizes)
    _check_multipliers(path, {name: arrays[name] for name in further}, (sizes["v"], sizes["g"], sizes["N"]))
    arrays |= {name: arrays[names[name]] for name in ARRAYS if names[name] in arrays}
    for name in optional:
        shape = [sizes[letter] for letter in ARRAYS[name].shape]
        arrays.setdefault(name, np.zeros(shape, dtype=np.str_ if ARRAYS[name].is_text else float))
    library = Library.of(arrays, meta)
    _check_problem(path, library)
    _check_words(path, library)
    return library


def _beside_the_window(path: Path, meta: dict[str, Any]) -> dict[str, int]:
    """M and L as the time axis has them, before anything of that size is made; none in a file of schema 1."""
    if meta["schema"] == 1:
        return {"M": 0, "L": 0}
    weights, dt_s, lead_s = meta["weights"], meta["dt_s"], meta["lead_s"]
    delay_s = 0.0 if meta["amplifier"] is None else meta["amplifier"]["delay_s"]
    if not SHORTEST_DT_S <= dt_s <= LONGEST_DT_S:
        raise InputError(f"{path}: meta.dt_s = {dt_s:g} s: must be {SHORTEST_DT_S:g} to {LONGEST_DT_S:g} s")
    if not 0 <= weights["after_s"] <= LONGEST_AFTER_S or samples_after(weights["after_s"], dt_s) > MOST_AFTER:
        raise InputError(
            f"{path}: meta.weights.after_s = {weights['after_s']:g} s: must be 0 to {LONGEST_AFTER_S:g} s and at "
            f"most {MOST_AFTER} samples; solve the scene again"
        )
    if not (0 <= lead_s <= LONGEST_DELAY_S and 0 <= delay_s <= LONGEST_DELAY_S):
        raise InputError(f"{path}: meta.lead_s and amplifier.delay_s must be 0 to {LONGEST_DELAY_S:g} s")
    grid = TimeGrid(dt_s, 1, lead_s, delay_s, samples_after(weights["after_s"], dt_s))
    return {"M": grid.after_stages, "L": grid.before_times_s.size}


def _check_words(path: Path, library: Library) -> None:
    """What `meta` says of the entries has the shape of the grid, and its words are words."""
    meta, (nv, ng, _) = library.meta, library.command.shape
    repeats, scene, left_out = meta["repeatability"], meta["scene"], meta["left_out"]
    fit = {
        "repeatability": isinstance(repeats, list)
        and len(repeats) == nv
        and all(each is None or (isinstance(each, int | float) and 0 <= each < np.inf) for each in repeats),
        "scene": isinstance(scene["name"], str) and isinstance(scene["description"], str),
        "left_out": isinstance(left_out, dict) and all(_is_reason(said, nv, ng) for said in left_out.values()),
        "sources": isinstance(meta["sources"], list) and all(isinstance(each, dict) for each in meta["sources"]),
        "versions": isinstance(meta["versions"], dict),
    }
    odd = next((key for key, fits in fit.items() if not fits), None)
    if odd is not None:
        raise InputError(f"{path}: meta.{odd} is not of the form that a solve writes; solve the scene again")


def _is_reason(said: Any, nv: int, ng: int) -> bool:
    """Why a part is left out: words, or words or null for every entry."""
    if isinstance(said, str):
        return True
    rows = said if isinstance(said, list) and len(said) == nv else [None]
    return all(
        isinstance(row, list) and len(row) == ng and all(each is None or isinstance(each, str) for each in row)
        for row in rows
    )


def _check_problem(path: Path, library: Library) -> None:
    """The numbers of `meta` must make a time grid, a coil and a problem; only the first entry's is tried."""
    advice = "solve the scene again"
    if not ((library.axes.targets or library.speeds_m_s[0] > 0) and library.grips_N[0] >= 0):
        raise InputError(f"{path}: speeds_m_s must be > 0 and grips_N >= 0; {advice}")
    try:
        grid = library.time_grid()
        if not SHORTEST_DT_S <= grid.dt_s <= LONGEST_DT_S:
            raise InputError(f"dt_s = {grid.dt_s:g} s: must be {SHORTEST_DT_S:g} to {LONGEST_DT_S:g} s")
        if grid.dt_s * grid.stages > LONGEST_HORIZON_S:
            raise InputError(f"{grid.stages} commands of {grid.dt_s:g} s: at most {LONGEST_HORIZON_S:g} s")
        if not (0 <= grid.lead_s <= LONGEST_DELAY_S and 0 <= grid.delay_s <= LONGEST_DELAY_S):
            raise InputError(f"lead_s and delay_s must be 0 to {LONGEST_DELAY_S:g} s")
        limits = library.meta["limits"]
        for key, value in limits.items():
            if isinstance(value, int | float) and key != TemperatureLimit.key and not 0 < value < np.inf:
                raise InputError(f"limits.{key} = {value}: must be > 0 and finite")
        problem = library.problem(0, 0)
        thermal, rail = problem.thermal, problem.limits.get(SupplyLimit.name)
        if (ends := limits.get(COPPER)) is not None and not (isinstance(rail, SupplyLimit) and rail.copper_C == ends):
            raise InputError(f"limits.{COPPER} = {cut(repr(ends))}: the coil and its budget say otherwise")
        if library.nonlinear:
            from transopt.library.nonlinear import nonlinear_problem

            nonlinear_problem(library, 0, 0)
        stated = limits["temperature_C"]
        if stated is not None and (thermal is None or stated != thermal.limit_C):
            raise InputError(f"limits.temperature_C = {stated}: the coil and its budget say otherwise")
    except (InputError, *BROKEN) as error:
        raise InputError(f"{path}: meta does not describe a problem ({error}); {advice}") from None
