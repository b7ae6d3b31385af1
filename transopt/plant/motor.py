"""The drive of the stylus: a motor and its transmission by datasheet, or both combined at the tip."""

from transopt.base.section import Finite, NonNegative, Positive, Section, Words


class Motor(Section):
    """A motor by one row of its datasheet.

    No datasheet states `R_eddy_ohm`, which acts across the inductance: at a voltage step the current jumps by
    step / (R_ohm + R_eddy_ohm). Without it the current does not jump.

    Attributes
    ----------
    name : maker and part number.
    datasheet : source of the numbers.
    R_ohm : terminal resistance at 25 C.
    L_H : terminal inductance.
    kt_Nm_A : torque per ampere.
    rotor_kg_m2 : inertia of the rotor.
    i_continuous_A : largest continuous current.
    i_peak_A : largest permitted current.
    R_wh_K_W : thermal resistance from winding to housing.
    R_ha_K_W : thermal resistance from housing to air.
    tau_w_s : thermal time constant of the winding.
    tau_h_s : thermal time constant of the housing.
    winding_max_C : highest permitted temperature of the winding.
    R_eddy_ohm : resistance of eddy currents across the inductance, measured on an oscilloscope.
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
    """Thermal data of a coil: winding, housing, and the winding's highest temperature.

    Attributes
    ----------
    R_wh_K_W : thermal resistance from winding to housing.
    R_ha_K_W : thermal resistance from housing to air.
    tau_w_s : thermal time constant of the winding.
    tau_h_s : thermal time constant of the housing.
    winding_max_C : highest permitted temperature of the winding.
    """

    R_wh_K_W: Positive
    R_ha_K_W: Positive
    tau_w_s: Positive
    tau_h_s: Positive
    winding_max_C: Finite


class Transmission(Section):
    """The transmission from motor shaft to stylus tip.

    Attributes
    ----------
    ratio_1_m : rotation of the shaft, in radian, per metre of tip travel.
    link_mass_kg : effective mass of the link at the tip.
    stiffness_N_m : spring between motor and stylus.
    damping_N_s_m : damper between motor and stylus.
    """

    ratio_1_m: Positive
    link_mass_kg: NonNegative
    stiffness_N_m: Positive
    damping_N_s_m: NonNegative


class Tip(Section):
    """The drive stated at the tip, such as a voice coil; without motor data there is no coil temperature.

    Attributes
    ----------
    force_per_current_N_A : force at the tip per ampere.
    moving_mass_kg : effective mass of the drive at the tip.
    stiffness_N_m : spring between drive and stylus, where the model has a transmission.
    damping_N_s_m : damper between drive and stylus, where the model has a transmission.
    """

    force_per_current_N_A: Positive
    moving_mass_kg: Positive
    stiffness_N_m: Positive | None = None
    damping_N_s_m: NonNegative | None = None


def at_the_tip(motor: Motor, transmission: Transmission) -> Tip:
    """Motor and transmission as they act at the tip: k_f = k_t ratio, m = J ratio^2 + m_link."""
    ratio = transmission.ratio_1_m
    return Tip(
        force_per_current_N_A=motor.kt_Nm_A * ratio,
        moving_mass_kg=motor.rotor_kg_m2 * ratio**2 + transmission.link_mass_kg,
        stiffness_N_m=transmission.stiffness_N_m,
        damping_N_s_m=transmission.damping_N_s_m,
    )
