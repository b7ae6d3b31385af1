"""Pages of the manual and README, and the code blocks in them."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

from tests.benches.places import ROOT

DOCS = ROOT / "docs"
GENERATED = DOCS / "reference/generated"
PAGES = [
    ROOT / "README.md",
    *(page for page in sorted(DOCS.rglob("*.md")) if page.parent != GENERATED),
]
FENCED = re.compile(
    r"(?:^<!-- not run: (?P<why>[^\n]+) -->\n+)?^```(?P<language>[^\n`]*)\n(?P<code>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
NAMED = re.compile(r"\A# ([\w.-]+\.(?:py|toml))$", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes
    ----------
    language : the first word after the fence.
    code : what stands in it.
    why_not : a comment before the fence, `<!-- not run: WHY -->`, says why it is not run; empty without one.
    prints : the block of output that follows it on the page with nothing but space between; empty without one.
    """

    language: str
    code: str
    why_not: str = ""
    prints: str = ""

    @property
    def file(self) -> str | None:
        """The file that a reader saves it as, if its first line is a comment with nothing but that name."""
        named = NAMED.match(self.code)
        return named and named[1]


def text(page: str | Path) -> str:
    """Text of a page by its path in the checkout."""
    return (ROOT / page).read_text(encoding="utf-8")


def named(page: Path) -> str:
    """A page by its path in the checkout."""
    return page.relative_to(ROOT).as_posix()


def fenced(page: str | Path) -> list[Block]:
    """Every fenced block of a page, in order."""
    whole, made = text(page), list[Block]()
    last = None
    for one in FENCED.finditer(whole):
        language = (one["language"].split() or [""])[0]
        if language == "text" and last is not None and not whole[last.end() : one.start()].strip():
            made[-1] = replace(made[-1], prints=one["code"])
        made.append(Block(language, one["code"], one["why"] or ""))
        last = one
    return made


def blocks(page: str | Path, language: str) -> list[str]:
    """The code of every fenced block of a language on a page."""
    return [block.code for block in fenced(page) if block.language == language]
