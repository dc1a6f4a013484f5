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


def spread_points(points: FloatArray, chosen: int, seed: int) -> IntArray:
    """Return `chosen` indices by farthest-point sampling, from a random first one."""
    first = int(np.random.default_rng(seed).integers(len(points)))
    return np.asarray(farthest_points(points, chosen, first), dtype=np.int64)
