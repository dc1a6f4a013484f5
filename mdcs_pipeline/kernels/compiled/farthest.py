"""Farthest-point sampling."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def farthest_points(
    points: FloatArray, scale: FloatArray, chosen: int, least: float, first: int
) -> IntArray:
    """Return indices, each the point farthest from those before it, in its own scale.

    It ends with `chosen` of them, or when every point has one within `least` of its scale.
    """
    n = len(points)
    nearest = np.full(n, np.inf)
    result = np.empty(chosen, np.int64)
    at = first
    count = 0
    for c in range(chosen):
        result[c] = at
        count += 1
        y0, y1, y2 = points[at, 0], points[at, 1], points[at, 2]
        far = -1.0
        for j in range(n):
            a, b, d = points[j, 0] - y0, points[j, 1] - y1, points[j, 2] - y2
            square = (a * a + b * b + d * d) / (scale[j] * scale[j])
            if square < nearest[j]:
                nearest[j] = square
            if nearest[j] > far:
                far = nearest[j]
                at = j
        if far <= least * least:
            break
    return result[:count].copy()
