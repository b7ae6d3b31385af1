"""Reading a library file: every part of it is checked before any part is used.

The checks here ensure that the file is intact and describes a problem of an admissible size.
`transopt.library.proven` checks that its waveforms are optimal and keep their limits.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.files import check_depth, read_file
from transopt.base.npz import Archive
from transopt.base.shown import cut
from transopt.base.sizes import (
    MOST_COMMANDS,
    MOST_DEVICES,
    MOST_FILE_BYTES,
    MOST_NODES,
    MOST_STAGES,
    MOST_STATES,
)
from transopt.base.units import beyond, largest
from transopt.library.arrays import HASH_FIELD, absent, content_hash
from transopt.library.library import COOL, Library
from transopt.library.meta import SCHEMA, lacking, most_parts, stated
from transopt.library.multipliers import ARRAYS, further_arrays, is_of_entries
from transopt.library.posed import posing_of, scene_in

if TYPE_CHECKING:  # which loads pydantic
    from transopt.scene.scene import Scene

ADVICE = "give a library.npz written by `transopt solve`"
TABLES_OF_WORDS = ("scene", "left_out", "sources", "versions", "solver")  # nothing is computed from these tables
# Exceptions that reading arbitrary content can raise.
BROKEN = (TypeError, ValueError, KeyError, IndexError, AttributeError, ArithmeticError, RecursionError, MemoryError)


def _in_words(error: Exception) -> str:
    """This project's error message in parentheses; empty for an exception of Python's own."""
    return f" ({error})" if isinstance(error, InputError) else ""


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    data = read_file(path, MOST_FILE_BYTES, ADVICE)
    try:
        archive = Archive(data)
        return {name: archive[name] for name in archive}
    except ValueError as error:
        raise InputError(f"{path}: {error}; {ADVICE}") from None
    except Exception:  # zipfile, zlib, struct, header parser: any damaged archive ends here
        raise InputError(f"{path}: damaged or not an .npz file; {ADVICE}") from None


def _check_meta(path: Path, text: NDArray[Any]) -> dict[str, Any]:
    try:
        meta = json.loads(str(text))
        check_depth(meta)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: meta is not JSON: damaged; solve the scene again") from None
    schema = meta.get("schema") if isinstance(meta, dict) else None
    if not isinstance(meta, dict) or isinstance(schema, bool) or schema != SCHEMA:
        raise InputError(
            f"{path}: schema {cut(repr(schema))}, this version reads schema {SCHEMA} alone; solve the scene again"
        )
    if missing := lacking(meta):
        raise InputError(f"{path}: meta lacks {', '.join(missing)}; solve the scene again")
    for place, value in _leaves({key: value for key, value in meta.items() if key not in TABLES_OF_WORDS}):
        if said := beyond(place, value):
            raise InputError(f"{path}: meta.{place} = {cut(repr(value))}: {said}, or solve the scene again")
    return meta


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted path and value of all numbers in tables and lists; the items of a list have the list's path."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list):
        for inner in value:
            yield from _leaves(inner, place)
    elif isinstance(value, int | float):
        yield place, value


def _check_arrays(path: Path, arrays: dict[str, NDArray[Any]], sizes: dict[str, int], prefix: str = "") -> None:
    """Check every array against its declaration; `sizes` receives the size of each letter of the shapes."""
    for declared, declaration in ARRAYS.items():
        name = prefix + declared
        if name not in arrays or (prefix and not is_of_entries(declared)):
            continue
        array = arrays[name]
        letters = declaration.letters(sizes)
        if array.ndim != len(letters):
            raise InputError(f"{path}: {name} has {array.ndim} dimensions, expected {len(letters)}; solve it again")
        pairs = zip(letters, array.shape, strict=True)
        expected = tuple(sizes.setdefault(letter, size) for letter, size in pairs)
        if array.shape != expected:
            raise InputError(f"{path}: {name} has shape {array.shape}, expected {expected}; solve it again")
        if not declaration.fits(array.dtype):
            raise InputError(f"{path}: {name} has type {array.dtype}, expected {declaration.type_word}")
        if not declaration.is_text and not declaration.may_be_nan and not np.all(np.isfinite(array)):
            raise InputError(f"{path}: {name} holds a number that is not finite; solve the scene again")
        if (
            not declaration.is_text
            and array.size
            and not (most := np.nanmax(np.abs(array), initial=0)) <= largest(declaration.unit)
        ):
            raise InputError(
                f"{path}: {name} reaches {most:.3g} {declaration.unit}, at most {largest(declaration.unit):g} is "
                "possible; solve the scene again"
            )
    for what, size, most in (
        ("speeds", sizes["v"], MOST_NODES),
        ("grips", sizes["g"], MOST_NODES),
        ("stages", sizes["N"], MOST_STAGES),
        ("states", sizes["n"], MOST_STATES),
        ("further devices", sizes["s"], MOST_DEVICES),
        ("commands", sizes["v"] * sizes["g"] * sizes["N"] * sizes["i"], MOST_COMMANDS),
    ):
        if size > most:
            raise InputError(f"{path}: {size} {what}, at most {most}; solve a smaller scene")
    named = "targets" in arrays
    for name in ("grips_N",) if named else ("speeds_m_s", "grips_N"):
        # An arm repeats each grip once per place.
        nodes = np.array([*dict.fromkeys(arrays[name].tolist())]) if sizes["i"] > 1 else arrays[name]
        if nodes.size == 0 or np.any(np.diff(nodes) <= 0):
            raise InputError(f"{path}: {name} is empty or not strictly increasing; solve the scene again")


def _check_multipliers(path: Path, prefix: str, arrays: dict[str, NDArray[Any]], sizes: dict[str, int]) -> None:
    """Check the multipliers that not every library has: finite, one number for every command."""
    shape = (sizes["v"], sizes["g"], sizes["N"])
    for name, array in arrays.items():
        if array.shape != shape or array.dtype.kind != "f" or not np.all(np.isfinite(array)):
            raise InputError(f"{path}: {prefix}{name} is no finite array of shape {shape}; solve the scene again")


def load_library(path: str | Path) -> Library:
    """Read a library file, checking all of it before any of it is used.

    Raises
    ------
    InputError : the file is missing, damaged, foreign, pickled or changed since it was written; an array is missing
        or misshapen; a number or a size is beyond what a library can have.
    """
    path = Path(path)
    arrays = _read_arrays(path)
    for name in ("meta", HASH_FIELD):
        if name not in arrays:
            raise InputError(f"{path}: no array {name}: not a library of this project; solve the scene again")
    meta = _check_meta(path, arrays["meta"])
    try:
        with np.errstate(all="ignore"):  # an overflow shows as a value that is not finite
            return _checked(path, arrays, meta)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(f"{path}: ") else f"{path}: {error}") from None
    except BROKEN:
        raise InputError(f"{path}: meta does not describe a problem; solve the scene again") from None


def _checked(path: Path, arrays: dict[str, NDArray[Any]], meta: dict[str, Any]) -> Library:
    scene = scene_in(meta)
    posing = posing_of(scene)
    spread = arrays["spread_A"].shape[1] if "spread_A" in arrays else 0
    further = further_arrays(posing, spread, most_parts(meta))
    has_cool = "cool" in meta
    if has_cool is not (scene.grid.cool_share is not None):
        raise InputError(f"{path}: meta.cool does not go with its scene's grid.cool_share; solve the scene again")
    # Cool commands have `left_out` of their own, which determines the arrays that they must have.
    files = [(COOL, {**meta, "left_out": _left_out_of(path, meta["cool"])})] if has_cool else []
    files.append(("", meta))
    optional = {prefix: absent(ARRAYS, stated(scene, own)) for prefix, own in files}
    for prefix, names in optional.items():
        for name in (*ARRAYS, *further):
            if (not prefix or is_of_entries(name)) and prefix + name not in arrays and name not in names:
                raise InputError(f"{path}: array {prefix}{name} is missing; solve the scene again")
    hashed = str(arrays.pop(HASH_FIELD))
    if hashed != content_hash(arrays):
        raise InputError(f"{path}: content does not match its hash: changed or damaged; solve the scene again")
    grid = posing.grid
    sizes = {
        "1": 1,
        "3": 3,
        "N": grid.stages,
        "M": grid.after_stages,
        "L": grid.before_times_s.size,
        "h": posing.hand_over_samples,
        **_several(scene),
        **({} if scene.robust else {"s": 0}),
    }
    _check_arrays(path, arrays, sizes)

    def known(prefix: str) -> dict[str, NDArray[Any]]:
        """Arrays by their names without the prefix; zero or empty where the file needs none."""
        names = [name for name in (*ARRAYS, *further) if not prefix or is_of_entries(name)]
        found = {name: arrays[prefix + name] for name in names if prefix + name in arrays}
        _check_multipliers(path, prefix, {name: found[name] for name in further}, sizes)
        for name in optional[prefix]:
            shape = [sizes[letter] for letter in ARRAYS[name].letters(sizes)]
            found[name] = np.zeros(shape, dtype=np.str_ if ARRAYS[name].is_text else float)
        return found

    library = Library.of(known(""), meta)
    if has_cool:
        _check_arrays(path, arrays, sizes, COOL)
        library = library.with_cool(known(COOL))
    _check_problem(path, library)
    _check_words(path, library)
    return library


def _several(scene: "Scene") -> dict[str, int]:
    """Letter -> size of inputs, tracked accelerations and devices; motors and directions only of several."""
    motors, directions = len(scene.shares), scene.directions
    found = {"i": max(motors, 1), "o": directions, "q": len(scene.axes.places)}
    found |= {letter: size for letter, size in (("m", motors), ("p", directions)) if size > 1}
    return found | ({"g": len(scene.axes.grips_N)} if scene.axes.places else {})


def _left_out_of(path: Path, cool: Any) -> Any:
    """The parts left out of the cool commands' problems, from `meta.cool`."""
    if not (isinstance(cool, dict) and set(cool) == {"left_out"}):
        raise InputError(f"{path}: meta.cool is not of the form that a solve writes; solve the scene again")
    return cool["left_out"]


def _check_words(path: Path, library: Library) -> None:
    """Check that what `meta` states per entry has the shape of the grid and the right types."""
    meta, (nv, ng) = library.meta, library.command.shape[:2]
    left_out = meta["left_out"]
    fit = {
        "repeatability": _is_table(meta["repeatability"], nv, ng, _is_spread),
        "slow_part_known": _is_table(meta["slow_part_known"], nv, ng, lambda each: isinstance(each, bool)),
        "derived": isinstance(meta["derived"], dict),
        "left_out": isinstance(left_out, dict) and all(_is_reason(said, nv, ng) for said in left_out.values()),
        "sources": isinstance(meta["sources"], list) and all(isinstance(each, dict) for each in meta["sources"]),
        "versions": isinstance(meta["versions"], dict),
    }
    if library.cool is not None:
        of_cool = library.cool.meta["left_out"]
        fit["cool.left_out"] = isinstance(of_cool, dict) and all(_is_reason(s, nv, ng) for s in of_cool.values())
    odd = next((key for key, fits in fit.items() if not fits), None)
    if odd is not None:
        raise InputError(f"{path}: meta.{odd} is not of the form that a solve writes; solve the scene again")


def _is_reason(said: Any, nv: int, ng: int) -> bool:
    """Whether this is a reason to leave a part out: text, or for every entry text or None."""
    return isinstance(said, str) or _is_table(said, nv, ng, lambda each: each is None or isinstance(each, str))


def _is_spread(each: Any) -> bool:
    return each is None or (isinstance(each, int | float) and 0 <= each < np.inf)


def _is_table(said: Any, nv: int, ng: int, fits: Callable[[Any], bool]) -> bool:
    """Whether this is a table with one fitting value per entry, row by row."""
    rows = said if isinstance(said, list) and len(said) == nv else [None]
    return all(isinstance(row, list) and len(row) == ng and all(map(fits, row)) for row in rows)


def _check_problem(path: Path, library: Library) -> None:
    """Check that the file poses a problem; only the first entry is tried."""
    if not ((library.axes.targets or library.speeds_m_s[0] > 0) and library.grips_N[0] >= 0):
        raise InputError(f"{path}: speeds_m_s must be > 0 and grips_N >= 0; solve the scene again")
    scene = library.scene()
    if scene.axes.places and library.grips_N.tolist() != [*scene.axes.grips_N]:
        raise InputError(f"{path}: grips_N is not that of the scene in meta; solve the scene again")
    try:
        library.problem(0, 0)
        if library.nonlinear:
            from transopt.library.nonlinear import nonlinear_problem

            nonlinear_problem(library, 0, 0)
    except (InputError, *BROKEN) as error:
        raise InputError(f"{path}: it does not describe a problem{_in_words(error)}; solve the scene again") from None
