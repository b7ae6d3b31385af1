"""Does what is said to do for a refused entry really do?

    python -m pytest -m long -n 0 tests/campaigns/test_remedies.py
        --campaign="[--cases 3000] [--seed 31337] [--scenes all|few|none] [--jobs 4] [--json FILE]"

Gathers the refusals of random stress cases and of a grid of scenes: virtual walls of 50 to 2000 N/m at 0.2 to 4 A,
slow commands over a wall, warm coils, rails, strokes. Of each it takes every remedy that is stated as solved, reads
its numbers once from the sentence as a user would and once from its type, and solves the scene or the case anew with
them, as they stand and by the ordinary way. It fails if a sentence and its type differ, if a remedy does not end
certified and replayed clean, or if a refusal states none.
"""

import os
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from typing import Annotated, Any

import pytest
import typer

import problems
from problems.stress.cases import StressCase
from problems.stress.draw import drawn
from tests.campaigns.harness import Jobs, JsonFile, Seed, long_form, words_of, write_json
from transopt.base.errors import InputError
from transopt.base.writing import table
from transopt.design.build import build_library
from transopt.design.context import Context
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.design.explain import Remedy, what_would_do
from transopt.design.remedy import Values, remedies
from transopt.problem.answer import Status
from transopt.scene.keys import with_values
from transopt.scene.recordings import recordings_of
from transopt.solvers.options import SolverOptions

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
STATED = re.compile(r"(?:no (?P<gone>[\w.]+))|(?:(?P<key>[\w.]+) = (?P<value>\S+))")
EVERY = 100  # places, of a line that says how far it is
CURRENTS_A = (0.2, 0.3, 0.5, 0.8, 1.25, 2.0, 4.0)
STIFFNESSES_N_M = (50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0)


@dataclass(frozen=True)
class Place:
    """Places to look for refusals: a stress case, or a built-in scene with other numbers."""

    name: str
    case: StressCase | None = None
    scene: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class Refusal:
    """One refused entry.

    Attributes
    ----------
    place : its name.
    status : how it ended.
    sentence : the whole message.
    stated : remedies that are said to do. failed : those of them that did not, with how they ended.
    seconds : from the refusal to its remedies.
    """

    place: str
    status: str
    sentence: str
    stated: int = 0
    failed: list[str] = field(default_factory=list)
    seconds: float = 0.0


def read(sentence: str) -> list[dict[str, float | None]]:
    """Keys and values of each remedy, as they are printed in "A and B, or C would do"."""
    if not sentence.endswith(" would do"):
        return []
    return [
        {
            found["gone"] or found["key"]: None if found["gone"] else float(found["value"])
            for found in STATED.finditer(one)
        }
        for one in sentence.removesuffix(" would do").split(", or ")
    ]


def _stands(case: StressCase, values: Values | None) -> Entry:
    """How a case ends with other numbers, by the ordinary way."""
    (entry,) = design([case.posed(values)])
    return entry


def _checked(refusal: Refusal, said: Sequence[Remedy], sentence: str, ends: Callable[[Values], str]) -> Refusal:
    """Try every remedy that is stated as solved; `ends` says how an entry does with its numbers."""
    stated = [remedy for remedy in said if remedy.solved]
    refusal.stated = len(stated)
    printed = read(sentence)
    if printed != [dict(remedy.values) for remedy in stated]:
        refusal.failed.append(f"the sentence says {printed}, its type {[dict(remedy.values) for remedy in stated]}")
    for values in printed:
        end = ends(values)
        if end:
            refusal.failed.append(f"{values}: {end}")
    return refusal


def of_case(place: Place) -> list[Refusal]:
    """The refusal of a stress case, if it is one that has a problem."""
    case = place.case
    assert case is not None
    try:
        entry = _stands(case, None)
    except InputError:
        return []
    if entry.admitted:
        return []
    start = time.perf_counter()
    own = remedies(case, entry, SolverOptions())
    sentence, took_s = what_would_do(own), time.perf_counter() - start
    found = Refusal(place.name, entry.status.name, "; ".join([*entry.shortfalls, sentence]), seconds=took_s)

    def ends(values: Values) -> str:
        try:
            again = _stands(case, values)
        except InputError as error:
            return str(error)
        return "" if again.admitted else f"{again.status.name}: {'; '.join(again.shortfalls)}"

    return [_checked(found, own, sentence, ends)]


def of_scene(place: Place) -> list[Refusal]:
    """The refusals of a scene."""
    options = SolverOptions()
    scene = with_values(problems.load(place.scene), place.values)
    taps = recordings_of(scene)
    built = build_library(scene, taps, options=options)
    found = []
    for entry in built.refused:

        def ends(values: Values, speed_m_s: float = entry.speed_m_s, grip_N: float = entry.grip_N) -> str:
            try:
                changed = with_values(scene, values)
                (again,) = design([Context.recorded(changed, taps).posed(speed_m_s, grip_N)], options=options)
            except InputError as error:
                return str(error)
            return "" if again.status is Status.OPTIMAL else f"{again.status.name}: {'; '.join(again.shortfalls)}"

        name = f"{place.name}, {entry.speed_m_s:g} m/s, {entry.grip_N:g} N"
        refusal = Refusal(name, entry.status.name, "; ".join(entry.shortfalls))
        found.append(_checked(refusal, entry.remedies, entry.shortfalls[-1], ends))
    return found


def refusals(place: Place) -> list[Refusal]:
    """All refusals of a place, their remedies tried."""
    return of_scene(place) if place.case is None else of_case(place)


def stress(seed: int, count: int) -> list[Place]:
    return [Place(f"seed {seed}, case {index}", drawn(seed, index)) for index in range(count)]


def _scene(name: str, values: Values, grid: Mapping[str, list[float]] | None = None) -> Place:
    said = ", ".join(f"no {key}" if value is None else f"{key} {value:g}" for key, value in values.items())
    return Place(f"{name} with {said}", scene=name, values={**values, **(grid or {})})


def few_scenes() -> list[Place]:
    """One of each kind, with one entry each."""
    one = {"grid.speeds_m_s": [0.4], "grid.grips_N": [5.0]}
    return [
        _scene("walled", {"feedback.stiffness_N_m": 500.0, "limits.current_A": 0.5}, one),
        _scene("low_supply", {"limits.supply_V": 0.3}, one),
        _scene("hot_coil", {"thermal.start_winding_C": 85.0, "thermal.headroom_K": 1e-6}, one),
        _scene("low_supply", {"limits.stroke_m": 5e-3}, one),
    ]


def grid_of_scenes() -> list[Place]:
    """Walls, slow commands over a wall, coils, rails and strokes."""

    def walls() -> Iterator[Place]:
        for stiffness in STIFFNESSES_N_M:
            for current in CURRENTS_A:
                yield _scene("walled", {"feedback.stiffness_N_m": stiffness, "limits.current_A": current})
        for damping in (0.0, 5.0, 20.0):
            for current in (0.3, 1.25):
                yield _scene("walled", {"feedback.damping_N_s_m": damping, "limits.current_A": current})
        for rate in (1.0, 10.0, 100.0):
            yield _scene("walled", {"feedback.stiffness_N_m": 1000.0, "limits.slew_A_per_s": rate})
        for latency in (10, 50, 100):
            yield _scene("walled", {"feedback.stiffness_N_m": 2000.0, "feedback.latency_ticks": latency})

    def coils() -> Iterator[Place]:
        for start in (90.0, 99.0, 99.99, 99.9999, 100.0):
            yield _scene("hot_coil", {"thermal.start_winding_C": start, "thermal.headroom_K": None})
        for headroom in (1e-2, 1e-3, 1e-4, 1e-6):
            yield _scene("hot_coil", {"thermal.start_winding_C": 85.0, "thermal.headroom_K": headroom})
        for ambient in (60.0, 90.0, 99.99):
            yield _scene("rapid_tapping", {"thermal.ambient_C": ambient})
        for idle in (0.5, 1.0, 2.0, 4.0):
            yield _scene("rapid_tapping", {"thermal.idle_A": idle})

    def rails() -> Iterator[Place]:
        for volts in (0.05, 0.1, 0.2, 0.3, 0.5, 0.6, 1.0, 3.0):
            yield _scene("low_supply", {"limits.supply_V": volts})
        for stroke in (1e-6, 1e-4, 1e-3, 5e-3):
            yield _scene("low_supply", {"limits.stroke_m": stroke})
        for velocity in (0.05, 0.3, 0.45):
            yield _scene("low_supply", {"limits.velocity_m_s": velocity})
        for volts in (0.3, 1.0):
            yield _scene("low_supply", {"limits.supply_V": volts, "limits.velocity_m_s": 0.3})

    return [*walls(), *coils(), *rails()]


CORES = os.cpu_count() or 1
SCENES: Mapping[str, Callable[[], list[Place]]] = {"all": grid_of_scenes, "few": few_scenes, "none": list}


def campaign(places: Sequence[Place], jobs: int) -> tuple[list[Refusal], list[str]]:
    """The refusals of all places, and of places that could not be looked at what happened there."""
    for variable in ONE_THREAD:
        os.environ.setdefault(variable, "1")
    found: list[Refusal] = []
    broken: list[str] = []
    if jobs == 1:
        return [refusal for place in places for refusal in refusals(place)], broken
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        names = {pool.submit(refusals, place): place.name for place in places}
        for count, done in enumerate(as_completed(names), 1):
            if count % EVERY == 0:
                print(f"{count} of {len(places)} places, {len(found)} refusals", file=sys.stderr, flush=True)
            try:
                found += done.result()
            except Exception as error:  # the others go on
                broken.append(f"{names[done]}: {type(error).__name__}: {error}")
    return found, broken


def summary(found: Sequence[Refusal]) -> list[str]:
    """Lines of a table: refusals, remedies and what became of them, by how the entries ended."""
    rows = []
    for status in sorted({refusal.status for refusal in found}):
        of = [refusal for refusal in found if refusal.status == status]
        stated, failed = sum(r.stated for r in of), sum(len(r.failed) for r in of)
        slowest = max(r.seconds for r in of)
        rows.append([status, len(of), sum(not r.stated for r in of), stated, stated - failed, f"{slowest:.1f}"])
    return table(["refused as", "entries", "without a remedy", "remedies stated", "of them did", "slowest s"], rows)


def main(
    cases: int = 3000,
    seed: Seed = 31337,
    scenes: Annotated[str, typer.Option(help="all, few or none")] = "all",
    jobs: Jobs = CORES,
    json: JsonFile = None,
) -> int:
    [grid] = words_of(scenes, SCENES)
    places = [*SCENES[grid](), *stress(seed, cases)]
    found, broken = campaign(places, jobs)
    print("\n".join(summary(found)))
    for refusal in found:
        for failure in refusal.failed:
            print(f"does not do: {refusal.place}: {failure}")
        if not refusal.stated:
            print(f"no remedy: {refusal.place}: {refusal.sentence}")
    for line in broken:
        print(line)
    kinds = Counter(bool(refusal.stated) for refusal in found)
    print(
        f"{len(found)} refusals, {kinds[True]} with remedies; {sum(r.stated for r in found)} remedies, "
        f"{sum(len(r.failed) for r in found)} of them did not do"
    )
    write_json([asdict(refusal) for refusal in found], json)
    return int(bool(broken) or kinds[False] > 0 or any(refusal.failed for refusal in found))


test_long_form = long_form(main)


SEED, CASES = 31337, 90
SHORT = 60  # stages


def test_a_sentence_is_read_as_it_is_meant() -> None:
    assert read("limits.current_A = 2 A and amplifier.command_limit_A = 3e-05 A, or no feedback would do") == [
        {"limits.current_A": 2.0, "amplifier.command_limit_A": 3e-5},
        {"feedback": None},
    ]
    assert read("tried in vain, as far as limits.supply_V = 48 V") == []


@pytest.mark.parametrize("place", few_scenes(), ids=lambda place: place.name)
def test_every_remedy_of_a_scene_does(place: Place) -> None:
    found = refusals(place)
    assert found
    for refusal in found:
        assert refusal.stated, refusal.sentence
        assert refusal.failed == []


def test_every_remedy_of_random_cases_does() -> None:
    short = [place for place in stress(SEED, CASES) if place.case is not None and place.case.horizon.stages <= SHORT]
    found, broken = campaign(short, 1)
    assert broken == []
    assert len(found) >= 5
    for refusal in found:
        assert refusal.stated, f"{refusal.place}: {refusal.sentence}"
        assert refusal.failed == [], refusal.place


def test_a_grid_holds_every_kind_of_limit() -> None:
    keys = {key for place in SCENES["all"]() for key in place.values}
    assert keys >= {
        "limits.current_A",
        "limits.slew_A_per_s",
        "limits.supply_V",
        "limits.stroke_m",
        "limits.velocity_m_s",
        "feedback.stiffness_N_m",
        "thermal.start_winding_C",
        "thermal.headroom_K",
        "thermal.idle_A",
    }
    assert drawn(SEED, 3) == stress(SEED, 4)[3].case
