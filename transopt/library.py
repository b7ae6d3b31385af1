"""The library file: waveforms over (speed, grip) with all it takes to check them (DESIGN 6)."""

import hashlib
import json
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.amplifier import Amplifier
from transopt.discretise import StageModel, TimeGrid, discretise
from transopt.errors import InputError
from transopt.files import whole_file
from transopt.models import StateSpace
from transopt.problem import Limits, Multipliers, TransientProblem
from transopt.signals import FloatArray
from transopt.thermal import CoilModel

SCHEMA = 1
HASH_FIELD = "content_sha256"
MULTIPLIER_FIELDS = {
    "current_lower": "mu_current_lower",
    "current_upper": "mu_current_upper",
    "command_lower": "mu_command_lower",
    "command_upper": "mu_command_upper",
    "slew_lower": "mu_slew_lower",
    "slew_upper": "mu_slew_upper",
    "hand_over": "mu_end",
}
# Shape of each array in the sizes v (speeds), g (grips), N (stages), h (hand-over), n (plant states). The two
# baselines stand for the transient and the steady limit.
SHAPES = {
    "speeds_m_s": "v",
    "grips_N": "g",
    "command_A": "vgN",
    "transient_command_A": "vgN",
    "current_A": "vgN",
    "acceleration_m_s2": "vgN",
    "reference_m_s2": "vN",
    "reference_raw_m_s2": "vN",
    "nominal_position_m": "vN",
    "nrmse": "vg",
    "floor": "vg",
    "nrmse_seed": "vg2",
    "nrmse_clipped": "vg2",
    "peak_current_A": "vg",
    "peak_temperature_C": "vg",
    "objective": "vg",
    "primal_violation": "vg",
    "dual_residual": "vg",
    "duality_gap": "vg",
    "solve_time_s": "vg",
    "status": "vg",
    "binding": "vg",
    "mu_current_lower": "vgN",
    "mu_current_upper": "vgN",
    "mu_command_lower": "vgN",
    "mu_command_upper": "vgN",
    "mu_slew_lower": "vgN",
    "mu_slew_upper": "vgN",
    "mu_end": "vgh",
    "plant_A": "gnn",
    "plant_B": "gn1",
    "plant_C": "g1n",
    "plant_D": "g11",
    "plant_Ce": "g1n",
}
TEXTS = ("status", "binding")
MAY_BE_NAN = ("peak_temperature_C",)  # unknown where the drive is stated at the tip
# Pairs of multipliers stand in the file only where their limit is in force.
OPTIONAL = ("mu_slew_lower", "mu_slew_upper")
META_KEYS = {
    "dt_s": (),
    "lead_s": (),
    "grip_min_N": (),
    "amplifier": ("pole_Hz", "delay_s", "command_limit_A"),
    "limits": ("current_A", "steady_current_A", "slew_A_per_s", "supply_V", "temperature_C"),
    "thermal": ("R_ohm", "limit_C"),
    "feedback": (),
    "weights": ("rho", "tracking"),
    "hand_over_samples": (),
    "left_out": (),
    "repeatability": (),
    "scene": ("name", "description"),
    "sources": (),
    "versions": (),
}


@dataclass(frozen=True)
class Waveform:
    """A blended command between nodes.

    Attributes
    ----------
    command_A : (N,) total command c_k, issued at -lead + k dt and held [A].
    speed_m_s, grip_N : where it was blended, after clamping to the grid.
    speed_clamped, grip_clamped : whether the wanted point lay outside the grid.
    silent : no transient is played, for want of speed or grip; the command is zero.
    """

    command_A: FloatArray
    speed_m_s: float
    grip_N: float
    speed_clamped: bool
    grip_clamped: bool
    silent: bool


def _weights(nodes: FloatArray, value: float) -> FloatArray:
    """(n,) weights of linear interpolation at `value`, which lies inside the nodes."""
    return np.array([np.interp(value, nodes, unit) for unit in np.eye(nodes.size)])


@dataclass(frozen=True)
class Library:
    """A solved library; arrays as in DESIGN 6, `meta` as its JSON."""

    speeds_m_s: FloatArray
    grips_N: FloatArray
    command_A: FloatArray
    transient_command_A: FloatArray
    current_A: FloatArray
    acceleration_m_s2: FloatArray
    reference_m_s2: FloatArray
    reference_raw_m_s2: FloatArray
    nominal_position_m: FloatArray
    nrmse: FloatArray
    floor: FloatArray
    nrmse_seed: FloatArray
    nrmse_clipped: FloatArray
    peak_current_A: FloatArray
    peak_temperature_C: FloatArray
    objective: FloatArray
    primal_violation: FloatArray
    dual_residual: FloatArray
    duality_gap: FloatArray
    solve_time_s: FloatArray
    status: NDArray[np.str_]
    binding: NDArray[np.str_]
    mu_current_lower: FloatArray
    mu_current_upper: FloatArray
    mu_command_lower: FloatArray
    mu_command_upper: FloatArray
    mu_slew_lower: FloatArray
    mu_slew_upper: FloatArray
    mu_end: FloatArray
    plant_A: FloatArray
    plant_B: FloatArray
    plant_C: FloatArray
    plant_D: FloatArray
    plant_Ce: FloatArray
    meta: dict[str, Any]

    def time_grid(self) -> TimeGrid:
        amplifier = self.meta["amplifier"]
        delay = 0.0 if amplifier is None else amplifier["delay_s"]
        return TimeGrid(self.meta["dt_s"], self.command_A.shape[2], self.meta["lead_s"], delay)

    def coil(self) -> CoilModel | None:
        return None if self.meta["thermal"] is None else CoilModel(**self.meta["thermal"])

    def stage(self, ig: int) -> StageModel:
        """Stage model of one grip, discretised anew from the plant in the file."""
        matrices = (self.plant_A, self.plant_B, self.plant_C, self.plant_D, self.plant_Ce)
        amplifier = self.meta["amplifier"]
        return discretise(
            StateSpace(*(m[ig] for m in matrices)),
            None if amplifier is None else Amplifier(**amplifier),
            self.meta["dt_s"],
        )

    def problem(self, iv: int, ig: int, stage: StageModel | None = None) -> TransientProblem:
        """The problem that entry (iv, ig) claims to solve."""
        meta = self.meta
        return TransientProblem(
            stage=self.stage(ig) if stage is None else stage,
            grid=self.time_grid(),
            reference_m_s2=self.reference_m_s2[iv],
            tracking_weights=np.asarray(meta["weights"]["tracking"], dtype=float),
            rho=meta["weights"]["rho"],
            limits=Limits(
                current_A=meta["limits"]["current_A"],
                command_A=None if meta["amplifier"] is None else meta["amplifier"]["command_limit_A"],
                slew_A_per_s=meta["limits"]["slew_A_per_s"],
            ),
            hand_over_samples=meta["hand_over_samples"],
        )

    def multipliers(self, iv: int, ig: int) -> Multipliers:
        return Multipliers(**{name: getattr(self, field)[iv, ig] for name, field in MULTIPLIER_FIELDS.items()})

    def at(self, speed_m_s: float, grip_N: float) -> Waveform:
        """Bilinear blend at any speed and grip; outside the grid the nearest edge is taken and reported.

        A convex combination of feasible currents is feasible, so every limit holds between the nodes too.
        Below `grip_min_N` the command is zero, since a free stylus would be thrown; a library of the free
        device (its only grip is 0) has no such bound. A stylus that does not come in (speed <= 0) taps nothing.

        Raises
        ------
        InputError : speed or grip is not a finite number.
        """
        if not (np.isfinite(speed_m_s) and np.isfinite(grip_N)):
            raise InputError(f"speed {speed_m_s} m/s, grip {grip_N} N: both must be finite numbers")
        speed = float(np.clip(speed_m_s, self.speeds_m_s[0], self.speeds_m_s[-1]))
        grip = float(np.clip(grip_N, self.grips_N[0], self.grips_N[-1]))
        by_speed, by_grip = _weights(self.speeds_m_s, speed), _weights(self.grips_N, grip)
        silent = speed_m_s <= 0 or (self.grips_N[0] > 0 and grip_N < self.meta["grip_min_N"])
        command = np.einsum("v,g,vgk->k", by_speed, by_grip, self.command_A) * (0.0 if silent else 1.0)
        return Waveform(command, speed, grip, speed != speed_m_s, grip != grip_N, silent)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What stands in the file, by name: the arrays, `meta` as text, and the content's hash."""
        arrays = {name: np.asarray(getattr(self, name)) for name in SHAPES}
        if self.meta["limits"]["slew_A_per_s"] is None:
            for name in OPTIONAL:
                del arrays[name]
        arrays["meta"] = np.array(json.dumps(self.meta, sort_keys=True))
        arrays[HASH_FIELD] = np.array(_content_hash(arrays))
        return arrays

    @property
    def content_sha256(self) -> str:
        return str(self.arrays()[HASH_FIELD])

    def save(self, path: Path) -> None:
        """Write the file whole or not at all.

        Raises
        ------
        InputError : the folder cannot be written.
        """
        arrays = self.arrays()
        with whole_file(path) as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def _content_hash(arrays: dict[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    advice = "give a library.npz written by `transopt solve`"
    try:
        with path.open("rb") as stream:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise InputError(f"{path}: a single array, not a library; {advice}")
            return {name: archive[name] for name in archive.files}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {advice}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: a folder, not a file; {advice}") from None
    except PermissionError:
        raise InputError(f"{path}: no permission to read it; {advice}") from None
    except ValueError as error:
        reason = "holds pickled objects, which are never loaded" if "pickle" in str(error).lower() else str(error)
        raise InputError(f"{path}: {reason}; {advice}") from None
    except (OSError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise InputError(f"{path}: damaged or not an .npz file ({error}); {advice}") from None
    except Exception as error:  # zlib.error and NotImplementedError among them: any broken archive ends here
        raise InputError(f"{path}: damaged archive ({error}); {advice}") from None


def _check_meta(path: Path, text: NDArray[Any]) -> dict[str, Any]:
    try:
        meta = json.loads(str(text))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: meta is not JSON ({error}); solve the scene again") from None
    if not isinstance(meta, dict) or meta.get("schema") != SCHEMA:
        found = meta.get("schema") if isinstance(meta, dict) else None
        raise InputError(f"{path}: schema {found}, this version reads {SCHEMA}; solve the scene again")
    missing = [key for key in META_KEYS if key not in meta]
    for key, inner in META_KEYS.items():
        # null: the scene has no such part; anything else holds the keys that are read from it.
        table = meta.get(key)
        if inner and table is not None:
            missing += [f"{key}.{name}" for name in inner if not isinstance(table, dict) or name not in table]
    if missing:
        raise InputError(f"{path}: meta lacks {', '.join(missing)}; solve the scene again")
    return meta


def _check_shapes(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    sizes = {"1": 1, "2": 2}
    for name, letters in SHAPES.items():
        array = arrays[name]
        if array.ndim != len(letters):
            raise InputError(f"{path}: {name} has {array.ndim} dimensions, expected {len(letters)}; solve it again")
        expected = tuple(sizes.setdefault(letter, size) for letter, size in zip(letters, array.shape, strict=True))
        if array.shape != expected:
            raise InputError(f"{path}: {name} has shape {array.shape}, expected {expected}; solve it again")
        kind = "U" if name in TEXTS else "f"
        if array.dtype.kind != kind:
            raise InputError(f"{path}: {name} has type {array.dtype}, expected {'text' if kind == 'U' else 'float'}")
        if kind == "f" and name not in MAY_BE_NAN and not np.all(np.isfinite(array)):
            raise InputError(f"{path}: {name} holds a number that is not finite; solve the scene again")
    for name in ("speeds_m_s", "grips_N"):
        if arrays[name].size == 0 or np.any(np.diff(arrays[name]) <= 0):
            raise InputError(f"{path}: {name} is empty or not strictly increasing; solve the scene again")


def load_library(path: Path) -> Library:
    """Read a library file and check it whole before anything is used.

    Raises
    ------
    InputError : missing, damaged, foreign, pickled, changed since it was written, an array missing or misshapen.
    """
    arrays = _read_arrays(path)
    for name in ("meta", HASH_FIELD):
        if name not in arrays:
            raise InputError(f"{path}: no array {name}: not a library of this project; solve the scene again")
    meta = _check_meta(path, arrays["meta"])
    slew = meta["limits"]["slew_A_per_s"]
    absent = [name for name in SHAPES if name not in arrays and not (name in OPTIONAL and slew is None)]
    if absent:
        raise InputError(f"{path}: array {absent[0]} is missing; solve the scene again")
    stored = str(arrays.pop(HASH_FIELD))
    if stored != _content_hash(arrays):
        raise InputError(f"{path}: content does not match its hash: changed or damaged; solve the scene again")
    for name in OPTIONAL:
        arrays.setdefault(name, np.zeros_like(arrays["mu_current_lower"]))
    _check_shapes(path, arrays)
    known = {field.name for field in fields(Library)}
    library = Library(**{k: v for k, v in arrays.items() if k in known and k != "meta"}, meta=meta)
    _check_problem(path, library)
    return library


def _check_problem(path: Path, library: Library) -> None:
    """The numbers of `meta` must make a time grid, a coil and a problem; only the first entry's is tried."""
    advice = "solve the scene again"
    if library.meta["feedback"] is not None:
        raise InputError(f"{path}: meta.feedback: this version plays libraries without a wall only; {advice}")
    if not (library.speeds_m_s[0] > 0 and library.grips_N[0] >= 0):
        raise InputError(f"{path}: speeds_m_s must be > 0 and grips_N >= 0; {advice}")
    try:
        grid = library.time_grid()
        sound = 0 < grid.dt_s < np.inf and 0 <= grid.lead_s < np.inf and 0 <= grid.delay_s < np.inf
        library.coil()
        library.problem(0, 0)
    except (InputError, TypeError, ValueError, ArithmeticError) as error:
        raise InputError(f"{path}: meta does not describe a problem ({error}); {advice}") from None
    if not sound:
        raise InputError(f"{path}: meta: dt_s must be > 0, lead_s and delay_s >= 0, all finite; {advice}")
