"""Points in the order of the cells of a grid: who is near is read off rows of cells.

Cells of one row follow each other in the order, so a row's points within a box are one slice,
found by halving. No cell is stored, so a few far points cost nothing.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.types import BoolArray, FloatArray, IntArray

T = TypeVar("T", bound=np.generic)
# Cells along an axis at most: three such numbers fit into one key.
_MOST = 2**20
# Cells a point up to which all are counted.
_ROOMY = 16


class Grid(NamedTuple):
    """Points of a cloud by cells.

    Parameters
    ----------
    points : (n, 3) float64
        In the order of their cells.
    order : (n,) int64
        Index of each in the cloud.
    keys : (n,) int64
        Cell of each, rising.
    low : (3,) float64
        Corner of the first cell.
    size : float
        Edge of a cell.
    shape : (3,) int64
        Cells along each axis.
    starts : (C + 1,) int64
        Where each of all cells begins; empty where there would be too many.
    """

    points: FloatArray
    order: IntArray
    keys: IntArray
    low: FloatArray
    size: float
    shape: IntArray
    starts: IntArray


def grid_of(points: FloatArray, size: float) -> Grid:
    """Return the points by cells of about `size`, larger where the cloud is too wide for it.

    Parameters
    ----------
    points : (n, 3) float64
    size : float

    Returns
    -------
    Grid
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    low, high = _bounds(points)
    extent = float((high - low).max()) if len(points) else 0.0
    size = max(size, 2.0 * extent / _MOST, np.finfo(float).tiny)
    shape = np.ones(3, np.int64)
    if len(points):
        shape += np.floor((high - low) / size).astype(np.int64)
    # A scene of far objects has cells beyond number, nearly all of them empty.
    dense = np.prod(shape.astype(float)) <= _ROOMY * len(points) + 4096
    if dense:
        placed, order, keys, starts = _counted(points, low, size, shape)
        return Grid(placed, order, keys, low, size, shape, starts)
    cells = np.floor((points - low) / size).astype(np.int64)
    keys = (cells[:, 0] * _MOST + cells[:, 1]) * _MOST + cells[:, 2]
    order = np.argsort(keys, kind="stable")
    return Grid(points[order], order, keys[order], low, size, shape, np.empty(0, np.int64))


@njit(cache=True, nogil=True)
def _bounds(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest coordinates, infinite of no points."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(points)):
        for a in range(3):
            low[a] = min(low[a], points[i, a])
            high[a] = max(high[a], points[i, a])
    return low, high


@njit(cache=True, nogil=True)
def _counted(
    points: FloatArray, low: FloatArray, size: float, shape: IntArray
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """Return points, order, keys and starts of a `Grid`, sorted by counting."""
    n, count = len(points), shape[0] * shape[1] * shape[2]
    cells, along = np.empty(n, np.int64), np.empty(n, np.int64)
    starts, placed = np.zeros(count + 2, np.int64), np.empty((n, 3))
    order, keys = np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        cell, key = 0, 0
        for a in range(3):
            step = int(np.floor((points[i, a] - low[a]) / size))
            cell, key = cell * shape[a] + step, key * _MOST + step
        cells[i], along[i] = cell, key
        starts[cell + 2] += 1
    for c in range(1, count + 2):
        starts[c] += starts[c - 1]
    # Where a cell begins moves on to where it ends, which is where the next begins.
    for i in range(n):
        at = starts[cells[i] + 1]
        starts[cells[i] + 1] += 1
        order[at], keys[at] = i, along[i]
        placed[at] = points[i]
    return placed, order, keys, starts[: count + 1].copy()


# What loops over rows calls is given arrays and numbers: a whole Grid for every row, its arrays
# counted in and out, takes longer than the row's points; and what is written might be its shape.


@njit(cache=True, nogil=True, inline="always")
def span_of(low: float, size: float, cells: int, first: float, last: float) -> tuple[int, int]:
    """Return the first and the last of an axis' cells between two coordinates."""
    start = int(np.floor((first - low) / size))
    stop = int(np.floor((last - low) / size))
    return max(0, start), min(cells - 1, stop)


@njit(cache=True, nogil=True, inline="always")
def row_of(
    starts: IntArray,
    keys: IntArray,
    shape: tuple[int, int, int],
    i: int,
    j: int,
    first: int,
    last: int,
) -> tuple[int, int]:
    """Return where the points of the cells (i, j, first … last) begin and end."""
    if len(starts) > 0:
        row = (i * shape[1] + j) * shape[2]
        return int(starts[row + first]), int(starts[row + last + 1])
    key = (i * _MOST + j) * _MOST
    start = np.searchsorted(keys, key + first)
    return int(start), int(np.searchsorted(keys, key + last, side="right"))


@njit(cache=True, nogil=True, inline="always")
def _add_near(
    points: FloatArray,
    place: tuple[float, float, float],
    squared: float,
    rows: tuple[int, int],
    found: IntArray,
    count: int,
) -> int:
    """Add those of a slice of the points that are near a place to `count` found before."""
    px, py, pz = place
    # Of numbers without a sign none is looked at for counting from the end.
    for at in range(np.uint64(rows[0]), np.uint64(rows[1])):
        x, y, z = points[at, 0] - px, points[at, 1] - py, points[at, 2] - pz
        # Written in any case: what is near cannot be foretold, and a wrong guess costs more.
        found[count] = at
        count += x * x + y * y + z * z <= squared
    return count


@njit(cache=True, nogil=True, inline="always")
def within(grid: Grid, place: FloatArray, reach: float, found: IntArray) -> int:
    """Fill `found` with the points, in the grid's order, within `reach` of a place.

    Parameters
    ----------
    grid : Grid
    place : (3,) float64
    reach : float
    found : (n,) int64
        Room for all points.

    Returns
    -------
    int
        How many there are.
    """
    points, starts, keys = grid.points, grid.starts, grid.keys
    shape = grid.shape[0], grid.shape[1], grid.shape[2]
    low, size, squared = grid.low, grid.size, reach * reach
    here = place[0], place[1], place[2]
    x = span_of(low[0], size, shape[0], here[0] - reach, here[0] + reach)
    y = span_of(low[1], size, shape[1], here[1] - reach, here[1] + reach)
    z = span_of(low[2], size, shape[2], here[2] - reach, here[2] + reach)
    if (x[1] - x[0] + 1) * (y[1] - y[0] + 1) > len(points):
        # More rows than points: most are empty.
        return _add_near(points, here, squared, (0, len(points)), found, 0)
    count = 0
    if z[0] > z[1]:
        return 0
    for i in range(x[0], x[1] + 1):
        for j in range(y[0], y[1] + 1):
            rows = row_of(starts, keys, shape, i, j, z[0], z[1])
            count = _add_near(points, here, squared, rows, found, count)
    return count


@njit(cache=True, nogil=True)
def share_near(grid: Grid, some: BoolArray, places: FloatArray, reach: FloatArray) -> FloatArray:
    """Return which share of the points within reach of places is of `some`.

    Parameters
    ----------
    grid : Grid
    some : (n,) bool
        In the grid's order.
    places : (k, 3) float64
    reach : (k,) float64

    Returns
    -------
    (k,) float64
        0 where there is no point.
    """
    result, found = np.zeros(len(places)), np.empty(len(grid.points), np.int64)
    for at in range(len(places)):
        near, count = within(grid, places[at], reach[at], found), 0
        for k in found[:near]:
            count += some[k]
        result[at] = count / max(near, 1)
    return result


@njit(cache=True, nogil=True)
def covering(grid: Grid, reach: FloatArray) -> tuple[IntArray, IntArray]:
    """Return points, in the grid's order, that all others are near to.

    Parameters
    ----------
    grid : Grid
    reach : (n,) float64
        How far a point that is chosen stands for others.

    Returns
    -------
    chosen : (m,) int64
    stands : (n,) int64
        Which of the chosen stands for each point; for a chosen one, itself.
    """
    n = len(grid.points)
    chosen, stands, found = np.empty(n, np.int64), np.full(n, -1), np.empty(n, np.int64)
    count = 0
    for i in range(n):
        if stands[i] >= 0:
            continue
        for k in found[: within(grid, grid.points[i], reach[i], found)]:
            if stands[k] < 0:
                stands[k] = count
        stands[i] = count
        chosen[count] = i
        count += 1
    return chosen[:count].copy(), stands


def standing_for(points: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
    """Return points that all others are near to, in the cloud's order.

    Parameters
    ----------
    points : (n, 3) float64
    reach : (n,) float64
        How far a point that is chosen stands for others.

    Returns
    -------
    chosen : (m,) int64
    stands : (n,) int64
        Which of the chosen stands for each point; for a chosen one, itself.
    """
    grid = grid_of(points, float(np.median(reach)))
    chosen, stands = covering(grid, reach[grid.order])
    return grid.order[chosen], scattered(grid, stands)


def scattered(grid: Grid, values: NDArray[T]) -> NDArray[T]:
    """Return values in the grid's order in the cloud's."""
    result = np.empty_like(values)
    result[grid.order] = values
    return result
