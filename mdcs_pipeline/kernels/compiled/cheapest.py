"""The node of least cost for each point, without a matrix of all costs."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def cheapest_site(
    points: FloatArray, point_scale: FloatArray, nodes: FloatArray, node_scale: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return each point's node of least cost ‖x_i − y_j‖²/(r_i r_j), the first of equal ones.

    Parameters
    ----------
    points, nodes : (n, 3), (m, 3) float64
        m > 0.
    point_scale, node_scale : (n,), (m,) float64

    Returns
    -------
    nearest : (n,) int64
    cost : (n,) float64
    """
    nearest, cost = np.empty(len(points), np.int64), np.empty(len(points))
    for j in range(len(points)):
        x, y, z, scale = points[j, 0], points[j, 1], points[j, 2], point_scale[j]
        best, least = 0, np.inf
        for i in range(len(nodes)):
            u, v, w = x - nodes[i, 0], y - nodes[i, 1], z - nodes[i, 2]
            one = (u * u + v * v + w * w) / (scale * node_scale[i])
            if one < least:
                best, least = i, one
        nearest[j], cost[j] = best, least
    return nearest, cost
