"""Merging of nodes that are not skeletal (section IV.B)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.grid import grid_of
from mdcs_pipeline.kernels.compiled.pairing import closest_disjoint, near_pairs
from mdcs_pipeline.kernels.links import unique_pairs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Merged(NamedTuple):
    """Nodes after a round of merging.

    Parameters
    ----------
    positions : (k, 3) float64
    mass : (k,) float64
    kept : (k,) int64
        Index, before the round, of the node whose name lives on.
    into : (m,) int64
        Index, after the round, of what became of each node.
    """

    positions: FloatArray
    mass: FloatArray
    kept: IntArray
    into: IntArray


def merging_pairs(
    nodes: FloatArray, mass: FloatArray, skeletal: BoolArray, pairs: IntArray
) -> IntArray:
    """Return disjoint pairs: by rising mass, each unsettled node with its nearest partner.

    Parameters
    ----------
    nodes : (m, 3) float64
    mass : (m,) float64
    skeletal : (m,) bool
    pairs : (E, 2) int64
        Connections.

    Returns
    -------
    (P, 2) int64
        The unsettled node first.
    """
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    length = np.linalg.norm(nodes[ends[:, 0]] - nodes[ends[:, 1]], axis=1)
    ends = ends[np.lexsort((ends[:, 1], length, ends[:, 0]))]
    start = np.searchsorted(ends[:, 0], np.arange(len(nodes) + 1))
    free = np.ones(len(nodes), dtype=bool)
    chosen = []
    unsettled = np.flatnonzero(~skeletal)
    for i in unsettled[np.argsort(mass[unsettled], kind="stable")]:
        if not free[i]:
            continue
        partners = ends[start[i] : start[i + 1], 1]
        # "x_j is the nearest neighbour of x_i": a taken one is not passed over for the next.
        if len(partners) and free[partners[0]]:
            free[i] = free[partners[0]] = False
            chosen.append((i, partners[0]))
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)


def merge(nodes: FloatArray, mass: FloatArray, pairs: IntArray) -> Merged:
    """Merge each pair into its first node: masses add, the place is their centre of mass.

    Parameters
    ----------
    nodes : (m, 3) float64
    mass : (m,) float64
    pairs : (P, 2) int64
        Disjoint.

    Returns
    -------
    Merged
    """
    positions, sums = nodes.copy(), mass.copy()
    first, second = pairs[:, 0], pairs[:, 1]
    sums[first] = mass[first] + mass[second]
    # Two nodes that carry nothing meet half-way.
    share = np.where(sums[first] > 0, mass[second] / np.where(sums[first] > 0, sums[first], 1), 0.5)
    positions[first] += share[:, None] * (nodes[second] - nodes[first])
    alive = np.ones(len(nodes), dtype=bool)
    alive[second] = False
    kept = np.flatnonzero(alive)
    into = np.full(len(nodes), -1, dtype=np.int64)
    into[kept] = np.arange(len(kept))
    into[second] = into[first]
    return Merged(positions[kept], sums[kept], kept, into)


def inherited(pairs: IntArray, into: IntArray) -> IntArray:
    """Return the connections that a merge leaves: those of both nodes, between what they became."""
    return unique_pairs(into[pairs])


def close_pairs(
    nodes: FloatArray,
    scale: FloatArray,
    spacing: float,
    fixed: BoolArray | None = None,
    widths: FloatArray | None = None,
) -> IntArray:
    """Return disjoint pairs nearer than `spacing` · min(r_i, r_k), closest in radii first.

    Parameters
    ----------
    nodes : (m, 3) float64
    scale : (m,) float64
        r_i.
    spacing : float
    fixed : (m,) bool, optional
        Nodes that only take others in: of two fixed ones neither goes, and in a pair with
        another the fixed one comes first.
    widths : (m,) float64, optional
        Factor to `spacing` for each node; of a pair the larger counts. 1 when absent.

    Returns
    -------
    (P, 2) int64
    """
    count = len(nodes)
    unmoved = np.zeros(count, dtype=bool) if fixed is None else fixed
    factor = np.ones(count) if widths is None else widths
    grid = grid_of(nodes, spacing * float(np.median(scale)))
    near, ratio = near_pairs(grid, scale, factor, unmoved, spacing)
    chosen = closest_disjoint(near, ratio, count)
    order = np.lexsort((near[chosen, 1], near[chosen, 0], ratio[chosen]))
    return np.asarray(near[chosen[order]], dtype=np.int64)
