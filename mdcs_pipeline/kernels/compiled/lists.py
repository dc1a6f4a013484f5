"""Which nodes can receive mass from which points: the truncated kernel's pattern."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def best_and_slack(
    points: FloatArray,
    nodes: FloatArray,
    potentials: FloatArray,
    point_weight: FloatArray,
    node_weight: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return, for every point, min_i(c_ij − f_i), and for every node how far it is from serving.

    c_ij = d_ij² · node_weight_i · point_weight_j.
    The slack of node i is min_j(c_ij − f_i − best_j): 0 where the node is some point's best.
    """
    n, m = len(points), len(nodes)
    best = np.full(n, np.inf)
    slack = np.full(m, np.inf)
    row = np.empty(m)
    for j in range(n):
        y0, y1, y2 = points[j, 0], points[j, 1], points[j, 2]
        low = np.inf
        for i in range(m):
            a, b, c = nodes[i, 0] - y0, nodes[i, 1] - y1, nodes[i, 2] - y2
            square = a * a + b * b + c * c
            value = square * node_weight[i] * point_weight[j] - potentials[i]
            row[i] = value
            low = min(low, value)
        best[j] = low
        for i in range(m):
            slack[i] = min(slack[i], row[i] - low)
    return best, slack


@njit(cache=True, nogil=True)
def lists_within(
    points: FloatArray,
    nodes: FloatArray,
    potentials: FloatArray,
    point_weight: FloatArray,
    node_weight: FloatArray,
    best: FloatArray,
    reach: float,
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return CSR lists (indptr, node, cost) of the nodes with c_ij − f_i ≤ best_j + reach."""
    n, m = len(points), len(nodes)
    indptr = np.zeros(n + 1, np.int64)
    size = 64 * n + 16
    indices = np.empty(size, np.int32)
    costs = np.empty(size, np.float64)
    count = 0
    for j in range(n):
        y0, y1, y2 = points[j, 0], points[j, 1], points[j, 2]
        limit = best[j] + reach
        if count + m > size:
            size = 2 * size + m
            grown = np.empty(size, np.int32)
            grown[:count] = indices[:count]
            indices = grown
            wider = np.empty(size, np.float64)
            wider[:count] = costs[:count]
            costs = wider
        for i in range(m):
            a, b, c = nodes[i, 0] - y0, nodes[i, 1] - y1, nodes[i, 2] - y2
            cost = (a * a + b * b + c * c) * node_weight[i] * point_weight[j]
            if cost - potentials[i] <= limit:
                indices[count] = i
                costs[count] = cost
                count += 1
        indptr[j + 1] = count
    return indptr, indices[:count].copy(), costs[:count].copy()
