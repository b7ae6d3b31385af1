"""Libraries made of arrays by the names that these have in a file."""

from collections.abc import Mapping
from typing import Any

from transopt.library.library import MULTIPLIERS, Library


def library_of(arrays: Mapping[str, Any], meta: dict[str, Any]) -> Library:
    """A library of all its arrays, those of the multipliers among them."""
    multipliers = {name: array for name, array in arrays.items() if name in MULTIPLIERS}
    others = {name: array for name, array in arrays.items() if name not in MULTIPLIERS}
    return Library(**others, multipliers_of=multipliers, meta=meta)
