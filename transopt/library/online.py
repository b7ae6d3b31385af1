"""Solves one tap for its measured speed, grip and coil temperature.

A library's blend between nodes is feasible but not optimal, and assumes one start temperature and one set of limits.
Here the problem of the nodes is posed for the measured point and solved by the compiled interior point, with the
same certificate as an entry: by a standing problem (`standing_tap`) where the taps of the library allow it, else in
general. CasADi is not loaded: the stage data come from `stage_data`, which a test compares with the CasADi statement.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from threading import RLock
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief, cut
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.library.library import Library
from transopt.library.other_limits import with_limits
from transopt.library.place import Place, Waveform, finite, interpolation_weights
from transopt.library.proven import bounded
from transopt.library.standing_tap import MARGIN, StandingTap
from transopt.plant.coil import HOUSING_C, WINDING_C, CoilModel
from transopt.plant.discretise import StageModel
from transopt.plant.state_space import StateSpace
from transopt.plant.wall import reference_course
from transopt.problem.answer import Certificate, Multipliers
from transopt.problem.leave_out import leave_out
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.posing import Posing
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import pressing, pressing_under
from transopt.proof.certify import BINDING_MULTIPLIER
from transopt.proof.effect import TEMPERATURE, Effect, boxes_of, inside
from transopt.solvers.native.extension import (
    ACCURACY,
    MOST_STATES,
    SOLVED,
    available,
    interior_points,
    linear_passes,
)
from transopt.solvers.prove import certified
from transopt.solvers.stage_data import Stages, stages, without_limits

if TYPE_CHECKING:  # which loads pydantic
    from transopt.scene.scene import Scene

TOLERANCE = 1e-9  # on gap and residuals: three digits tighter than the certificate, as in the designer
MOST_ITERATIONS = 60  # a tap takes 10 to 30; beyond this the blend is played
MOST_MASKS = 3  # solves until the assumed pressing of the wall agrees with the answer
STANDING = 8  # number of sets of limits whose standing problems are cached
FAMILIES = 64  # number of grips whose stage models are cached


@dataclass(frozen=True)
class OnlineTap:
    """The waveform to play for one measured tap.

    Attributes
    ----------
    wave : the command, with what was clamped, in the form of the library's own blend.
    certificate : of the optimum; None if the blend or nothing is played.
    remark : why the blend or nothing is played instead of an optimum; empty for an optimum.
    elapsed_s : wall time from the call to the answer, certificate included.
    """

    wave: Waveform
    certificate: Certificate | None
    remark: str
    elapsed_s: float

    __repr__ = brief

    @property
    def solved(self) -> bool:
        return self.certificate is not None


class _Found(NamedTuple):
    command: FloatArray
    proof: Certificate


class Online:
    """Solves for the optimum of a measured tap with memory allocated once.

    Threads may share one: their taps are then solved one after the other. Each with its own solves them side by side.

    Parameters
    ----------
    library : gives references, limits, grid and start temperatures. A speed between its nodes has the reference that
        `transopt.references.reference.between` states.
    plant : makes the device for any grip on the library's grid; default: the plant of the library's scene.
    spread : makes the further devices that a robust library's command serves at a grip; default: those of the
        library's scene, or none if `plant` is given.

    Raises
    ------
    InputError : the extension is not built, the problem has too many states for it, or an argument has the wrong
        type.
    """

    @one_blas_thread()
    def __init__(
        self,
        library: Library,
        plant: Callable[[float], StateSpace] | None = None,
        spread: Callable[[float], tuple[StateSpace, ...]] | None = None,
    ) -> None:
        if not available:
            raise InputError(
                "online: the solver's extension is not built or out of date; install again where there is a compiler"
            )
        if not isinstance(library, Library):
            raise InputError(f"online: {cut(repr(library))} is no library: give what `load_library` returns")
        for kind, made in (("plant", plant), ("spread", spread)):
            if made is not None and not callable(made):
                raise InputError(f"online: {kind} = {cut(repr(made))}: must be a function of the grip in N")
        library.check_linear("online")
        if library.posing().worst:
            raise InputError(
                'online: robust.minimise = "worst" is a search through many optima for one tap: solve the scene '
                'with "mean", or play the library as it is'
            )
        self._lock = RLock()  # reentrant, for a `plant` that itself asks for a tap
        self._library, self._coil = library, library.coil()
        if plant is None:
            scene = library.scene()
            plant, spread = scene.plant, spread or partial(_spread, scene)
        self._plant, self._spread = plant, spread or _none
        self._stages: dict[tuple[Any, ...], tuple[StageModel, ...]] = {}
        self._posing, self._corrected = library.posing(), bool(np.any(library.correction_m_s2))
        entries = [library.parts(iv, ig) for iv, ig in np.ndindex(library.command.shape[:2])]
        self._parts = {name: max(parts[name] for parts in entries) for name in entries[0]}
        self._hardest = float(library.speeds_m_s[-1]), float(library.grips_N[-1])
        self._found_standing: dict[tuple[tuple[str, float], ...], StandingTap | None] = {}
        problem = self._posed(self._posing, *self._hardest, self._coil)
        # Allocate memory for all problems of a tap: without limits, with and without the temperature.
        linear_passes([_small_enough(without_limits(problem))], TOLERANCE)
        for each in (problem, problem.without(TemperatureLimit.name)):
            self._by_interior_point(each)
        self.solve(*self._hardest)

    def __repr__(self) -> str:
        return f"Online({self._library!r})"

    def _devices(self, posing: Posing, grip_N: float) -> tuple[StageModel, ...]:
        """The device at a grip and those of its spread, discretised with the amplifier and the outputs it limits."""
        key = (grip_N, posing.amplifier, posing.watched)
        found = self._stages.get(key)
        if found is None:
            others = (posing.stage(plant) for plant in _made(self._spread, grip_N, "spread"))
            found = (posing.stage(*_made(self._plant, grip_N, "plant")), *others)
            if len(self._stages) >= FAMILIES:
                del self._stages[next(iter(self._stages))]
            self._stages[key] = found
        return found

    def _posed(self, posing: Posing, speed_m_s: float, grip_N: float, coil: CoilModel | None) -> TransientProblem:
        library = self._library
        stage, *spread = self._devices(posing, grip_N)
        wanted = library.wanted(speed_m_s, grip_N)
        if self._corrected:
            # The correction learnt on the device at the nodes, interpolated between them.
            own = interpolation_weights(library.speeds_m_s, speed_m_s)
            by_grip = interpolation_weights(library.grips_N, grip_N)
            correction = np.einsum("v,g,vgk->k", own, by_grip, library.correction_m_s2)
            wanted = replace(wanted, target=wanted.target.moved(correction))
        # A limit on an output is stated at as many instants within a period as in the node with the most.
        problem = posing.problem(wanted, stage, tuple(spread), coil).within(self._parts)
        if posing.objective == "intensity":
            problem = replace(problem, intensity=self._price(speed_m_s, grip_N))
        if problem.wall is None:
            return problem
        return pressing(problem, reference_course(problem.grid, problem.target.continued_m_s2))

    def _price(self, speed_m_s: float, grip_N: float) -> float:
        """lam between the nodes, bilinear.

        At any lam, the optimum is the nearest waveform among those of equal energy.
        Exactly the energy that the scene asks for may need a slightly different lam; the tap is then a little
        stronger or weaker. The certificate is that of the problem with the lam used.
        """
        library = self._library
        by_speed = interpolation_weights(library.speeds_m_s, speed_m_s)
        by_grip = interpolation_weights(library.grips_N, grip_N)
        return float(by_speed @ library.intensity @ by_grip)

    def solve(
        self,
        speed_m_s: float,
        grip_N: float,
        winding_C: float | None = None,
        housing_C: float | None = None,
        limits: Mapping[str, float] | None = None,
    ) -> OnlineTap:
        """The certified optimum for one tap, or the library's blend with the reason why.

        Parameters
        ----------
        winding_C, housing_C : measured temperatures at the start; default: the library's own. Without a housing
            temperature the library's is used, lowered to the winding's if that is colder.
        limits : values in place of the library's own, by the keys of a scene's `limits`, `command_A` for the
            amplifier's range and `temperature_C` for the winding. Without a certified optimum the blend is
            played only if it keeps all limits from the measured temperatures on; otherwise nothing. Nothing is played
            on a winding above its limit or at a measured temperature that no motor has.

        Raises
        ------
        InputError : speed, grip or temperature is not a finite number; a limit is unknown, not > 0, or needs a part
            that the library's scene does not have.
        """
        start = time.perf_counter()
        limits = _table(limits)
        posing = with_limits(limits, self._posing) if limits else self._posing
        place = self._library.located(speed_m_s, grip_N)
        coil, remark = _heated(self._coil, limits.get("temperature_C"), winding_C, housing_C)
        if place.silent and not remark:
            remark = "nothing to play: too little grip or speed"
        with self._lock, one_blas_thread():
            wave, proof, remark = self._answered(posing, place, coil, limits, remark)
        return OnlineTap(wave, proof, remark, time.perf_counter() - start)

    def _answered(
        self, posing: Posing, place: Place, coil: CoilModel | None, limits: Mapping[str, float], remark: str
    ) -> tuple[Waveform, Certificate | None, str]:
        """What `solve` answers; `remark` says why there is nothing to solve, if there is not."""
        if not remark and (standing := self._standing(posing, limits)):
            (plant,) = _made(self._plant, place.grip_N, "plant")
            if (known := standing.solved(plant, place, coil)) is not None:
                command, certificate = known
                return Waveform(**vars(place), command=command, transient_command=command), certificate, ""
        return self._in_general(posing, place, coil, limits, remark)

    def _standing(self, posing: Posing, limits: Mapping[str, float]) -> StandingTap | None:
        """The taps under these limits as a standing problem; None if they are not of that kind."""
        key = tuple(sorted(limits.items()))
        if key not in self._found_standing:
            if len(self._found_standing) >= STANDING:
                del self._found_standing[next(iter(self._found_standing))]
            problem = self._posed(posing, *self._hardest, self._coil)
            made = StandingTap.of(self._library, posing, problem, TOLERANCE, MOST_ITERATIONS)
            self._found_standing[key] = made
        return self._found_standing[key]

    def _in_general(
        self, posing: Posing, place: Place, coil: CoilModel | None, limits: Mapping[str, float], remark: str
    ) -> tuple[Waveform, Certificate | None, str]:
        """What `solve` answers for a tap of any kind."""
        problem = None if remark else self._posed(posing, place.speed_m_s, place.grip_N, coil)
        found = remark if problem is None else self._optimum(problem)
        if isinstance(found, str):
            wave = self._library.blend(place)
            if problem is None:  # the coil is too hot at the start, or not known
                wave = _silent(wave)
            elif not inside(problem, wave.command):
                wave = _silent(wave)
                found = f"{found}; nothing is played, for the library's blend leaves the limits"
            return wave, None, found
        problem, answer = found
        transient = problem.transient_command(answer.command)
        return Waveform(**vars(place), command=answer.command, transient_command=transient), answer.proof, ""

    def _optimum(self, problem: TransientProblem) -> tuple[TransientProblem, _Found] | str:
        """The problem, with the wall pressing as the answer makes it press, and that answer; or why there is none."""
        for _ in range(MOST_MASKS):
            found = self._solved(problem)
            if found is None or not found.proof.accepted:
                return "no certified optimum"
            if problem.wall is None:
                return problem, found
            again = pressing_under(problem, found.command)
            assert again.wall is not None
            first = max(problem.free_stages - 1, 0)  # the prefilter remembers the last tick before the hand-over
            if np.array_equal(again.wall.pressing[first:], problem.wall.pressing[first:]):
                return problem, found
            problem = again
        return "the wall pushes elsewhere after every solve"

    def _solved(self, problem: TransientProblem) -> _Found | None:
        """The answer from the smallest problem that has it: without limits, without the temperature, or complete."""
        if problem.reference_is_zero:
            return self._proven(Effect(problem, np.zeros(problem.grid.stages)), Multipliers.zero(problem))
        small, free = leave_out(problem).problem, None
        bare = without_limits(small)
        (linear,) = linear_passes([bare], TOLERANCE)
        if linear.code in (SOLVED, ACCURACY):
            free = Effect(problem, bare.free_command(linear.command))
            if inside(problem, free.command, effect=free):
                multipliers = replace(Multipliers.zero(problem), hand_over=bare.hand_over(linear.gradient))
                found = self._proven(free, multipliers)
                if found.proof.accepted:
                    return found
        return self._limited(problem, small, free)

    def _limited(self, problem: TransientProblem, small: TransientProblem, free: Effect | None) -> _Found | None:
        """The answer under limits.

        Whether and where the temperature binds is a guess: it sets only the order of attempts and the length of the
        first search.
        """
        cold, found = small.without(TemperatureLimit.name), None
        hottest = None if small.thermal is None or free is None else _hottest(free)
        attempts = [cold] if small.thermal is None else [cold, small] if hottest is None else [small, cold]
        for attempt in attempts:
            searched = self._searched(problem, attempt, hottest or 0)
            if searched is None:
                continue
            effect, multipliers = searched
            if attempt.thermal is not None and multipliers.upper(TEMPERATURE).max() <= BINDING_MULTIPLIER:
                # The winding does not bind. Without its multipliers the certificate is that of the problem without
                # it.
                none = np.zeros(effect.command.size)
                multipliers = multipliers.with_pair(TEMPERATURE, none, none)
            if attempt is not small and not inside(
                problem, effect.command, only=TemperatureLimit.name, effect=effect
            ):
                continue
            found = self._proven(effect, multipliers)
            if found.proof.accepted:
                return found
        return found

    def _searched(
        self, problem: TransientProblem, attempt: TransientProblem, last: int
    ) -> tuple[Effect, Multipliers] | None:
        """An attempt's answer.

        Under a temperature, limits are stated up to a little after `last`, or everywhere if the answer leaves them.
        Without one the extension shortens its search itself.
        """
        cut = last + MARGIN if attempt.thermal is not None and attempt.thermal.period_s is None else 0
        for stated in (cut, 0) if 0 < cut <= 3 * attempt.free_stages // 4 else (0,):
            answer = self._by_interior_point(attempt, stated)
            if answer is not None:
                command, multipliers = answer
                effect = Effect(problem, command)
                if not stated or _last_outside(effect, attempt) < stated:
                    return effect, multipliers
        return None

    def _by_interior_point(self, problem: TransientProblem, cut: int = 0) -> tuple[FloatArray, Multipliers] | None:
        given = _small_enough(stages(problem))
        (answer,) = interior_points([given], tolerance=TOLERANCE, max_iterations=MOST_ITERATIONS, cut=cut)
        if answer.code not in (SOLVED, ACCURACY):
            return None
        by_row = answer.upper - answer.lower
        return given.command(answer.command), given.multipliers(by_row, answer.gradient)

    def _proven(self, effect: Effect, multipliers: Multipliers) -> _Found:
        """A command with its certificate; where the temperature binds, a convex problem bounds J from below."""
        proof = certified(effect.problem, effect.command, multipliers, effect=effect)
        return _Found(effect.command, bounded(effect, multipliers, proof))


def _small_enough(given: Stages) -> Stages:
    """The stage data, refused if the problem has too many states for the extension."""
    states = given.sizes["states"] + given.sizes["nodes"]
    if states > MOST_STATES:
        raise InputError(f"online: the problem has {states} states, limit {MOST_STATES}: spread fewer devices")
    return given


def _hottest(effect: Effect) -> int | None:
    """The stage at which an unlimited command is hottest with its current clipped; None if it keeps the limit.

    A guess that the temperature will bind, and of where.
    """
    thermal, limit = effect.problem.thermal, effect.problem.limits.input_limit
    assert thermal is not None
    model = thermal.model
    excess = effect.rise_K[1:, 0] - model.headroom_K
    if excess.max() > 0:
        currents = (np.clip(each, -limit, limit) for each in (effect.motion.plant_input, effect.command))
        excess = model.rise(model.heating.mean_square(*currents))[1:, 0] - model.headroom_K
    return int(excess.argmax()) if excess.max() > 0 else None


def _last_outside(effect: Effect, problem: TransientProblem) -> int:
    """The last stage at which a command leaves a limit of the problem; -1 if it keeps them all."""
    boxes = boxes_of(effect.of(problem), Multipliers.zero(problem))
    return max((int(np.flatnonzero(box.excess > 0).max(initial=-1)) for box in boxes), default=-1)


def _table(limits: Any) -> Mapping[str, float]:
    """The limits that a caller gave for a tap, checked to be a table."""
    if limits is not None and not isinstance(limits, Mapping):
        raise InputError(f"limits = {cut(repr(limits))}: must be a table such as {{'current_A': 3.0}}")
    return limits or {}


def _made(make: Callable[[float], Any], grip_N: float, kind: str) -> tuple[StateSpace, ...]:
    """The devices that a caller's function makes for a grip, checked for their type."""
    made = make(grip_N)
    devices = made if isinstance(made, tuple) else (made,)
    if (kind == "plant" and len(devices) != 1) or not all(isinstance(each, StateSpace) for each in devices):
        asked = "a StateSpace" if kind == "plant" else "a tuple of StateSpace"
        raise InputError(f"online: {kind}({grip_N:g}) is {cut(repr(made))}: must be {asked}")
    return devices


def _none(grip_N: float) -> tuple[StateSpace, ...]:
    """No further devices."""
    return ()


def _spread(scene: "Scene", grip_N: float) -> tuple[StateSpace, ...]:
    """The further devices of a scene at a grip."""
    return tuple(of.plant(grip) for of, grip in scene.spread(grip_N))


def _heated(
    coil: CoilModel | None, limit_C: float | None, winding_C: float | None, housing_C: float | None
) -> tuple[CoilModel | None, str]:
    """The coil at its measured start and with the given limit; and why that start allows no tap, or empty."""
    if coil is None:
        return coil, ""
    limit_C = coil.limit_C if limit_C is None else float(limit_C)
    winding = coil.start_winding_C if winding_C is None else finite("winding", winding_C, "C")
    housing = coil.start_housing_C if winding_C is None else min(coil.start_housing_C, winding)
    if housing_C is not None:
        housing = finite("housing", housing_C, "C")
    read = ("winding", winding_C, winding, WINDING_C), ("housing", housing_C, housing, HOUSING_C)
    for node, given, value, (low, high) in read:
        if given is not None and not low <= value <= high:
            return coil, f"{node} {value:.4g} C: a {node} has {low:g} to {high:g} C: check its sensor"
    if winding > limit_C:
        return coil, f"winding {winding:.4g} C is above its limit {limit_C:g} C: let the motor cool"
    return replace(coil, limit_C=limit_C, start_winding_C=winding, start_housing_C=housing), ""


def _silent(wave: Waveform) -> Waveform:
    """The waveform with zero commands, at the same place."""
    nothing = np.zeros_like(wave.command)
    return replace(wave, silent=True, command=nothing, transient_command=nothing)
