"""A neighbour graph with fewer points: for ways that are long against its links."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from mdcs_pipeline.kernels.compiled.grid import standing_for

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Points whose ways to all others tell how much longer ways are in the coarser graph.
_GAUGES = 3


class Coarse(NamedTuple):
    """Points that stand for others, and how far neighbours are from each other.

    Parameters
    ----------
    points : (m, 3) float64
        Centres of mass of what they stand for.
    mass : (m,) float64
    graph : csr_array, (m, m)
    into : (n,) int64
        Which of them stands for each point.
    """

    points: FloatArray
    mass: FloatArray
    graph: sparse.csr_array
    into: IntArray


def coarsened(points: FloatArray, mass: FloatArray, graph: sparse.csr_array, size: float) -> Coarse:
    """Return the graph with points within `size` of each other made one, where links join them.

    Two are neighbours where a link leads from one to the other. Ways are as long as before, on
    the whole: the longer links are, the less a way can bend towards its goal.

    Parameters
    ----------
    points : (n, 3) float64
    mass : (n,) float64
    graph : csr_array, (n, n)
        Distances between neighbours, symmetric.
    size : float

    Returns
    -------
    Coarse
    """
    into = _hanging_together(graph, standing_for(points, np.full(len(points), size))[1])
    held = np.bincount(into, mass).astype(np.float64)
    sums = [np.bincount(into, mass * x) for x in points.T]
    middle: FloatArray = np.stack(sums, axis=1) / held[:, None]
    links = sparse.coo_array(graph)
    i, j = into[links.row], into[links.col]
    apart = i != j
    entries = np.ones(int(apart.sum())), (i[apart], j[apart])
    joined = sparse.csr_array(sparse.coo_array(entries, shape=(len(held),) * 2))
    rows = np.repeat(np.arange(len(held)), np.diff(joined.indptr))
    length = np.linalg.norm(middle[rows] - middle[joined.indices], axis=1)
    joined.data = np.maximum(length, 1e-12)
    joined.data *= _stretch(graph, joined, into)
    return Coarse(middle, held, joined, into)


def _hanging_together(graph: sparse.csr_array, into: IntArray) -> IntArray:
    """Return the groups, each split into what hangs together in the graph."""
    rows = np.repeat(np.arange(len(into)), np.diff(graph.indptr))
    inside = into[rows] == into[graph.indices]
    entries = np.ones(int(inside.sum()), np.int8), (rows[inside], graph.indices[inside])
    within = sparse.coo_array(entries, shape=graph.shape)
    _, piece = sparse.csgraph.connected_components(within, directed=False)
    return np.asarray(piece, dtype=np.int64)


def _stretch(fine: sparse.csr_array, coarse: sparse.csr_array, into: IntArray) -> float:
    """Return how much longer ways are in the finer graph, in the median."""
    gauges = np.linspace(0, len(into) - 1, _GAUGES).astype(np.int64)
    long = dijkstra(fine, indices=gauges)
    short = dijkstra(coarse, indices=into[gauges])[:, into]
    told = np.isfinite(long) & np.isfinite(short) & (short > 0)
    far = long > np.median(long[told]) if told.any() else told
    return float(np.median(long[told & far] / short[told & far])) if (told & far).any() else 1.0
