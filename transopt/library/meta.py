"""What a library's `meta` holds, declared once, and which parts a problem was solved without.

The reader of a library refuses files by these declarations, and the manual's table is made of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from transopt.plant.state_space import CURRENT_INPUT, Input


@dataclass(frozen=True)
class Stated:
    """Declaration of one thing that `meta` states.

    Attributes
    ----------
    meaning : what it says.
    null : what null stands for; empty where it is never null.
    since : schema of the first files that have it.
    needed : a file that lacks it is refused, unless the table that it stands in is null.
    of_unit : needed only where commands have this unit; empty for any.
    whole : a table or a list that is kept as it came, whose keys are not declared one by one.
    """

    meaning: str
    null: str = ""
    since: int = 1
    needed: bool = False
    whole: bool = False
    of_unit: str = ""


def _needed(meaning: str, null: str = "", *, since: int = 1, whole: bool = False, of_unit: str = "") -> Stated:
    return Stated(meaning, null, since, True, whole, of_unit)


# Dotted path -> what stands there. What a name ends in is its unit (`transopt.base.units`).
META = {
    "schema": _needed("which of the forms of this file it is"),
    "command_unit": _needed("`A` or `V`: what commands and the plant's input are", since=3),
    "targets": Stated("names of what the rows are for", "the rows are speeds", whole=True),
    "target_ends_s": Stated("when each of them is over", "the rows are speeds"),
    "dt_s": _needed("servo period"),
    "lead_s": _needed("how long before contact a waveform starts"),
    "grip_min_N": _needed("below this grip nothing is played"),
    "hand_over_samples": _needed("so many commands at the end are the wall's own, zero without one"),
    "amplifier": _needed("between command and the plant's input", "ideal: the command is the input"),
    "amplifier.pole_Hz": _needed("where its low-pass has lost 3 dB", "no pole"),
    "amplifier.delay_s": _needed("pure delay, beyond the hold of the command"),
    "amplifier.command_limit_A": _needed("largest command", "no limit", of_unit="A"),
    "amplifier.command_limit_V": _needed("largest command", "no limit", of_unit="V"),
    "limits": _needed("what the tap has to keep; one that is null is not asked for"),
    "limits.current_A": _needed("largest current at any time", of_unit="A"),
    "limits.steady_current_A": _needed("what the motor stands for ever, for the baselines", of_unit="A"),
    "limits.voltage_V": _needed("largest voltage at any time", of_unit="V"),
    "limits.steady_voltage_V": _needed("what the actuator stands for ever, for the baselines", of_unit="V"),
    "limits.sag": Stated("times from the first command on and the share of the voltage there", "none", whole=True),
    "limits.slew_V_per_s": Stated("fastest change of the command", "not asked for"),
    "limits.temperature_C": _needed("largest temperature of the winding", "shown not to matter to any entry"),
    "limits.slew_A_per_s": Stated("fastest change of the command", "not asked for"),
    "limits.supply_V": Stated("largest voltage of the motor", "not asked for"),
    "limits.supply_copper_C": Stated("(2,) coldest and hottest copper at which the rail is kept"),
    "limits.stroke_m": Stated("largest displacement of the motor mass", "not asked for"),
    "limits.velocity_m_s": Stated("largest velocity of the motor mass", "not asked for"),
    "limits.own": Stated("limits of the user's: name, unit, bounds, expression", "none", whole=True),
    "thermal": _needed("the coil", "nothing is known of it"),
    "thermal.coil": _needed("its numbers"),
    "thermal.coil.R_ohm": Stated("resistance at 25 C"),
    "thermal.coil.R_wh_K_W": Stated("thermal resistance from winding to housing"),
    "thermal.coil.R_ha_K_W": Stated("thermal resistance from housing to ambient"),
    "thermal.coil.tau_w_s": Stated("time constant of the winding"),
    "thermal.coil.tau_h_s": Stated("time constant of the housing"),
    "thermal.coil.limit_C": Stated("largest temperature of the winding"),
    "thermal.coil.ambient_C": Stated("of the air"),
    "thermal.coil.start_winding_C": Stated("of the winding when a tap starts"),
    "thermal.coil.start_housing_C": Stated("of the housing when a tap starts"),
    "thermal.coil.nodes": Stated("2: winding and housing; 1: the housing stays as it is"),
    "thermal.budget": _needed("what the taps may make of it"),
    "thermal.budget.headroom_K": Stated("rise of the winding that one tap may cause", "up to the limit"),
    "thermal.budget.tap_rate_Hz": Stated("taps repeated for ever", "a single tap"),
    "thermal.budget.idle_A": Stated("current in the pauses", "what the wall asks for at the end"),
    "circuit": _needed("the motor's", "no motor is stated"),
    "circuit.R_ohm": _needed("resistance at 25 C"),
    "circuit.L_H": _needed("inductance"),
    "circuit.emf_V_s_m": _needed("back-EMF over the velocity of the motor mass"),
    "feedback": _needed("the virtual wall", "none"),
    "feedback.stiffness_N_m": _needed("of the wall"),
    "feedback.damping_N_s_m": _needed("of the wall"),
    "feedback.force_per_current_N_A": _needed("by which a force becomes a current"),
    "feedback.latency_ticks": _needed("whole servo periods from reading to command"),
    "feedback.derivative_filter_Hz": _needed("low-pass of the velocity", "none"),
    "weights": _needed("of the objective"),
    "weights.rho": _needed("of the command's movement"),
    "weights.tracking": _needed("(N,) of the squared errors"),
    "weights.error_filter": _needed("`none` or `pacinian`: by what the error is filtered"),
    "weights.calm": Stated("factor on the weights of the errors after the end of a target"),
    "weights.spread": _needed("devices that each command serves besides the node's own", "none", whole=True),
    "weights.after_s": _needed("for so long after the waveform the error counts", since=2),
    "weights.objective": _needed("`waveform` or `intensity`", since=2),
    "weights.intensity_dB": _needed("energy asked for, over the recorded tap's", since=2),
    "weights.error_filter_b": _needed("numerator of the filter in 1/z, 1 without", since=2),
    "weights.error_filter_a": _needed("denominator of the filter in 1/z, 1 without", since=2),
    "left_out": _needed("part of the problem -> why it cannot matter, or a table of reasons by entry", whole=True),
    "repeatability": _needed("by speed: NRMSE of single recordings about their mean; null where there is one"),
    "nonlinear": Stated("formulas that the plant has in place of constants", "a linear plant", whole=True),
    "scene": _needed("the scene as it was read, every key; `transopt scene keys` says what they are", whole=True),
    "sources": _needed("recordings and model files by name and SHA-256, and how they were prepared", whole=True),
    "versions": _needed("of this project and of what it computed with", whole=True),
    "solver": Stated("method and its options", whole=True),
    "outputs": Stated("outputs of the plant that limits bound, by grip", whole=True),
    "spread_outputs": Stated("the same of the further devices of a spread, by grip and device", whole=True),
    "grid_refinement": Stated("what `--grid-tolerance` reached", "the grid was taken as it stood", whole=True),
    "refinement": Stated("what `transopt-play refine` learnt on the device, by round", whole=True),
}


def in_file_form(driven_by: Input, targets: Sequence[str], *, of_devices: bool = False) -> dict[str, Any]:
    """What `meta` says of the form of its file: the oldest schema that can hold it, so that most can read it.

    Schema 2 knows a current as the input, speeds, and the mean over a spread of devices; schema 3 names arrays for
    any input, holds named targets, the shares of the devices where the worst of them counts, and the multipliers of
    limits on the motion of each.

    Parameters
    ----------
    of_devices : whether something of the last two is in it.
    """
    if driven_by is CURRENT_INPUT and not targets and not of_devices:
        return {"schema": 2}
    return {"schema": 3, "command_unit": driven_by.unit, "targets": list(targets) or None}


def lacking(meta: dict[str, Any], schema: int) -> list[str]:
    """Paths of what a file of this schema has to state and does not; what a table that is null would hold is not."""
    found, unit = [], meta.get("command_unit", "A")
    for path, stated in META.items():
        if not stated.needed or stated.since > schema or stated.of_unit not in ("", unit):
            continue
        table: Any = meta
        *tables, name = path.split(".")
        for key in tables:
            table = table.get(key) if isinstance(table, dict) else {}
        if table is not None and (not isinstance(table, dict) or name not in table):
            found.append(path)
    return found


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
