"""Is the ground truth true? The solid's own topology, and the room between its limbs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from benchmarks.topology.solid import Shape, cone_distance, cones


def inside_grid(shape: Shape, cells: int) -> NDArray[np.bool_]:
    """Return which points of a grid, `cells` along the longest side, lie in the solid."""
    low, high = shape.box
    step = (high - low).max() / cells
    # An irrational offset keeps grid planes off the solid's own planes of symmetry.
    axes = [
        np.arange(a - 2.318 * step, b + 2.5 * step, step) for a, b in zip(low, high, strict=True)
    ]
    solid = np.zeros([len(a) for a in axes], dtype=bool)
    for cone, (i, j) in zip(cones(shape), shape.edges, strict=True):
        ends, reach = shape.nodes[[i, j]], shape.balls[[i, j]].max() + step
        near = [
            slice(*np.searchsorted(a, (ends[:, k].min() - reach, ends[:, k].max() + reach)))
            for k, a in enumerate(axes)
        ]
        mesh = np.meshgrid(*[a[s] for a, s in zip(axes, near, strict=True)], indexing="ij")
        points = np.stack([m.ravel() for m in mesh], axis=1)
        solid[tuple(near)] |= (cone_distance(cone, points) < 0).reshape(mesh[0].shape)
    return solid


def solid_counts(shape: Shape, cells: int = 200) -> tuple[int, int, int]:
    """Return components, loops and cavities of the solid, from its cubes on a grid.

    Loops follow from the Euler characteristic V − E + F − C of the cubical complex of grid points
    (neighbours by faces): it equals components − loops + cavities.
    """
    solid = inside_grid(shape, cells)
    euler = 0
    for spans in np.ndindex(2, 2, 2):
        cell = solid
        for axis, span in enumerate(spans):
            if span:
                size = cell.shape[axis]
                cell = np.take(cell, np.arange(size - 1), axis) & np.take(
                    cell, np.arange(1, size), axis
                )
        euler += (-1) ** sum(spans) * int(np.count_nonzero(cell))
    components = ndimage.label(solid)[1]
    cavities = ndimage.label(~solid, ndimage.generate_binary_structure(3, 3))[1] - 1
    return components, components + cavities - euler, cavities


def clearance(shape: Shape) -> float:
    """Least gap between limbs that the graph does not join nearby, in radii of the thinner.

    Two places on the graph count as separate when the way between them along the graph is longer
    than the straight way by half and by six of their radii; near a junction limbs must merge.
    """
    places, radii, owners = [], [], []
    for i, j in shape.edges:
        length = np.linalg.norm(shape.nodes[j] - shape.nodes[i])
        count = 2 + int(length / (0.5 * min(shape.balls[i], shape.balls[j])))
        part = np.linspace(0, 1, count)
        places.append(np.outer(1 - part, shape.nodes[i]) + np.outer(part, shape.nodes[j]))
        radii.append((1 - part) * shape.balls[i] + part * shape.balls[j])
        owners.append((i, j, part * length, length))
    points, sizes = np.concatenate(places), np.concatenate(radii)
    way = _graph_way(shape, owners)
    gap = np.linalg.norm(points[:, None] - points[None], axis=2)
    both = sizes[:, None] + sizes[None]
    separate = (way > 1.5 * gap) & (way > gap + 3 * both)
    room = (gap - both) / np.minimum(sizes[:, None], sizes[None])
    return float(room[separate].min()) if separate.any() else float("inf")


def _graph_way(
    shape: Shape, owners: list[tuple[int, int, NDArray[np.float64], float]]
) -> NDArray[np.float64]:
    """Path length along the graph between all sampled places."""
    first, second = shape.edges.T
    length = np.linalg.norm(shape.nodes[first] - shape.nodes[second], axis=1)
    size = len(shape.nodes)
    node_way = dijkstra(coo_array((length, (first, second)), shape=(size, size)), directed=False)
    start = np.concatenate([np.full(len(p), i) for i, _, p, _ in owners])
    end = np.concatenate([np.full(len(p), j) for _, j, p, _ in owners])
    from_start = np.concatenate([p for _, _, p, _ in owners])
    from_end = np.concatenate([full - p for _, _, p, full in owners])
    edge = np.concatenate([np.full(len(o[2]), k) for k, o in enumerate(owners)])
    best = np.full((len(start), len(start)), np.inf)
    for ends_a, past_a in ((start, from_start), (end, from_end)):
        for ends_b, past_b in ((start, from_start), (end, from_end)):
            best = np.minimum(
                best, past_a[:, None] + node_way[np.ix_(ends_a, ends_b)] + past_b[None]
            )
    same = edge[:, None] == edge[None]
    return np.where(same, np.abs(from_start[:, None] - from_start[None]), best)


def spur_reach(shape: Shape) -> float:
    """Least distance by which a leaf's ball sticks out of the other branches, in its own radii."""
    degree = np.bincount(shape.edges.ravel(), minlength=len(shape.nodes))
    frames = cones(shape)
    least = float("inf")
    for leaf in np.flatnonzero(degree == 1):
        own = shape.branches[np.flatnonzero((shape.edges == leaf).any(axis=1))[0]]
        others = [f for f, branch in zip(frames, shape.branches, strict=True) if branch != own]
        if others:
            gap = min(float(cone_distance(f, shape.nodes[[leaf]])[0]) for f in others)
            least = min(least, gap / float(shape.balls[leaf]) + 1.0)
    return least
