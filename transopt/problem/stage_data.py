"""One problem's numbers stage by stage, as the project's own method takes them (`solvers/riccati.c`).

What a stage is comes as `Derivatives`: the designer reads them from the CasADi statement (`transcribe.stage_data`);
the runtime, which must not load CasADi, takes the same written out by hand. A test holds the two together to 1e-12.
"""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.coil import PWM_RIPPLE_A
from transopt.problem.problem import OBJECTIVE_SCALE, STAGEWISE, Multipliers, TransientProblem
from transopt.problem.stage import Layout, LinearStage, hand_over_rows, layout, linear_stage

SIZE_BOUND = 2.0  # of the limit current


def kelvin(problem: TransientProblem) -> float:
    """Unit of the rises: the largest headroom; 0 without temperature."""
    if problem.thermal is None:
        return 0.0
    headroom = problem.thermal.model.headroom_K
    return max(float(headroom[np.isfinite(headroom)].max()), 1e-9)


def tracking_values(problem: TransientProblem, stage: LinearStage) -> dict[str, FloatArray]:
    """Reference (N,) in units of |r|, weights (N,) and the movement's weight (1,) of the statement."""
    r = problem.reference_m_s2
    filtered = r if problem.error_filter is None else problem.error_filter.apply(r)
    return {
        "r": filtered / (np.linalg.norm(r) or 1.0),
        "w": problem.tracking_weights,
        "rho": np.array([problem.movement_weight * stage.current_A**2]),
    }


def heat_values(problem: TransientProblem, current_A: float) -> dict[str, FloatArray]:
    """Numbers of the temperature recursion, in units of `current_A` and of `kelvin`, matrices as they are written."""
    assert problem.thermal is not None
    model, unit = problem.thermal.model, kelvin(problem)
    F, f = (np.zeros_like(model.M), np.zeros_like(model.b)) if model.closure is None else model.closure
    return {
        "M": model.M,
        "b": model.b * current_A**2 / unit,
        "gain": model.gain,
        "copper": np.array([model.copper * unit]),
        "square": model.heating.square,
        "share": np.array([model.heating.share]),
        "decay": np.array([model.heating.decay]),
        "ripple": np.array([PWM_RIPPLE_A / current_A]),
        "F": F,
        "f": f / unit,
    }


def held(problem: TransientProblem, command_A: FloatArray) -> FloatArray:
    """(N,) commands moved by rounding only: into the box, zero at a plain hand-over."""
    c = np.clip(command_A, -problem.limits.command_bound_A, problem.limits.command_bound_A)
    if problem.wall is None:
        c[problem.free_stages :] = 0.0
    return np.asarray(c)


@dataclass(frozen=True)
class Derivatives:
    """What one stage is, in scaled units.

    Attributes
    ----------
    A : (n, n) of the states one period later by x. C, E : (S, n), (S,) of the tracked outputs by x and by dc.
    V, v : (3, n), (3,) of the voltage before and after the switching instant, in units of its limit, and of the mean
        current, by x and by dc; zero where there is none.
    """

    A: FloatArray
    C: FloatArray
    E: FloatArray
    V: FloatArray
    v: FloatArray


def derivatives(problem: TransientProblem, stage: LinearStage, where: Layout) -> Derivatives:
    """The same as `transcribe.stage_data` gives."""
    n = where.states
    V, v = np.zeros((3, n)), np.zeros(3)
    if problem.supply is not None:
        V[:2] = stage.supply / problem.supply.limit_V
        v[1] = problem.supply.by_command * stage.current_A / problem.supply.limit_V
    if problem.thermal is not None:
        heating = problem.thermal.model.heating
        later = (1 - heating.share) * (1 - heating.decay)
        V[2, -1] = v[2] = later
        if where.amplifier:
            V[2, where.current] = heating.share + (1 - heating.share) * heating.decay
    return Derivatives(stage.A, stage.C, np.zeros_like(stage.E) if where.amplifier else stage.E, V, v)


@dataclass(frozen=True)
class Rows:
    """Limits as rows lower_k <= G x_k + d dc_k + d_size e_k <= upper_k, k = 0..N.

    Attributes
    ----------
    kinds : their names, the winding's first where there is one.
    G : (rows, n). d, d_size : (rows,). lower, upper : (N + 1, rows), infinite where there is no limit.
    unit : (rows,) of a row, in units of the program: the largest of its bounds, so that limits are of order one.
    """

    kinds: tuple[str, ...]
    G: FloatArray
    d: FloatArray
    d_size: FloatArray
    lower: FloatArray
    upper: FloatArray
    unit: FloatArray


def _rows(problem: TransientProblem, stage: LinearStage, where: Layout, data: Derivatives) -> Rows:
    N, n, limits = problem.grid.stages, where.states, problem.limits
    states, none, every = np.eye(n), np.zeros(n), slice(N)
    kinds: list[str] = []
    found: list[tuple[FloatArray, float, float, FloatArray, FloatArray]] = []

    def row(
        kind: str,
        G: FloatArray,
        d: float,
        d_size: float,
        lower: FloatArray | float,
        upper: FloatArray | float,
        stages: slice,
    ) -> None:
        """One row with limits at some stages."""
        bounds = np.array([np.full(N + 1, -np.inf), np.full(N + 1, np.inf)])
        bounds[0, stages], bounds[1, stages] = lower, upper
        kinds.append(kind)
        found.append((G, d, d_size, bounds[0], bounds[1]))

    current = limits.current_A / stage.current_A
    thermal, supply = problem.thermal, problem.supply
    if thermal is not None:
        row("winding", none, 0.0, 0.0, -np.inf, thermal.model.headroom_K / kelvin(problem), slice(1, N + 1))
        if thermal.model.closure is not None:
            # Taps that repeat never cool below the surroundings: colder fixed points are those of a runaway.
            found[-1][3][0] = 0.0
    command = current if limits.command_A is None else limits.command_A / stage.current_A
    # A plain hand-over's commands are zero.
    free = slice(problem.free_stages if problem.wall is None else N)
    row("command", states[-1], 1.0, 0.0, -command, command, free)
    if where.amplifier:
        # The current at tau_0 is zero; that at tau_N follows the hand-over.
        row("current", states[where.current], 0.0, 0.0, -current, current, slice(1, N))
    if limits.slew_A_per_s is not None:
        step = limits.slew_A_per_s * problem.grid.dt_s / stage.current_A
        row("slew", none, 1.0, 0.0, -step, step, every)
    if supply is not None:
        nominal = supply.nominal_V / supply.limit_V
        for j, (kind, stages) in enumerate({"supply_before": slice(1, N), "supply_after": every}.items()):
            volts = nominal[stages]
            row(kind, data.V[j], float(data.v[j]), 0.0, -1 - volts, 1 - volts, stages)
    if thermal is not None:
        # size >= |mean i|: the kink of Eq. 7 as two rows, on which Newton does not stumble.
        for kind, sign in {"size_above": -1.0, "size_below": 1.0}.items():
            row(kind, sign * data.V[2], float(sign * data.v[2]), 1.0, 0.0, np.inf, every)
        row("size", none, 0.0, 1.0, -SIZE_BOUND * current, SIZE_BOUND * current, every)

    G, d, d_size, lower, upper = (np.array(each) for each in zip(*found, strict=True))
    bounds = np.concatenate([lower, upper], axis=1)
    unit = np.abs(np.where(np.isfinite(bounds), bounds, 0.0)).max(axis=1)
    # The winding's row is a state of the recursion, whose unit is the largest headroom already.
    unit = np.where((unit > 0) & (np.array(kinds) != "winding"), unit, 1.0)
    by = unit[:, None]
    return Rows(tuple(kinds), G / by, d / unit, d_size / unit, (lower / by).T, (upper / by).T, unit)


def _no_rows(n: int) -> Rows:
    none = np.zeros(0)
    return Rows((), np.zeros((0, n)), none, none, np.zeros((0, 0)), np.zeros((0, 0)), none)


@dataclass(frozen=True)
class Stages:
    """One problem as the method takes it, in the statement's units.

    Attributes
    ----------
    current_A, kelvin : units of commands and of rises.
    sizes, numbers, arrays : integers, scalars and arrays of `tr_problem`, by name; the arrays contiguous.
    """

    problem: TransientProblem
    current_A: float
    kelvin: float
    limits: Rows
    sizes: dict[str, int]
    numbers: dict[str, float]
    arrays: dict[str, FloatArray]

    def command(self, scaled: FloatArray) -> FloatArray:
        """(N,) commands [A] of those in scaled units (N,), as `held`."""
        return held(self.problem, scaled * self.current_A)

    def multipliers(self, by_row: FloatArray, gradient: FloatArray) -> Multipliers:
        """Multipliers of J in SI from upper less lower ones (N + 1, rows) and the gradient (N,) by the movements."""
        problem, N, unit = self.problem, self.sizes["stages"], OBJECTIVE_SCALE / self.current_A
        scaled = dict(zip(self.limits.kinds, (by_row / self.limits.unit).T, strict=True))
        zero = np.zeros(N + 1)
        on = {kind: scaled.get(kind, zero)[:N] * unit for kind in ("command", "current", "slew")}
        if problem.limits.command_A is None:
            on["current"], on["command"] = on["command"], zero[:N]
        if problem.supply is not None:
            per_volt = OBJECTIVE_SCALE / problem.supply.limit_V
            on |= {kind: scaled[kind][:N] * per_volt for kind in ("supply_before", "supply_after")}
        sides = {
            f"{kind}_{side}": sign * mu for kind, mu in on.items() for side, sign in (("lower", -1), ("upper", 1))
        }
        if problem.thermal is not None:
            above, below = (np.maximum(-scaled[kind][:N], 0.0) for kind in ("size_above", "size_below"))
            # The two share what the size is worth; where it is worth nothing any sign will do.
            sides["current_sign"] = (above - below) / np.maximum(above + below, np.finfo(float).tiny)
            sides["temperature_upper"] = scaled["winding"][1:] * OBJECTIVE_SCALE / self.kelvin
        tail = -gradient[problem.free_stages :] * unit
        stated = dict.fromkeys(STAGEWISE, zero[:N]) | sides
        return Multipliers(**{**stated, "hand_over": tail}).clipped()


def stages(problem: TransientProblem, stage: LinearStage, data: Derivatives, *, limited: bool = True) -> Stages:
    """The problem around what one stage is; not `limited`, without any row."""
    where, m = layout(problem), 0 if problem.thermal is None else problem.thermal.model.nodes
    values = tracking_values(problem, stage)
    limits = _rows(problem, stage, where, data) if limited else _no_rows(where.states)
    gains, offsets = hand_over_rows(problem, stage)
    gains[:, -1] -= 1.0  # c_k = rows x_k + constant, so dc_k = that less c_(k-1)
    nothing = np.zeros(4)
    heat = (
        dict.fromkeys(("M", "b", "gain", "square", "F", "f"), nothing)
        if m == 0
        else heat_values(problem, stage.current_A)
    )
    arrays = {
        "A": data.A,
        "C": data.C,
        "E": data.E,
        "weight": 2 * values["w"] / (OBJECTIVE_SCALE * where.devices),
        "reference": values["r"],
        "rule_gain": gains,
        "rule_offset": offsets,
        **{name: getattr(limits, name) for name in ("G", "d", "d_size", "lower", "upper")},
        **{name: heat[name] for name in ("M", "b", "gain", "square", "F", "f")},
    }
    return Stages(
        problem=problem,
        current_A=stage.current_A,
        kelvin=kelvin(problem),
        limits=limits,
        sizes={
            "stages": problem.grid.stages,
            "free_stages": problem.free_stages,
            "states": where.states,
            "outputs": where.devices,
            "rows": limits.d.size,
            "nodes": m,
            "current": where.current if where.amplifier else -1,
            "repeated": int(m > 0 and problem.thermal is not None and problem.thermal.model.closure is not None),
        },
        numbers={
            "movement_weight": 2 * float(values["rho"][0]) / OBJECTIVE_SCALE,
            "command_bound": problem.limits.command_bound_A / stage.current_A,
            **{name: float(heat[name][0]) if m else 0.0 for name in ("decay", "ripple", "copper")},
        },
        arrays={name: np.ascontiguousarray(array, dtype=float) for name, array in arrays.items()},
    )


def runtime_stages(problem: TransientProblem, stage: LinearStage | None = None) -> Stages:
    """Stage data of a problem without the CasADi statement; `stage` spares computing the linear part again."""
    stage = linear_stage(problem) if stage is None else stage
    return stages(problem, stage, derivatives(problem, stage, layout(problem)))


def without_limits(problem: TransientProblem, stage: LinearStage | None = None) -> Stages:
    """Stage data of the same problem without rows and temperature: what a linear pass takes."""
    limited = problem.supply is not None or problem.thermal is not None
    bare = replace(problem, supply=None, thermal=None) if limited else problem
    stage = linear_stage(bare) if stage is None else stage
    return stages(bare, stage, derivatives(bare, stage, layout(bare)), limited=False)
