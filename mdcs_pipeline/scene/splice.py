"""What an update found for a region, written into the scene in one block."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import IntArray
from mdcs_pipeline.kernels.assignment import plan_owners
from mdcs_pipeline.kernels.contact import contacts
from mdcs_pipeline.messages import RoughSkeleton, Skeleton, Surface, Thickness
from mdcs_pipeline.scene.change import SceneChange
from mdcs_pipeline.scene.difference import difference, snapshot
from mdcs_pipeline.scene.graph import Chain, Pair, SceneGraph, SceneNode, pair_of
from mdcs_pipeline.scene.region import Region
from mdcs_pipeline.scene.state import Scene, World

FloatArray = NDArray[np.float64]

# An edge without inserted points.
_STRAIGHT = Chain(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0), np.empty(0))


class Update(NamedTuple):
    """What the stages made of a region.

    Parameters
    ----------
    rough : RoughSkeleton
        Nodes by their ids, the plan and the edges.
    skeleton : Skeleton
        The same nodes first and in the same order, then those inserted into edges.
    surface : Surface
    thickness : Thickness
        That the plan was made with.
    """

    rough: RoughSkeleton
    skeleton: Skeleton
    surface: Surface
    thickness: Thickness


def splice_nothing(scene: Scene, region: Region) -> SceneChange:
    """Return the change of a frame that brought too little for an update.

    Nodes whose voxels have all vanished go without one.
    """
    if scene.world is None:
        return SceneChange(region.header, scene=scene.number, figures=region.figures)
    graph = scene.world.graph
    gone = [
        name
        for name in region.active.tolist()
        if name in graph.nodes and not _cells(scene.world, name)
    ]
    if gone and not len(region):
        before = snapshot(scene.world, set(gone))
        for name in gone:
            graph.remove(name)
        scene.vacated -= set(gone)
        _hand_back(scene, set(gone))
        return difference(scene, region, before, set())
    return SceneChange(region.header, scene=scene.number, figures=region.figures)


def _cells(world: World, name: int) -> int:
    cells = world.graph.nodes[name].cells
    return int(np.count_nonzero(world.voxels.owner[cells] == name))


def splice_update(scene: Scene, region: Region, update: Update) -> SceneChange:
    """Write an update into the scene and return what it changed.

    Parameters
    ----------
    scene : Scene
        With a world; changed.
    region : Region
        That the update was made for.
    update : Update

    Returns
    -------
    SceneChange
    """
    assert scene.world is not None
    world = scene.world
    graph = world.graph
    rough = update.rough
    ids = rough.nodes.ids.tolist()
    fixed = rough.nodes.fixed
    free = {name for name, stays in zip(ids, fixed.tolist(), strict=True) if not stays}
    seen = {*region.active.tolist(), *ids}
    before = snapshot(world, seen)
    _own(world, region, update, free)
    inherited = _inherited(world, region, free)
    for name in region.active.tolist():
        if name not in free:
            graph.remove(name)
        else:
            graph.cut(name)
    _write_nodes(world, region, update, free)
    _write_near(graph, update, free | set(region.ring.tolist()))
    _write_edges(world, region, update, before.chains)
    for pair in inherited:
        if pair not in graph.chains:
            graph.join(pair, _STRAIGHT)
    scene.vacated -= set(region.active.tolist())
    _hand_back(scene, set(region.active.tolist()) - free)
    return difference(scene, region, before, seen & graph.nodes.keys())


def _inherited(world: World, region: Region, free: set[int]) -> list[Pair]:
    """Return the edges of nodes that fixed ones took in: what they joined must not come apart."""
    graph, owner = world.graph, world.voxels.owner
    pairs: set[Pair] = set()
    for name in region.active.tolist():
        node = graph.nodes[name]
        if name in free or not len(node.cells):
            continue
        heirs, counts = np.unique(owner[node.cells], return_counts=True)
        heir = int(heirs[np.argmax(counts)])
        if heir in graph.nodes and heir not in free and heir != name:
            kept = node.links - set(region.active.tolist()) - {heir}
            pairs.update(pair_of(heir, other) for other in kept)
    return sorted(pairs)


def _hand_back(scene: Scene, gone: set[int]) -> None:
    """What waited at nodes that are gone has to find others."""
    held = [scene.waiting.pop(name) for name in sorted(gone & scene.waiting.keys())]
    scene.changed = np.concatenate([scene.changed, *held])
    scene.overdue -= gone


def _own(world: World, region: Region, update: Update, free: set[int]) -> None:
    """Give each voxel that was taken account of to its node, and its thickness."""
    ids = update.rough.nodes.ids
    owner = ids[plan_owners(update.rough.plan.plan)]
    voxels = world.voxels
    ring = np.isin(region.owner, region.ring)
    # A voxel of the outer nodes may have a nearer one out of sight: it changes hands only
    # within the region.
    moves = region.taken | ring | np.isin(owner, np.array(sorted(free), dtype=np.int64))
    slots = region.slots[moves]
    voxels.owner[slots] = owner[moves]
    taken = region.slots[region.taken]
    voxels.radius[taken] = update.thickness.radius[region.taken]
    if update.thickness.centre is not None:
        voxels.middle[taken] = update.thickness.centre[region.taken]
    if update.thickness.trust is not None:
        voxels.trust[taken] = update.thickness.trust[region.taken]
    if update.thickness.normal is not None:
        voxels.normal[taken] = update.thickness.normal[region.taken]
    voxels.pending[taken] = False


def _write_nodes(world: World, region: Region, update: Update, free: set[int]) -> None:
    nodes, skeleton = update.rough.nodes, update.skeleton
    owner = world.voxels.owner[region.slots]
    order = np.argsort(owner, kind="stable")
    starts = np.searchsorted(owner[order], nodes.ids, "left")
    ends = np.searchsorted(owner[order], nodes.ids, "right")
    places = world.unit.to_unit(skeleton.nodes)
    area = len(region) * world.voxels.size**2
    received = np.bincount(
        update.rough.plan.plan.indices, update.rough.plan.plan.data, minlength=len(nodes)
    )
    ring, grown = set(region.ring.tolist()), set(region.grown.tolist())
    fresh = np.concatenate([[0], np.cumsum(region.owner[order] < 0)])
    new = (fresh[ends] - fresh[starts]).tolist()
    for k, name in enumerate(nodes.ids.tolist()):
        cells = region.slots[order[starts[k] : ends[k]]]
        if name in free:
            old = world.graph.nodes.get(name)
            world.graph.put(
                name,
                SceneNode(
                    position=places[k].copy(),
                    mass=float(received[k]) * area,
                    share=float(skeleton.mass[k]) * area,
                    potential=float(nodes.potentials[k]),
                    scale=float(nodes.scale[k]),
                    radius=float(skeleton.radius[k]) / world.unit.length,
                    cells=cells,
                    gained=0 if old is None or name in grown else old.gained + new[k],
                    near=() if old is None else old.near,
                    links=set() if old is None else old.links,
                ),
            )
        else:
            node = world.graph.nodes[name]
            node.cells = cells
            if name in ring:
                node.mass = float(received[k]) * area


def _write_near(graph: SceneGraph, update: Update, whole: set[int]) -> None:
    """Note which nodes' voxels touch; those of `whole` have all their surroundings in sight."""
    rough = update.rough
    ids = rough.nodes.ids
    touching = contacts(update.surface.graph, plan_owners(rough.plan.plan), len(ids))
    inside = set(ids.tolist())
    found: dict[int, set[int]] = {name: set() for name in inside}
    for k, name in enumerate(ids.tolist()):
        row = touching.indices[touching.indptr[k] : touching.indptr[k + 1]]
        found[name].update(ids[row].tolist())
    for name in sorted(inside):
        node = graph.nodes[name]
        kept = {n for n in node.near if n in graph.nodes}
        if name in whole:
            kept -= inside
        else:
            kept -= whole
            found[name] &= whole
        node.near = tuple(sorted(kept | found[name]))


def _write_edges(world: World, region: Region, update: Update, old: dict[Pair, Chain]) -> None:
    """Put the edges that are not there, each with the points inserted into it.

    They end at free nodes, but for those by which an update joins what lies around it.
    """
    graph, skeleton = world.graph, update.skeleton
    ids = update.rough.nodes.ids.tolist()
    next_id = max(graph.next_id, region.next_id)
    places = world.unit.to_unit(skeleton.nodes)
    area = len(region) * world.voxels.size**2
    for i, j, chain in _chains(update):
        pair = pair_of(ids[i], ids[j])
        if pair in graph.chains:
            continue
        rows = np.array(chain if ids[i] < ids[j] else chain[::-1], dtype=np.int64)
        names = _names(old.get(pair), len(rows), next_id)
        next_id = max(next_id, int(names.max(initial=-1)) + 1)
        graph.join(
            pair,
            Chain(
                names,
                places[rows],
                skeleton.mass[rows] * area,
                skeleton.radius[rows] / world.unit.length,
            ),
        )


def _names(known: Chain | None, count: int, next_id: int) -> IntArray:
    """Return ids for the points of an edge: as many old ones as can be, in their order."""
    had = np.empty(0, np.int64) if known is None else known.ids
    if len(had) == count:
        return had
    if len(had) > count:
        spread = np.round(np.linspace(0, len(had) - 1, count)).astype(np.int64)
        return had[spread]
    names = next_id + np.arange(count)
    if not len(had):
        return names
    names[np.round(np.linspace(0, count - 1, len(had))).astype(np.int64)] = had
    return names


def _chains(update: Update) -> list[tuple[int, int, list[int]]]:
    """Return the rough edges with the inserted nodes between their ends, in the first's order."""
    count = len(update.rough.nodes)
    near: dict[int, list[int]] = {}
    for a, b in update.skeleton.edges.tolist():
        near.setdefault(a, []).append(b)
        near.setdefault(b, []).append(a)
    found = []
    for start in range(count):
        for first in near.get(start, ()):
            chain, last, at = [], start, first
            while at >= count:
                chain.append(at)
                further = [n for n in near[at] if n != last]
                if not further:
                    # A tip added to a node without an edge: it belongs to no edge of the graph.
                    break
                last, at = at, further[0]
            if start < at < count:
                found.append((start, at, chain))
    return found
