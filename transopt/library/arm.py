"""A library of an arm with several motors: commands over speed, grip, normal and posture, with all it takes to check.

All limits of an arm are boxes on each motor's current and command, the same at every node, and each amplifier is
linear. A convex combination of commands that keep them keeps them too, whichever nodes it is made of, so every blend
over speed, grip, normal and posture is admissible. What it does to the stylus is another question: the error between
nodes is looked at where the grid is chosen.
"""

import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.files import check_depth, read_file, whole_file
from transopt.base.npz import Archive
from transopt.base.shown import cut, wrapped
from transopt.base.signals import FloatArray
from transopt.base.sizes import MOST_COMMANDS, MOST_FILE_BYTES
from transopt.base.writing import percent
from transopt.library.arrays import HASH_FIELD, Array, content_hash
from transopt.library.place import finite, interpolation_weights
from transopt.plant.discretise import StageModel
from transopt.plant.state_space import StateSpace
from transopt.problem.answer import Multipliers
from transopt.problem.limits.limit import SIDES
from transopt.problem.objective.target import Target
from transopt.problem.posing import Posing, Wanted
from transopt.problem.problem import TransientProblem

if TYPE_CHECKING:
    from transopt.plant.arm import Arm
    from transopt.scene.scene import Scene

SCHEMA = "arm 1"
SAME = 1e-9  # of the largest: what rounding and another processor leave between the plant of a scene and a file's
ADVICE = "give a library.npz that `transopt solve` wrote for a scene of an arm"
NODE_UNITS = ("m/s", "N", "", "")
NODES = "vgoq"  # axes: speeds, grips, normals (o for orientation), postures
# Shape in letters as of `library.arrays.Array`, with o normals, q postures, m motors and p directions.
ARRAYS = {
    "speeds_m_s": Array("v", "m/s", "incoming speeds along the normal, rising"),
    "grips_N": Array("g", "N", "grip forces, rising"),
    "normals": Array("op", "", "normals of the surfaces in the frame of the base"),
    "postures_rad": Array("qp", "rad", "angles of the arm"),
    "command": Array(NODES + "mN", "A", "command of each motor, issued at -lead + k dt and held"),
    "plant_input": Array(NODES + "mN", "A", "current of each motor at the switching instants"),
    "acceleration_m_s2": Array(NODES + "pN", "m/s^2", "y'' of the stylus along normal and tangents, as predicted"),
    "target_before_m_s2": Array("vgpL", "m/s^2", "what J asks of y'' where no command can reach it"),
    "target_m_s2": Array("vgpN", "m/s^2", "what J asks of y'' at the switching instants"),
    "target_after_m_s2": Array("vgpM", "m/s^2", "what J asks of y'' after the last command"),
    "free_before_m_s2": Array("vgpL", "m/s^2", "a_free, how the stylus accelerates without commands"),
    "free_m_s2": Array("vgpN", "m/s^2", "a_free at the switching instants"),
    "free_after_m_s2": Array("vgpM", "m/s^2", "a_free after the last command"),
    "tap_error": Array(NODES, "", "error along the normal over the intention, after replay"),
    "tangential_error": Array(NODES, "", "acceleration across the normal over the intention, over |r|"),
    "direction_rad": Array(NODES, "rad", "angle by which the acceleration is off the normal, by its norms"),
    "felt_error": Array(NODES, "", "error along the normal in 120 to 620 Hz"),
    "felt_dB": Array(NODES, "dB", "energy in that band over that of r"),
    "floor": Array(NODES, "", "tap error of the optimum without limits"),
    "peak_input": Array(NODES, "A", "largest current of any motor in the replay"),
    "objective": Array(NODES, "", "J of the commands"),
    "duality_gap": Array(NODES, "", "bound on J - optimum"),
    "binding": Array(NODES, "", "the limits that bind, and when", is_text=True),
    "mu_end": Array(NODES + "mh", "1/A", "multipliers of the hand-over, of either sign"),
    "plant_A": Array("goqnn", "", "dx/dt = A x + B i of the arm at each grip, normal and posture"),
    "plant_B": Array("goqnm", "", "its B"),
    "plant_C": Array("goqpn", "", "y'' = C x + D i"),
    "plant_D": Array("goqpm", "", "its D"),
}
BROKEN = (TypeError, ValueError, KeyError, IndexError, AttributeError, ArithmeticError, RecursionError, MemoryError)


@dataclass(frozen=True)
class Blend:
    """Commands for a tap between the nodes.

    Attributes
    ----------
    command : (m, N) [A].
    clamped : what lay outside of the grid and was taken to its edge.
    """

    command: FloatArray
    clamped: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class ArmLibrary:
    """Proven commands of an arm, as its `library.npz` holds them.

    Attributes
    ----------
    arrays : by the names of `ARRAYS`, which states shape, unit and meaning.
    multipliers : mu_<row>_<side> -> (v, g, o, q, N) [1/A].
    meta : the file's JSON: schema, the scene, the recordings' names and the versions used.
    """

    arrays: Mapping[str, NDArray[Any]]
    multipliers: Mapping[str, FloatArray]
    meta: dict[str, Any]

    def __repr__(self) -> str:
        v, g, o, q, m, N = self.command.shape
        error = self.arrays["tap_error"]
        return wrapped(
            f"ArmLibrary({cut(self.meta['scene']['name'])}: {v} speeds, {g} grips, {o} normals, {q} postures, "
            f"{N} commands of {m} motors, tap error {percent(error.min())} to {percent(error.max())} %)"
        )

    @property
    def command(self) -> FloatArray:
        """(v, g, o, q, m, N) [A]."""
        return self.arrays["command"]

    @property
    def nodes(self) -> list[tuple[int, int, int, int]]:
        """Indices of every entry: speed, grip, normal, posture."""
        return [*np.ndindex(*self.command.shape[:4])]

    def place(self, node: tuple[int, int, int, int]) -> str:
        """Which entry it is, in a sentence."""
        iv, ig, io, iq = node
        speed, grip = self.arrays["speeds_m_s"][iv], self.arrays["grips_N"][ig]
        return f"{speed:g} m/s, {grip:g} N, normal {io + 1}, posture {iq + 1}"

    def scene(self) -> "Scene":
        """The scene that the library was solved from.

        Raises
        ------
        InputError : a scene of another version, or changed by hand.
        """
        from transopt.library.posed import scene_in

        return scene_in(self.meta)

    @cached_property
    def posing(self) -> Posing:
        """What the problems of all its entries share."""
        return self.scene().arm_posing()

    @cached_property
    def _stages(self) -> dict[tuple[int, ...], StageModel]:
        return {}

    def stage(self, ig: int, io: int, iq: int) -> StageModel:
        """Stage model of a grip, normal and posture, discretised anew from the plant in the file."""
        at = ig, io, iq
        if at not in self._stages:
            A, B, C, D = (self.arrays[f"plant_{name}"][at] for name in "ABCD")
            self._stages[at] = self.posing.stage(StateSpace(A, B, C, D))
        return self._stages[at]

    def problem(self, node: tuple[int, int, int, int]) -> TransientProblem:
        """The problem that an entry claims to solve."""
        iv, ig, io, iq = node
        names = [f"{kind}{part}_m_s2" for kind in ("target", "free") for part in ("", "_after", "_before")]
        target = Target(*(self.arrays[name][iv, ig] for name in names))
        grid, speed = self.posing.grid, float(self.arrays["speeds_m_s"][iv])
        # Nothing of an arm looks at the nominal motion.
        still, ticks = np.zeros(grid.stages), np.zeros(grid.stages + grid.after_stages)
        known = bool(self.meta["slow_part_known"][iv][ig])
        wanted = Wanted(speed, target, still, still, ticks, slow_part_known=known)
        return self.posing.problem(wanted, self.stage(ig, io, iq))

    def multipliers_at(self, node: tuple[int, int, int, int]) -> Multipliers:
        """Multipliers of an entry."""
        lower, upper = ({row: f"mu_{row}_{side}" for row in self._rows} for side in SIDES)
        pairs = {row: (self.multipliers[lower[row]][node], self.multipliers[upper[row]][node]) for row in self._rows}
        stages = self.command.shape[-1]
        return Multipliers(stages, pairs, self.arrays["mu_end"][node], np.zeros(stages))

    @cached_property
    def _rows(self) -> list[str]:
        """Names of the limits' rows."""
        return [row.name for _, row in self.problem((0, 0, 0, 0)).rows()]

    def blended(self, speed_m_s: float, grip_N: float, normal: float = 0.0, posture: float = 0.0) -> Blend:
        """Blend the commands of the nodes around a tap; every blend keeps the limits.

        Parameters
        ----------
        normal, posture : places along the lists of the scene, from 0: 0.5 lies half-way between the first and the
            second. `normal_along` and `posture_along` find them.

        Raises
        ------
        InputError : what is no number.
        """
        found, clamped = self.command, []
        numbered = (np.arange(n, dtype=float) for n in self.command.shape[2:4])
        axes = [self.arrays["speeds_m_s"], self.arrays["grips_N"], *numbered]
        names, values, units = (
            ("speed", "grip", "normal", "posture"),
            (speed_m_s, grip_N, normal, posture),
            NODE_UNITS,
        )
        for name, value, unit, nodes in zip(names, values, units, axes, strict=True):
            wanted = finite(name, value, unit)
            kept = float(np.clip(wanted, nodes[0], nodes[-1]))
            if kept != wanted:
                clamped.append(name)
            found = np.tensordot(interpolation_weights(nodes, kept), found, axes=1)
        return Blend(found, tuple(clamped))

    def normal_along(self, normal: FloatArray) -> float:
        """Place along the list of normals that is nearest to a direction (3,)."""
        direction = np.asarray(normal, dtype=float)
        return _along(self.arrays["normals"], direction / np.linalg.norm(direction))

    def posture_along(self, posture_rad: FloatArray) -> float:
        """Place along the list of postures that is nearest to the angles (3,) [rad]."""
        return _along(self.arrays["postures_rad"], np.asarray(posture_rad, dtype=float))

    def save(self, path: str | Path) -> None:
        """Write the file whole or not at all.

        Raises
        ------
        InputError : the folder cannot be written.
        """
        arrays = {**self.arrays, **self.multipliers, "meta": np.array(json.dumps(self.meta))}
        arrays[HASH_FIELD] = np.array(content_hash(arrays))
        with whole_file(Path(path)) as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def _along(nodes: FloatArray, wanted: FloatArray) -> float:
    """Place on the line through nodes (k, 3), in nodes from 0, that is nearest to a point (3,)."""
    best, found = np.inf, 0.0
    for j, (start, end) in enumerate(itertools.pairwise(nodes)):
        way = end - start
        share = float(np.clip((wanted - start) @ way / (way @ way), 0.0, 1.0))
        off = float(np.linalg.norm(start + share * way - wanted))
        if off < best:
            best, found = off, j + share
    return found


def _read(path: Path) -> dict[str, NDArray[Any]]:
    data = read_file(path, MOST_FILE_BYTES, ADVICE)
    try:
        archive = Archive(data)
        return {name: archive[name] for name in archive}
    except Exception:  # zipfile, zlib, struct, the parser of heads: any broken archive ends here
        raise InputError(f"{path}: damaged or not an .npz file; {ADVICE}") from None


def is_arm_library(path: str | Path) -> bool:
    """Whether a file is a library of an arm, by its schema alone; False for one that cannot be read."""
    try:
        archive = Archive(read_file(Path(path), MOST_FILE_BYTES, ADVICE))
        return bool(json.loads(str(archive["meta"]))["schema"] == SCHEMA)
    except Exception:  # whatever is broken is said by who reads all of it
        return False


def _meta(path: Path, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    try:
        meta = json.loads(str(arrays["meta"]))
        check_depth(meta)
    except (ValueError, KeyError, RecursionError):
        raise InputError(f"{path}: meta is missing or not JSON; {ADVICE}") from None
    if not isinstance(meta, dict) or meta.get("schema") != SCHEMA:
        raise InputError(f"{path}: no library of an arm; {ADVICE}")
    return meta


def load_arm_library(path: str | Path) -> ArmLibrary:
    """Read a library of an arm and check it whole before anything is used.

    Raises
    ------
    InputError : missing, damaged, foreign, changed since it was written, an array missing or misshapen.
    """
    path = Path(path)
    arrays = _read(path)
    meta = _meta(path, arrays)
    stated = str(arrays.pop(HASH_FIELD, ""))
    if stated != content_hash(arrays):
        raise InputError(f"{path}: content does not match its hash: changed or damaged; solve the scene again")
    arrays.pop("meta")
    multipliers = {name: arrays.pop(name) for name in [*arrays] if name.startswith("mu_") and name not in ARRAYS}
    try:
        library = ArmLibrary(arrays, multipliers, meta)
        _check(path, library)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(f"{path}: ") else f"{path}: {error}") from None
    except BROKEN:
        raise InputError(f"{path}: does not describe a problem; solve the scene again") from None
    return library


def _check_places(path: Path, library: ArmLibrary, arm: "Arm") -> None:
    """Refuse nodes, and plants at them, that are not those of the scene."""
    grid, (o, q) = library.scene().grid, library.command.shape[2:4]
    places = [[arm.place(iq, io) for iq in range(q)] for io in range(o)]
    plants = [[[arm.plant_at(grip, each) for each in row] for row in places] for grip in grid.grips_N]
    stated = {
        "speeds_m_s": grid.speeds_m_s,
        "grips_N": grid.grips_N,
        "normals": [row[0].normal for row in places],
        "postures_rad": [each.posture_rad for each in places[0]],
        **{f"plant_{name}": [[[getattr(p, name) for p in row] for row in by] for by in plants] for name in "ABCD"},
    }
    for name, wanted in stated.items():
        expected, found = np.array(wanted), library.arrays[name]
        if found.shape != expected.shape or np.abs(found - expected).max() > SAME * np.abs(expected).max():
            raise InputError(f"{path}: {name} is not that of the scene in meta; solve the scene again")


def _check(path: Path, library: ArmLibrary) -> None:
    sizes: dict[str, int] = {}
    for name, declared in ARRAYS.items():
        if name not in library.arrays:
            raise InputError(f"{path}: array {name} is missing; solve the scene again")
        array = library.arrays[name]
        expected = tuple(sizes.setdefault(each, size) for each, size in zip(declared.shape, array.shape, strict=True))
        if array.shape != expected or not declared.fits(array.dtype):
            raise InputError(f"{path}: {name} has shape {array.shape} of {array.dtype}, expected {expected}")
        if not declared.is_text and not np.all(np.isfinite(array)):
            raise InputError(f"{path}: {name} holds a number that is not finite; solve the scene again")
    if library.command.size > MOST_COMMANDS:
        raise InputError(f"{path}: {library.command.size} commands, at most {MOST_COMMANDS}; solve a smaller scene")
    posing, arm = library.posing, library.scene().arm()
    grid = posing.grid
    places, times = (len(arm.normals), len(arm.postures_deg)), (grid.stages, grid.after_stages)
    if tuple(sizes[letter] for letter in "oqNMh") != (*places, *times, posing.hand_over_samples):
        raise InputError(f"{path}: the arrays do not go with the scene in meta; solve the scene again")
    _check_places(path, library, arm)
    for name, array in library.multipliers.items():
        if array.shape != (*library.command.shape[:4], grid.stages) or not np.all(np.isfinite(array)):
            raise InputError(f"{path}: {name} is no finite array of the grid's shape; solve the scene again")
    rows = {f"mu_{row.name}_{side}" for _, row in library.problem((0, 0, 0, 0)).rows() for side in SIDES}
    if rows != set(library.multipliers):
        raise InputError(f"{path}: multipliers of other limits than the scene's; solve the scene again")
