"""Error against run time: work-precision diagrams of the project's solvers and their rivals on four entries.

    python scripts/error_against_runtime.py --out DIR [--quick] [--case NAME] [--method FILE.py] [--dump DIR]

Writes work_precision.png, error_against_runtime.md and rows.csv into --out: four minutes of one core, one with
--quick. --method adds the curve of your own solve(qp) (see `ert_qp.QP`), which may take a second argument, tolerance,
and returns x, (x, y) or (x, y, {"iterations": ..., "status": ...}); a run of it is cut at ten seconds and has failed,
unless it hangs inside native code, or on Windows, where nothing can cut it. --dump writes the QPs as NPZ, to be used
without this project.
"""

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from common.measuring import THREAD_VARIABLES, elapsed_ms
from precision.cases import SCENES, Case, DisagreementError, case_of_scene, check_name
from precision.figure import save_small, work_precision
from precision.methods import Level, Method, baselines, discretisations, opti_ipopt, project_methods
from precision.periods import measure_periods
from precision.qp import dump
from precision.report import markdown, summaries_of
from precision.run import Effort, Row, measure
from precision.user import user_method
from precision.wheels import PIP_LINE, hpipm, wheels
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from transopt.base.errors import InputError
from transopt.base.plotting import save_figure
from transopt.base.terminal import make_folder
from transopt.base.writing import write_csv, write_text
from transopt.solvers import program
from transopt.solvers.statement import state

FIGURE, REPORT, ROWS = "work_precision.png", "error_against_runtime.md", "rows.csv"
QUICK = Effort(budget_ms=0.0, least=1)
PERIOD_STEPS = 8  # in the progress bar


def of_interest(method: Method, quick: bool) -> Method:
    """With `quick` a method's default and high-accuracy setting alone; of Opti, slow to set up, only the default."""
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
    """Every row of every case, with a bar on a terminal and a line per case elsewhere."""
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
                case,
                methods,
                effort,
                told=lambda text, done: progress.update(task, description=text, advance=done),
            )
            if periods:
                progress.update(task, description=f"{case.name}: servo rates")
                rows += measure_periods(case, effort)
                progress.advance(task, PERIOD_STEPS)
            if not watched:
                print(f"{case.name}: {time.perf_counter() - started:.0f} s", file=sys.stderr, flush=True)
    return rows


def reading_ms(case: Case) -> float:
    """What reading one problem's numbers from the CasADi statement takes, the best of a few."""

    def read() -> None:
        shape = program.program_shape(case.small)
        program.state_program(shape).qp_data(p=state(case.small).p)

    return min(elapsed_ms(read) for _ in range(5))


def run(arguments: argparse.Namespace) -> int:
    if arguments.out is None and arguments.dump is None:
        raise InputError("nothing to do: state --out DIR, --dump DIR or both")
    names = list(dict.fromkeys(arguments.case or SCENES))
    for name in names:
        check_name(name)
    users = [user_method(path) for path in arguments.method or []]
    if arguments.figure is not None and arguments.figure.suffix.lower() != ".png":
        raise InputError(f"--figure {arguments.figure}: a PNG is written: give it the suffix .png")
    if arguments.figure is not None and not arguments.figure.parent.is_dir():
        raise InputError(f"--figure {arguments.figure}: no such folder")
    for folder in (arguments.out, arguments.dump):
        if folder is not None:
            make_folder(folder)
    started = time.perf_counter()
    with Console(stderr=True).status("reference solutions"):
        cases = [case_of_scene(name) for name in names]
    if arguments.dump is not None:
        print("\n".join(dump_all(cases, arguments.dump)))
    if arguments.out is None:
        return 0
    extra, missing = wheels()
    if missing:
        print(f"left out, not installed: {', '.join(missing)}; to add them: {PIP_LINE}")
    all_methods = [*project_methods(), hpipm(), *extra, opti_ipopt(), *users, *baselines(), *discretisations()]
    methods = [of_interest(method, arguments.quick) for method in all_methods]
    effort = QUICK if arguments.quick else Effort()
    rows = measure_all(cases, methods, effort, periods=not arguments.quick)
    quadratic = [case for case in cases if case.qp is not None]
    text = markdown(
        cases,
        rows,
        command=" ".join(["python scripts/error_against_runtime.py", *sys.argv[1:]]),
        elapsed_s=time.perf_counter() - started,
        missing=missing,
        reading_ms=reading_ms(quadratic[0]) if quadratic else float("nan"),
    )
    write_csv(rows, arguments.out / ROWS)
    figure = work_precision(cases, rows)
    save_figure(figure, arguments.out / FIGURE)
    if arguments.figure is not None:
        save_small(figure, arguments.figure)
    write_text(text, arguments.out / REPORT)
    print("\n".join(summaries_of(cases, rows)))
    print(f"{arguments.out}: {REPORT}, {FIGURE}, {ROWS}; {time.perf_counter() - started:.0f} s in all")
    return 0


def main(given: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for report, figure and rows")
    parser.add_argument("--quick", action="store_true", help="default and high-accuracy settings only, one run each")
    parser.add_argument(
        "--case", action="append", metavar="NAME", help=f"one of {', '.join(SCENES)}; may be repeated"
    )
    parser.add_argument("--method", action="append", type=Path, metavar="FILE.py", help="your own solve(qp)")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="also write the figure here, in few colours")
    parser.add_argument("--dump", type=Path, metavar="DIR", help="write the QPs here as NPZ")
    try:
        return run(parser.parse_args(given))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except DisagreementError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; nothing was written", file=sys.stderr)
        return 130


if __name__ == "__main__":
    if any(os.environ.get(name) != "1" for name in THREAD_VARIABLES):
        # Linear algebra reads these when it is loaded, which it is by now: once more, with one thread.
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
        os.execv(sys.executable, [sys.executable, *sys.argv])
    sys.exit(main())
