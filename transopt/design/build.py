"""From a scene and its recordings to a library: every entry designed, the file assembled."""

import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.machine import versions
from transopt.base.shown import cut, html_figure, html_table, wrapped
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.base.writing import percent
from transopt.design.context import Context
from transopt.design.design import SOLVED_TOGETHER, design
from transopt.design.entry import Entry
from transopt.design.entry_arrays import EntryArrays
from transopt.design.nodes import Nodes, Point
from transopt.design.refine_grid import Errors, OffNode, Refinement
from transopt.design.scene_entry import with_remedies
from transopt.design.trade_off import TradeOff, trade_off
from transopt.library.columns import FIGURES, EntryTable
from transopt.library.derived import derived, places
from transopt.library.library import Library
from transopt.library.meta import SCHEMA, heat_is_in, most_parts, shared_left_out
from transopt.library.multipliers import ARRAYS, further_arrays
from transopt.library.posed import PLANT
from transopt.plant.state_space import POSITION, VELOCITY
from transopt.problem.answer import Status
from transopt.problem.objective.target import along_normal
from transopt.recordings.recording import Recording
from transopt.references.reference import COURSES, Reference
from transopt.references.references import TARGETS, References
from transopt.scene.identified import IdentifiedModel
from transopt.scene.model_parts import MODEL_PARTS
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions
from transopt.solvers.side_by_side import together

if TYPE_CHECKING:  # nothing is drawn while a library is solved
    from matplotlib.figure import Figure


# Arrays of a reference that a library stores for every cell under the same name.
CELLS = (*(name for name in COURSES if name != "nominal_position_at_ticks_m"), *TARGETS)


@dataclass(frozen=True)
class Build:
    """The outcome of a design: all entries, speed by speed, and a `library` only if every entry is admitted.

    `scene` has the grid that was solved; with a `refinement`, that is the refined one. `cool` has the entries of the
    cool commands (`grid.cool_share`), speed by speed. It is empty where the scene asks for no cool commands or any
    other entry is refused.
    """

    scene: Scene
    references: References
    entries: list[list[Entry]]
    library: Library | None
    solver: str
    elapsed_s: float
    refinement: Refinement | None = None
    cool: Sequence[Sequence[Entry]] = ()

    def __repr__(self) -> str:
        entries = list(self.all_entries())
        errors = [entry.figures.tap_error for entry in entries if entry.admitted]
        found = f", tap error {percent(min(errors))} to {percent(max(errors))} %" if errors else ""
        stationary = any(entry.status is Status.STATIONARY for entry in entries)
        certified = "certified stationary" if stationary else "certified"
        return wrapped(
            f"Build({cut(self.scene.name)}: {self.scene.axes.in_words}, "
            f"{len(errors)} of {len(entries)} entries {certified} and replayed"
            f"{found}; {self.elapsed_s:.2f} s)"
        )

    def _repr_html_(self) -> str:
        """Table and figure in a notebook."""
        linear = ("linear",) if self.scene.nonlinear else ()
        names = ("tap", "floor", *FIGURES[1:], *linear, "binding", "verdict")
        shown = self.table(names)
        return html_table(repr(self), shown.heads, shown.cells) + html_figure(self.plot())

    def table(self, names: Sequence[str]) -> EntryTable:
        """All entries, speeds outermost, in columns of `transopt.library.columns.COLUMNS`."""
        scene = self.scene
        limits = (scene.limits.transient_input, scene.limits.steady_input)
        return EntryTable(scene.axes.columns, names, list(self.all_entries()), scene.driven_by.unit, limits).known

    def plot(self) -> "Figure":
        """Plot every waveform over time; for a refused entry only its reference.

        The figure is matplotlib's; `savefig` writes it to a file.
        """
        from transopt.report.transients import entries_figure

        return entries_figure(self.entries)

    def all_entries(self) -> Iterator[Entry]:
        for row in self.entries:
            yield from row

    @cached_property
    @one_blas_thread()
    def trade_offs(self) -> list[TradeOff]:
        """Trade-off of waveform against intensity for every entry with a binding limit; solved on first access."""
        options = SolverOptions(self.solver)
        found = together([trade_off(entry, options) for entry in self.all_entries()])
        return [each for each in found if each is not None]

    @one_blas_thread()
    def between_nodes(self, points: Iterable[Point]) -> list[OffNode]:
        """Compare blends of the nodes' commands, at any speeds and grips, with the optima solved exactly there.

        Parameters
        ----------
        points : each a speed [m/s] and a grip [N] within the grid.

        Returns
        -------
        One result for each point, in their order: `optimum` is the tap error of the optimum there and `after` that of
        the blend, both replayed. `before` equals `after`, since there is only one grid.

        Raises
        ------
        InputError : a point outside of the grid, or one without a proven optimum.
        """
        grid = self.scene.grid
        if self.scene.targets:
            raise InputError("between_nodes: named targets have nothing between them: ask for a scene with speeds")
        self.scene.check_one_motor("between_nodes")
        asked = list(points)
        for name, values, nodes, unit in (
            ("speed", [speed for speed, _ in asked], grid.speeds_m_s, "m/s"),
            ("grip", [grip for _, grip in asked], grid.grips_N, "N"),
        ):
            for value in values:
                if not nodes[0] <= value <= nodes[-1]:
                    raise InputError(
                        f"between_nodes: {name} {value:g} {unit}: outside of the nodes, {nodes[0]:g} to "
                        f"{nodes[-1]:g} {unit}: ask for points within them"
                    )
        own = Nodes(tuple(grid.speeds_m_s), tuple(grid.grips_N))
        return Errors(self.context, SolverOptions(self.solver)).replayed(asked, own, own)

    @property
    def recorded_remarks(self) -> list[str]:
        """Assumptions about the scene's own grips that no recording supports, one sentence each."""
        grid = self.scene.grid if self.refinement is None else self.refinement.recorded
        return self.references.remarks(grid.grips_N)

    @property
    def context(self) -> Context:
        """Devices and references with which the entries' problems were posed."""
        return Context(self.scene, self.references)

    @property
    def refused(self) -> list[Entry]:
        """Entries that are not admitted and so prevent a library; cool commands only if all others are admitted."""
        first = [entry for entry in self.all_entries() if not entry.admitted]
        return first or [entry for row in self.cool for entry in row if not entry.admitted]

    @property
    def proven(self) -> list[Entry]:
        """Entries that are admitted: certified, and replayed without leaving a limit."""
        return [entry for entry in self.all_entries() if entry.admitted]

    def command(self, target: str) -> FloatArray:
        """(N,) command of a named target [A or V], issued at -lead + k dt and held.

        Raises
        ------
        InputError : a target that the scene does not have, or one whose design is refused.
        """
        entry = next((each for each in self.all_entries() if each.target == target), None)
        if entry is None:
            known = ", ".join(self.scene.axes.targets) or "it has speeds"
            raise InputError(f"{target}: no target of this scene: {known}")
        if not entry.admitted:
            raise InputError(f"{target}: refused: {'; '.join(entry.shortfalls) or entry.status.value}")
        return entry.solution.command


@one_blas_thread()
def build_library(
    scene: Scene,
    recordings: Sequence[Recording] | References,
    *,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] = lambda done: None,
    refinement: Refinement | None = None,
) -> Build:
    """Design, certify and replay every entry of a scene.

    Parameters
    ----------
    recordings : the scene's recordings (`reference.read_recordings`, or `transopt.scene.strikes.recordings`), or the
        references of a library whose recordings are not at hand (`transopt.library.recorded`).
    progress : called with the number of entries that have just been finished.
    refinement : a refinement of this scene (`refine_grid.refine_grid`). Its grid is solved in place of the scene's
        own; references at added speeds are blended from the recorded ones (`References.at`).

    Raises
    ------
    InputError : recordings that cannot be used, or parameters that are not passive at some grip.
    """
    start = time.perf_counter()
    options = SolverOptions() if options is None else options
    if isinstance(recordings, References):
        context = Context(scene, recordings)
    else:
        context = Context.recorded(scene, recordings)
    if refinement is not None:
        scene = scene.model_copy(update={"grid": refinement.grid})
        context = context.varied(scene)
    rows, devices = scene.axes.rows, scene.axes.devices
    table = EntryArrays(len(rows), len(devices), without=TARGETS)
    entries: list[list[Entry]] = [[] for _ in rows]
    # Some whole devices together, or a part of the rows of one that has many.
    some, parts = max(SOLVED_TOGETHER // len(rows), 1), math.ceil(len(rows) / SOLVED_TOGETHER)
    for first, part in itertools.product(range(0, len(devices), some), np.array_split(range(len(rows)), parts)):
        posed = [
            each
            for number in range(first, min(first + some, len(devices)))
            for each in context.posed_together([context.cells.rows[i][number] for i in part], *devices[number])
        ]
        designed = design(posed, options=options)
        for column in (designed[i : i + part.size] for i in range(0, len(designed), part.size)):
            table.add(column)
            # The table has replayed and judged the entries, so that progress counts finished ones.
            progress(len(column))
            for i, entry in zip(part, column, strict=True):
                entries[i].append(entry)
    entries = with_remedies(context, entries, options)
    cool = _cool(context, entries, options)
    admitted = all(entry.admitted for row in (*entries, *cool) for entry in row)
    return Build(
        scene=scene,
        references=context.references,
        entries=entries,
        library=_assembled(context, table, entries, options, refinement, cool) if admitted else None,
        solver=options.solver,
        elapsed_s=time.perf_counter() - start,
        refinement=refinement,
        cool=cool,
    )


def _cool(context: Context, entries: Sequence[Sequence[Entry]], options: SolverOptions) -> list[list[Entry]]:
    """Entries of the cool commands; empty where the scene asks for none, or any of `entries` is refused."""
    share = context.scene.grid.cool_share
    if share is None or not all(entry.admitted for row in entries for entry in row):
        return []
    columns = []
    for column in zip(*entries, strict=True):
        posed = [context.posed(entry.speed_m_s, entry.grip_N, entry.target) for entry in column]
        asked = [
            replace(each, warmer=entry.designed, cool_share=share) for each, entry in zip(posed, column, strict=True)
        ]
        columns.append(design(asked, options=options))
    return [list(row) for row in zip(*columns, strict=True)]


def _assembled(
    context: Context,
    table: EntryArrays,
    entries: list[list[Entry]],
    options: SolverOptions,
    refinement: Refinement | None,
    cool: Sequence[Sequence[Entry]],
) -> Library:
    """Assemble the library of admitted entries, speeds outermost, and of the cool commands where there are any.

    For a nonlinear plant the stored problem is that of the plant linearised at rest; predicted motions and the errors
    of the baselines are those on the nonlinear plant.
    """
    scene = context.scene

    plants = [entry.problem.stage.plant for entry in entries[0]]
    spreads = [[device.plant for device in entry.problem.spread] for entry in entries[0]]

    def stacked(name: str) -> Any:
        own = np.stack([getattr(plant, name) for plant in plants])
        others = [[getattr(plant, name) for plant in devices] for devices in spreads]
        return np.array(others).reshape(len(plants), len(spreads[0]), *own.shape[1:])

    axes, p = scene.axes, entries[0][0].problem.stage.tracked
    cells, courses = context.cells.rows, context.cells.courses

    def of_cells(name: str) -> FloatArray:
        found = courses[name]
        return along_normal(found, p) if ARRAYS[name].is_directed and found.ndim == 3 and p > 1 else found

    at_ticks = courses["nominal_position_at_ticks_m"]
    meta = {**_meta(context, cells, entries, options), "grid_refinement": _refined(refinement)}
    parts = max(max(entry.problem.parts.values(), default=1) for row in (*entries, *cool) for entry in row)
    if parts > 1:
        meta["instants_within"] = parts - 1
    if cool:
        meta["cool"] = {"left_out": shared_left_out([[entry.left_out for entry in row] for row in cool])}
    further = further_arrays(context.posing, len(spreads[0]), most_parts(meta))
    arrays = {
        "speeds_m_s": np.asarray(scene.axes.speeds_m_s),
        "targets": np.array([target for _, target in scene.axes.rows], dtype=np.str_),
        "target_ends_s": np.array([row[0].ends_s if row[0].name else 0.0 for row in cells]),
        "grips_N": np.asarray(axes.grips_N),
        **places(scene),
        **{name: of_cells(name) for name in CELLS},
        "nominal_position_at_ticks_m": at_ticks[..., : scene.stages],
        "nominal_after_at_ticks_m": at_ticks[..., scene.stages :],
        **table.arrays(further),
        # One zero for all: a library that was not refined on its device has no correction.
        "correction_m_s2": np.broadcast_to(0.0, table.shape + entries[0][0].problem.reference_m_s2.shape),
        **{f"plant_{name}": np.stack([getattr(plant, name) for plant in plants]) for name in PLANT},
        **{f"spread_{name}": stacked(name) for name in PLANT},
    }
    library = Library.of(arrays, meta)
    if not cool:
        return library
    of_cool = EntryArrays(len(cool), len(cool[0]), without=TARGETS)
    for column in zip(*cool, strict=True):
        of_cool.add(column)
    return library.with_cool({name: arrays[name] for name in TARGETS} | of_cool.arrays(further))


def _meta(
    context: Context, cells: list[list[Reference]], entries: list[list[Entry]], options: SolverOptions
) -> dict[str, Any]:
    scene = context.scene
    left_out = shared_left_out([[entry.left_out for entry in row] for row in entries])
    watched = context.posing.watched
    # Position and velocity are stored even where no limit reads them: they distinguish a mass inside a case from one
    # that the nominal motion moves.
    outputs = [entry.problem.stage.plant.stored((POSITION, VELOCITY, *watched)) for entry in entries[0]]
    of_spread = [[device.plant.stored(watched) for device in entry.problem.spread] for entry in entries[0]]
    return {
        "schema": SCHEMA,
        "derived": derived(
            context.posing,
            [row[0].problem for row in entries],
            warm=heat_is_in(left_out),
        ),
        **({"outputs": outputs} if any(outputs) else {}),
        **({"spread_outputs": of_spread} if any(map(any, of_spread)) else {}),
        "left_out": left_out,
        "repeatability": [[None if np.isnan(c.repeatability) else c.repeatability for c in row] for row in cells],
        "slow_part_known": [[cell.slow_part_known for cell in row] for row in cells],
        "scene": scene.model_dump(mode="json"),
        "solver": {**asdict(options), **({"nonlinear": entries[0][0].solution.solver} if scene.nonlinear else {})},
        "sources": [
            *(source for cell in context.references for source in _sources(scene, cell)),
            *_target_sources(scene, context.references),
            *_model_sources(scene),
        ],
        "versions": versions("transopt", "casadi", "numpy", "scipy"),
    }


def _refined(refinement: Refinement | None) -> dict[str, Any] | None:
    """Evidence of a grid refinement and which nodes were recorded; null for a grid that was not refined."""
    if refinement is None:
        return None
    recorded, grid = refinement.recorded, refinement.grid
    return {
        "tolerance": refinement.tolerance,
        "worst_excess_before": max((p.excess_before for p in refinement.off(recorded)), default=0.0),
        "worst_excess_after": max((p.excess_after for p in refinement.off(grid)), default=0.0),
        "points": len(refinement.points),
        "shortfall": refinement.shortfall,
        "recorded_speeds_m_s": recorded.speeds_m_s,
        "scene_grips_N": recorded.grips_N,
    }


def _model_sources(scene: Scene) -> list[dict[str, Any]]:
    """The model file and the measurements its parts were fitted to; empty for a model stated in the scene itself."""
    if not isinstance(scene.model, IdentifiedModel):
        return []
    own = {"file": scene.model.file, "origin": "model file", "sha256": scene.model.sha256}
    parts = {name: getattr(scene.model, name) for name in MODEL_PARTS}
    return [
        own,
        *(
            {**source.model_dump(), "origin": f"{name} of {scene.model.file} was identified from it"}
            for name, part in parts.items()
            if part is not None
            for source in part.sources
        ),
    ]


def _sources(scene: Scene, reference: Reference) -> list[dict[str, Any]]:
    return [
        {
            "file": tap.recording.name,
            "origin": tap.recording.source,
            "sha256": tap.recording.sha256,
            "grid_speed_m_s": reference.speed_m_s,
            "grip_N": tap.recording.grip_N,
            "speed_source": tap.speed_source,
            "time_scale": scene.recordings.time_scale,
            "scaling": float(factor * tap.amplitude),
            "onset_s": tap.onset_s,
            "offset_m_s2": tap.offset_m_s2,
            "polarity": tap.polarity,
        }
        for tap, factor in zip(reference.taps, reference.factors, strict=True)
    ]


def _target_sources(scene: Scene, references: References) -> list[dict[str, Any]]:
    """Named targets as the scene states them, each with the hash of its file if it was read from one."""
    if not scene.targets:
        return []
    return [
        {"origin": "target", **target.model_dump(exclude_none=True), "sha256": reference.sha256}
        for target, reference in zip(scene.targets, references, strict=True)
    ]
