"""Spurs: ends that do not leave the thickness of what they stand on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
