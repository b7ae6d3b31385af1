"""The convex limit that takes the temperature's place in the lower bound on J: whatever is admissible keeps it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import PWM_RIPPLE_A, CoilModel, following_square_mean
from transopt.plant.time_grid import TimeGrid
from transopt.problem.heat import Budget
from transopt.problem.limits.temperature import TemperatureLimit, temperature_limit

COMMANDS = 25  # by lot for each coil
ROUNDING = 1e-9  # of the headroom


@dataclass(frozen=True)
class Drawn:
    """A coil by lot, and what it is asked for: one tap, or taps that repeat for ever."""

    coil: CoilModel
    amplifier: Amplifier
    grid: TimeGrid
    budget: Budget

    @property
    def limit(self) -> TemperatureLimit:
        return temperature_limit(self.coil, self.amplifier, self.grid, self.budget)

    def currents(self, commands: np.ndarray) -> np.ndarray:
        """(M, N) at the switching instants."""
        decay = np.exp(-self.amplifier.rate_rad_s * self.grid.dt_s)
        found = np.zeros_like(commands)
        for k in range(commands.shape[1] - 1):
            found[:, k + 1] = decay * found[:, k] + (1 - decay) * commands[:, k]
        return found

    def hottest_C(self, commands: np.ndarray) -> np.ndarray:
        """(M,) true temperature at its highest: the copper warms within the steps too, and |i| turns exactly."""
        N, dt = self.grid.stages, self.grid.dt_s
        # Before the first command is felt the ripple heats alone.
        steps = np.append(self.grid.delay_s, np.full(N, dt))
        felt = following_square_mean(self.currents(commands), commands, self.amplifier.rate_rad_s * steps[1:])
        heat = np.concatenate([np.full((len(commands), 1), PWM_RIPPLE_A**2), felt], axis=1)
        if self.budget.tap_rate_Hz is None:
            winding, _ = self.coil.simulate(heat, steps)
            return np.asarray(winding[:, 1:].max(axis=1))
        pause = 1 / self.budget.tap_rate_Hz - N * dt
        idle = np.full(len(commands), self.budget.pause_A)
        winding, _ = self.coil.steady_course(felt, steps[1:], pause, idle)
        return np.asarray(winding.max(axis=1))

    def excess(self, commands: np.ndarray) -> np.ndarray:
        """(M,) by how much the relaxed limit is left, of its largest headroom; negative inside."""
        model = self.limit.relaxed().model
        rises = [
            model.rise(model.heating.mean_square(i, c))[1:, 0]
            for i, c in zip(self.currents(commands), commands, strict=True)
        ]
        return np.asarray((np.array(rises) - model.headroom_K).max(axis=1) / np.abs(model.headroom_K).max())


def drawn(seed: int) -> Drawn:
    """Time constants from a tenth of the horizon to many periods, one and two nodes, repeated or not."""
    random = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    dt, N = between(2e-5, 1e-3), int(random.integers(3, 40))
    grid = TimeGrid(dt, N, 3e-4, float(random.choice([0.0, 0.68, 2.999])) * dt)
    repeated, nodes = seed % 2 == 0, 1 + seed // 2 % 2
    period = (N + 4) * dt * (1 + between(1e-3, 300.0))
    rest, limit = random.uniform(-20.0, 60.0), random.uniform(80.0, 200.0)
    start = limit if random.random() < 0.2 else random.uniform(rest, limit)
    coil = CoilModel(
        R_ohm=between(0.1, 30.0),
        R_wh_K_W=between(0.3, 30.0),
        R_ha_K_W=between(0.3, 100.0),
        tau_w_s=between(N * dt / 10, 3000.0),
        tau_h_s=between(N * dt / 10, 30000.0),
        limit_C=limit,
        ambient_C=rest,
        start_winding_C=start,
        start_housing_C=random.uniform(rest, min(start, limit - 5)) if start > rest else start,
        nodes=nodes,
    )
    headroom = between(1e-3, 1.0) * (limit - rest) if random.random() < 0.3 and not repeated else None
    budget = Budget(headroom_K=headroom, tap_rate_Hz=1 / period if repeated else None)
    return Drawn(coil, Amplifier(between(30.0, 1e5), grid.delay_s, 1e9), grid, budget)


def commands(random: np.random.Generator, N: int) -> np.ndarray:
    """(COMMANDS, N) of every kind: noise, steps, held, single ticks, to one side or both."""
    noise = random.standard_normal((COMMANDS, N))
    held = np.cumsum(noise, axis=1)
    single = noise * (random.random((COMMANDS, N)) < 0.1)
    kinds = np.stack([noise, np.abs(noise), held, np.abs(held), single + 1e-3 * noise, np.ones_like(noise)])
    return np.asarray(kinds[random.integers(0, len(kinds), COMMANDS), np.arange(COMMANDS)])


def touching(case: Drawn, shapes: np.ndarray) -> np.ndarray:
    """The commands (M, N) scaled, each by bisection, until the true temperature just keeps the limit."""
    limit = case.limit.limit_C
    low, high = np.zeros(len(shapes)), np.ones(len(shapes))
    for _ in range(60):
        cool = case.hottest_C(high[:, None] * shapes) <= limit
        if not cool.any():
            break
        high[cool] *= 4.0
    for _ in range(45):
        middle = (low + high) / 2
        cool = case.hottest_C(middle[:, None] * shapes) <= limit
        low, high = np.where(cool, middle, low), np.where(cool, high, middle)
    return np.asarray(low[:, None] * shapes)


def tried(seeds: range) -> Iterator[tuple[Drawn, np.ndarray]]:
    """Each case whose ripple alone is no reason to refuse it, with its commands at the limit."""
    for seed in seeds:
        case = drawn(seed)
        if case.hottest_C(np.zeros((1, case.grid.stages)))[0] < case.limit.limit_C:
            yield case, touching(case, commands(np.random.default_rng(seed), case.grid.stages))


def kept_by_all(seeds: range) -> tuple[int, float]:
    """How many commands were tried, and the largest excess over the relaxed limit."""
    found = [case.excess(at_limit) for case, at_limit in tried(seeds)]
    return sum(each.size for each in found), max(float(each.max()) for each in found)


def test_a_command_whose_true_temperature_touches_the_limit_keeps_the_relaxed_one() -> None:
    count, worst = kept_by_all(range(25))
    assert count >= 400
    assert worst <= ROUNDING


@pytest.mark.long
@pytest.mark.parametrize("first", range(1000, 1440, 40))
def test_ten_thousand_commands_at_the_limit_keep_the_relaxed_one(first: int) -> None:
    count, worst = kept_by_all(range(first, first + 40))
    assert count >= 900
    assert worst <= ROUNDING


@pytest.mark.parametrize("nodes", [1, 2])
def test_taps_that_repeat_leave_the_relaxed_limit_little_room(nodes: int) -> None:
    """A winding whose time constants are long beside the period cools by little in between."""
    slow = CoilModel(2.18, 3.1, 14.0, 12.0, 612.0, limit_C=100.0, nodes=nodes)
    grid = TimeGrid(1e-4, 100, 3e-4, 0.0)
    case = Drawn(slow, Amplifier(1050.0, 0.0, 6.0), grid, Budget(tap_rate_Hz=16.0))
    at_limit = touching(case, np.ones((1, 100)))
    assert -5e-3 < case.excess(at_limit)[0] < 0
