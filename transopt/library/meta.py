"""What a library's `meta` holds: the keys that are read from it, and which parts a problem was solved without."""

from collections.abc import Sequence
from typing import Any

# Key -> the keys of its table that are read, where it is a table. A table may be null: the scene has no such part.
META_KEYS = {
    "dt_s": (),
    "lead_s": (),
    "grip_min_N": (),
    "amplifier": ("pole_Hz", "delay_s", "command_limit_A"),
    "limits": ("current_A", "steady_current_A", "temperature_C"),
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

# Of its weights, from schema 2 on.
WEIGHTS_OF_2 = ("after_s", "objective", "intensity_dB", "error_filter_b", "error_filter_a")


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
