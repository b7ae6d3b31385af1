"""QP solvers that know nothing of this project: HPIPM through CasADi, and those of the `bench` extra."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata, util
from typing import Any

import casadi as ca
import numpy as np
from scipy import linalg, sparse

from precision.cases import Case
from precision.methods import TIME_LIMIT_S, Answer, Kind, Level, Method, Prepared, Setting, sweep
from precision.qp import QP, project_multipliers
from transopt.base.signals import FloatArray

EXTRA = ("piqp", "clarabel", "osqp", "daqp")
PIP_LINE = "pip install '.[bench]'"


@dataclass(frozen=True)
class Point:
    """What a QP solver returns: x (V,), y (m + b,) where it gives one, its own status and iterations."""

    x: FloatArray
    y: FloatArray | None
    status: str
    iterations: int


Solve = Callable[[], Point]


def qp_method(name: str, version: str, settings: Sequence[Setting], build: Callable[[QP, Setting], Solve]) -> Method:
    """A method for the cases that are QPs."""

    def prepare(case: Case, setting: Setting) -> Prepared:
        qp = case.qp
        assert qp is not None

        def read(point: Point) -> Answer:
            multipliers = None if point.y is None else project_multipliers(case.small, qp, point.y)
            return Answer(qp.command(point.x), point.status, point.iterations, multipliers)

        return Prepared(build(qp, setting), read)

    return Method(name, version, Kind.SOLVER, lambda case: [] if case.qp is None else settings, prepare)


# ------------------------------------------------------------------------------------------------ HPIPM


def hpipm() -> Method:
    """CasADi's conic plugin. It asks for more digits than it reaches, which is its status 1: the residuals decide."""

    def build(qp: QP, setting: Setting) -> Solve:
        N, n, m = qp.stages, len(qp.A_d), qp.rows
        # It wants its dynamics as A z + B dc - z_next = 0.
        A = ca.DM(sparse.csc_matrix(-qp.A[:m]))
        P = ca.DM(sparse.csc_matrix(qp.P))
        lower, upper = qp.bounds()
        limits = [0] * (N + 1 - qp.hand_over_samples) + [1] * qp.hand_over_samples
        options: dict[str, Any] = {"N": N, "nx": [0, *[n] * N], "nu": [*[1] * N, 0], "ng": limits}
        if np.isfinite(setting.tolerance):
            options["hpipm"] = {f"res_{kind}_max": setting.tolerance for kind in "gbdm"}
        sparsity = {"h": P.sparsity(), "a": A.sparsity()}
        solver = ca.conic("hpipm", "hpipm", sparsity, {**options, "error_on_fail": False, "print_time": False})

        def solve() -> Point:
            found = solver(h=P, g=qp.q, a=A, lba=-qp.u[:m], uba=-qp.l[:m], lbx=lower, ubx=upper)
            on_rows, on_variables = -np.asarray(found["lam_a"]).ravel(), np.asarray(found["lam_x"]).ravel()
            statistics = solver.stats()
            return Point(
                x=np.asarray(found["x"]).ravel(),
                y=np.append(on_rows, on_variables[qp.boxed]),
                status=f"return status {statistics['return_status']}",
                iterations=int(statistics["iter_count"]),
            )

        return solve

    # Beyond 1e-6 it does not stop by itself any more.
    settings = sweep("CasADi's defaults, 100 iterations", (1e-2, 1e-4, 1e-6, 1e-8), 1e-6, "res_max")
    return qp_method("hpipm (CasADi)", metadata.version("casadi"), settings, build)


# ------------------------------------------------------------------------------------------------ the extra's


def piqp_multistage(qp: QP, setting: Setting) -> Solve:
    """PIQP called directly, with its factorisation for problems that are ordered by stages."""
    import piqp

    P, A, m = sparse.csc_matrix(qp.P), sparse.csc_matrix(qp.A[: qp.rows]), qp.rows
    lower, upper = qp.bounds()
    solver = piqp.SparseSolver()
    solver.settings.num_threads = 1
    solver.settings.kkt_solver = piqp.KKTSolver.sparse_multistage
    if np.isfinite(setting.tolerance):
        solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = setting.tolerance
        solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 0.0
    solver.setup(P, qp.q, A, qp.l[:m], None, None, None, lower, upper)

    def solve() -> Point:
        status = solver.solve()  # which begins anew every time
        found = solver.result
        y = np.append(found.y, (found.z_bu - found.z_bl)[qp.boxed])
        return Point(np.array(found.x), y, status.name, int(found.info.iter))

    return solve


def _clarabel(qp: QP, setting: Setting) -> Solve:
    import clarabel

    m, box = qp.rows, qp.A[qp.rows :]
    b = box.shape[0]
    P = sparse.csc_matrix(sparse.triu(qp.P))
    A = sparse.csc_matrix(sparse.vstack([qp.A[:m], box, -box]))
    bounds = np.concatenate([qp.u, -qp.l[m:]])
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads, settings.time_limit = False, 1, TIME_LIMIT_S
    settings.presolve_enable = False  # as new numbers need it; there is nothing for it to remove
    if np.isfinite(setting.tolerance):
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = setting.tolerance
    solver = clarabel.DefaultSolver(
        P, qp.q, A, bounds, [clarabel.ZeroConeT(m), clarabel.NonnegativeConeT(2 * b)], settings
    )

    def solve() -> Point:
        solver.update(P=P, q=qp.q, A=A, b=bounds)
        found = solver.solve()
        z = np.array(found.z)
        return Point(
            np.array(found.x), np.append(z[:m], z[m : m + b] - z[m + b :]), str(found.status), found.iterations
        )

    return solve


def _osqp(qp: QP, setting: Setting) -> Solve:
    import osqp

    P, A = sparse.csc_matrix(sparse.triu(qp.P)), sparse.csc_matrix(qp.A)
    chosen: dict[str, Any] = {}
    if np.isfinite(setting.tolerance):
        chosen = {"eps_abs": setting.tolerance, "eps_rel": setting.tolerance, "max_iter": 1_000_000}
    polishing = setting.level is Level.HIGH
    solver = osqp.OSQP()
    solver.setup(P, qp.q, A, qp.l, qp.u, verbose=False, time_limit=TIME_LIMIT_S, polishing=polishing, **chosen)
    step = solver.settings.rho
    start = {"x": np.zeros(qp.q.size), "y": np.zeros(qp.l.size)}

    def solve() -> Point:
        # Neither the last solution nor the step size that it led to.
        solver.update(q=qp.q, l=qp.l, u=qp.u, Px=P.data, Ax=A.data)
        solver.update_settings(rho=step)
        solver.warm_start(**start)
        found = solver.solve(raise_error=False)
        return Point(np.asarray(found.x), np.asarray(found.y), str(found.info.status), int(found.info.iter))

    return solve


def condensed(qp: QP) -> dict[str, FloatArray]:
    """State the QP in its F free commands alone, in their unit: H (F, F), f (F,), A (N - 1, F) of the currents at
    tau_1 to tau_(N-1), and bounds of the commands followed by those of the currents.
    """
    N, (terms, instants) = qp.stages, qp.wanted.shape
    F = N - qp.hand_over_samples
    z, outputs, current = np.zeros(len(qp.A_d)), np.empty((terms, instants)), np.empty(instants)
    for k in range(instants):
        outputs[:, k], current[k] = qp.C_d @ z, z[qp.current_state]
        # A command that is held for one period.
        z = qp.A_d @ z + qp.B_d[:, 0] * (1.0 if k == 0 else -1.0 if k == 1 else 0.0)
    tracking = np.vstack([linalg.toeplitz(output, np.zeros(F)) for output in outputs])
    moving = np.eye(N, F) - np.eye(N, F, k=-1)
    weighted = qp.error_weights.reshape(-1, 1) * tracking
    smooth = qp.movement_weight * qp.current_unit_A**2
    upper = np.append(np.full(F, qp.command_limit_A), np.full(N - 1, qp.current_limit_A)) / qp.current_unit_A
    return {
        "H": 2 / qp.objective_scale * (tracking.T @ weighted + smooth * moving.T @ moving),
        "f": -2 / qp.objective_scale * (weighted.T @ qp.wanted.ravel()),
        "A": linalg.toeplitz(current[:N], np.zeros(F))[1:],
        "bupper": upper,
        "blower": -upper,
    }


DAQP_STATUS = {
    1: "optimal",
    2: "soft optimal",
    -1: "infeasible",
    -2: "cycling",
    -3: "unbounded",
    -4: "iteration limit",
}


def _daqp(qp: QP, setting: Setting) -> Solve:
    import daqp

    tight = {} if np.isnan(setting.tolerance) else {"primal_tol": setting.tolerance}
    free = qp.command_at[: qp.stages - qp.hand_over_samples]

    def solve() -> Point:
        found, _, code, info = daqp.solve(**condensed(qp), time_limit=TIME_LIMIT_S, **tight)
        x = np.zeros(qp.q.size)
        x[free] = found
        return Point(x, None, DAQP_STATUS.get(code, f"exit {code}"), int(info["iterations"]))

    return solve


def wheels() -> tuple[list[Method], list[str]]:
    """Methods of the `bench` extra that are installed, and the names of those that are not."""
    sweeps = {
        "piqp": (
            piqp_multistage,
            sweep("own defaults, multistage", (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12), 1e-12, "eps"),
        ),
        "clarabel": (_clarabel, sweep("own defaults", (1e-2, 1e-4, 1e-6, 1e-10, 1e-12), 1e-12, "tol")),
        "osqp": (_osqp, sweep("own defaults (1e-3)", (1e-4, 1e-5, 1e-6, 1e-8), 1e-8, "eps", ", polished")),
        "daqp": (_daqp, sweep("own defaults, condensed", (1e-10,), 1e-10, "condensed, primal_tol")),
    }
    missing = [name for name in EXTRA if util.find_spec(name) is None]
    found = [
        qp_method(name, metadata.version(name), sweeps[name][1], sweeps[name][0])
        for name in EXTRA
        if name not in missing
    ]
    return found, missing
