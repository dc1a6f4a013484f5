"""What hangs together: points near each other, or neighbours of one owner."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.grid import Grid, within
from mdcs_pipeline.kernels.compiled.types import IntArray


@njit(cache=True, nogil=True)
def pieces_near(grid: Grid, reach: float) -> IntArray:
    """Return the piece of each point, where points within `reach` hang together.

    Parameters
    ----------
    grid : Grid
    reach : float

    Returns
    -------
    (n,) int64
        In the grid's order, numbered from 0.
    """
    n = len(grid.points)
    piece, found, waiting = np.full(n, -1), np.empty(n, np.int64), np.empty(n, np.int64)
    count = 0
    for start in range(n):
        if piece[start] >= 0:
            continue
        piece[start], waiting[0], left = count, start, 1
        while left > 0:
            left -= 1
            here = grid.points[waiting[left]]
            for k in found[: within(grid, here, reach, found)]:
                if piece[k] < 0:
                    piece[k] = count
                    waiting[left] = k
                    left += 1
        count += 1
    return piece


@njit(cache=True, nogil=True)
def pieces_alike(indptr: IntArray, indices: IntArray, owner: IntArray) -> IntArray:
    """Return the piece of each point, where neighbours of one owner hang together.

    Parameters
    ----------
    indptr, indices
        Symmetric graph of the points, CSR.
    owner : (n,) int64

    Returns
    -------
    (n,) int64
        Numbered from 0 in the order of their first points.
    """
    n = len(owner)
    piece, waiting = np.full(n, -1), np.empty(n, np.int64)
    count = 0
    for start in range(n):
        if piece[start] >= 0:
            continue
        piece[start], waiting[0], left = count, start, 1
        while left > 0:
            left -= 1
            i = waiting[left]
            for e in range(indptr[i], indptr[i + 1]):
                k = indices[e]
                if piece[k] < 0 and owner[k] == owner[i]:
                    piece[k] = count
                    waiting[left] = k
                    left += 1
        count += 1
    return piece
