"""The first steps of a command, whose loading takes some tenths of a second in which a Ctrl-C may come."""

import gc
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

INSTALLED = Path(__file__).parents[2]  # the folder that holds the packages, in a checkout as in site-packages
# New objects between two searches for garbage. What a command loads it keeps, and most garbage goes without a search:
# after Python's 700 new objects each, a search is made hundreds of times for nothing: a twentieth of the processor's
# time of `transopt solve`. A call from Python gains less, and leaves the number to the program that it is a part of.
COLLECTED_AFTER = 500_000


ARTIST = "matplotlib.artist"


class _Undocumented:
    """An import hook that loads matplotlib's artists without the lists of properties in their docstrings.

    Matplotlib collects these lists from the docstrings of all setters when it is imported, which takes a third of the
    import's time. A command never shows them; for callers from Python the hook is not installed.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Spec of `matplotlib.artist`, with a loader that replaces its list of properties by an empty text."""
        spec = PathFinder.find_spec(fullname, path, target) if fullname == ARTIST else None
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def undocumented(module: ModuleType) -> None:
            execute(module)
            vars(module)["kwdoc"] = lambda artist: ""

        vars(spec.loader)["exec_module"] = undocumented
        return spec


def start(module: str) -> None:
    """Load the module of a command line and call its `main`.

    Until the command line handles signals itself (`transopt.base.terminal.run`), a Ctrl-C ends the process by the
    system's default; Python's own handler would print a traceback from the middle of an import. A Ctrl-C that is
    ignored, as in the background of a shell, stays ignored. If a file with the package's name would be imported in
    place of the package, the process ends with code 2 and one line.

    At exit Python collects garbage among all objects, and again while it unloads the modules. That takes some tenths
    of a second and only frees memory that the process's end frees anyway, so existing objects are exempted from it.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.set_threshold(COLLECTED_AFTER)
    sys.meta_path.insert(0, _Undocumented())
    # Pydantic would read the metadata of all installed packages to find plugins for itself.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    package = module.partition(".")[0]
    stranger = in_the_way(package)
    if stranger is not None:
        print(
            f"error: {ascii(str(stranger))[1:-1]}: stands in the way of the package {package}, which Python "
            "would load in its stead: rename it, or take its folder out of PYTHONPATH",
            file=sys.stderr,
        )
        sys.exit(2)
    try:
        import_module(module).main()
    finally:
        gc.freeze()


def in_the_way(package: str) -> Path | None:
    """The file or folder that Python would import in place of the installed package, found without importing it.

    None if the package itself would be imported.
    """
    found = find_spec(package)
    if found is None:
        return None
    places = [found.origin] if found.has_location and found.origin else list(found.submodule_search_locations or ())
    ours = (INSTALLED / package).resolve()
    for place in map(Path, places):
        if ours not in (place.resolve(), place.resolve().parent):
            return place
    return None
