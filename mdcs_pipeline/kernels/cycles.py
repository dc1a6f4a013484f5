"""Short cycles of a small graph."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def neighbour_sets(count: int, pairs: IntArray) -> list[set[int]]:
    """Return, for each of `count` nodes, the nodes that it is paired with."""
    near: list[set[int]] = [set() for _ in range(count)]
    for i, j in pairs.tolist():
        near[i].add(j)
        near[j].add(i)
    return near


def strip_branches(near: list[set[int]]) -> None:
    """Take ends off, in place, until every node that has a partner has two (the 2-core)."""
    ends = [i for i, partners in enumerate(near) if len(partners) == 1]
    while ends:
        i = ends.pop()
        for j in near[i]:
            near[j].discard(i)
            if len(near[j]) == 1:
                ends.append(j)
        near[i] = set()


def _shortest_path(near: list[set[int]], start: int, goal: int) -> list[int]:
    """Return the nodes of a path with the fewest edges that is not the edge itself, or none."""
    before = {start: start}
    queue = deque([start])
    while queue:
        i = queue.popleft()
        for j in sorted(near[i]):
            if j in before or (i == start and j == goal):
                continue
            before[j] = i
            if j == goal:
                path = [j]
                while path[-1] != start:
                    path.append(before[path[-1]])
                return path[::-1]
            queue.append(j)
    return []


def short_cycles(count: int, pairs: IntArray) -> list[list[int]]:
    """Return, for every edge on any cycle, a cycle through it with the fewest edges.

    Parameters
    ----------
    count : int
    pairs : (E, 2) int64

    Returns
    -------
    list of list of int
        Nodes in the order of the cycle, each set of nodes once.
    """
    near = neighbour_sets(count, pairs)
    strip_branches(near)
    found: dict[frozenset[int], list[int]] = {}
    for i, partners in enumerate(near):
        for j in sorted(partners):
            if i < j and (path := _shortest_path(near, i, j)):
                found.setdefault(frozenset(path), path)
    return list(found.values())


def on_cycles(count: int, pairs: IntArray) -> BoolArray:
    """Return the nodes that lie on any cycle of the graph."""
    inside = np.zeros(count, dtype=bool)
    for cycle in short_cycles(count, pairs):
        inside[cycle] = True
    return inside
