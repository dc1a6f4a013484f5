"""Symmetry check of the plan, and the false cycles that it shows (section IV.C, Eq. 5-6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.cycles import on_cycles

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def asymmetry(
    plan: sparse.csr_array, points: FloatArray, mass: FloatArray, nodes: FloatArray, floor: float
) -> FloatArray:
    """Return m_i^d of Eq. 6: the largest imbalance of mass over three principal directions.

    Y_i are the points that give node i more than `floor` of their mass.

    Parameters
    ----------
    plan : csr_array, (n, m)
    points : (n, 3) float64
    mass : (n,) float64
    nodes : (m, 3) float64
    floor : float

    Returns
    -------
    (m,) float64
        In [0, 1]; 0 for a node without points.
    """
    rows = np.repeat(np.arange(plan.shape[0]), np.diff(plan.indptr))
    kept = plan.data > floor * mass[rows]
    rows, columns = rows[kept], plan.indices[kept]
    offset = nodes[columns] - points[rows]
    count = len(nodes)
    outer = np.einsum("ka,kb->kab", offset, offset).reshape(-1, 9)
    sums = [np.bincount(columns, outer[:, a], minlength=count) for a in range(9)]
    _, vectors = np.linalg.eigh(np.stack(sums, axis=1).reshape(-1, 3, 3))
    along = np.einsum("ka,kab->kb", offset, vectors[columns])
    total = np.bincount(columns, mass[rows], minlength=count)
    imbalance = np.zeros(count)
    for axis in range(3):
        signed = np.bincount(columns, np.sign(along[:, axis]) * mass[rows], minlength=count)
        imbalance = np.maximum(imbalance, np.abs(signed))
    return np.asarray(imbalance / np.where(total > 0, total, 1.0), dtype=np.float64)


def false_cycle_nodes(count: int, pairs: IntArray, candidates: BoolArray) -> BoolArray:
    """Return the nodes on cycles of the subgraphs that grow from candidates (section IV.C).

    A walk that starts at a candidate ends where it meets a symmetric node, so an edge
    between two symmetric nodes belongs to no such subgraph.

    Parameters
    ----------
    count : int
    pairs : (E, 2) int64
    candidates : (m,) bool
        Asymmetric nodes.

    Returns
    -------
    (m,) bool
    """
    walked = candidates[pairs].any(axis=1) if len(pairs) else np.zeros(0, dtype=bool)
    return on_cycles(count, pairs[walked])
