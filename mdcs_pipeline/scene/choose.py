"""Which part of a scene an update works on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from mdcs_pipeline.arrays import BoolArray, IntArray
from mdcs_pipeline.header import Header
from mdcs_pipeline.kernels.compiled.grid import grid_of, scattered
from mdcs_pipeline.kernels.compiled.pieces import pieces_near
from mdcs_pipeline.scene.graph import SceneGraph
from mdcs_pipeline.scene.region import Region, empty_region
from mdcs_pipeline.scene.state import Scene, World
from mdcs_pipeline.scene.voxels import NOBODY, VoxelMap

# Cells around a changed voxel among which its node is looked for.
_REACH = 2
# Voxels away from all nodes that are looked at again in every frame.
_ALONE = 500


class RegionRule(NamedTuple):
    """What makes a region active.

    Parameters
    ----------
    share : float
        Changed share of a node's voxels from which it becomes active.
    speck : int
        Fewer new voxels than this that hang together and touch nothing known wait for more.
    reach : float
        New surface wakes the nodes within this many of their local radii.
    most : int
        Voxels that one update works on, about; the rest waits for the next frame.
    renewal : float
        A node is made afresh once new surface has made its voxels this many times as many.
    """

    share: float = 0.1
    speck: int = 20
    reach: float = 1.5
    most: int = 6000
    renewal: float = 1.5


class _Names(NamedTuple):
    """Nodes of a region by what may happen to them."""

    active: list[int]
    ring: list[int]
    outer: list[int]


def choose_region(scene: Scene, rule: RegionRule, header: Header, drain: bool) -> Region:
    """Return the region that the pending voxels make active; empty while there are too few.

    Parameters
    ----------
    scene : Scene
    rule : RegionRule
    header : Header
        Of the frame.
    drain : bool
        Whether all that is pending counts, however little it is.

    Returns
    -------
    Region
    """
    world = scene.world
    if world is None:
        return empty_region(header, {})
    awake, touched = _awake(scene, world, rule, drain)
    due = set(touched)
    place = world.voxels.place
    while True:
        names = _names(world.graph, place[awake], touched, rule)
        held = sum(len(world.graph.nodes[n].cells) for part in names for n in part)
        # What surrounds it may be large by itself: then a quarter is enough to be new.
        if len(awake) + held <= rule.most or len(awake) <= rule.most // 4:
            break
        # Too much at once: the half that lies together goes first.
        far = np.linalg.norm(place[awake] - place[awake[0]], axis=1)
        awake = np.sort(awake[np.argsort(far, kind="stable")[: (len(awake) + 1) // 2]])
        owners = np.unique(world.voxels.nearest_owner(awake, _REACH))
        touched = {int(n) for n in owners if n in world.graph.nodes}
    scene.overdue = due - touched
    return _region(header, world, awake, names, _count(scene), rule.renewal)


def _count(scene: Scene) -> int:
    return sum(len(slots) for slots in scene.waiting.values())


def _awake(scene: Scene, world: World, rule: RegionRule, drain: bool) -> tuple[IntArray, set[int]]:
    """Return the voxels whose time has come, and the nodes that they lie at."""
    voxels, nodes, waiting = world.voxels, world.graph.nodes, scene.waiting
    touched = _sorted_in(scene, world) | {n for n in scene.overdue if n in waiting}
    if drain:
        touched |= waiting.keys()
    due = {n for n in scene.vacated if n in nodes and (drain or _loss(world, n) >= rule.share)}
    awake = []
    for name in sorted(touched):
        held = waiting[name] = waiting[name][voxels.pending[waiting[name]]]
        if name < 0:
            held = held[_patches(voxels, held, rule.speck)]
        elif not (drain or len(held) >= rule.share * len(nodes[name].cells)):
            continue
        else:
            due.add(name)
        if not len(waiting[name]):
            del waiting[name]
        awake.append(held)
    # A slot may have been used again while it waited elsewhere.
    return np.unique(np.concatenate([np.empty(0, np.int64), *awake])), due


def _sorted_in(scene: Scene, world: World) -> set[int]:
    """Put what has changed to the nodes that it lies at, and return these."""
    voxels, waiting = world.voxels, scene.waiting
    # What lay at no node may do so by now; those asked longest ago are asked again.
    alone = waiting.pop(NOBODY, np.empty(0, np.int64))
    if len(alone) > _ALONE:
        waiting[NOBODY] = alone[_ALONE:]
    new = np.concatenate([alone[:_ALONE], scene.changed])
    scene.changed = np.empty(0, np.int64)
    new = np.unique(new[voxels.pending[new]])
    nearest = voxels.nearest_owner(new, _REACH)
    names, where = np.unique(nearest, return_inverse=True)
    for k, name in enumerate(names.tolist()):
        slots = new[where == k]
        waiting[name] = np.concatenate([waiting[name], slots]) if name in waiting else slots
    return {*names.tolist(), NOBODY} & waiting.keys()


def _loss(world: World, name: int) -> float:
    cells = world.graph.nodes[name].cells
    return 1.0 - float(np.mean(world.voxels.owner[cells] == name)) if len(cells) else 1.0


def _patches(voxels: VoxelMap, slots: IntArray, least: int) -> BoolArray:
    """Return which voxels hang together with at least `least` others of the given ones."""
    if len(slots) < least:
        return np.zeros(len(slots), dtype=bool)
    reach = 3.0 * voxels.size
    grid = grid_of(voxels.place[slots], reach)
    piece = scattered(grid, pieces_near(grid, reach))
    return np.asarray(np.bincount(piece)[piece] >= least, dtype=np.bool_)


def _names(
    graph: SceneGraph, places: NDArray[np.float64], touched: set[int], rule: RegionRule
) -> _Names:
    """Return the nodes that new surface at `places` reaches, and two rings around them."""
    active = set(touched)
    near = graph.around(places, rule.reach * graph.largest_scale)
    if near:
        found = [graph.nodes[name] for name in near]
        distance = cdist(np.array([node.position for node in found]), places).min(axis=1)
        scale = np.array([node.scale for node in found])
        active.update(np.array(near)[distance <= rule.reach * scale].tolist())
    ring = graph.neighbours(active)
    outer = graph.neighbours(active | ring)
    return _Names(sorted(active), sorted(ring), sorted(outer))


def _cells(world: World, names: list[int]) -> IntArray:
    """Return the voxels that the nodes still own."""
    voxels, nodes = world.voxels, world.graph.nodes
    held = [nodes[n].cells[voxels.owner[nodes[n].cells] == n] for n in names]
    return np.concatenate([np.empty(0, np.int64), *held])


def _has_grown(world: World, name: int, renewal: float) -> bool:
    node = world.graph.nodes[name]
    return node.gained > (renewal - 1.0) * (len(node.cells) - node.gained)


def _region(
    header: Header,
    world: World | None,
    awake: IntArray,
    names: _Names,
    waiting: int,
    renewal: float,
) -> Region:
    if world is None:
        return empty_region(header, {"active": 0})
    voxels, graph = world.voxels, world.graph
    slots, taken = [awake], [np.ones(len(awake), dtype=bool)]
    # Of the outer nodes all voxels too: where the region ends, thickness is measured wrong, and
    # that must not be at what is updated.
    for part, takes in ((names.active, True), (names.ring, False), (names.outer, False)):
        cells = _cells(world, part)
        slots.append(cells)
        taken.append(np.full(len(cells), takes))
    every, first = np.unique(np.concatenate(slots), return_index=True)
    figures = {
        "voxels": len(voxels),
        "nodes": len(graph),
        "waiting": waiting,
        "active": len(names.active),
        "fixed": len(names.ring) + len(names.outer),
        "points": len(every),
    }
    return Region(
        header=header,
        slots=every,
        taken=np.concatenate(taken)[first],
        owner=voxels.owner[every],
        radius=voxels.radius[every],
        middle=voxels.middle[every],
        trust=voxels.trust[every].astype(np.float64),
        normal=voxels.normal[every].astype(np.float64),
        changed=voxels.pending[every],
        grown=np.array([n for n in names.active if _has_grown(world, n, renewal)], np.int64),
        active=np.array(names.active, dtype=np.int64),
        ring=np.array(names.ring, dtype=np.int64),
        next_id=graph.next_id,
        figures=figures,
    )
