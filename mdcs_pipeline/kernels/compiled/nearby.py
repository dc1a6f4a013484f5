"""The nearest points of each point of a grid, without a branch that cannot be foretold."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.grid import Grid, row_of, span_of
from mdcs_pipeline.kernels.compiled.selecting import LANES, ranks_of
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

# Cells to each side that are looked through, and points in them, before a point is left to a
# better way: far from all others, or in a crowd.
_WIDEST, _CROWD = 3, 2048
# Classes of squared distances; on a surface they hold equally many points.
_CLASSES = 64
# Points in the nearest classes that are compared all with all; more lie in one place.
_COMPARED = 256


@njit(cache=True, nogil=True)
def usual_distance(points: FloatArray, count: int, samples: int) -> float:
    """Return the median distance of some points to the `count` nearest of all."""
    found, squares = np.empty(samples), np.empty(len(points))
    for s in range(samples):
        i = s * len(points) // samples
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        for k in range(len(points)):
            x, y, z = points[k, 0] - px, points[k, 1] - py, points[k, 2] - pz
            squares[k] = x * x + y * y + z * z
        found[s] = np.sqrt(np.partition(squares, count)[count])
    return float(np.median(found))


@njit(cache=True, nogil=True, inline="always")
def _gathered(grid: Grid, i: int, wide: int, squares: FloatArray, found: IntArray) -> int:
    """Write squared distances of the points in cells up to `wide` away; return how many, or −1."""
    points, starts, keys, low = grid.points, grid.starts, grid.keys, grid.low
    shape, size = (grid.shape[0], grid.shape[1], grid.shape[2]), grid.size
    px, py, pz = points[i, 0], points[i, 1], points[i, 2]
    reach, count = wide * size, 0
    x = span_of(low[0], size, shape[0], px - reach, px + reach)
    y = span_of(low[1], size, shape[1], py - reach, py + reach)
    z = span_of(low[2], size, shape[2], pz - reach, pz + reach)
    for a in range(x[0], x[1] + 1):
        for b in range(y[0], y[1] + 1):
            rows = row_of(starts, keys, shape, a, b, z[0], z[1])
            if count + rows[1] - rows[0] > len(found):
                return -1
            for k in range(rows[0], rows[1]):
                u, v, w = points[k, 0] - px, points[k, 1] - py, points[k, 2] - pz
                squares[count] = u * u + v * v + w * w
                found[count] = k
                count += 1
    return count


@njit(cache=True, nogil=True, inline="always")
def _narrowed(
    squares: FloatArray, found: IntArray, count: int, wanted: int, sure: float, held: IntArray
) -> int:
    """Keep what is in the classes of the `wanted` smallest below `sure`; return how many, or −1."""
    held[:] = 0
    scale = _CLASSES / sure
    for k in range(count):
        held[int(min(squares[k] * scale, float(_CLASSES)))] += 1
    most, total = 0, held[0]
    while total < wanted:
        most += 1
        if most >= _CLASSES:
            return -1
        total += held[most]
    kept = 0
    for k in range(count):
        square = squares[k]
        squares[kept], found[kept] = square, found[k]
        kept += int(min(square * scale, float(_CLASSES))) <= most
    return kept


@njit(cache=True, nogil=True)
def nearest_in_grid(grid: Grid, count: int, which: IntArray) -> tuple[FloatArray, IntArray]:
    """Return the `count` nearest others of points, as far as cells nearby tell.

    Parameters
    ----------
    grid : Grid
        Best with cells about as wide as the distance that is sought.
    count : int
        Fewer than there are points.
    which : (k,) int64
        The points that are asked for, in the grid's order.

    Returns
    -------
    distance : (k, count) float64
        Rising; NaN where nearby cells did not tell.
    names : (k, count) int64
        In the cloud's order.
    """
    order, room = grid.order, min(_CROWD, len(grid.points))
    distance, names = np.full((len(which), count), np.nan), np.zeros((len(which), count), np.int64)
    squares, found = np.empty(room + LANES), np.empty(room, np.int64)
    ranks = np.empty(room + LANES, np.int64)
    held = np.empty(_CLASSES + 1, np.int64)
    for at in range(len(which)):
        i, margin = which[at], np.inf
        for a in range(3):
            inside = (grid.points[i, a] - grid.low[a]) / grid.size
            inside -= np.floor(inside)
            margin = min(margin, inside, 1.0 - inside)
        for wide in range(1, _WIDEST + 1):
            here = _gathered(grid, i, wide, squares, found)
            if here < 0:
                break
            # What lies in no cell so far is farther away; round-off must not lose a point.
            sure = ((margin + wide) * grid.size * (1.0 - 1e-9)) ** 2
            kept = _narrowed(squares, found, here, count + 1, sure, held)
            if kept < 0:
                continue
            if kept > _COMPARED:
                break
            for k in range(kept):
                # The point itself comes first, before others in the same place.
                squares[k] = -1.0 if found[k] == i else squares[k]
            ranks_of(squares, kept, ranks)
            for k in range(kept):
                if 0 < ranks[k] <= count:
                    distance[at, ranks[k] - 1] = np.sqrt(squares[k])
                    names[at, ranks[k] - 1] = order[found[k]]
            break
    return distance, names
