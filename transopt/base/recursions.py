"""Linear recursions over the stages, and a spline: compiled or, without the extension, by banded triangular systems.

The recursion x_(k+1) = P_k x_k + f_k with m states, written for all k at once, is a unit lower triangular system with
2 m - 1 diagonals below the main one. BLAS solves it with the recursion's own products and sums, in a fiftieth of the
time of a loop in Python; the optional extension `native/recursions.c` takes a fifth of that. The two differ in the
last bits by rounding.
"""

from __future__ import annotations

import ctypes as ct
import math
import os
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from transopt.base.signals import FloatArray  # it imports this module for its spline

CHUNK = 128  # stages in one band matrix, reused for a constant A
EXTENSION = "_recursions.pyd" if os.name == "nt" else "_recursions.so"
MOST_STATES, MOST_WIDTH, MOST_LARGEST, MOST_FEW, MOST_DENSE, MOST_OUTPUTS = 64, 96, 192, 4, 256, 4  # of recursions.c


def _library() -> ct.CDLL | None:
    file = Path(__file__).with_name("native") / EXTENSION
    if not file.exists():
        return None
    library = ct.CDLL(str(file))
    most = {"states": MOST_STATES, "width": MOST_WIDTH, "largest": MOST_LARGEST, "few": MOST_FEW, "dense": MOST_DENSE}
    size, count, array = ct.c_size_t, ct.c_int, ct.c_void_p
    takes: dict[str, tuple[type, ...]] = {
        "tr_run": (size, count, array, array),
        "tr_forwards": (size, count, array, array),
        "tr_backwards": (size, count, array, array),
        "tr_courses": (size, size, *(count,) * 4, *(array,) * 6, count),
        "tr_largest": (size, size, *(count,) * 5, *(array,) * 7),
        "tr_square_means": (size, size, array, ct.c_double, *(array,) * 3),
        "tr_heated": (size, size, *(array,) * 5),
        "tr_bilinear": (size, count, *(array,) * 3, ct.c_double, array, array),
        "tr_spline": (size, size, array, size, *(array,) * 3),
        "tr_spline_even": (size, array, size, ct.c_double, ct.c_double, array, array),
        "tr_struck": (size, count, count, size, *(array,) * 6),
        "tr_walled": (size, size, *(count,) * 3, size, size, *(array,) * 8),
    }
    calls = [*takes, *(f"tr_most_{name}" for name in most)]
    if not all(hasattr(library, name) for name in calls):
        return None  # built from another version: not usable
    if any(getattr(library, f"tr_most_{name}")() != number for name, number in most.items()):
        return None
    for name, given in takes.items():
        call = getattr(library, name)
        call.restype, call.argtypes = None, given
    return library


def address(array: NDArray[Any]) -> int:
    """Address of the first element of a contiguous array, for a call in C."""
    # Takes half the time of `array.ctypes.data`; for an array of structures, which it describes, a hundred times it.
    found: int = array.__array_interface__["data"][0]
    return found


COMPILED = _library()


class Recursion:
    """The recursion x_k = A x_(k-1) + forcing_k with a constant matrix A (m, m)."""

    def __init__(self, A: FloatArray) -> None:
        self._A = np.ascontiguousarray(A, dtype=float)

    def run(self, forcing: FloatArray) -> FloatArray:
        """(N, m) states for a forcing (N, m), starting with x_0 = forcing_0."""
        N, m = forcing.shape
        if COMPILED is not None and m <= MOST_STATES:
            found = np.array(forcing, dtype=float, order="C")
            COMPILED.tr_run(N, m, address(self._A), address(found))
            return found
        found = np.empty(forcing.shape)
        for start in range(0, N, CHUNK):
            part = forcing[start : start + CHUNK].copy()
            if start:
                part[0] += self._A @ found[start - 1]
            found[start : start + CHUNK] = _substituted(self._band, part, transposed=False)
        return found

    @cached_property
    def _band(self) -> FloatArray:
        """(2 m, CHUNK m) band matrix of `CHUNK` stages."""
        block = _band(self._A[None]).T
        columns = np.empty((CHUNK, *block.shape))
        columns[:] = block
        return columns.reshape(-1, block.shape[1]).T


class LinearSystem:
    """Outputs y_k = C x_k + D u_k along x_(k+1) = A x_k + B u_k from rest, and their transpose.

    Parameters
    ----------
    A : (m, m).
    B : (m, p).
    C : (q, m).
    D : (q, p).
    """

    def __init__(self, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> None:
        self.A, self.B, self._C, self._D = A, B, C, D
        self._dtype = np.result_type(A, B, C, D)

    def outputs(self, inputs: FloatArray) -> FloatArray:
        """(..., q, N) outputs for inputs (..., p, N), each time series on its own."""
        return self._along(inputs, back=False)

    def transposed(self, by_outputs: FloatArray) -> FloatArray:
        """(..., p, N) gradient of a function by the inputs, from its gradient by the outputs (..., q, N)."""
        return self._mirror._along(by_outputs, back=True)

    def largest(
        self, inputs: FloatArray, start: FloatArray | None = None, *, terms: int = 1
    ) -> tuple[FloatArray, FloatArray]:
        """Largest |y| of each output along M courses, from any states on; NaN where a course has one.

        Parameters
        ----------
        inputs : (M, p, N).
        start : (M, m) states at first; by default zero.
        terms : so many outputs one after the other are the terms of one sum of absolute values.

        Returns
        -------
        (M, q / terms) largest values and (M, m) states after the last input.
        """
        (M, p, N), (q, m) = inputs.shape, self._C.shape
        states = np.zeros((M, m)) if start is None else np.array(start, dtype=float, order="C")
        found = np.empty((M, q // terms))
        if COMPILED is not None and m <= MOST_STATES and p <= MOST_WIDTH and q // terms <= MOST_LARGEST:
            inputs = np.ascontiguousarray(inputs, dtype=float)
            given = *self._compiled(M), *map(address, (inputs, states, found))
            COMPILED.tr_largest(M, N, m, p, q, terms, *given)
            return found, states
        for course in range(M):
            outputs, states[course] = self._one_along(inputs[course], np.dtype(float), start=states[course])
            sums = np.abs(outputs).reshape(q // terms, terms, N).sum(axis=1)
            found[course] = sums.max(axis=1, initial=0.0)
        return found, states

    @cached_property
    def _mirror(self) -> LinearSystem:
        """The adjoint system, which runs backward in time: lambda_k = A' lambda_(k+1) + C' g_k."""
        return LinearSystem(self.A.T, self._C.T, self.B.T, self._D.T)

    def _along(self, inputs: FloatArray, *, back: bool) -> FloatArray:
        (*courses, p, N), (q, m), dtype = inputs.shape, self._C.shape, np.result_type(self._dtype, inputs)
        found = np.empty((*courses, q, N), dtype=dtype)
        wide = max(m + q, p) > MOST_WIDTH or m > MOST_STATES
        if dtype == np.float64 and COMPILED is not None and not wide:
            inputs, number = np.ascontiguousarray(inputs, dtype=float), math.prod(courses)
            given = *self._compiled(number), address(inputs), address(found)
            COMPILED.tr_courses(number, N, m, p, q, *given, back)
            return found
        for each in np.ndindex(*courses):
            along = inputs[each][:, ::-1] if back else inputs[each]
            outputs, _ = self._one_along(along, dtype, start=np.zeros(m))
            found[each] = outputs[:, ::-1] if back else outputs
        return found

    def _one_along(self, inputs: FloatArray, dtype: np.dtype, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(q, N) outputs and (m,) states after the last of the inputs (p, N)."""
        N, m = inputs.shape[1], self._C.shape[1]
        states = np.zeros((N + 1, m), dtype=dtype)
        states[0], states[1:] = start, inputs.T @ self.B.T
        if dtype == np.float64:
            states = self._recursion.run(states)
        else:
            for k in range(1, N + 1):  # neither BLAS nor the extension has extended precision
                states[k] += self.A @ states[k - 1]
        return self._C @ states[:-1].T + self._D @ inputs, states[-1]

    @cached_property
    def _recursion(self) -> Recursion:
        return Recursion(self.A)

    def _compiled(self, courses: int) -> tuple[int | None, ...]:
        """Width and addresses as `recursions.c` takes the system; few courses do not need its sparse rows."""
        width = self._columns.shape[1]
        few = courses <= MOST_FEW and width <= MOST_DENSE
        return width, address(self._columns), *((None,) * 3 if few else map(address, self._sparse))

    @cached_property
    def _rows(self) -> FloatArray:
        """(q + m, p + m) rows [D C; B A], which sum over inputs and states."""
        by_inputs, by_states = (np.concatenate(of) for of in ((self._D, self.B), (self._C, self.A)))
        return np.concatenate([by_inputs, by_states], axis=1)

    @cached_property
    def _columns(self) -> FloatArray:
        """(p + m, width) their columns, padded with zeros to a multiple of eight."""
        height, width = self._rows.shape
        found = np.zeros((width, height + -height % 8))
        found[:, :height] = self._rows.T
        return found

    @cached_property
    def _sparse(self) -> tuple[NDArray[Any], ...]:
        return sparse(self._rows)


def sparse(rows: FloatArray) -> tuple[NDArray[Any], ...]:
    """Starts, columns and values of the entries of sparse rows as `recursions.c` takes them, at least one each."""
    stated = rows != 0
    stated[:, 0] = True
    starts = np.zeros(len(rows) + 1, dtype=np.int32)
    np.cumsum(stated.sum(axis=1), out=starts[1:])
    return starts, np.nonzero(stated)[1].astype(np.int32), rows[stated].astype(float)


def bilinear(
    M: FloatArray, b: FloatArray, gain: FloatArray, by_first: float, h: FloatArray, start: FloatArray
) -> FloatArray:
    """(N + 1, m) states of x_(k+1) = M x_k + b (gain_k + by_first x_k[0]) h_k, starting with x_0 = start.

    Parameters
    ----------
    M : (m, m).
    b, start : (m,).
    gain, h : (N,).
    """
    found = np.empty((h.size + 1, b.size))
    found[0] = start
    if COMPILED is not None:
        given = [np.ascontiguousarray(each, dtype=float) for each in (M, b, gain, h)]
        M, b, gain, h = given
        COMPILED.tr_bilinear(
            h.size, b.size, address(M), address(b), address(gain), by_first, address(h), address(found)
        )
        return found
    P = np.repeat(M[None], h.size, axis=0)
    P[:, :, 0] += b * (by_first * h)[:, None]
    forcing = b * (gain * h)[:, None]
    forcing[0] += P[0] @ start
    found[1:] = forwards(P[1:], forcing)
    return found


def square_means(factors: FloatArray, ripple: float, before: FloatArray, command: FloatArray) -> FloatArray | None:
    """Means of (|i| + ripple)^2 where i follows a held command through one pole; None without the extension.

    Parameters
    ----------
    factors : (4, K) of steps of w times their length x: x, exp(-x), (1 - exp(-x)) / x and (1 - exp(-2 x)) / (2 x).
    before, command : (..., K) i at the start of each step, and the command during it.
    """
    if COMPILED is None:
        return None
    before, command = (np.ascontiguousarray(each, dtype=float) for each in np.broadcast_arrays(before, command))
    found, K = np.empty(before.shape), before.shape[-1]
    given = address(np.ascontiguousarray(factors)), ripple, *map(address, (before, command, found))
    COMPILED.tr_square_means(before.size // max(K, 1), K, *given)
    return found


def heated(heat: FloatArray, squares: FloatArray, steps: FloatArray, start: FloatArray) -> FloatArray | None:
    """Temperatures of a coil's two nodes, dT/dt = m T + c, exact for M heatings; None without the extension.

    A step of constant heating q has m = ((h_0 q - h_1, h_1), (h_2, h_3)) with real eigenvalues and c = (h_4 q, h_5).

    Parameters
    ----------
    heat : (6,) the numbers h.
    squares, steps : (M, K) heatings q and (K,) lengths of the steps.
    start : (M, 2) temperatures at the start.

    Returns
    -------
    (2, M, K + 1) temperatures of both nodes, the start first; infinite from an overflow on.
    """
    if COMPILED is None:
        return None
    M, K = squares.shape
    found = np.empty((2, M, K + 1))
    found[..., 0] = start.T
    given = [np.ascontiguousarray(each, dtype=float) for each in (heat, squares, steps)]
    COMPILED.tr_heated(M, K, *map(address, (*given, *found)))
    return found


def spline(y: FloatArray, places: FloatArray) -> FloatArray:
    """(n, c) values of the cubic not-a-knot splines through c series; the outermost pieces are extrapolated.

    The slopes d at the knots, per spacing, satisfy d_(k-1) + 4 d_k + d_(k+1) = 3 (y_(k+1) - y_(k-1)).

    Parameters
    ----------
    y : (K, c) values at evenly spaced knots, K >= 4.
    places : (n,) positions, in spacings from the first knot.
    """
    K, courses = y.shape
    if COMPILED is not None:
        y, places = (np.ascontiguousarray(each, dtype=float) for each in (y, places))
        found, work = np.empty((places.size, courses)), np.empty(K * (courses + 1))
        COMPILED.tr_spline(K, courses, address(y), places.size, *map(address, (places, work, found)))
        return found
    from scipy.linalg import lapack

    below, diagonal, above = np.ones(K - 1), np.full(K, 4.0), np.ones(K - 1)
    diagonal[[0, -1]], above[0], below[-1] = 1.0, 2.0, 2.0
    right = np.empty(y.shape)
    right[1:-1] = 3 * (y[2:] - y[:-2])
    right[0] = 0.5 * (4 * y[1] + y[2] - 5 * y[0])
    right[-1] = 0.5 * (5 * y[-1] - 4 * y[-2] - y[-3])
    slopes = lapack.dgtsv(below, diagonal, above, right)[3]
    left = np.clip(places.astype(int), 0, K - 2)
    t, rise, before, after = (places - left)[:, None], y[left + 1] - y[left], slopes[left], slopes[left + 1]
    curved = 3 * rise - 2 * before - after + t * (before + after - 2 * rise)
    return np.asarray(y[left] + t * (before + t * curved))


def spline_even(y: FloatArray, first: float, step: float, count: int) -> FloatArray:
    """(count,) values of `spline` through one series (K,) at positions first, first + step, ..., step > 0."""
    if COMPILED is None:
        return spline(y[:, None], np.asarray(first + step * np.arange(count), dtype=float))[:, 0]
    y, found, work = np.ascontiguousarray(y, dtype=float), np.empty(count), np.empty(2 * y.size)
    COMPILED.tr_spline_even(y.size, address(y), count, first, step, address(work), address(found))
    return found


def forwards(P: FloatArray, forcing: FloatArray) -> FloatArray:
    """(K, m) states of x_k = P_(k-1) x_(k-1) + forcing_k, starting with x_0 = forcing_0; P is (K - 1, m, m)."""
    return _changing(P, forcing, transposed=False)


def backwards(P: FloatArray, forcing: FloatArray) -> FloatArray:
    """(K, m) states of x_k = P_k' x_(k+1) + forcing_k, from x_(K-1) = forcing_(K-1); the transpose of `forwards`."""
    return _changing(P, forcing, transposed=True)


def _changing(P: FloatArray, forcing: FloatArray, *, transposed: bool) -> FloatArray:
    if COMPILED is None:
        last = np.zeros((1, *P.shape[1:]))  # pads the band; the last stage has no step
        return _substituted(_band(np.concatenate([P, last])), forcing, transposed=transposed)
    P, found = np.ascontiguousarray(P), np.array(forcing, order="C")
    call = COMPILED.tr_backwards if transposed else COMPILED.tr_forwards
    call(*found.shape, address(P), address(found))
    return found


def _band(P: FloatArray) -> FloatArray:
    """The matrix of x_(k+1) - P_k x_k for k = 0..K-1, in BLAS's storage of a lower band matrix.

    Parameters
    ----------
    P : (K, m, m).

    Returns
    -------
    (2 m, K m) : column j m + i holds the diagonal and the subdiagonals of state i of stage j.
    """
    K, m, _ = P.shape
    columns = np.zeros((K, m, 2 * m))
    for j in range(m):
        columns[:, j, m - j : 2 * m - j] = -P[:, :, j]
    return columns.reshape(K * m, 2 * m).T


def _substituted(lower: FloatArray, forcing: FloatArray, *, transposed: bool) -> FloatArray:
    """(K, m) solution of the triangular system with the given band (2 m, at least K m)."""
    from scipy.linalg import blas

    K, m = forcing.shape
    solved = blas.dtbsv(2 * m - 1, lower[:, : K * m], forcing.ravel(), lower=1, trans=int(transposed), diag=1)
    return np.asarray(solved).reshape(K, m)


def filtered(b: FloatArray, a: FloatArray, values: FloatArray) -> FloatArray:
    """(..., K) output of the digital filter b / a from rest, equal to that of `scipy.signal.lfilter`.

    `lfilter` itself is not used because a tap may have to be solved between approach and contact, and loading
    scipy.signal takes longer than solving a hundred taps. The states are those of the transposed direct form II.

    Parameters
    ----------
    b, a : coefficients of z^0, z^-1, ...
    """
    order = max(a.size, b.size) - 1
    b, a = np.pad(b, (0, order + 1 - b.size)) / a[0], np.pad(a[1:], (0, order + 1 - a.size)) / a[0]
    A = np.eye(order, k=1)
    A[:, 0] -= a
    system = LinearSystem(A, (b[1:] - a * b[0])[:, None], np.eye(1, order), b[:1, None])
    return system.outputs(values[..., None, :])[..., 0, :]


def strike(
    rows: FloatArray, contact: tuple[float, float, float], start: FloatArray, found: FloatArray
) -> FloatArray | None:
    """Simulate V strikes of a linear system against a contact; None without the extension.

    A step of the fourth-order Runge-Kutta method is written as `rows`, each a linear combination of the states and of
    the forces at the four Runge-Kutta stages. They give depth delta and closing speed at each stage, from which the
    force k delta^e (1 + c d delta/dt) >= 0 follows; then the outputs, and the states after the step.

    Parameters
    ----------
    rows : (8 + q + n, n + 4); the rows of a Runge-Kutta stage only use the forces of earlier stages.
    contact : k, e and c.
    start : (n, V) initial states.
    found : (steps + 1, q, V) contiguous; receives the outputs.

    Returns
    -------
    (n, V) final states.
    """
    n, (instants, outputs, courses) = start.shape[0], found.shape
    if COMPILED is None or n > MOST_STATES or outputs > MOST_OUTPUTS:
        return None
    given = (*sparse(rows), np.array(contact), np.array(start, dtype=float, order="C"), found)
    COMPILED.tr_struck(instants - 1, n, outputs, courses, *map(address, given))
    return given[-2]
