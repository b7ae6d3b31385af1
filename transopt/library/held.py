"""The arrays that a library file holds: name, shape, unit, meaning, and how each is made of an entry."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.library.arrays import Array
from transopt.problem.limits import OF_OUTPUTS

INPUT = "A or V"  # unit of commands and of what drives the plant; `meta` says which of the two


@dataclass(frozen=True)
class Held:
    """Arrays of a library beside those of multipliers; each states its shape, unit and meaning beside its name."""

    speeds_m_s: Annotated[FloatArray, Array("v", "m/s", "incoming speeds of the grid, rising; 0 for named targets")]
    targets: Annotated[
        NDArray[np.str_], Array("v", "", "names of the targets, in place of speeds", is_text=True, needs="targets")
    ]
    grips_N: Annotated[
        FloatArray, Array("g", "N", "grip forces of the grid, rising; the only one is 0 for a free device")
    ]
    command: Annotated[
        FloatArray,
        Array(
            "vgN",
            INPUT,
            "total command c_k, issued at -lead + k dt and held",
            made=lambda entry: entry.solution.command,
        ),
    ]
    transient_command: Annotated[
        FloatArray,
        Array(
            "vgN",
            INPUT,
            "the command without the wall's predicted feedback",
            made=lambda entry: entry.transient_command,
        ),
    ]
    plant_input: Annotated[
        FloatArray,
        Array(
            "vgN",
            INPUT,
            "what drives the plant at the switching instants",
            made=lambda entry: entry.plant_input,
        ),
    ]
    acceleration_m_s2: Annotated[
        FloatArray,
        Array("vgN", "m/s^2", "y'' of the stylus there, as predicted", made=lambda entry: entry.predicted_m_s2),
    ]
    acceleration_after_m_s2: Annotated[
        FloatArray,
        Array(
            "vgM",
            "m/s^2",
            "y'' after the last command, as predicted",
            made=lambda entry: entry.after_m_s2,
            replayed=True,
        ),
    ]
    recorded_before_m_s2: Annotated[
        FloatArray, Array("vgL", "m/s^2", "r, the recorded acceleration, from contact to the first command that acts")
    ]
    recorded_m_s2: Annotated[FloatArray, Array("vgN", "m/s^2", "r at the switching instants")]
    recorded_after_m_s2: Annotated[
        FloatArray, Array("vgM", "m/s^2", "r after the last command, 0 where the recording has ended")
    ]
    free_before_m_s2: Annotated[
        FloatArray, Array("vgL", "m/s^2", "a_free, how the stylus accelerates without a command, before the first")
    ]
    free_m_s2: Annotated[FloatArray, Array("vgN", "m/s^2", "a_free at the switching instants")]
    free_after_m_s2: Annotated[FloatArray, Array("vgM", "m/s^2", "a_free after the last command")]
    target_before_m_s2: Annotated[
        FloatArray,
        Array(
            "vgL",
            "m/s^2",
            "what J asks of y'' where no command can reach it, r - a_free",
            made=lambda entry: entry.problem.target.before_m_s2,
        ),
    ]
    target_m_s2: Annotated[
        FloatArray,
        Array(
            "vgN",
            "m/s^2",
            "what J asks of y'' at the switching instants, r - a_free and the correction of a refined library",
            made=lambda entry: entry.problem.target.window_m_s2,
        ),
    ]
    target_after_m_s2: Annotated[
        FloatArray,
        Array(
            "vgM",
            "m/s^2",
            "what J asks of y'' after the last command, r - a_free",
            made=lambda entry: entry.problem.target.after_m_s2,
        ),
    ]
    target_ends_s: Annotated[
        FloatArray, Array("v", "s", "when a named target is over, from its beginning on", needs="targets")
    ]
    nominal_position_m: Annotated[
        FloatArray, Array("vgN", "m", "z_nom, where the stylus is without a command, at the switching instants")
    ]
    nominal_velocity_m_s: Annotated[FloatArray, Array("vgN", "m/s", "its derivative there")]
    nominal_position_at_ticks_m: Annotated[
        FloatArray, Array("vgN", "m", "z_nom at the ticks, where encoders are read")
    ]
    nominal_after_at_ticks_m: Annotated[FloatArray, Array("vgM", "m", "z_nom at the M ticks that follow")]
    tap_error: Annotated[
        FloatArray,
        Array(
            "vg",
            "",
            "|y'' + a_free - r| / |r| over the intention after replay, nothing filtered",
            made=lambda entry: entry.figures.tap_error,
            replayed=True,
        ),
    ]
    felt_error: Annotated[
        FloatArray,
        Array(
            "vg",
            "",
            "the same through a band-pass of 120 to 620 Hz, over all samples; NaN where the servo cannot carry it",
            may_be_nan=True,
            made=lambda entry: entry.figures.felt_error,
            replayed=True,
        ),
    ]
    felt_dB: Annotated[
        FloatArray,
        Array(
            "vg",
            "dB",
            "energy in that band over that of r",
            may_be_nan=True,
            made=lambda entry: entry.figures.felt_dB,
            replayed=True,
        ),
    ]
    speed_change: Annotated[
        FloatArray,
        Array(
            "vg",
            "",
            "change of speed over the intention, played over recorded; NaN of a target that changes none",
            may_be_nan=True,
            made=lambda entry: entry.figures.speed,
            replayed=True,
        ),
    ]
    bump_m_s2: Annotated[
        FloatArray,
        Array(
            "vg",
            "m/s^2",
            "peak error in 10 to 60 Hz after the intention; NaN of a named target",
            may_be_nan=True,
            made=lambda entry: entry.figures.bump_m_s2,
            replayed=True,
        ),
    ]
    heat_A2_s: Annotated[
        FloatArray,
        Array(
            "vg",
            "A^2 s",
            "integral of i^2 through the window and after it, NaN where a voltage drives the plant",
            may_be_nan=True,
            made=lambda entry: entry.heat_A2_s,
            replayed=True,
        ),
    ]
    energy: Annotated[
        FloatArray,
        Array(
            "vg",
            "m^2/s^4",
            "E, the sums of J over the target in place of the error",
            made=lambda entry: entry.problem.tracking.energy_m2_s4,
            replayed=True,
        ),
    ]
    heat_price: Annotated[
        FloatArray,
        Array(
            "vg",
            "1/A^2 or 1/V^2",
            "price in J of the sum of i_k^2 over the window",
            made=lambda entry: entry.problem.heat_price,
            replayed=True,
        ),
    ]
    error_after: Annotated[
        FloatArray,
        Array(
            "vg",
            "",
            "|y'' + a_free - r| after the last command, relative to the target in the window",
            made=lambda entry: entry.figures.error_after,
            replayed=True,
        ),
    ]
    peak_after_m_s2: Annotated[
        FloatArray,
        Array(
            "vg",
            "m/s^2",
            "largest |y'' + a_free - r| after the last command",
            made=lambda entry: entry.figures.peak_after_m_s2,
            replayed=True,
        ),
    ]
    intensity: Annotated[
        FloatArray,
        Array(
            "vg",
            "",
            "lam, price of the energy that y'' lacks",
            needs="intensity",
            made=lambda entry: entry.problem.intensity,
        ),
    ]
    energy_dB: Annotated[
        FloatArray,
        Array(
            "vg",
            "dB",
            "energy of y'' in the window over that of the target",
            needs="intensity",
            made=lambda entry: entry.energy_dB if entry.objective == "intensity" else 0.0,
        ),
    ]
    floor: Annotated[
        FloatArray, Array("vg", "", "tap error of the optimum without limits", made=lambda entry: entry.floor)
    ]
    linear_command: Annotated[
        FloatArray,
        Array(
            "vgN",
            INPUT,
            "command of the design for the plant as it is at rest",
            needs="nonlinear",
            made=lambda entry: (
                np.zeros(entry.problem.grid.stages) if entry.linear_command is None else entry.linear_command
            ),
        ),
    ]
    tap_error_promised: Annotated[
        FloatArray,
        Array(
            "vg",
            "",
            "of that command on the plant as it is at rest",
            needs="nonlinear",
            made=lambda entry: 0.0 if entry.linear_command is None else entry.linear_promised,
            replayed=True,
        ),
    ]
    tap_error_linear: Annotated[
        FloatArray,
        Array(
            "vg",
            "",
            "of that command on the nonlinear plant after replay",
            may_be_nan=True,
            needs="nonlinear",
            made=lambda entry: 0.0 if entry.linear_command is None else entry.linear_tap_error,
            replayed=True,
        ),
    ]
    instants_within: Annotated[
        FloatArray,
        Array(
            "vg3",
            "",
            "instants within a servo period, beside its end, at which coil current, stroke and velocity are limited",
            needs="instants_within",
            made=lambda entry: [entry.problem.parts.get(kind.name, 1) - 1.0 for kind in OF_OUTPUTS],
        ),
    ]
    substeps: Annotated[
        FloatArray,
        Array(
            "vg",
            "",
            "steps of the nonlinear stage in a servo period, 1 to 32",
            needs="nonlinear",
            made=lambda entry: 0.0 if entry.designed.nonlinear is None else entry.designed.nonlinear.stage.substeps,
        ),
    ]
    peak_input: Annotated[
        FloatArray,
        Array(
            "vg",
            INPUT,
            "largest size of it in the replay",
            made=lambda entry: entry.played.peak_input,
            replayed=True,
        ),
    ]
    peak_temperature_C: Annotated[
        FloatArray,
        Array(
            "vg",
            "C",
            "hottest winding of the replay, NaN without a motor's data",
            may_be_nan=True,
            made=lambda entry: entry.played.winding_C,
            replayed=True,
        ),
    ]
    objective: Annotated[
        FloatArray, Array("vg", "", "J of the command", made=lambda entry: entry.certificate.objective)
    ]
    primal_violation: Annotated[
        FloatArray,
        Array(
            "vg",
            "",
            "largest excess over a limit, in A, V or K",
            made=lambda entry: entry.certificate.primal_violation,
        ),
    ]
    dual_residual: Annotated[
        FloatArray,
        Array(
            "vg",
            "1/A",
            "largest reduced gradient of the Lagrangian",
            made=lambda entry: entry.certificate.dual_residual,
        ),
    ]
    duality_gap: Annotated[
        FloatArray, Array("vg", "", "bound on J - optimum", made=lambda entry: entry.certificate.duality_gap)
    ]
    lower_bound: Annotated[
        FloatArray,
        Array("vg", "", "rigorous bound on the optimum from below", made=lambda entry: entry.certificate.lower_bound),
    ]
    solve_time_s: Annotated[
        FloatArray, Array("vg", "s", "wall time of the solve", made=lambda entry: entry.solution.solve_time_s)
    ]
    status: Annotated[
        NDArray[np.str_], Array("vg", "", "how the entry ended", is_text=True, made=lambda entry: entry.status.value)
    ]
    binding: Annotated[
        NDArray[np.str_],
        Array("vg", "", "the limits that bind, and when", is_text=True, made=lambda entry: entry.binding),
    ]
    current_sign: Annotated[
        FloatArray,
        Array(
            "vgN",
            "",
            "slope of |mean i| over each period, by which ripple heats",
            needs="temperature_C",
            made=lambda entry: entry.solution.multipliers.slope,
        ),
    ]
    mu_end: Annotated[
        FloatArray,
        Array(
            "vgh",
            "1/A",
            "multiplier of the hand-over, of either sign",
            made=lambda entry: entry.solution.multipliers.hand_over,
        ),
    ]
    plant_A: Annotated[FloatArray, Array("gnn", "", "dx/dt = A x + B i of the device at each grip")]
    plant_B: Annotated[FloatArray, Array("gn1", "", "its B")]
    plant_C: Annotated[FloatArray, Array("g1n", "", "y'' = C x + D i")]
    plant_D: Annotated[FloatArray, Array("g11", "", "its D")]
    plant_Ce: Annotated[FloatArray, Array("g1n", "", "encoder position = Ce x")]
    correction_m_s2: Annotated[
        FloatArray,
        Array(
            "vgN",
            "m/s^2",
            "added to the target where the device's own taps have been learnt from",
            needs="refinement",
        ),
    ]
    spread_A: Annotated[
        FloatArray, Array("gsnn", "", "A of further devices that a robust entry serves", needs="spread")
    ]
    spread_B: Annotated[FloatArray, Array("gsn1", "", "their B", needs="spread")]
    spread_C: Annotated[FloatArray, Array("gs1n", "", "their C", needs="spread")]
    spread_D: Annotated[FloatArray, Array("gs11", "", "their D", needs="spread")]
    spread_Ce: Annotated[FloatArray, Array("gs1n", "", "their Ce", needs="spread")]
    spread_share: Annotated[
        FloatArray,
        Array(
            "vgs",
            "",
            "their shares in J, of the worst device's saddle point; the rest is the own",
            needs="worst",
            made=lambda entry: entry.problem.shared[1:],
        ),
    ]
