"""Links lead somewhere: files, images and headings in the checkout; addresses are well formed.

Whether an address answers is asked where there is a network: `.ci/run --links`.
"""

import re
from pathlib import Path
from urllib.parse import urlsplit

from tests.docs.pages import FENCED, PAGES, text

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)")
INCLUDED = re.compile(r"^```\{include\} (\S+)$", re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Names of the headings of a page and of what it includes, as links into it spell them."""
    prose = FENCED.sub("", text(page))
    headings = re.findall(r"^#{1,6} +(.+?) *$", prose, flags=re.MULTILINE)
    found = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    included = [(page.parent / name).resolve() for name in INCLUDED.findall(text(page))]
    return found.union(*(anchors(one) for one in included if one.exists()))


def links(page: Path) -> list[str]:
    return LINK.findall(re.sub(r"`[^`\n]*`", "", FENCED.sub("", text(page))))


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        for link in links(page):
            path, _, anchor = link.partition("#")
            if urlsplit(link).scheme:
                continue
            target = (page.parent / path).resolve() if path else page
            assert target.exists(), f"{page}: {link}"
            if anchor:
                assert target.suffix == ".md", f"{page}: {link}"
                assert anchor in anchors(target), f"{page}: {link}: {sorted(anchors(target))}"


def test_addresses_are_well_formed() -> None:
    for page in PAGES:
        for link in links(page):
            parts = urlsplit(link)
            if parts.scheme:
                assert parts.scheme == "https", f"{page}: {link}"
                assert re.fullmatch(r"[\w-]+(\.[\w-]+)+", parts.netloc), f"{page}: {link}"


def test_a_heading_is_found_by_its_name(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# What `a_b` is, in %\n\n```sh\n# no heading\n```\n\n## A second-hand *one*\n")
    assert anchors(page) == {"what-a_b-is-in-", "a-second-hand-one"}
