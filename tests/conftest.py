"""Shared scenes, recordings and one solved library; built once per session."""

import gc
import os
import shutil
import signal
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import hypothesis
import numpy as np
import pytest

import problems
from controller.host.payload import payload
from controller.host.session import Session
from controller.protocol.capacity import LEASE_MOST_MS
from controller.servo.interface import State
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank, bank
from tests.benches.commands import Run, Terminal
from tests.benches.desk import PORT, Desk
from tests.benches.device import need_compiler
from tests.benches.limits import numbers_of, with_limit
from tests.benches.model_parts import Make, scene_on
from tests.benches.quick_part import without_slow_part
from tests.benches.servo import WALL, Bench
from transopt.base import recursions
from transopt.design.build import Build, build_library
from transopt.design.context import Context
from transopt.library.library import Library
from transopt.plant.discretise import discretise
from transopt.problem.answer import Solution, Status
from transopt.problem.heat import Budget
from transopt.problem.limits import posed
from transopt.problem.limits.limit import Setting
from transopt.problem.limits.temperature import temperature_limit
from transopt.problem.objective.error_term import ErrorTerm
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify
from transopt.recordings.recording import Recording
from transopt.references.reference import Reference
from transopt.references.references import References
from transopt.scene.keys import with_values
from transopt.scene.recordings import references_of
from transopt.scene.scene import Scene
from transopt.scene.strikes import recordings

WAIT_S = 60.0  # longer than a busy machine ever leaves a process waiting
STAGES = 60  # of the short case of error against run time: 6 ms, of which 2 saturate

# Hypothesis would fail an example that takes 0.2 s, which on a busy machine any does.
hypothesis.settings.register_profile(
    "any machine", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("any machine")

# A shell starts what runs in its background with Ctrl-C ignored, and so would be what the tests start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    words = 'options of a campaign, like "--seeds 0,1"; --campaign=--help tells them'
    parser.addoption("--campaign", action="append", default=[], metavar="OPTIONS", help=words)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect tests without passes of the garbage collector, a quarter of that time: nothing of them can be freed."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()  # nor does a later pass look at them
        gc.enable()


def is_stationary(problem: TransientProblem, answer: Solution) -> bool:
    """Whether an answer is certified, but for the global bound where the temperature binds."""
    proof = certify(problem, answer.command, answer.multipliers)
    return answer.status is Status.OPTIMAL and proof.is_stationary


@pytest.fixture(params=["compiled", "banded"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways of computing a recursion: by the extension, and without it by banded substitution."""
    if request.param == "banded":
        monkeypatch.setattr(recursions, "COMPILED", None)
    elif recursions.COMPILED is None:
        pytest.skip("the extension is not built")


@pytest.fixture(scope="session")
def c_compiler() -> None:
    """Without one, a test that asks for it is skipped."""
    need_compiler()


@pytest.fixture
def pseudo_terminal() -> None:
    """Without one, a test that asks for it is skipped."""
    try:
        for end in os.openpty():
            os.close(end)
    except OSError as error:
        pytest.skip(f"no pseudo-terminals here: {error}")


@pytest.fixture(scope="session")
def scene() -> Scene:
    return problems.load("wood_on_foam")


@pytest.fixture(scope="session")
def taps(scene: Scene) -> list[Recording]:
    return recordings(scene)


@pytest.fixture(scope="session")
def build(scene: Scene, taps: list[Recording]) -> Build:
    return build_library(scene, taps)


@pytest.fixture(scope="session")
def library(build: Build) -> Library:
    assert build.library is not None
    return build.library


@pytest.fixture(scope="session")
def saved_library(library: Library, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library's file; not to be changed, a copy of it may be."""
    path = tmp_path_factory.mktemp("library") / "library.npz"
    library.save(path)
    return path


@pytest.fixture(scope="session")
def recorded(scene: Scene, taps: list[Recording]) -> References:
    """What was recorded at every speed and grip of the scene."""
    return references_of(scene, taps)


@pytest.fixture(scope="session")
def references(scene: Scene, recorded: References) -> list[Reference]:
    """What was recorded at every speed of the scene and at 3 N, in the middle of its grips."""
    return [recorded.at(speed, 3.0) for speed in scene.grid.speeds_m_s]


class ProblemMaker:
    """Entries of the default scene over 60 ms, for the quick part of its taps, varied where a test wants it."""

    def __init__(self, scene: Scene, references: list[Reference]) -> None:
        self.scene, self.references = scene, references

    def __call__(
        self,
        speed_m_s: float = 0.4,
        grip_N: float = 5.0,
        *,
        ideal: bool = False,
        delay_s: float | None = None,
        stages: int | None = None,
        **limits: float | None,
    ) -> TransientProblem:
        scene = self.scene
        grid, amplifier = replace(scene.time_grid(), after_stages=0), scene.amplifier_model()
        if ideal:
            amplifier = None
        if delay_s is not None:
            grid = replace(grid, delay_s=delay_s)
            amplifier = None if amplifier is None else replace(amplifier, delay_s=delay_s)
        grid = replace(grid, stages=600 if stages is None else stages)
        recorded = next(r for r in self.references if r.speed_m_s == speed_m_s)
        reference = without_slow_part(recorded, scene.time_grid()).target.window_m_s2
        # A longer horizon goes on with nothing to do, a shorter one is cut.
        padded = np.concatenate([reference, np.zeros(max(0, grid.stages - reference.size))])[: grid.stages]
        # Neither nominal motion nor coil: what a limit needs of them is put in by the test that has it.
        stage, nothing = discretise(scene.plant(grip_N), amplifier, grid.dt_s), np.zeros(grid.stages)
        setting = Setting(stage, grid, None, None, Budget(), None, padded, nothing, nothing)
        return TransientProblem(
            stage=stage,
            grid=grid,
            target=Target(padded),
            terms=(ErrorTerm("plain", np.ones(grid.stages)),),
            rho=scene.weights.rho,
            limits=numbers_of(posed(scene.limits.asked(), setting), grid.dt_s, **limits),
            hand_over_samples=scene.hand_over_samples,
        )


@pytest.fixture(scope="session")
def make_problem(scene: Scene, references: list[Reference]) -> ProblemMaker:
    return ProblemMaker(scene, references)


def walled_scene(scene: Scene, stiffness_N_m: float, **feedback: float) -> Scene:
    """The scene with a wall, and with a hand that does not press into it for ever."""
    data = scene.model_dump()
    data["hand"]["yields"] = "brakes"
    data["feedback"] = {"stiffness_N_m": stiffness_N_m, "damping_N_s_m": 5.0, **feedback}
    return Scene.model_validate(data)


WalledMaker = Callable[..., TransientProblem]


@pytest.fixture(scope="session")
def walled(scene: Scene, references: list[Reference]) -> WalledMaker:
    """An entry over a wall; stiffness 0, which no scene may state, leaves the damper."""

    def make(stiffness_N_m: float, speed_m_s: float, grip_N: float = 3.0, **feedback: float) -> TransientProblem:
        varied = walled_scene(scene, max(stiffness_N_m, 1.0), **feedback)
        reference = next(r for r in references if r.speed_m_s == speed_m_s)
        reference = without_slow_part(reference, varied.time_grid())
        problem = Context(varied).posed_as(reference, grip_N).problem
        wall = replace(problem.wall.wall, stiffness_N_m=stiffness_N_m)
        return replace(problem, wall=replace(problem.wall, wall=wall))

    return make


@pytest.fixture(scope="session")
def tables(library: Library) -> Bank:
    return bank(library)


@pytest.fixture(scope="session")
def stated(library: Library) -> Settings:
    return Settings.of(library)


@pytest.fixture
def bench(stated: Settings, tables: Bank) -> Bench:
    """An armed servo over a wall."""
    made = Bench(replace(stated, wall=WALL), tables)
    made.servo.arm()
    return made


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """A scene on a model file, in a folder of its own."""
    return partial(scene_on, tmp_path)


@pytest.fixture(scope="session")
def short_scene(scene: Scene) -> Scene:
    """The pulse of a tap, and nothing of what would come after it."""
    return with_values(scene, {"time.stages": STAGES, "weights.after_s": 0.0})


@pytest.fixture(scope="session")
def hot_problem(make_problem: ProblemMaker, scene: Scene) -> TransientProblem:
    """The coil's temperature binds, so that there is no QP."""
    problem, coil = make_problem(stages=STAGES), scene.coil()
    assert coil is not None
    limit = temperature_limit(coil, scene.amplifier_model(), problem.grid, Budget(headroom_K=0.02))
    return with_limit(problem, limit)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Terminal:
    """Run `PROGRAM ARGS` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return Terminal(monkeypatch, capsys)


@pytest.fixture
def play(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, saved_library: Path, c_compiler: None
) -> Run:
    """Run `transopt-play ARGS` in a folder that holds library.npz, with a home of its own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    shutil.copyfile(saved_library, tmp_path / "library.npz")
    return partial(terminal, "transopt-play")


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A host that takes no pause for the end, and a lease as long as there is: for a device in real time.

    It runs beside everything else on this machine, and either of the two may wait for a processor.
    """
    arm = Session.arm

    def armed(self: Session, gain: float, lease_ms: int, *, trial: bool = False) -> None:
        arm(self, gain, max(lease_ms, LEASE_MOST_MS), trial=trial)

    monkeypatch.setattr(Session, "arm", armed)
    monkeypatch.setattr("controller.host.session.SILENCE_S", WAIT_S)
    monkeypatch.setattr("controller.host.requests.GIVE_UP_S", WAIT_S)


@pytest.fixture
def desk(library: Library, monkeypatch: pytest.MonkeyPatch) -> Desk:
    return Desk(library).put(monkeypatch)


@pytest.fixture
def ready(play: Run, desk: Desk) -> Iterator[Desk]:
    """Yield a desk that holds the library, its check taken for passed."""
    assert play("upload", "library.npz", *PORT).code == 0
    desk.pass_check(payload(Path("library.npz")).configuration)
    yield desk
    # Whatever happened, nothing is left armed once the lease is over.
    for _ in range(2500):
        if desk.end.state in (State.IDLE, State.FAULT):
            break
        desk.step()
    assert desk.end.state in (State.IDLE, State.FAULT)
