"""Scripts, loaded as `python scripts/NAME.py` loads them: from their folder, which no test imports from."""

import sys
from importlib import import_module
from types import ModuleType

from tests.benches.places import ROOT

SCRIPTS = ROOT / "scripts"


def script(name: str) -> ModuleType:
    """A script, or with a dot a part of one, from the folder of scripts.

    The folder stays on the path, as for a script that is called: processes that a script starts look there too.
    """
    if str(SCRIPTS) not in sys.path:
        sys.path.append(str(SCRIPTS))
    return import_module(name)
