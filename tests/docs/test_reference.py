"""The generated reference: what it is made of says all that the code does."""

import ast
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from controller.servo.interface import Fault
from tests.benches.model_parts import (
    amplifier_part,
    coil_part,
    drive_device,
    fourth_order_hand,
    hand_part,
    state_space_device,
)
from tests.benches.oracle.faults import FAULTS
from tests.benches.places import ROOT
from tests.docs.pages import DOCS
from transopt.base.section import Section, meanings
from transopt.design.build import build_library
from transopt.library.library import Library
from transopt.library.meta import META
from transopt.scene.builtin import load_scene, scene_names
from transopt.scene.keys import keys, with_values
from transopt.scene.recordings import recordings_of

ENDS = "Exit 1: "


@pytest.fixture(scope="module")
def reference() -> Iterator[Any]:
    """The module that writes the generated pages; it lies beside them."""
    sys.path.insert(0, str(DOCS))
    yield import_module("reference_pages")
    sys.path.remove(str(DOCS))


def _ends_with_1(folder: str) -> set[str]:
    """Functions of a folder of commands from which exit code 1 can be reached, by the names that they call."""
    calls: dict[str, set[str]] = {}
    found: set[str] = set()
    for path in (ROOT / folder).glob("*.py"):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(function, ast.FunctionDef):
                continue
            names = calls.setdefault(function.name, set())
            for node in ast.walk(function):
                match node:
                    case ast.Call(func=ast.Name(id=name)):
                        names.add(name)
                    case ast.Call(func=ast.Attribute(attr="Exit"), args=[ast.Constant(value=1) | ast.Name()]):
                        found.add(function.name)
    while more := {name for name, called in calls.items() if called & found} - found:
        found |= more
    return found


class TestExitCodes:
    def test_a_command_that_can_fall_short_says_so_and_no_other_does(self, reference: Any) -> None:
        can = _ends_with_1("transopt/cli") | _ends_with_1("controller/cli")
        for words, command in reference.leaves():
            assert (ENDS in command.help) == (command.callback.__name__ in can), words


class TestFaults:
    def test_each_has_a_rule_and_words(self, reference: Any) -> None:
        assert [rule.fault for rule in FAULTS] == list(reference.SEEN_WHEN)
        assert set(reference.SEEN_WHEN) == set(Fault)


def paths(meta: dict[str, Any], before: str = "") -> Iterator[str]:
    """Dotted paths of all keys, not below those that are kept whole."""
    for key, value in meta.items():
        path = f"{before}{key}"
        yield path
        if isinstance(value, dict) and not (path in META and META[path].whole):
            yield from paths(value, f"{path}.")


class TestMeta:
    @pytest.mark.parametrize("name", ["walled", "hot_coil", "low_supply", "second_order", "ideal_amplifier"])
    def test_all_that_is_written_is_declared(self, name: str) -> None:
        scene = with_values(load_scene(name), {"grid.speeds_m_s": [0.2], "grid.grips_N": [3.0]})
        built = build_library(scene, recordings_of(scene))
        assert set(paths(built.library.meta)) <= set(META)

    def test_all_that_is_needed_is_written(self, library: Library) -> None:
        written = set(paths(library.meta))
        assert {path for path, stated in META.items() if stated.needed} <= written


def test_every_key_of_a_scene_has_a_sentence() -> None:
    found = {key.path: key.description for name in scene_names() for key in keys(load_scene(name))}
    assert [path for path, said in found.items() if not said.strip()] == []


def test_examples_are_of_keys_that_there_are(reference: Any) -> None:
    listed = reference.scene_keys()
    assert [key for key in import_module("key_pages").EXAMPLES if f"| `{key}` |" not in listed] == []


class TestModelFile:
    @pytest.mark.parametrize(
        "part",
        [amplifier_part(), drive_device(), state_space_device(), hand_part(), fourth_order_hand(), coil_part()],
        ids=type,
    )
    def test_every_field_has_a_meaning(self, reference: Any, part: Section) -> None:
        assert set(type(part).model_fields) <= set(meanings(type(part)))
        page = reference.model_file()
        assert type(part).__name__ in page
        assert all(f"`{name}`" in page for name in type(part).model_fields)


def test_a_page_includes_every_part(reference: Any) -> None:
    pages = "\n".join(path.read_text(encoding="utf-8") for path in Path(DOCS).rglob("*.md"))
    assert all(f"generated/{name}.md" in pages for name in reference.PARTS)
