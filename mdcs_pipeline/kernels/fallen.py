"""Which points have lost their node: those cut off from the rest of what it holds."""

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
    piece = pieces_alike(graph.indptr, graph.indices, owner)
    size = np.bincount(piece)
    owner_of = np.full(len(size), -1, np.int64)
    owner_of[piece] = owner
    known = owner >= 0
    whole = np.bincount(owner[known], minlength=int(owner.max(initial=0)) + 1)
    share = np.where(owner_of >= 0, size / np.maximum(whole[np.maximum(owner_of, 0)], 1), 0.0)
    # By owner, then by falling size: the first piece of each owner is its largest.
    order = np.lexsort((np.arange(len(size)), -size, owner_of))
    first = np.ones(len(size), dtype=bool)
    first[order[1:]] = owner_of[order[1:]] != owner_of[order[:-1]]
    lesser = ~first & (share >= least) & (owner_of >= 0)
    return np.asarray(lesser[piece], dtype=np.bool_)
