"""Junctions beside nodes: limbs that leave a node together meet on their way, not in it.

The points of the nodes cover the cloud, and nodes meet where points serve both. The nodes that
meet node j, joined where they meet each other at j, fall into groups: one for each direction in
which the shape leaves j (the link of j in the nerve of the cover). A tree of edges between nodes
may still have two edges of one group meet in j: where a thumb leaves a palm, the palm's limb
would make a detour by the thumb's root. They meet where the mass is that j and the group share.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.cycles import neighbour_sets
from mdcs_pipeline.kernels.links import unique_pairs
from mdcs_pipeline.kernels.spanning import piece_labels

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Parted(NamedTuple):
    """A graph whose limbs meet beside its nodes.

    Parameters
    ----------
    edges : (E, 2) int64
        i < j; nodes from m on are new.
    beside : (k,) int64
        The node that each new one has taken edges from.
    meeting : tuple of (q,) int64
        For each new node, the old ones that meet `beside` there.
    """

    edges: IntArray
    beside: IntArray
    meeting: tuple[IntArray, ...]


def parted(
    count: int, edges: IntArray, triangles: IntArray, firm: BoolArray, fixed: BoolArray
) -> Parted:
    """Return the graph with edges that leave a node together brought to a node of their own.

    Pieces, loops and ends stay as they are: a node keeps an edge into each group, and one whose
    edges all leave together stays where they meet.

    Parameters
    ----------
    count : int
        m.
    edges : (E, 2) int64
    triangles : (T, 3) int64
        Nodes that meet in common points, from `nerve.filled_triangles`.
    firm : (T, 3) bool
        Whether the two nodes other than the k-th of a triangle touch each other.
    fixed : (m,) bool
        Nodes whose edges stay.

    Returns
    -------
    Parted
    """
    near = neighbour_sets(count, edges)
    # The old nodes that each node stands for, seen from one that it has an edge to.
    stands = [np.array([node]) for node in range(count)]
    meets = {node: _meets(node, triangles, firm) for node in _branching(near, count)}
    beside: list[int] = []
    again = True
    while again:
        again = False
        for node in _branching(near, count):
            groups = _groups(near, node, stands, meets[node])
            if fixed[node] or len(groups) < 2:
                continue
            for group in groups:
                if len(group) < 2 or any(fixed[stands[other]].any() for other in group):
                    continue
                new, again = len(near), True
                stands.append(np.unique(np.concatenate([stands[k] for k in [node, *group]])))
                beside.append(node)
                near.append({node, *group})
                near[node] = (near[node] - set(group)) | {new}
                for other in group:
                    near[other] = (near[other] - {node}) | {new}
    pairs = [(node, other) for node, others in enumerate(near) for other in others if node < other]
    met = tuple(np.setdiff1d(s, [b]) for s, b in zip(stands[count:], beside, strict=True))
    return Parted(unique_pairs(np.array(pairs)), np.array(beside, dtype=np.int64), met)


def _branching(near: list[set[int]], count: int) -> list[int]:
    return [node for node in range(count) if len(near[node]) > 2]


def _meets(node: int, triangles: IntArray, firm: BoolArray) -> IntArray:
    """Return the pairs of nodes that touch and meet `node`."""
    mine = triangles[((triangles == node) & firm).any(axis=1)]
    return np.asarray(mine[mine != node].reshape(-1, 2), dtype=np.int64)


def _groups(
    near: list[set[int]], node: int, stands: list[IntArray], meets: IntArray
) -> list[list[int]]:
    """Return the neighbours of a node by the direction in which they leave it.

    Two that an edge joins are a loop with it, and no direction.
    """
    others, tied = sorted(near[node]), []
    for a, one in enumerate(others):
        for b, other in enumerate(others[:a]):
            if other in near[one]:
                continue
            there = np.isin(meets, stands[one]), np.isin(meets, stands[other])
            if (there[0][:, 0] & there[1][:, 1]).any() or (there[0][:, 1] & there[1][:, 0]).any():
                tied.append((b, a))
    label = piece_labels(len(others), np.array(tied, dtype=np.int64).reshape(-1, 2))
    return [[others[k] for k in np.flatnonzero(label == g)] for g in np.unique(label)]


def meeting_places(
    plan: sparse.csr_array, mass: FloatArray, places: FloatArray, joints: Parted
) -> FloatArray:
    """Return where each new node is: the centre of the mass that its old nodes share.

    The mass is Σ π_j π_k / ϱ over all pairs of them, so that the place does not depend on which
    of their edges were there: of a triangle that is filled, `link` opens the longest.

    Parameters
    ----------
    plan : csr_array, (n, m)
    mass : (n,) float64
        ϱ, of the points.
    places : (n, 3) float64
        Where each point's mass is carried from.
    joints : Parted

    Returns
    -------
    (k, 3) float64
    """
    columns = sparse.csc_array(plan)
    found = np.empty((len(joints.beside), 3))
    for k, (node, others) in enumerate(zip(joints.beside.tolist(), joints.meeting, strict=True)):
        each = columns[:, [node, *others]].toarray()
        shared = (each.sum(axis=1) ** 2 - (each**2).sum(axis=1)) / mass
        found[k] = shared @ places / shared.sum()
    return found
