"""`transopt-play refine --from-files`: one step of learning from taps that another firmware played and recorded."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from controller.cli.refine import finish, tell_round
from controller.refine.heard import Heard, Node
from controller.refine.kept import history_of, in_meta, is_learning
from controller.refine.learner import LEAST_DEGREES, LEAST_TAPS, Learner, Resolve
from controller.refine.recorded import RecordedTap, recorded_tap
from controller.refine.rounds import Refined
from controller.refine.tables import place
from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.files.names import Layout
from transopt.library.library import Library
from transopt.recordings.recording import Recording, load_recording
from transopt.recordings.split import split


def step(
    library: Library,
    path: Path,
    files: Sequence[Path],
    layout: Layout,
    accelerometer_Hz: float,
    resolve: Resolve,
    rounds: int,
    taps: int,
    stated: dict[str, Any],
    out: Path,
) -> None:
    """Learn from the taps of a library, and write the next one with what its taps will be judged against.

    Parameters
    ----------
    files : one tap each, or several in a row.
    layout : what the user states about them.
    accelerometer_Hz : bandwidth, one pole.
    rounds : of corrections, at most.
    taps : that are asked for at each node of the next round.
    stated : what `meta["refinement"]` says beside the history, where a refinement begins.

    Raises
    ------
    InputError : no files, files that were learnt from before, or no node with two taps.
    Exit : code 1 if the refinement is over and nothing was gained that was to be gained.
    """
    if not files:
        raise InputError(
            f"--from-files: names no files: transopt-play refine {path} --from-files TAP.csv ... --out {out}"
        )
    known = library.meta["refinement"] if is_learning(library) else stated
    whole = [load_recording(file, layout) for file in files]
    hashes = [one.sha256 for one in whole]
    twice = next((one for one in whole if hashes.count(one.sha256) > 1), None)
    if twice is not None:
        raise InputError(f"{twice.source}: is named twice, or another file is equal to it: leave one out")
    read = [tap for one in whole for tap in split(one, {})]
    seen = _not_again(read, known.get("files", {}))
    begun = {**known, "files": {**known.get("files", {}), **seen}}
    history, asked = history_of(library) if is_learning(library) else (None, None)
    learner = Learner(library, resolve, rounds, lambda learner: in_meta(learner, begun), history, asked)
    results = learner.learn(_by_node(learner, [recorded_tap(one, library, accelerometer_Hz) for one in read]))
    tell_round(learner, results)
    written = out / "library.npz"
    if not learner.over:
        learner.library.save(written)
        wanted = ", ".join(place(library, node) for node in learner.asked)
        terminal.console().print(
            f"next: play {written} and record {taps} taps at each of: {wanted}; then\n"
            f"transopt-play refine {shlex.quote(str(written))} --from-files TAPS... --out ANOTHER_FOLDER"
        )
        return
    finish(Refined.of(library, learner), path, out)


def _not_again(read: Sequence[Recording], before: dict[str, str]) -> dict[str, str]:
    """SHA-256 of each file to its name; taps of an earlier library say nothing of this one."""
    for one in read:
        if one.sha256 in before:
            earlier = f"was learnt from in an earlier step, as {before[one.sha256]}"
            raise InputError(f"{one.name}: {earlier}: record taps of this library")
    return {one.sha256: Path(one.source).name for one in read}


def _by_node(learner: Learner, taps: Sequence[RecordedTap]) -> dict[Node, list[Heard]]:
    """Taps that count, at the nodes that are asked for; of all others is said why they do not."""
    found: dict[Node, list[Heard]] = {node: [] for node in learner.asked}
    for tap in taps:
        if isinstance(tap.heard, str):
            why = tap.heard
        elif tap.node not in found:
            assert tap.node is not None
            why = f"{place(learner.library, tap.node)} is not asked for in this step"
        else:
            found[tap.node].append(tap.heard)
            continue
        terminal.console().print(f"{tap.name} does not count: {why}", style="yellow")
    counted = {node: len(each) for node, each in found.items()}
    if all(count < LEAST_TAPS for count in counted.values()):
        wanted = ", ".join(f"{place(learner.library, node)} ({count})" for node, count in counted.items())
        raise InputError(f"--from-files: at least {LEAST_TAPS} taps at a node are needed, found are: {wanted}")
    if learner.number == 0 and sum(max(count - 1, 0) for count in counted.values()) < LEAST_DEGREES:
        raise InputError(
            "--from-files: two taps at one node do not tell how they scatter: record a third, or other nodes"
        )
    few = [f"{place(learner.library, node)} ({count})" for node, count in counted.items() if count < LEAST_TAPS]
    if few:
        terminal.console().print(
            f"fewer than {LEAST_TAPS} taps, which stay as they were: {', '.join(few)}", style="yellow"
        )
    return found
