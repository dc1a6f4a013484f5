"""The step of Algorithm 2 over X, for a fixed plan (Eq. 12-14)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

FloatArray = NDArray[np.float64]

# Nodes up to which a full matrix is solved sooner than a sparse one is set up.
_DENSE = 120


class Pull(NamedTuple):
    """The quadratic Σ_ij w_ij ‖x_i − y_j‖² that stands for the transport term.

    Parameters
    ----------
    total : (m,) float64
        Σ_j w_ij.
    weighted : (m, 3) float64
        Σ_j w_ij y_j.
    """

    total: FloatArray
    weighted: FloatArray


def pull(
    plan: sparse.csr_array,
    points: FloatArray,
    nodes: FloatArray,
    power: int,
    scales: tuple[FloatArray, FloatArray],
) -> Pull:
    """Return the weights with which the plan pulls each node to its points.

    For p = 2 they are π_ij / (r_i r_j) and the quadratic is the transport cost. For p = 1 they
    are π_ij / (2 ‖x_i − y_j‖ √(r_i r_j)): the quadratic then touches the sum of distances from
    above at the present nodes (up to a constant), so that its minimiser is a Weiszfeld step.

    Parameters
    ----------
    plan : csr_array, (n, m)
    points : (n, 3) float64
    nodes : (m, 3) float64
    power : int
        p, 1 or 2.
    scales : (n,) and (m,) float64
        r_j and r_i.

    Returns
    -------
    Pull
    """
    if power == 1:
        rows = np.repeat(np.arange(plan.shape[0]), np.diff(plan.indptr))
        distance = np.linalg.norm(points[rows] - nodes[plan.indices], axis=1)
        # A node on top of a point would be held there by an infinite weight.
        largest = float(distance.max(initial=0.0))
        floor = 1e-6 * largest if largest > 0 else 1.0
        data = 0.5 * plan.data / np.maximum(distance, floor)
        plan = sparse.csr_array((data, plan.indices, plan.indptr), shape=plan.shape)
        scales = np.sqrt(scales[0]), np.sqrt(scales[1])
    carried = np.concatenate([np.ones((len(points), 1)), points], axis=1) / scales[0][:, None]
    sums = (plan.T @ carried) / scales[1][:, None]
    return Pull(sums[:, 0], sums[:, 1:])


def bending(edges: NDArray[np.int64], count: int) -> sparse.csr_array:
    """Return L with (L X)_i = x_i − mean of its neighbours (Eq. 8).

    Rows of nodes with fewer than two neighbours are 0: an end must not be drawn inwards.
    """
    i, j = edges[:, 0], edges[:, 1]
    degree = np.bincount(edges.ravel(), minlength=count)
    inner = degree > 1
    rows, columns = np.concatenate([i, j]), np.concatenate([j, i])
    kept = inner[rows]
    values = -1.0 / degree[rows[kept]]
    diagonal = np.flatnonzero(inner)
    return sparse.csr_array(
        sparse.coo_array(
            (
                np.concatenate([values, np.ones(len(diagonal))]),
                (
                    np.concatenate([rows[kept], diagonal]),
                    np.concatenate([columns[kept], diagonal]),
                ),
            ),
            shape=(count, count),
        )
    )


def relaxed_step(
    nodes: FloatArray, pulled: Pull, smoothing: sparse.csr_array | None, weight: float, step: float
) -> FloatArray:
    """Return (1 − θ) X + θ X*, X* the minimiser for a fixed plan (Eq. 13-14).

    X* minimises (1 − λ) Σ w_ij ‖x_i − y_j‖² + λ ‖L X‖². The printed system updates one node
    at a time from its neighbours' old places and may overshoot; solved for all nodes at once
    the objective falls for every θ in (0, 1].

    Parameters
    ----------
    nodes : (m, 3) float64
        X.
    pulled : Pull
    smoothing : csr_array (m, m) or None
        L of `bending`.
    weight : float
        λ.
    step : float
        θ.

    Returns
    -------
    (m, 3) float64
    """
    if smoothing is None or weight == 0.0:
        served = pulled.total > 0
        goal = nodes.copy()
        goal[served] = pulled.weighted[served] / pulled.total[served, None]
    elif len(nodes) <= _DENSE:
        bent = smoothing.toarray()
        full = weight * (bent.T @ bent)
        diagonal = full.diagonal() + (1.0 - weight) * pulled.total
        np.fill_diagonal(full, np.where(diagonal == 0, 1.0, diagonal))
        right = np.where((diagonal == 0)[:, None], nodes, (1.0 - weight) * pulled.weighted)
        goal = np.linalg.solve(full, right)
    else:
        left = sparse.diags_array((1.0 - weight) * pulled.total)
        system = sparse.csc_array(left + weight * (smoothing.T @ smoothing))
        # The row of a node without mass and without inner neighbours is empty: it stays.
        lost = system.diagonal() == 0
        right = np.where(lost[:, None], nodes, (1.0 - weight) * pulled.weighted)
        goal = splu(sparse.csc_array(system + sparse.diags_array(lost.astype(float)))).solve(right)
    return np.asarray((1.0 - step) * nodes + step * goal, dtype=np.float64)
