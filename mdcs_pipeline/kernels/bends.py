"""What the Dirichlet term counts: the bends of a graph (Eq. 8), and in which unit.

Eq. 8 takes a node's distance from the mean of its neighbours. That is κ h²/2 for a curve of
curvature κ with nodes h apart: the closer they are, the less it holds. In the radii of the shape
it suits nodes at one spacing.

What a curve may bend follows from what is known of it. A node's mass scatters sideways by w about
the axis, because of noise, or because the limb is wide and flat: there the middle is known to w,
and what it does within a stretch of w is a guess. So the other measure is κ w², by how much the
curve leaves its tangents over such a stretch: the same for any spacing, and next to nothing where
all mass lies on one line, which the curve then follows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.update import bending

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Nodes with less mass than this share of the median's count as that much.
_LEAST_MASS = 0.1
# Shortest spacing that is reckoned with, in the median edge.
_SHORTEST = 0.1


def steps_in_radii(edges: IntArray, scale: FloatArray) -> sparse.csr_array:
    """Return B with ‖B X‖² = Σ ‖x_i − mean of its neighbours‖² / r_i² (Eq. 8).

    Costs are in local radii: so must bends be, or thick parts would hardly be smoothed.

    Parameters
    ----------
    edges : (E, 2) int64
    scale : (m,) float64
        r_i; 1 without a thickness, where it is Eq. 8 as printed.

    Returns
    -------
    csr_array (m, m)
    """
    return sparse.csr_array(sparse.diags_array(1.0 / scale) @ bending(edges, len(scale)))


def bends_in_scatter(
    nodes: FloatArray, edges: IntArray, scale: FloatArray, mass: FloatArray, scatter: FloatArray
) -> sparse.csr_array:
    """Return B with ‖B X‖² = Σ ρ_i (κ_i w_i² / r_i)², κ_i h_i² = 2 ‖x_i − mean of neighbours‖.

    Parameters
    ----------
    nodes : (m, 3) float64
        They tell h_i, the mean length of a node's edges.
    edges : (E, 2) int64
    scale : (m,) float64
        r_i; 1 without a thickness.
    mass : (m,) float64
        ρ_i.
    scatter : (m,) float64
        w_i², from `sideways_scatter`.

    Returns
    -------
    csr_array (m, m)
    """
    count = len(nodes)
    length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    degree = np.maximum(np.bincount(edges.ravel(), minlength=count), 1)
    spacing = np.bincount(edges.ravel(), np.repeat(length, 2), minlength=count) / degree
    # Edges that are much shorter than others say nothing of bends.
    shortest = _SHORTEST * float(np.median(length)) if len(length) else 1.0
    held = np.maximum(mass, _LEAST_MASS * np.median(mass))
    weight = 2.0 * np.sqrt(held) * scatter / (np.maximum(spacing, shortest) ** 2 * scale)
    return sparse.csr_array(sparse.diags_array(weight) @ bending(edges, count))


def sideways_scatter(
    plan: sparse.csr_array, places: FloatArray, nodes: FloatArray, edges: IntArray
) -> FloatArray:
    """Return w_i²: the variance, across the curve, of the mass that each node receives.

    The curve's directions at a node are those of its edges, each counted alike.

    Parameters
    ----------
    plan : csr_array, (n, m)
    places : (n, 3) float64
        Where each point's mass is carried from.
    nodes : (m, 3) float64
    edges : (E, 2) int64

    Returns
    -------
    (m,) float64
        0 for nodes without mass.
    """
    count = len(nodes)
    way = nodes[edges[:, 1]] - nodes[edges[:, 0]]
    way /= np.maximum(np.linalg.norm(way, axis=1), np.finfo(float).tiny)[:, None]
    squares = np.repeat(_outer(way), 2, axis=0)
    degree = np.maximum(np.bincount(edges.ravel(), minlength=count), 1)
    along = np.stack(
        [np.bincount(edges.ravel(), column, minlength=count) / degree for column in squares.T],
        axis=1,
    )
    # About the middle of them all: moments far from the origin would lose their digits.
    offset = places - places.mean(axis=0)
    ones = np.ones((len(places), 1))
    sums = plan.T @ np.concatenate([ones, offset, _outer(offset)], axis=1)
    moments = sums[:, 1:] / np.where(sums[:, :1] > 0, sums[:, :1], 1.0)
    second = moments[:, 3:] - _outer(moments[:, :3])
    across = second[:, [0, 4, 8]].sum(axis=1) - (second * along).sum(axis=1)
    return np.asarray(np.maximum(across, 0.0), dtype=np.float64)


def _outer(vectors: FloatArray) -> FloatArray:
    """Return v vᵀ of each row, (k, 9)."""
    return np.asarray((vectors[:, :, None] * vectors[:, None, :]).reshape(-1, 9), dtype=np.float64)


def without(smoothing: sparse.csr_array, nodes: BoolArray) -> sparse.csr_array:
    """Return the bends without those at some nodes."""
    if not nodes.any():
        return smoothing
    return sparse.csr_array(sparse.diags_array((~nodes).astype(np.float64)) @ smoothing)
