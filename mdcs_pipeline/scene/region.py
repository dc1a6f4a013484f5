"""The part of a scene that an update works on, as messages for the stages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import BoolArray, IntArray, finite_array, set_fields
from mdcs_pipeline.header import Header
from mdcs_pipeline.messages import MassCloud, Nodes
from mdcs_pipeline.scene.state import World

# Nodes that the search for a way around an active region may visit.
_SEARCH = 300


@dataclass(frozen=True, eq=False)
class Region:
    """The part of a scene that an update works on.

    Parameters
    ----------
    header : Header
        Of the frame.
    slots : (n,) int64
        Voxels whose centroids are the points of the cloud, in its order.
    taken : (n,) bool
        Which of them the update takes account of: the changed, and those of active nodes.
    owner : (n,) int64
        Id of the node that each gave most of its mass to; −1 for new surface.
    radius : (n,) float64
        Thickness known so far, 0 where there is none.
    middle : (n, 3) float64
        Middle of the limb as known so far; of no meaning where no thickness is.
    trust : (n,) float64
        How far both are believed, in [0, 1].
    normal : (n, 3) float64
        Where the outside is; 0 where that is not known.
    changed : (n,) bool
        Voxels that are new or have moved since they were last taken account of.
    grown : (g,) int64
        Active nodes that stand for much more surface than when they were last made afresh.
    active : (a,) int64
        Ids of the nodes that may move, merge or go.
    ring : (r,) int64
        Ids of the nodes around these, whose mass may change.
    next_id : int
        Smallest id that no node has had.
    figures : dict
        Counts for the frame's change message.
    """

    header: Header
    slots: IntArray
    taken: BoolArray
    owner: IntArray
    radius: NDArray[np.float64]
    middle: NDArray[np.float64]
    trust: NDArray[np.float64]
    normal: NDArray[np.float64]
    changed: BoolArray
    grown: IntArray
    active: IntArray
    ring: IntArray
    next_id: int
    figures: dict[str, Any]

    def __post_init__(self) -> None:
        count = len(self.slots)
        set_fields(
            self,
            slots=finite_array(self.slots, (None,), "slots", np.int64),
            taken=finite_array(self.taken, (count,), "taken", np.bool_),
            owner=finite_array(self.owner, (count,), "owner", np.int64),
            radius=finite_array(self.radius, (count,), "radius"),
            middle=finite_array(self.middle, (count, 3), "middle"),
            trust=finite_array(self.trust, (count,), "trust"),
            normal=finite_array(self.normal, (count, 3), "normal"),
            changed=finite_array(self.changed, (count,), "changed", np.bool_),
            grown=finite_array(self.grown, (None,), "grown", np.int64),
            active=finite_array(self.active, (None,), "active", np.int64),
            ring=finite_array(self.ring, (None,), "ring", np.int64),
        )

    def __len__(self) -> int:
        return len(self.slots)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return dict(self.figures)


def empty_region(header: Header, figures: dict[str, Any]) -> Region:
    """Return the region of a frame that changes nothing."""
    none, never = np.empty(0, np.int64), np.empty(0, np.bool_)
    values, places = np.empty(0), np.empty((0, 3))
    return Region(
        header, none, never, none, values, places, values, places, never, none, none, none, 0,
        figures,
    )  # fmt: skip


def region_cloud(world: World, region: Region) -> MassCloud:
    """Return the points of a region, of equal mass: each stands for the surface of a voxel."""
    count = len(region)
    mass = np.full(count, 1.0 / count)
    return MassCloud(world.voxels.place[region.slots], mass, world.unit, region.header)


def region_nodes(world: World, region: Region) -> Nodes:
    """Return the nodes of a region: the active, then the fixed ones around them."""
    graph = world.graph
    active = region.active.tolist()
    outer = graph.neighbours([*active, *region.ring.tolist()])
    fixed = sorted({*region.ring.tolist(), *outer})
    ids = np.array([*active, *fixed], dtype=np.int64)
    nodes = [graph.nodes[name] for name in ids.tolist()]
    row = {int(name): k for k, name in enumerate(ids)}
    beyond = graph.pieces_beyond(fixed, set(active), _SEARCH)
    links = [
        (row[name], row[other])
        for name in fixed
        for other in sorted(graph.nodes[name].links)
        if other in row and other not in region.active and row[name] < row[other]
    ]
    mass = np.array([node.mass for node in nodes])
    return Nodes(
        positions=np.array([node.position for node in nodes]).reshape(-1, 3),
        mass=mass / mass.sum() if len(mass) else mass,
        potentials=np.array([node.potential for node in nodes]),
        ids=ids,
        links=np.array(links, dtype=np.int64).reshape(-1, 2),
        settled=np.ones(len(nodes), dtype=bool),
        scale=np.array([node.scale for node in nodes]),
        fixed=np.arange(len(nodes)) >= len(active),
        beyond=np.array([-1] * len(active) + [beyond[name] for name in fixed], dtype=np.int64),
        header=region.header,
    )
