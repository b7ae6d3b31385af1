"""The schematics in the manual are those that the script draws."""

from tests.benches.places import ROOT
from tests.benches.scripts import script


def test_the_drawings_of_the_manual_have_the_values_of_today() -> None:
    for name, text in script("circuit_drawings").drawings().items():
        assert (ROOT / "docs/howto" / name).read_text(encoding="utf-8") == text, "run scripts/circuit_drawings.py"
