"""Every page can be reached and built, and what it tells a user to type exists."""

import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable
from importlib import util
from pathlib import Path

import click
import pytest
import typer

from controller.protocol.codes import Kind, Reason
from tests.benches.places import ROOT
from tests.docs.pages import DOCS, PAGES, blocks, text
from transopt.library.library import ARRAYS
from transopt.problem.answer import Status
from transopt.scene.builtin import load_scene
from transopt.scene.keys import keys

LANGUAGES = {"sh", "python", "toml", "text", "bibtex", "{toctree}", "{include}", "{code-cell}"}
COMMANDS = {
    "transopt": "transopt.cli.main",
    "transopt-play": "controller.cli.play",
    "transopt-device": "controller.cli.device",
}


# Page of the reference -> the words that the code has for it to name.
STATED: dict[str, Callable[[], Iterable[str]]] = {
    "scene_keys": lambda: [key.path for key in keys(load_scene("wood_on_foam"))],
    "library_file": lambda: ARRAYS,
    "messages": lambda: [*(kind.name for kind in Kind), *(reason.name for reason in Reason)],
    "exit_codes": lambda: [status.name for status in Status],
    "commands": lambda: [
        "transopt solve",
        "transopt identify device",
        "transopt-play record sweep",
        "--grid-tolerance",
    ],
}


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=named)
class TestPage:
    def test_every_block_says_what_it_is(self, page: Path) -> None:
        opened = re.findall(r"^```(.*)$", text(page), flags=re.MULTILINE)[::2]
        assert {first.split(" ")[0] for first in opened} <= LANGUAGES

    def test_links_lead_somewhere(self, page: Path) -> None:
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text(page)):
            assert target.startswith("https://") or (page.parent / target).exists(), target

    def test_python_compiles_and_toml_parses(self, page: Path) -> None:
        for block in blocks(page, "python"):
            compile(block, str(page), "exec")
        for block in blocks(page, "toml"):
            tomllib.loads(block)

    def test_commands_and_their_options_exist(self, page: Path) -> None:
        for block in blocks(page, "sh"):
            for line in block.splitlines():
                words = shlex.split(line, comments=True)
                if words and words[0] in COMMANDS:
                    _check(words)


def _check(words: list[str]) -> None:
    from importlib import import_module

    app = import_module(COMMANDS[words[0]]).app
    command: click.Command = typer.main.get_command(app)
    rest = words[1:]
    while isinstance(command, click.Group) or hasattr(command, "commands"):
        assert rest[0] in command.commands, " ".join(words)  # type: ignore[union-attr]
        command, rest = command.commands[rest[0]], rest[1:]  # type: ignore[union-attr]
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    asked = {word.split("=")[0] for word in rest if word.startswith("--")}
    assert asked <= known, f"{' '.join(words)}: {asked - known}"


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
@pytest.mark.timeout(300)  # eight pages are run, and the suite may have the processor
def test_the_manual_builds_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-n", "-q", str(DOCS), str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=280)
    assert ended.returncode == 0, ended.stderr
    for name, stated in STATED.items():
        page = re.sub("<[^>]*>", "", (tmp_path / f"reference/{name}.html").read_text(encoding="utf-8"))
        missing = [word for word in stated() if word not in page]
        assert not missing, f"reference/{name}.md lacks {missing}"
