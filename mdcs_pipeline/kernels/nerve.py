"""Filled triangles: the nerve of the cover of the cloud by its nodes' points.

The sets Y_i of points that send mass to node i cover the cloud. Where three of them meet in
common points, the triangle of their nodes is filled, and its cycle is no hole of the shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Share from which a point serves a node, and common points that fill a triangle.
LEAST_SHARE, COMMON_POINTS = 0.01, 1


def filled_triangles(top: IntArray, shares: FloatArray, floor: float, points: int) -> IntArray:
    """Return the node triples that share at least `points` points.

    Parameters
    ----------
    top : (n, k) int64
        Nodes by falling share, −1 where there are fewer.
    shares : (n, k) float64
    floor : float
        Least share that counts as serving a node.
    points : int
        Least number of common points.

    Returns
    -------
    (T, 3) int64
        Rising indices, each triple once.
    """
    width = top.shape[1]
    serves = (shares > floor) & (top >= 0)
    # Most points serve fewer than three.
    many = serves.sum(axis=1) >= 3
    top, serves = top[many], serves[many]
    triples = [
        top[serves[:, a] & serves[:, b] & serves[:, c]][:, [a, b, c]]
        for a in range(width)
        for b in range(a + 1, width)
        for c in range(b + 1, width)
    ]
    found = np.sort(np.concatenate(triples), axis=1) if triples else np.empty((0, 3), np.int64)
    if not len(found):
        return np.empty((0, 3), np.int64)
    # One number a triple sorts many times faster than rows do.
    base = int(found.max()) + 1
    if base >= 1 << 20:
        raise OverflowError(f"{base} nodes are more than triples of them can be numbered for")
    named = (found[:, 0] * base + found[:, 1]) * base + found[:, 2]
    unique, counts = np.unique(named, return_counts=True)
    kept = unique[counts >= points]
    return np.stack([kept // (base * base), kept // base % base, kept % base], axis=1)


def open_triangles(nodes: FloatArray, pairs: IntArray, triangles: IntArray) -> IntArray:
    """Return the pairs without the longest edge of every filled triangle, longest first.

    Pieces and true holes survive. Two filled triangles on one longest edge leave the rim of
    their square: such a loop on the wall of something thick is what the check widens.

    Parameters
    ----------
    nodes : (m, 3) float64
    pairs : (E, 2) int64
    triangles : (T, 3) int64

    Returns
    -------
    (E', 2) int64
    """
    alive = set(map(tuple, pairs.tolist()))
    sides = triangles[:, [[0, 1], [0, 2], [1, 2]]]
    # Most triangles lack a side from the start: they need not be gone through one by one.
    named = sides @ [len(nodes), 1]
    held = np.isin(named, pairs @ [len(nodes), 1]).all(axis=1)
    triangles, sides, named = triangles[held], sides[held], named[held]
    if not len(triangles):
        return np.array(sorted(alive), dtype=np.int64).reshape(-1, 2)
    length = np.linalg.norm(nodes[sides[:, :, 0]] - nodes[sides[:, :, 1]], axis=2)
    # The longest side; of equal ones the last by its nodes, and so with equal triangles.
    last = np.where(length == length.max(axis=1)[:, None], named, -1).argmax(axis=1)
    rows = np.arange(len(triangles))
    order = np.lexsort((*triangles.T[::-1], named[rows, last], length[rows, last]))[::-1]
    for corners, side in zip(sides[order].tolist(), last[order].tolist(), strict=True):
        edges = [tuple(edge) for edge in corners]
        if alive.issuperset(edges):
            alive.discard(edges[side])
    return np.array(sorted(alive), dtype=np.int64).reshape(-1, 2)
