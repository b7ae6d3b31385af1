"""The record of a refinement in a library, `meta["refinement"]`.

It holds the results of every round and, while a refinement from files is in progress, all data that its next step
needs.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from controller.refine.heard import Node
from controller.refine.learner import Course, History, Learner, NodeRound, Round
from controller.refine.learning import Condition
from controller.refine.significance import Tapped
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.library.library import Library

DIGITS = 7  # significant digits of measured numbers


def in_meta(learner: Learner, stated: Mapping[str, Any]) -> dict[str, Any]:
    """Tables (nv, ng) by round, null where nothing was measured; `learning` is null once the refinement is over.

    Parameters
    ----------
    stated : entries on device and measurement.
    """
    library, history = learner.library, learner.history
    return {
        **stated,
        "rounds": [_round(library, results) for results in history.rounds],
        "confirmed": None if history.confirmed is None else _round(library, history.confirmed),
        "why": _table(library, history.courses, lambda course: course.why),
        "learning": None if learner.over else _learning(learner),
    }


def _table(library: Library, of: Mapping[Node, Any], value: Callable[[Any], Any]) -> list[list[Any]]:
    nv, ng = library.speeds_m_s.size, library.grips_N.size
    return [[value(of[iv, ig]) if (iv, ig) in of else None for ig in range(ng)] for iv in range(nv)]


def _round(library: Library, results: Round) -> dict[str, Any]:
    def of_condition(name: str) -> Callable[[NodeRound], Any]:
        return lambda node: None if node.condition is None else getattr(node.condition, name)

    return {
        "playback_error": _table(library, results, lambda node: node.playback_error),
        "better": _table(library, results, lambda node: node.better),
        "peak_current_A": _table(library, results, lambda node: _number(node.tapped.peak_current_A)),
        **{
            name: _table(library, results, of_condition(name))
            for name in ("gain", "cutoff_Hz", "factor", "sure_factor")
        },
    }


def _learning(learner: Learner) -> dict[str, Any]:
    """The complete history, node by node."""
    history = learner.history
    return {
        "asked": [list(node) for node in learner.asked],
        "confirming": history.confirming,
        "courses": [{"node": list(node), **asdict(course)} for node, course in history.courses.items()],
        "rounds": [
            [
                {
                    "node": list(node),
                    "correction_m_s2": one.tapped.correction_m_s2.tolist()
                    if one.tapped.correction_m_s2.any()
                    else None,
                    "predicted": _rounded(one.tapped.predicted),
                    "differences": [_rounded(tap) for tap in one.tapped.differences],
                    "reference": one.tapped.reference,
                    "peak_current_A": _number(one.tapped.peak_current_A),
                    "better": one.better,
                    "limited": one.limited,
                    "condition": None if one.condition is None else asdict(one.condition),
                }
                for node, one in results.items()
            ]
            for results in history.rounds
        ],
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _rounded(values: FloatArray) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values.tolist()]


def is_learning(library: Library) -> bool:
    """Whether a library is from an unfinished refinement."""
    return bool((library.meta.get("refinement") or {}).get("learning"))


def history_of(library: Library) -> tuple[History, list[Node]]:
    """The history in a library from an unfinished refinement, and the nodes whose taps it waits for.

    Raises
    ------
    InputError : the entry is not as `in_meta` writes it.
    """
    said = library.meta["refinement"]["learning"]
    size = library.command.shape[2]
    try:
        rounds: list[Round] = [{_node(one): _node_round(one, size) for one in results} for results in said["rounds"]]
        courses = {
            _node(one): Course(one["best"], one["base"], one["gain"], _condition(one["condition"]), one["why"])
            for one in said["courses"]
        }
        asked = [(int(iv), int(ig)) for iv, ig in said["asked"]]
        return History(rounds, courses, bool(said["confirming"])), asked
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"meta.refinement.learning: not as `transopt-play refine` wrote it ({error!r}); begin again from the "
            "library as it was solved"
        ) from None


def _node(one: Mapping[str, Any]) -> Node:
    iv, ig = one["node"]
    return int(iv), int(ig)


def _condition(said: Mapping[str, Any] | None) -> Condition | None:
    return None if said is None else Condition(**said)


def _node_round(one: Mapping[str, Any], size: int) -> NodeRound:
    correction, peak_A = one["correction_m_s2"], one["peak_current_A"]
    tapped = Tapped(
        correction_m_s2=np.zeros(size) if correction is None else np.array(correction, dtype=float),
        predicted=np.array(one["predicted"], dtype=float),
        differences=np.array(one["differences"], dtype=float),
        reference=float(one["reference"]),
        peak_current_A=float("nan") if peak_A is None else float(peak_A),
    )
    return NodeRound(tapped, one["better"], one["limited"], _condition(one["condition"]))
