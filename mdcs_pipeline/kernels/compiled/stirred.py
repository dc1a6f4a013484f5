"""Which patches of points have to be looked at again once some of the points have moved."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.grid import Grid, row_of, span_of
from mdcs_pipeline.kernels.compiled.types import BoolArray, FloatArray, IntArray

# Points that a place is compared with one by one.
_FEW = 48


@njit(cache=True, nogil=True)
def near_any(
    grid: Grid, reach: FloatArray, some: BoolArray, which: IntArray, before: FloatArray
) -> BoolArray:
    """Return the points that are of `some`, or within reach of one where it is or was before.

    For all others `within` finds what it found before, in the places where it was.

    Parameters
    ----------
    grid : Grid
    reach : (n,) float64
    some : (n,) bool
        In the grid's order; all others are where they were.
    which : (k,) int64
        Points that are asked for.
    before : (n, 3) float64
        Where the points were.

    Returns
    -------
    (k,) bool
    """
    points, n = grid.points, len(grid.points)
    starts, keys, low, size = grid.starts, grid.keys, grid.low, grid.size
    shape = grid.shape[0], grid.shape[1], grid.shape[2]
    count = np.zeros(n + 1, np.int64)
    for k in range(n):
        count[k + 1] = count[k] + some[k]
    result = some[which]
    if count[n] == n:
        return result
    # Sooner gone through one by one than a point's cells are.
    few = np.flatnonzero(some)[: _FEW + 1]
    for at in range(len(which)):
        place, far = points[which[at]], reach[which[at]]
        # Round-off must not lose a point.
        squared = far * far * (1.0 + 1e-9)
        if result[at]:
            continue
        if len(few) <= _FEW:
            for k in few:
                near = min(_apart(points[k], place), _apart(before[k], place))
                result[at] |= near <= squared
            continue
        x = span_of(low[0], size, shape[0], place[0] - far, place[0] + far)
        y = span_of(low[1], size, shape[1], place[1] - far, place[1] + far)
        z = span_of(low[2], size, shape[2], place[2] - far, place[2] + far)
        for i in range(x[0], x[1] + 1):
            if result[at] or z[0] > z[1]:
                break
            for j in range(y[0], y[1] + 1):
                start, stop = row_of(starts, keys, shape, i, j, z[0], z[1])
                # Most rows have none.
                if count[stop] == count[start]:
                    continue
                for k in range(start, stop):
                    if some[k]:
                        near = min(_apart(points[k], place), _apart(before[k], place))
                        result[at] |= near <= squared
    return result


@njit(cache=True, nogil=True, inline="always")
def _apart(one: FloatArray, other: FloatArray) -> float:
    """Return the square of two places' distance."""
    x, y, z = one[0] - other[0], one[1] - other[1], one[2] - other[2]
    apart: float = x * x + y * y + z * z
    return apart
