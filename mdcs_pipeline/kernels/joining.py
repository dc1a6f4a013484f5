"""Pieces that no bridge has reached: each is joined where an open end of one aims at another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.ends import End
from mdcs_pipeline.kernels.shore import Shore, straightness
from mdcs_pipeline.kernels.spanning import piece_labels

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Where an edge is looked at as something to aim at: not at its ends, which are nodes.
_BETWEEN = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)


def joined_pieces(
    pairs: IntArray, ends: list[End], shore: Shore, reach: float, aim: float, crowd: float
) -> IntArray:
    """Return edges that join the pieces of a graph from their open ends, nearest first.

    An end is joined to the node, or to the nearer end of the edge, that it aims at in another
    piece. No edge closes a loop, and none leads through the surface.

    Parameters
    ----------
    pairs : (E, 2) int64
    ends : list of End
        Those that something is missing behind.
    shore : Shore
    reach : float
        Longest way from an end's rim to the surface of its goal, in the end's radius.
    aim : float
        Least cosine between an end and the way to its goal.
    crowd : float
        Points around the way, in those of the end, from which it leads through the surface.

    Returns
    -------
    (J, 2) int64
    """
    piece = piece_labels(len(shore.nodes), pairs)
    places, goals = places_on(shore.nodes, pairs)
    found = []
    for k, end in enumerate(ends):
        length = np.linalg.norm(places - end.place, axis=1)
        # Both the limb and what it aims at reach towards each other.
        gap = length - shore.scale[goals] - max(end.extent, 0.0)
        near = gap <= reach * end.radius
        for goal in np.flatnonzero(near & (piece[goals] != piece[end.node])).tolist():
            cosine = straightness(end, places[goal])
            if cosine >= aim:
                found.append((float(length[goal]) / cosine / end.radius, k, goal))
    joined = []
    for _, k, goal in sorted(found):
        end, node = ends[k], int(goals[goal])
        if piece[node] != piece[end.node] and not shore.pierced(end, places[goal], crowd):
            joined.append((end.node, node))
            piece[piece == piece[node]] = piece[end.node]
    return np.array(joined, dtype=np.int64).reshape(-1, 2)


def places_on(nodes: FloatArray, pairs: IntArray) -> tuple[FloatArray, IntArray]:
    """Return places on a graph, (p, 3), and the node that each stands for, (p,)."""
    first, second = pairs.T
    places, stand = [nodes], [np.arange(len(nodes))]
    for t in _BETWEEN:
        places.append((1.0 - t) * nodes[first] + t * nodes[second])
        stand.append(first if t < 0.5 else second)
    return np.concatenate(places), np.concatenate(stand)
