"""Pages of the manual and README, and the code blocks in them."""

import re
from pathlib import Path

from tests.benches.places import ROOT

DOCS = ROOT / "docs"
GENERATED = DOCS / "reference/generated"
PAGES = [
    ROOT / "README.md",
    ROOT / "controller/firmware/port/BRINGUP.md",
    *(page for page in sorted(DOCS.rglob("*.md")) if page.parent != GENERATED),
]


def text(page: str | Path) -> str:
    """Of a page by its path in the checkout."""
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str | Path, language: str) -> list[str]:
    """Every fenced block of a language on a page."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text(page), flags=re.DOTALL | re.MULTILINE)
