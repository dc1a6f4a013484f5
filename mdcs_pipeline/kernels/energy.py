"""The objective that Algorithm 2 lowers (Eq. 1, 4 and 8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.sinkhorn import Problem

FloatArray = NDArray[np.float64]


def distances(plan: sparse.csr_array, points: FloatArray, nodes: FloatArray) -> FloatArray:
    """Return ‖x_i − y_j‖ for every stored entry of the plan, in its order."""
    rows = np.repeat(np.arange(plan.shape[0]), np.diff(plan.indptr))
    return np.asarray(np.linalg.norm(points[rows] - nodes[plan.indices], axis=1), dtype=np.float64)


def transport_energy(plan: sparse.csr_array, problem: Problem) -> float:
    """Return Σ π_ij c_ij − ε H(Π), H = −Σ π ln π (Eq. 4 and 9), for the problem's nodes."""
    rows = np.repeat(np.arange(plan.shape[0]), np.diff(plan.indptr))
    scale = problem.point_scale[rows] * problem.node_scale[plan.indices]
    cost = float(plan.data @ (distances(plan, problem.points, problem.nodes) ** 2 / scale))
    data = plan.data[plan.data > 0]
    return cost + problem.epsilon * float(data @ np.log(data))


def bending_energy(smoothing: sparse.csr_array, nodes: FloatArray) -> float:
    """Return R(X) = Σ ‖x_i − mean of its neighbours‖² over inner nodes (Eq. 8, without its λ)."""
    return float(np.square(smoothing @ nodes).sum())


def mean_distance(plan: sparse.csr_array, points: FloatArray, nodes: FloatArray) -> FloatArray:
    """Return Σ_j π_ij ‖x_i − y_j‖ / Σ_j π_ij: the radius around each node, (m,)."""
    total = np.bincount(plan.indices, plan.data, minlength=len(nodes))
    cost = np.bincount(
        plan.indices, plan.data * distances(plan, points, nodes), minlength=len(nodes)
    )
    return np.asarray(cost / np.maximum(total, np.finfo(float).tiny), dtype=np.float64)
