"""The nodes of a scene and the graph between them, changed in place and locally."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import IntArray

FloatArray = NDArray[np.float64]
Pair = tuple[int, int]
Cell = tuple[int, int, int]


@dataclass
class SceneNode:
    """A node of the skeleton, in unit lengths.

    Parameters
    ----------
    position : (3,) float64
    mass : float
        Surface that it receives among the nodes alone, in squared unit lengths.
    share : float
        The same once nodes are inserted into the edges: what the skeleton tells.
    potential : float
        f_i of the plan that last served it.
    scale : float
        r_i of the cost.
    radius : float
        Mean distance of the mass that it receives.
    cells : (k,) int64
        Slots of the voxels that it owned when it was last active.
    gained : int
        New surface that it took over, in voxels, since its place was last sought from seeds.
    near : tuple of int
        Nodes whose voxels touch its own, sorted.
    links : set of int
        Nodes that it has an edge with.
    """

    position: FloatArray
    mass: float
    share: float
    potential: float
    scale: float
    radius: float
    cells: IntArray
    gained: int = 0
    near: tuple[int, ...] = ()
    links: set[int] = field(default_factory=set)


@dataclass(frozen=True)
class Chain:
    """The points inserted into an edge, from its smaller id to its larger.

    Parameters
    ----------
    ids : (k,) int64
    positions : (k, 3) float64
        In unit lengths.
    mass, radius : (k,) float64
    """

    ids: IntArray
    positions: FloatArray
    mass: FloatArray
    radius: FloatArray


class SceneGraph:
    """Nodes by id, chains by pair of ids, and a coarse grid to find nodes by place.

    Parameters
    ----------
    cell : float
        Edge of the grid's cells, in unit lengths.
    """

    def __init__(self, cell: float) -> None:
        self.cell = cell
        self.nodes: dict[int, SceneNode] = {}
        self.chains: dict[Pair, Chain] = {}
        self.next_id = 0
        self.largest_scale = 0.0
        self._grid: dict[Cell, set[int]] = {}

    def __len__(self) -> int:
        return len(self.nodes)

    def put(self, name: int, node: SceneNode) -> None:
        """Add a node or replace the one of that id; links of an old one must be gone."""
        old = self.nodes.get(name)
        if old is not None:
            self._leave(name, old)
        self.nodes[name] = node
        self.largest_scale = max(self.largest_scale, node.scale)
        self._grid.setdefault(self._cell_of(node.position), set()).add(name)
        self.next_id = max(self.next_id, name + 1)

    def remove(self, name: int) -> None:
        """Remove a node with its edges."""
        self.cut(name)
        node = self.nodes.pop(name)
        self._leave(name, node)
        for other in node.near:
            if other in self.nodes:
                mate = self.nodes[other]
                mate.near = tuple(n for n in mate.near if n != name)

    def cut(self, name: int) -> list[Pair]:
        """Remove all edges of a node and return them."""
        node = self.nodes[name]
        gone = [pair_of(name, other) for other in sorted(node.links)]
        for other in node.links:
            self.nodes[other].links.discard(name)
        node.links = set()
        for pair in gone:
            del self.chains[pair]
        return gone

    def join(self, pair: Pair, chain: Chain) -> None:
        """Add an edge."""
        a, b = pair
        self.nodes[a].links.add(b)
        self.nodes[b].links.add(a)
        self.chains[pair] = chain
        if len(chain.ids):
            self.next_id = max(self.next_id, int(chain.ids.max()) + 1)

    def pieces_beyond(self, rim: list[int], without: set[int], limit: int) -> dict[int, int]:
        """Return a label for each node of a rim: alike where a way leads around `without`.

        The search ends after `limit` nodes, so that it stays local; what it has not found to
        be joined by then counts as apart.
        """
        label: dict[int, int] = {}
        budget = limit
        for start in rim:
            if start in label:
                continue
            label[start] = start
            seen, front = {start}, deque([start])
            missing = set(rim) - seen
            # Once all of the rim is found, more would tell nothing.
            while front and missing and budget > 0:
                name = front.popleft()
                budget -= 1
                for other in sorted(self.nodes[name].links - without - seen):
                    seen.add(other)
                    missing.discard(other)
                    front.append(other)
            for name in rim:
                if name in seen:
                    label[name] = start
        return label

    def around(self, places: FloatArray, reach: float) -> list[int]:
        """Return, sorted, the ids of nodes in cells within `reach` of any place, and some more."""
        if not len(places) or not self.nodes:
            return []
        home = np.floor(places / self.cell).astype(np.int64)
        low, shape = home.min(axis=0), np.ptp(home, axis=0) + 1
        names = np.unique(np.ravel_multi_index(tuple((home - low).T), tuple(shape)))
        wide = int(np.ceil(reach / self.cell))
        steps = range(-wide, wide + 1)
        cells = {
            (x + i, y + j, z + k)
            for x, y, z in (np.stack(np.unravel_index(names, tuple(shape)), axis=1) + low).tolist()
            for i in steps
            for j in steps
            for k in steps
        }
        found: set[int] = set()
        for cell in cells:
            found |= self._grid.get(cell, set())
        return sorted(found)

    def neighbours(self, names: Iterable[int]) -> set[int]:
        """Return the nodes that touch or are joined to the given ones, without these."""
        given = set(names)
        found: set[int] = set()
        for name in given:
            found.update(self.nodes[name].near)
            found |= self.nodes[name].links
        return {name for name in found - given if name in self.nodes}

    def _leave(self, name: int, node: SceneNode) -> None:
        cell = self._cell_of(node.position)
        held = self._grid[cell]
        held.discard(name)
        if not held:
            del self._grid[cell]

    def _cell_of(self, place: FloatArray) -> Cell:
        x, y, z = np.floor(place / self.cell).astype(np.int64).tolist()
        return (x, y, z)


def pair_of(a: int, b: int) -> Pair:
    """Return two ids, the smaller first."""
    return (a, b) if a < b else (b, a)
