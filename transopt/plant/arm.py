"""A serial arm with three motors at its base that carries a stylus, held by a hand: a Phantom-like device.

The arm turns by q_1 about the vertical; upper arm and forearm stand in that plane at the angles q_2 above the
horizontal and q_3 beyond the downward vertical. As in the Phantom a parallel linkage drives the forearm, so that q_3
is measured against the base and all motors are mounted there. The tip is at (Cavusoglu, Feygin and Tendick, Presence
11(6), 2002, with a rotated frame)

    x = r cos q_1,  y = r sin q_1,  z = l_1 sin q_2 - l_2 cos q_3,  r = l_1 cos q_2 + l_2 sin q_3.

Links are uniform rods with balanced weight. Within a few millimetres around a posture the arm has the effective mass
M = J^-T I J^-1 (3 x 3) at its tip, with I the inertia of links and rotors in the angles and J the Jacobian of the
tip. A spring and a damper join tip and stylus; skin and arm of the hand follow, each as 3 x 3 matrices. This chain of
three points is the linear plant. Its outputs are the accelerations of the stylus along the surface normal and two
tangents.
"""

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from transopt.base.errors import InputError
from transopt.base.section import Finite, NonNegative, Positive, Section
from transopt.base.signals import FloatArray
from transopt.plant.hand import HandSection
from transopt.plant.kind import PlantKind, Share
from transopt.plant.motor import Tip
from transopt.plant.state_space import StateSpace

MOTORS = 3
MAX_CONDITION = 100.0  # of the Jacobian [m/rad]: nearer to singular, the arm hardly moves in some direction
COMPLEX_STEP = 1e-30  # of an angle [rad], for complex-step derivatives, which have no cancellation
MAX_PLACES = 32  # largest number of postures, and of normals
Triple = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Three = Annotated[list[Positive], Field(min_length=3, max_length=3)]


class LinkagePart(Section):
    """Lengths and masses of an arm.

    Attributes
    ----------
    upper_arm_m : from shoulder to elbow.
    forearm_m : from elbow to stylus.
    upper_arm_kg : of a uniform rod.
    forearm_kg : of a uniform rod.
    base_kg_m2 : inertia of all that turns about the vertical beside the two rods.
    """

    upper_arm_m: Positive
    forearm_m: Positive
    upper_arm_kg: Positive
    forearm_kg: Positive
    base_kg_m2: NonNegative = 0.0

    def tip_m(self, q: FloatArray) -> FloatArray:
        """(3,) position of the tip at the angles q (3,) [rad]."""
        reach = self.upper_arm_m * np.cos(q[1]) + self.forearm_m * np.sin(q[2])
        height = self.upper_arm_m * np.sin(q[1]) - self.forearm_m * np.cos(q[2])
        return np.array([reach * np.cos(q[0]), reach * np.sin(q[0]), height])

    def jacobian(self, q: FloatArray) -> FloatArray:
        """(3, 3) derivative of the tip's position by the angles [m/rad]."""
        (s1, s2, s3), (c1, c2, c3) = np.sin(q), np.cos(q)
        upper, fore = self.upper_arm_m, self.forearm_m
        reach = upper * c2 + fore * s3
        return np.array(
            [
                [-reach * s1, -upper * s2 * c1, fore * c3 * c1],
                [reach * c1, -upper * s2 * s1, fore * c3 * s1],
                [0.0 * reach, upper * c2, fore * s3],
            ]
        )

    def inertia(self, q: FloatArray) -> FloatArray:
        """(3, 3) inertia of the links in the angles [kg m^2], from the kinetic energy of the two rods."""
        upper, fore, m1, m2 = self.upper_arm_m, self.forearm_m, self.upper_arm_kg, self.forearm_kg
        c2, s3 = np.cos(q[1]), np.sin(q[2])
        turning = self.base_kg_m2 + m1 * upper**2 * c2**2 / 3
        turning = turning + m2 * (upper**2 * c2**2 + upper * fore * c2 * s3 + fore**2 * s3**2 / 3)
        joined = m2 * upper * fore * np.sin(q[2] - q[1]) / 2
        lifted, bent = (m1 / 3 + m2) * upper**2, m2 * fore**2 / 3
        nothing = 0.0 * joined
        return np.array([[turning, nothing, nothing], [nothing, lifted, joined], [nothing, joined, bent]])

    def centrifugal(self, q: FloatArray, rate: FloatArray) -> FloatArray:
        """(3,) centrifugal and Coriolis torques (dI/dt) q' - grad (q' I q') / 2 [N m]."""
        by_angle = [self.inertia(q + 1j * COMPLEX_STEP * turn).imag / COMPLEX_STEP for turn in np.eye(3)]
        changing = sum(each * speed for each, speed in zip(by_angle, rate, strict=True))
        return np.asarray(changing @ rate - np.array([rate @ each @ rate for each in by_angle]) / 2)


@dataclass(frozen=True)
class Place:
    """Posture of the arm and normal of the surface at which a tap takes place.

    Attributes
    ----------
    posture_rad : (3,) angles of the arm.
    normal : (3,) unit vector in the frame of the base, out of the object.
    """

    posture_rad: FloatArray
    normal: FloatArray

    @cached_property
    def frame(self) -> FloatArray:
        """(3, 3) the normal and two tangents, row by row; the first tangent is horizontal."""
        level = np.cross([0.0, 0.0, 1.0], self.normal)
        if np.linalg.norm(level) < 1e-6:  # floor or ceiling: every tangent is horizontal
            level = np.array([1.0, 0.0, 0.0]) - self.normal[0] * self.normal
        first = level / np.linalg.norm(level)
        return np.array([self.normal, first, np.cross(self.normal, first)])


class Arm(PlantKind):
    """Three motors, a serial arm, stylus and hand, at several postures and surface normals.

    Attributes
    ----------
    linkage : lengths and masses of the arm.
    torque_Nm_A : torque of each motor per ampere.
    rotor_kg_m2 : rotor inertia of each motor.
    ratios : turns of each motor's shaft per turn of its joint.
    stiffness_N_m : spring of cables and links between the arm's tip and the stylus, the same in all directions.
    damping_N_s_m : damper between the arm's tip and the stylus.
    stylus_mass_kg : mass of the stylus.
    hand : skin and arm of the hand along the stylus.
    across : stiffness and damping of hand and skin across the stylus over those along it.
    stylus : direction of the stylus in the frame of the base.
    postures_deg : angles of the arm, posture by posture.
    normals : normals of the surfaces, in the frame of the base, out of the object.
    motor_shares : share of the transient limit that each motor has, where they are not equally strong.
    """

    driven_at_tip: ClassVar[bool] = False

    kind: Literal["arm"]
    linkage: LinkagePart
    torque_Nm_A: Three
    rotor_kg_m2: Three
    ratios: Three
    stiffness_N_m: Positive
    damping_N_s_m: NonNegative
    stylus_mass_kg: Positive
    hand: HandSection
    across: Positive = 1.0
    stylus: Triple
    postures_deg: Annotated[list[Triple], Field(min_length=1, max_length=MAX_PLACES)]
    normals: Annotated[list[Triple], Field(min_length=1, max_length=MAX_PLACES)]
    motor_shares: Annotated[list[Share], Field(min_length=3, max_length=3)] = Field(
        default_factory=lambda: [1.0, 1.0, 1.0]
    )

    @field_validator("normals")
    @classmethod
    def _directed(cls, normals: list[list[float]]) -> list[list[float]]:
        if any(not np.linalg.norm(normal) > 0 for normal in normals):
            raise ValueError("a normal of length zero: give a direction, as [0.0, 0.0, 1.0] for a table")
        return normals

    @model_validator(mode="after")
    def _can_move(self) -> Self:
        if not np.linalg.norm(self.stylus) > 0:
            raise ValueError(
                "stylus: a direction of length zero: give one, as [0.0, 0.0, -1.0] for an upright stylus"
            )
        for j, posture in enumerate(self.postures_deg):
            condition = float(np.linalg.cond(self.linkage.jacobian(np.radians(posture))))
            if not condition <= MAX_CONDITION:
                raise ValueError(
                    f"postures_deg {j + 1}: singular: the Jacobian's condition is {condition:.3g}, at most "
                    f"{MAX_CONDITION:g}: bend the elbow, or move the tip away from the axis of the base"
                )
        return self

    @property
    def shares(self) -> list[float]:
        return self.motor_shares

    @property
    def directions(self) -> int:
        return MOTORS

    @property
    def places(self) -> tuple[tuple[int, int], ...]:
        """Every normal with every posture, by number from 1, the normals outermost."""
        normals, postures = (range(1, len(each) + 1) for each in (self.normals, self.postures_deg))
        return tuple(itertools.product(normals, postures))

    def place(self, normal: float = 1, posture: float = 1) -> Place:
        """A normal and a posture, by number from 1; 1.5 lies half-way between the first and the second."""
        direction = _at(self.normals, normal)
        return Place(np.radians(_at(self.postures_deg, posture)), direction / np.linalg.norm(direction))

    def normal_along(self, normal: FloatArray) -> float:
        """Place along the list of normals, from 1, that is nearest to a direction (3,)."""
        nodes = np.array([self.place(j + 1).normal for j in range(len(self.normals))])
        direction = np.asarray(normal, dtype=float)
        return _along(nodes, direction / np.linalg.norm(direction))

    def posture_along(self, posture_rad: FloatArray) -> float:
        """Place along the list of postures, from 1, that is nearest to the angles (3,) [rad]."""
        return _along(np.radians(self.postures_deg), np.asarray(posture_rad, dtype=float))

    def torques_Nm_A(self) -> FloatArray:
        """(3,) torque at each joint per ampere."""
        return np.asarray(np.array(self.torque_Nm_A) * self.ratios)

    def joint_inertia(self, q: FloatArray) -> FloatArray:
        """(3, 3) inertia of links and rotors in the angles [kg m^2]."""
        return np.asarray(self.linkage.inertia(q) + np.diag(np.array(self.rotor_kg_m2) * np.array(self.ratios) ** 2))

    def links(self, grip_N: float) -> tuple[list[FloatArray], list[FloatArray]]:
        """Stiffness and damping (3, 3) in the base's frame: tip to stylus, skin, arm of the hand.

        Raises
        ------
        InputError : a hand that is not passive at this grip.
        """
        along = np.array(self.stylus) / np.linalg.norm(self.stylus)
        onto = np.outer(along, along)
        shape = onto + self.across * (np.eye(3) - onto)
        pairs = [self.hand.skin(grip_N), self.hand.arm(grip_N)]
        for name, value in [("stiffness", each.stiffness_N_m) for each in pairs] + [
            ("damping", each.damping_N_s_m) for each in pairs
        ]:
            if not 0 <= value < np.inf:
                raise InputError(f"model.hand: {name} {value:g}: must be >= 0 and finite (passive)")
        K = [self.stiffness_N_m * np.eye(3), *(each.stiffness_N_m * shape for each in pairs)]
        B = [self.damping_N_s_m * np.eye(3), *(each.damping_N_s_m * shape for each in pairs)]
        return K, B

    def hand_mass_kg(self, grip_N: float) -> float:
        """Mass of the hand.

        Raises
        ------
        InputError : a mass that is not > 0 at this grip.
        """
        mass = self.hand.line("mass_kg").at(grip_N)
        if not 0 < mass < np.inf:
            raise InputError(f"model.hand.mass_kg = {mass:g} kg at {grip_N:g} N: must be > 0 and finite")
        return mass

    def at_tip(self, place: Place) -> tuple[FloatArray, FloatArray]:
        """Effective mass of the arm at its tip [kg] and force per current [N/A], (3, 3) in the surface's frame."""
        q = place.posture_rad
        inverse = np.linalg.inv(place.frame @ self.linkage.jacobian(q))  # joint rates per velocity of the tip
        return inverse.T @ self.joint_inertia(q) @ inverse, inverse.T * self.torques_Nm_A()

    def plant(self, grip_N: float, tip: Tip | None = None, *, struck: bool = False) -> StateSpace:
        """The linear plant at the first posture and normal."""
        return self.plant_at(grip_N, self.place())

    def plant_at(self, grip_N: float, place: Place) -> StateSpace:
        """The linear plant around a place: three currents to the stylus' acceleration along normal and tangents.

        States: tip minus stylus, stylus minus hand, hand (3 each), then the velocities of the three points.

        Raises
        ------
        InputError : a hand that is not passive, or a grip of zero.
        """
        if not grip_N > 0:
            raise InputError("grid.grips_N: model.kind = arm is held by a hand: give grips above 0")
        frame, (mass, force) = place.frame, self.at_tip(place)
        K, B = ([frame @ each @ frame.T for each in of_link] for of_link in self.links(grip_N))
        masses = [mass, self.stylus_mass_kg * np.eye(3), self.hand_mass_kg(grip_N) * np.eye(3)]
        A, one = np.zeros((18, 18)), np.eye(3)
        points = [slice(9 + 3 * j, 12 + 3 * j) for j in range(3)]
        for j in range(3):
            stretch, nearer = slice(3 * j, 3 * j + 3), points[j]
            further = points[j + 1] if j < 2 else None
            A[stretch, nearer] = one
            pulled = [(nearer, -1.0, masses[j])]
            if further is not None:
                A[stretch, further] = -one
                pulled.append((further, 1.0, masses[j + 1]))
            for point, sign, body in pulled:
                A[point, stretch] += sign * np.linalg.solve(body, K[j])
                A[point, nearer] += sign * np.linalg.solve(body, B[j])
                if further is not None:
                    A[point, further] -= sign * np.linalg.solve(body, B[j])
        drive = np.zeros((18, 3))
        drive[points[0]] = np.linalg.solve(mass, force)
        return StateSpace(A, drive, A[points[1]].copy(), np.zeros((3, 3)))


def _at(nodes: list[list[float]], number: float) -> FloatArray:
    """(3,) point of a list, by number from 1, or between two of them."""
    first = int(number)
    share, start = number - first, np.array(nodes[first - 1])
    return start if share == 0 else start + share * (np.array(nodes[first]) - start)


def _along(nodes: FloatArray, wanted: FloatArray) -> float:
    """Place on the line through nodes (k, 3), by number from 1, that is nearest to a point (3,)."""
    best, found = np.inf, 1.0
    for j, (start, end) in enumerate(itertools.pairwise(nodes), start=1):
        way = end - start
        share = float(np.clip((wanted - start) @ way / (way @ way), 0.0, 1.0))
        off = float(np.linalg.norm(start + share * way - wanted))
        if off < best:
            best, found = off, j + share
    return found
