"""What an array of a library is: its shape, unit and meaning, declared where `Library` names it.

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
SEVERAL = "mp"  # letters of motors and directions, which arrays have where there are several


@dataclass(frozen=True)
class Array:
    """Declaration of one array.

    Attributes
    ----------
    shape : one letter for each dimension: v speeds, g grips, N stages, M samples after them, L instants before them
        that no command can reach, h samples of the hand-over, n states of the plant, s further devices of a robust
        entry, i inputs and o tracked accelerations of the plant; a digit is that size. m motors and p directions are
        there in a library of several motors alone, whose q devices have a place each.
    unit : SI, with C for degrees Celsius; empty for what has none.
    meaning : what it holds.
    is_text : words and not double-precision numbers.
    may_be_nan : NaN stands for what is not known; every other number is finite.
    needs : what has to be stated for the array to stand in the file: a key of the scene's `limits`, `spread`, `worst`
        (as what is minimised over the spread), `nonlinear`, `one motor` or `several motors`, named `targets`,
        `intensity` as the objective, or a `refinement` or `instants_within` in `meta`
        (`transopt.library.meta.stated`); empty for an array that is always there. Without it the array is zero or
        empty, or of no device.
    made : its value for one entry (`transopt.design.entry.Entry`), from which a library is assembled and by which an
        entry that is solved again takes its place; None for what is not of single entries.
    replayed : whether `verify` makes it again to compare, from the problem and a replay of the file's own command.
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
        """Whether it has every direction of a plant that has several."""
        return "p" in self.shape

    def letters(self, known: Container[str]) -> list[str]:
        """Letters of its dimensions; those of motors and directions only where their numbers are known."""
        return [letter for letter in self.shape if letter not in SEVERAL or letter in known]

    @property
    def type_word(self) -> str:
        return "text" if self.is_text else "float64"

    def fits(self, dtype: np.dtype[Any]) -> bool:
        """Whether an array of this type can be it."""
        return dtype.kind == "U" if self.is_text else (dtype.kind, dtype.itemsize) == ("f", 8)


def kept(shape: str, unit: str, meaning: str, made: str | Callable[[Any], Any] = "", **more: Any) -> Any:
    """A field of a dataclass that declares an array; `made` may name an attribute of the entry, with dots."""
    of_entry = (attrgetter(made) if made else None) if isinstance(made, str) else made
    return field(metadata={"array": Array(shape, unit, meaning, made=of_entry, **more)})


def declared(owner: type) -> dict[str, Array]:
    """Name -> declaration of every field that has one, in their order."""
    return {each.name: each.metadata["array"] for each in fields(owner)}


def absent(arrays: dict[str, Array], stated: Set[str]) -> list[str]:
    """Names of the arrays that a file does not have where this and no more is stated."""
    return [name for name, array in arrays.items() if array.needs and array.needs not in stated]


def content_hash(arrays: dict[str, NDArray[Any]]) -> str:
    """SHA-256 over names, types, shapes and bytes of all arrays, by name in alphabetical order."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
