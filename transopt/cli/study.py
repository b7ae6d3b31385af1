"""`transopt study`: what limits, motors and amplifiers cost, as certified optima over any keys of a scene."""

import os
import shlex
import sys
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError, did_you_mean
from transopt.cli.scene import ACCEPT_HELP, DEFAULT_SCENE, key_table

if TYPE_CHECKING:
    from transopt.study.executors import Pool
    from transopt.study.plan import Plan


@dataclass(frozen=True)
class Request:
    """What the command line asks for; the attributes are its options.

    Attributes
    ----------
    vary, settings : --vary and --set, one text per use of the option.
    name : --study.
    """

    vary: list[str]
    settings: list[str]
    speed: str | None
    grip: str | None
    sample: int | None
    seed: int | None
    full: bool
    require: list[str]
    solve_for: str | None
    greatest: bool
    name: str | None
    figures: Path | None
    executor: str | None
    jobs: int | None
    accept: bool
    out: Path


def study(
    scene: Annotated[str, typer.Argument(help="Built-in name or path of a .toml file.")] = DEFAULT_SCENE,
    vary: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUES", help="V1,V2,... or START:STOP:COUNT[:log]; repeatable.")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="For all points; repeatable.")
    ] = None,
    speed: Annotated[str | None, typer.Option(help="Speeds of the entries, in m/s; default: of the scene.")] = None,
    grip: Annotated[str | None, typer.Option(help="Grips of the entries, in N; default: of the scene.")] = None,
    sample: Annotated[int | None, typer.Option(help="Points of a Latin hypercube, not all combinations.")] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed of the sample; default: 1.")] = None,
    full: Annotated[
        bool, typer.Option("--full", help="Baselines and prices of the limits too (3 times as long).")
    ] = False,
    require: Annotated[
        list[str] | None,
        typer.Option(metavar="MEASURE<=NUMBER", help="What --solve-for is to meet, as tap_error<=30%; repeatable."),
    ] = None,
    solve_for: Annotated[
        str | None, typer.Option(metavar="KEY=LOW:HIGH[:TOLERANCE]", help="The least value that meets --require.")
    ] = None,
    greatest: Annotated[bool, typer.Option("--greatest", help="The greatest value instead.")] = False,
    name: Annotated[str | None, typer.Option("--study", metavar="NAME", help="A named study, or all.")] = None,
    figures: Annotated[Path | None, typer.Option(help="Folder for copies of the figures of named studies.")] = None,
    list_keys: Annotated[bool, typer.Option("--list-keys", help="Print keys, units, defaults, bounds.")] = False,
    executor: Annotated[str | None, typer.Option(help="processes (default), serial or dask://HOST:PORT.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes; default: one per core.")] = None,
    accept: Annotated[bool, typer.Option("--accept", help=ACCEPT_HELP)] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for everything that is written.")] = None,
) -> None:
    """What constraints cost: certified optima over any keys of a scene; stopped, the same command goes on.

    One row per solve in rows.csv, report.md and a figure beside it.

    Exit 1: nothing certified, a row that is neither certified nor refused for a stated cause, or no value that meets
    --require.
    """
    from transopt.scene import builtin

    if list_keys:
        loaded = builtin.load_scene(scene, accept=accept)
        terminal.console().print(key_table(loaded, f"{loaded.name}: keys for --vary, --set and --solve-for"))
        return
    if out is None:
        asked = vary or sample or require or name
        what = (
            "--out: give a folder, as --out cost"
            if asked
            else "study: say what to vary, as --vary limits.current_A=3,4,5"
        )
        raise InputError(what if asked else f"{what} --out cost; --list-keys lists the keys")
    request = Request(
        vary=vary or [],
        settings=settings or [],
        speed=speed,
        grip=grip,
        sample=sample,
        seed=seed,
        full=full,
        require=require or [],
        solve_for=solve_for,
        greatest=greatest,
        name=name,
        figures=figures,
        executor=executor,
        jobs=jobs,
        accept=accept,
        out=out,
    )
    check_together(request)
    code = run(request, scene)
    if code:
        raise typer.Exit(code)


def check_together(request: Request) -> None:
    """Refuse options that do not belong together."""
    from transopt.study.named import IN_PROCESS, STUDIES

    name = request.name
    if name is not None and name not in (*STUDIES, "all"):
        near = did_you_mean(name, STUDIES)
        raise InputError(f"--study {name}: no such study{near}; choose one of {', '.join(STUDIES)}, or all")
    inverse = bool(request.require) or request.solve_for is not None or request.greatest
    if inverse and (not request.require or request.solve_for is None):
        raise InputError("--require and --solve-for belong together: what is to be met, and by which key")
    if inverse and (request.vary or request.sample is not None or name):
        raise InputError("--solve-for: not together with --vary, --sample or --study; --set fixes other keys")
    if not inverse and not request.vary and not name:
        raise InputError("--vary: nothing is varied; --list-keys shows what can be, --study has ready ones")
    if inverse and (request.full or request.seed is not None):
        raise InputError("--solve-for: not together with --full or --seed, which belong to --vary")
    sampled = request.sample is not None or request.seed is not None
    if name and (request.vary or request.settings or request.speed or request.grip or sampled or request.full):
        raise InputError("--study: a named study says itself what is varied; leave the other options out")
    if name in IN_PROCESS and (request.executor is not None or request.jobs is not None):
        raise InputError(f"--study {name}: solves in this process: leave --executor and --jobs out")
    if request.figures is not None and not name:
        raise InputError("--figures: only with --study, which has figures to copy; others are written to --out")
    if request.jobs is not None and request.executor not in (None, "processes"):
        raise InputError(f"--jobs {request.jobs}: only with --executor processes, not {request.executor}")
    if request.sample is not None and request.sample < 1:
        raise InputError(f"--sample {request.sample}: must be at least 1")
    if request.seed is not None and request.sample is None:
        raise InputError(f"--seed {request.seed}: only with --sample, which draws by it")
    if request.seed is not None and request.seed < 0:
        raise InputError(f"--seed {request.seed}: must be 0 or more")


def run(request: Request, scene: str) -> int:
    """Solve and write what is asked for; the exit code."""
    from transopt.scene import builtin
    from transopt.study.axes import apply_settings, parse_axis, parse_numbers
    from transopt.study.executors import executor_pool
    from transopt.study.named import OF_AN_ARM, OF_ONE_MOTOR, write
    from transopt.study.plan import Plan

    files = [builtin.FOLDER]
    loaded = apply_settings(builtin.load_scene(scene, accept=request.accept), request.settings, files)
    jobs = (os.cpu_count() or 1) if request.jobs is None else request.jobs
    with closing(executor_pool(request.executor or "processes", jobs)) as pool:
        if request.name not in OF_AN_ARM:
            loaded.check_one_motor(f"study: {loaded.name}")
        if request.name and loaded.targets:
            raise InputError(
                f"--study {request.name}: asks about speeds and grips, {loaded.name} has named targets: --vary"
            )
        if request.name:
            worst = 0
            for name in OF_ONE_MOTOR if request.name == "all" else [request.name]:
                code, finding = write(
                    name, loaded, request.out, pool, _command(), search=files, figures=request.figures
                )
                terminal.console().print(f"{name}: {finding}")
                worst = max(worst, code)
            return worst
        speeds, grips = loaded.axes.speeds_m_s, loaded.axes.grips_N
        if loaded.targets and (request.speed or request.grip):
            raise InputError(
                f"--speed and --grip: {loaded.name} has named targets, all of which are solved: leave them out"
            )
        plan = Plan(
            loaded,
            tuple(parse_axis(loaded, "--vary", text, files) for text in request.vary),
            tuple(sorted(set(parse_numbers("--speed", request.speed))) if request.speed else speeds),
            tuple(sorted(set(parse_numbers("--grip", request.grip))) if request.grip else grips),
            sample=request.sample,
            seed=1 if request.seed is None else request.seed,
            rivals=request.full,
        )
        terminal.make_folder(request.out)
        return (_answer if request.solve_for else _vary)(request, plan, pool)


def _command() -> str:
    """What was typed."""
    return shlex.join(["transopt", *sys.argv[1:]])


def _vary(request: Request, plan: "Plan", pool: "Pool") -> int:
    """Rows, figure and report of one study."""
    from transopt.base.plotting import save_figure
    from transopt.base.writing import write_text
    from transopt.study.figures import study_figure
    from transopt.study.report import provenance, study_answer, study_markdown, study_table, summary
    from transopt.study.rows import exit_code
    from transopt.study.session import run_plan

    started = time.perf_counter()
    rows = run_plan(plan, request.out, pool)
    save_figure(study_figure(plan, rows), request.out / "tap_error.png", plan.scene.name)
    head = provenance(_command(), time.perf_counter() - started)
    write_text(study_markdown(plan, rows, "tap_error.png", head), request.out / "report.md")
    console = terminal.console()
    if (shown := study_table(plan, rows)) is not None:
        console.print(shown)
    for text in (
        *study_answer(plan, rows),
        f"{summary(rows)}.",
        _written(request.out, "tap_error.png"),
    ):
        console.print(text)
    return exit_code(rows)


def _answer(request: Request, plan: "Plan", pool: "Pool") -> int:
    """Rows, figure and report of the inverse question."""
    from transopt.base.plotting import save_figure
    from transopt.base.writing import write_text
    from transopt.study.figures import axis_label, question_figure
    from transopt.study.inverse import parse_question
    from transopt.study.report import answer_markdown, provenance
    from transopt.study.session import run_question

    started = time.perf_counter()
    assert request.solve_for is not None
    question = parse_question(plan.scene, request.solve_for, request.require, greatest=request.greatest)
    found = run_question(plan, question, request.out, pool)
    save_figure(question_figure(found, axis_label(question.key.path)), request.out / "answer.png", plan.scene.name)
    head = provenance(_command(), time.perf_counter() - started)
    write_text(answer_markdown(plan.scene, found, head), request.out / "report.md")
    console = terminal.console()
    for sentence in (*found.sentences, _written(request.out, "answer.png")):
        console.print(sentence)
    return 0 if found.met is not None else 1


def _written(out: Path, figure: str) -> str:
    """The files of a study."""
    return f"{out}: rows.csv, {figure}, report.md; study.sqlite, from which the same command goes on"
