"""Paths of the things that tests read as files."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
# Real recorded impacts, beside a checkout and no part of it: tests that need them skip where they are absent.
IMPACTS = ROOT.parent / "shared" / "data" / "impacts"
CASES = ROOT.parent / "shared" / "data" / "cases"  # small files as people bring them
