"""What constraints cost: certified optima over any keys of a scene.

    python scripts/constraint_study.py SCENE --vary KEY=V1,V2,... [--vary KEY=START:STOP:COUNT[:log]] --out DIR
    python scripts/constraint_study.py SCENE --require "nrmse<=0.10" --solve-for KEY=LOW:HIGH[:TOLERANCE] --out DIR
    python scripts/constraint_study.py SCENE --list-keys
    python scripts/constraint_study.py --study NAME|all --out DIR

One row per solve in DIR/rows.csv, report.md and a figure beside it. A run that was stopped or killed goes on with the
same command. Exit codes: 0 done, 1 nothing certified, a row that is neither certified nor refused for a stated cause,
or no such value, 2 bad input, 130 stopped.
"""

import argparse
import contextlib
import os
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from rich.table import Table

import problems
import transopt.study.named as study_named
from transopt.base.console import console, make_folder
from transopt.base.errors import InputError
from transopt.base.plotting import save_figure
from transopt.scene.keys import keys
from transopt.scene.scene import Scene
from transopt.study.axes import Plan, apply_settings, parse_axis, parse_numbers
from transopt.study.figures import axis_label, question_figure, study_figure
from transopt.study.inverse import parse_question
from transopt.study.report import answer_markdown, provenance, study_markdown, summary, write_report
from transopt.study.rows import exit_code
from transopt.study.run import Pool, executor_pool
from transopt.study.session import run_plan, run_question

SCENE = "wood_on_foam"


def load(name: str) -> Scene:
    """A scene by built-in name or by path."""
    return problems.load(name)


def key_table(scene: Scene) -> Table:
    """What --list-keys prints."""
    table = Table(title=f"{scene.name}: keys for --vary, --set and --solve-for")
    for column in ("key", "unit", "default", "here", "allowed", "about"):
        table.add_column(column, overflow="fold")

    def shown(value: object) -> str:
        return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)

    for key in keys(scene):
        words = ", ".join(key.choices)
        allowed = " or ".join(part for part in (key.bounds, words, "none" if key.optional else "") if part)
        default = "to be stated" if key.required else shown(key.default)
        table.add_row(key.path, key.unit, default, shown(key.value), allowed, key.description)
    return table


class Parser(argparse.ArgumentParser):
    """One line for what cannot be understood, not the usage of every option."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; --help shows all options")


def parser() -> Parser:
    made = Parser(description="What constraints cost: certified optima over any keys of a scene.", allow_abbrev=False)
    made.add_argument("scene", nargs="?", default=SCENE, help="built-in name or path of a .toml file")
    made.add_argument(
        "--vary", action="append", default=[], metavar="KEY=VALUES", help="V1,V2,... or START:STOP:COUNT"
    )
    made.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="for all points")
    made.add_argument("--speed", metavar="VALUES", help="speeds of the entries [m/s]; default: of the scene")
    made.add_argument("--grip", metavar="VALUES", help="grips of the entries [N]; default: of the scene")
    made.add_argument("--sample", type=int, metavar="N", help="a Latin hypercube of N points, not all combinations")
    made.add_argument("--seed", type=int, metavar="N", help="of the sample; default: 1")
    made.add_argument("--full", action="store_true", help="baselines and prices of the limits too (3 times as long)")
    made.add_argument("--require", action="append", default=[], metavar="MEASURE<=NUMBER")
    made.add_argument("--solve-for", metavar="KEY=LOW:HIGH[:TOLERANCE]", help="the least value that meets --require")
    made.add_argument("--greatest", action="store_true", help="the greatest value instead")
    made.add_argument("--study", choices=[*study_named.STUDIES, "all"], help="a named study")
    made.add_argument("--figures", type=Path, help="folder for copies of the figures of named studies")
    made.add_argument("--list-keys", action="store_true", help="keys, units, defaults")
    made.add_argument("--executor", help="processes (the default), serial or dask://HOST:PORT")
    made.add_argument("--jobs", type=int, help="processes; default: one per core")
    made.add_argument("--out", type=Path, help="folder for everything that is written")
    return made


def check_together(arguments: argparse.Namespace) -> None:
    """Refuse options that do not belong together.

    Raises
    ------
    InputError : one line.
    """
    if arguments.out is None:
        raise InputError("--out: give a folder")
    inverse = bool(arguments.require) or arguments.solve_for is not None or arguments.greatest
    if inverse and (not arguments.require or arguments.solve_for is None):
        raise InputError("--require and --solve-for belong together: what is to be met, and by which key")
    if inverse and (arguments.vary or arguments.sample is not None or arguments.study):
        raise InputError("--solve-for: not together with --vary, --sample or --study; --set fixes other keys")
    if not inverse and not arguments.vary and not arguments.study:
        raise InputError("--vary: nothing is varied; --list-keys shows what can be, --study has ready ones")
    if inverse and (arguments.full or arguments.seed is not None):
        raise InputError("--solve-for: not together with --full or --seed, which belong to --vary")
    sampled = arguments.sample is not None or arguments.seed is not None
    if arguments.study and (
        arguments.vary or arguments.set or arguments.speed or arguments.grip or sampled or arguments.full
    ):
        raise InputError("--study: a named study says itself what is varied; leave the other options out")
    if arguments.study in study_named.OFF_NODE and (arguments.executor is not None or arguments.jobs is not None):
        raise InputError(f"--study {arguments.study}: solves in this process: leave --executor and --jobs out")
    if arguments.figures is not None and not arguments.study:
        raise InputError("--figures: only with --study, which has figures to copy; others are written to --out")
    if arguments.jobs is not None and arguments.executor not in (None, "processes"):
        raise InputError(f"--jobs {arguments.jobs}: only with --executor processes, not {arguments.executor}")
    if arguments.sample is not None and arguments.sample < 1:
        raise InputError(f"--sample {arguments.sample}: must be at least 1")
    if arguments.seed is not None and arguments.sample is None:
        raise InputError(f"--seed {arguments.seed}: only with --sample, which draws by it")
    if arguments.seed is not None and arguments.seed < 0:
        raise InputError(f"--seed {arguments.seed}: must be 0 or more")


def entries(scene: Scene, arguments: argparse.Namespace) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Speeds and grips, the scene's own where nothing is said."""
    speeds, grips = scene.grid.speeds_m_s, scene.grid.grips_N
    speeds = sorted(set(parse_numbers("--speed", arguments.speed))) if arguments.speed else speeds
    grips = sorted(set(parse_numbers("--grip", arguments.grip))) if arguments.grip else grips
    return tuple(speeds), tuple(grips)


def vary(arguments: argparse.Namespace, scene: Scene, pool: Pool, command: str) -> int:
    """Rows, figure and report of one study."""
    started = time.perf_counter()
    speeds, grips = entries(scene, arguments)
    plan = Plan(
        scene,
        tuple(parse_axis(scene, "--vary", text) for text in arguments.vary),
        speeds,
        grips,
        sample=arguments.sample,
        seed=1 if arguments.seed is None else arguments.seed,
        rivals=arguments.full,
    )
    rows = run_plan(plan, arguments.out, pool)
    save_figure(study_figure(plan, rows), arguments.out / "nrmse.png")
    head = provenance(command, time.perf_counter() - started)
    write_report(study_markdown(plan, rows, "nrmse.png", head), arguments.out)
    print(summary(rows))
    print(f"{arguments.out}: rows.csv, nrmse.png, report.md")
    return exit_code(rows)


def solve_for(arguments: argparse.Namespace, scene: Scene, pool: Pool, command: str) -> int:
    """The inverse question."""
    started = time.perf_counter()
    speeds, grips = entries(scene, arguments)
    question = parse_question(scene, arguments.solve_for, arguments.require, greatest=arguments.greatest)
    found = run_question(Plan(scene, (), speeds, grips), question, arguments.out, pool)
    save_figure(question_figure(found, axis_label(question.key.path)), arguments.out / "answer.png")
    head = provenance(command, time.perf_counter() - started)
    write_report(answer_markdown(scene.name, found, head), arguments.out)
    for sentence in found.sentences:
        print(sentence)
    print(f"{arguments.out}: rows.csv, answer.png, report.md")
    return 0 if found.met is not None else 1


def run(arguments: argparse.Namespace, command: str) -> int:
    if arguments.list_keys:
        console().print(key_table(load(arguments.scene)))
        return 0
    check_together(arguments)
    scene = apply_settings(load(arguments.scene), arguments.set)
    jobs = (os.cpu_count() or 1) if arguments.jobs is None else arguments.jobs
    pool = executor_pool(arguments.executor or "processes", jobs)
    with contextlib.closing(pool):
        make_folder(arguments.out)
        if arguments.study:
            names = list(study_named.STUDIES) if arguments.study == "all" else [arguments.study]
            return max(study_named.write(name, scene, arguments.out, pool, arguments.figures) for name in names)
        return (solve_for if arguments.solve_for else vary)(arguments, scene, pool, command)


def main(words: Sequence[str] | None = None) -> int:
    words = sys.argv[1:] if words is None else words
    try:
        return run(parser().parse_args(words), f"python scripts/constraint_study.py {shlex.join(words)}")
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        print(str(stop) or "stopped", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
