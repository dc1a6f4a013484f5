"""Which nodes' points touch each other on the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Pairs of nodes up to which each is counted in a place of its own, which needs no sorting.
_DENSE = 1 << 16


def contacts(graph: sparse.csr_array, owner: IntArray, count: int) -> sparse.csr_array:
    """Return how many neighbouring points each two nodes own.

    Parameters
    ----------
    graph : csr_array, (n, n)
        Symmetric neighbour graph of the points.
    owner : (n,) int64
        Node of each point.
    count : int
        m.

    Returns
    -------
    csr_array, (m, m)
        Symmetric, diagonal 0.
    """
    rows = owner[np.repeat(np.arange(graph.shape[0]), np.diff(graph.indptr))]
    columns = owner[graph.indices]
    apart = rows != columns
    if count * count <= _DENSE:
        shared = np.bincount(rows[apart] * count + columns[apart], minlength=count * count)
        return sparse.csr_array(shared.reshape(count, count).astype(np.float64))
    ones = np.ones(int(np.count_nonzero(apart)))
    return sparse.csr_array(
        sparse.coo_array((ones, (rows[apart], columns[apart])), shape=(count, count))
    )


def relative_contact(touching: sparse.csr_array, pairs: IntArray) -> FloatArray:
    """Return the contact of each pair relative to the smaller of its nodes' largest contacts.

    Parameters
    ----------
    touching : csr_array, (m, m)
    pairs : (E, 2) int64

    Returns
    -------
    (E,) float64
    """
    if not len(pairs):
        return np.zeros(0)
    if touching.shape[0] ** 2 <= _DENSE:
        counts = touching.toarray()
        largest, shared = counts.max(axis=1), counts[pairs[:, 0], pairs[:, 1]]
    else:
        largest = np.asarray(touching.max(axis=1).toarray()).ravel()
        shared = np.asarray(touching[pairs[:, 0], pairs[:, 1]]).ravel()
    smaller = largest[pairs].min(axis=1)
    return np.asarray(shared / np.where(smaller > 0, smaller, 1.0), dtype=np.float64)


def bodies_touch(
    graph: sparse.csr_array, owner: IntArray, body: BoolArray, pairs: IntArray
) -> BoolArray:
    """Return whether the body of each node of a pair touches the other's points.

    Parameters
    ----------
    graph : csr_array, (n, n)
    owner : (n,) int64
    body : (n,) bool
        Which points are their node's body, from `fallen.bodies`.
    pairs : (E, 2) int64

    Returns
    -------
    (E,) bool
    """
    rows = np.repeat(np.arange(len(owner)), np.diff(graph.indptr))
    base = max(int(owner.max(initial=0)), int(pairs.max(initial=0))) + 1
    mine = body[rows]
    touched = np.unique(owner[rows[mine]] * base + owner[graph.indices[mine]])
    there, back = pairs @ [base, 1], pairs @ [1, base]
    return np.asarray(np.isin(there, touched) & np.isin(back, touched), dtype=np.bool_)
