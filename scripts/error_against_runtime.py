"""Error against run time: work-precision diagrams of the project's solvers and their rivals on four entries.

    python scripts/error_against_runtime.py --out DIR [--quick] [--case NAME] [--method FILE.py] [--dump DIR]

Writes work_precision.png, error_against_runtime.md and rows.csv into --out: four minutes of one core, one with
--quick. --method adds the curve of your own solve(qp) (see `precision.qp.QP`), which may take a second argument,
tolerance, and returns x, (x, y) or (x, y, {"iterations": ..., "status": ...}); a run of it is cut at ten seconds and
has failed, unless it hangs inside native code, or on Windows, where nothing can cut it. --dump writes the QPs as NPZ,
to be used without this project.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from common.command import run
from common.measuring import elapsed_ms, on_one_thread
from common.page import PageFile, write_answer, write_part
from precision.cases import SCENES, Case, DisagreementError, case_of_scene, check_name
from precision.figure import save_small, work_precision
from precision.methods import Level, Method, baselines, discretisations, opti_ipopt, project_methods
from precision.periods import measure_periods
from precision.qp import dump
from precision.report import answer, markdown, summaries_of
from precision.run import Effort, Row, measure
from precision.user import user_method
from precision.wheels import PIP_LINE, hpipm, wheels
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from typer import Option

from transopt.base.errors import InputError
from transopt.base.plotting import save_figure
from transopt.base.terminal import make_folder
from transopt.base.writing import write_csv, write_text
from transopt.solvers import program
from transopt.solvers.shape import program_shape
from transopt.solvers.statement import state

FIGURE, REPORT, ROWS = "work_precision.png", "error_against_runtime.md", "rows.csv"
QUICK = Effort(budget_ms=0.0, least=1)
PERIOD_STEPS = 8  # in the progress bar


def of_interest(method: Method, quick: bool) -> Method:
    """Keep, if `quick`, a method's default and high-accuracy setting; of Opti, slow to set up, only the default."""
    if not quick:
        return method
    wanted = {Level.DEFAULT, Level.POINT} if method.name == "opti-ipopt" else {Level.DEFAULT, Level.HIGH, Level.POINT}

    def settings(case: Case) -> list:
        return [setting for setting in method.settings(case) if setting.level in wanted]

    return Method(method.name, method.version, method.kind, settings, method.prepare)


def dump_all(cases: Sequence[Case], folder: Path) -> list[str]:
    """Write the QPs; one line about each case."""
    told = []
    for case in cases:
        if case.qp is None:
            told.append(f"{case.name}: no QP: the temperature is not quadratic in the current; not dumped")
            continue
        dump(case.qp, folder / f"{case.name}.npz")
        told.append(f"{folder / case.name}.npz: {case.entry}, {case.qp.q.size} variables, {case.qp.l.size} rows")
    return told


def measure_all(cases: Sequence[Case], methods: Sequence[Method], effort: Effort, *, periods: bool) -> list[Row]:
    """All rows of all cases, with a progress bar on a terminal and a line per case elsewhere."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    watched = sys.stderr.isatty()
    steps = {case.name: 2 * sum(len(method.settings(case)) for method in methods) for case in cases}
    total = sum(steps.values()) + (PERIOD_STEPS * len(cases) if periods else 0)
    rows: list[Row] = []
    started = time.perf_counter()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not watched) as progress:
        task = progress.add_task("", total=total)
        for case in cases:
            rows += measure(
                case, methods, effort, told=lambda text, done: progress.update(task, description=text, advance=done)
            )
            if periods:
                progress.update(task, description=f"{case.name}: servo rates")
                rows += measure_periods(case, effort)
                progress.advance(task, PERIOD_STEPS)
            if not watched:
                print(f"{case.name}: {time.perf_counter() - started:.0f} s", file=sys.stderr, flush=True)
    return rows


def reading_ms(case: Case) -> float:
    """Time to read one problem's numbers from the CasADi statement, the least of a few runs [ms]."""

    def read() -> None:
        shape = program_shape(case.small)
        program.state_program(shape).qp_data(p=state(case.small).p)

    return min(elapsed_ms(read) for _ in range(5))


def compared(
    out: Annotated[Path | None, Option(help="folder for report, figure and rows")] = None,
    quick: Annotated[bool, Option("--quick", help="default and high-accuracy settings only, one run each")] = False,
    case: Annotated[list[str] | None, Option(help=f"one of {', '.join(SCENES)}; may be repeated")] = None,
    method: Annotated[list[Path] | None, Option(metavar="FILE.py", help="your own solve(qp)")] = None,
    figure: Annotated[
        Path | None, Option(metavar="FILE.png", help="also write the figure here, in few colours")
    ] = None,
    dump: Annotated[Path | None, Option(metavar="DIR", help="write the QPs here as NPZ")] = None,
    page: PageFile = None,
) -> int:
    if out is None and dump is None:
        raise InputError("nothing to do: state --out DIR, --dump DIR or both")
    names = list(dict.fromkeys(case or SCENES))
    for name in names:
        check_name(name)
    users = [user_method(path) for path in method or []]
    if figure is not None and figure.suffix.lower() != ".png":
        raise InputError(f"--figure {figure}: a PNG is written: give it the suffix .png")
    if figure is not None and not figure.parent.is_dir():
        raise InputError(f"--figure {figure}: no such folder")
    for folder in (out, dump):
        if folder is not None:
            make_folder(folder)
    started = time.perf_counter()
    try:
        with Console(stderr=True).status("reference solutions"):
            cases = [case_of_scene(name) for name in names]
    except DisagreementError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if dump is not None:
        print("\n".join(dump_all(cases, dump)))
    if out is None:
        return 0
    extra, missing = wheels()
    if missing:
        print(f"left out, not installed: {', '.join(missing)}; to add them: {PIP_LINE}")
    all_methods = [*project_methods(), hpipm(), *extra, opti_ipopt(), *users, *baselines(), *discretisations()]
    methods = [of_interest(method, quick) for method in all_methods]
    rows = measure_all(cases, methods, QUICK if quick else Effort(), periods=not quick)
    quadratic = [case for case in cases if case.qp is not None]
    text = markdown(
        cases,
        rows,
        command=" ".join(["python scripts/error_against_runtime.py", *sys.argv[1:]]),
        elapsed_s=time.perf_counter() - started,
        missing=missing,
        reading_ms=reading_ms(quadratic[0]) if quadratic else float("nan"),
    )
    write_csv(rows, out / ROWS)
    drawn = work_precision(cases, rows)
    save_figure(drawn, out / FIGURE)
    if figure is not None:
        save_small(drawn, figure)
    write_text(text, out / REPORT)
    summaries = summaries_of(cases, rows)
    print("\n".join(summaries))
    # On the page they stand in the middle of a section.
    write_part(page, [f"**{line[4:]}**" if line.startswith("### ") else line for line in summaries])
    if quadratic:
        write_answer(page, answer(cases, rows))
    print(f"{out}: {REPORT}, {FIGURE}, {ROWS}; {time.perf_counter() - started:.0f} s in all")
    return 0


if __name__ == "__main__":
    on_one_thread()
    run(compared)
