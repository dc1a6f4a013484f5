"""Bridges over holes: ends of a skeleton where the shape was cut open, not where it ends.

A limb that ends is capped: beyond its last node the surface closes in on the axis. A limb cut
by a hole is an open pipe: up to its rim the surface keeps its distance from the axis. Open
ends that face each other belong together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.cycles import neighbour_sets
from mdcs_pipeline.kernels.spanning import piece_labels

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class End(NamedTuple):
    """A leaf of a skeleton.

    Parameters
    ----------
    node : int
    place : (3,) float64
    outward : (3,) float64
        Unit vector along the limb, away from it.
    radius : float
        Median distance of the limb's last points from its axis.
    openness : float
        Median distance of the outermost points from the axis, in that radius: about 1 at the
        rim of an open pipe, less where the limb closes.
    extent : float
        How far beyond the node its limb's points reach.
    """

    node: int
    place: FloatArray
    outward: FloatArray
    radius: float
    openness: float
    extent: float


class BridgeRule(NamedTuple):
    """What is bridged.

    Parameters
    ----------
    openness : float
        Least openness of an end.
    reach : float
        Longest bridge, in the larger radius of its ends.
    facing : float
        Least cosine between an end's direction and the bridge, for two open ends.
    aim : float
        The same for an open end that meets a node of another piece.
    ratio : float
        Largest ratio of the two ends' radii.
    """

    openness: float = 0.6
    reach: float = 9.0
    facing: float = 0.5
    aim: float = 0.75
    ratio: float = 2.5


def _limb(near: list[set[int]], leaf: int, nodes: FloatArray, length: float) -> list[int]:
    """Return the nodes of the chain behind a leaf, up to a junction or `length`."""
    chain = [leaf, *near[leaf]]
    while len(near[chain[-1]]) == 2 and np.linalg.norm(nodes[chain[-1]] - nodes[leaf]) < length:
        (following,) = near[chain[-1]] - {chain[-2]}
        chain.append(following)
    return chain


def open_ends(
    nodes: FloatArray, scale: FloatArray, pairs: IntArray, points: FloatArray, owner: IntArray
) -> list[End]:
    """Return the leaves of a graph with their direction, radius and openness.

    Parameters
    ----------
    nodes : (m, 3) float64
    scale : (m,) float64
        Local radius.
    pairs : (E, 2) int64
    points : (n, 3) float64
    owner : (n,) int64
        Node of each point.

    Returns
    -------
    list of End
    """
    near = neighbour_sets(len(nodes), pairs)
    ends = []
    for leaf in np.flatnonzero([len(partners) == 1 for partners in near]).tolist():
        chain = _limb(near, leaf, nodes, 2.0 * float(scale[leaf]))
        outward = nodes[leaf] - nodes[chain[-1]]
        length = float(np.linalg.norm(outward))
        mine = points[np.isin(owner, chain[:2])] - nodes[leaf]
        if length == 0.0 or len(mine) < 4:
            continue
        outward = outward / length
        along = mine @ outward
        across = np.linalg.norm(mine - along[:, None] * outward, axis=1)
        radius = float(np.median(across))
        extent = float(np.quantile(along, 0.97))
        rim = along > extent - 0.5 * radius
        openness = float(np.median(across[rim])) / max(radius, np.finfo(float).tiny)
        ends.append(End(leaf, nodes[leaf], outward, radius, openness, extent))
    return ends


def bridges(nodes: FloatArray, pairs: IntArray, ends: list[End], rule: BridgeRule) -> IntArray:
    """Return edges that join open ends to each other, or to what they aim at.

    Two open ends are joined when each lies ahead of the other, shortest bridges first, each
    end once. An open end that is left over is joined to the nearest node ahead of it that
    belongs to another piece: where a limb was cut off at its root.

    Parameters
    ----------
    nodes : (m, 3) float64
    pairs : (E, 2) int64
    ends : list of End
    rule : BridgeRule

    Returns
    -------
    (B, 2) int64
    """
    free = {end.node: end for end in ends if end.openness >= rule.openness}
    built: list[tuple[int, int]] = []
    for _, a, b in sorted(_facing(list(free.values()), rule)):
        if a in free and b in free:
            del free[a], free[b]
            built.append((a, b))
    for end in free.values():
        piece = piece_labels(len(nodes), np.concatenate([pairs, _as_pairs(built)]))
        ahead = _ahead(end, nodes, piece != piece[end.node], rule)
        if ahead is not None:
            built.append((end.node, ahead))
    return _as_pairs(built)


def _as_pairs(built: list[tuple[int, int]]) -> IntArray:
    return np.sort(np.array(built, dtype=np.int64).reshape(-1, 2), axis=1)


def _facing(ends: list[End], rule: BridgeRule) -> list[tuple[float, int, int]]:
    """Return (length in radii over alignment, node, node) of the ends that face each other."""
    found = []
    for k, a in enumerate(ends):
        for b in ends[k + 1 :]:
            gap = b.place - a.place
            length = float(np.linalg.norm(gap))
            large, small = max(a.radius, b.radius), min(a.radius, b.radius)
            if length == 0.0 or length > rule.reach * large or large > rule.ratio * small:
                continue
            ahead = float(a.outward @ gap) / length, -float(b.outward @ gap) / length
            if min(ahead) >= rule.facing:
                found.append((length / large / (ahead[0] + ahead[1]), a.node, b.node))
    return found


def _ahead(end: End, nodes: FloatArray, allowed: NDArray[np.bool_], rule: BridgeRule) -> int | None:
    gap = nodes - end.place
    length = np.maximum(np.linalg.norm(gap, axis=1), np.finfo(float).tiny)
    cosine = gap @ end.outward / length
    fits = allowed & (cosine >= rule.aim) & (length <= rule.reach * end.radius)
    if not fits.any():
        return None
    return int(np.argmin(np.where(fits, length / np.where(fits, cosine, 1.0), np.inf)))


def stretched(nodes: FloatArray, ends: list[End]) -> FloatArray:
    """Return the nodes with each end moved out to the centre of its limb's round tip.

    A node at the end of a limb carries the limb's last stretch, and stands in the middle of
    it. The medial axis goes on, to one radius before the tip.

    Parameters
    ----------
    nodes : (m, 3) float64
    ends : list of End

    Returns
    -------
    (m, 3) float64
    """
    moved = nodes.copy()
    for end in ends:
        moved[end.node] += max(0.0, end.extent - end.radius) * end.outward
    return moved
