"""A neighbour graph that stands for the shape's surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from mdcs_pipeline.kernels.nearest import nearest

FloatArray = NDArray[np.float64]


class SurfaceGraph(NamedTuple):
    """Points freed of some noise, and the distances between neighbours.

    Parameters
    ----------
    positions : (n, 3) float64
    graph : csr_array, (n, n)
        Symmetric.
    """

    positions: FloatArray
    graph: sparse.csr_array


def averaged(points: FloatArray, neighbours: int) -> FloatArray:
    """Return each point's mean with its `neighbours` nearest: noise across the surface shrinks."""
    found = nearest(points, neighbours)
    sums = points + points[found.indices].sum(axis=1)
    return np.asarray(sums / (1 + found.indices.shape[1]), dtype=np.float64)


def surface_graph(points: FloatArray, neighbours: int, averaging: int) -> SurfaceGraph:
    """Return the symmetric nearest-neighbour graph of averaged points.

    Parameters
    ----------
    points : (n, 3) float64
    neighbours : int
        Each point is linked to this many, and to those that name it.
    averaging : int
        Neighbours that a point is averaged with; 0 for none.

    Returns
    -------
    SurfaceGraph
    """
    n = len(points)
    placed = averaged(points, averaging) if averaging else points.copy()
    found = nearest(placed, neighbours)
    rows = np.repeat(np.arange(n), found.indices.shape[1])
    # Points that averaging put on one place still are neighbours, at a distance above 0.
    length = np.maximum(found.distance.ravel(), 1e-12)
    columns = found.indices.ravel()
    one_way = sparse.csr_array(sparse.coo_array((length, (rows, columns)), shape=(n, n)))
    return SurfaceGraph(placed, sparse.csr_array(one_way.maximum(one_way.T)))


def islands(graph: sparse.csr_array, mass: FloatArray, least: float) -> NDArray[np.bool_]:
    """Return the points whose connected part holds less than `least` of the mass."""
    _, part = connected_components(graph, directed=False)
    held = np.bincount(part, mass)
    return np.asarray(held[part] < least * mass.sum(), dtype=np.bool_)
