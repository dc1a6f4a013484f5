"""The branches of a graph: paths between its ends and junctions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]


def split_branches(count: int, edges: IntArray) -> list[IntArray]:
    """Return the paths that a graph falls into at its ends and junctions.

    Parameters
    ----------
    count : int
        Number of nodes.
    edges : (E, 2) int64
        Pairs of node indices, each once.

    Returns
    -------
    list of (n,) int64
        Node indices along each branch, n > 1; every edge is in one of them. Inner nodes
        have two neighbours. A loop ends with the node that it starts with: its junction,
        or the lowest index of a ring without one. Isolated nodes are in none. The order
        depends on the indices alone.
    """
    near: list[list[int]] = [[] for _ in range(count)]
    for i, j in edges.tolist():
        near[i].append(j)
        near[j].append(i)
    walked: set[tuple[int, int]] = set()
    branches: list[IntArray] = []
    stops = [i for i in range(count) if len(near[i]) != 2]
    # What no end or junction leads to is a ring: its lowest node is met first.
    for start in [*stops, *(i for i in range(count) if len(near[i]) == 2)]:
        for first in sorted(near[start]):
            if (start, first) not in walked:
                path = _walk(near, start, first)
                walked.update(pairwise(path))
                walked.update(pairwise(reversed(path)))
                branches.append(np.array(path, np.int64))
    return branches


def _walk(near: list[list[int]], start: int, first: int) -> list[int]:
    path = [start, first]
    while path[-1] != start and len(near[path[-1]]) == 2:
        one, other = near[path[-1]]
        path.append(other if one == path[-2] else one)
    return path
