"""Tests the completion of datasheets: each number of published sheets is left out and estimated from the others.

python scripts/sheets.py [--page docs/plants/sheets.md]
"""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from common.command import run
from common.page import PageFile, write_part

import problems
from transopt.base.writing import table
from transopt.scene.rated import TOLERANCE, UNKNOWN, WORDS, Rating, completed, predicted


@dataclass(frozen=True)
class LeftOut:
    """A number of a datasheet and its estimate from the others, in SI.

    Attributes
    ----------
    note : contradiction among the others; empty if they agree.
    """

    key: str
    stated: float
    found: float
    note: str

    @property
    def off(self) -> float:
        """Relative difference between estimate and stated number."""
        return self.found / self.stated - 1


def sheets() -> Iterator[Mapping[str, Any]]:
    """The published sheets, by the names of their files."""
    for path in sorted((problems.FOLDER / "sheets").glob("*.toml")):
        yield tomllib.loads(path.read_text(encoding="utf-8"))


def left_out(sheet: Mapping[str, Any]) -> Iterator[LeftOut]:
    """Every number of a datasheet that the others determine, left out in turn."""
    rating = Rating(sheet.get("case_mass_kg"), sheet.get("L_H", 0.0), sheet.get("rms_V"), sheet.get("rms_A"))
    for key in (key for key in TOLERANCE if key in sheet):
        rest = completed({name: value for name, value in sheet.items() if name != key}, rating)
        found = predicted(np.array([rest.values[name] for name in UNKNOWN]), rating)[key]
        yield LeftOut(key, sheet[key], found, rest.note)


def main(page: PageFile = None) -> int:
    rows, sources = [], []
    for number, sheet in enumerate(sheets(), start=1):
        found = {each.key: each for each in left_out(sheet)}
        said = {key: each.note or f"{each.stated:.4g} ({100 * each.off:+.1f} %)" for key, each in found.items()}
        rows.append([sheet["name"], *(said[key] for key in KEYS)])
        sources.append(f"{number}. {sheet['name']}: <{sheet['source']}>")
    lines = [*table(("sheet", *(WORDS[key] for key in KEYS)), rows), *sources]
    print("\n".join(lines))
    write_part(page, lines)
    return 0


KEYS = (
    "resonance_Hz",
    "R_ohm",
    "moving_mass_kg",
    "force_factor_N_A",
    "quality",
    "quality_electrical",
    "quality_total",
    "stiffness_N_m",
)  # of all sheets, in the order of the page's columns

if __name__ == "__main__":
    run(main)
