"""A scene and its taps, solved again under changed limits: the computations of the page, without the web server.

While a slider moves, an answer consists of the optima with their certificates (`Service.quick`). When it rests, every
tap is designed as by `transopt solve`, replayed, priced and admitted (`Service.settled`), so that the table shows the
figures of a library.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.base.toml_edit import edited
from transopt.design.build import build_library
from transopt.design.context import Context, Posed
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.design.explain import what_would_do
from transopt.design.remedy import Work, remedies
from transopt.design.scene_entry import SceneEntry
from transopt.library.library import Library
from transopt.library.recorded import references_of_library
from transopt.plant.coil import WINDING_C, CoilModel
from transopt.plant.time_grid import TimeGrid
from transopt.problem.warm_coil import WarmCoil
from transopt.recordings.recording import Recording
from transopt.references.reference import Reference
from transopt.references.references import References
from transopt.scene.builtin import FOLDER
from transopt.scene.file import scene_text
from transopt.scene.keys import IN_PLACE_OF, Value, keys, with_values
from transopt.scene.recordings import recordings_of, references_of, sampled_again
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions, TrialOptions
from transopt.web.controls import DEVICE, TABLES, Control, at_present, controls
from transopt.web.price import priced
from transopt.web.shown import Place, Shown, shown
from transopt.web.warm import Warm, on_warm_coil

Tables = tuple[object, ...]  # what a cached result depends on
MOST_REMEDY_WORK = 100.0  # work limit for the search of remedies for one refused tap: one or two seconds
# The tables on which simulated recordings depend.
SIMULATED_ON = (
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
)


class Service:
    """A scene, its taps, and the changes made to it on the page.

    Parameters
    ----------
    scene : the scene as opened.
    recordings : recordings to reproduce in place of those that the scene names.
    library : library that the scene belongs to; its references are used while the time axis does not change, so that
        the recordings need not be present.
    text : text of the scene's file, whose comments are kept when it is saved; empty without a file.
    dropped : whether its recordings are in a temporary folder; a saved scene then expects them in its own folder.

    Raises
    ------
    InputError : unsuitable recordings, or a nonlinear plant.
    """

    def __init__(
        self,
        scene: Scene,
        recordings: Sequence[Recording] | None = None,
        library: Library | None = None,
        text: str = "",
        dropped: bool = False,
    ) -> None:
        self.opened, self.of_library, self._given = scene, library, recordings
        self.source, self._dropped = text, dropped
        self.changes: dict[str, Value] = {}
        self.options = SolverOptions()
        self.trial = TrialOptions(self.options.solver, self.options.tolerance, self.options.max_iterations)
        self._references: tuple[Tables, References] = ((), References())
        self._recordings: tuple[Tables, list[Recording]] = ((), [])
        self._sampled: Sequence[Recording] | None = None  # recordings of the references; None for a library's
        self._context: Context | None = None
        self._posed_last = dict[Place, Posed]()  # the last problem of each tap
        self.probe: tuple[float, float] | None = None
        self.winding_C: float | None = None
        self._known = {key.path for key in keys(scene) if key.path.split(".", 1)[0] in TABLES} - set(DEVICE)
        scene.posing()  # a nonlinear plant is refused here, by name
        scene.check_one_motor(f"page: {scene.name}")
        if library is not None:
            self._references = (_recorded_on(scene), references_of_library(library))
        self.scene = scene
        self.references(scene)

    def __getstate__(self) -> dict[str, Any]:
        # Another process builds the devices itself, and needs the references only.
        return {**vars(self), **self._fresh, "of_library": None}

    @property
    def _fresh(self) -> dict[str, Any]:
        """What services of one scene do not share, as at their beginning."""
        return {"_context": None, "_posed_last": {}, "trial": replace(self.trial, spans={})}

    def another(self) -> "Service":
        """A service of the scene as opened for another window; the references are shared."""
        found = object.__new__(Service)
        vars(found).update(vars(self) | self._fresh)
        found.scene, found.changes, found.probe, found.winding_C = self.opened, {}, None, None
        return found

    def changed(self, changes: Mapping[str, Value]) -> "Service":
        """A service of the scene with further changes, which leaves this one as it is and shares what it knows.

        Raises
        ------
        InputError : values that the scene refuses.
        """
        found = object.__new__(Service)
        vars(found).update(vars(self))
        found.change({**self.changes, **changes}, self.probe)
        return found

    @property
    def axis(self) -> Tables:
        """The references' cache key."""
        return self._references[0]

    @property
    def places(self) -> list[Place]:
        """The taps of the scene, speeds outermost, and the one between the nodes if it is requested."""
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
        """Controls of the scene as opened, at the values that it has now."""
        return at_present(self._opened_controls, self.scene)

    @cached_property
    def _opened_controls(self) -> list[Control]:
        return controls(self.opened)

    @property
    def grid(self) -> TimeGrid:
        return self.scene.time_grid()

    @property
    def remarks(self) -> list[str]:
        """Warnings about the scene that qualify all results."""
        found = [self.scene.unfit_model()]
        if self.of_library is not None and self.of_library.meta.get("refinement"):
            found.append(
                "the library was refined on its device; what is shown and saved here is designed anew for the "
                "recorded taps, without what was learnt there"
            )
        return [each for each in found if each]

    @property
    def windings_C(self) -> tuple[float, float] | None:
        """Ambient temperature and the winding's limit during a transient; None without cool commands."""
        coil = self._guarded
        if coil is None or self.scene.grid.cool_share is None:
            return None
        return coil.ambient_C, WarmCoil.of(coil, self.grid.dt_s).play_limit_C

    @property
    def _guarded(self) -> CoilModel | None:
        """The coil's model by which the servo estimates its temperature."""
        coil = self.scene.coil()
        return None if coil is None else coil.on_a_device()

    def change(
        self,
        changes: Mapping[str, Value],
        probe: tuple[float, float] | None = None,
        winding_C: float | None = None,
    ) -> None:
        """Apply changes to the scene as opened, in place of earlier changes.

        Parameters
        ----------
        changes : key -> value; of two keys that state the same limit the later one counts.
        probe : a speed [m/s] and a grip [N] between the nodes; None for none.
        winding_C : temperature of a warm coil on which every tap is shown too; None for none.

        Raises
        ------
        InputError : values that the scene refuses; it is then not changed.
        """
        wanted: dict[str, Value] = {}
        for key, value in changes.items():
            if key not in self._known:
                raise InputError(f"{key}: no slider of this scene")
            wanted.pop(IN_PLACE_OF.get(key, ""), None)
            wanted[key] = value
        scene = self.scene if wanted == self.changes else with_values(self.opened, wanted)
        self._check_probe(scene, probe)
        low_C, high_C = WINDING_C
        if winding_C is not None and not low_C <= winding_C <= high_C:
            raise InputError(f"winding {winding_C:g} C: must be {low_C:g} to {high_C:g} C")
        if winding_C is not None and self.windings_C is None:
            raise InputError(f"winding {winding_C:g} C: the scene has no cool commands: state grid.cool_share")
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

    def references(self, scene: Scene) -> References:
        """References at the speeds and grips of a scene or for its targets, cached by `axis`.

        Raises
        ------
        InputError : unsuitable recordings.
        """
        axis, (last, known) = _recorded_on(scene), self._references
        if axis != last:
            taps = self._taps(scene)
            known = sampled_again(scene, known) if taps is self._sampled else references_of(scene, taps)
            self._references, self._sampled = (axis, known), taps
        return known

    def _taps(self, scene: Scene) -> Sequence[Recording]:
        if self._given is not None or scene.targets:
            return self._given or ()
        on = ("recordings",) if scene.recordings.simulated is None else SIMULATED_ON
        of = tuple(getattr(scene, name) for name in on)
        if of != self._recordings[0]:
            self._recordings = (of, recordings_of(scene))
        return self._recordings[1]

    @property
    def context(self) -> Context:
        """Devices and references of the scene as it is now."""
        known, references = self._context, self.references(self.scene)
        if known is None or known.references is not references:
            self._context = Context(self.scene, references)
        elif known.scene is not self.scene:
            self._context = known.varied(self.scene)
        assert self._context is not None
        return self._context

    def reference(self, place: Place) -> Reference:
        """Reference of one tap, between the recorded speeds too."""
        return self.context.reference(place.speed_m_s, place.grip_N, place.target)

    def _posed(self, place: Place) -> Posed:
        return self._posed_together([place])[0]

    def _posed_together(self, places: Sequence[Place]) -> list[Posed]:
        """The problems of taps, which share what they can with others of their grip and with their own last ones."""
        context, of_grip, found = self.context, dict[float, list[int]](), dict[int, Posed]()
        for number, place in enumerate(places):
            of_grip.setdefault(place.grip_N, []).append(number)
        for grip_N, numbers in of_grip.items():
            taps = [places[number] for number in numbers]
            references = [context.reference(tap.speed_m_s, tap.grip_N, tap.target) for tap in taps]
            found |= zip(numbers, context.posed_together(references, grip_N), strict=True)
        last, here = self._posed_last, self.places
        self._posed_last = {place: last[place] for place in here if place in last}
        for number, place in enumerate(places):
            if place in last:
                found[number].problem.learn(last[place].problem)
            self._posed_last[place] = found[number]
        return [found[number] for number in range(len(places))]

    def order(self, selected: int) -> list[int]:
        """All taps, the selected one first, then grip by grip."""
        places = self.places
        rest = sorted(range(len(places)), key=lambda index: (places[index].grip_N, index))
        return [index for index in (selected,) if 0 <= index < len(places)] + [i for i in rest if i != selected]

    @one_blas_thread()
    def quick(self, indices: Sequence[int]) -> list[Shown]:
        """Design some taps together under the present limits: optima and certificates, without replays and prices."""
        places = self.places
        with np.errstate(over="ignore", invalid="ignore"):  # extreme values overflow and end as refused taps
            entries = design(self._posed_together([places[index] for index in indices]), options=self.trial)
            found = shown(indices, entries)
            if self.winding_C is None:
                return found
            return [self._warmed(each, entry) for each, entry in zip(found, entries, strict=True)]

    def _warmed(self, found: Shown, entry: Entry) -> Shown:
        """A tap together with the transient that the warm coil allows."""
        warm = self._warm(found.index, entry) if found.certified else None
        if warm is None or found.curves is None:
            return found
        played, acceleration, current = warm
        free = entry.problem.target.lasting(entry.problem.target.free_m_s2)
        curves = replace(found.curves, warm_m_s2=acceleration + free, warm_input=current)
        return replace(found, warm=played, curves=curves)

    def _warm(self, index: int, entry: Entry) -> tuple[Warm, FloatArray, FloatArray] | None:
        """The transient on a coil at the requested temperature; None if none is requested."""
        share = self.scene.grid.cool_share
        coil = None if self.winding_C is None else self._guarded
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
        """One tap as an entry of a library; for a refused one the reason and remedies."""
        place, entry = self.places[index], self.entry(index)
        admitted = entry.admitted
        reason, warm = "", self._warm(index, entry) if admitted else None
        if not admitted:
            status, *shortfalls = dict.fromkeys([entry.status.value, *entry.shortfalls])
            posed = SceneEntry(self.context, place.grip_N, self.reference(place))
            found = remedies(posed, entry, self.options, Work(MOST_REMEDY_WORK))
            reason = ": ".join([status, "; ".join(filter(None, [*shortfalls, what_would_do(found)]))])
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
            prices=priced(self._posed(place), entry, self.trial) if admitted else (),
            verdict=entry.verdict,
        )

    @property
    def text(self) -> str:
        """The changed scene as text of a file, with the comments of the opened one, without installation paths."""
        scene = self.scene
        changes: dict[str, Any] = {"name": scene.name}
        for path, value in self.changes.items():
            changes |= {IN_PLACE_OF[path]: None, path: value} if path in IN_PLACE_OF else {path: value}
        if scene.implausible == "accept":
            changes["implausible"] = "accept"
        return edited(self.source, changes) or scene_text(_portable(scene, self._dropped))

    def accelerations(self, index: int) -> dict[str, FloatArray]:
        """Accelerations to play as sound: (N + M,) recorded, clipped and, if certified, optimum [m/s^2]."""
        (shown,) = self.quick([index])
        assert shown.curves is not None
        found = {"recorded": shown.curves.recorded_m_s2, "clipped": shown.curves.clipped_m_s2}
        return {**found, "optimum": shown.curves.optimum_m_s2} if shown.certified else found

    def library(self, progress: Callable[[int, int], None] = lambda done, of: None) -> Library:
        """Build the library of the changed scene.

        Parameters
        ----------
        progress : called with the number of finished taps and their total.

        Raises
        ------
        InputError : an entry is refused, with its reason; missing recordings.
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


def _recorded_on(scene: Scene) -> Tables:
    """What the references of the scene depend on, of all that can be changed on the page."""
    return scene.time_grid(), scene.recordings, scene.targets, scene.hand


def _portable(scene: Scene, beside: bool) -> Scene:
    """The scene with a relative folder of recordings, without a path of an installation."""
    folder = Path(scene.recordings.folder)
    if beside or not scene.recordings.files:
        folder = Path()
    elif folder.is_relative_to(FOLDER):
        folder = folder.relative_to(FOLDER)
    elif not folder.is_dir():
        folder = Path(folder.name)  # the library was built elsewhere
    return scene.model_copy(update={"recordings": scene.recordings.model_copy(update={"folder": folder.as_posix()})})
