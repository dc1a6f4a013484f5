"""The shortest loops that all others of a graph are made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


def loop_basis(count: int, edges: IntArray, lengths: FloatArray) -> list[list[int]]:
    """Return a cycle basis of least total length.

    Horton's candidates, a shortest path from a node to each end of an edge, taken from the
    shortest on as long as they are independent over GF(2). Source: J. D. Horton, A
    polynomial-time algorithm to find the shortest cycle basis of a graph, SIAM J. Comput.
    16 (1987).

    Parameters
    ----------
    count : int
        Number of nodes.
    edges : (E, 2) int64
        Pairs of node indices; a pair may come several times, and join a node to itself.
    lengths : (E,) float64
        Not negative.

    Returns
    -------
    list of list of int
        Indices of the edges of each loop, ascending; the shortest loop first.
    """
    slack = np.maximum(lengths, np.finfo(float).tiny)
    first: dict[tuple[int, int], int] = {}
    found: list[tuple[float, int]] = []
    later: list[int] = []
    for e in np.argsort(slack, kind="stable").tolist():
        i, j = sorted(edges[e].tolist())
        if i == j:
            found.append((float(slack[e]), 1 << e))
        elif first.setdefault((i, j), e) != e:
            later.append(e)
    simple = np.array(sorted(first.values()), np.int64)
    trees = _trees(count, edges, slack, first)
    # The shorter twin can stand for it in any other loop, so it needs but the shortest way
    # between its own ends.
    for e in later:
        i, j = edges[e].tolist()
        distance, masks = trees[i]
        found.append((float(distance[j] + slack[e]), masks[j] | 1 << e))
    wanted = len(simple) - count + _pieces(trees, count)
    found.extend(_independent(_candidates(edges, slack, simple, trees), wanted))
    return [_members(mask) for _, mask in sorted(found)]


Tree = tuple[FloatArray, list[int]]


def _trees(
    count: int, edges: IntArray, lengths: FloatArray, first: dict[tuple[int, int], int]
) -> list[Tree]:
    """Return distances from every node, and the shortest paths as bits of edges."""
    if not count:
        return []
    used = np.array(list(first.values()), np.int64)
    pairs = edges[used]
    graph = coo_array((lengths[used], (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    distances, before = dijkstra(graph, directed=False, return_predecessors=True)
    trees: list[Tree] = []
    for root in range(count):
        masks = [0] * count
        parents = before[root].tolist()
        for node in np.argsort(distances[root], kind="stable").tolist():
            parent = parents[node]
            if parent >= 0:
                edge = first[(min(parent, node), max(parent, node))]
                masks[node] = masks[parent] | 1 << edge
        trees.append((distances[root], masks))
    return trees


def _pieces(trees: list[Tree], count: int) -> int:
    return sum(int(np.argmin(np.isinf(trees[i][0]))) == i for i in range(count))


def _candidates(
    edges: IntArray, lengths: FloatArray, simple: IntArray, trees: list[Tree]
) -> list[tuple[float, int]]:
    found: dict[int, float] = {}
    for distance, masks in trees:
        for e in simple.tolist():
            i, j = edges[e].tolist()
            bit = 1 << e
            apart = not (masks[i] & masks[j] or (masks[i] | masks[j]) & bit)
            if np.isfinite(distance[i]) and apart:
                found[masks[i] | masks[j] | bit] = float(distance[i] + distance[j] + lengths[e])
    return sorted((length, mask) for mask, length in found.items())


def _independent(candidates: list[tuple[float, int]], wanted: int) -> list[tuple[float, int]]:
    """Return the first `wanted` candidates that are no sums of those before them."""
    rows: dict[int, int] = {}
    chosen: list[tuple[float, int]] = []
    for length, mask in candidates:
        if len(chosen) == wanted:
            break
        rest = mask
        while rest and (top := rest.bit_length()) in rows:
            rest ^= rows[top]
        if rest:
            rows[rest.bit_length()] = rest
            chosen.append((length, mask))
    return chosen


def _members(mask: int) -> list[int]:
    return [k for k in range(mask.bit_length()) if mask >> k & 1]
