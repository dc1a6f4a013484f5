"""Which points are cut off from the rest of what their node holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.compiled.pieces import pieces_alike

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def fallen_apart(graph: sparse.csr_array, owner: IntArray, least: float) -> BoolArray:
    """Return the points of a node's lesser pieces, where its points fall into several.

    Parameters
    ----------
    graph : csr_array, (n, n)
        Neighbours on the surface.
    owner : (n,) int64
        Node of each point; −1 for none.
    least : float
        Share of a node's points from which a piece counts.

    Returns
    -------
    (n,) bool
        Of each node's pieces the largest is left out.
    """
    piece, size, owner_of = _pieces(graph, owner)
    known = owner >= 0
    whole = np.bincount(owner[known], minlength=int(owner.max(initial=0)) + 1)
    share = np.where(owner_of >= 0, size / np.maximum(whole[np.maximum(owner_of, 0)], 1), 0.0)
    # By owner, then by falling size: the first piece of each owner is its largest.
    order = np.lexsort((np.arange(len(size)), -size, owner_of))
    first = np.ones(len(size), dtype=bool)
    first[order[1:]] = owner_of[order[1:]] != owner_of[order[:-1]]
    lesser = ~first & (share >= least) & (owner_of >= 0)
    return np.asarray(lesser[piece], dtype=np.bool_)


def bodies(graph: sparse.csr_array, owner: IntArray, least: float) -> BoolArray:
    """Return which points belong to the body of their node, not to its strays.

    The plan carries mass through the air: the tip of a limb may give most of its mass to a node
    of the next. Such points hang together on the surface, but not with the node's others.

    Parameters
    ----------
    graph : csr_array, (n, n)
        Symmetric neighbour graph of the points.
    owner : (n,) int64
        Node of each point.
    least : float
        Points of a connected part, relative to the node's largest, from which it is no stray:
        of half-seen limbs the two walls may be apart.

    Returns
    -------
    (n,) bool
    """
    piece, size, owner_of = _pieces(graph, owner)
    largest = np.zeros(int(owner.max(initial=0)) + 1, np.int64)
    np.maximum.at(largest, owner_of, size)
    return np.asarray((size >= least * largest[owner_of])[piece], dtype=np.bool_)


def _pieces(graph: sparse.csr_array, owner: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return the piece of each point, and the points and the owner of each piece."""
    piece = pieces_alike(graph.indptr, graph.indices, owner)
    size = np.bincount(piece)
    owner_of = np.full(len(size), -1, np.int64)
    owner_of[piece] = owner
    return piece, size, owner_of
