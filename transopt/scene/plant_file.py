"""Files with the matrices of a plant: read with a scene that names one, written by `transopt plant fit`.

dx/dt = A x + B u, acceleration = C x + D u. NPZ and MAT files contain the variables A (n, n), B (n,), C (n,), D (0 if
missing), and a row `output_NAME` (n,) for every further output on which limits may be stated; an NPZ file also
`input`, "current" or "voltage". A CSV file contains the block matrix [A B; C D] below comment lines. The lines
`# input: voltage` and `# outputs: position, velocity` state input and outputs; the rows of these outputs follow the
matrix, with 0 in the last cell.

The content is copied into the table `[model]`, so that a library does not need the file.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from transopt.base.errors import InputError, did_you_mean
from transopt.base.files import read_file, whole_file
from transopt.base.npz import Archive
from transopt.base.shown import cut
from transopt.base.signals import FloatArray
from transopt.base.sizes import MOST_MODEL_BYTES, MOST_STATES
from transopt.files import mat5
from transopt.files.containers import guarded
from transopt.plant.state_space import StateSpace

OUTPUT = "output_"  # prefix of the variable with a further output's row
USUAL_UNITS = {"position": "m", "velocity": "m/s", "current": "A"}  # of the outputs with built-in limits
INPUTS = ("current", "voltage")
SUFFIXES = (".npz", ".mat", ".csv")
_STATED = re.compile(r"#\s*(input|outputs)\s*[:=]\s*(.*?)[;,\s]*")
_ADVICE = "a plant file holds the matrices A, B, C, D as .npz, .mat or .csv"


def with_plant_file(scene: Path, table: dict[str, Any]) -> dict[str, Any]:
    """The table [model] of a scene with the matrices of the file that it names, if it names one.

    Parameters
    ----------
    scene : the scene's file; the plant's path is relative to its folder.
    table : the table of the scene.

    Raises
    ------
    InputError : one line: scene, file, matrix, what is wrong with it.
    """
    named = table.get("file")
    if table.get("kind") != "state_space" or named is None:
        return table
    if not isinstance(named, str):
        raise InputError(f'{scene}: model.file = {cut(repr(named))}: must be the path of a file, "plant.npz"')
    twice = next((name for name in "ABCD" if name in table), None)
    if twice is not None:
        raise InputError(f"{scene}: model.{twice}: stands in model.file = {named!r} too: take one of them out")
    try:
        found = read_plant(scene.parent / named)
        return {**table, **found, **_outputs(table, found)}
    except InputError as error:
        raise InputError(f"{scene}: model.file = {named!r}: {error}") from None


def _outputs(table: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    """The plant's outputs, with rows and units from file and scene combined."""
    stated = table.get("input")
    if stated is not None and found.get("input", stated) != stated:
        raise InputError(
            f"a {found['input']} drives it, and the scene states input = {stated!r}: take that line out of the scene"
        )
    own = table.get("outputs", {})
    if not isinstance(own, dict) or not all(isinstance(each, dict) for each in own.values()):
        raise InputError('model.outputs: must be tables, [model.outputs.NAME] with unit = "m"')
    rows, outputs = found["outputs"], {}
    for name, row in rows.items():
        each = own.get(name, {})
        if "row" in each:
            raise InputError(f"model.outputs.{name}: the scene states its row as well: take one of them out")
        unit = each.get("unit", USUAL_UNITS.get(name))
        if unit is None:
            raise InputError(
                f'{OUTPUT}{name} has no unit: add [model.outputs.{name}] with unit = "m" or another unit'
            )
        outputs[name] = {"row": row, "unit": unit}
    for name, each in own.items():
        if name not in rows and "row" not in each:
            raise InputError(
                f"model.outputs.{name}: no row {OUTPUT}{name} in the file{did_you_mean(name, rows)}; it has "
                f"{', '.join(rows) or 'none'}: state its row in the scene"
            )
        outputs.setdefault(name, each)
    return {"outputs": outputs}


def read_plant(path: Path) -> dict[str, Any]:
    """A, B, C, D, outputs (name -> row) and, if stated, the input, as entries of the table [model].

    Raises
    ------
    InputError : one line: file, matrix, its shape, the required shape.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: unknown format {path.suffix!r}: save the matrices as {', '.join(SUFFIXES)}")
    data = read_file(path, MOST_MODEL_BYTES, _ADVICE)
    try:
        if suffix == ".csv":
            return _checked(*_of_text(data))
        kind, remedy = ("NPZ", "save it with numpy.savez") if suffix == ".npz" else ("MAT", "save it with -v7")
        with guarded(f"not a readable {kind} file", f"{remedy}: {_ADVICE}"):
            found: Mapping[str, Any] = Archive(data) if suffix == ".npz" else mat5.variables(data)
            named = {name: found[name] for name in found if name in (*"ABCD", "input") or name.startswith(OUTPUT)}
        return _checked({name: _numbers(name, value) for name, value in named.items() if name != "input"}, named)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _numbers(name: str, value: Any) -> FloatArray:
    array = np.asarray(value)
    if array.dtype.kind not in "iuf" or array.ndim > 2:
        raise InputError(f"{name}: must be a matrix of real numbers; convert it")
    return np.atleast_2d(np.asarray(array, dtype=float))


def _of_text(data: bytes) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """The matrices of a CSV file, and the statements in its comments."""
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"cannot be read as text ({error}); save it as UTF-8 text") from None
    stated, rows = dict[str, str](), list[list[float]]()
    for number, line in enumerate(lines, 1):
        content = line.strip()
        if found := _STATED.fullmatch(content):
            stated[found[1]] = found[2]
        if not content or content.startswith("#"):
            continue
        mark = ";" if ";" in content else "," if "," in content else None
        cells = (content.replace(",", ".") if mark == ";" else content).split(mark)
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            raise InputError(
                f"row {number}: {cut(content)!r} is not a row of numbers; put # before a remark; the rows are "
                "[A B; C D]"
            ) from None
        if len(rows[-1]) != len(rows[0]):
            raise InputError(f"row {number}: {len(rows[-1])} cells, the rows above have {len(rows[0])}: correct it")
    names = [name.strip() for name in stated.get("outputs", "").split(",") if name.strip()]
    n = len(rows[0]) - 1 if rows else 0
    if n < 1 or len(rows) != n + 1 + len(names):
        raise InputError(
            f"{len(rows)} rows of {n + 1} cells: the block matrix [A B; C D] of n states has n + 1 rows and columns, "
            f"and below it a row for each of {len(names)} outputs that a line '# outputs: ...' names"
        )
    block = np.array(rows)
    fed = next((name for name, row in zip(names, block[n + 1 :], strict=True) if row[n] != 0), None)
    if fed is not None:
        raise InputError(f"output {fed}: its last cell must be 0, as limits need outputs of the states alone")
    matrices = {"A": block[:n, :n], "B": block[:n, n:], "C": block[n : n + 1, :n], "D": block[n : n + 1, n:]}
    outputs = {f"{OUTPUT}{name}": row[None, :n] for name, row in zip(names, block[n + 1 :], strict=True)}
    return {**matrices, **outputs}, dict(stated)


def _checked(matrices: Mapping[str, FloatArray], stated: Mapping[str, Any]) -> dict[str, Any]:
    """The matrices as lists, after a check of their shapes."""
    missing = [name for name in "ABC" if name not in matrices]
    if missing:
        has = ", ".join(matrices) or "none of them"
        raise InputError(f"no {missing[0]}: {_ADVICE}; it has {has}")
    A = matrices["A"]
    n = A.shape[0]
    if A.shape != (n, n) or not 1 <= n <= MOST_STATES:
        raise InputError(f"A: of shape {A.shape}, must be square with 1 to {MOST_STATES} rows")
    found: dict[str, Any] = {"A": A.tolist(), "D": 0.0, "outputs": {}}
    several = matrices["B"].shape[0] == n > 1 < matrices["B"].shape[1]  # drives, of which the scene checks the sizes
    for name, matrix in matrices.items():
        most = 1 if name == "D" else n
        if several and name in "BCD":
            found[name] = matrix.tolist()
        elif name != "A" and (matrix.size != most or 1 not in matrix.shape):
            raise InputError(
                f"{name}: of shape {matrix.shape}, must have {most} number{'s' * (most > 1)}, one input and one "
                f"output, for A with {n} states"
            )
        if not np.all(np.isfinite(matrix)):
            raise InputError(f"{name}: holds a number that is not finite; correct it")
        if name.startswith(OUTPUT):
            found["outputs"][name.removeprefix(OUTPUT)] = matrix.ravel().tolist()
        elif name != "A" and not several:
            found[name] = float(matrix.ravel()[0]) if name == "D" else matrix.ravel().tolist()
    if "input" in stated:
        word = str(np.asarray(stated["input"]).ravel()[0]) if np.size(stated["input"]) else ""
        if word not in INPUTS:
            raise InputError(f"input = {cut(word)!r}: must be {' or '.join(INPUTS)}")
        found["input"] = word
    return found


def save_plant(plant: StateSpace, path: Path) -> None:
    """Write a plant and its outputs as an NPZ file for `read_plant`.

    Raises
    ------
    InputError : another ending, or a path that cannot be written.
    """
    if path.suffix.lower() != ".npz":
        raise InputError(f"{path}: a plant file is written as .npz: give a name that ends so")
    arrays: dict[str, Any] = {name: getattr(plant, name) for name in "ABCD"}
    arrays |= {f"{OUTPUT}{name}": output.row for name, output in plant.outputs.items()}
    with whole_file(path) as file:
        np.savez(file, input=np.array(plant.driven_by.name), **arrays)
