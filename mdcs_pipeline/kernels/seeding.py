"""First candidates for skeleton nodes, chosen among the points (Algorithm 1, line 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.farthest import farthest_points

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def random_points(count: int, chosen: int, seed: int) -> IntArray:
    """Return `chosen` distinct indices below `count`, drawn evenly and sorted."""
    rng = np.random.default_rng(seed)
    return np.sort(rng.choice(count, chosen, replace=False))


def spread_points(
    points: FloatArray,
    chosen: int,
    seed: int,
    scale: FloatArray | None = None,
    least: float = 0.0,
) -> IntArray:
    """Return indices by farthest-point sampling, from a random first one.

    Parameters
    ----------
    points : (n, 3) float64
    chosen : int
        Most that are chosen.
    seed : int
        Chooses the first.
    scale : (n,) float64, optional
        Unit of each point's distances; 1 when absent.
    least : float
        No more are chosen once every point has one within this many of its units.

    Returns
    -------
    (k,) int64
    """
    first = int(np.random.default_rng(seed).integers(len(points)))
    unit = np.ones(len(points)) if scale is None else scale
    found = farthest_points(points, unit, chosen, least, first)
    return np.asarray(found, dtype=np.int64)
