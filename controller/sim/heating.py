"""A simulated heating record of a coil on a bench supply, from which the coil is identified.

A device on a port cannot record it: it measures neither the coil's voltage nor its temperature.
"""

from dataclasses import replace

import numpy as np

from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulator import Coil
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.coil import CoilModel, effective_square

STEP_S = 0.05  # integration step: 1/240 of the winding's time constant, for an error of microkelvins


def true_coil(model: CoilModel, mismatch: float, seed: int) -> CoilModel:
    """The coil with both thermal resistances and both time constants times 1 +- `mismatch`, independent and uniform.

    It serves heating records only: in a tap the simulated coil is the scene's, since no limit depends on it there.
    """
    R_wh, R_ha, tau_w, tau_h = 1 + mismatch * np.random.default_rng([seed, 8]).uniform(-1, 1, 4)
    return replace(
        model,
        R_wh_K_W=model.R_wh_K_W * float(R_wh),
        R_ha_K_W=model.R_ha_K_W * float(R_ha),
        tau_w_s=model.tau_w_s * float(tau_w),
        tau_h_s=model.tau_h_s * float(tau_h),
    )


def heat_record(
    model: CoilModel,
    current_A: float,
    heating_s: float,
    cooling_s: float,
    every_s: float,
    *,
    noise_K: float,
    current_noise_A: float = SEED_SENSORS.current_noise_A,
    seed: int,
) -> dict[str, FloatArray]:
    """Simulate a constant current from rest, then no current, and measure winding and housing with noise.

    At rest winding and housing are at the ambient temperature, however hot the coil is when a tap begins: a record
    without the ambient beside it must begin cold for `transopt identify coil`.

    Parameters
    ----------
    model : the true coil.
    noise_K, current_noise_A : rms.

    Returns
    -------
    Columns (n,) by name for `write_measurement`. Row k is read at k `every_s`; the current of row k flows until row
    k + 1.

    Raises
    ------
    InputError : the winding would exceed its limit.
    """
    rows = round((heating_s + cooling_s) / every_s) + 1
    current = np.where(np.arange(rows) < round(heating_s / every_s), current_A, 0.0)
    steps = max(round(every_s / STEP_S), 1)
    cold = replace(model, start_winding_C=model.ambient_C, start_housing_C=model.ambient_C)
    coil, winding, housing = Coil(cold), np.empty(rows), np.empty(rows)
    for k, square in enumerate(effective_square(current, model.ripple_A).tolist()):
        winding[k], housing[k] = coil.winding_C, coil.housing_C
        if coil.winding_C > model.limit_C:
            raise InputError(
                f"record heat: the winding would pass its limit of {model.limit_C:g} C after {k * every_s:g} s at "
                f"{current_A:g} A; lower --current or --heating"
            )
        for _ in range(steps):
            coil.step(square, every_s / steps)
    random = np.random.default_rng([seed, 9])
    return {
        "time_s": np.asarray(every_s * np.arange(rows)),
        "current_A": current + current_noise_A * random.standard_normal(rows),
        "winding_C": winding + noise_K * random.standard_normal(rows),
        "housing_C": housing + noise_K * random.standard_normal(rows),
    }
