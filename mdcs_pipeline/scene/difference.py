"""What an update changed: the part of a scene that it touches, before and after."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mdcs_pipeline.arrays import IntArray
from mdcs_pipeline.scene.change import SceneChange
from mdcs_pipeline.scene.graph import Chain, Pair, pair_of
from mdcs_pipeline.scene.region import Region
from mdcs_pipeline.scene.state import Scene, World


class Part(NamedTuple):
    """Places and edges of all that an update may touch, inserted nodes included."""

    places: dict[int, tuple[float, ...]]
    edges: set[Pair]
    chains: dict[Pair, Chain]


def snapshot(world: World, names: set[int]) -> Part:
    """Return what stands at the nodes of these names, and on the edges between and at them."""
    graph = world.graph
    held = {name for name in names if name in graph.nodes}
    pairs = {pair_of(name, other) for name in held for other in graph.nodes[name].links}
    chains = {pair: graph.chains[pair] for pair in sorted(pairs)}
    places = {name: tuple(graph.nodes[name].position.tolist()) for name in sorted(held)}
    edges: set[Pair] = set()
    for (i, j), chain in chains.items():
        ids = chain.ids.tolist()
        places.update(zip(ids, map(tuple, chain.positions.tolist()), strict=True))
        edges.update(pair_of(a, b) for a, b in pairwise([i, *ids, j]))
    return Part(places, edges, chains)


def difference(scene: Scene, region: Region, before: Part, names: set[int]) -> SceneChange:
    """Return what has changed since `before` at the nodes of these names."""
    assert scene.world is not None
    world = scene.world
    after = snapshot(world, names)
    added = sorted(after.places.keys() - before.places.keys())
    removed = sorted(before.places.keys() - after.places.keys())
    moved = sorted(
        name for name, place in after.places.items() if before.places.get(name, place) != place
    )
    rows = np.array([after.places[name] for name in [*added, *moved]]).reshape(-1, 3)
    return SceneChange(
        header=region.header,
        added=np.array(added, dtype=np.int64),
        moved=np.array(moved, dtype=np.int64),
        removed=np.array(removed, dtype=np.int64),
        positions=world.unit.from_unit(rows),
        joined=_as_pairs(after.edges - before.edges),
        parted=_as_pairs(before.edges - after.edges),
        scene=scene.number,
        figures={**region.figures, "nodes": len(world.graph)},
    )


def _as_pairs(edges: set[Pair]) -> IntArray:
    return np.array(sorted(edges), dtype=np.int64).reshape(-1, 2)
