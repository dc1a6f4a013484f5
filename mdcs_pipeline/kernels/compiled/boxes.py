"""Points in boxes of equal count: what lies together is worked on together."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.selecting import select
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def box_order(points: FloatArray, size: int) -> IntArray:
    """Return an order of the points in which each run of `size` of them lies in a small box.

    Halved along the longer side until a box is full; all but the last hold exactly `size`.
    """
    n = len(points)
    order = np.arange(n)
    keys = np.empty(n)
    firsts = np.empty(64, np.int64)
    lasts = np.empty(64, np.int64)
    firsts[0], lasts[0] = 0, n
    depth = 1
    low, high = np.empty(3), np.empty(3)
    while depth > 0:
        depth -= 1
        first, last = firsts[depth], lasts[depth]
        if last - first <= size:
            continue
        low[:], high[:] = np.inf, -np.inf
        for k in range(first, last):
            for a in range(3):
                value = points[order[k], a]
                low[a] = min(low[a], value)
                high[a] = max(high[a], value)
        axis = np.argmax(high - low)
        for k in range(first, last):
            keys[k] = points[order[k], axis]
        middle = first + ((last - first + size - 1) // size // 2) * size
        select(keys, first, last, middle, order)
        firsts[depth], lasts[depth] = first, middle
        firsts[depth + 1], lasts[depth + 1] = middle, last
        depth += 2
    return order


@njit(cache=True, nogil=True)
def box_bounds(
    points: FloatArray, weight: FloatArray, size: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lower and upper corners, (B, 3), and least and largest weight, (B, 2), of the runs."""
    n = len(points)
    count = (n + size - 1) // size
    low = np.full((count, 3), np.inf)
    high = np.full((count, 3), -np.inf)
    span = np.empty((count, 2))
    for b in range(count):
        first, last = b * size, min(n, (b + 1) * size)
        span[b, 0] = span[b, 1] = weight[first]
        for j in range(first, last):
            for a in range(3):
                low[b, a] = min(low[b, a], points[j, a])
                high[b, a] = max(high[b, a], points[j, a])
            span[b, 0] = min(span[b, 0], weight[j])
            span[b, 1] = max(span[b, 1], weight[j])
    return low, high, span
