"""What drives the stylus: a motor and its transmission by datasheet, or both as the stylus feels them at the tip."""

from transopt.base.section import Finite, NonNegative, Positive, Section, Words


class Motor(Section):
    """One row of a datasheet; its values belong together.

    `R_eddy_ohm`, across the inductance, is in no datasheet: a step of the voltage makes the current jump by
    step / (R_ohm + R_eddy_ohm). Without it the current does not jump.

    Attributes
    ----------
    name : maker and part.
    datasheet : where the numbers are from.
    R_ohm : terminal resistance at 25 C.
    L_H : terminal inductance.
    kt_Nm_A : torque per ampere.
    rotor_kg_m2 : inertia of the rotor.
    i_continuous_A : current that the motor stands for ever.
    i_peak_A : largest current that may flow.
    R_wh_K_W : thermal resistance from winding to housing.
    R_ha_K_W : thermal resistance from housing to air.
    tau_w_s : thermal time constant of the winding.
    tau_h_s : thermal time constant of the housing.
    winding_max_C : most that the winding stands.
    R_eddy_ohm : resistance of eddy currents across the inductance, seen on a scope.
    """

    name: Words
    datasheet: Words
    R_ohm: Positive
    L_H: NonNegative
    kt_Nm_A: Positive
    rotor_kg_m2: NonNegative
    i_continuous_A: Positive
    i_peak_A: Positive
    R_wh_K_W: Positive
    R_ha_K_W: Positive
    tau_w_s: Positive
    tau_h_s: Positive
    winding_max_C: Finite
    R_eddy_ohm: Positive | None = None


class Winding(Section):
    """How a coil heats: winding over housing over ambient, and the most that the winding stands.

    Attributes
    ----------
    R_wh_K_W : thermal resistance from winding to housing.
    R_ha_K_W : thermal resistance from housing to air.
    tau_w_s : thermal time constant of the winding.
    tau_h_s : thermal time constant of the housing.
    winding_max_C : most that the winding stands.
    """

    R_wh_K_W: Positive
    R_ha_K_W: Positive
    tau_w_s: Positive
    tau_h_s: Positive
    winding_max_C: Finite


class Transmission(Section):
    """From motor shaft to stylus tip: `ratio_1_m` is shaft radian per metre of tip travel.

    Attributes
    ----------
    ratio_1_m : turn of the shaft, in radian, for a metre of the tip.
    link_mass_kg : mass of the link, felt at the tip.
    stiffness_N_m : spring between motor and stylus.
    damping_N_s_m : damper between motor and stylus.
    """

    ratio_1_m: Positive
    link_mass_kg: NonNegative
    stiffness_N_m: Positive
    damping_N_s_m: NonNegative


class Tip(Section):
    """The drive stated at the tip, for voice coils: no motor data, so no coil temperature.

    Attributes
    ----------
    force_per_current_N_A : force at the tip for each ampere.
    moving_mass_kg : mass of the drive, felt at the tip.
    stiffness_N_m : spring between drive and stylus, where the model has a transmission.
    damping_N_s_m : damper between drive and stylus, where the model has a transmission.
    """

    force_per_current_N_A: Positive
    moving_mass_kg: Positive
    stiffness_N_m: Positive | None = None
    damping_N_s_m: NonNegative | None = None


def at_the_tip(motor: Motor, transmission: Transmission) -> Tip:
    """What the stylus feels of a motor: k_f = k_t ratio, and rotor and link as one mass m = J ratio^2 + m_link.

    The ratio is in shaft radian per metre of tip travel.
    """
    ratio = transmission.ratio_1_m
    return Tip(
        force_per_current_N_A=motor.kt_Nm_A * ratio,
        moving_mass_kg=motor.rotor_kg_m2 * ratio**2 + transmission.link_mass_kg,
        stiffness_N_m=transmission.stiffness_N_m,
        damping_N_s_m=transmission.damping_N_s_m,
    )
