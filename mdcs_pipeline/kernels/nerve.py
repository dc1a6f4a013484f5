"""Filled triangles: the nerve of the cover of the cloud by its nodes' points.

The sets Y_i of points that send mass to node i cover the cloud. Where three of them meet in
common points, the triangle of their nodes is filled, and its cycle is no hole of the shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
    triples = [
        top[serves[:, a] & serves[:, b] & serves[:, c]][:, [a, b, c]]
        for a in range(width)
        for b in range(a + 1, width)
        for c in range(b + 1, width)
    ]
    found = np.sort(np.concatenate(triples), axis=1) if triples else np.empty((0, 3), np.int64)
    if not len(found):
        return np.empty((0, 3), np.int64)
    # Sorting whole numbers is some twenty times faster than sorting rows.
    base = int(found.max()) + 1
    codes = (found[:, 0] * base + found[:, 1]) * base + found[:, 2]
    unique, counts = np.unique(codes, return_counts=True)
    kept = unique[counts >= points]
    return np.stack([kept // base**2, kept // base % base, kept % base], axis=1)


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
    alive = {(i, j) for i, j in pairs.tolist()}
    sides = triangles[:, [[0, 1], [0, 2], [1, 2]]]
    length = np.linalg.norm(nodes[sides[:, :, 0]] - nodes[sides[:, :, 1]], axis=2).tolist()
    longest = [
        max(zip(lengths, map(tuple, edges), strict=True))
        for lengths, edges in zip(length, sides.tolist(), strict=True)
    ]
    order = sorted(zip(longest, map(tuple, triangles.tolist()), strict=True), reverse=True)
    for (_, edge), (a, b, c) in order:
        if {(a, b), (a, c), (b, c)} <= alive:
            alive.discard(edge)
    return np.array(sorted(alive), dtype=np.int64).reshape(-1, 2)
