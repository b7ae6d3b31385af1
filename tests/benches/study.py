"""What the tests of constraint studies share."""

import csv
from pathlib import Path
from typing import Any

from transopt.scene.keys import with_values
from transopt.scene.scene import Scene

MODULES = {
    "constraint_study": "constraint_study",
    **{
        name: f"transopt.study.{name}"
        for name in (
            "axes",
            "figures",
            "inverse",
            "motors",
            "named",
            "offnode",
            "report",
            "rows",
            "run",
            "session",
        )
    },
    "scale": "study_scale",
}


def short_scene(scene: Scene) -> Scene:
    """8 ms: the pulse of a tap without its ringing."""
    return with_values(scene, {"time.stages": 80})


def serial(study: Any) -> Any:
    """A pool that solves in this process."""
    return study.run.executor_pool("serial", 1)


def read(path: Path) -> list[dict[str, str]]:
    """Rows of a study."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def plain(path: Path) -> list[dict[str, str]]:
    """Rows of a study without its times."""
    return [{name: cell for name, cell in row.items() if not name.endswith("_ms")} for row in read(path)]
