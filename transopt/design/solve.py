"""From a scene, by name, path or value, to its library in one call; and the proof of one answer."""

from collections.abc import Sequence
from pathlib import Path

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.design.build import Build, build_library
from transopt.design.refine_grid import DEFAULT_CAP, check_tolerance, refine_grid
from transopt.library.library import Library
from transopt.problem.answer import Certificate, Multipliers
from transopt.problem.problem import TransientProblem
from transopt.recordings.recording import Recording
from transopt.scene.builtin import load_scene
from transopt.scene.recordings import Files, recordings_in, recordings_of
from transopt.scene.scene import Scene
from transopt.solvers.choose import check_name, prove
from transopt.solvers.options import SolverOptions


@one_blas_thread()
def build(
    scene: Scene | str | Path,
    recordings: Sequence[Recording] | Files | None = None,
    *,
    options: SolverOptions | None = None,
    grid_tolerance: float | None = None,
    grid_cap: int = DEFAULT_CAP,
    accept_unfit_model: bool = False,
) -> Build:
    """Design, certify and replay every entry of a scene; the answer has the refused ones too.

    Parameters
    ----------
    scene : a scene, the name of a built-in one, or the path of a .toml file.
    recordings : to be reproduced in place of those that the scene names, or paths of files or folders with them.
    options : solver and its tolerance; the default is the project's own method.
    grid_tolerance : nodes are added until a blend between them is this close to the optimum (0.02: 2 %), but not
        beyond `grid_cap`; without it the scene's grid is taken as it stands.
    accept_unfit_model : design although the scene's model file says that it is not fit to design with.

    Raises
    ------
    InputError : a scene, a recording or an option that cannot be used.
    """
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    if not accept_unfit_model and (reason := loaded.unfit_model()):
        raise InputError(f"{reason}; identify it again, or pass accept_unfit_model=True")
    options = SolverOptions() if options is None else options
    check_name(options.solver)
    if grid_tolerance is not None:
        check_tolerance(loaded, grid_tolerance, grid_cap)
    taps = recordings_of(loaded) if recordings is None else recordings_in(loaded, recordings)
    refinement = None
    if grid_tolerance is not None:
        refinement = refine_grid(loaded, taps, grid_tolerance, cap=grid_cap, options=options)
    return build_library(loaded, taps, options=options, refinement=refinement)


def solve(
    scene: Scene | str | Path,
    recordings: Sequence[Recording] | Files | None = None,
    *,
    options: SolverOptions | None = None,
    grid_tolerance: float | None = None,
    grid_cap: int = DEFAULT_CAP,
    accept_unfit_model: bool = False,
) -> Library:
    """The library of a scene, every entry certified and replayed; parameters as of `build`.

    The entries of a scene with `[model.nonlinear]` are stationary points on the nonlinear plant.

    Raises
    ------
    InputError : what `build` refuses; or entries that are refused, with the first one's reason.
    """
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    if loaded.nonlinear and (recordings is not None or grid_tolerance is not None):
        raise InputError(
            f"{loaded.name}: recordings and grid_tolerance are for speeds, and model.nonlinear has targets: leave "
            "them out"
        )
    made = build(
        loaded,
        recordings,
        options=options,
        grid_tolerance=grid_tolerance,
        grid_cap=grid_cap,
        accept_unfit_model=accept_unfit_model,
    )
    if made.library is not None:
        return made.library
    first, count = made.refused[0], sum(1 for _ in made.all_entries())
    reason = "; ".join(first.shortfalls) or first.status.value
    raise InputError(
        f"{made.scene.name}: {len(made.refused)} of {count} entries refused, the first at "
        f"{first.place}: {reason}; transopt.build returns all of them with their reasons"
    )


def design_nonlinear(scene: Scene | str | Path, *, options: SolverOptions | None = None) -> Build:
    """Design every target of a scene for its nonlinear plant, beside the linear design for the plant at rest.

    Each entry is a certified stationary point that was replayed on the nonlinear plant; `linear_command` and
    `linear_played` are those of the design for the plant at rest, played there too.

    Parameters
    ----------
    scene : a scene with `[[targets]]` and `[model.nonlinear]`, or the path of its .toml file.
    options : tolerance and largest number of iterations of IPOPT; its `solver` is that of the linear design.

    Raises
    ------
    InputError : a scene without `model.nonlinear`, or with a part that no nonlinear plant can have yet; a target that
        cannot serve.
    """
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    loaded.nonlinear_plant()
    return build(loaded, options=options)


@one_blas_thread()
def certify(
    problem: TransientProblem,
    command: FloatArray,
    multipliers: Multipliers,
    options: SolverOptions | None = None,
) -> Certificate:
    """Proof that a command is optimal, or by how much it may not be, whoever found it.

    The command is rolled out anew, and with the multipliers bounds how far the objective lies above the optimum.
    Where the problem limits the winding's temperature it is not convex; its convex relaxation is then solved for the
    bound.

    Parameters
    ----------
    command : (N,). multipliers : of the same problem, as a `Solution` or a library has them.
    """
    return prove(problem, command, multipliers, SolverOptions() if options is None else options)
