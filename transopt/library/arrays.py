"""The declaration of a library's array: shape, unit and meaning, stated beside its name in `Library`.

A field of `Library` is annotated with its `Array`. Saving, loading, checking and exporting a library read these
declarations, so that an array is added or changed in one place.
"""

import hashlib
from collections.abc import Callable, Container, Set
from dataclasses import dataclass, field, fields
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

HASH_FIELD = "content_sha256"
SEVERAL = "mp"  # letters of motors and directions; an array has these dimensions only if there are several


@dataclass(frozen=True)
class Array:
    """Declaration of one array.

    Attributes
    ----------
    shape : one letter per dimension. v speeds, g grips, N stages, M samples after them, L instants before them that
        no command can reach, h samples of the hand-over, n states of the plant, s further devices of a robust entry,
        i inputs and o tracked accelerations of the plant; a digit is a fixed size. m motors and p directions are
        dimensions only in a library of several motors, which has q devices, each with its place.
    unit : SI, with C for degrees Celsius; empty for a quantity without a unit.
    meaning : what the array holds.
    is_text : whether it holds text; otherwise it holds double-precision numbers.
    may_be_nan : whether NaN may stand for an unknown number; all other numbers are finite.
    needs : condition for the array to be in the file: a key of the scene's `limits`, `spread`, `worst`
        (the objective over the spread), `nonlinear`, `one motor`, `several directions`, an `arm`, named `targets`,
        `intensity` as the objective, or a `refinement` or `instants_within` in `meta`
        (`transopt.library.meta.stated`); empty for an array that is always in the file. An array that is not in the
        file is zero or empty, or has no devices.
    made : computes its value for one entry (`transopt.design.entry.Entry`). A library is assembled from these values,
        and an entry that is solved again is replaced by them. None for an array that is not per entry.
    replayed : whether `verify` computes it again from the problem and a replay of the file's command, to compare.
    """

    shape: str
    unit: str
    meaning: str
    is_text: bool = False
    may_be_nan: bool = False
    needs: str = ""
    made: Callable[[Any], Any] | None = None
    replayed: bool = False

    @property
    def is_directed(self) -> bool:
        """Whether it has a dimension of directions, for a plant with several."""
        return "p" in self.shape

    def letters(self, known: Container[str]) -> list[str]:
        """Letters of its dimensions; those of motors and directions only where their numbers are known."""
        return [letter for letter in self.shape if letter not in SEVERAL or letter in known]

    @property
    def type_word(self) -> str:
        return "text" if self.is_text else "float64"

    def fits(self, dtype: np.dtype[Any]) -> bool:
        """Whether an array of this type matches the declaration."""
        return dtype.kind == "U" if self.is_text else (dtype.kind, dtype.itemsize) == ("f", 8)


def kept(shape: str, unit: str, meaning: str, made: str | Callable[[Any], Any] = "", **more: Any) -> Any:
    """A dataclass field that declares an array; `made` may be the dotted path of an attribute of the entry."""
    of_entry = (attrgetter(made) if made else None) if isinstance(made, str) else made
    return field(metadata={"array": Array(shape, unit, meaning, made=of_entry, **more)})


def declared(owner: type) -> dict[str, Array]:
    """Name -> declaration of every field that declares an array, in the order of the fields."""
    return {each.name: each.metadata["array"] for each in fields(owner)}


def absent(arrays: dict[str, Array], stated: Set[str]) -> list[str]:
    """Names of the arrays that are not in the file if these conditions (`Array.needs`) hold and no other."""
    return [name for name, array in arrays.items() if array.needs and array.needs not in stated]


def content_hash(arrays: dict[str, NDArray[Any]]) -> str:
    """SHA-256 over names, types, shapes and bytes of all arrays, in alphabetical order of their names."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
