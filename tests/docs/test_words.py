"""What is written by hand in the manual: how much, in sentences of which length, with formulas that are typeset."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.pages import DOCS, FENCED, PAGES, fenced, named, text
from tests.docs.test_prose import OPENER
from transopt.library.columns import COLUMNS

MOST_WORDS = 35_000
SHORTEST, LONGEST = 4, 30  # words of a sentence; what is shorter is a name or a number in a table
LONGER = 0.05  # share of sentences that may be longer
APPENDIX = DOCS / "results"
GENERATED = (DOCS / "CHANGELOG.md", DOCS / "reference/protocol.md")
BY_SCRIPT = re.compile(r"^<!-- (?:written by|output of|tables of).*?^<!-- end -->$", re.DOTALL | re.MULTILINE)
ITEM = re.compile(r"^(?:[-*]|\d+\.) ")
SENTENCE = re.compile(r"(?<=[.!?:;])\**\s+(?=[A-Z*\"(`])")
OPERATOR = re.compile(r"[\^≤≥]|<=|>=| [-+*/] |\w\(\w+\) =|sum_")
# Code that is no formula: commands, paths, choices, and what a person types.
TYPED = re.compile(r"transopt|python|pip|git|--|\.(?:py|toml|md|npz|c|h)\b|/\w+/|Settings|arm-none|[=\"]\"")


def hand_written(page: Path) -> str:
    """A page without code, output, comments, and what a script has written onto it."""
    prose = FENCED.sub("\n\n", BY_SCRIPT.sub("\n\n", text(page)))
    prose = re.sub(r"\A---\n.*?\n---\n|<!--.*?-->", "", prose, flags=re.DOTALL)
    return re.sub(r"^\*`.*\*$", "", prose, flags=re.MULTILINE)


def counted() -> list[Path]:
    """Pages of the manual that are read: not the appendix of measured tables, generated tables or the change log."""
    pages = [page for page in PAGES if page.is_relative_to(DOCS) and page not in GENERATED]
    return [page for page in pages if page.parent != APPENDIX or page.name == "index.md"]


def words(prose: str) -> int:
    return sum(any(letter.isalnum() for letter in word) for word in prose.split())


def paragraphs(prose: str) -> Iterator[str]:
    """Paragraphs, list items, headings and cells of tables."""
    lines: list[str] = []
    for line in (*re.sub(r"\$\$.*?\$\$", " X ", prose, flags=re.DOTALL).splitlines(), ""):
        bare = line.strip()
        if not bare or bare[0] in "|#" or ITEM.match(bare):
            yield " ".join(lines)
            lines = []
        if bare.startswith("|"):
            yield from (cell.strip() for cell in re.split(r"(?<!\\)\|", bare))
        elif bare:
            lines.append(ITEM.sub("", bare).strip("# "))


def sentences(prose: str) -> list[str]:
    found = []
    for paragraph in paragraphs(prose):
        plain = re.sub(r"`[^`]*`|\$[^$]*\$", "CODE", re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", paragraph))
        found += [sentence for sentence in SENTENCE.split(plain) if len(sentence.split()) >= SHORTEST]
    return found


def test_the_manual_can_be_read() -> None:
    by_page = {named(page): words(hand_written(page)) for page in counted()}
    assert sum(by_page.values()) <= MOST_WORDS, sorted(by_page.items(), key=lambda item: -item[1])[:20]


def test_most_sentences_are_short() -> None:
    all_of_them = [(named(page), sentence) for page in PAGES for sentence in sentences(hand_written(page))]
    longer = [(page, sentence) for page, sentence in all_of_them if len(sentence.split()) > LONGEST]
    share = len(longer) / len(all_of_them)
    assert share <= LONGER, "\n".join([f"{100 * share:.1f} % are longer:", *(f"{p}: {s}" for p, s in longer)])


def test_nothing_leans_on_the_heading_above_it() -> None:
    for page in PAGES:
        prose = re.sub(r"[`*]", "", hand_written(page))
        assert [words for words in paragraphs(prose) if OPENER.match(words)] == [], page


@pytest.mark.parametrize("page", sorted((DOCS / "explanation").glob("*.md")), ids=named)
def test_formulas_are_typeset(page: Path) -> None:
    code = re.findall(r"`([^`\n]+)`", hand_written(page))
    assert [span for span in code if OPERATOR.search(span) and not TYPED.search(span)] == []
    blocks = fenced(page)
    printed = [block.prints for block in blocks if block.language in ("python", "sh")]
    alone = [block.code for block in blocks if block.language == "text" and block.code not in printed]
    assert alone == [], "a block of text is what the block of code before it prints"


def test_a_sentence_ends_where_a_reader_ends_it() -> None:
    prose = "# One\n\nOne is a sentence. Another one, by `a. B`: it goes on\nhere; And so it ends.\n"
    prose += "- An item of a list\n\n| a | x |\n"
    ends = ["One is a sentence.", "Another one, by CODE: it goes on here;", "And so it ends.", "An item of a list"]
    assert sentences(prose) == ends


def test_the_page_of_results_says_what_the_appendix_says() -> None:
    for line in text(APPENDIX / "index.md").splitlines():
        details = re.findall(r"\]\((\w+\.md)\)", line)
        if line.startswith("| ") and details:
            measured = "\n".join(text(APPENDIX / page) for page in details)
            answer = line.split("|")[2]
            for number in re.findall(
                r"(?<![\w-])\d+(?:[.,]\d+)*(?: \d{3})*(?:e-?\d+)?", re.sub(r"`[^`]*`", "", answer)
            ):
                # A number of its own: not a part of a longer one, of a commit or of a date.
                assert re.search(rf"(?<![\w.,-]){re.escape(number)}(?![\w-]|[.,]\d)", measured), (
                    f"{number} of: {line}"
                )


def test_the_glossary_has_every_column_of_a_table() -> None:
    """The others it includes from the code."""
    glossary = text(DOCS / "reference/glossary.md")
    unsaid = [column.head.partition(" {")[0].removesuffix(" %") for column in COLUMNS.values() if not column.meaning]
    assert [head for head in unsaid if head.split(",")[0] not in glossary] == []


def test_the_drawing_is_what_its_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    import device_drawing

    assert device_drawing.FILE.read_text(encoding="utf-8") == device_drawing.drawing()
