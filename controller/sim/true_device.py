"""The true device: masses, springs and dampers in absolute coordinates, amplifier, coil.

It shares with the design model only the physical parameters of the scene. Positions are those of the masses along the
surface normal, not deviations from a nominal motion; the hand's intention is a moving ground.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from controller.servo.settings import AMPLIFIER, RE_25
from transopt.base.errors import InputError
from transopt.base.matrices import exponential
from transopt.base.signals import FloatArray
from transopt.plant import second_order
from transopt.plant.amplifier import Amplifier
from transopt.plant.bridge import Bridge
from transopt.plant.coil import CoilModel
from transopt.plant.drive import Drive
from transopt.plant.fourth_order import FourthOrder
from transopt.plant.hand import HandSection, LinearInGrip
from transopt.recordings.settings import SimulatedTaps
from transopt.scene.identified import IdentifiedModel
from transopt.scene.model_parts import DriveDevice, FourthOrderHand, SecondOrderHand, StateSpaceDevice
from transopt.scene.scene import Scene

LETTING_GO_N = 0.2  # below this grip the skin's spring and damper fade to zero; at 0 N nobody holds the stylus


@dataclass(frozen=True)
class Joint:
    """Spring and damper, either of which may depend on the grip."""

    stiffness_N_m: LinearInGrip
    damping_N_s_m: LinearInGrip

    def scaled(self, stiffness: float, damping: float) -> "Joint":
        return Joint(_scaled(self.stiffness_N_m, stiffness), _scaled(self.damping_N_s_m, damping))


def _scaled(parameter: LinearInGrip, factor: float) -> LinearInGrip:
    return LinearInGrip(parameter.constant * factor, parameter.per_newton * factor)


def _joint(stiffness_N_m: float, damping_N_s_m: float) -> Joint:
    return Joint(LinearInGrip(stiffness_N_m, 0.0), LinearInGrip(damping_N_s_m, 0.0))


@dataclass(frozen=True)
class Ground:
    """Forces between the motor mass and the device's base, which the design model does not have.

    Attributes
    ----------
    stiffness_N_m, damping_N_s_m : spring (relaxed at the surface) and viscous friction, >= 0.
    friction_N : Coulomb friction, >= 0; smoothed as tanh(v / `friction_speed_m_s`).
    """

    stiffness_N_m: float = 0.0
    damping_N_s_m: float = 0.0
    friction_N: float = 0.0
    friction_speed_m_s: float = 2e-3


NO_GROUND = Ground()


@dataclass(frozen=True)
class TrueDevice:
    """Physical parameters of one device in one hand.

    Attributes
    ----------
    masses_kg : n masses from the motor to the hand.
    joints : n; joint j between mass j and mass j + 1, the last one between the last mass and the intention.
    stylus : index of the mass that carries the accelerometer and meets real objects.
    skin : index of the joint that needs a grip to be closed; None where stylus and hand are one mass.
    amplifier : None if ideal. crossover_A : half-width of its dead band around zero.
    coil : None where the drive is stated at the tip.
    bridge : PWM bridge and PI loop behind the amplifier's pole; None if only the pole is known.
    """

    masses_kg: tuple[LinearInGrip, ...]
    joints: tuple[Joint, ...]
    stylus: int
    skin: int | None
    force_per_current_N_A: float
    amplifier: Amplifier | None
    coil: CoilModel | None
    ground: Ground = NO_GROUND
    crossover_A: float = 0.0
    bridge: Bridge | None = None

    @property
    def delay_s(self) -> float:
        """Delay from a command to the amplifier's pole, or to the bridge's loop, less the loop's own delay."""
        of_loop = 0.0 if self.bridge is None else self.bridge.delay_s
        return 0.0 if self.amplifier is None else max(self.amplifier.delay_s - of_loop, 0.0)

    def mismatched(self, fraction: float, random: np.random.Generator) -> "TrueDevice":
        """Every mass, stiffness, damping, the force per ampere, the amplifier's pole and delay times 1 +- `fraction`.

        The factors are independent and uniform; both coefficients of a grip-dependent parameter share one.
        """
        n = len(self.masses_kg)
        factors = iter((1 + fraction * random.uniform(-1, 1, 3 * n + 3)).tolist())
        masses = tuple(_scaled(mass, next(factors)) for mass in self.masses_kg)
        joints = tuple(joint.scaled(next(factors), next(factors)) for joint in self.joints)
        gain, pole, delay = factors
        amplifier = self.amplifier
        if amplifier is not None:
            amplifier = replace(amplifier, pole_Hz=amplifier.pole_Hz * pole, delay_s=amplifier.delay_s * delay)
        return replace(
            self,
            masses_kg=masses,
            joints=joints,
            force_per_current_N_A=self.force_per_current_N_A * gain,
            amplifier=amplifier,
        )

    def at(self, grip_N: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n,) masses [kg], stiffnesses [N/m] and dampings [N s/m] of the joints at a grip."""
        masses = np.array([mass.at(grip_N) for mass in self.masses_kg])
        stiffness = np.array([joint.stiffness_N_m.at(grip_N) for joint in self.joints])
        damping = np.array([joint.damping_N_s_m.at(grip_N) for joint in self.joints])
        if self.skin is not None:
            hold = min(max(grip_N / LETTING_GO_N, 0.0), 1.0)
            stiffness[self.skin] *= hold
            damping[self.skin] *= hold
        return masses, stiffness, damping


def device_of(scene: Scene) -> TrueDevice:
    """The device that a scene describes, without imperfections.

    Raises
    ------
    InputError : the device is a black box, which has no masses, or an actuator that no hand holds.
    """
    model = scene.model.moving if isinstance(scene.model, IdentifiedModel) else scene.model
    if isinstance(model, StateSpaceDevice):
        raise InputError(
            f"{scene.name}: its device is an identified state space, which has no masses to move: simulate "
            "another device (--true-device SCENE.toml or library.npz)"
        )
    if not isinstance(
        model, second_order.SecondOrder | SecondOrderHand | FourthOrder | FourthOrderHand | Drive | DriveDevice
    ):
        raise InputError(
            f"{scene.name}: no hand holds its actuator, so that nobody taps with it: simulate another device "
            "(--true-device SCENE.toml or library.npz)"
        )
    tip = scene.drive_at_tip()

    def held(hand: HandSection) -> tuple[LinearInGrip, tuple[Joint, Joint]]:
        skin = Joint(hand.line("skin_stiffness_N_m"), hand.line("skin_damping_N_s_m"))
        return hand.line("mass_kg"), (skin, Joint(hand.line("arm_stiffness_N_m"), hand.line("arm_damping_N_s_m")))

    masses: tuple[LinearInGrip, ...]
    joints: tuple[Joint, ...]
    match model:
        case second_order.SecondOrder():
            masses, stylus, skin = (second_order.SEED_HAND_MASS_KG,), 0, None
            joints = (Joint(second_order.SEED_HAND_STIFFNESS_N_M, second_order.SEED_HAND_DAMPING_N_S_M),)
        case SecondOrderHand(mass_kg=whole, stiffness_N_m=stiffness, damping_N_s_m=damping):
            masses, stylus, skin = (whole.linear(),), 0, None
            joints = (Joint(stiffness.linear(), damping.linear()),)
        case FourthOrder(stylus_mass_kg=mass, hand=section) | FourthOrderHand(stylus_mass_kg=mass, hand=section):
            # A hand identified from taps includes in its stylus mass all that moves with it, the motor too.
            moving_kg = tip.moving_mass_kg if isinstance(model, FourthOrder) else 0.0
            hand_mass, joints = held(section)
            masses, stylus, skin = (LinearInGrip(moving_kg + mass, 0.0), hand_mass), 0, 0
        case Drive(stylus_mass_kg=mass, hand=section) | DriveDevice(stylus_mass_kg=mass, hand=section):
            assert tip.stiffness_N_m is not None
            assert tip.damping_N_s_m is not None
            hand_mass, hand_joints = held(section)
            masses, stylus, skin = (LinearInGrip(tip.moving_mass_kg, 0.0), LinearInGrip(mass, 0.0), hand_mass), 1, 1
            joints = (_joint(tip.stiffness_N_m, tip.damping_N_s_m), *hand_joints)
    return TrueDevice(
        masses_kg=masses,
        joints=joints,
        stylus=stylus,
        skin=skin,
        force_per_current_N_A=tip.force_per_current_N_A,
        amplifier=scene.amplifier_model(),
        coil=scene.coil(),
        bridge=None if scene.pole_is_stated else scene.bridge(),
    )


# Inputs of the linear flow, constant over a step except the intention, whose velocity is constant.
COMMAND, INTENTION, INTENTION_SPEED, MOTOR_FORCE, CONTACT_FORCE = range(5)
INPUTS = 5


class Layout:
    """Indices into the state vector of n masses: positions, velocities, then the attributes below.

    Attributes
    ----------
    current : current in the coil.
    sensed : acceleration behind the accelerometer's pole.
    target : position of the struck object's mass; its velocity follows.
    states : number of states.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self.current, self.sensed, self.target, self.states = 2 * n, 2 * n + 1, 2 * n + 2, 2 * n + 4


def nonlinear(device: TrueDevice, target: SimulatedTaps | None) -> bool:
    return target is not None or device.ground.friction_N > 0


def rates(device: TrueDevice, target: SimulatedTaps | None, bandwidth_Hz: float, grip_N: float) -> FloatArray:
    """(S + U, S + U) generator of the linear motion of states and inputs; only the intention's input row is not zero.

    The contact force acts on the stylus outwards and on the object inwards.
    """
    masses, stiffness, damping = device.at(grip_N)
    n = masses.size
    at = Layout(n)
    S = at.states
    G = np.zeros((S + INPUTS, S + INPUTS))
    G[:n, n : 2 * n] = np.eye(n)
    for j in range(n):
        # Joint j pulls mass j and the next mass (or the intention) towards each other.
        if j + 1 < n:
            ahead_z, ahead_v = j + 1, n + j + 1
        else:
            ahead_z, ahead_v = S + INTENTION, S + INTENTION_SPEED
        for row, sign, mass in ((n + j, -1.0, masses[j]), *([(n + j + 1, 1.0, masses[j + 1])] if j + 1 < n else [])):
            G[row, j] += sign * stiffness[j] / mass
            G[row, ahead_z] -= sign * stiffness[j] / mass
            G[row, n + j] += sign * damping[j] / mass
            G[row, ahead_v] -= sign * damping[j] / mass
    G[n, 0] -= device.ground.stiffness_N_m / masses[0]
    G[n, n] -= device.ground.damping_N_s_m / masses[0]
    G[n, at.current] += device.force_per_current_N_A / masses[0]
    G[n, S + MOTOR_FORCE] += 1 / masses[0]
    G[n + device.stylus, S + CONTACT_FORCE] += 1 / masses[device.stylus]
    if device.amplifier is not None and device.bridge is None:
        G[at.current, at.current] = -device.amplifier.rate_rad_s
        G[at.current, S + COMMAND] = device.amplifier.rate_rad_s
    pole = 2 * np.pi * bandwidth_Hz
    G[at.sensed] = pole * G[n + device.stylus]
    G[at.sensed, at.sensed] -= pole
    if target is not None:
        G[at.target, at.target + 1] = 1.0
        G[at.target + 1, at.target] = -target.object_stiffness_N_m / target.object_mass_kg
        G[at.target + 1, at.target + 1] = -target.object_damping_N_s_m / target.object_mass_kg
        G[at.target + 1, S + CONTACT_FORCE] = -1 / target.object_mass_kg
    G[S + INTENTION, S + INTENTION_SPEED] = 1.0
    return G


@dataclass(frozen=True)
class Flow:
    """The exact linear motion at one grip.

    Attributes
    ----------
    whole, half : per segment of the servo period, (S, S + U) maps over one step and over half of it.
    acceleration : (S + U,) row of the stylus's acceleration.
    """

    whole: tuple[FloatArray, ...]
    half: tuple[FloatArray, ...]
    acceleration: FloatArray


@lru_cache(maxsize=4096)
def flow(
    device: TrueDevice, target: SimulatedTaps | None, bandwidth_Hz: float, grip_N: float, steps_s: tuple[float, ...]
) -> Flow:
    """Matrix exponentials of the linear part over one step of each segment; cached, since grips recur.

    Half steps are computed only if nonlinear forces have to be evaluated at the midpoint.
    """
    G = rates(device, target, bandwidth_Hz, grip_N)
    n = len(device.masses_kg)
    S = Layout(n).states

    def maps(fraction: float) -> tuple[FloatArray, ...]:
        return tuple(np.ascontiguousarray(exponential(G * (h * fraction))[:S]) for h in steps_s)

    return Flow(maps(1.0), maps(0.5) if nonlinear(device, target) else (), G[n + device.stylus].copy())


def _fixed(value: float) -> LinearInGrip:
    return LinearInGrip(value, 0.0)


# The device of a run without library and scene: an RE 25 on a Phantom-class transmission.
DEFAULT_DEVICE = TrueDevice(
    masses_kg=(_fixed(0.014), _fixed(0.026), _fixed(0.010)),
    joints=(
        Joint(_fixed(6e4), _fixed(8.0)),
        Joint(LinearInGrip(3000.0, 2000.0), LinearInGrip(6.0, 3.0)),
        Joint(LinearInGrip(160.0, 110.0), LinearInGrip(6.0, 3.0)),
    ),
    stylus=1,
    skin=1,
    force_per_current_N_A=1.25,
    amplifier=AMPLIFIER,
    coil=RE_25,
)
