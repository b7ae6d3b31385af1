"""TOML files edited line by line."""

import pytest

from transopt.base.toml_edit import edited


def test_a_changed_line_says_what_stood_there() -> None:
    text = '# a\n[limits]\nbeta = 3.2  # wide\nwords = "a # b"\nmany = [1,\n  2]  # two\n\n[grid]\nspeeds = [1.0]\n'
    found = edited(text, {"limits.beta": 2.0, "limits.words": "c", "limits.many": [3], "grid.speeds": None, "x.y": 1})
    assert 'beta = 2.0  # wide (was 3.2)\nwords = "c"  # (was "a # b")\nmany = [3]' in found
    assert "# speeds = [1.0]" in found
    assert found.endswith("[x]\ny = 1\n")


def test_a_table_takes_the_place_of_another_with_all_that_is_in_it() -> None:
    text = "[a]\nx = 1\n# said\n[a.b]\ny = 2\n[c]\nz = 3\n"
    assert edited(text, {"a": {"w": "v"}}) == '[a]\nw = "v"\n# said\n[c]\nz = 3\n'
    assert edited(text, {"d": {"w": 1.0}}) == f"{text}\n[d]\nw = 1.0\n"


@pytest.mark.parametrize("text", ["", "limits = { beta = 3.2 }\n", "limits.beta = 3.2\n", "no text"])
def test_what_is_not_stated_line_by_line_is_not_edited(text: str) -> None:
    assert edited(text, {"limits.beta": 2.0}) is None


@pytest.mark.parametrize(
    ("line", "new"),
    [
        ("# beta = 3  # wide", "beta = 2.0  # wide"),
        ("#beta =", "beta = 2.0"),
        ("# beta =  # share", "beta = 2.0  # share"),
    ],
)
def test_a_key_that_a_comment_states_takes_its_place(line: str, new: str) -> None:
    text = "# beta = 9\n[limits]\nwide = 1\n{}\n[grid]\n# beta = 4\n"
    for noted in (True, False):
        assert edited(text.format(line), {"limits.beta": 2.0}, noted=noted) == text.format(new)
    assert edited(text.format("beta = 1"), {"limits.beta": 2.0}, noted=False) == text.format("beta = 2.0")
