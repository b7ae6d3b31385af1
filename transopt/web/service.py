"""A scene and its taps, solved under other limits again and again: what the page shows, with no web in it.

While a slider moves, an answer is the optimum with its certificate (`Service.quick`). When it rests, every tap is
made anew as `transopt solve` makes it, replayed, priced and admitted (`Service.settled`), so that what the table says
is what a library would hold.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.design.build import build_library
from transopt.design.context import KEPT_STAGES, Context, Kept, Posed
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.design.explain import what_would_do
from transopt.design.remedy import remedies
from transopt.design.scene_entry import SceneEntry
from transopt.library.library import Library
from transopt.library.proven import load_proven
from transopt.library.recorded import references_of_library
from transopt.plant.coil import CoilModel
from transopt.plant.discretise import StageModel, TimeGrid
from transopt.problem.answer import Status
from transopt.problem.baselines import clipped_optimum
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.figures import Figures
from transopt.problem.problem import TransientProblem
from transopt.problem.warm_coil import WarmCoil
from transopt.recordings.recording import Recording
from transopt.recordings.reference import Reference
from transopt.recordings.references import References
from transopt.recordings.tap import check_usable, prepare, read_recordings
from transopt.scene.builtin import load_scene
from transopt.scene.keys import IN_PLACE_OF, Value, keys, with_values
from transopt.scene.recordings import recordings_of, references_of
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions, TrialOptions
from transopt.web.controls import DEVICE, TABLES, Control, controls, input_key
from transopt.web.warm import Warm, on_warm_coil

MOST_REMEDY_S = 1.5  # of a processor's time for what would do for one tap
RECORDED = {
    "recordings",
    "hand",
    "targets",
    "time",
    "weights",
    "grid",
    "model",
    "motor",
    "transmission",
    "tip",
    "striker",
}


@dataclass(frozen=True)
class Place:
    """Which tap it is.

    Attributes
    ----------
    speed_m_s, grip_N : 0 of a named target.
    target : its name; empty for a tap.
    title : in words.
    between : whether it lies between the nodes of the scene, where the sliders of speed and grip put it.
    """

    speed_m_s: float
    grip_N: float
    target: str
    title: str
    between: bool = False


@dataclass(frozen=True)
class Curves:
    """One tap as it is drawn; without a certified optimum its own curves are NaN.

    Attributes
    ----------
    times_s : (N + M,) the switching instants, and those after the window.
    recorded_m_s2 : (N + M,) r, the recorded acceleration.
    optimum_m_s2, clipped_m_s2 : (N + M,) y'' of the optimum, and of the unlimited one cut at the limit.
    input, clipped_input : (N + M,) what drives the plant [A or V].
    input_limit : that they stay within.
    temperature_C : (N,) of the winding at the ends of the periods; (0,) without a coil.
    temperature_limit_C : NaN without a coil.
    warm_m_s2, warm_input : (N + M,) as `optimum_m_s2` and `input`, of what is played on a coil as warm as is asked
        for; (0,) where nothing is asked.
    """

    times_s: FloatArray
    recorded_m_s2: FloatArray
    optimum_m_s2: FloatArray
    clipped_m_s2: FloatArray
    input: FloatArray
    clipped_input: FloatArray
    input_limit: float
    temperature_C: FloatArray
    temperature_limit_C: float
    warm_m_s2: FloatArray = field(default_factory=lambda: np.zeros(0))
    warm_input: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Shown:
    """One tap of an answer.

    Attributes
    ----------
    index : of the place.
    certified : whether the project's certificate is accepted; what is not is greyed.
    replayed : whether it is admitted too, as an entry of a library is.
    reason : why it is not certified; empty if it is.
    figures : how near the optimum comes to the recorded tap; None where there is none.
    floor, clipped : tap error of the optimum without limits, and of that one clipped.
    heat_A2_ms : integral of the squared current.
    binds : what holds it back, in words.
    curves : as drawn; None in the answer of `settled`, which changes no curve.
    warm : what is played on a coil as warm as is asked for; None where nothing is asked, or it is not certified.
    price : of the dearest limit, in a sentence; known when settled.
    verdict : known when settled.
    """

    index: int
    certified: bool
    replayed: bool
    reason: str
    figures: Figures | None
    floor: float
    clipped: float
    heat_A2_ms: float
    binds: str
    curves: Curves | None = None
    warm: Warm | None = None
    price: str = ""
    verdict: str = ""


class Service:
    """A scene, its taps, and the changes that have been made to it.

    Parameters
    ----------
    scene : as it was opened.
    recordings : to be reproduced in place of those that the scene names.
    library : of which it is the scene: then its references serve as long as the time axis stays, and no recording
        need be there.

    Raises
    ------
    InputError : recordings that cannot serve; a nonlinear plant.
    """

    def __init__(
        self, scene: Scene, recordings: Sequence[Recording] | None = None, library: Library | None = None
    ) -> None:
        self.opened, self.of_library, self._given = scene, library, recordings
        self.changes: dict[str, Value] = {}
        self.options = SolverOptions()
        self.trial = TrialOptions(self.options.solver, self.options.tolerance, self.options.max_iterations)
        self._references: tuple[str, References] = ("", References())
        self._referenced: Scene | None = None  # that the references were last looked up for
        self._recordings: tuple[str, list[Recording]] = ("", [])
        self._stages: Kept[StageModel] = Kept(KEPT_STAGES)  # of all scenes that the sliders have come to
        self._context: Context | None = None
        self.probe: tuple[float, float] | None = None
        self.winding_C: float | None = None
        self._known = {key.path for key in keys(scene) if key.path.split(".", 1)[0] in TABLES} - set(DEVICE)
        scene.posing()  # a nonlinear plant is refused here, by name
        if library is not None:
            self._references = (self._axis(scene), references_of_library(library))
        self.scene = scene
        self.references(scene)

    def __getstate__(self) -> dict[str, Any]:
        # For another process: it makes the devices itself, and needs no library beside the references.
        return {**vars(self), "_stages": Kept(KEPT_STAGES), "_context": None, "of_library": None}

    @property
    def axis(self) -> str:
        """What its references were made for, as text: as long as it stays, so do they."""
        return self._references[0]

    @property
    def places(self) -> list[Place]:
        """The taps of the scene, speeds outermost, and the one between the nodes where it is asked for."""
        axes, scene = self.scene.axes, self.scene
        names = axes.targets or ("",) * len(axes.speeds_m_s)
        found = [
            Place(speed, grip, name, axes.place(iv, ig))
            for iv, (speed, name) in enumerate(zip(axes.speeds_m_s, names, strict=True))
            for ig, grip in enumerate(axes.grips_N)
        ]
        if self.probe is not None and not scene.targets:
            speed, grip = self.probe
            found.append(Place(speed, grip, "", f"{speed:.3g} m/s, {grip:.3g} N", between=True))
        return found

    @property
    def controls(self) -> list[Control]:
        """Controls of the scene as it is now."""
        return controls(self.scene)

    @property
    def grid(self) -> TimeGrid:
        return self.scene.time_grid()

    @property
    def remarks(self) -> list[str]:
        """What has to be known before anything that is shown is believed."""
        found = [self.scene.unfit_model()]
        if self.of_library is not None and self.of_library.meta.get("refinement"):
            found.append(
                "the library was refined on its device; what is shown and saved here is designed anew for the "
                "recorded taps, without what was learnt there"
            )
        return [each for each in found if each]

    @property
    def windings_C(self) -> tuple[float, float] | None:
        """Ambient, and what a transient may bring the winding to; None where the scene has no second commands."""
        coil = self._guarded
        if coil is None or self.scene.grid.cool_share is None:
            return None
        return coil.ambient_C, WarmCoil.of(coil, self.grid.dt_s).play_limit_C

    @property
    def _guarded(self) -> CoilModel | None:
        """The coil as the servo that plays the commands estimates it."""
        coil = self.scene.coil()
        return None if coil is None else coil.on_a_device()

    def change(
        self,
        changes: Mapping[str, Value],
        probe: tuple[float, float] | None = None,
        winding_C: float | None = None,
    ) -> None:
        """Take other values into the scene.

        Parameters
        ----------
        probe : a speed [m/s] and a grip [N] between the nodes; None for none.
        winding_C : of a coil on which every tap is played besides; None for none.

        Raises
        ------
        InputError : values that the scene does not take; it stays as it was.
        """
        for key in changes:
            if key not in self._known:
                raise InputError(f"{key}: no slider of this scene")
        wanted = {**self.changes, **changes}
        for key in changes:
            wanted.pop(IN_PLACE_OF.get(key, ""), None)
        scene = with_values(self.opened, wanted)
        self._check_probe(scene, probe)
        if winding_C is not None and (self.windings_C is None or not np.isfinite(winding_C)):
            raise InputError(f"winding {winding_C:g} C: the scene has no second commands: state grid.cool_share")
        self.references(scene)
        self.scene, self.changes, self.probe, self.winding_C = scene, wanted, probe, winding_C

    def _check_probe(self, scene: Scene, probe: tuple[float, float] | None) -> None:
        if probe is None:
            return
        axes = scene.axes
        ends = ((axes.speeds_m_s, "speed", "m/s"), (axes.grips_N, "grip", "N"))
        for value, (nodes, name, unit) in zip(probe, ends, strict=True):
            if not nodes[0] <= value <= nodes[-1]:
                raise InputError(
                    f"{name} {value:g} {unit}: outside of the nodes, {nodes[0]:g} to {nodes[-1]:g} {unit}"
                )

    def _axis(self, scene: Scene) -> str:
        """What the references depend on, as text."""
        stated = scene.model_dump(include={"recordings", "targets", "hand"}, mode="json")
        return f"{scene.time_grid()} {json.dumps(stated)}"

    def references(self, scene: Scene) -> References:
        """What the device has to do at speeds and grips of a scene or for its targets; kept until the axis changes.

        Raises
        ------
        InputError : recordings that cannot serve.
        """
        if scene is not self._referenced:
            axis = self._axis(scene)
            if axis != self._references[0]:
                self._references = (axis, references_of(scene, self._taps(scene)))
            self._referenced = scene
        return self._references[1]

    def _taps(self, scene: Scene) -> Sequence[Recording]:
        if self._given is not None or scene.targets:
            return self._given or ()
        of = json.dumps(scene.model_dump(include=RECORDED, mode="json"))
        if of != self._recordings[0]:
            self._recordings = (of, recordings_of(scene))
        return self._recordings[1]

    @property
    def context(self) -> Context:
        """Devices and references of the scene as it is now."""
        if self._context is None or self._context.scene is not self.scene:
            self._context = Context(self.scene, self.references(self.scene), self._stages)
        return self._context

    def reference(self, place: Place) -> Reference:
        """Reference of one tap, between the recorded speeds too."""
        return self.context.reference(place.speed_m_s, place.grip_N, place.target)

    def _posed(self, place: Place) -> Posed:
        return self.context.posed(place.speed_m_s, place.grip_N, place.target)

    def order(self, selected: int) -> list[int]:
        """All taps, the selected one first, then grip by grip."""
        places = self.places
        rest = sorted(range(len(places)), key=lambda index: (places[index].grip_N, index))
        return [index for index in (selected,) if 0 <= index < len(places)] + [i for i in rest if i != selected]

    @one_blas_thread()
    def quick(self, index: int, *, words: bool = True) -> Shown:
        """One tap under the present limits: its optimum and the certificate, no replay and no price.

        Parameters
        ----------
        words : whether it is found out what binds, and the energy; else these are left empty and NaN.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # what is far from usual fails, and says so
            (entry,) = design([self._posed(self.places[index])], options=self.trial)
            shown = _shown(index, entry, words=words)
            warm = self._warm(index, entry) if shown.certified else None
            if warm is None:
                return shown
            found, acceleration, current = warm
            assert shown.curves is not None
            free = entry.problem.target.lasting(entry.problem.target.free_m_s2)
            return replace(
                shown, warm=found, curves=replace(shown.curves, warm_m_s2=acceleration + free, warm_input=current)
            )

    def _warm(self, index: int, entry: Entry) -> tuple[Warm, FloatArray, FloatArray] | None:
        """A tap on a coil as warm as is asked for; None where nothing is asked."""
        coil, share = self._guarded, self.scene.grid.cool_share
        if self.winding_C is None or coil is None or share is None:
            return None
        return on_warm_coil(self._posed(self.places[index]), entry, coil, self.winding_C, share, self.trial)

    @one_blas_thread()
    def entry(self, index: int) -> Entry:
        """One tap as an entry of a library: solved, certified, replayed, priced, or refused with its reason."""
        (found,) = design([self._posed(self.places[index])], rivals=True, options=self.options)
        return found

    @one_blas_thread()
    def settled(self, index: int) -> Shown:
        """One tap as a library would hold it; of a refused one the reason, and what would do."""
        place, entry = self.places[index], self.entry(index)
        admitted = entry.admitted
        reason, warm = "", self._warm(index, entry) if admitted else None
        if not admitted:
            said = list(dict.fromkeys([entry.status.value, *entry.shortfalls]))
            posed = SceneEntry(self.context, place.grip_N, self.reference(place))
            found = remedies(posed, entry, self.options, most_s=MOST_REMEDY_S)
            reason = ": ".join([said[0], "; ".join(filter(None, [*said[1:], what_would_do(found)]))])
        return Shown(
            index=index,
            certified=admitted,
            replayed=admitted,
            reason=reason,
            figures=entry.figures if admitted else None,
            floor=entry.floor,
            clipped=entry.baselines.clipped.tap_error,
            heat_A2_ms=1e3 * entry.heat_A2_s if admitted else np.nan,
            binds=entry.binding if admitted else "",
            warm=None if warm is None else warm[0],
            price=entry.prices[0].sentence if entry.prices else "",
            verdict=entry.verdict,
        )

    def accelerations(self, index: int) -> dict[str, FloatArray]:
        """What a tap sounds like: (N + M,) of recorded, clipped and, if certified, optimum [m/s^2]."""
        shown = self.quick(index)
        assert shown.curves is not None
        found = {"recorded": shown.curves.recorded_m_s2, "clipped": shown.curves.clipped_m_s2}
        return {**found, "optimum": shown.curves.optimum_m_s2} if shown.certified else found

    def library(self, progress: Callable[[int, int], None] = lambda done, of: None) -> Library:
        """Build the library of the scene as it is.

        Parameters
        ----------
        progress : called with how many taps are done, and of how many.

        Raises
        ------
        InputError : an entry is refused, with its reason; recordings that are not there.
        """
        scene, done = self.scene, 0

        def advance(count: int) -> None:
            nonlocal done
            done += count
            progress(done, scene.axes.entries)

        progress(0, scene.axes.entries)
        made = build_library(scene, self._taps(scene), options=self.options, progress=advance)
        if made.library is None:
            first = made.refused[0]
            raise InputError(
                f"no library: {len(made.refused)} of {scene.axes.entries} taps are refused, the first at "
                f"{first.place}: {'; '.join(first.shortfalls) or first.status.value}"
            )
        return made.library


def opened(source: Scene | Library | str | Path, recordings: Path | None = None) -> Service:
    """The service of a scene, of a library, or of the name or path of one.

    Parameters
    ----------
    recordings : folder of the scene's recordings, in place of the one that it names.

    Raises
    ------
    InputError : a file that cannot be used.
    """
    if isinstance(source, str | Path) and str(source).lower().endswith(".npz"):
        source = load_proven(Path(source))
    if isinstance(source, Library):
        source.check_linear("page")
        return Service(source.scene(), library=source)
    scene = source if isinstance(source, Scene) else load_scene(source)
    if recordings is not None:
        scene = with_values(scene, {"recordings.folder": str(recordings.resolve())})
    return Service(scene)


def own_taps(scene: Scene, folder: Path, files: Sequence[str], speed_m_s: float | None) -> Service:
    """The service of a scene with taps of a user's own in place of its recordings.

    The grid takes the speeds of the files, one each, since taps within the scene's tolerance of each other share one.

    Parameters
    ----------
    files : names in the folder.
    speed_m_s : of files that state none.

    Raises
    ------
    InputError : a file that is no tap, or whose speed nobody states.
    """
    if scene.targets:
        raise InputError(
            f"{scene.name}: has named targets, which no tap takes the place of: open a scene with speeds"
        )
    stated = scene.recordings.model_dump(include={"lowpass_Hz", "trusted_from_Hz", "speed_tolerance"})
    table = {**stated, "files": list(files), "folder": str(folder), "speed_m_s": speed_m_s}
    settings = with_values(scene, {"recordings": table}).recordings
    taps = [prepare(recording, settings) for recording in read_recordings(settings)]
    nodes: list[float] = []
    for tap in sorted(taps, key=lambda tap: tap.speed_m_s):
        check_usable(tap, settings)
        speed = float(f"{tap.speed_m_s:.3g}")
        if not nodes or abs(nodes[-1] / tap.speed_m_s - 1) > settings.speed_tolerance:
            nodes.append(speed)
    return Service(with_values(scene, {"recordings": table, "grid.speeds_m_s": nodes}))


def _rolled(problem: TransientProblem, command: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N + M,) acceleration and input of a command (N,), after which there is none."""
    return problem.stage.rollout(np.append(command, np.zeros(problem.grid.after_stages)))


def _shown(index: int, entry: Entry, *, words: bool) -> Shown:
    problem, answer, proof = entry.problem, entry.solution, entry.certificate
    grid, target = problem.grid, problem.target
    N = grid.stages
    certified = answer.status is Status.OPTIMAL and (proof.accepted or _bent(entry))
    clipped = clipped_optimum(problem.stage, grid, entry.designed.unlimited_command, problem.limits.input_limit)
    clipped_m_s2, clipped_input = _rolled(problem, clipped)
    nothing = np.full(N + grid.after_stages, np.nan)
    optimum, current = (
        problem.stage.rollout(problem.continued(answer.command)) if certified else (nothing, nothing.copy())
    )
    thermal = problem.limits.get(TemperatureLimit.name)
    warm, limit_C = np.zeros(0), np.nan
    if isinstance(thermal, TemperatureLimit):
        limit_C = thermal.limit_C
        warm = thermal.temperatures_C(current[:N], answer.command) if certified else nothing[:N]
    curves = Curves(
        times_s=np.append(grid.switching_times_s, grid.after_times_s),
        recorded_m_s2=target.lasting(target.recorded_m_s2),
        optimum_m_s2=optimum + target.lasting(target.free_m_s2),
        clipped_m_s2=clipped_m_s2 + target.lasting(target.free_m_s2),
        input=current,
        clipped_input=clipped_input,
        input_limit=problem.limits.input_limit,
        temperature_C=warm,
        temperature_limit_C=limit_C,
    )
    said = "; ".join(dict.fromkeys([answer.status.value, *entry.designed.remarks]))
    if not certified and answer.status is Status.OPTIMAL:
        said = f"{Status.NOT_CERTIFIED.value}: gap {proof.relative_gap:.1e}, limit {proof.GAP_TOLERANCE:.0e}"
    return Shown(
        index=index,
        certified=certified,
        replayed=False,
        reason="" if certified else said,
        figures=problem.figures(optimum) if certified else None,
        floor=entry.floor,
        clipped=problem.yardstick.tap_error(target, clipped_m_s2),
        heat_A2_ms=1e3 * entry.heat_A2_s if certified else np.nan,
        binds=entry.binding if certified and words else "",
        curves=curves,
    )


def _bent(entry: Entry) -> bool:
    """Whether the answer is a stationary point under a limit of a user's own, of which nobody can promise more."""
    own = any(name != TemperatureLimit.name for name in entry.problem.nonlinear)
    return entry.certificate.is_stationary and own


def described(service: Service) -> dict[str, Any]:
    """What a page has to know of a scene before anything of it is solved: words, units, taps and controls."""
    scene, axes = service.scene, service.scene.axes
    driven = scene.driven_by
    return {
        "name": scene.name,
        "description": scene.description,
        "driven_by": {"name": driven.name, "unit": driven.unit},
        "input_key": input_key(scene),
        "window_end_s": service.grid.end_s,
        "columns": axes.columns,
        "places": [vars(place) for place in service.places],
        "controls": [vars(control) for control in service.controls],
        "between": None
        if scene.targets
        else {
            "speed_m_s": [axes.speeds_m_s[0], axes.speeds_m_s[-1]],
            "grip_N": [axes.grips_N[0], axes.grips_N[-1]],
        },
        "windings_C": service.windings_C,
        "remarks": service.remarks,
        "solver": service.options.solver,
    }


def plain(shown: Shown) -> dict[str, Any]:
    """An answer without its curves, as JSON has it: null where there is no number."""
    own = {name: value for name, value in vars(shown).items() if name != "curves"}
    return {**_finite(own), "figures": _said(shown.figures), "warm": _said(shown.warm)}


def _said(of: Figures | Warm | None) -> dict[str, Any] | None:
    if of is None:
        return None
    return {**_finite(vars(of)), **({"figures": _said(of.figures)} if isinstance(of, Warm) else {})}


def _finite(table: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not np.isfinite(value) else value for name, value in table.items()
    }
