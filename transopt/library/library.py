"""A library: waveforms over (speed, grip) with all that is needed to check and to play them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.shown import cut, html_figure, html_table, wrapped
from transopt.base.writing import percent
from transopt.library.arrays import HASH_FIELD, absent, content_hash
from transopt.library.columns import COLUMNS, FIGURES, NAN, OF_DIRECTIONS, EntryTable, TableRow
from transopt.library.meta import most_parts, stated
from transopt.library.multipliers import ARRAYS, MULTIPLIERS, further_arrays, is_of_entries
from transopt.library.place import Place, Waveform, finite, interpolation_weights
from transopt.library.posed import Posed
from transopt.problem.answer import OBJECTIVE_SCALE, held_back, verdict
from transopt.problem.objective.bands import normal_levels
from transopt.problem.objective.figures import Figures

if TYPE_CHECKING:  # a device that plays a library loads neither matplotlib nor pydantic for it
    from matplotlib.figure import Figure


COOL = "cool_"  # prefix of the arrays of the cool commands in the file


@dataclass(frozen=True)
class Library(Posed):
    """A solved library, as `library.npz` holds it.

    Every array states its shape, unit and meaning beside its name (`transopt.library.held`), in the letters of
    `transopt.library.arrays.Array`. `meta` is the file's JSON: the scene, numbers derived from it, the recordings and
    the versions used. The problem of an entry is the scene's, with the plants and the targets of the file; nothing
    else states it.
    `multipliers_of` maps array names mu_<row>_<side> of the file to their arrays, one for each side of each limit's
    row; one that it does not have is zero. The list of limits determines the names (`MULTIPLIERS`).

    r is the recorded acceleration, a_free the acceleration of the stylus without a command. J compares y'', which the
    command adds, with the target r - a_free.

    In a library that was refined on its device (`meta["refinement"]`) `correction_m_s2` is added to the target, so
    that the real device, which differs from the model, reproduces r. The certificate is that of the corrected
    problem; `tap_error` and `floor` still compare the model with r, and `meta["refinement"]` states what the device
    measured.

    If the scene's plant is nonlinear, `plant_A` to `plant_Ce` are the plant at rest, and commands, predictions,
    errors and multipliers are those of the nonlinear plant (`transopt.library.nonlinear`). Such an entry is a
    stationary point and no proven optimum: its `lower_bound` is 0, because J is never negative. `floor` is that of
    the plant at rest.

    `cool` is the library of the cool commands, one per node with less heat (`grid.cool_share`); None if the scene
    asks for none. It shares all arrays that do not depend on a command; in the file its own arrays have the prefix
    `cool_`.
    """

    cool: "Library | None" = None

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]], meta: dict[str, Any]) -> "Library":
        """Make a library from all arrays by their names in the file; multipliers are named mu_<row>_<side>."""
        named = {name: array for name, array in arrays.items() if name in ARRAYS and name not in MULTIPLIERS}
        multipliers = {name: array for name, array in arrays.items() if name.startswith("mu_") and name not in named}
        return cls(**named, multipliers_of=multipliers, meta=meta, cool=None)

    def with_cool(self, arrays: Mapping[str, NDArray[Any]]) -> "Library":
        """This library with cool commands, from the per-entry arrays by their names without the prefix."""
        shared = {name: self.array(name) for name in ARRAYS if not is_of_entries(name)}
        meta = {**self.meta, "left_out": self.meta["cool"]["left_out"]}
        return replace(self, cool=Library.of({**shared, **arrays}, meta))

    def __repr__(self) -> str:
        stages, dt_s = self.command.shape[-1], self.dt_s
        errors = f"tap error {percent(self.tap_error.min())} to {percent(self.tap_error.max())} %"
        return wrapped(
            f"Library({cut(self.meta['scene']['name'])}: {self.axes.in_words}, {stages} commands of {1e3 * dt_s:g} "
            f"ms, limit {self.input_limit:g} {self.driven_by.unit}, {errors}"
            f"{'; nonlinear plant, stationary points' if self.nonlinear else ''})"
        )

    def _repr_html_(self) -> str:
        """Table and figure for a notebook."""
        shown = self.table((*FIGURES, "peak", "binding"))
        return html_table(repr(self), shown.heads, shown.cells) + html_figure(self.plot())

    def table(self, names: Sequence[str]) -> EntryTable:
        """All entries, speeds outermost, in columns of `transopt.library.columns.COLUMNS`."""
        nv, ng = self.command.shape[:2]
        rows = [self.row(iv, ig) for iv in range(nv) for ig in range(ng)]
        limits = (self.input_limit, self.steady_input)
        return EntryTable(self.axes.columns, names, rows, self.driven_by.unit, limits).known

    def row(self, iv: int, ig: int) -> TableRow:
        """The row of an entry in tables."""
        found: dict[str, Any] = {
            "linear": (self.tap_error_promised[iv, ig], self.tap_error_linear[iv, ig]),
            "repeats": self._repeatability(iv, ig),
            "gap": self.duality_gap[iv, ig] / max(self.objective[iv, ig], OBJECTIVE_SCALE),
            "held": "; ".join(self.held(iv, ig)),
            "verdict": self.verdict(iv, ig),
        }
        unknown = () if self.command.ndim > 3 else [COLUMNS[name].array for name in OF_DIRECTIONS]
        for name, column in COLUMNS.items():
            if (
                column.array
                and not (column.after and self.time_grid().after_stages == 0)
                and column.array not in unknown
            ):
                found[name] = getattr(self, column.array)[iv, ig]
        return TableRow(self.axes.cells(iv, ig), found)

    def held(self, iv: int, ig: int) -> list[str]:
        """The limits that hold an entry back, see `transopt.problem.answer.held_back`.

        For a nonlinear plant the optimum without limits is that of the plant at rest, so it is not used.
        """
        floor, unlimited = (float(array[iv, ig]) for array in (self.floor, self.unlimited_objective))
        if self.nonlinear:
            floor, unlimited = NAN, NAN
        tap_error, objective = float(self.tap_error[iv, ig]), float(self.objective[iv, ig])
        return held_back(tap_error, floor, objective, unlimited, str(self.binding[iv, ig]))

    def verdict(self, iv: int, ig: int) -> str:
        """How good an entry is, see `transopt.problem.answer.verdict`.

        For a nonlinear plant the floor is that of another plant, the plant at rest, so it is not used.
        """
        several = self.command.ndim > 3
        return verdict(
            self.figures(iv, ig),
            NAN if self.nonlinear else float(self.floor[iv, ig]),
            self._repeatability(iv, ig),
            normal_levels(self.uncorrected(iv, ig), self.acceleration_m_s2[iv, ig], self.dt_s),
            self.held(iv, ig),
            named=bool(self.axes.targets),
            # The sign of one motor's current does not say whether the surface pulls if there are several motors.
            least_input=None if several else (float(self.plant_input[iv, ig].min()), self.driven_by.unit),
        )

    def figures(self, iv: int, ig: int) -> Figures:
        """Distance of an entry from the recorded tap, as the file states it."""
        stored = (self.tap_error, self.felt_error, self.felt_dB, self.speed_change, self.bump_m_s2)
        after = (self.error_after, self.peak_after_m_s2)
        return Figures(*(float(array[iv, ig]) for array in (*stored, *after)))

    def _repeatability(self, iv: int, ig: int) -> float:
        """Trial-to-mean error of the recordings of an entry; NaN if there is only one recording."""
        spread = self.meta["repeatability"][iv][ig]
        return NAN if spread is None else float(spread)

    def plot(self) -> "Figure":
        """Every waveform over time: acceleration beside its reference, current beside its limit.

        It is a matplotlib figure; `savefig` writes it to a file.
        """
        from transopt.report.transients import library_figure

        return library_figure(self)

    def at(self, speed_m_s: float, grip_N: float, normal: float = 1.0, posture: float = 1.0) -> Waveform:
        """Linear blend at any speed and grip; outside the grid the nearest edge is used and reported.

        A convex combination of feasible currents is feasible, so every limit on the current holds between the nodes
        too; with a wall only as far as the device's actual feedback is the predicted one.
        For an arm it is also linear in the places along the lists of normals and postures: 1.5 lies half-way between
        the first and the second (`Arm.normal_along`, `Arm.posture_along`). All limits of an arm are boxes on each
        motor's current and command, equal at every node, so every blend is admissible there as well.
        Below `grip_min_N` the command is zero, since it would throw a free stylus; a library of the free device (its
        only grip is 0) has no such bound. At speed <= 0 the stylus does not approach, so the command is zero too.

        Raises
        ------
        InputError : speed, grip or place is not a finite number; a library of named targets has neither.
        """
        return self.blend(self.located(speed_m_s, grip_N, normal, posture))

    def located(self, speed_m_s: float, grip_N: float, normal: float = 1.0, posture: float = 1.0) -> Place:
        """Locate a measured tap on the grid, clamped to it.

        Raises
        ------
        InputError : speed, grip or place is not a finite number; a library of named targets has neither.
        """
        if self.axes.targets:
            raise InputError(f"this library has no speeds but targets: ask for one of {', '.join(self.axes.targets)}")
        speed_m_s, grip_N = finite("speed", speed_m_s, "m/s"), finite("grip", grip_N, "N")
        speed = min(max(float(speed_m_s), float(self.speeds_m_s[0])), float(self.speeds_m_s[-1]))
        grip = min(max(float(grip_N), float(self.grips_N[0])), float(self.grips_N[-1]))
        silent = speed_m_s <= 0 or (self.grips_N[0] > 0 and grip_N < self.grip_min_N)
        found = Place(speed, grip, speed != speed_m_s, grip != grip_N, bool(silent))
        asked = finite("normal", normal, ""), finite("posture", posture, "")
        if asked == (1.0, 1.0):
            return found
        _, *most = self.axes.sizes
        at = [min(max(each, 1.0), float(last)) for each, last in zip(asked, most, strict=True)]
        return replace(found, normal=at[0], posture=at[1], place_clamped=at != [*asked])

    def blend(self, place: Place) -> Waveform:
        """Interpolate the nodes' commands at a place; zero where the place is silent."""
        by_speed = interpolation_weights(self.speeds_m_s, place.speed_m_s)
        axes, by_device = self.axes, np.ones(1)
        numbered = [(np.arange(1.0, size + 1), at) for size, at in zip(axes.sizes[1:], place.at, strict=True)]
        for nodes, at in ((np.array([*axes.by_grip]), place.grip_N), *numbered):
            by_device = np.outer(by_device, interpolation_weights(nodes, at)).ravel()
        command, transient = (
            np.tensordot(np.outer(by_speed, by_device), waveforms, 2) * (0.0 if place.silent else 1.0)
            for waveforms in (self.command, self.transient_command)
        )
        return Waveform(**vars(place), command=command, transient_command=transient)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Content of the file by name: the arrays, `meta` as text, and the hash of the content."""
        arrays = {name: self.array(name) for name in self.stored()}
        if self.cool is not None:
            arrays |= {COOL + name: self.cool.array(name) for name in self.cool.stored() if is_of_entries(name)}
        arrays["meta"] = np.array(json.dumps(self.meta, sort_keys=True))
        arrays[HASH_FIELD] = np.array(content_hash(arrays))
        return arrays

    def stored(self) -> list[str]:
        """Names of the arrays that this library has in its file, `meta` and the hash excepted."""
        missing = absent(ARRAYS, stated(self.scene(), self.meta))
        named = [name for name in ARRAYS if name not in missing]
        return named + self.further

    @property
    def further(self) -> list[str]:
        """Names of its multiplier arrays that not every library has."""
        return further_arrays(self.posing(), self.spread_A.shape[1], most_parts(self.meta))

    def array(self, name: str) -> NDArray[Any]:
        """One array by its attribute name; zeros for the multipliers of a limit that the problem does not have."""
        if name.startswith("mu_") and name != "mu_end":
            found = self.multipliers_of.get(name)
            speeds, grips, *_, stages = self.command.shape  # motors stand before the stages
            return np.zeros((speeds, grips, stages)) if found is None else found
        return np.asarray(getattr(self, name))

    @property
    def content_sha256(self) -> str:
        return str(self.arrays()[HASH_FIELD])

    def save(self, path: str | Path) -> None:
        """Write the file whole or not at all.

        Raises
        ------
        InputError : the name does not end in .npz, or the folder cannot be written.
        """
        if Path(path).suffix.lower() != ".npz":
            other = "; transopt.export_library and export_drive write other formats" if Path(path).suffix else ""
            raise InputError(f"{path}: a library is an .npz file: name it {Path(path).with_suffix('.npz')}{other}")
        arrays = self.arrays()
        with whole_file(Path(path)) as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
