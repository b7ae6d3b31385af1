"""The first look at a build or a library: the design, a matrix of tap errors, the worst entry, what to do next.

`transopt.report.tables` has the details. The first look reads the declared columns of the entries and the prices,
which the report computes anyway.
"""

import re
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from transopt.base.axes import Axes
from transopt.base.shown import cut
from transopt.base.signals import FloatArray
from transopt.base.writing import percent
from transopt.design.build import Build
from transopt.design.price import Price, library_prices
from transopt.library.columns import NAN, Row
from transopt.library.library import Library
from transopt.problem.answer import AT_FLOOR, END_OF_LIMIT_NAME, MIN_FLOOR_OF_PUSHING_HAND, Status
from transopt.problem.warm_coil import WarmCoil
from transopt.scene.scene import Scene

POOR = 0.5  # a larger error is poor: half of the tap is missing, or as much again follows it
MOST_ROWS = 8  # rows of the matrix; `--table` shows those left out between them
HELD, BAD, REFUSED = "*", "!", "x"  # marks after a number, and in place of one
OF_A_MOTOR = re.compile(r" of motor \d+(, which has [\d.]+ of it)?")  # equal limits of several motors are stated once
LONGEST_TARGET = 28
MOST_LIMITS = 3  # most limits named in one line


@dataclass(frozen=True)
class Look:
    """Data of the first look.

    Attributes
    ----------
    name : name of the scene.
    axes : speeds and grips, or named targets.
    rows : [iv][ig] rows of the entries.
    proof : what is proven of all admitted entries, such as "proven optimal and replayed".
    floored : whether the floors belong to this plant; those of a nonlinear plant belong to the plant at rest.
    """

    name: str
    axes: Axes
    rows: Sequence[Sequence[Row]]
    proof: str
    floored: bool = True

    @classmethod
    def of_build(cls, build: Build) -> "Look":
        """The first look at a build; refused entries are marked."""
        stationary = any(entry.status is Status.STATIONARY for entry in build.all_entries())
        proof = "certified stationary and replayed" if stationary else "proven optimal and replayed"
        return cls(build.scene.name, build.scene.axes, build.entries, proof, not build.scene.nonlinear)

    @classmethod
    def of_library(cls, library: Library, *, proven: bool) -> "Look":
        """The first look at a library. `proven`: whether its certificates were checked when it was read."""
        nv, ng = library.command.shape[:2]
        rows = [[library.row(iv, ig) for ig in range(ng)] for iv in range(nv)]
        what = "stationary" if library.is_stationary else "optimal"
        proof = f"proven {what}" if proven else f"said to be {what}, which was not checked here"
        return cls(library.scene().name, library.axes, rows, proof, not library.nonlinear)

    @property
    def what(self) -> str:
        """Noun for an entry."""
        return "target" if self.axes.targets else "tap"

    def counted(self, count: int) -> str:
        """A number of entries, with the noun in singular or plural."""
        return f"{count} {self.what}{'' if count == 1 else 's'}"

    @cached_property
    def places(self) -> list[tuple[int, int]]:
        """Indices (iv, ig) of all entries."""
        return [(iv, ig) for iv, rows in enumerate(self.rows) for ig in range(len(rows))]

    @cached_property
    def refused(self) -> int:
        """Number of refused entries."""
        return sum(bool(row.refusal) for rows in self.rows for row in rows)

    @cached_property
    def poor(self) -> list[tuple[int, int]]:
        """Entries with a reason in `why_poor`."""
        return [(iv, ig) for iv, ig in self.places if self.why_poor(iv, ig)]

    def why_poor(self, iv: int, ig: int) -> str:
        """Why a hand takes an entry for another tap, in words; empty for a good or a refused entry."""
        row = self.rows[iv][ig]
        if row.refusal:
            return ""
        verdict = str(row.value("verdict")).split(";")[0]
        missing, felt, after = (float(row.value(name)) for name in ("tap", "felt", "after"))
        if verdict.startswith("too "):
            return verdict
        if missing >= POOR:
            return f"{percent(missing)} % of it is missing"
        if felt >= POOR:
            return f"its waveform is {percent(felt)} % off where fingers feel"
        return f"an error of {percent(after)} % of it follows after the waveform" if after >= POOR else ""

    @cached_property
    def errors(self) -> FloatArray:
        """(nv, ng) tap error; NaN where refused."""
        return np.array([[NAN if row.refusal else float(row.value("tap")) for row in rows] for rows in self.rows])

    @cached_property
    def worst(self) -> tuple[int, int] | None:
        """The admitted entry with the largest tap error; None if none is admitted."""
        return _largest(self.errors)

    @cached_property
    def costliest(self) -> tuple[int, int] | None:
        """The admitted entry farthest above its floor, whose limits cost most and whose prices a report has.

        None if no entry is above its floor: prices are in tap error, and what limits cost there lies elsewhere.
        """
        floors = [[NAN if row.refusal else float(row.value("floor")) for row in rows] for rows in self.rows]
        above = self.errors - np.array(floors)
        farthest = _largest(above) if self.floored else None
        return farthest if farthest is not None and above[farthest] > AT_FLOOR else None

    def held(self, iv: int, ig: int) -> list[str]:
        """The limits that hold an entry back, each with its bound; empty for a refused entry."""
        row = self.rows[iv][ig]
        held = "" if row.refusal else str(row.value("held"))
        return list(dict.fromkeys(map(stated_limit, held.split("; ")))) if held else []


def _largest(values: FloatArray) -> tuple[int, int] | None:
    if np.isnan(values).all():
        return None
    iv, ig = np.unravel_index(int(np.nanargmax(values)), values.shape)
    return int(iv), int(ig)


def stated_limit(binding: str) -> str:
    """A limit and its bound: "4 A current" from "current +4 A at 1.2 to 3.1 ms"."""
    name, *rest = END_OF_LIMIT_NAME.split(OF_A_MOTOR.sub("", binding), maxsplit=1)
    bound = rest[0].split(" at ")[0].split(" with ")[0].lstrip("+-") if rest else ""
    return f"{bound} {name}".strip()


def named_limits(limits: Sequence[str]) -> str:
    """Limits as part of a sentence: "the 6 A command and the 4 A current limits"."""
    return f"the {' and the '.join(limits)} limit{'s' if len(limits) > 1 else ''}"


def head(look: Look) -> str:
    """One sentence on the design; refused or poor entries come before what is proven."""
    total, poor = len(look.places), look.poor
    if look.refused:
        return (
            f"{look.name}: {look.refused} of {look.counted(total)} refused, so no library is written and an earlier "
            "one is kept."
        )
    every = "it is" if total == 1 else "all are"
    if poor:
        worst = max(poor, key=lambda place: look.errors[place])
        better = "The limits allow no better: " if look.floored else ""
        return (
            f"{look.name}: {len(poor)} of {look.counted(total)} {'is' if len(poor) == 1 else 'are'} poor: at "
            f"{look.axes.place(*worst)} {look.why_poor(*worst)}. "
            f"{better}{every if better else every.capitalize()} {look.proof}."
        )
    return f"{look.name}: {look.counted(total)}, {'' if total == 1 else 'all '}{look.proof}."


def chosen(count: int, most: int, must: int | None) -> list[int]:
    """At most `most` of `count` indices, evenly spaced, including the first, the last and `must`."""
    if count <= most:
        return list(range(count))
    chosen = np.unique(np.linspace(0, count - 1, max(most, 2)).round().astype(int))
    if must is not None and must not in chosen:
        inner = chosen[1:-1] if chosen.size > 2 else chosen[1:]
        chosen[np.flatnonzero(chosen == inner[np.argmin(np.abs(inner - must))])[0]] = must
    return sorted(map(int, chosen))


def matrix(look: Look, width: int) -> list[str]:
    """The tap error over speed and grip, or per target, in lines of at most `width` characters."""
    axes, errors = look.axes, look.errors
    if axes.targets:
        rows, columns = [cut(name, LONGEST_TARGET) for name in axes.targets], ["error %"]
    else:
        rows = [f"{speed:g} m/s" for speed in axes.speeds_m_s]
        columns = ["free" if grip == 0 else f"{grip:g} N" for grip in axes.by_grip]
    turned = len(columns) == 1 and not axes.targets  # with a single grip, the speeds are columns
    if turned:
        rows, columns = columns, rows
    corner = "" if axes.targets else "tap error %"
    # For an arm, each cell shows the worst of the places.
    groups = [[ig] for ig in range(len(axes.grips_N))] if axes.targets else [*axes.by_grip.values()]
    cells_of = [[_cell(look, iv, group) for group in groups] for iv in range(len(look.rows))]
    found = [list(each) for each in zip(*cells_of, strict=True)] if turned else cells_of
    room = max(len(mark) for cells in found for _, mark in cells)
    columns = [name + " " * room for name in columns]
    cells = [[f"{number}{mark:<{room}}" for number, mark in each] for each in found]
    label = max(map(len, [corner, *rows]))
    size = max(len(text) for texts in [columns, *cells] for text in texts) + 2
    worst = look.worst
    must: tuple[int | None, int | None] = (None, None)
    if worst is not None:
        place = worst[0], next(j for j, group in enumerate(groups) if worst[1] in group)
        must = place[::-1] if turned else place
    down = chosen(len(rows), MOST_ROWS, must[0])
    across = chosen(len(columns), max((width - label) // size, 1), must[1])

    def line(first: str, texts: Sequence[str]) -> str:
        return (f"{first:<{label}}" + "".join(f"{text:>{size}}" for text in texts)).rstrip()

    lines = [line(corner, [columns[j] for j in across])]
    lines += [line(rows[i], [cells[i][j] for j in across]) for i in down]
    if axes.places:
        lines.append(f"(each the worst of {len(groups[0])} places; --table has all)")
    elif len(down) * len(across) < errors.size:
        shown = f"{len(down) * len(across)} of {errors.size} {look.what}s, the worst among them"
        lines.append(f"({shown}; --table has all)")
    return lines


def _cell(look: Look, iv: int, group: Sequence[int]) -> tuple[str, str]:
    """Largest number in a group of entries and their marks, or the mark of refusal if one is refused."""
    if any(look.rows[iv][ig].refusal for ig in group):
        return "", REFUSED
    held, poor = any(look.held(iv, ig) for ig in group), any((iv, ig) in look.poor for ig in group)
    return percent(max(look.errors[iv, ig] for ig in group)), HELD * held + BAD * poor


def marks(look: Look) -> list[str]:
    """Explanations of the marks that occur in the matrix."""
    lines = []
    if look.poor:
        lines.append(
            f"{BAD} poor: half of the {look.what} is missing, felt otherwise or added after it, or a hand feels it "
            "too weak or too strong"
        )
    held = Counter(limit for place in look.places for limit in look.held(*place))
    if held:
        named = [limit for limit, _ in held.most_common()]
        more = f"; and by {len(named) - MOST_LIMITS} more" if len(named) > MOST_LIMITS else ""
        lines.append(f"{HELD} held back by {named_limits(named[:MOST_LIMITS])}{more}")
    if look.refused:
        lines.append(f"{REFUSED} refused, for what is said below")
    return lines


def worst_line(look: Look, prices: Sequence[Price]) -> str:
    """The worst entry, and the effect of raising the costliest limit; empty if no entry is admitted.

    Parameters
    ----------
    prices : prices of the costliest entry, the highest first.
    """
    worst, costliest = look.worst, look.costliest
    if worst is None:
        return ""
    row = look.rows[worst[0]][worst[1]]
    felt = row.value("felt")
    figures = f"{percent(look.errors[worst])} %" + ("" if np.isnan(felt) else f" (felt {percent(felt)} %)")
    place = look.axes.place(*worst)
    sentence = f"{'Worst: ' if look.errors.size > 1 else ''}{place}: {figures}"
    if look.held(*worst) and (not prices or costliest != worst):
        sentence += f", held back by {named_limits(look.held(*worst))}"
    elif not look.held(*worst):
        ends = look.floored and not look.axes.targets and row.value("floor") > MIN_FLOOR_OF_PUSHING_HAND
        sentence += ", held back by no limit" + (": the waveform ends while the hand still pushes" if ends else "")
    if not prices or costliest is None:
        return f"{sentence}."
    at = "" if costliest == worst else f" at {look.axes.place(*costliest)}, {percent(look.errors[costliest])} %"
    return f"{sentence}. {_priced(prices[0], at)}."


def _priced(price: Price, at: str) -> str:
    """The effect of the highest price, as a sentence without full stop."""
    raised = f"{price.bound + price.step:.8g} {price.unit}".rstrip()
    then = f"no certified answer with {raised}" if np.isnan(price.then) else f"with {raised} {percent(price.then)} %"
    bound = f"{price.bound:.8g} {price.unit}".rstrip()
    costs = f"The {bound} {price.limit} limit costs most{at}"
    enough = f"{price.enough:.3g} {price.unit}".rstrip()
    free = f"from about {enough} on it no longer matters" if np.isfinite(price.enough) else price.free_from
    return f"{costs}: {then}; {free}"


def priced(source: Build | Library | None, look: Look) -> Sequence[Price]:
    """Prices of the costliest entry if a limit holds it back; empty if there is no source to compute them from."""
    place = look.costliest
    if source is None or place is None or not look.held(*place):
        return ()
    return source.entries[place[0]][place[1]].prices if isinstance(source, Build) else library_prices(source, *place)


def lines(source: Build | Library | None, look: Look, width: int) -> list[tuple[str, str | None]]:
    """Head, matrix, marks and worst entry: lines with their colours.

    Parameters
    ----------
    source : used to price limits; None for a library that is not proven, whose numbers may pose no problem.
    """
    found = []
    if look.worst is not None:
        found = [*matrix(look, width), *marks(look), worst_line(look, priced(source, look))]
    colour = "red" if look.refused else "yellow" if look.poor else None
    return [(head(look), colour), *((line, None) for line in found if line)]


def next_commands(library: Path, scene: Scene) -> list[str]:
    """Commands for a library file: details, a driver's file or simulated tap, and the page or a check.

    No tap is proposed where the scene's coil begins so warm that a device withholds every transient.
    """
    file, coil = shlex.quote(str(library)), scene.coil()
    heard = f"transopt-play tap {file} --simulate"
    if coil is not None and coil.start_winding_C >= WarmCoil.of(coil.on_a_device(), scene.time.dt_s).play_limit_C:
        heard = f"transopt verify {file}"
    if scene.targets:
        heard = f"transopt export {file} drive.wav --drive"
    if scene.shares:
        heard = f"transopt export {file} motors.h"
    last = "verify" if scene.nonlinear or scene.shares else "page"  # `page` is for linear plants with one motor
    return list(dict.fromkeys([f"transopt show {file} --table", heard, f"transopt {last} {file}"]))
