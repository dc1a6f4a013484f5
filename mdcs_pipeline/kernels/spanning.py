"""Joining pieces along the strongest remaining links."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.links import Links

IntArray = NDArray[np.int64]


def piece_labels(count: int, pairs: IntArray) -> IntArray:
    """Return the number of the piece that each of `count` nodes belongs to."""
    parent = list(range(count))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for i, j in pairs.tolist():
        parent[root(i)] = root(j)
    roots = np.array([root(i) for i in range(count)], dtype=np.int64)
    return np.unique(roots, return_inverse=True)[1].astype(np.int64)


def spanning_links(count: int, pairs: IntArray, candidates: Links, least: float) -> IntArray:
    """Return `pairs` with the candidate links that join pieces, strongest first.

    Parameters
    ----------
    count : int
        m.
    pairs : (E, 2) int64
    candidates : Links
    least : float
        Weaker candidates carry no real mass and stay out.

    Returns
    -------
    (E', 2) int64
    """
    piece = piece_labels(count, pairs)
    added = []
    order = np.argsort(-candidates.strength, kind="stable")
    for k in order[candidates.strength[order] >= least]:
        i, j = candidates.pairs[k]
        if piece[i] != piece[j]:
            piece[piece == piece[j]] = piece[i]
            added.append((int(i), int(j)))
    if not added:
        return pairs
    joined = np.concatenate([pairs, np.array(added, dtype=np.int64)])
    return np.unique(joined, axis=0)
