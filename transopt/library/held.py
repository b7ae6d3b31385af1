"""The arrays of a library file: name, shape, unit, meaning, and how each is computed from an entry."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.library.arrays import kept
from transopt.problem.limits import OF_OUTPUTS

INPUT = "A or V"  # unit of commands and plant input; `meta` states which of the two


@dataclass(frozen=True, kw_only=True)
class Held:
    """Arrays of a library except the multipliers; each states its shape, unit and meaning beside its name."""

    # fmt: off
    speeds_m_s: FloatArray = kept("v", "m/s", "incoming speeds of the grid, rising; 0 for named targets")
    targets: NDArray[np.str_] = kept("v", "", "names of the targets, in place of speeds", is_text=True,
        needs="targets")
    grips_N: FloatArray = kept("g", "N",
        "grip forces of the grid, rising; the only one is 0 for a free device; of an arm once for each place")
    normals: FloatArray = kept("q3", "", "normal of the surface of each device, in the frame of an arm's base",
        needs="arm")
    postures_rad: FloatArray = kept("q3", "rad", "angles of the arm in each device", needs="arm")
    command: FloatArray = kept("vgmN", INPUT, "total command c_k, issued at -lead + k dt and held",
        "solution.command")
    transient_command: FloatArray = kept("vgmN", INPUT, "the command without the wall's predicted feedback",
        "transient_command")
    plant_input: FloatArray = kept("vgmN", INPUT, "plant input at the switching instants", "plant_input")
    acceleration_m_s2: FloatArray = kept("vgpN", "m/s^2",
        "predicted y'' of the stylus at the switching instants", "predicted_m_s2")
    acceleration_after_m_s2: FloatArray = kept("vgpM", "m/s^2", "predicted y'' after the last command",
        "after_m_s2", replayed=True)
    recorded_before_m_s2: FloatArray = kept("vgpL", "m/s^2",
        "r, the recorded acceleration, from contact to the first command that acts")
    recorded_m_s2: FloatArray = kept("vgpN", "m/s^2", "r at the switching instants")
    recorded_after_m_s2: FloatArray = kept("vgpM", "m/s^2",
        "r after the last command, 0 where the recording has ended")
    free_before_m_s2: FloatArray = kept("vgpL", "m/s^2",
        "a_free, acceleration of the stylus without a command, from contact to the first command that acts")
    free_m_s2: FloatArray = kept("vgpN", "m/s^2", "a_free at the switching instants")
    free_after_m_s2: FloatArray = kept("vgpM", "m/s^2", "a_free after the last command")
    target_before_m_s2: FloatArray = kept("vgpL", "m/s^2",
        "target of y'' where no command can reach it, r - a_free", "problem.target.before_m_s2")
    target_m_s2: FloatArray = kept("vgpN", "m/s^2",
        "target of y'' at the switching instants, r - a_free and the correction of a refined library",
        "problem.target.window_m_s2")
    target_after_m_s2: FloatArray = kept("vgpM", "m/s^2", "target of y'' after the last command, r - a_free",
        "problem.target.after_m_s2")
    target_ends_s: FloatArray = kept("v", "s", "duration of a named target", needs="targets")
    nominal_position_m: FloatArray = kept("vgN", "m",
        "z_nom, position of the stylus without a command, at the switching instants")
    nominal_velocity_m_s: FloatArray = kept("vgN", "m/s", "dz_nom/dt at the switching instants")
    nominal_position_at_ticks_m: FloatArray = kept("vgN", "m", "z_nom at the ticks, where encoders are read")
    nominal_after_at_ticks_m: FloatArray = kept("vgM", "m", "z_nom at the M ticks that follow")
    tap_error: FloatArray = kept("vg", "",
        "|y'' + a_free - r| / |r| over the intention after replay, nothing filtered", "figures.tap_error",
        replayed=True)
    felt_error: FloatArray = kept("vg", "",
        "tap error after a band-pass of 120 to 620 Hz, over all samples; NaN where the servo rate is too low for it",
        "figures.felt_error", may_be_nan=True, replayed=True)
    felt_dB: FloatArray = kept("vg", "dB", "energy of the played acceleration in that band over that of r",
        "figures.felt_dB", may_be_nan=True, replayed=True)
    speed_change: FloatArray = kept("vg", "",
        "change of speed over the intention, played over recorded; NaN of a target that changes none",
        "figures.speed", may_be_nan=True, replayed=True)
    bump_m_s2: FloatArray = kept("vg", "m/s^2",
        "peak error in 10 to 60 Hz after the intention; NaN of a named target", "figures.bump_m_s2", may_be_nan=True,
        replayed=True)
    heat_A2_s: FloatArray = kept("vg", "A^2 s",
        "integral of i^2 over the window, NaN where a voltage drives the plant", "heat_A2_s",
        may_be_nan=True, replayed=True)
    energy: FloatArray = kept("vg", "m^2/s^4", "E, the sums of J over the target in place of the error",
        "problem.tracking.energy_m2_s4", replayed=True)
    heat_price: FloatArray = kept("vg", "1/A^2", "price in J of the sum of i_k^2 over the window",
        "problem.heat_price", replayed=True)
    error_after: FloatArray = kept("vg", "",
        "|y'' + a_free - r| after the last command, relative to the target in the window", "figures.error_after",
        replayed=True)
    peak_after_m_s2: FloatArray = kept("vg", "m/s^2", "largest |y'' + a_free - r| after the last command",
        "figures.peak_after_m_s2", replayed=True)
    intensity: FloatArray = kept("vg", "", "lam, price of the energy that y'' lacks", "problem.intensity",
        needs="intensity")
    energy_dB: FloatArray = kept("vg", "dB", "energy of y'' in the window over that of the target",
        lambda entry: entry.energy_dB if entry.objective == "intensity" else 0.0, needs="intensity")
    tangential_error: FloatArray = kept("vg", "", "error across the normal over the intention, over |r| along it",
        "tangential_error", replayed=True, needs="several directions")
    direction_rad: FloatArray = kept("vg", "rad",
        "angle by which that error turns the acceleration, by the sizes of both", "direction_rad", replayed=True,
        needs="several directions")
    floor: FloatArray = kept("vg", "",
        "tap error of the optimum without limits; NaN where that was not found", "floor", may_be_nan=True)
    unlimited_objective: FloatArray = kept("vg", "", "J of that optimum", "unlimited_objective",
        may_be_nan=True)
    linear_command: FloatArray = kept("vgN", INPUT, "command designed for the plant linearised at rest",
        lambda entry: np.zeros(entry.problem.grid.stages) if entry.linear_command is None else entry.linear_command,
        needs="nonlinear")
    tap_error_promised: FloatArray = kept("vg", "", "tap error of `linear_command` on the plant linearised at rest",
        lambda entry: 0.0 if entry.linear_command is None else entry.linear_promised, replayed=True,
        needs="nonlinear")
    tap_error_linear: FloatArray = kept("vg", "", "tap error of `linear_command` on the nonlinear plant after replay",
        lambda entry: 0.0 if entry.linear_command is None else entry.linear_tap_error, may_be_nan=True,
        replayed=True, needs="nonlinear")
    instants_within: FloatArray = kept("vg3", "",
        "instants within a servo period, beside its end, at which coil current, stroke and velocity are limited",
        lambda entry: [entry.problem.parts.get(kind.name, 1) - 1.0 for kind in OF_OUTPUTS], needs="instants_within")
    substeps: FloatArray = kept("vg", "", "steps of the nonlinear stage in a servo period, 1 to 32",
        lambda entry: 0.0 if entry.designed.nonlinear is None else entry.designed.nonlinear.stage.substeps,
        needs="nonlinear")
    peak_input: FloatArray = kept("vg", INPUT, "largest plant input in the replay, without its sign",
        "played.peak_input", replayed=True)
    peak_temperature_C: FloatArray = kept("vg", "C", "hottest winding of the replay, NaN without a motor's data",
        "played.winding_C", may_be_nan=True, replayed=True)
    objective: FloatArray = kept("vg", "", "J of the command", "certificate.objective")
    primal_violation: FloatArray = kept("vg", "", "largest excess over a limit, in A, V or K",
        "certificate.primal_violation")
    dual_residual: FloatArray = kept("vg", "1/A", "largest reduced gradient of the Lagrangian",
        "certificate.dual_residual")
    duality_gap: FloatArray = kept("vg", "", "bound on J - optimum", "certificate.duality_gap")
    lower_bound: FloatArray = kept("vg", "", "rigorous bound on the optimum from below", "certificate.lower_bound")
    solve_time_s: FloatArray = kept("vg", "s", "wall time of the solve", "solution.solve_time_s")
    status: NDArray[np.str_] = kept("vg", "", "status of the entry", "status.value", is_text=True)
    binding: NDArray[np.str_] = kept("vg", "", "the limits that bind, and when", "binding", is_text=True)
    current_sign: FloatArray = kept("vgN", "", "slope of |mean i| over each period, by which ripple heats",
        "solution.multipliers.slope", needs="temperature_C")
    mu_end: FloatArray = kept("vgmh", "1/A", "multiplier of the hand-over, of either sign",
        "solution.multipliers.hand_over")
    plant_A: FloatArray = kept("gnn", "", "dx/dt = A x + B i of the device at each grip")
    plant_B: FloatArray = kept("gni", "", "B of the device")
    plant_C: FloatArray = kept("gon", "", "y'' = C x + D i")
    plant_D: FloatArray = kept("goi", "", "its D")
    plant_Ce: FloatArray = kept("g1n", "", "encoder position = Ce x")
    correction_m_s2: FloatArray = kept("vgpN", "m/s^2",
        "correction of the target that was learnt from taps on the device", needs="refinement")
    spread_A: FloatArray = kept("gsnn", "", "A of further devices that a robust entry serves", needs="spread")
    spread_B: FloatArray = kept("gsni", "", "their B", needs="spread")
    spread_C: FloatArray = kept("gson", "", "their C", needs="spread")
    spread_D: FloatArray = kept("gsoi", "", "their D", needs="spread")
    spread_Ce: FloatArray = kept("gs1n", "", "their Ce", needs="spread")
    spread_share: FloatArray = kept("vgs", "",
        "weights of the further devices in J at the saddle point of the worst device; the entry's own has the rest",
        lambda entry: entry.problem.shared[1:], needs="worst")
    # fmt: on
