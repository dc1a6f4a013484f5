"""Cells of the nodes: which node a point gives most of its mass to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.distance import cdist

from mdcs_pipeline.kernels.compiled.shares import top_shares

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_BLOCK = 1 << 22


def plan_owners(plan: sparse.csr_array) -> IntArray:
    """Return the node that each point of a plan (n, m) gives most of its mass to, (n,) int64."""
    return top_shares(plan.indptr, plan.indices, plan.data, 1)[0][:, 0]


def owners(
    points: FloatArray,
    nodes: FloatArray,
    potentials: FloatArray,
    point_scale: FloatArray,
    node_scale: FloatArray,
) -> IntArray:
    """Return the node with the largest f_i − ‖x_i − y_j‖²/(r_i r_j), the power cell of Eq. 3.

    Parameters
    ----------
    points : (n, 3) float64
    nodes : (m, 3) float64
    potentials : (m,) float64
    point_scale, node_scale : (n,), (m,) float64
        r_j and r_i.

    Returns
    -------
    (n,) int64
    """
    result = np.empty(len(points), np.int64)
    block = max(1, _BLOCK // len(nodes))
    for start in range(0, len(points), block):
        part = slice(start, start + block)
        weight = node_scale * point_scale[part, None]
        cost = cdist(points[part], nodes, "sqeuclidean") / weight
        result[part] = np.argmax(potentials - cost, axis=1)
    return result
