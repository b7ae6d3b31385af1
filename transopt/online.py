"""One tap solved anew for what was measured: speed, grip and the coil's temperature.

A library's blend between nodes is feasible but not optimal, and knows one start temperature. Here the problem of its
nodes is posed for the measured point and solved by the compiled interior point, with the certificate of an entry.
Nothing loads CasADi: stage data are those of `stagewise`, which a test holds to the CasADi statement.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from transopt.certify import certify, inside
from transopt.discretise import StageModel, discretise
from transopt.errors import InputError
from transopt.library import Library, Waveform, interpolation_weights, speed_weights
from transopt.linear import LinearStage, linear_stage
from transopt.models import StateSpace
from transopt.native import ACCURACY, MOST_STATES, SOLVED, Buffers, LinearPass, available, interior_point
from transopt.parts import encoder_course, leave_out, pressing, reference_course
from transopt.problem import Certificate, Multipliers, TransientProblem
from transopt.signals import FloatArray
from transopt.stagewise import runtime_stages, without_limits
from transopt.thermal import CoilModel

TOLERANCE = 1e-9  # of gap and residuals: three digits to the certificate's, as in the designer
MOST_ITERATIONS = 60  # a tap takes 10 to 30; who needs more gets the blend
MOST_MASKS = 3  # solves until the wall pushes exactly where it was assumed to
FAMILIES = 64  # grips whose stage models are kept


@dataclass(frozen=True)
class Tap:
    """What to play for one measured tap.

    Attributes
    ----------
    wave : the command, with what was clamped, as the library's own blend has it.
    certificate : of the optimum; None where the blend is played, or nothing.
    remark : why the blend is played instead of an optimum; empty for an optimum.
    elapsed_s : from the call to the answer, certificate included.
    """

    wave: Waveform
    certificate: Certificate | None
    remark: str
    elapsed_s: float

    @property
    def solved(self) -> bool:
        return self.certificate is not None


@dataclass(frozen=True)
class _Found:
    command_A: FloatArray
    multipliers: Multipliers
    proof: Certificate


class Online:
    """The optimum for a measured tap, by a solver whose memory is laid out once; for one thread at a time.

    Parameters
    ----------
    library : references, limits, grid, start temperatures. A speed between its nodes has the reference that
        `transopt.reference.between` states.
    plant : device of any grip on the library's grid, `Scene.plant` for a library's own scene.
    spread : further devices that a robust library's command shall serve at a grip; none without it.

    Raises
    ------
    InputError : the extension is not built, or the problem has too many states for it.
    """

    def __init__(
        self,
        library: Library,
        plant: Callable[[float], StateSpace],
        spread: Callable[[float], tuple[StateSpace, ...]] = lambda grip_N: (),
    ) -> None:
        if not available:
            raise InputError("online: the solver's extension is not built; install again where there is a C compiler")
        self._library, self._plant, self._spread = library, plant, spread
        self._coil = library.coil()
        self._stages: dict[float, tuple[StageModel, ...]] = {}
        self._buffers: dict[tuple[tuple[str, int], ...], Buffers] = {}
        fastest, firmest = float(library.speeds_m_s[-1]), float(library.grips_N[-1])
        problem = self._posed(fastest, firmest, self._coil)
        sizes = runtime_stages(problem).sizes
        states = sizes["states"] + sizes["nodes"]
        if states > MOST_STATES:
            raise InputError(f"online: the problem has {states} states, limit {MOST_STATES}: spread fewer devices")
        # Memory of all that a tap can come to: with and without the temperature.
        for each in (problem, replace(problem, thermal=None)):
            self._by_interior_point(each)

    def _devices(self, grip_N: float) -> tuple[StageModel, ...]:
        """The device of a grip and those of its spread, discretised."""
        found = self._stages.get(grip_N)
        if found is None:
            library = self._library
            amplifier, dt, position = library.amplifier(), library.meta["dt_s"], library.meta["feedback"] is not None
            plants = (self._plant(grip_N), *self._spread(grip_N))
            found = tuple(discretise(plant, amplifier, dt, position=position) for plant in plants)
            if len(self._stages) >= FAMILIES:
                del self._stages[next(iter(self._stages))]
            self._stages[grip_N] = found
        return found

    def _posed(self, speed_m_s: float, grip_N: float, coil: CoilModel | None) -> TransientProblem:
        library = self._library
        by_speed = speed_weights(library.speeds_m_s, speed_m_s)
        stage, *spread = self._devices(grip_N)
        problem = library.posed(speed_m_s, by_speed, stage, tuple(spread), coil)
        if np.any(library.correction_m_s2):
            # What the device was found to need at the nodes, blended as it is between them.
            own = interpolation_weights(library.speeds_m_s, speed_m_s)
            by_grip = interpolation_weights(library.grips_N, grip_N)
            correction = np.einsum("v,g,vgk->k", own, by_grip, library.correction_m_s2)
            problem = replace(problem, reference_m_s2=problem.reference_m_s2 + correction)
        if problem.wall is None:
            return problem
        return pressing(problem, reference_course(problem.grid, problem.reference_m_s2))

    def solve(
        self, speed_m_s: float, grip_N: float, winding_C: float | None = None, housing_C: float | None = None
    ) -> Tap:
        """The certified optimum for one tap, or the library's blend with the reason why.

        Parameters
        ----------
        winding_C, housing_C : temperatures at the start; the library's own without them. Without a housing's the
            library's is taken, but none that is hotter than the winding.

        Raises
        ------
        InputError : speed, grip or temperature is not a finite number.
        """
        start = time.perf_counter()
        wave = self._library.at(speed_m_s, grip_N)
        coil, hot = self._heated(winding_C, housing_C)
        if wave.silent or hot:
            remark = hot or "nothing to play: too little grip or speed"
            return Tap(wave, None, remark, time.perf_counter() - start)
        found = self._optimum(self._posed(wave.speed_m_s, wave.grip_N, coil))
        if isinstance(found, str):
            return Tap(wave, None, found, time.perf_counter() - start)
        problem, answer = found
        transient = problem.transient_command(answer.command_A)
        wave = replace(wave, command_A=answer.command_A, transient_command_A=transient)
        return Tap(wave, answer.proof, "", time.perf_counter() - start)

    def _heated(self, winding_C: float | None, housing_C: float | None) -> tuple[CoilModel | None, str]:
        """The coil with its measured start, and why that start allows no tap; or empty."""
        coil = self._coil
        if coil is None or winding_C is None:
            return coil, ""
        housing = min(coil.start_housing_C, winding_C) if housing_C is None else housing_C
        if not (np.isfinite(winding_C) and np.isfinite(housing)):
            raise InputError(f"winding {winding_C} C, housing {housing} C: both must be finite numbers")
        if winding_C > coil.limit_C:
            return coil, f"winding {winding_C:.4g} C is above its limit {coil.limit_C:g} C: let the motor cool"
        return replace(coil, start_winding_C=winding_C, start_housing_C=housing), ""

    def _optimum(self, problem: TransientProblem) -> tuple[TransientProblem, _Found] | str:
        """The problem, its wall pressing where the answer makes it press, and that answer; or why there is none."""
        for _ in range(MOST_MASKS):
            found = self._solved(problem)
            if found is None or not found.proof.accepted:
                return "no certified optimum"
            if problem.wall is None:
                return problem, found
            again = pressing(problem, encoder_course(problem, found.command_A))
            assert again.wall is not None
            first = max(problem.free_stages - 1, 0)  # the tick before the hand-over, which the prefilter remembers
            if np.array_equal(again.wall.pressing[first:], problem.wall.pressing[first:]):
                return problem, found
            problem = again
        return "the wall pushes elsewhere after every solve"

    def _solved(self, problem: TransientProblem) -> _Found | None:
        """The smallest problem that has the answer (DESIGN 4): without limits, without the temperature, whole."""
        if problem.reference_is_zero:
            return self._judged(problem, np.zeros(problem.grid.stages), Multipliers.zero(problem))
        small = leave_out(problem).problem
        stage = linear_stage(small)
        linear = LinearPass(without_limits(small, stage))
        if linear.solve(TOLERANCE).code in (SOLVED, ACCURACY):
            free = linear.command_A()
            if inside(problem, free):
                multipliers = replace(Multipliers.zero(problem), hand_over=linear.hand_over())
                found = self._judged(problem, free, multipliers)
                if found.proof.accepted:
                    return found
        answer = self._by_interior_point(replace(small, thermal=None), stage)
        if small.thermal is not None and answer is not None and not inside(problem, answer[0], only="coil"):
            answer = self._by_interior_point(small, stage)
        return None if answer is None else self._judged(problem, *answer)

    def _by_interior_point(
        self, problem: TransientProblem, stage: LinearStage | None = None
    ) -> tuple[FloatArray, Multipliers] | None:
        stages = runtime_stages(problem, stage)
        key = tuple(sorted(stages.sizes.items()))
        if key not in self._buffers:
            self._buffers[key] = Buffers(stages.sizes)
        buffers = self._buffers[key]
        answer = interior_point(stages, buffers, tolerance=TOLERANCE, max_iterations=MOST_ITERATIONS)
        if answer.code not in (SOLVED, ACCURACY):
            return None
        by_row = buffers.upper - buffers.lower
        return stages.command(buffers.movement), stages.multipliers(by_row, buffers.gradient)

    def _judged(self, problem: TransientProblem, command_A: FloatArray, multipliers: Multipliers) -> _Found:
        """With its certificate; where the temperature binds, the convex problem bounds J from below."""
        proof = certify(problem, command_A, multipliers)
        if problem.thermal is not None and proof.finite and not np.isfinite(proof.lower_bound):
            relaxed = replace(problem, thermal=problem.thermal.relaxed(problem.limits.current_A))
            bound = self._by_interior_point(relaxed)
            if bound is not None:
                proof = replace(proof, lower_bound=certify(relaxed, *bound).lower_bound)
        return _Found(command_A, multipliers, proof)
