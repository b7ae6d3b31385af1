"""Named studies: each writes rows, a figure, a report and a finding to a folder of its own."""

import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from transopt.base.errors import InputError
from transopt.base.plotting import save_figure
from transopt.base.terminal import make_folder
from transopt.base.writing import table, write_csv, write_text
from transopt.scene.scene import Scene
from transopt.study.direction import direction, direction_figure, direction_sentence
from transopt.study.executors import Pool
from transopt.study.grid_spacing import spacing_figure, spacing_sentence, spacing_study
from transopt.study.grip_mismatch import mismatch, mismatch_figure, mismatch_sentence
from transopt.study.key_studies import KEY_STUDIES, KeyStudy
from transopt.study.motor_selection import motor_selection
from transopt.study.optima import Proven, proven_sentence
from transopt.study.report import provenance, refusal_lines, study_markdown, summary
from transopt.study.rows import exit_code
from transopt.study.session import run_plan


@dataclass(frozen=True)
class InProcess:
    """A named study that is solved in this process: of commands played where they were not made for, or of an arm.

    Attributes
    ----------
    measure : returns the results, a dataclass per row, and the optima that they rest on.
    figure, finding : make the figure and the text from the results.
    """

    measure: Callable[[Scene], tuple[Sequence[Any], list[Proven]]]
    figure: Callable[[Sequence[Any]], Figure]
    finding: Callable[[Sequence[Any]], str]


IN_PROCESS = {
    "grip_mismatch": InProcess(mismatch, mismatch_figure, mismatch_sentence),
    "grid_spacing": InProcess(spacing_study, spacing_figure, spacing_sentence),
    "direction": InProcess(direction, direction_figure, direction_sentence),
}
OF_AN_ARM = ("direction",)
OF_ONE_MOTOR = (*KEY_STUDIES, *(name for name in IN_PROCESS if name not in OF_AN_ARM), "motor_selection")
STUDIES = (*OF_ONE_MOTOR, *OF_AN_ARM)


@dataclass(frozen=True)
class Written:
    """Results of a study to be written.

    Attributes
    ----------
    report : makes the Markdown from the lines of `provenance`.
    finding : one or two sentences.
    code : exit code, see `exit_code`.
    """

    figure: Figure
    report: Callable[[list[str]], str]
    finding: str
    code: int


def _key_study(study: KeyStudy, name: str, scene: Scene, folder: Path, pool: Pool) -> Written:
    plan = study.plan(scene)
    rows = run_plan(plan, folder, pool, name=name)
    finding = study.finding(plan, rows)
    if not finding:
        reason = next((row["reason"] for row in rows if row["reason"]), "")
        finding = "; ".join([summary(rows), *([f"the first: {reason}"] if reason else [])])
    return Written(
        study.figure(plan, rows),
        lambda head: study_markdown(plan, rows, f"{name}.png", [*head, finding, ""]),
        finding,
        exit_code(rows),
    )


def _in_process(name: str, scene: Scene, folder: Path) -> Written:
    study = IN_PROCESS[name]
    found, optima = study.measure(scene)
    write_csv(optima, folder / "rows.csv")
    write_csv(found, folder / f"{name}.csv")
    fields = list(asdict(found[0]))
    rows = [[f"{v:.4g}" if isinstance(v, float) else v for v in asdict(one).values()] for one in found]
    body = [
        f"![{name}]({name}.png)",
        "",
        f"{proven_sentence(optima)}; errors are shares of 1 ({name}.csv).",
        "",
        *table(fields, rows),
    ]
    finding, code = study.finding(found), exit_code([{"status": one.status} for one in optima])
    return Written(
        study.figure(found),
        lambda head: "\n".join([f"# {scene.name}: {name}", "", *head, finding, "", *body]),
        finding,
        code,
    )


def _motor_selection(name: str, scene: Scene, folder: Path, pool: Pool, search: Sequence[Path]) -> Written:
    found = motor_selection(scene, folder, pool, search)
    for stem, page in found.pages().items():
        save_figure(page, folder / f"{stem}.png", scene.name)
    rows = [row for _, own in found.studies.values() for row in own]
    return Written(
        found.figure(),
        lambda head: "\n".join([*found.report(f"{name}.png", head), *refusal_lines(rows)]),
        found.sentence(),
        exit_code(rows) if found.ranked() and not found.refused else 1,
    )


def write(
    name: str,
    scene: Scene,
    out: Path,
    pool: Pool,
    command: str,
    *,
    search: Sequence[Path] = (),
    figures: Path | None = None,
) -> tuple[int, str]:
    """Solve the missing rows of one named study, and write its files.

    Parameters
    ----------
    out : folder that contains the study's folder, which has the study's name.
    command : what repeats the study, for its report.
    search : folders whose `motors/` hold the files that `motor_selection` compares.
    figures : a folder that receives a copy of the study's figure.

    Returns
    -------
    Exit code and finding.

    Raises
    ------
    InputError : see `run_plan`; or `figures` cannot be written.
    """
    started = time.perf_counter()
    folder = out / name
    make_folder(folder)
    if name in KEY_STUDIES:
        written = _key_study(KEY_STUDIES[name], name, scene, folder, pool)
    elif name in IN_PROCESS:
        written = _in_process(name, scene, folder)
    else:
        written = _motor_selection(name, scene, folder, pool, search)
    save_figure(written.figure, folder / f"{name}.png", scene.name)
    write_text(written.report(provenance(command, time.perf_counter() - started)), folder / "report.md")
    if figures is not None:
        try:
            figures.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / f"{name}.png", figures / f"{name}.png")
        except OSError as error:
            raise InputError(f"--figures {figures}: cannot be written ({error.strerror})") from None
    return written.code, written.finding
