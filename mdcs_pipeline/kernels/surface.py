"""A neighbour graph that stands for the shape's surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from mdcs_pipeline.kernels.compiled.linking import along_surface, both_ways
from mdcs_pipeline.kernels.compiled.neighbours import neighbour_axes
from mdcs_pipeline.kernels.nearest import nearest

FloatArray = NDArray[np.float64]

#: Points that each is linked to, and how near to upright on the surface a link may be, in degrees
#: between it and the normals, where nobody says.
NEIGHBOURS, UPRIGHT = 8, 41.4


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


def principal_axes(points: FloatArray, indices: NDArray[np.int64]) -> FloatArray:
    """Return the axes of each point's neighbourhood, itself included, the thinnest first.

    Parameters
    ----------
    points : (n, 3) float64
    indices : (n, k) int64
        Neighbours of each point.

    Returns
    -------
    (n, 3, 3) float64
        Unit vectors in the columns; on a surface the first is the normal. Signs mean nothing.
    """
    return neighbour_axes(points, indices)[1]


def normals(points: FloatArray, indices: NDArray[np.int64]) -> FloatArray:
    """Return the direction in which each point's neighbourhood is thinnest, (n, 3), unit.

    Its sign means nothing.
    """
    return principal_axes(points, indices)[:, :, 0]


def surface_graph(
    points: FloatArray, neighbours: int, averaging: int = 0, upright: float = 0.0
) -> SurfaceGraph:
    """Return the symmetric graph of neighbours along the surface.

    Two walls that face each other across a gap may be nearer than points of one wall; but a
    link through the gap stands upright on both. Such links are passed over for the next.

    Parameters
    ----------
    points : (n, 3) float64
    neighbours : int
        Each point is linked to this many, and to those that name it.
    averaging : int
        Neighbours that a point is averaged with; 0 for none.
    upright : float
        Least angle between a link and the normals at both its ends, in degrees; 0 takes all.

    Returns
    -------
    SurfaceGraph
    """
    n = len(points)
    placed = averaged(points, averaging) if averaging else points.copy()
    found = nearest(placed, 2 * neighbours if upright > 0.0 else neighbours)
    # Points that averaging put on one place still are neighbours, at a distance above 0.
    length = np.maximum(found.distance, 1e-12)
    kept = np.ones(length.shape, dtype=bool)
    if upright > 0.0 and n > 2 * neighbours:
        steepest = float(np.cos(np.radians(upright)))
        normal = normals(placed, found.indices[:, : 2 * neighbours])
        kept = along_surface(placed, found.indices, length, normal, neighbours, steepest)
    else:
        kept[:, neighbours:] = False
    indptr, indices, data = both_ways(found.indices, length, kept)
    return SurfaceGraph(placed, sparse.csr_array((data, indices, indptr), shape=(n, n)))


def islands(indices: NDArray[np.int64], mass: FloatArray, least: float) -> NDArray[np.bool_]:
    """Return the points whose connected part holds less than `least` of the mass.

    Parameters
    ----------
    indices : (n, k) int64
        Neighbours of each point.
    mass : (n,) float64
    least : float

    Returns
    -------
    (n,) bool
    """
    n, k = indices.shape
    entries = np.ones(n * k, np.int8), indices.ravel(), np.arange(0, n * k + 1, k)
    graph = sparse.csr_array(entries, shape=(n, n))
    _, part = connected_components(graph, directed=False)
    held = np.bincount(part, mass)
    return np.asarray(held[part] < least * mass.sum(), dtype=np.bool_)
