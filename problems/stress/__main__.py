"""The stress suite: `python -m problems.stress --cases 1000`."""

import os
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn
from typer import Option

from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.base.writing import write_text

if TYPE_CHECKING:
    from problems.stress.judge import Outcome

LIMIT_S = 120  # time limit per case; the slowest regular case takes a fraction of it
SEEDS = 2**32  # number of seeds from which one is drawn if none is stated
LOG_EVERY = 50  # cases between two lines of progress without a terminal


def stress(
    cases: Annotated[int, Option(min=1, help="Random cases.")] = 1000,
    seed: Annotated[int | None, Option(min=0, help="Seed of the cases; another one every time by default.")] = None,
    jobs: Annotated[int, Option(min=1, help="Worker processes.")] = os.cpu_count() or 1,
    case: Annotated[int | None, Option(min=0, help="Only the case of this index, in every detail.")] = None,
    families: Annotated[bool, Option("--directed", help="The directed families in place of random cases.")] = False,
    limit_s: Annotated[int, Option(min=1, help="Seconds that one case may take.")] = LIMIT_S,
    write: Annotated[Path | None, Option(help="File for the verdict on every case, a line each.")] = None,
) -> int:
    """Run the stress cases: each has to end certified or refused with a named cause, otherwise the exit code is 1."""
    # Imported here, so that --help is fast.
    from problems.stress.draw import drawn
    from problems.stress.families import directed, long_cases
    from problems.stress.judge import judge
    from problems.stress.run import run_cases, summary

    output = terminal.console()
    command = "python -m problems.stress"
    if families:
        command += " --directed"
        chosen = [*directed(), *long_cases()]
    else:
        seed = secrets.randbelow(SEEDS) if seed is None else seed
        output.print(f"seed {seed}, again by {command} --seed {seed} --cases {cases}")
        command += f" --seed {seed}"
        chosen = [drawn(seed, index) for index in range(cases)]
    if case is not None:
        if families and case >= len(chosen):
            raise InputError(f"--case {case}: there are {len(chosen)} directed cases, from 0 on")
        one = chosen[case] if seed is None else drawn(seed, case)
        found = judge(one)
        output.print(f"{one}\n{one!r}\n{found.kind} in {found.elapsed_s:.1f} s: {found.detail}")
        if found.certified:
            output.print(f"gap {found.gap:.1e}, replay difference {found.difference:.1e}")
        return int(found.bad)
    outcomes: dict[int, Outcome] = {}
    columns = (*Progress.get_default_columns()[:2], MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("stress", total=len(chosen))
        for index, outcome in run_cases(chosen, jobs, limit_s):
            outcomes[index] = outcome
            progress.advance(task)
            if not progress.console.is_terminal and len(outcomes) % LOG_EVERY == 0:
                progress.console.print(f"{len(outcomes)} of {len(chosen)} cases")
            if outcome.bad:
                progress.console.print(f"{command} --case {index}: {outcome.kind}")
    table, lines = summary(chosen, outcomes, command)
    output.print(table)
    for line in lines:
        output.print(line)
    if write is not None:
        write_text("".join(f"{index} {outcomes[index].kind}\n" for index in sorted(outcomes)), write)
    return int(any(outcome.bad for outcome in outcomes.values()))


def main() -> None:
    """Run the command line."""
    app = typer.Typer(add_completion=False)
    app.command()(stress)
    terminal.run(app, "python -m problems.stress")


if __name__ == "__main__":
    main()
