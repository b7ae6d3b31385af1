"""The virtual wall: its law, the hand-over, the closed loop in continuous time, walled libraries."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from problems.stress.judge import played
from tests.conftest import WalledMaker
from transopt.base.errors import InputError
from transopt.base.recursions import LinearSystem
from transopt.design.optimum import optimum
from transopt.plant.amplifier import Amplifier, prefilter
from transopt.plant.discretise import discretise
from transopt.plant.wall import FeedbackLoop, Wall
from transopt.problem.answer import Multipliers, Status
from transopt.problem.limits import hand_over
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import linear_stage
from transopt.problem.wall_ticks import pressing
from transopt.proof.certify import certify, reduced_gradient
from transopt.proof.designed import Designed
from transopt.proof.effect import Effect
from transopt.proof.replay import replay
from transopt.references.reference import Reference
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

AMPLIFIER = Amplifier(pole_Hz=1050.0, delay_s=68e-6, command_limit=6.0)
DT_S = 1e-4
COUNT_m = 24.5e-6
WALL = Wall(
    stiffness_N_m=500.0, damping_N_s_m=5.0, force_per_current_N_A=1.25, latency_ticks=1, derivative_filter_Hz=500.0
)


def plain_feedback(wall: Wall, z_m: np.ndarray, approach_m_s: float) -> np.ndarray:
    """(N,) i_fb at the ticks, tick by tick as the docstring of `Wall` states the law."""
    a = np.exp(-2 * np.pi * wall.derivative_filter_Hz * DT_S)
    before, velocity, readings = z_m[0] + approach_m_s * DT_S, -approach_m_s, []
    for z in z_m:
        velocity = a * velocity + (1 - a) * (z - before) / DT_S
        readings.append((z, velocity))
        before = z
    feedback = np.zeros(z_m.size)
    for k in range(z_m.size):
        j = k - wall.latency_ticks
        z, v = readings[j] if j >= 0 else (z_m[0] - j * approach_m_s * DT_S, -approach_m_s)
        if z < 0:
            push = -(wall.stiffness_N_m * z + wall.damping_N_s_m * v) / wall.force_per_current_N_A
            feedback[k] = max(push, 0.0)
    return feedback


def test_a_wall_that_grows_by_itself_stays_within_the_numbers() -> None:
    """Each tick's current throws the encoder back and forth, ten times as far as the tick before."""
    loop = FeedbackLoop(WALL, None, DT_S, np.array([-COUNT_m]), np.array([0.1]))
    encoder = np.array([-COUNT_m])
    largest = 0.0
    for tick in range(2000):
        current = loop.step(encoder)
        encoder = -0.02 * current if tick % 2 else 0.02 * current - COUNT_m
        largest = max(largest, float(current[0]))
    assert 1e99 < largest < 1e101
    assert np.isfinite(encoder).all()


def plain_prefilter(plant_input: np.ndarray) -> np.ndarray:
    p = np.exp(-2 * np.pi * 1050.0 * DT_S)
    return np.array([(i - p * e) / (1 - p) for i, e in zip(plant_input, [0.0, *plant_input[:-1]], strict=True)])


def courses(stages: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """(3, stages) courses that go in, bounce through the surface and shake; their approach speeds (3,)."""
    random = np.random.default_rng(1)
    t = DT_S * (np.arange(stages) - 3)
    speeds = np.array([0.1, 0.25, 0.4])
    shake = 1e-4 * np.cumsum(random.standard_normal((3, stages)), axis=1)
    return -speeds[:, None] * t * np.cos(400 * t) + np.where(t > 0, shake, 0.0), speeds


class TestLaw:
    @pytest.mark.parametrize("latency", [0, 1, 3])
    def test_against_the_law_written_out(self, latency: int) -> None:
        wall = replace(WALL, latency_ticks=latency)
        z, speeds = courses()
        for course, speed in zip(z, speeds, strict=True):
            ours = wall.current(*wall.measured(course, DT_S, speed))
            assert 0 < np.count_nonzero(ours) < ours.size
            np.testing.assert_allclose(ours, plain_feedback(wall, course, speed), atol=1e-12)

    @pytest.mark.parametrize("latency", [0, 1, 4])
    def test_linear_and_its_transpose(self, latency: int) -> None:
        wall = replace(WALL, latency_ticks=latency)
        random = np.random.default_rng(2)
        y, g = random.standard_normal((2, 50))
        y[0] = 0.0  # at the first tick nothing has been played yet
        assert wall.linear(y, DT_S) @ g == pytest.approx(y @ wall.linear_transpose(g, DT_S), rel=1e-12)

    @pytest.mark.parametrize("latency", [0, 1, 3])
    @pytest.mark.parametrize("amplifier", [AMPLIFIER, None])
    def test_the_loop_tick_by_tick_is_the_vectorised_law(self, latency: int, amplifier: Amplifier | None) -> None:
        wall = replace(WALL, latency_ticks=latency)
        z, speeds = courses()
        loop = FeedbackLoop(wall, amplifier, DT_S, z[:, 0], speeds)
        stepped = np.stack([loop.step(z[:, k]) for k in range(z.shape[1])], axis=1)
        for tap in range(3):
            law = plain_feedback(wall, z[tap], speeds[tap])
            expected = law if amplifier is None else plain_prefilter(law)
            np.testing.assert_allclose(stepped[tap], expected, atol=1e-11)
            if amplifier is not None:
                np.testing.assert_allclose(prefilter(law, amplifier, DT_S), expected, atol=1e-11)

    @pytest.mark.usefixtures("way")
    @pytest.mark.parametrize(("latency", "behind"), [(0, 1), (1, 2), (3, 4), (90, 1)])
    @pytest.mark.parametrize("amplifier", [AMPLIFIER, None])
    @pytest.mark.parametrize("count_m", [0.0, COUNT_m])
    def test_a_closed_loop_obeys_law_and_device(
        self, latency: int, behind: int, amplifier: Amplifier | None, count_m: float
    ) -> None:
        """The encoder reads what the device does under the closed commands, and these are what the law asks of it."""
        wall, (nominal, speeds) = replace(WALL, latency_ticks=latency), courses()
        (M, K), random = nominal.shape, np.random.default_rng(latency)
        A, B = 0.3 * random.standard_normal((3, 3)), random.standard_normal((3, 2))
        encoder = 1e-6 * np.append(np.zeros(2), random.standard_normal(3))
        own = random.uniform(-0.1, 0.1, (M, behind + K))
        closed = own.copy()
        first = np.round(nominal[:, 0] / count_m) * count_m if count_m else nominal[:, 0]
        loop = FeedbackLoop(wall, amplifier, DT_S, first, speeds)
        off = loop.close((A, B, encoder), nominal, closed, count_m=count_m)
        acting = np.stack([closed[:, :K], closed[:, 1 : 1 + K]], axis=1)
        device = LinearSystem(A, B, encoder[None, 2:], encoder[None, :2])
        np.testing.assert_allclose(off, device.outputs(acting)[:, 0], rtol=0, atol=1e-15)
        z = nominal + off
        z = np.round(z / count_m) * count_m if count_m else z
        stepped = FeedbackLoop(wall, amplifier, DT_S, first, speeds)
        asked = np.stack([stepped.step(z[:, k]) for k in range(K)], axis=1)
        assert asked.max() > 0.1
        np.testing.assert_allclose(closed[:, behind:], own[:, behind:] + asked, rtol=0, atol=1e-11)
        np.testing.assert_array_equal(closed[:, :behind], own[:, :behind])

    @pytest.mark.usefixtures("way")
    def test_a_closed_loop_that_grows_by_itself_is_not_hidden(self) -> None:
        nominal, commands = np.full((1, 2000), -COUNT_m), np.zeros((1, 2001))
        loop = FeedbackLoop(WALL, None, DT_S, nominal[:, 0], np.array([0.1]))
        off = loop.close((np.array([[-2.0]]), np.array([[1.0]]), np.array([0.0, 1.0])), nominal, commands)
        assert not np.isfinite(off).all()
        assert np.nanmax(commands) < 1e101

    def test_bad_walls_are_refused(self) -> None:
        with pytest.raises(InputError, match="feedback: stiffness_N_m = -1: must be >= 0"):
            replace(WALL, stiffness_N_m=-1.0)
        with pytest.raises(InputError, match="latency_ticks must be >= 0"):
            replace(WALL, latency_ticks=-1)


def rebuilt(problem: TransientProblem, amplifier: Amplifier | None) -> TransientProblem:
    """Pose the walled entry again, through another amplifier."""
    stage = discretise(problem.stage.plant, amplifier, DT_S, position=True)
    grid = replace(problem.grid, delay_s=0.0 if amplifier is None else amplifier.delay_s)
    limits = problem.limits if amplifier is not None else problem.limits.without("command")
    return replace(problem, stage=stage, grid=grid, limits=limits)


class TestHandOver:
    @pytest.mark.parametrize("latency", [0, 1, 3])
    @pytest.mark.parametrize("amplifier", [AMPLIFIER, replace(AMPLIFIER, delay_s=168e-6), None])
    def test_rows_are_the_feedback_of_the_rolled_out_states(
        self, walled: WalledMaker, latency: int, amplifier: Amplifier | None
    ) -> None:
        """Encoder memory, derivative filter, delay line, prefilter: all of it as states, against the plain law."""
        problem = rebuilt(walled(500, 0.4, latency_ticks=latency), amplifier)
        N = problem.grid.stages
        command = np.random.default_rng(4).uniform(-1, 1, N)
        motion = problem.stage.motion(command)
        z = problem.wall.encoder(problem.feedback.course(motion))
        problem = pressing(problem, problem.feedback.course(motion))
        stage = linear_stage(problem)
        x, movement = np.zeros(stage.units.size), np.diff(command, prepend=0.0) / stage.input_scale
        rows, constant = hand_over.rows(problem, stage)
        found = []
        for k in range(N):
            if k >= problem.free_stages:
                j = k - problem.free_stages
                found.append((rows[j] @ x + constant[j]) * stage.input_scale)
            x = stage.A @ x + stage.A[:, -1] * movement[k]
        law = plain_feedback(problem.wall.wall, z, 0.4)
        expected = law if amplifier is None else plain_prefilter(law)
        assert expected[problem.free_stages :].min() > 0.1, "the wall does not push: the test shows nothing"
        np.testing.assert_allclose(found, expected[problem.free_stages :], atol=1e-10)

    def test_encoder_positions_against_the_matrix_exponential(self, walled: WalledMaker) -> None:
        """At the ticks, 32 us before the next switching instant, not at the switching instants."""
        problem = walled(500, 0.4)
        command = np.random.default_rng(5).uniform(-4, 4, 60)
        course = problem.stage.motion(command).encoder_m
        z = fine_loop(problem, command, closed=False)[2]
        assert np.abs(z).max() > 1e-5
        np.testing.assert_allclose(course[:-1], z[1:], atol=1e-13)

    def test_gradient_of_the_hand_overs_lagrangian_by_differences(self, walled: WalledMaker) -> None:
        problem = walled(500, 0.4)
        N = problem.grid.stages
        random = np.random.default_rng(6)
        command, weights = random.uniform(-1, 1, N), random.standard_normal(problem.hand_over_samples)
        problem = pressing(problem, problem.feedback.course(problem.stage.motion(problem.continued(command))))
        multipliers = replace(Multipliers.zero(problem), hand_over=weights)

        def lagrangian(c: np.ndarray) -> float:
            tail = (c - problem.hand_over_command(problem.stage.motion(c)))[problem.free_stages :]
            return problem.objective(c, problem.accelerations(c)) + float(weights @ tail)

        gradient = reduced_gradient(Effect(problem, command), multipliers)
        for k in (0, 300, 585, 589, 590, 597, 599):
            step = np.eye(N)[k]  # quadratic: exact for any step
            difference = (lagrangian(command + step) - lagrangian(command - step)) / 2
            assert gradient[k] == pytest.approx(difference, rel=1e-8, abs=1e-11)

    def test_a_lost_or_flipped_multiplier_is_noticed(self, walled: WalledMaker) -> None:
        designed = optimum(walled(500, 0.4), SolverOptions())
        command, m = designed.solution.command, designed.solution.multipliers
        assert designed.certificate.accepted
        for factor in (0.0, -1.0, 1.01):
            wrong = replace(m, hand_over=factor * m.hand_over)
            assert not certify(designed.problem, command, wrong).accepted
        moved = command.copy()
        moved[-4] += 1e-4
        assert certify(designed.problem, moved, m).violation("A") >= 0.9e-4


def fine_loop(
    problem: TransientProblem, transient_A: np.ndarray, *, closed: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Total command, y'' at the switching instants and y of the encoder at the ticks, each (N,).

    Nothing of the project but the plant's matrices and z_nom: the delay is a queue on a 4 us grid, which tick
    (100 us) and delay (68 us) are multiples of; the law is written out.
    """
    plant, hand_over, N = problem.stage.plant, problem.wall, transient_A.size
    wall, v_in, per_tick, late = hand_over.wall, hand_over.approach_m_s, 25, 17
    n, w = plant.order, 2 * np.pi * 1050.0
    flow = np.zeros((n + 2, n + 2))
    flow[:n, :n], flow[:n, n : n + 1] = plant.A, plant.B
    flow[n, n], flow[n, n + 1] = -w, w
    step = expm(flow * 4e-6)
    a, p = np.exp(-2 * np.pi * wall.derivative_filter_Hz * DT_S), np.exp(-w * DT_S)

    x = np.zeros(n + 2)  # plant, current, command felt
    total, acceleration, encoder = np.zeros(N), np.zeros(N), np.zeros(N)
    readings: list[tuple[float, float]] = []
    before, velocity, fed_before = hand_over.nominal_m[0] + v_in * DT_S, -v_in, 0.0
    for fine in range((N + 1) * per_tick):
        k, phase = divmod(fine, per_tick)
        if phase == 0 and k < N:
            encoder[k] = plant.Ce[0] @ x[:n]
            z = hand_over.nominal_m[k] + encoder[k]
            velocity = a * velocity + (1 - a) * (z - before) / DT_S
            before = z
            readings.append((z, velocity))
            fed = 0.0
            if closed and k >= wall.latency_ticks:  # earlier readings lie above the surface
                z_read, v_read = readings[k - wall.latency_ticks]
                if z_read < 0:
                    force = -(wall.stiffness_N_m * z_read + wall.damping_N_s_m * v_read)
                    fed = max(force / wall.force_per_current_N_A, 0.0)
            total[k] = transient_A[k] + (fed - p * fed_before) / (1 - p)
            fed_before = fed
        if phase == late and k < N:
            x[n + 1] = total[k]
            acceleration[k] = plant.C[0] @ x[:n] + plant.D[0, 0] * x[n]
        x = step @ x
    return total, acceleration, encoder


def check_closed_loop(problem: TransientProblem) -> Designed:
    """The transient on top of real feedback gives the predicted total command and motion."""
    designed = optimum(problem, SolverOptions())
    assert designed.solution.status is Status.OPTIMAL
    assert designed.certificate.accepted
    final, command = designed.problem, designed.solution.command
    assert final.wall is not None
    predicted, _ = final.stage.rollout(command)
    run = played(final, command)
    assert np.abs(run.command - command).max() <= 1e-9
    assert np.abs(run.acceleration_m_s2 - predicted).max() <= 1e-9 * np.abs(predicted).max()
    assert run.shortfalls(final, command, predicted) == []
    return designed


class TestClosedLoop:
    @pytest.mark.parametrize(
        ("stiffness_N_m", "speed_m_s"),
        [(0, 0.4), (200, 0.1), (200, 0.4), (500, 0.2), (2000, 0.1)],
    )
    def test_sampled_delayed_feedback_reproduces_the_prediction(
        self, walled: WalledMaker, stiffness_N_m: float, speed_m_s: float
    ) -> None:
        """Measured 7e-13 A and 7e-14 of the peak acceleration at most."""
        check_closed_loop(walled(stiffness_N_m, speed_m_s))

    def test_longer_latency_and_whole_delays(self, walled: WalledMaker) -> None:
        check_closed_loop(walled(200, 0.2, 1.0, latency_ticks=3))
        check_closed_loop(rebuilt(walled(500, 0.3, latency_ticks=2), replace(AMPLIFIER, delay_s=168e-6)))
        check_closed_loop(rebuilt(walled(500, 0.3, latency_ticks=0), replace(AMPLIFIER, delay_s=100e-6)))

    @pytest.mark.parametrize(("stiffness_N_m", "speed_m_s"), [(500, 0.4), (2000, 0.1)])
    def test_an_independent_closed_loop(self, walled: WalledMaker, stiffness_N_m: float, speed_m_s: float) -> None:
        """Measured: 2e-13 A, 3e-12 m/s^2."""
        designed = optimum(walled(stiffness_N_m, speed_m_s), SolverOptions())
        problem, command = designed.problem, designed.solution.command
        transient = problem.transient_command(command)
        assert np.abs(command - transient).max() > 0.3, "no feedback: the test shows nothing"
        assert not transient[problem.free_stages :].any()
        total, acceleration, encoder = fine_loop(problem, transient)
        motion = problem.stage.motion(command)
        np.testing.assert_allclose(total, command, rtol=0, atol=1e-8)
        np.testing.assert_allclose(acceleration, motion.acceleration_m_s2, rtol=0, atol=1e-7)
        np.testing.assert_allclose(encoder, problem.feedback.course(motion), rtol=0, atol=1e-12)

    def test_nominal_motion_at_the_ticks(self, references: list[Reference], scene: Scene) -> None:
        """Above the surface before contact, at it at t = 0, going in at the stated speed."""
        grid = scene.time_grid()
        for reference in references:
            ticks = reference.nominal_position_at_ticks_m
            all_ticks, within = grid.all_issue_times_s, ticks[: grid.stages]
            before = all_ticks < 0
            # The hand's share acts before contact too, by less than a nanometre.
            np.testing.assert_allclose(ticks[before], -reference.speed_m_s * all_ticks[before], rtol=0, atol=2e-9)
            assert ticks[3] == pytest.approx(0, abs=1e-12)
            # Between two ticks a switching instant of the same motion.
            late = np.interp(grid.switching_times_s[5:-1], grid.issue_times_s, within)
            np.testing.assert_allclose(late, reference.nominal_position_m[5:-1], atol=2e-7)

    @pytest.mark.parametrize(
        ("stiffness_N_m", "damping_N_s_m", "speed_m_s", "most"),
        [(500, 0.0, 0.4, 0.01), (200, 5.0, 0.4, 0.1), (2000, 5.0, 0.1, 0.6)],
    )
    def test_encoder_counts(
        self, walled: WalledMaker, stiffness_N_m: float, damping_N_s_m: float, speed_m_s: float, most: float
    ) -> None:
        """Measured: 0.26 %, 3.9 % and 21 % of the peak acceleration.

        It is the damper that hears the counts: 5 N s/m answers one count of 24.5 um within a tick by 0.26 A, and
        the prefilter doubles that; the design's prediction leaves the rounding out.
        """
        designed = optimum(walled(stiffness_N_m, speed_m_s, damping_N_s_m=damping_N_s_m), SolverOptions())
        problem, command = designed.problem, designed.solution.command
        (run,) = replay(
            problem.stage,
            problem.grid,
            problem.transient_command(command)[None],
            [problem.target],
            None,
            walls=[problem.wall],
            count_m=COUNT_m,
        )
        predicted, _ = problem.stage.rollout(command)
        off = np.abs(run.acceleration_m_s2 - predicted).max() / np.abs(predicted).max()
        assert 1e-4 < off < most


def test_a_wall_needs_the_encoders_position(walled: WalledMaker) -> None:
    problem = walled(500, 0.4)
    blind = discretise(problem.stage.plant, problem.stage.amplifier, DT_S)
    with pytest.raises(InputError, match="a wall needs the encoder position"):
        replace(problem, stage=blind)
