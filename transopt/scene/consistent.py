"""Consistency between the tables of a scene: keys that need or exclude keys of other tables."""

import math
from typing import TYPE_CHECKING

from transopt.base.errors import InputError
from transopt.base.sizes import LONGEST_LEAD_S, MOST_AFTER, MOST_COMMANDS
from transopt.base.writing import rounded_down
from transopt.plant.arm import Arm
from transopt.plant.drive import Drive
from transopt.plant.fourth_order import FourthOrder
from transopt.plant.kind import PlantKind
from transopt.plant.moving_coil import MovingCoil
from transopt.plant.time_grid import samples_after
from transopt.problem.limits import kinds_of
from transopt.recordings.axes import ALL
from transopt.scene.identified import IdentifiedModel
from transopt.scene.model_parts import StateSpaceDevice
from transopt.scene.sections import OF_A_CURRENT, AmplifierSection, Robust, Thermal, Weights

if TYPE_CHECKING:
    from transopt.scene.scene import Scene

BELOW = 1 - 1e-6  # factor for a value that has to stay strictly below a bound
FORCE_TOLERANCE = 0.01  # relative difference between the motor's force per ampere and that of a model file
POPULATION_SEED = 2  # seed of the hands that a robust design serves


def check(scene: "Scene") -> None:
    """Check the tables of a scene against each other.

    Raises
    ------
    ValueError : the first contradiction, with the key to change.
    """
    _check_what_is_wanted(scene)
    _check_input(scene)
    if (scene.motor is None) != (scene.transmission is None):
        raise ValueError("motor and transmission belong together: give both, or a tip table in their place")
    if isinstance(scene.model, IdentifiedModel):
        _check_identified(scene, scene.model)
    if scene.nonlinear and not scene.targets:
        raise ValueError("model.nonlinear: x is the displacement from rest, so it needs [[targets]], not speeds")
    if scene.nonlinear and scene.weights.objective != "waveform":
        raise ValueError('model.nonlinear: only with weights.objective = "waveform"')
    if scene.grid.cool_share is not None and (scene.nonlinear or scene.weights.objective != "waveform"):
        raise ValueError(
            "grid.cool_share: the cool command is the optimum of a linear plant's waveform: leave it out, or "
            'model.nonlinear and weights.objective = "intensity"'
        )
    if scene.nonlinear and scene.robust is not None:
        raise ValueError("robust: serves a spread of linear devices, not model.nonlinear: leave one of them out")
    whole = isinstance(scene.model, PlantKind) and not scene.model.driven_at_tip
    if whole and (scene.motor, scene.transmission, scene.tip) != (None, None, None):
        raise ValueError(f"model.kind = {scene.model.kind} is a whole actuator: take motor, transmission, tip out")
    if whole and scene.feedback is not None:
        raise ValueError(f"feedback: a wall is for a stylus on a motor, not for model.kind = {scene.model.kind}")
    held = not isinstance(scene.model, PlantKind) or scene.model.held_by_hand
    if not held and scene.grid.grips_N != [0.0]:
        raise ValueError(f"grid.grips_N: model.kind = {scene.model.kind} depends on no grip: leave it out")
    if not whole and not _drive_in_file(scene) and (scene.motor is None) == (scene.tip is None):
        raise ValueError("the drive is stated either by motor and transmission or by tip: give exactly one")
    through = isinstance(scene.model, PlantKind) and scene.model.through_transmission
    if through and scene.tip is not None and None in (scene.tip.stiffness_N_m, scene.tip.damping_N_s_m):
        raise ValueError(f"model.kind = {scene.model.kind} needs tip.stiffness_N_m and tip.damping_N_s_m")
    if scene.motor is not None and scene.limits.transient_input > scene.motor.i_peak_A:
        raise ValueError(_above_peak(scene, scene.motor.i_peak_A))
    if scene.shares:
        _check_several(scene)
    if scene.directions == 1 and scene.weights.tangential != Weights().tangential:
        raise ValueError(f"weights.tangential: model.kind = {scene.model.kind} has one direction: leave it out")
    _check_amplifier(scene)
    commands = scene.axes.entries * scene.stages
    if commands > MOST_COMMANDS:
        raise ValueError(f"grid and time.stages: {commands} commands, at most {MOST_COMMANDS}: fewer nodes or stages")
    _check_time(scene)
    _check_what_needs_what(scene)
    if scene.hand_over_samples > scene.stages:
        raise ValueError(
            f"hand_over_samples = {scene.hand_over_samples}: must not exceed time.stages = {scene.stages}"
        )


def _above_peak(scene: "Scene", peak_A: float) -> str:
    """Message that names the key by which the limit exceeds the motor's peak current, and its largest value."""
    limits, asked = scene.limits, f"above the motor's i_peak_A = {peak_A:g} A: lower it to"
    if limits.current_A is not None:
        return f"limits.current_A = {limits.current_A:g}: {asked} {peak_A:g} or less"
    if limits.steady_input > peak_A:
        return f"limits.steady_current_A = {limits.steady_input:g}: {asked} {peak_A:g} or less"
    factor, most = limits.transient_input / limits.steady_input, math.floor(100 * peak_A / limits.steady_input) / 100
    made = f"makes {limits.transient_input:g} A of the steady current, {limits.steady_input:g} A"
    return f"limits.beta = {factor:g}: {made}, {asked} {most:g} or less"


def _check_several(scene: "Scene") -> None:
    """Check a scene with several motors."""
    asked, kinds = scene.limits.asked(), kinds_of(scene.driven_by)
    unfit = [f"limits.{kind.key}" for kind in kinds if not kind.of_each_motor and asked.get(kind.key) is not None]
    tables = (
        ("targets", bool(scene.targets) and isinstance(scene.model, Arm)),
        ("limits.own", bool(scene.limits.own)),
        ("thermal", scene.thermal != Thermal()),
        ("robust", scene.robust is not None),
        ("grid.cool_share", scene.grid.cool_share is not None),
        ("weights.objective", scene.weights.objective != "waveform"),
    )
    for key in (*unfit, *(key for key, there in tables if there)):
        raise ValueError(
            f"{key}: model.kind = {scene.model.kind} cannot have it yet: leave it out, or take a plant with one motor"
        )
    if isinstance(scene.model, Arm) and scene.grid.grips_N[0] == 0:
        raise ValueError("grid.grips_N: model.kind = arm is held by a hand: give grips above 0")
    if scene.recordings.simulated is not None and scene.striker is None:
        raise ValueError(
            "recordings.simulated: several motors do not strike: give recorded files, or a [striker] that moves "
            "along the normal, as that of stylus_3d"
        )
    commands = scene.axes.entries * len(scene.shares) * scene.stages
    if commands > MOST_COMMANDS:
        nodes = "grid, model.postures_deg and model.normals" if scene.axes.places else "grid and time.stages"
        raise ValueError(f"{nodes}: {commands} commands, at most {MOST_COMMANDS}: fewer nodes or stages")


def _check_what_is_wanted(scene: "Scene") -> None:
    """Check that the scene states either speeds with recordings of taps, or named targets."""
    if scene.recordings.axis == ALL and not isinstance(scene.model, Arm):
        raise ValueError(
            f'recordings.axis: "{ALL}" is for an arm, not for model.kind = {scene.model.kind}: '
            'leave it out, or take "main" or "dft321"'
        )
    names = [target.name for target in scene.targets]
    if not names:
        if scene.weights.calm != 1:
            raise ValueError("weights.calm: a tap goes on as it was recorded, only a named target has an end")
        if not scene.grid.speeds_m_s:
            raise ValueError("grid.speeds_m_s: missing; add it to the scene, or [[targets]] without speeds")
        if not scene.recordings.files and scene.recordings.simulated is None:
            raise ValueError("recordings: give files or a simulated table; neither is stated")
        return
    if len(set(names)) < len(names):
        raise ValueError("targets: two have the same name: give each its own")
    if scene.grid.speeds_m_s:
        raise ValueError("grid.speeds_m_s: named targets have no speed: give either speeds or targets")
    if scene.grid.grips_N != [0.0]:
        raise ValueError("grid.grips_N: named targets are for a device that no hand holds: leave it out")
    if scene.recordings.files or scene.recordings.simulated is not None:
        raise ValueError("recordings: named targets take the place of files and simulated taps: leave these out")
    if scene.feedback is not None:
        raise ValueError("feedback: a virtual wall needs a stylus that taps: leave it out with named targets")


def _check_input(scene: "Scene") -> None:
    """Check that limits and tables belong to the plant's input, a current or a voltage."""
    limits, unit = scene.limits, scene.driven_by.unit
    if unit == "A":
        if limits.voltage_V is not None:
            raise ValueError(
                f"limits.voltage_V: a current drives model.kind = {scene.model.kind}: state its limits in A, or a "
                "model that a voltage drives"
            )
        if limits.steady_current_A is None:
            raise ValueError("limits.steady_current_A: missing; add it to the scene")
        return
    if limits.voltage_V is None:
        raise ValueError(f"limits.voltage_V: missing; a voltage drives model.kind = {scene.model.kind}")
    if (
        limits.current_A is not None
        and scene.nonlinear
        and isinstance(scene.model, MovingCoil)
        and not scene.model.L_H
    ):
        raise ValueError(
            "limits.current_A: without inductance the current of a coil whose BL changes with x is no linear limit: "
            "state model.L_H, or bound the voltage by limits.voltage_V"
        )
    for key, stated in (
        ("limits.beta", limits.beta is not None),
        *((f"limits.{key}", getattr(limits, key) is not None) for key in OF_A_CURRENT),
        ("feedback", scene.feedback is not None),
        ("thermal", scene.thermal != Thermal()),
        ("grid.cool_share", scene.grid.cool_share is not None),
        # J prices the square of the input, and that of a voltage is no heat: the back-EMF is in it.
        ("weights.heat_price", scene.weights.heat_price > 0),
    ):
        if stated:
            raise ValueError(
                f"{key}: belongs to a motor that a current drives, and here a voltage does: leave it out"
            )


def _check_what_needs_what(scene: "Scene") -> None:
    """Check keys that need or exclude keys of other tables."""
    if scene.limits.supply_V is not None and (scene.circuit() is None or scene.amplifier == "ideal"):
        raise ValueError(
            "limits.supply_V needs [motor] (resistance, inductance, back-EMF) and an amplifier with a pole: an "
            "ideal one changes the current at once, which no voltage can"
        )
    budgets = (scene.thermal.headroom_K, scene.thermal.tap_rate_Hz)
    if budgets != (None, None) and scene.winding is None:
        raise ValueError("thermal.headroom_K and thermal.tap_rate_Hz need [motor]: a tip states no coil")
    winding = scene.winding
    if winding is not None and scene.thermal.start_winding_C > winding.winding_max_C:
        raise ValueError(
            f"thermal.start_winding_C = {scene.thermal.start_winding_C:g} C: above the motor's winding_max_C = "
            f"{winding.winding_max_C:g} C: let it cool"
        )
    grid = scene.time_grid()
    takes_s = (grid.stages + 1) * grid.dt_s + grid.delay_s
    shorter = "" if scene.time.stages is None else ", or shorten time.stages"
    if scene.thermal.tap_rate_Hz is not None and not 1 / scene.thermal.tap_rate_Hz > takes_s:
        raise ValueError(
            f"thermal.tap_rate_Hz = {scene.thermal.tap_rate_Hz:g}: a tap takes {takes_s * 1e3:g} ms with the "
            f"amplifier's delay: must be at most {rounded_down(BELOW / takes_s):g}{shorter}"
        )
    if scene.robust is not None and scene.feedback is not None:
        raise ValueError(
            "robust: feedback depends on the motion, which differs over a spread of devices: leave one of them out"
        )
    if scene.robust is not None and scene.robust.minimise == "worst" and scene.weights.objective == "intensity":
        raise ValueError(
            'robust.minimise = "worst": only for the waveform: leave out weights.objective = "intensity", or take '
            '"mean"'
        )
    if scene.robust is not None and scene.robust.grip_spread is not None and scene.grid.grips_N[0] == 0:
        raise ValueError("robust.grip_spread: the free device has no grip to spread")
    if scene.robust is not None and scene.robust.population is not None:
        _check_population(scene, scene.robust)
    produced = scene.robust is not None and (scene.robust.resonance_spread or scene.robust.quality_spread)
    if produced and not isinstance(scene.model, MovingCoil):
        raise ValueError(
            "robust.resonance_spread and quality_spread: only for a mass on a spring, model.kind = inertial or "
            f"voice_coil, not of {scene.model.kind}: leave them out"
        )
    if scene.robust is not None and scene.robust.model_uncertainty and not isinstance(scene.model, IdentifiedModel):
        raise ValueError('robust.model_uncertainty: needs a model file (model = "MODEL.json"), which has it')


def _check_population(scene: "Scene", robust: Robust) -> None:
    """Check that the scene states a hand, which the hands of a population can replace, and draw them."""
    if not isinstance(scene.model, Drive | FourthOrder) or scene.grid.grips_N[0] == 0:
        raise ValueError(
            "robust.population: spreads the hand that a scene states by [model.hand], at grips above 0: leave it "
            "out; an identified model has robust.model_uncertainty"
        )
    assert robust.population is not None
    try:
        robust.population.drawn(robust.samples, POPULATION_SEED, scene.grid.grips_N)
    except InputError as error:
        raise ValueError(f"robust.{error}") from None


def _drive_in_file(scene: "Scene") -> bool:
    """Whether a model file contains the device, so that the scene need not state motor and transmission."""
    return isinstance(scene.model, IdentifiedModel) and scene.model.device is not None


def _on_the_motion(scene: "Scene") -> list[str]:
    """Keys of the scene's limits that depend on the device's motion."""
    asked, kinds = scene.limits.asked(), kinds_of(scene.driven_by)
    return [kind.key for kind in kinds if kind.of_each_device and asked.get(kind.key) is not None]


def _check_identified(scene: "Scene", model: IdentifiedModel) -> None:
    """Check that the scene does not contradict its model file."""
    for grip in scene.grid.grips_N:
        for served in (grip, *scene.spread_grips_N(grip)):
            try:
                model.check_grip(served)
            except InputError as error:
                raise ValueError(f"grid.grips_N: {served:g} N: {error}") from None
    tip = model.tip()
    if _drive_in_file(scene) and scene.tip is not None:
        raise ValueError(f"tip: the device in {model.file} includes the drive: take the tip table out")
    if tip is not None and scene.motor is not None and scene.transmission is not None:
        stated, known = scene.motor.kt_Nm_A * scene.transmission.ratio_1_m, tip.force_per_current_N_A
        if not abs(stated / known - 1) <= FORCE_TOLERANCE:
            raise ValueError(
                f"motor: kt_Nm_A * transmission.ratio_1_m = {stated:.4g} N/A, but {model.file} was identified "
                f"with force_per_current_N_A = {known:.4g} N/A: they must agree within {FORCE_TOLERANCE:.0%}; "
                "correct one of them, or identify again with this motor"
            )
    if isinstance(model.device, StateSpaceDevice):
        for key, stated_in_scene in (
            ("feedback", scene.feedback is not None),
            *((f"limits.{key}", True) for key in _on_the_motion(scene)),
        ):
            if stated_in_scene:
                raise ValueError(
                    f"{key}: needs the motor's motion, and the device in {model.file} is a state space without it: "
                    "identify a drive chain, or leave it out"
                )
        if scene.recordings.simulated is not None and scene.striker is None:
            raise ValueError(
                f"recordings.simulated: the device in {model.file} is a state space, which has no stylus to "
                "strike with: give recorded files, or a [model] that strikes and the file as model_file"
            )
    if scene.robust is not None and scene.robust.model_uncertainty:
        try:
            model.drawn(scene.robust.samples, scene.grid.grips_N)
        except InputError as error:
            raise ValueError(f"robust.model_uncertainty: {error}") from None


def _check_amplifier(scene: "Scene") -> None:
    """Check that pole and delay are stated once: in the scene, in its model file, or implied by bridge and motor."""
    identified = scene.model.amplifier if isinstance(scene.model, IdentifiedModel) else None
    stated = None if scene.amplifier == "ideal" else scene.amplifier
    if stated is not None and stated.switching_Hz is not None:
        if scene.circuit() is None or scene.limits.supply_V is None:
            raise ValueError(
                "amplifier.switching_Hz: needs [motor] and the rail that the bridge switches, limits.supply_V: "
                "add them, or take it out"
            )
        scene.bridge()
    if stated is not None and stated.gain_V_A is not None:
        if stated.switching_Hz is None:
            raise ValueError("amplifier.gain_V_A: belongs to a bridge's current loop: add amplifier.switching_Hz too")
        if stated.pole_Hz is not None or identified is not None:
            raise ValueError("amplifier.gain_V_A: determines the pole, which is stated too: take one of them out")
    if identified is None:
        follows = scene.bridge() is not None and not scene.pole_is_stated
        for name in ("pole_Hz", "delay_s"):
            if stated is not None and getattr(stated, name) is None and not follows:
                raise ValueError(f"amplifier.{name}: missing; add it to the scene")
        return
    assert isinstance(scene.model, IdentifiedModel)
    if scene.amplifier == "ideal":
        raise ValueError(f"amplifier = 'ideal': {scene.model.file} has an amplifier part: state [amplifier]")
    assert isinstance(scene.amplifier, AmplifierSection)
    for name in ("pole_Hz", "delay_s"):
        value = getattr(scene.amplifier, name)
        if value is not None:
            raise ValueError(
                f"amplifier.{name} = {value:g}: {scene.model.file} has it too ({getattr(identified, name):g}): "
                "take it out of the scene"
            )


def _check_time(scene: "Scene") -> None:
    """Check that a default lead is possible, and that the samples after the window are not too many."""
    lead_s, after = scene.lead_s, samples_after(scene.weights.after_s, scene.time.dt_s)
    if scene.time.lead_s is None and lead_s > LONGEST_LEAD_S:
        raise ValueError(
            f"time.lead_s: the amplifier's delay of {scene.delay_s * 1e3:g} ms and 0.2 ms, in whole periods of "
            f"{scene.time.dt_s * 1e3:g} ms, take a lead of {lead_s * 1e3:g} ms, at most {LONGEST_LEAD_S * 1e3:g} "
            "ms: state a shorter time.lead_s; what no command can reach then counts as error"
        )
    if after > MOST_AFTER:
        raise ValueError(
            f"weights.after_s = {scene.weights.after_s:g} s: {after} samples of {scene.time.dt_s:g} s, at most "
            f"{MOST_AFTER}: lower weights.after_s"
        )
