"""The columns of a row, and which of them a limit has: everything in this package that names limits stands here."""

from dataclasses import fields

from transopt.design.sweep import Outcome

# What a solved entry says, in the order of the columns; the number of the row stands before it.
OUTCOME = [field.name for field in fields(Outcome) if field.name != "index"]

# The largest multiplier of each limit, by the limit's name: objective per unit of the limit.
MULTIPLIERS = {
    "current": "mu_current_1_A",
    "command": "mu_command_1_A",
    "slew": "mu_slew_1_A",
    "supply": "mu_supply_1_V",
    "coil": "mu_coil_1_K",
}
# How far the certificate found a limit exceeded, a column per unit of the limits.
VIOLATIONS = ("violation_A", "violation_V", "violation_K")
# What an inverse question may require a bound of.
MEASURES = (
    "nrmse",
    "weighted_nrmse",
    "floor",
    "peak_current_A",
    "peak_command_A",
    "peak_temperature_C",
    "peak_voltage_V",
    "free_peak_A",
)
