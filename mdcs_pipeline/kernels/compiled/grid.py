"""Points in the order of the cells of a grid: who is near is read off rows of cells.

Cells of one row follow each other in the order, so a row's points within a box are one slice,
found by halving. No cell is stored, so a few far points cost nothing.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

T = TypeVar("T", bound=np.generic)
# Cells along an axis at most: three such numbers fit into one key.
_MOST = 2**20


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
    """

    points: FloatArray
    order: IntArray
    keys: IntArray
    low: FloatArray
    size: float


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
    low = points.min(axis=0, initial=np.inf)
    extent = float((points.max(axis=0, initial=-np.inf) - low).max(initial=0.0))
    size = max(size, 2.0 * extent / _MOST, np.finfo(float).tiny)
    cells = np.floor((points - low) / size).astype(np.int64)
    keys = (cells[:, 0] * _MOST + cells[:, 1]) * _MOST + cells[:, 2]
    order = np.argsort(keys, kind="stable")
    return Grid(np.ascontiguousarray(points[order]), order, keys[order], low, size)


@njit(cache=True, nogil=True)
def _add_near(
    points: FloatArray,
    place: FloatArray,
    squared: float,
    rows: tuple[int, int],
    found: IntArray,
    count: int,
) -> int:
    """Add those of a slice of the points that are near a place to `count` found before."""
    for at in range(rows[0], rows[1]):
        x = points[at, 0] - place[0]
        y = points[at, 1] - place[1]
        z = points[at, 2] - place[2]
        if x * x + y * y + z * z <= squared:
            found[count] = at
            count += 1
    return count


@njit(cache=True, nogil=True)
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
    points, keys, size = grid.points, grid.keys, grid.size
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for a in range(3):
        low[a] = max(0, int(np.floor((place[a] - reach - grid.low[a]) / size)))
        high[a] = min(_MOST - 1, int(np.floor((place[a] + reach - grid.low[a]) / size)))
    count, squared = 0, reach * reach
    if (high[0] - low[0] + 1) * (high[1] - low[1] + 1) > len(points):
        # More rows than points: most are empty.
        return _add_near(points, place, squared, (0, len(points)), found, 0)
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            row = (i * _MOST + j) * _MOST
            start = np.searchsorted(keys, row + low[2])
            stop = np.searchsorted(keys, row + high[2], side="right")
            count = _add_near(points, place, squared, (start, stop), found, count)
    return count


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


def scattered(grid: Grid, values: NDArray[T]) -> NDArray[T]:
    """Return values in the grid's order in the cloud's."""
    result = np.empty_like(values)
    result[grid.order] = values
    return result
