"""Anderson's extrapolation of a fixed-point iteration."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray

# Share of the trace that is added to the diagonal of the least squares.
RIDGE = 1e-10


@njit(cache=True, nogil=True)
def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution of a small linear system, by elimination with pivots."""
    left, answer = matrix.copy(), right.copy()
    n = len(answer)
    for c in range(n):
        pivot = c
        for r in range(c + 1, n):
            if abs(left[r, c]) > abs(left[pivot, c]):
                pivot = r
        for k in range(n):
            left[c, k], left[pivot, k] = left[pivot, k], left[c, k]
        answer[c], answer[pivot] = answer[pivot], answer[c]
        for r in range(c + 1, n):
            factor = left[r, c] / left[c, c]
            for k in range(c, n):
                left[r, k] -= factor * left[c, k]
            answer[r] -= factor * answer[c]
    for c in range(n - 1, -1, -1):
        for k in range(c + 1, n):
            answer[c] -= left[c, k] * answer[k]
        answer[c] /= left[c, c]
    return answer


@njit(cache=True, nogil=True, fastmath=True)
def _dot(a: FloatArray, b: FloatArray) -> float:
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@njit(cache=True, nogil=True)
def mixed_step(
    point: FloatArray,
    residual: FloatArray,
    root: FloatArray,
    clip: float,
    moves: FloatArray,
    turns: FloatArray,
    normal: FloatArray,
    held: int,
) -> int:
    """Move `point` to the next one of z ← G(z), where G(z) − z is `residual` (type II).

    Parameters
    ----------
    point, residual, root : (m,) float64
        `root` are the roots of the least squares' weights.
    clip : float
        Largest change of a component.
    moves, turns : (depth + 1, m) float64
        Differences of G(z), and of the weighted residuals, over the last steps; the last
        row holds both as they are now. Written to.
    normal : (depth, depth) float64
        Products of the rows of `turns`. Written to.
    held : int
        Points seen since it was last cleared; 0 clears.

    Returns
    -------
    int
        `held` for the next call.
    """
    depth, m = len(normal), len(point)
    plain = point + residual
    scaled = residual * root
    if held > 0:
        row = (held - 1) % depth
        moves[row] = plain - moves[depth]
        turns[row] = scaled - turns[depth]
    moves[depth], turns[depth] = plain, scaled
    used = min(held, depth)
    if used == 0:
        point[:] = plain
        return 1
    right = np.empty(used)
    for k in range(used):
        normal[row, k] = normal[k, row] = _dot(turns[row], turns[k])
        right[k] = _dot(turns[k], scaled)
    # Tikhonov term: the normal matrix turns singular as the iteration converges.
    system = normal[:used, :used].copy()
    ridge = RIDGE * np.trace(system) + 1e-300
    for k in range(used):
        system[k, k] += ridge
    gamma = solved(system, right)
    for k in range(used):
        for i in range(m):
            plain[i] -= gamma[k] * moves[k, i]
    for i in range(m):
        point[i] += min(max(plain[i] - point[i], -clip), clip)
    return held + 1
