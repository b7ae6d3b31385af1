"""Declarations of all that a library's `meta` holds, and the parts that a problem was solved without.

The reader of a library refuses files by these declarations, and the manual's table is generated from them.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from transopt.base.errors import InputError
from transopt.base.shown import cut
from transopt.problem.limits.current import BEFORE, FollowingCurrentLimit
from transopt.problem.limits.output import PARTS
from transopt.problem.limits.temperature import TemperatureLimit

if TYPE_CHECKING:  # which loads pydantic
    from transopt.scene.scene import Scene

SCHEMA = 4


@dataclass(frozen=True)
class Stated:
    """Declaration of one key of `meta`.

    Attributes
    ----------
    meaning : what the value is.
    null : what null means; empty if the value is never null.
    needed : whether a file without it is refused.
    whole : whether it is a table or list that is stored as given, without a declaration of its keys.
    """

    meaning: str
    null: str = ""
    needed: bool = False
    whole: bool = False


def _needed(meaning: str, null: str = "", *, whole: bool = False) -> Stated:
    return Stated(meaning, null, True, whole)


# Dotted path -> declaration. The ending of a name is its unit (`transopt.base.units`).
META = {
    "schema": _needed("version of the file format: 4"),
    "scene": _needed("the scene as it was read, every key; `transopt scene keys` says what they are", whole=True),
    "derived": _needed("the problem in numbers that follow from the scene, for readers without this project"),
    "derived.dt_s": _needed("servo period"),
    "derived.lead_s": _needed("how long before contact a waveform starts"),
    "derived.hand_over_samples": _needed(
        "number of commands at the end that the wall alone makes; they are zero without a wall"
    ),
    "derived.intention_s": _needed(
        "the tap error is over the instants from contact to before this time: 1 ns less than the scene's, so that no "
        "rounding of an instant counts; for a named target 1 ns less than the window"
    ),
    "derived.amplifier": _needed("amplifier between command and plant input", "ideal: the command is the input"),
    "derived.amplifier.pole_Hz": Stated("pole of its low-pass, the frequency of -3 dB"),
    "derived.amplifier.delay_s": Stated("pure delay, beyond the hold of the command"),
    "derived.amplifier.command_limit": Stated("largest command [A or V]"),
    "derived.limits": _needed("limits that every plant has"),
    "derived.limits.plant_input": _needed("largest current or voltage at any time [A or V]"),
    "derived.limits.slew_per_s": _needed("fastest change of the command [A/s or V/s]", "not asked for"),
    "derived.exact": _needed("true: these limits are all; false: another limit, a spread, a wall or intensity is in"),
    "derived.wall": _needed("whether a virtual wall follows the waveform"),
    "derived.spread": _needed("whether each command serves further devices"),
    "derived.movement_weight": _needed("rho (1e-4 s / dt)^2 / (N I^2), of the squared changes of the command"),
    "derived.terms": _needed("terms of the error in J: name, filter b / a, weights before, in and after", whole=True),
    "derived.felt": _needed("band-pass of the felt error: b / a", "the servo rate does not carry it"),
    "derived.felt.b": Stated("numerator in 1/z"),
    "derived.felt.a": Stated("denominator in 1/z"),
    "left_out": _needed("part of the problem -> why it cannot matter, or a table of reasons by entry", whole=True),
    "cool": Stated("`left_out` of the cool commands", "the scene asks for none", whole=True),
    "repeatability": _needed(
        "by speed and grip: error of single recordings about their mean; null where there is one", whole=True
    ),
    "slow_part_known": _needed("by speed and grip: whether what is slower than the tap was recorded", whole=True),
    "sources": _needed("recordings and model files by name and SHA-256, and how they were prepared", whole=True),
    "versions": _needed("versions of this project and of its numerical packages", whole=True),
    "solver": _needed("method and its options", whole=True),
    "outputs": Stated("outputs of the plant that limits bound, by grip", whole=True),
    "spread_outputs": Stated("the same of the further devices of a spread, by grip and device", whole=True),
    "instants_within": Stated("largest value of the array `instants_within`; absent where it is zero"),
    "grid_refinement": Stated("what `--grid-tolerance` reached", "the grid was taken as it stood", whole=True),
    "refinement": Stated("what `transopt-play refine` learnt on the device, by round", whole=True),
}


def lacking(meta: dict[str, Any]) -> list[str]:
    """Required top-level keys that a file lacks; nested keys are compared with the scene by `statements`."""
    return [path for path, stated in META.items() if stated.needed and "." not in path and path not in meta]


def stated(scene: "Scene", meta: dict[str, Any]) -> set[str]:
    """Conditions (`Array.needs`) that this library fulfils.

    The temperature is among them if it is a constraint of at least one entry.
    """
    several = bool(scene.shares)
    conditions = {
        "arm": bool(scene.axes.places),
        "several directions": scene.directions > 1,
        "one motor": not several,
        "targets": bool(scene.targets),
        "spread": scene.robust is not None,
        "worst": scene.robust is not None and scene.robust.minimise == "worst",
        "nonlinear": scene.nonlinear,
        "intensity": scene.weights.objective == "intensity",
        "refinement": meta.get("refinement") is not None,
        "instants_within": meta.get("instants_within") is not None,
        TemperatureLimit.key: heat_is_in(meta["left_out"]),
        BEFORE: scene.driven_by.unit == "V"
        and scene.limits.current_A is not None
        and FollowingCurrentLimit.suits(scene.circuit()),
    }
    # Several motors have multipliers for each (`further_arrays`) in place of these.
    limits = {key for key, value in scene.limits.asked().items() if value is not None and not several}
    return {name for name, holds in conditions.items() if holds} | (limits - {TemperatureLimit.key})


def parts_of(instants_within: Any) -> int:
    """Number of parts into which this many instants divide a servo period.

    Raises
    ------
    InputError : the number of instants is none of those that `PARTS` allows.
    """
    number = isinstance(instants_within, int | float) and not isinstance(instants_within, bool)
    if not number or instants_within + 1 not in PARTS:
        known = ", ".join(str(parts - 1) for parts in PARTS)
        raise InputError(f"instants_within = {cut(repr(instants_within))}: must be one of {known}")
    return int(instants_within) + 1


def most_parts(meta: Mapping[str, Any]) -> int:
    """The largest number of parts (`parts_of`) that an entry of a library has."""
    return parts_of(meta.get("instants_within", 0))


def heat_is_in(left_out: Mapping[str, Any]) -> bool:
    """Whether the temperature is a constraint of at least one entry: neither it nor all limits are left out."""
    reasons = [left_out[part] for part in (TemperatureLimit.name, "limits") if part in left_out]
    if any(isinstance(said, str) for said in reasons):
        return False
    by_entry = zip(*(itertools.chain.from_iterable(said) for said in reasons), strict=True)
    return not reasons or any(all(reason is None for reason in entry) for entry in by_entry)


def shared_left_out(left_out: Sequence[Sequence[dict[str, str]]]) -> dict[str, Any]:
    """Part -> reason, or -> (nv, ng) reasons if entries differ, None where the part is kept; the form in `meta`."""
    parts = dict.fromkeys(part for row in left_out for entry in row for part in entry)
    shared: dict[str, Any] = {}
    for part in parts:
        reasons = [[entry.get(part) for entry in row] for row in left_out]
        alike = {reason for row in reasons for reason in row}
        shared[part] = reasons[0][0] if len(alike) == 1 else reasons
    return shared


def entry_left_out(meta: dict[str, Any], iv: int, ig: int) -> dict[str, str]:
    """The parts left out of one entry, with reasons, from the form of `shared_left_out`."""
    reasons = {p: said if isinstance(said, str) else said[iv][ig] for p, said in meta["left_out"].items()}
    return {part: reason for part, reason in reasons.items() if reason is not None}
