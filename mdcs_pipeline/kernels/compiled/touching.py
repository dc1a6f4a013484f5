"""The ball inside that touches the surface at each point.

All arrays are in the order of a `Grid`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.grid import Grid, row_of, span_of
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

# A ball that was guessed too small grows by this.
_SWELL = 1.5


@njit(cache=True, nogil=True)
def tangent_radii(
    grid: Grid,
    normals: FloatArray,
    most: FloatArray,
    apart: float,
    pierced: int,
    which: IntArray | None = None,
) -> FloatArray:
    """Return the radius of the largest ball inside that touches the surface at each point.

    The ball lies on the side that the normal turns away from. Only points that are seen from
    its centre at more than `apart` radians from where it touches limit it: what is nearer says
    how rough the sampling is.

    A ball is guessed and what lies in it is looked at: if that are enough points, the ball
    that they leave is the one that is sought; otherwise the guess was too small.

    Parameters
    ----------
    grid : Grid
    normals : (n, 3) float64
        Unit, outwards.
    most : (n,) float64
        Largest radius.
    apart : float
    pierced : int
        Points that may lie inside: the smallest balls of all are those of noise.
    which : (k,) int64, optional
        The points that are asked for; all when absent.

    Returns
    -------
    (k,) float64
    """
    asked = np.arange(len(grid.points)) if which is None else which
    result, least = np.empty(len(asked)), np.empty(pierced + 1)
    limit = 2.0 * (1.0 - np.cos(apart))
    guess = grid.size
    for at in range(len(asked)):
        i = asked[at]
        size = min(guess, most[i])
        while True:
            least[:] = size
            _limit_ball(grid, i, normals[i], size, limit, least)
            if least[pierced] < size or size >= most[i]:
                break
            size = min(_SWELL * size, most[i])
        result[at] = least[pierced]
        # Neighbours in the grid's order lie on the same limb, mostly.
        guess = 1.1 * least[pierced]
    return result


@njit(cache=True, nogil=True)
def _limit_ball(
    grid: Grid,
    i: int,
    normal: FloatArray,
    size: float,
    limit: float,
    least: FloatArray,
) -> None:
    """Lower `least`, rising, to the radii of the balls on which points within this one lie."""
    points, starts, keys = grid.points, grid.starts, grid.keys
    shape = grid.shape[0], grid.shape[1], grid.shape[2]
    corner, edge, here = grid.low, grid.size, grid.points[i]
    c0, c1, c2 = here[0] - size * normal[0], here[1] - size * normal[1], here[2] - size * normal[2]
    wide = size * (1.0 + 1e-9)
    x = span_of(corner[0], edge, shape[0], c0 - wide, c0 + wide)
    y = span_of(corner[1], edge, shape[1], c1 - wide, c1 + wide)
    if (x[1] - x[0] + 1) * (y[1] - y[0] + 1) > len(points):
        _limit_by(points, here, normal, (0, len(points)), limit, least)
        return
    for a in range(x[0], x[1] + 1):
        # The ball is cut into slabs; to round off their edges takes longer than to look there.
        low = corner[0] + a * edge
        off = max(low - c0, c0 - low - edge, 0.0)
        half = np.sqrt(max(wide * wide - off * off, 0.0)) + 1e-9 * wide
        y = span_of(corner[1], edge, shape[1], c1 - half, c1 + half)
        z = span_of(corner[2], edge, shape[2], c2 - half, c2 + half)
        if z[0] > z[1]:
            continue
        for b in range(y[0], y[1] + 1):
            rows = row_of(starts, keys, shape, a, b, z[0], z[1])
            _limit_by(points, here, normal, rows, limit, least)


@njit(cache=True, nogil=True, inline="always")
def _limit_by(
    points: FloatArray,
    here: FloatArray,
    normal: FloatArray,
    rows: tuple[int, int],
    limit: float,
    least: FloatArray,
) -> None:
    """Lower `least` by a slice of the points."""
    h0, h1, h2 = here[0], here[1], here[2]
    n0, n1, n2 = normal[0], normal[1], normal[2]
    last = len(least) - 1
    # Twice the bound, and a little more: round-off must not lose a point.
    bound = 2.0 * least[last] * (1.0 + 1e-12)
    for k in range(np.uint64(rows[0]), np.uint64(rows[1])):
        x, y, z = points[k, 0] - h0, points[k, 1] - h1, points[k, 2] - h2
        away = x * x + y * y + z * z
        depth = -(x * n0 + y * n1 + z * n2)
        # Both at once, and without a division: which points pass one of them cannot be foretold.
        if (away < bound * depth) & (4.0 * depth * depth > limit * away):
            radius = away / (2.0 * depth)
            if radius < least[last]:
                at = last
                while at > 0 and least[at - 1] > radius:
                    least[at] = least[at - 1]
                    at -= 1
                least[at] = radius
                bound = 2.0 * least[last] * (1.0 + 1e-12)
