"""Spurs: ends that do not leave the thickness of what they stand on, or that nothing covers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.branches import split_branches
from mdcs_pipeline.kernels.ends import End

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def shed_spurs(
    nodes: FloatArray, scale: FloatArray, pairs: IntArray, ends: list[End], length: float
) -> IntArray:
    """Return which node each node becomes when spurs shrink into their junctions, shortest first.

    A leaf on a junction is a spur when its points reach less than `length` local radii from
    the junction: they are the junction's own surface then. Where spurs have left a junction
    with two branches, it is none any more, and its last leaf stays.

    Parameters
    ----------
    nodes : (m, 3) float64
    scale : (m,) float64
        Local radius.
    pairs : (E, 2) int64
    ends : list of End
    length : float

    Returns
    -------
    (m,) int64
        Itself for all but spurs.
    """
    into = np.arange(len(nodes))
    degree = np.bincount(pairs.ravel(), minlength=len(nodes))
    spurs = []
    for end in ends:
        mine = pairs[(pairs == end.node).any(axis=1)]
        if len(mine) != 1:
            continue
        root = int(mine[0].sum() - end.node)
        reach = float(np.linalg.norm(nodes[end.node] - nodes[root])) + max(end.extent, 0.0)
        if degree[root] > 2 and reach < length * scale[root]:
            spurs.append((reach / scale[root], end.node, root))
    for _, leaf, root in sorted(spurs):
        if degree[root] > 2:
            into[leaf] = root
            degree[root] -= 1
    return into


def shed_strays(scale: FloatArray, counts: IntArray, pairs: IntArray, cover: float) -> IntArray:
    """Return which node each node becomes when limbs of stray points shrink into their junctions.

    A limb is as densely sampled as what it stands on, or nearly so: density changes along a
    scan, but not at a junction. One whose nodes all have less than `cover` of the junction's
    points on a piece of surface of their own size, n_i / r_i², is a string of outliers.

    Parameters
    ----------
    scale : (m,) float64
        Local radius.
    counts : (m,) int64
        Points of each node.
    pairs : (E, 2) int64
    cover : float

    Returns
    -------
    (m,) int64
        Itself for all but strays.
    """
    into = np.arange(len(scale))
    degree = np.bincount(pairs.ravel(), minlength=len(scale))
    covered = counts / scale**2
    for branch in split_branches(len(scale), pairs):
        for root, limb in ((branch[0], branch[1:]), (branch[-1], branch[:-1])):
            leads_out = degree[root] > 2 and (degree[limb] == 1).any()
            if leads_out and covered[limb].max() < cover * covered[root]:
                into[limb] = root
    return into
