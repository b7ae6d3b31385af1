"""Coils that no motor of a haptic device has: a unit of the record is wrong, not the motor."""

from transopt.plant.coil import CoilModel

CREDIBLE_K_W = (0.2, 500.0)  # of coil to ambient; motors of 6 mm and of 60 mm lie within
CREDIBLE_S = (5.0, 2e4)  # of a housing's time constant


def unbelievable(coil: CoilModel) -> list[str]:
    """What is orders of magnitude off, and the unit to look at; a wrong unit fits without any misfit."""
    judged = (
        ("R_wh + R_ha", coil.R_wh_K_W + coil.R_ha_K_W, "K/W", CREDIBLE_K_W, "current_A in A, the resistance in ohm"),
        ("tau_h", coil.tau_h_s, "s", CREDIBLE_S, "time_s in s"),
    )
    return [
        f"{name} of {value:.3g} {unit} is that of no such motor ({least:g} to {most:g} {unit}): is {column}?"
        for name, value, unit, (least, most), column in judged
        if not least <= value <= most
    ]
