"""The columns of a row; those of the limits follow from the list of limits."""

from dataclasses import fields

from transopt.design.sweep import MULTIPLIER_COLUMNS, Outcome

# The largest multiplier of each limit, by what the limit is called: objective per unit of the limit.
MULTIPLIERS = MULTIPLIER_COLUMNS


def _outcome() -> list[str]:
    found: list[str] = []
    for field in fields(Outcome):
        found += MULTIPLIERS.values() if field.name == "multipliers" else [field.name]
    return [name for name in found if name != "index"]


# What a solved entry says, in the order of the columns; the number of the row stands before it.
OUTCOME = _outcome()
# How far the certificate found a limit exceeded, a column per unit of the limits.
VIOLATIONS = ("violation_A", "violation_V", "violation_K")
# What an inverse question may require a bound of.
MEASURES = (
    "tap_error",
    "felt_error",
    "felt_dB",
    "speed_change",
    "bump_m_s2",
    "heat_A2_s",
    "energy_dB",
    "waveform_dB",
    "intensity",
    "floor",
    "peak_input",
    "peak_command",
    "peak_temperature_C",
    "peak_voltage_V",
    "free_peak",
)
