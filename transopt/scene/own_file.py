"""Reads the user's own limits: Python files with a list `LIMITS` of results of `transopt.own_limit`.

Such a file is a program of the user and is executed when a scene that names it is read. This package depends neither
on its expressions nor on CasADi; each limit describes itself as a table.
"""

import runpy
import traceback
from pathlib import Path
from typing import Any

from transopt.base.errors import InputError
from transopt.base.files import is_file

LIST = "LIMITS"


def own_tables(scene: Path, named: Any, stages: int) -> list[dict[str, Any]]:
    """The tables of all limits in the named files, whose paths are relative to the scene's folder.

    Parameters
    ----------
    named : the scene's value of `limits.own`; tables in it are kept.
    stages : number of stages of the scene's horizon, over which stage-dependent numbers are written out.

    Raises
    ------
    InputError : no such file, a file that raises an error, or one without limits.
    """
    if not isinstance(named, list):
        raise InputError(f'{scene}: limits.own = {named!r}: must be a list of files, as in own = ["my_limits.py"]')
    found: list[dict[str, Any]] = []
    for each in named:
        found += [each] if isinstance(each, dict) else _read(scene, each, stages)
    names = [table.get("name") for table in found]
    if len(set(names)) < len(names):
        raise InputError(f"{scene}: limits.own: two limits have the name {max(names, key=names.count)}: rename one")
    return found


def _read(scene: Path, named: Any, stages: int) -> list[dict[str, Any]]:
    if not isinstance(named, str):
        raise InputError(f"{scene}: limits.own: {named!r} is not the name of a file")
    path = scene.parent / named
    if not is_file(path):
        raise InputError(f"{scene}: limits.own = {named!r}: no such file in {scene.parent}")
    try:
        stated = runpy.run_path(str(path)).get(LIST)
        if not isinstance(stated, list) or not stated:
            raise InputError(f"it has no list {LIST} of limits: LIMITS = [transopt.own_limit(...)]")
        return [limit.table(stages) for limit in stated]
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # a user's program may raise anything
        line = next(
            (f.lineno for f in reversed(traceback.extract_tb(error.__traceback__)) if f.filename == str(path)), 0
        )
        words = str(error).strip().splitlines() or [""]
        raise InputError(f"{path}, line {line}: {type(error).__name__}: {words[-1]}") from None
