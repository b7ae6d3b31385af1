"""A library's multipliers by their names in the file, and the declarations of all its arrays."""

import itertools
from collections.abc import Mapping

from transopt.base.signals import FloatArray
from transopt.library.arrays import Array, declared
from transopt.library.held import Held
from transopt.problem.answer import Multipliers, Pair
from transopt.problem.limits import KINDS, OF_OUTPUTS, kinds_for
from transopt.problem.limits.input import SHARES
from transopt.problem.limits.limit import SIDES
from transopt.problem.limits.output import row_within
from transopt.problem.limits.own import OwnLimit, follows_motion
from transopt.problem.limits.row import device_row, motor_row
from transopt.problem.posing import Posing


def _multiplier_arrays() -> dict[str, tuple[str, Array]]:
    found: dict[str, tuple[str, Array]] = {}
    for kind in KINDS:
        for row, side in itertools.product(kind.row_names, kind.sides):
            name, meaning = f"mu_{row}_{side}", f"multiplier of the {side} bound on the {kind.label}"
            unit = f"1/{kind.step_unit}"
            if name in found and (before := found[name][1].unit) != unit:
                unit = f"{before} or {unit}"  # a limit on both kinds of input has both units
            found[name] = row, Array("vgN", unit, meaning, needs=kind.stored_with(row) or "one motor")
    return found


# Array -> (row it belongs to, declaration), in the order of the limits.
MULTIPLIERS = _multiplier_arrays()
ARRAYS = {**declared(Held), **{name: array for name, (_, array) in MULTIPLIERS.items()}}


def is_of_entries(name: str) -> bool:
    """Whether an array holds answers; otherwise it states the problems."""
    return name not in ARRAYS or name in MULTIPLIERS or ARRAYS[name].made is not None


def of_sides(multipliers: Multipliers) -> dict[str, FloatArray]:
    """Name of an array -> (N,) multipliers of one side of a row, of all sides that have one above zero."""
    return {
        f"mu_{row}_{side}": values
        for row, pair in multipliers.pairs.items()
        if multipliers.most(row) > 0
        for side, values in zip(SIDES, pair, strict=True)
        if values.any()
    }


def pairs_of(sides: Mapping[str, FloatArray], nothing: FloatArray) -> dict[str, Pair]:
    """`Multipliers.pairs` from the result of `of_sides`; `nothing` (N,) for a side that it does not have."""
    return {
        row: (sides.get(f"mu_{row}_{SIDES[0]}", nothing), sides.get(f"mu_{row}_{SIDES[1]}", nothing))
        for row in dict.fromkeys(map(row_of, sides))
    }


def row_of(array: str) -> str:
    """The row whose multipliers an array holds."""
    return array.removeprefix("mu_").rsplit("_", 1)[0]


def further_arrays(posing: Posing, spread: int, parts: int) -> list[str]:
    """Names of the multiplier arrays that not every library has, from its limits and its input.

    They belong to the limits of each of several motors, to the user's own limits, to limits on outputs at instants
    within the servo periods and, for each further device of a spread, to the limits on its motion.

    Parameters
    ----------
    spread : number of further devices. parts : largest number of parts of a servo period at whose ends a limit holds.
    """
    limits, drive = posing.asked, posing.driven_by
    own, kinds = limits.get(OwnLimit.key) or [], kinds_for(drive, posing.circuit)
    of_each = [kind for kind in kinds if kind.of_each_device and limits.get(kind.key) is not None]
    inside = [row_within(kind.name, share) for kind in OF_OUTPUTS if kind in of_each for share in kind.shares(parts)]
    of_motor = [kind for kind in kinds if kind.of_each_motor and (kind.in_every_file or limits.get(kind.key))]
    numbers = range(len(limits.get(SHARES) or ()))
    motors = [motor_row(row, j) for j in numbers for kind in of_motor for row in kind.row_names]
    rows = [*(row for kind in of_each for row in kind.row_names), *inside]
    rows += [table["name"] for table in own if follows_motion(table["outputs"], drive)]
    found = [*motors, *(table["name"] for table in own), *inside]
    found += [device_row(row, device) for device in range(1, spread + 1) for row in dict.fromkeys(rows)]
    return [f"mu_{row}_{side}" for row in found for side in SIDES]
