"""The objective that Algorithm 2 lowers (Eq. 1, 4 and 8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.problem import Solution

FloatArray = NDArray[np.float64]


def distances(plan: sparse.csr_array, points: FloatArray, nodes: FloatArray) -> FloatArray:
    """Return ‖x_i − y_j‖ for every stored entry of the plan, in its order."""
    rows = np.repeat(np.arange(plan.shape[0]), np.diff(plan.indptr))
    return np.asarray(np.linalg.norm(points[rows] - nodes[plan.indices], axis=1), dtype=np.float64)


def transport_energy(solution: Solution) -> float:
    """Return Σ π_ij c_ij − ε H(Π), H = −Σ π ln π (Eq. 4 and 9).

    For a plan of the form exp((f + g − c)/ε), each entry has ε ln π + c = f + g, so that the
    sum is that of the potentials over the plan's own marginals.
    """
    plan = solution.plan
    received = np.bincount(plan.indices, plan.data, minlength=plan.shape[1])
    sent = np.add.reduceat(plan.data, plan.indptr[:-1])
    return float(received @ solution.node_potentials + sent @ solution.point_potentials)


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
