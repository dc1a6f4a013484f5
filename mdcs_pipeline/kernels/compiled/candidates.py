"""Which nodes can receive mass from a box of points."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True, fastmath=True)
def gaps(
    low: FloatArray, high: FloatArray, span: FloatArray, sites: FloatArray, least: FloatArray
) -> None:
    """Write into `least` the least c_ij − f_i between a box of points and each row of `sites`.

    A site's columns are lower corner, upper corner, weight 1/r and potential f: for a single
    node the corners are its place, for a cell of nodes the bounds of them all.
    """
    for i in range(len(least)):
        square = 0.0
        for a in range(3):
            apart = max(max(sites[a, i] - high[a], low[a] - sites[3 + a, i]), 0.0)
            square += apart * apart
        least[i] = square * sites[6, i] * span[0] - sites[7, i]


@njit(cache=True, nogil=True, fastmath=True)
def _most(low: FloatArray, high: FloatArray, span: FloatArray, sites: FloatArray, i: int) -> float:
    """Return the largest c_ij − f_i between a box of points and node i."""
    square = 0.0
    for a in range(3):
        apart = max(high[a] - sites[a, i], sites[a, i] - low[a])
        square += apart * apart
    most: float = square * sites[6, i] * span[1] - sites[7, i]
    return most


@njit(cache=True, nogil=True)
def box_lists(
    low: FloatArray,
    high: FloatArray,
    span: FloatArray,
    sites: FloatArray,
    cells: FloatArray,
    size: int,
    reach: float,
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return for each box the nodes with c_ij − f_i ≤ min_k(c_kj − f_k) + reach for some point.

    And some more: a box is judged by its bounds.

    Parameters
    ----------
    low, high, span : (B, 3), (B, 3), (B, 2) float64
        Of the boxes, from `box_bounds`, with weights 1/r_j.
    sites : (8, m) float64
        Nodes, in the order of their cells.
    cells : (8, C) float64
        Bounds of each run of `size` nodes: largest f, least 1/r.
    size : int
    reach : float

    Returns
    -------
    indptr, indices
        Rising indices into `sites`.
    levels : (B,) float64
        No f_i − c_ij of the box is higher.
    """
    m = sites.shape[1]
    indptr = np.zeros(len(low) + 1, np.int64)
    indices = np.empty(64 * len(low) + m, np.int32)
    of_cells, of_nodes = np.empty(cells.shape[1]), np.empty(m)
    levels = np.empty(len(low))
    count = 0
    for b in range(len(low)):
        gaps(low[b], high[b], span[b], cells, of_cells)
        # The best that every point of the box is sure to have, from the likeliest cell on.
        nearest = np.argmin(of_cells)
        levels[b] = -of_cells[nearest]
        best = np.inf
        for i in range(nearest * size, min(m, (nearest + 1) * size)):
            best = min(best, _most(low[b], high[b], span[b], sites, i))
        for c in range(len(of_cells)):
            if of_cells[c] < best:
                for i in range(c * size, min(m, (c + 1) * size)):
                    best = min(best, _most(low[b], high[b], span[b], sites, i))
        if count + m > len(indices):
            grown = np.empty(2 * len(indices) + m, np.int32)
            grown[:count] = indices[:count]
            indices = grown
        for c in range(len(of_cells)):
            if of_cells[c] <= best + reach:
                first, last = c * size, min(m, (c + 1) * size)
                gaps(low[b], high[b], span[b], sites[:, first:last], of_nodes[first:last])
                for i in range(first, last):
                    indices[count] = i
                    count += of_nodes[i] <= best + reach
        indptr[b + 1] = count
    return indptr, indices[:count].copy(), levels


@njit(cache=True, nogil=True)
def least_gap(
    node: int,
    sites: FloatArray,
    points: FloatArray,
    weight: FloatArray,
    best: FloatArray,
    bounds: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    size: int,
) -> float:
    """Return min_j(c_ij − f_i − best_j): how far a node is from serving any point.

    `bounds` are low, high and span of the boxes and the largest `best` in each.
    """
    low, high, span, top = bounds
    found = np.inf
    one = np.empty(1)
    for b in range(len(low)):
        gaps(low[b], high[b], span[b], sites[:, node : node + 1], one)
        if one[0] - top[b] >= found:
            continue
        for j in range(b * size, min(len(points), (b + 1) * size)):
            square = 0.0
            for a in range(3):
                square += (points[j, a] - sites[a, node]) ** 2
            found = min(found, square * sites[6, node] * weight[j] - sites[7, node] - best[j])
    return found
