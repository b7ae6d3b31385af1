"""What reading a library at run time loads."""

import subprocess
import sys
from pathlib import Path

from transopt.library.library import Library


def test_reading_a_library_never_loads_the_optimiser(library: Library, tmp_path: Path) -> None:
    """The runtime path: load, blend, and look at a controller, in a fresh interpreter."""
    library.save(tmp_path / "library.npz")
    program = (
        "import sys; from pathlib import Path; import controller, transopt.library.file as l; "
        "l.load_library(Path(sys.argv[1])).at(0.25, 2.0); "
        "assert not {'casadi', 'matplotlib', 'serial'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "library.npz")], check=True)
