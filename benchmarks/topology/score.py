"""How wrong is a skeleton: counts that differ, distances to the truth, radius error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from benchmarks.topology.solid import Floats, Ints, Truth, graph_counts


@dataclass(frozen=True)
class Score:
    """Errors and distances of one result.

    Distances are in percent of the truth's diagonal, ``to_truth`` from the result to the truth and
    ``from_truth`` the other way; `radius_error` is the mean relative error in percent. What cannot
    be known is None.
    """

    errors: int
    components: int
    cycles: int
    leaves: int
    delta_components: int
    delta_cycles: int
    delta_leaves: int
    mean_to_truth: float | None = None
    mean_from_truth: float | None = None
    hausdorff_to_truth: float | None = None
    hausdorff_from_truth: float | None = None
    radius_error: float | None = None


def densify(
    nodes: Floats, edges: Ints, step: float, values: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return points along the edges no further apart than `step`, and values interpolated there.

    Every edge counts by its length: its points stand at the middles of equal parts, and nodes
    without an edge stand for themselves. `values` (K,) default to zero.
    """
    values = np.zeros(len(nodes)) if values is None else values
    alone = np.setdiff1d(np.arange(len(nodes)), edges.ravel())
    points, carried = [nodes[alone]], [values[alone]]
    for i, j in edges:
        count = max(1, int(np.ceil(np.linalg.norm(nodes[i] - nodes[j]) / step)))
        part = (np.arange(count) + 0.5) / count
        points.append(np.outer(1 - part, nodes[i]) + np.outer(part, nodes[j]))
        carried.append((1 - part) * values[i] + part * values[j])
    return np.concatenate(points), np.concatenate(carried)


def checked_graph(nodes: ArrayLike, edges: ArrayLike) -> tuple[Floats, Ints]:
    """Return the graph as arrays, each edge once.

    Raises
    ------
    ValueError
        If a node is not finite, or an edge is a self-loop or names no node.
    """
    places: NDArray[np.float64] = np.asarray(nodes, dtype=np.float64).reshape(-1, 3)
    pairs: NDArray[np.int64] = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
    if not np.isfinite(places).all():
        raise ValueError("the skeleton has nodes that are not finite")
    if len(pairs) and (pairs.min() < 0 or pairs.max() >= len(places)):
        raise ValueError(f"the skeleton has edges to nodes outside 0..{len(places) - 1}")
    if np.any(pairs[:, 0] == pairs[:, 1]):
        raise ValueError("the skeleton has edges from a node to itself")
    return places, np.unique(np.sort(pairs, axis=1), axis=0)


def _ends(nodes: Floats, edges: Ints) -> Floats:
    """Nodes are part of the curve too: the furthest point is often a leaf."""
    return nodes[np.unique(edges)] if len(edges) else nodes


def score(nodes: ArrayLike, edges: ArrayLike, radius: ArrayLike | None, truth: Truth) -> Score:
    """Compare a skeleton, nodes (K, 3), edges (E, 2) and radius (K,) or None, with the truth."""
    places, pairs = checked_graph(nodes, edges)
    components, cycles, leaves = graph_counts(len(places), pairs)
    deltas = (
        components - truth.components,
        cycles - truth.cycles,
        leaves - truth.leaves,
    )
    counted = deltas if truth.count_leaves else deltas[:2]
    counts = (sum(map(abs, counted)), components, cycles, leaves, *deltas)
    if not len(truth.nodes) or not len(places):
        return Score(*counts)
    step = truth.diagonal / 1000
    mine, _ = densify(places, pairs, step)
    true, true_radius = densify(truth.nodes, truth.edges, step, truth.radius)
    tree = cKDTree(true)
    forth, back = tree.query(mine)[0], cKDTree(mine).query(true)[0]
    far = tree.query(_ends(places, pairs))[0].max()
    back_far = cKDTree(mine).query(_ends(truth.nodes, truth.edges))[0].max()
    percent = 100.0 / truth.diagonal
    error = None
    if radius is not None and truth.radius is not None:
        expected = true_radius[tree.query(places)[1]]
        found = np.asarray(radius, dtype=np.float64)
        error = float(100 * np.mean(np.abs(found - expected) / expected))
    return Score(
        *counts,
        mean_to_truth=float(percent * forth.mean()),
        mean_from_truth=float(percent * back.mean()),
        hausdorff_to_truth=float(percent * max(forth.max(), far)),
        hausdorff_from_truth=float(percent * max(back.max(), back_far)),
        radius_error=error,
    )


def failed(truth: Truth) -> Score:
    """Return the score of a method that gave nothing: everything that is there is missing."""
    return score(np.zeros((0, 3)), np.zeros((0, 2)), None, truth)
