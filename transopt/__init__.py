"""Design motor-current transients that make a virtual surface feel as hard as the real one.

    import transopt as to

    library = to.solve("wood_on_foam")
    library.save("library.npz")

The names in `__all__` are the public interface of this package, and stay: a change that breaks one of them is a new
major version. Everything else, the rooms `transopt.design`, `transopt.library` and all below them, may move between
versions; who imports from there follows.

A tap runs through the names in this order. `load_scene` reads a `Scene`; `recordings_of` has its `Recording`s, which
`prepare` and `references_of` turn into references; `build` poses a `TransientProblem` for every speed and grip,
solves, certifies and replays it, and returns a `Build` of `Entry`s; `solve` returns its `Library` alone. `Online`
solves a library's problem anew for what was measured.

Each name is loaded when it is first used: `import transopt` alone loads nothing, so that a program which only reads a
library never loads the optimiser.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from transopt.base.errors import InputError
    from transopt.design.build import Build
    from transopt.design.entry import Entry
    from transopt.design.solve import build, certify, design_nonlinear, solve
    from transopt.design.verify import verify_library as verify
    from transopt.library.drive_files import export_drive
    from transopt.library.export import export_library
    from transopt.library.file import load_library
    from transopt.library.library import Library
    from transopt.library.online import Online
    from transopt.library.place import Waveform
    from transopt.library.trade import trade_figures
    from transopt.plant.state_space import Input, Output, StateSpace
    from transopt.problem.answer import Certificate, Multipliers, Solution, Status
    from transopt.problem.limits.limit import Limits
    from transopt.problem.problem import TransientProblem
    from transopt.proof.replay import Replay, replay
    from transopt.recordings.recording import Recording
    from transopt.recordings.settings import Recordings
    from transopt.recordings.tap import prepare
    from transopt.references.reference import Reference
    from transopt.references.references import References
    from transopt.report.write import write_report
    from transopt.scene.builtin import load_scene, scene_names
    from transopt.scene.file import with_model, with_plant
    from transopt.scene.keys import with_values
    from transopt.scene.recordings import read_recordings, recordings_of, references_of
    from transopt.scene.scene import Scene
    from transopt.solvers.choose import solve as solve_problem
    from transopt.solvers.options import SolverOptions
    from transopt.solvers.own import own_limit
    from transopt.web.serve import page

__all__ = [
    "Build",
    "Certificate",
    "Entry",
    "Input",
    "InputError",
    "Library",
    "Limits",
    "Multipliers",
    "Online",
    "Output",
    "Recording",
    "Recordings",
    "Reference",
    "References",
    "Replay",
    "Scene",
    "Solution",
    "SolverOptions",
    "StateSpace",
    "Status",
    "TransientProblem",
    "Waveform",
    "build",
    "certify",
    "design_nonlinear",
    "export_drive",
    "export_library",
    "load_library",
    "load_scene",
    "own_limit",
    "page",
    "prepare",
    "read_recordings",
    "recordings_of",
    "references_of",
    "replay",
    "scene_names",
    "solve",
    "solve_problem",
    "trade_figures",
    "verify",
    "with_model",
    "with_plant",
    "with_values",
    "write_report",
]

# Name -> the room that has it, and what it is called there where that is another name.
_HOME = {
    "Build": "design.build",
    "Certificate": "problem.answer",
    "Entry": "design.entry",
    "Input": "plant.state_space",
    "InputError": "base.errors",
    "Library": "library.library",
    "Limits": "problem.limits.limit",
    "Multipliers": "problem.answer",
    "Online": "library.online",
    "Output": "plant.state_space",
    "Recording": "recordings.recording",
    "Recordings": "recordings.settings",
    "Reference": "references.reference",
    "References": "references.references",
    "Replay": "proof.replay",
    "Scene": "scene.scene",
    "Solution": "problem.answer",
    "SolverOptions": "solvers.options",
    "StateSpace": "plant.state_space",
    "Status": "problem.answer",
    "TransientProblem": "problem.problem",
    "Waveform": "library.place",
    "build": "design.solve",
    "certify": "design.solve",
    "export_drive": "library.drive_files",
    "design_nonlinear": "design.solve",
    "export_library": "library.export",
    "load_library": "library.file",
    "load_scene": "scene.builtin",
    "own_limit": "solvers.own",
    "page": "web.serve",
    "prepare": "recordings.tap",
    "read_recordings": "scene.recordings",
    "recordings_of": "scene.recordings",
    "references_of": "scene.recordings",
    "replay": "proof.replay",
    "scene_names": "scene.builtin",
    "solve": "design.solve",
    "solve_problem": "solvers.choose:solve",
    "trade_figures": "library.trade",
    "verify": "design.verify:verify_library",
    "with_model": "scene.file",
    "with_plant": "scene.file",
    "with_values": "scene.keys",
    "write_report": "report.write",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    room, _, there = _HOME[name].partition(":")
    value = getattr(import_module(f"{__name__}.{room}"), there or name)
    globals()[name] = value  # the next time it is simply there
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
