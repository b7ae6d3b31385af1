"""The library file: waveforms over (speed, grip) with all it takes to check them (DESIGN 6)."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.chain import StateSpace
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import StageModel, TimeGrid, discretise
from transopt.plant.wall import Wall
from transopt.problem.leave_out import pressing
from transopt.problem.posing import Posing, Wanted
from transopt.problem.problem import Multipliers, TransientProblem

SCHEMA = 1
HASH_FIELD = "content_sha256"
MULTIPLIER_FIELDS = {
    "current_lower": "mu_current_lower",
    "current_upper": "mu_current_upper",
    "command_lower": "mu_command_lower",
    "command_upper": "mu_command_upper",
    "slew_lower": "mu_slew_lower",
    "slew_upper": "mu_slew_upper",
    "supply_before_lower": "mu_supply_before_lower",
    "supply_before_upper": "mu_supply_before_upper",
    "supply_after_lower": "mu_supply_after_lower",
    "supply_after_upper": "mu_supply_after_upper",
    "temperature_upper": "mu_temperature_upper",
    "current_sign": "current_sign",
    "hand_over": "mu_end",
}
# Shape of each array in the sizes v (speeds), g (grips), N (stages), h (hand-over), n (plant states), s (further
# devices of a robust entry). The two baselines stand for the transient and the steady limit.
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
    "nominal_velocity_m_s": "vN",
    "nominal_position_at_ticks_m": "vN",
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
    "lower_bound": "vg",
    "solve_time_s": "vg",
    "status": "vg",
    "binding": "vg",
    "mu_current_lower": "vgN",
    "mu_current_upper": "vgN",
    "mu_command_lower": "vgN",
    "mu_command_upper": "vgN",
    "mu_slew_lower": "vgN",
    "mu_slew_upper": "vgN",
    "mu_supply_before_lower": "vgN",
    "mu_supply_before_upper": "vgN",
    "mu_supply_after_lower": "vgN",
    "mu_supply_after_upper": "vgN",
    "mu_temperature_upper": "vgN",
    "current_sign": "vgN",
    "mu_end": "vgh",
    "plant_A": "gnn",
    "plant_B": "gn1",
    "plant_C": "g1n",
    "plant_D": "g11",
    "plant_Ce": "g1n",
    "correction_m_s2": "vgN",
    "spread_A": "gsnn",
    "spread_B": "gsn1",
    "spread_C": "gs1n",
    "spread_D": "gs11",
    "spread_Ce": "gs1n",
}
PLANT = ("A", "B", "C", "D", "Ce")
TEXTS = ("status", "binding")
MAY_BE_NAN = ("peak_temperature_C",)  # unknown where the drive is stated at the tip
# Multipliers stand in the file only where their limit is in force, further devices where there are any, and
# corrections only where a device's own taps have been learnt from.
OPTIONAL = {
    "slew_A_per_s": ("mu_slew_lower", "mu_slew_upper"),
    "supply_V": tuple(f"mu_supply_{side}" for side in ("before_lower", "before_upper", "after_lower", "after_upper")),
    "temperature_C": ("mu_temperature_upper", "current_sign"),
    "spread": tuple(f"spread_{matrix}" for matrix in PLANT),
    "refinement": ("correction_m_s2",),
}
META_KEYS = {
    "dt_s": (),
    "lead_s": (),
    "grip_min_N": (),
    "amplifier": ("pole_Hz", "delay_s", "command_limit_A"),
    "limits": ("current_A", "steady_current_A", "slew_A_per_s", "supply_V", "temperature_C"),
    "thermal": ("coil", "budget"),
    "circuit": ("R_ohm", "L_H", "emf_V_s_m"),
    "feedback": (
        "stiffness_N_m",
        "damping_N_s_m",
        "force_per_current_N_A",
        "latency_ticks",
        "derivative_filter_Hz",
    ),
    "weights": ("rho", "tracking", "error_filter", "spread"),
    "hand_over_samples": (),
    "left_out": (),
    "repeatability": (),
    "scene": ("name", "description"),
    "sources": (),
    "versions": (),
}


@dataclass(frozen=True)
class Place:
    """Where a measured tap lies on the grid of speeds and grips.

    Attributes
    ----------
    speed_m_s, grip_N : after clamping to the grid.
    speed_clamped, grip_clamped : whether the wanted point lay outside the grid.
    silent : no transient is played, for want of speed or grip.
    """

    speed_m_s: float
    grip_N: float
    speed_clamped: bool
    grip_clamped: bool
    silent: bool


@dataclass(frozen=True)
class Waveform(Place):
    """A command for a place: zero where it is silent, else a blend of the nodes' or what was solved for it.

    Attributes
    ----------
    command_A : (N,) total command c_k, issued at -lead + k dt and held [A].
    transient_command_A : (N,) what a device with the library's wall plays on top of its feedback [A].
    """

    command_A: FloatArray
    transient_command_A: FloatArray


def interpolation_weights(nodes: FloatArray, value: float) -> FloatArray:
    """(n,) weights of linear interpolation at `value`, which lies inside the nodes."""
    weights, after = np.zeros(nodes.size), int(np.searchsorted(nodes, value))
    share = 1.0 if after == 0 else (value - nodes[after - 1]) / (nodes[after] - nodes[after - 1])
    weights[after - 1], weights[after] = 1 - share, share
    return weights


def speed_weights(nodes_m_s: FloatArray, speed_m_s: float) -> FloatArray:
    """(nv,) weights by which references of the nodes make that of a speed on the grid (`reference.between`).

    r = v ((1 - w) r_1 / v_1 + w r_2 / v_2): the shape r / v is linear in speed.
    """
    return np.asarray(speed_m_s * interpolation_weights(nodes_m_s, speed_m_s) / nodes_m_s)


@dataclass(frozen=True)
class Library:
    """A solved library; arrays as in DESIGN 6, `meta` as its JSON.

    In a library that was refined on its device (`meta["refinement"]`) an entry is solved for r + `correction_m_s2`,
    so that the device, which is not quite the model, makes r. All of its certificate is of that problem; `nrmse` and
    `floor` stay the model's view of r, and what the device really did stands in `meta["refinement"]`.
    """

    speeds_m_s: FloatArray
    grips_N: FloatArray
    command_A: FloatArray
    transient_command_A: FloatArray
    current_A: FloatArray
    acceleration_m_s2: FloatArray
    reference_m_s2: FloatArray
    reference_raw_m_s2: FloatArray
    nominal_position_m: FloatArray
    nominal_velocity_m_s: FloatArray
    nominal_position_at_ticks_m: FloatArray
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
    lower_bound: FloatArray
    solve_time_s: FloatArray
    status: NDArray[np.str_]
    binding: NDArray[np.str_]
    mu_current_lower: FloatArray
    mu_current_upper: FloatArray
    mu_command_lower: FloatArray
    mu_command_upper: FloatArray
    mu_slew_lower: FloatArray
    mu_slew_upper: FloatArray
    mu_supply_before_lower: FloatArray
    mu_supply_before_upper: FloatArray
    mu_supply_after_lower: FloatArray
    mu_supply_after_upper: FloatArray
    mu_temperature_upper: FloatArray
    current_sign: FloatArray
    mu_end: FloatArray
    correction_m_s2: FloatArray
    plant_A: FloatArray
    plant_B: FloatArray
    plant_C: FloatArray
    plant_D: FloatArray
    plant_Ce: FloatArray
    spread_A: FloatArray
    spread_B: FloatArray
    spread_C: FloatArray
    spread_D: FloatArray
    spread_Ce: FloatArray
    meta: dict[str, Any]

    def time_grid(self) -> TimeGrid:
        amplifier = self.meta["amplifier"]
        delay = 0.0 if amplifier is None else amplifier["delay_s"]
        return TimeGrid(self.meta["dt_s"], self.command_A.shape[2], self.meta["lead_s"], delay)

    def coil(self) -> CoilModel | None:
        return None if self.meta["thermal"] is None else CoilModel(**self.meta["thermal"]["coil"])

    def wall(self) -> Wall | None:
        return None if self.meta["feedback"] is None else Wall(**self.meta["feedback"])

    def amplifier(self) -> Amplifier | None:
        return None if self.meta["amplifier"] is None else Amplifier(**self.meta["amplifier"])

    def _discretised(self, matrices: list[FloatArray]) -> StageModel:
        position = self.meta["feedback"] is not None
        return discretise(StateSpace(*matrices), self.amplifier(), self.meta["dt_s"], position=position)

    def stage(self, ig: int) -> StageModel:
        """Stage model of one grip, discretised anew from the plant in the file."""
        return self._discretised([getattr(self, f"plant_{name}")[ig] for name in PLANT])

    def spread(self, ig: int) -> tuple[StageModel, ...]:
        """Further devices that the entries of one grip were designed for."""
        devices = range(self.spread_A.shape[1])
        return tuple(self._discretised([getattr(self, f"spread_{name}")[ig, j] for name in PLANT]) for j in devices)

    def problem(self, iv: int, ig: int, stage: StageModel | None = None) -> TransientProblem:
        """The problem that entry (iv, ig) claims to solve; a wall pushes where the entry's own motion makes it."""
        wanted = self.wanted(float(self.speeds_m_s[iv]), np.eye(self.speeds_m_s.size)[iv])
        wanted = replace(wanted, reference_m_s2=wanted.reference_m_s2 + self.correction_m_s2[iv, ig])
        stage = self.stage(ig) if stage is None else stage
        problem = self.posing().problem(wanted, stage, self.spread(ig), self.coil())
        if problem.wall is None:
            return problem
        return pressing(problem, problem.encoder_at_ticks(problem.stage.motion(self.command_A[iv, ig])))

    def posing(self) -> Posing:
        """What the problems of all taps with these limits share."""
        return Posing.of(self.meta, self.command_A.shape[2])

    def wanted(self, speed_m_s: float, by_speed: FloatArray) -> Wanted:
        """Reference and nominal motion, from weights (nv,) of the nodes' own, see `speed_weights`."""
        return Wanted(
            speed_m_s,
            by_speed @ self.reference_m_s2,
            by_speed @ self.nominal_velocity_m_s,
            by_speed @ self.nominal_position_at_ticks_m,
        )

    def multipliers(self, iv: int, ig: int) -> Multipliers:
        return Multipliers(**{name: getattr(self, field)[iv, ig] for name, field in MULTIPLIER_FIELDS.items()})

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
        """Where a measured tap lies on the grid.

        Raises
        ------
        InputError : speed or grip is not a finite number.
        """
        if not (np.isfinite(speed_m_s) and np.isfinite(grip_N)):
            raise InputError(f"speed {speed_m_s} m/s, grip {grip_N} N: both must be finite numbers")
        speed = min(max(float(speed_m_s), float(self.speeds_m_s[0])), float(self.speeds_m_s[-1]))
        grip = min(max(float(grip_N), float(self.grips_N[0])), float(self.grips_N[-1]))
        silent = speed_m_s <= 0 or (self.grips_N[0] > 0 and grip_N < self.meta["grip_min_N"])
        return Place(speed, grip, speed != speed_m_s, grip != grip_N, bool(silent))

    def blend(self, place: Place) -> Waveform:
        """The nodes' commands at a place; zero where it is silent."""
        by_speed = interpolation_weights(self.speeds_m_s, place.speed_m_s)
        by_grip = interpolation_weights(self.grips_N, place.grip_N)
        command, transient = (
            np.tensordot(np.outer(by_speed, by_grip), waveforms, 2) * (0.0 if place.silent else 1.0)
            for waveforms in (self.command_A, self.transient_command_A)
        )
        return Waveform(**vars(place), command_A=command, transient_command_A=transient)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What stands in the file, by name: the arrays, `meta` as text, and the content's hash."""
        arrays = {name: np.asarray(getattr(self, name)) for name in SHAPES}
        for name in absent_arrays(self.meta):
            del arrays[name]
        arrays["meta"] = np.array(json.dumps(self.meta, sort_keys=True))
        arrays[HASH_FIELD] = np.array(content_hash(arrays))
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


def absent_arrays(meta: dict[str, Any]) -> list[str]:
    """Optional arrays that a file with this meta does not have."""
    stated = {**meta["limits"], "spread": meta["weights"]["spread"], "refinement": meta.get("refinement")}
    return [name for part, names in OPTIONAL.items() if stated[part] is None for name in names]


def content_hash(arrays: dict[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def temperature_is_in(left_out: dict[str, str]) -> bool:
    """Whether the temperature is a constraint of the problem of an entry with these parts left out."""
    return "temperature" not in left_out and "limits" not in left_out


def shared_left_out(left_out: Sequence[Sequence[dict[str, str]]]) -> dict[str, Any]:
    """Part -> reason, or -> reasons per entry (nv, ng) where they differ (null: the part is in), as `meta` has it."""
    parts = dict.fromkeys(part for row in left_out for entry in row for part in entry)
    shared: dict[str, Any] = {}
    for part in parts:
        reasons = [[entry.get(part) for entry in row] for row in left_out]
        alike = {reason for row in reasons for reason in row}
        shared[part] = reasons[0][0] if len(alike) == 1 else reasons
    return shared


def entry_left_out(meta: dict[str, Any], iv: int, ig: int) -> dict[str, str]:
    """What `shared_left_out` says of one entry."""
    reasons = {p: said if isinstance(said, str) else said[iv][ig] for p, said in meta["left_out"].items()}
    return {part: reason for part, reason in reasons.items() if reason is not None}
