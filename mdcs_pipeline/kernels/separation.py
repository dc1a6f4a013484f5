"""Whether the points of a node cut the shape in two, or can be walked around.

A node on the axis of a tube owns a ring of surface: without it, the surface at its one side
does not hang together with that at the other. A node of a false loop owns a patch on the wall
of something thick, and a short walk leads around it. A loop is judged by its nodes: it is
false where its neighbours, at most of its nodes, can be reached from each other around the
node. That is the same question for thick and thin, and a half-scanned tube answers it too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from mdcs_pipeline.kernels.cycles import short_cycles
from mdcs_pipeline.kernels.links import unique_pairs

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]


def surroundings(graph: sparse.csr_array, inside: BoolArray, hops: int) -> IntArray:
    """Return the points outside a set that at most `hops` links lead to.

    Parameters
    ----------
    graph : csr_array, (n, n)
    inside : (n,) bool
    hops : int

    Returns
    -------
    (k,) int64
    """
    seen = inside.copy()
    front = np.flatnonzero(inside)
    ring = []
    for _ in range(hops):
        starts, ends = graph.indptr[front], graph.indptr[front + 1]
        reached = [graph.indices[a:b] for a, b in zip(starts, ends, strict=True)]
        near = np.unique(np.concatenate(reached)) if reached else np.empty(0, np.int64)
        front = near[~seen[near]].astype(np.int64)
        seen[front] = True
        ring.append(front)
    return np.concatenate(ring) if ring else np.empty(0, np.int64)


class Rings:
    """The pieces of surface around each node's own points, found once a node.

    Parameters
    ----------
    graph : csr_array, (n, n)
        Neighbour graph of the surface.
    owner : (n,) int64
        Node of each point.
    hops : int
        Width of a ring in links.
    """

    def __init__(self, graph: sparse.csr_array, owner: IntArray, hops: int) -> None:
        self._graph, self._owner, self._hops = graph, owner, hops
        self._known: dict[int, tuple[IntArray, IntArray]] = {}

    def _pieces(self, node: int) -> tuple[IntArray, IntArray]:
        if node not in self._known:
            ring = surroundings(self._graph, self._owner == node, self._hops)
            _, piece = connected_components(self._graph[ring][:, ring], directed=False)
            self._known[node] = (self._owner[ring], piece.astype(np.int64))
        return self._known[node]

    def leads_around(self, node: int, one: int, other: int, overlap: float) -> bool:
        """Return whether the ring of `node` joins the points of its two neighbours.

        It does when the pieces that hold the two neighbours' points agree by more than
        `overlap` of their shares.
        """
        owner, piece = self._pieces(node)
        if not len(owner):
            return False
        count = int(piece.max()) + 1
        a = np.bincount(piece[owner == one], minlength=count).astype(np.float64)
        b = np.bincount(piece[owner == other], minlength=count).astype(np.float64)
        if not (a.any() and b.any()):
            return False
        return bool(np.minimum(a / a.sum(), b / b.sum()).sum() > overlap)


def false_loops(
    count: int, pairs: IntArray, rings: Rings, overlap: float, majority: float
) -> list[list[int]]:
    """Return the short cycles of which at least `majority` of the nodes can be walked around.

    Parameters
    ----------
    count : int
    pairs : (E, 2) int64
    rings : Rings
    overlap : float
    majority : float

    Returns
    -------
    list of list of int
    """
    false = []
    for cycle in short_cycles(count, pairs):
        before, after = cycle[-1:] + cycle[:-1], cycle[1:] + cycle[:1]
        around = [
            rings.leads_around(node, one, other, overlap)
            for node, one, other in zip(cycle, before, after, strict=True)
        ]
        if np.mean(around) >= majority:
            false.append(cycle)
    return false


def contracted(
    count: int,
    pairs: IntArray,
    graph: sparse.csr_array,
    owner: IntArray,
    hops: int,
    overlap: float,
    majority: float,
    loops: list[list[int]] | None = None,
) -> IntArray:
    """Return which node each node becomes when false loops shrink to one node, shortest first.

    A filled loop is a disc, and a disc shrinks to a point: pieces and true loops survive.

    Parameters
    ----------
    count : int
    pairs : (E, 2) int64
    graph : csr_array, (n, n)
    owner : (n,) int64
    hops : int
    overlap : float
    majority : float
    loops : list of list of int, optional
        The false loops that there are before any shrinks, where they are known.

    Returns
    -------
    (count,) int64
        The smallest index of the nodes that became one.
    """
    into = np.arange(count)
    while loops is None or loops:
        if loops:
            loop = min(loops, key=len)
            into[np.isin(into, loop)] = min(loop)
        rings = Rings(graph, into[owner], hops)
        loops = false_loops(count, unique_pairs(into[pairs]), rings, overlap, majority)
    return into
