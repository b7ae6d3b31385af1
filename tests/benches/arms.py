"""Problems of several motors drawn at random: chains of three points in space, and arms in drawn postures."""

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.arm import MAX_CONDITION, Arm, LinkagePart, Place
from transopt.plant.discretise import discretise
from transopt.plant.hand import HandSection
from transopt.plant.state_space import StateSpace
from transopt.plant.time_grid import TimeGrid
from transopt.problem.limits import limits_of
from transopt.problem.limits.command import CommandLimit
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.objective.error_term import plain, rapid
from transopt.problem.objective.target import Target
from transopt.problem.objective.weighting import highpass
from transopt.problem.problem import TransientProblem

DT_S = 1e-4
HAND = HandSection(
    mass_kg=0.010,
    skin_stiffness_N_m={"constant": 3000.0, "per_newton": 2000.0},
    skin_damping_N_s_m={"constant": 6.0, "per_newton": 3.0},
    arm_stiffness_N_m={"constant": 160.0, "per_newton": 110.0},
    arm_damping_N_s_m={"constant": 6.0, "per_newton": 3.0},
)


def phantom(**changed: object) -> Arm:
    """The arm of the built-in scene, some of it changed."""
    stated = {
        "kind": "arm",
        "linkage": LinkagePart(
            upper_arm_m=0.215, forearm_m=0.170, upper_arm_kg=0.030, forearm_kg=0.020, base_kg_m2=2e-4
        ),
        "torque_Nm_A": [23.4e-3] * 3,
        "rotor_kg_m2": [1.03e-6] * 3,
        "ratios": [11.0] * 3,
        "stiffness_N_m": 6e4,
        "damping_N_s_m": 8.0,
        "stylus_mass_kg": 0.026,
        "hand": HAND,
        "across": 0.7,
        "stylus": [0.5, 0.0, -0.866],
        "postures_deg": [[0.0, 25.0, 35.0]],
        "normals": [[0.0, 0.0, 1.0]],
    }
    return Arm(**{**stated, **changed})  # type: ignore[arg-type]


def drawn_place(arm: Arm, lot: np.random.Generator) -> Place:
    """A posture of any condition that an arm may have, near-singular ones among them, and any normal."""
    while True:
        posture = lot.uniform([-1.5, -1.4, -1.4], [1.5, 1.4, 1.4])
        if np.linalg.cond(arm.linkage.jacobian(posture)) <= MAX_CONDITION:
            normal = lot.standard_normal(3)
            return Place(posture, normal / np.linalg.norm(normal))


def _spread(size: float, p: int, lot: np.random.Generator) -> FloatArray:
    """A symmetric positive matrix (p, p) whose values lie within a factor of two of a size."""
    basis, _ = np.linalg.qr(lot.standard_normal((p, p)))
    return np.asarray(basis @ np.diag(size * np.exp(lot.uniform(-0.7, 0.7, p))) @ basis.T)


def drawn_chain(lot: np.random.Generator, motors: int, p: int = 3) -> StateSpace:
    """Three points in space, joined by drawn links, the first of them pushed by any number of motors."""
    masses = [_spread(size, p, lot) for size in (0.02, 0.03, 0.01)]
    K, B = ([_spread(size, p, lot) for size in sizes] for sizes in ((4e4, 8e3, 5e2), (8.0, 15.0, 15.0)))
    A, one = np.zeros((6 * p, 6 * p)), np.eye(p)
    points = [slice((3 + j) * p, (4 + j) * p) for j in range(3)]
    for j in range(3):
        stretch = slice(j * p, (j + 1) * p)
        ends = [(points[j], 1.0, masses[j])]
        if j < 2:
            ends.append((points[j + 1], -1.0, masses[j + 1]))
        for point, sign, _ in ends:
            A[stretch, point] = sign * one
        for point, sign, mass in ends:
            A[point, stretch] -= sign * np.linalg.solve(mass, K[j])
            for other, its_sign, _ in ends:
                A[point, other] -= sign * its_sign * np.linalg.solve(mass, B[j])
    drive = np.zeros((6 * p, motors))
    drive[points[0]] = np.linalg.solve(masses[0], 1.25 * lot.standard_normal((p, motors)))
    return StateSpace(A, drive, A[points[1]].copy(), np.zeros((p, motors)))


def pulse(times_s: FloatArray, peak_m_s2: float = 60.0) -> FloatArray:
    """A decaying ringing from contact on."""
    return np.where(
        times_s > 0, peak_m_s2 * np.exp(-times_s / 4e-3) * np.sin(2 * np.pi * 180 * np.maximum(times_s, 0)), 0.0
    )


def posed(
    plant: StateSpace,
    *,
    stages: int = 80,
    after: int = 60,
    limit_A: float = 2.5,
    weights: tuple[float, ...] = (1.0, 1.0, 1.0),
    shares: tuple[float, ...] = (),
    ideal: bool = False,
    heat_price: float = 0.0,
    rho: float = 1e-3,
    targets: FloatArray | None = None,
    delay_s: float = 68e-6,
) -> TransientProblem:
    """A tap along the first direction, or with `targets` (p, N + M) along all, within boxes on every motor."""
    amplifier = None if ideal else Amplifier(1050.0, delay_s, 6.0)
    grid = TimeGrid(DT_S, stages, 3e-4, 0.0 if ideal else delay_s, after)
    p, L = plant.tracked, grid.before_times_s.size
    if targets is None:
        targets = np.zeros((p, stages + after))
        targets[0] = pulse(np.append(grid.switching_times_s, grid.after_times_s))
    before = np.zeros((p, L))
    before[0] = pulse(grid.before_times_s)
    target = Target(targets[:, :stages], targets[:, stages:], before)
    if p == 1:
        target = target.normal
    current = CurrentLimit(limit_A, shares=shares) if shares else CurrentLimit(limit_A)
    return TransientProblem(
        stage=discretise(plant, amplifier, DT_S),
        grid=grid,
        target=target,
        terms=(plain(0.09, grid, 0.03), rapid(highpass(20.0, DT_S), grid)),
        rho=rho,
        limits=limits_of(current, None if ideal else CommandLimit(6.0)),
        hand_over_samples=10,
        shares=np.array(weights) if p > 1 else None,
        heat_price=heat_price,
    )


def drawn(seed: int, fewest: int = 2) -> TransientProblem:
    """One of the random problems: `fewest` to 4 motors of unequal strength, any weights, any postures of an arm."""
    lot = np.random.default_rng(seed)
    arm = seed % 2 == 0
    motors = 3 if arm else int(lot.integers(fewest, 5))
    plant = drawn_chain(lot, motors)
    if arm:
        device = phantom()
        plant = device.plant_at(float(lot.uniform(0.5, 8.0)), drawn_place(device, lot))
    return posed(
        plant,
        limit_A=float(np.exp(lot.uniform(-1.5, 1.5))),
        weights=(1.0, float(lot.uniform(0, 3)), float(10 ** lot.uniform(-2, 1))),
        shares=tuple(lot.uniform(0.2, 1.0, motors)) if motors > 1 else (),
        ideal=bool(lot.random() < 0.2),
        heat_price=float(lot.choice([0.0, 1e-5])),
        delay_s=float(lot.choice([68e-6, 9e-4])),
    )
