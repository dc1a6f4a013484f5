"""A scene as plain arrays and plain values, and back: what a checkpoint holds of it."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.clouds import UnitFrame
from mdcs_pipeline.scene.graph import Chain, SceneGraph, SceneNode
from mdcs_pipeline.scene.state import Scene, World
from mdcs_pipeline.scene.voxels import VoxelMap

Arrays = dict[str, NDArray[Any]]

_NUMBERS = ("mass", "share", "potential", "scale", "radius")


def scene_arrays(scene: Scene) -> tuple[dict[str, Any], Arrays]:
    """Return a scene's plain values and its arrays.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    values : dict
        Fit for JSON.
    arrays : dict of array
    """
    values: dict[str, Any] = {
        "number": scene.number,
        "frames": scene.frames,
        "frame_id": scene.frame_id,
        "stamp_ns": scene.stamp_ns,
        "drain": scene.drain,
        "hits": [[number, stamp] for number, stamp, _ in scene.hits],
        "world": None,
    }
    arrays: Arrays = {
        "changed": scene.changed,
        "vacated": np.array(sorted(scene.vacated), dtype=np.int64),
        "overdue": np.array(sorted(scene.overdue), dtype=np.int64),
        "waiting_at": np.array(list(scene.waiting), dtype=np.int64),
        **_ragged("waiting", list(scene.waiting.values())),
        **_ragged("hits", [slots for _, _, slots in scene.hits]),
    }
    if scene.world is not None:
        graph = scene.world.graph
        values["world"] = {
            "size": scene.world.voxels.size,
            "cell": graph.cell,
            "next_id": graph.next_id,
            "largest_scale": graph.largest_scale,
            "length": scene.world.unit.length,
        }
        arrays["centre"], arrays["axes"] = scene.world.unit.centre, scene.world.unit.axes
        arrays.update({f"voxel_{k}": v for k, v in scene.world.voxels.arrays().items()})
        arrays.update(_graph_arrays(graph))
    return values, arrays


def _ragged(name: str, rows: list[NDArray[np.int64]]) -> Arrays:
    """Return rows of different lengths as one array and where each ends."""
    return {
        f"{name}_rows": np.concatenate([np.empty(0, np.int64), *rows]),
        f"{name}_ends": np.cumsum([len(row) for row in rows], dtype=np.int64),
    }


def _rows(name: str, arrays: Arrays) -> list[NDArray[np.int64]]:
    ends = arrays[f"{name}_ends"].tolist()
    starts = [0, *ends][: len(ends)]
    held = arrays[f"{name}_rows"]
    return [held[a:b].copy() for a, b in zip(starts, ends, strict=True)]


def _graph_arrays(graph: SceneGraph) -> Arrays:
    nodes, chains = list(graph.nodes.values()), list(graph.chains.values())
    arrays: Arrays = {
        "node_ids": np.array(list(graph.nodes), dtype=np.int64),
        "node_position": np.array([node.position for node in nodes]).reshape(-1, 3),
        "node_gained": np.array([node.gained for node in nodes], dtype=np.int64),
        "chain_pairs": np.array(list(graph.chains), dtype=np.int64).reshape(-1, 2),
        "chain_positions": np.concatenate([np.empty((0, 3)), *(c.positions for c in chains)]),
        "chain_mass": np.concatenate([np.empty(0), *(c.mass for c in chains)]),
        "chain_radius": np.concatenate([np.empty(0), *(c.radius for c in chains)]),
        **_ragged("node_cells", [node.cells for node in nodes]),
        **_ragged("node_near", [np.array(node.near, dtype=np.int64) for node in nodes]),
        **_ragged("chain_ids", [chain.ids for chain in chains]),
    }
    for name in _NUMBERS:
        arrays[f"node_{name}"] = np.array([getattr(node, name) for node in nodes], np.float64)
    return arrays


def scene_from_arrays(values: dict[str, Any], arrays: Arrays) -> Scene:
    """Return the scene that `scene_arrays` was given; further frames change both alike.

    Raises
    ------
    KeyError, ValueError, IndexError, TypeError
        If something is missing or does not fit.
    """
    hits = zip(values["hits"], _rows("hits", arrays), strict=True)
    scene = Scene(
        number=int(values["number"]),
        frames=int(values["frames"]),
        frame_id=values["frame_id"],
        stamp_ns=int(values["stamp_ns"]),
        changed=arrays["changed"].astype(np.int64),
        vacated=set(arrays["vacated"].tolist()),
        overdue=set(arrays["overdue"].tolist()),
        waiting=dict(zip(arrays["waiting_at"].tolist(), _rows("waiting", arrays), strict=True)),
        hits=deque((int(number), int(stamp), slots) for (number, stamp), slots in hits),
        drain=bool(values["drain"]),
    )
    held = values["world"]
    if held is None:
        return scene
    unit = UnitFrame(arrays["centre"], arrays["axes"], float(held["length"]))
    parts = {k.removeprefix("voxel_"): v for k, v in arrays.items() if k.startswith("voxel_")}
    voxels = VoxelMap.from_arrays(float(held["size"]), parts)
    scene.world = World(unit, voxels, _graph(held, arrays))
    return scene


def _graph(held: dict[str, Any], arrays: Arrays) -> SceneGraph:
    graph = SceneGraph(float(held["cell"]))
    numbers = [arrays[f"node_{name}"].tolist() for name in _NUMBERS]
    rows = zip(
        arrays["node_ids"].tolist(),
        arrays["node_position"],
        *numbers,
        arrays["node_gained"].tolist(),
        _rows("node_cells", arrays),
        _rows("node_near", arrays),
        strict=True,
    )
    for name, position, mass, share, potential, scale, radius, gained, cells, near in rows:
        node = SceneNode(
            position=position.copy(),
            mass=mass,
            share=share,
            potential=potential,
            scale=scale,
            radius=radius,
            cells=cells,
            gained=gained,
            near=tuple(near.tolist()),
        )
        graph.put(name, node)
    start = 0
    for (a, b), ids in zip(arrays["chain_pairs"].tolist(), _rows("chain_ids", arrays), strict=True):
        part = slice(start, start + len(ids))
        start += len(ids)
        columns = (arrays[f"chain_{name}"][part].copy() for name in ("positions", "mass", "radius"))
        graph.join((a, b), Chain(ids, *columns))
    graph.next_id = int(held["next_id"])
    graph.largest_scale = float(held["largest_scale"])
    return graph
