"""Which edges of a skeleton belong to one branch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mdcs_pipeline.arrays import IntArray


def branch_labels(edges: IntArray, count: int) -> NDArray[np.int64]:
    """Return the branch of every edge: runs between ends and junctions, and bare rings.

    Parameters
    ----------
    edges : (E, 2) int64
    count : int
        Nodes of the skeleton.

    Returns
    -------
    (E,) int64
        From 0, without gaps, in the order of each branch's first edge.
    """
    if not len(edges):
        return np.empty(0, np.int64)
    ends = np.asarray(edges, np.int64).ravel()
    degree = np.bincount(ends, minlength=count)
    order = np.argsort(ends, kind="stable")
    first = np.cumsum(degree) - degree
    passed = first[degree == 2]
    left, right = order[passed] // 2, order[passed + 1] // 2
    graph = coo_array((np.ones(len(left)), (left, right)), shape=(len(edges),) * 2)
    labels = connected_components(graph, directed=False)[1]
    _, start, inverse = np.unique(labels, return_index=True, return_inverse=True)
    named: NDArray[np.int64] = np.argsort(np.argsort(start))[inverse].astype(np.int64)
    return named
