"""Farthest-point sampling."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.boxes import box_bounds, box_order
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

_BOX = 32


@njit(cache=True, nogil=True)
def farthest_points(
    points: FloatArray, scale: FloatArray, chosen: int, least: float, first: int
) -> IntArray:
    """Return indices, each the point farthest from those before it, in its own scale.

    It ends with `chosen` of them, or when every point has one within `least` of its scale.
    Of points equally far the first is taken. Points are kept in boxes: a box whose farthest
    point is nearer to what it has than any of it is to the new one is passed over.
    """
    n = len(points)
    order = box_order(points, _BOX)
    places, sizes = points[order], scale[order]
    low, high, span = box_bounds(places, sizes, _BOX)
    nearest = np.full(n, np.inf)
    # Of each box: its farthest point, and how far that is.
    peak, top = np.zeros(len(low), np.int64), np.full(len(low), np.inf)
    result = np.empty(chosen, np.int64)
    at, count = first, 0
    while count < chosen:
        result[count] = at
        count += 1
        y = points[at]
        far, at = -1.0, n
        for b in range(len(low)):
            square = 0.0
            for a in range(3):
                apart = max(max(low[b, a] - y[a], y[a] - high[b, a]), 0.0)
                square += apart * apart
            # A little less than the bound: round-off must not pass over a box.
            if square * (1.0 - 1e-12) < top[b] * span[b, 1] * span[b, 1]:
                _update_box(b, places, sizes, order, y, nearest, peak, top)
            if top[b] > far or (top[b] == far and peak[b] < at):
                far, at = top[b], peak[b]
        if far <= least * least:
            break
    return result[:count].copy()


@njit(cache=True, nogil=True)
def _update_box(
    b: int,
    places: FloatArray,
    sizes: FloatArray,
    order: IntArray,
    y: FloatArray,
    nearest: FloatArray,
    peak: IntArray,
    top: FloatArray,
) -> None:
    """Lower the squared distances of a box's points to a new one, and find its farthest."""
    far, at = -1.0, len(order)
    for j in range(b * _BOX, min(len(order), (b + 1) * _BOX)):
        d0, d1, d2 = places[j, 0] - y[0], places[j, 1] - y[1], places[j, 2] - y[2]
        square = (d0 * d0 + d1 * d1 + d2 * d2) / (sizes[j] * sizes[j])
        nearest[j] = min(nearest[j], square)
        if nearest[j] > far or (nearest[j] == far and order[j] < at):
            far, at = nearest[j], order[j]
    peak[b], top[b] = at, far
