"""A scene's whole skeleton."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mdcs_pipeline.header import Header
from mdcs_pipeline.skeleton import Skeleton

if TYPE_CHECKING:
    from mdcs_pipeline.scene.state import Scene


def assemble(scene: Scene) -> Skeleton:
    """Return all nodes and edges of a scene, in input units.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Skeleton
        Nodes by rising id: those of the graph and those inserted into its edges. Without any
        node it is empty.
    """
    header = Header(scene.frame_id or "", max(scene.stamp_ns, 0), max(scene.frames - 1, 0))
    if scene.world is None or not scene.world.graph.nodes:
        none, nobody = np.empty(0), np.empty(0, np.int64)
        return Skeleton(
            np.empty((0, 3)), np.empty((0, 2), np.int64), none, none, nobody, header=header
        )
    graph, unit = scene.world.graph, scene.world.unit
    nodes = list(graph.nodes.items())
    chains = list(graph.chains.items())
    ids = np.concatenate([[name for name, _ in nodes], *(c.ids for _, c in chains)])
    places = np.concatenate(
        [[node.position for _, node in nodes], *(c.positions for _, c in chains)]
    )
    mass = np.concatenate([[node.share for _, node in nodes], *(c.mass for _, c in chains)])
    radius = np.concatenate([[node.radius for _, node in nodes], *(c.radius for _, c in chains)])
    order = np.argsort(ids, kind="stable")
    row = {int(name): k for k, name in enumerate(ids[order])}
    edges = [
        sorted((row[a], row[b]))
        for (i, j), chain in chains
        for a, b in pairwise([i, *chain.ids.tolist(), j])
    ]
    edges.sort()
    return Skeleton(
        nodes=unit.from_unit(places[order]),
        edges=np.array(edges, dtype=np.int64).reshape(-1, 2),
        mass=mass[order] / mass[order].sum(),
        radius=radius[order] * unit.length,
        node_ids=ids[order],
        header=header,
        diagnostics={
            "scene": scene.number,
            "frames": scene.frames,
            "voxels": len(scene.world.voxels),
            "rough_nodes": len(nodes),
        },
    )
