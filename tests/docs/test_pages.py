"""Every page can be reached and built, its links lead somewhere, and what it tells a user to type exists.

Whether an address answers is asked where there is a network: `.ci/run --links`.
"""

import inspect
import json
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable
from functools import cache
from importlib import import_module, util
from pathlib import Path
from urllib.parse import urlsplit

import click
import pytest
import typer

from controller.protocol.codes import Kind, Reason
from controller.servo.interface import Fault, Notice
from tests.benches.places import ROOT
from tests.docs.pages import DOCS, FENCED, PAGES, blocks, fenced, text
from transopt.library.meta import META
from transopt.library.multipliers import ARRAYS
from transopt.problem.answer import Status
from transopt.scene.builtin import load_scene, scene_names
from transopt.scene.keys import keys
from transopt.scene.model_parts import CoilPart, DriveDevice, FourthOrderHand, SecondOrderHand

STAMP = re.compile(r"^\*`.*\*$", re.MULTILINE)  # names a commit, at which its command was another one perhaps
OUTPUT = {"text", "bibtex"}
RUN = {"sh", "python", "toml", "c"}  # by tests/docs/test_blocks.py, or a comment before the fence says why not
# Sphinx builds these, and executes the cells; what is included is a file that a test runs.
BUILT = {"{toctree}", "{index}", "{include}", "{literalinclude}", "{code-cell}"}
COMMANDS = {
    "transopt": "transopt.cli.main",
    "transopt-play": "controller.cli.play",
    "transopt-device": "controller.cli.device",
}


# Page of the reference -> the words that the code has for it to name.
STATED: dict[str, Callable[[], Iterable[str]]] = {
    "scene_keys": lambda: {
        key.path.removesuffix(".constant").removesuffix(".per_newton")  # a parameter of the hand is one key there
        for name in scene_names()
        for key in keys(load_scene(name))
    },
    "library_file": lambda: [*ARRAYS, *META],
    "model_file": lambda: [
        name for part in (DriveDevice, SecondOrderHand, FourthOrderHand, CoilPart) for name in part.model_fields
    ],
    "faults": lambda: [*(fault.name for fault in Fault), *(notice.name for notice in Notice)],
    "protocol": lambda: [*(kind.name for kind in Kind), *(reason.name for reason in Reason)],
    "exit_codes": lambda: [status.name for status in Status],
    "commands": lambda: [
        "transopt solve",
        "transopt identify device",
        "transopt-play record sweep",
        "--grid-tolerance",
    ],
}


def test_every_block_says_what_it_is() -> None:
    for page in PAGES:
        assert {block.language for block in fenced(page)} <= OUTPUT | RUN | BUILT, page
        assert len(fenced(page)) == len(re.findall(r"^```", text(page), flags=re.MULTILINE)) / 2, page
        indented = re.findall(r"\n\n( {4}\S.*)", FENCED.sub("", text(page)))
        assert not indented, f"{page}: a block without a fence cannot say what it is"


def test_python_compiles_and_toml_parses() -> None:
    for page in PAGES:
        for block in blocks(page, "python"):
            compile(block, str(page), "exec")
        for block in blocks(page, "toml"):
            assert not (said := _wrong_toml(block)), f"{page}: {said}\n{block}"


def test_commands_and_their_options_exist() -> None:
    for page in PAGES:
        spans = re.findall(r"`([^`]+)`", FENCED.sub("", text(page)))
        lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
        typed = [*(span.split() for span in spans), *(shlex.split(line, comments=True) for line in lines)]
        for words in typed:
            if words and words[0] in COMMANDS:
                _check(page, words)


def test_places_in_the_code_exist() -> None:
    for page in PAGES:
        for file, name in re.findall(r"`((?:\w+/)+\w+\.\w+)(?::(\w+))?`", FENCED.sub("", text(page))):
            if file.split("/")[0] not in ("transopt", "controller", "problems", "scripts", "tests", "docs"):
                continue
            assert (ROOT / file).exists(), f"{page}: {file}"
            stated = rf"^\s*(?:def|class|async def) {name}\b|^\s*{name}\b[^=\n]*=|^[\w *]+\b{name}\("
            if name:
                assert re.search(stated, text(file), re.MULTILINE), f"{page}: {file}:{name}"


def test_scripts_and_their_options_exist() -> None:
    for page in PAGES:
        for name, options in re.findall(r"python (scripts/[a-z_]+\.py)([^`|\n]*)", STAMP.sub("", text(page))):
            assert (ROOT / name).exists(), f"{page}: {name}"
            for option in re.findall(r"--[\w-]+", options):
                assert option in sources(ROOT / name), f"{page}: {name} {option}"


def test_campaigns_and_their_options_exist() -> None:
    for page in PAGES:
        for name, options in re.findall(r"python -m pytest [^`|\n]*(tests/campaigns/\w+\.py)([^`|\n]*)", text(page)):
            main = import_module(name.removesuffix(".py").replace("/", ".")).main
            for option in re.findall(r"--[\w-]+", options.removeprefix(" --campaign").replace("--help", "")):
                known = inspect.signature(main).parameters
                assert option[2:].replace("-", "_") in known, f"{page}: {name} {option}"


def sources(script: Path) -> str:
    """Sources of a script and of its helpers, some of which read its command line."""
    helpers = [path for path in (ROOT / "scripts").glob("*/*.py") if path.parent.stem in script.read_text()]
    return "\n".join(path.read_text(encoding="utf-8") for path in (script, *helpers))


def _wrong_toml(block: str) -> str:
    try:
        tomllib.loads(block)
    except tomllib.TOMLDecodeError as wrong:
        return str(wrong)
    return ""


@cache
def _command(name: str) -> click.Command:
    return typer.main.get_command(import_module(COMMANDS[name]).app)


def _check(page: Path, words: list[str]) -> None:
    command = _command(words[0])
    rest = words[1:]
    while rest and (isinstance(command, click.Group) or hasattr(command, "commands")):
        assert rest[0] in command.commands, f"{page}: {' '.join(words)}"  # type: ignore[union-attr]
        command, rest = command.commands[rest[0]], rest[1:]  # type: ignore[union-attr]
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    asked = {word.split("=")[0] for word in rest if word.startswith("--")}
    assert asked <= known, f"{page}: {' '.join(words)}: {asked - known}"


def test_readme_is_one_page_with_a_figure_at_its_top() -> None:
    lines = text("README.md").splitlines()
    assert len(lines) <= 150
    assert any(line.startswith("![") for line in lines[:20])
    installs, tests = blocks("README.md", "sh")
    assert "transopt solve" in installs
    assert "pytest" in tests


@pytest.mark.skipif(
    any(util.find_spec(name) is None for name in ("sphinx", "myst_nb", "furo")),
    reason="the extra docs is not installed: pip install -e '.[docs]'",
)
@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_manual_builds_without_a_warning(tmp_path: Path) -> None:
    """Every page, its cells run; a link within the manual that leads nowhere is a warning."""
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-n", "-q", str(DOCS), str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    index = json.loads((tmp_path / "searchindex.js").read_text(encoding="utf-8")[len("Search.setIndex(") : -1])
    assert index["docnames"][index["indexentries"]["install"][0][0]] == "start/everything", "what search shows first"
    for name, stated in STATED.items():
        page = re.sub("<[^>]*>", "", (tmp_path / f"reference/{name}.html").read_text(encoding="utf-8"))
        missing = [word for word in stated() if word not in page]
        assert not missing, f"reference/{name}.md lacks {missing}"


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
