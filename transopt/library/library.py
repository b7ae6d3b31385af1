"""A library: waveforms over (speed, grip) with all it takes to check and to play them."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.axes import Axes
from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.shown import cut, html_figure, html_table, wrapped
from transopt.base.signals import FloatArray
from transopt.base.writing import percent
from transopt.library.arrays import HASH_FIELD, absent, content_hash
from transopt.library.columns import COLUMNS, FIGURES, NAN, EntryTable, TableRow
from transopt.library.held import Held
from transopt.library.meta import most_parts, parts_of, stated
from transopt.library.multipliers import ARRAYS, MULTIPLIERS, further_arrays, is_of_entries, row_of
from transopt.library.place import Place, Waveform, finite, interpolation_weights, speed_weights
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import StageModel, TimeGrid
from transopt.plant.state_space import Input, Output, StateSpace
from transopt.plant.wall import Wall
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers, verdict
from transopt.problem.limits import OF_OUTPUTS
from transopt.problem.limits.limit import SIDES
from transopt.problem.limits.own import OwnLimit
from transopt.problem.objective.bands import levels
from transopt.problem.objective.figures import Figures, Yardstick
from transopt.problem.objective.target import Target
from transopt.problem.posing import Posing, Wanted
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import pressing_under

if TYPE_CHECKING:  # a device that plays a library loads neither matplotlib nor pydantic for it
    from matplotlib.figure import Figure

    from transopt.scene.scene import Scene

PLANT = ("A", "B", "C", "D", "Ce")
# What is proven of the commands of a nonlinear plant, in the words of whatever shows such a library.
NONLINEAR_CLAIM = (
    "nonlinear plant: each command is a certified stationary point, replayed on that plant; no bound says that there "
    "is no better one, and floor is of the plant as it is at rest"
)
COOL = "cool_"  # before the name of an array in the file: it is of the cool commands


@dataclass(frozen=True)
class Library(Held):
    """A solved library, as `library.npz` holds it.

    Every array states its shape, unit and meaning beside its name (`transopt.library.held`), in the letters of
    `transopt.library.arrays.Array`; `meta` is the file's JSON: the scene, numbers derived from it, the recordings and
    the versions used. The problem of an entry is that of the scene with the plants and the targets in the file;
    nothing else states it.
    `multipliers_of` has the array of every side of every limit's row by its name in the file, mu_<row>_<side>: which
    these are follows from the list of limits (`MULTIPLIERS`).

    What was recorded is r, how the stylus accelerates without a command a_free. What J asks of y'', which the command
    adds, is the target r - a_free.

    In a library that was refined on its device (`meta["refinement"]`) `correction_m_s2` is added to the target, so
    that the device, which is not quite the model, makes r. All of its certificate is of that problem; `tap_error` and
    `floor` stay the model's view of r, and what the device really did stands in `meta["refinement"]`.

    Where the scene's plant is nonlinear, `plant_A` to `plant_Ce` are the plant as it is at rest, and commands,
    predictions, errors and multipliers are of the nonlinear plant (`transopt.library.nonlinear`). Such an entry is a
    stationary point and no proven optimum: its `lower_bound` is 0, below which no J is. `floor` is that of the plant
    at rest.

    `cool` is the library of the cool commands, one of every node with less heat (`grid.cool_share`), and None where
    the scene asks for none. It shares everything that is not of a command; in the file its own arrays have `cool_`
    before their names.
    """

    multipliers_of: Mapping[str, FloatArray]
    meta: dict[str, Any]
    cool: "Library | None" = None

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]], meta: dict[str, Any]) -> "Library":
        """From all arrays by their names in the file; those of multipliers are mu_<row>_<side>."""
        named = {name: array for name, array in arrays.items() if name in ARRAYS and name not in MULTIPLIERS}
        multipliers = {name: array for name, array in arrays.items() if name.startswith("mu_") and name not in named}
        return cls(**named, multipliers_of=multipliers, meta=meta, cool=None)

    def with_cool(self, arrays: Mapping[str, NDArray[Any]]) -> "Library":
        """This library with cool commands, from the arrays of their entries by the names of the first ones'."""
        shared = {name: self.array(name) for name in ARRAYS if not is_of_entries(name)}
        meta = {**self.meta, "left_out": self.meta["cool"]["left_out"]}
        return replace(self, cool=Library.of({**shared, **arrays}, meta))

    def __repr__(self) -> str:
        stages, dt_s = self.command.shape[2], self.dt_s
        errors = f"tap error {percent(self.tap_error.min())} to {percent(self.tap_error.max())} %"
        return wrapped(
            f"Library({cut(self.meta['scene']['name'])}: {self.axes.said}, {stages} commands of {1e3 * dt_s:g} ms, "
            f"limit {self.input_limit:g} {self.driven_by.unit}, {errors}"
            f"{'; nonlinear plant, stationary points' if self.nonlinear else ''})"
        )

    @property
    def nonlinear(self) -> bool:
        """Whether its commands are for a nonlinear plant."""
        return self.scene().nonlinear

    @property
    def claim(self) -> str:
        """What is proven of its commands where that is not that each is an optimum, in a sentence; empty else."""
        return NONLINEAR_CLAIM if self.nonlinear else ""

    def check_linear(self, what: str) -> None:
        """Refuse what only a linear plant allows.

        Raises
        ------
        InputError : a nonlinear plant.
        """
        if self.nonlinear:
            raise InputError(
                f"{what}: this library's plant is nonlinear, and this is done with linear plants alone: verify, "
                "show, compare and export take it; for all else solve the scene without model.nonlinear"
            )

    @property
    def axes(self) -> Axes:
        """What its entries are for: speeds and grips, or named targets."""
        names = tuple(map(str, self.targets)) if self.scene().targets else ()
        return Axes(tuple(self.speeds_m_s.tolist()), tuple(self.grips_N.tolist()), names)

    @property
    def dt_s(self) -> float:
        """The servo period."""
        return self.time_grid().dt_s

    @property
    def lead_s(self) -> float:
        """How long before contact the first command is issued."""
        return self.time_grid().lead_s

    @property
    def hand_over_samples(self) -> int:
        """So many commands at the end are the wall's own, zero without one."""
        return self.posing().hand_over_samples

    @property
    def grip_min_N(self) -> float:
        """Below this grip nothing is played; 0 for the free device, which has no such bound."""
        return 0.0 if self.grips_N[0] == 0 else self.scene().grid.grip_min_N

    @property
    def input_limit(self) -> float:
        """The transient limit on the plant's input."""
        return float(self.posing().asked[f"{self.driven_by.name}_{self.driven_by.unit}"])

    @property
    def steady_input(self) -> float:
        """What the actuator stands for ever, at which the baselines are looked at besides."""
        return float(self.posing().asked[f"steady_{self.driven_by.name}_{self.driven_by.unit}"])

    def _repr_html_(self) -> str:
        """Table and figure in a notebook."""
        shown = self.table((*FIGURES, "peak", "binding"))
        return html_table(repr(self), shown.heads, shown.cells) + html_figure(self.plot())

    def table(self, names: Sequence[str]) -> EntryTable:
        """All entries, speeds outermost, in columns of `transopt.library.columns.COLUMNS`."""
        nv, ng, _ = self.command.shape
        rows = [self.row(iv, ig) for iv in range(nv) for ig in range(ng)]
        limits = (self.input_limit, self.steady_input)
        return EntryTable(self.axes.columns, names, rows, self.driven_by.unit, limits).known

    def row(self, iv: int, ig: int) -> TableRow:
        """What tables show of an entry."""
        found: dict[str, Any] = {
            "linear": (self.tap_error_promised[iv, ig], self.tap_error_linear[iv, ig]),
            "repeats": self._repeatability(iv, ig),
            "gap": self.duality_gap[iv, ig] / max(self.objective[iv, ig], OBJECTIVE_SCALE),
            "verdict": self.verdict(iv, ig),
        }
        for name, column in COLUMNS.items():
            if column.array and not (column.after and self.time_grid().after_stages == 0):
                found[name] = getattr(self, column.array)[iv, ig]
        return TableRow(self.axes.cells(iv, ig), found)

    def verdict(self, iv: int, ig: int) -> str:
        """How good an entry is, see `transopt.problem.answer.verdict`.

        The floor of a library whose plant is nonlinear is that of another plant, the one at rest, and is no measure.
        """
        target = self.told(iv, ig)
        free, recorded = (target.of_window(each) for each in (target.free_m_s2, target.recorded_m_s2))
        return verdict(
            self.figures(iv, ig),
            NAN if self.nonlinear else float(self.floor[iv, ig]),
            self._repeatability(iv, ig),
            levels(self.acceleration_m_s2[iv, ig] + free, recorded, self.dt_s),
            str(self.binding[iv, ig]),
            named=bool(self.axes.targets),
            least_input=(float(self.plant_input[iv, ig].min()), self.driven_by.unit),
        )

    @property
    def yardstick(self) -> Yardstick:
        """How its entries are compared with the recorded taps."""
        named = bool(self.axes.targets)
        grid = self.time_grid()
        return Yardstick(grid, grid.end_s if named else self.posing().intention_s, named)

    def figures(self, iv: int, ig: int) -> Figures:
        """How near an entry comes to the recorded tap, as the file says."""
        stored = (self.tap_error, self.felt_error, self.felt_dB, self.speed_change, self.bump_m_s2)
        after = (self.error_after, self.peak_after_m_s2)
        return Figures(*(float(array[iv, ig]) for array in (*stored, *after)))

    def _repeatability(self, iv: int, ig: int) -> float:
        """Trial-to-mean error of the recordings of an entry; NaN where there is one."""
        spread = self.meta["repeatability"][iv][ig]
        return NAN if spread is None else float(spread)

    def plot(self) -> "Figure":
        """Every waveform over time: acceleration beside its reference, current beside its limit.

        The figure is matplotlib's; `savefig` writes it to a file.
        """
        from transopt.report.transients import library_figure

        return library_figure(self)

    def scene(self) -> "Scene":
        """The scene that the library was solved from, as the file tells it.

        Raises
        ------
        InputError : a scene of another version, or changed by hand.
        """
        return self._scene

    @cached_property
    def _scene(self) -> "Scene":
        # A program that only names a library's type loads no pydantic.
        from transopt.library.own_scene import scene_in

        return scene_in(self.meta)

    def posing(self) -> Posing:
        """What the problems of all taps with these limits share; of a nonlinear plant as it is at rest."""
        return self._posing

    @cached_property
    def _posing(self) -> Posing:
        posing = posing_of(self.scene())
        if all(table["function"] is None for table in posing.asked.get(OwnLimit.key) or ()):
            return posing
        # Only a limit of the user's own that is not linear needs CasADi.
        from transopt.solvers.own import law

        return replace(posing, law_of=law)

    def time_grid(self) -> TimeGrid:
        """Ticks and switching instants, and how many samples after them count."""
        return self.posing().grid

    @property
    def driven_by(self) -> Input:
        """What drives the plant: a current, or a voltage."""
        return self.posing().driven_by

    def coil(self) -> CoilModel | None:
        """The motor's coil; None where nothing is known of it."""
        return self.posing().coil

    def wall(self) -> Wall | None:
        """The virtual wall; None without one."""
        return self.posing().wall

    def amplifier(self) -> Amplifier | None:
        """The amplifier; None for an ideal one, whose command is the plant's input."""
        return self.posing().amplifier

    def plant(self, ig: int) -> StateSpace:
        """The device of one grip, with the outputs that limits of a user's own look at."""
        by_grip = self.meta.get("outputs")  # not there where no limit looks at any
        A, B, C, D, Ce = (getattr(self, f"plant_{name}")[ig] for name in PLANT)
        outputs = _outputs(by_grip[ig] if by_grip else {})
        return StateSpace.from_matrices(A, B, C, D, Ce, outputs, self.driven_by)

    def stage(self, ig: int) -> StageModel:
        """Stage model of one grip, discretised anew from the plant in the file."""
        return self.posing().stage(self.plant(ig))

    def spread(self, ig: int) -> tuple[StageModel, ...]:
        """Further devices that the entries of one grip were designed for."""
        by_grip, found = self.meta.get("spread_outputs"), list[StageModel]()
        for j in range(self.spread_A.shape[1]):
            A, B, C, D, Ce = (getattr(self, f"spread_{name}")[ig, j] for name in PLANT)
            outputs = _outputs(by_grip[ig][j] if by_grip else {})
            plant = StateSpace.from_matrices(A, B, C, D, Ce, outputs, self.driven_by)
            found.append(self.posing().stage(plant))
        return tuple(found)

    def problem(self, iv: int, ig: int, stage: StageModel | None = None) -> TransientProblem:
        """The problem that entry (iv, ig) claims to solve; a wall pushes where the entry's own motion makes it.

        Of a nonlinear plant it is the problem of the plant as it is at rest, whose limits and objective
        `transopt.library.nonlinear.nonlinear_problem` puts on the nonlinear one.
        """
        wanted = self.wanted_of(iv, ig)
        wanted = replace(wanted, target=self.told(iv, ig).moved(self.correction_m_s2[iv, ig]))
        stage = self.stage(ig) if stage is None else stage
        problem = self.posing().problem(wanted, stage, self.spread(ig))
        problem = replace(
            problem,
            intensity=float(self.intensity[iv, ig]),
            heat_price=float(self.heat_price[iv, ig]),
            shares=self._shares(iv, ig),
        )
        problem = problem.within(self.parts(iv, ig))
        if problem.wall is None:
            return problem
        return pressing_under(problem, self.command[iv, ig])

    def parts(self, iv: int, ig: int) -> dict[str, int]:
        """Name of a limit on an output -> parts of a servo period at whose ends an entry has it.

        Raises
        ------
        InputError : a number of parts that no entry of the library has.
        """
        stated = self.instants_within[iv, ig].tolist()
        found = {kind.name: parts_of(within) for kind, within in zip(OF_OUTPUTS, stated, strict=True)}
        if max(found.values()) > most_parts(self.meta):
            raise InputError(f"instants_within = {max(stated):g}: more than meta.instants_within")
        return found

    def _shares(self, iv: int, ig: int) -> FloatArray | None:
        """(S,) shares of the devices in J, the own first; None where all have the same."""
        if not self.posing().worst:
            return None
        others = self.spread_share[iv, ig]
        return np.append(max(1.0 - others.sum(), 0.0), others)

    def lasting(self, iv: int, ig: int) -> tuple[FloatArray, FloatArray]:
        """(N + M,) y'' and i of an entry at the switching instants, as predicted through its window and after it."""
        if self.nonlinear:
            # Only a nonlinear plant needs this import, which takes the scene with all that reads one.
            from transopt.library.nonlinear import nonlinear_problem

            lasting = nonlinear_problem(self, iv, ig).effect(self.command[iv, ig]).lasting
            return lasting.acceleration_m_s2, lasting.plant_input
        problem = self.problem(iv, ig)
        return problem.stage.rollout(problem.continued(self.command[iv, ig]))

    def told(self, iv: int, ig: int) -> Target:
        """r - a_free of an entry, against which errors are told; a correction is none of it."""
        return self.wanted_of(iv, ig).target

    def wanted_of(self, iv: int, ig: int) -> Wanted:
        """What was recorded for an entry, and the nominal motion under it; a correction is none of it."""
        ends_s = float(self.target_ends_s[iv]) if self.axes.targets else np.inf
        known = self.meta["slow_part_known"][iv][ig]
        return self._wanted(float(self.speeds_m_s[iv]), lambda course: course[iv, ig], ends_s, known)

    def wanted(self, speed_m_s: float, grip_N: float) -> Wanted:
        """What a tap between the nodes asks for: the shape r / v linear in speed (`speed_weights`), and in grip."""
        by_grip = interpolation_weights(self.grips_N, grip_N)
        weights = np.outer(speed_weights(self.speeds_m_s, speed_m_s), by_grip)
        known = bool(np.all(np.array(self.meta["slow_part_known"])[weights > 0]))
        return self._wanted(speed_m_s, lambda course: np.tensordot(weights, course, 2), np.inf, known)

    def _wanted(self, speed_m_s: float, of: Callable[[FloatArray], FloatArray], ends_s: float, known: bool) -> Wanted:
        """What is wanted, `of` being what picks or blends a course (vg...) of the nodes."""
        free, before, after = of(self.free_m_s2), of(self.free_before_m_s2), of(self.free_after_m_s2)
        target = Target(
            of(self.recorded_m_s2) - free,
            of(self.recorded_after_m_s2) - after,
            of(self.recorded_before_m_s2) - before,
            free,
            after,
            before,
        )
        at_ticks = np.append(of(self.nominal_position_at_ticks_m), of(self.nominal_after_at_ticks_m))
        velocity, position = of(self.nominal_velocity_m_s), of(self.nominal_position_m)
        return Wanted(speed_m_s, target, velocity, position, at_ticks, ends_s, known)

    def multipliers(self, iv: int, ig: int) -> Multipliers:
        """Multipliers of one entry."""
        stages, pairs = self.command.shape[2], {}
        for row in dict.fromkeys(row_of(name) for name in self.multipliers_of):
            lower, upper = (self.multipliers_of.get(f"mu_{row}_{side}") for side in SIDES)
            if lower is not None or upper is not None:
                nothing = np.zeros(stages)
                pairs[row] = (
                    nothing if lower is None else lower[iv, ig],
                    nothing if upper is None else upper[iv, ig],
                )
        return Multipliers(stages, pairs, self.mu_end[iv, ig], self.current_sign[iv, ig])

    def at(self, speed_m_s: float, grip_N: float) -> Waveform:
        """Bilinear blend at any speed and grip; outside the grid the nearest edge is taken and reported.

        A convex combination of feasible currents is feasible, so every limit on the current holds between the nodes
        too; with a wall as far as the device's own feedback is the predicted one.
        Below `grip_min_N` the command is zero, since a free stylus would be thrown; a library of the free
        device (its only grip is 0) has no such bound. A stylus that does not come in (speed <= 0) taps nothing.

        Raises
        ------
        InputError : speed or grip is not a finite number.
        """
        return self.blend(self.located(speed_m_s, grip_N))

    def located(self, speed_m_s: float, grip_N: float) -> Place:
        """Locate a measured tap on the grid.

        Raises
        ------
        InputError : speed or grip is not a finite number.
        """
        if self.axes.targets:
            raise InputError(f"this library has no speeds but targets: ask for one of {', '.join(self.axes.targets)}")
        speed_m_s, grip_N = finite("speed", speed_m_s, "m/s"), finite("grip", grip_N, "N")
        speed = min(max(float(speed_m_s), float(self.speeds_m_s[0])), float(self.speeds_m_s[-1]))
        grip = min(max(float(grip_N), float(self.grips_N[0])), float(self.grips_N[-1]))
        silent = speed_m_s <= 0 or (self.grips_N[0] > 0 and grip_N < self.grip_min_N)
        return Place(speed, grip, speed != speed_m_s, grip != grip_N, bool(silent))

    def blend(self, place: Place) -> Waveform:
        """The nodes' commands at a place; zero where it is silent."""
        by_speed = interpolation_weights(self.speeds_m_s, place.speed_m_s)
        by_grip = interpolation_weights(self.grips_N, place.grip_N)
        command, transient = (
            np.tensordot(np.outer(by_speed, by_grip), waveforms, 2) * (0.0 if place.silent else 1.0)
            for waveforms in (self.command, self.transient_command)
        )
        return Waveform(**vars(place), command=command, transient_command=transient)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What stands in the file, by name: the arrays, `meta` as text, and the content's hash."""
        arrays = {name: self.array(name) for name in self.stored()}
        if self.cool is not None:
            arrays |= {COOL + name: self.cool.array(name) for name in self.cool.stored() if is_of_entries(name)}
        arrays["meta"] = np.array(json.dumps(self.meta, sort_keys=True))
        arrays[HASH_FIELD] = np.array(content_hash(arrays))
        return arrays

    def stored(self) -> list[str]:
        """Names of the arrays that its file has of it."""
        missing = absent(ARRAYS, stated(self.scene(), self.meta))
        named = [name for name in ARRAYS if name not in missing]
        return named + self.further

    @property
    def further(self) -> list[str]:
        """Names of its multipliers that not every library has."""
        return further_arrays(self.posing(), self.spread_A.shape[1], most_parts(self.meta))

    def array(self, name: str) -> NDArray[Any]:
        """One array by its name here; zeros for multipliers of a limit that is not in force."""
        if name.startswith("mu_") and name != "mu_end":
            found = self.multipliers_of.get(name)
            return np.zeros_like(self.command) if found is None else found
        return np.asarray(getattr(self, name))

    @property
    def content_sha256(self) -> str:
        return str(self.arrays()[HASH_FIELD])

    def save(self, path: str | Path) -> None:
        """Write the file whole or not at all.

        Raises
        ------
        InputError : the folder cannot be written.
        """
        arrays = self.arrays()
        with whole_file(Path(path)) as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def posing_of(scene: "Scene") -> Posing:
    """How the problems of a scene are posed; of a nonlinear plant those of the plant as it is at rest."""
    return scene.at_rest().posing()


def _outputs(stored: Mapping[str, Mapping[str, Any]]) -> dict[str, Output]:
    """Further outputs of a plant as `StateSpace.stored` writes them."""
    return {name: Output(**{**each, "row": np.array([each["row"]])}) for name, each in stored.items()}
