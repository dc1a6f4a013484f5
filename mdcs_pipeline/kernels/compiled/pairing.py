"""Pairs of nodes that are close in their own scales, and the closest of them that are disjoint."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.grid import Grid, within
from mdcs_pipeline.kernels.compiled.types import BoolArray, FloatArray, IntArray


@njit(cache=True, nogil=True)
def near_pairs(
    grid: Grid,
    scale: FloatArray,
    widths: FloatArray,
    fixed: BoolArray,
    spacing: float,
) -> tuple[IntArray, FloatArray]:
    """Return the pairs with |x_i − x_k| / (min(r_i, r_k) max(w_i, w_k)) < `spacing`, and this.

    Parameters
    ----------
    grid : Grid
        Of the nodes.
    scale, widths : (m,) float64
        r_i and w_i.
    fixed : (m,) bool
        Of two such nodes there is no pair; one comes first in a pair with another.
    spacing : float

    Returns
    -------
    pairs : (P, 2) int64
        i < k but for fixed ones; in no order.
    ratio : (P,) float64
    """
    m, widest = len(grid.points), widths.max()
    found = np.empty(m, np.int64)
    pairs, ratio = np.empty((4 * m, 2), np.int64), np.empty(4 * m)
    count = 0
    for at in range(m):
        i = grid.order[at]
        # A little more than the bound: round-off must not lose a pair.
        reach = spacing * scale[i] * widest * (1.0 + 1e-9)
        for other in found[: within(grid, grid.points[at], reach, found)]:
            k = grid.order[other]
            # Each pair is met from its smaller node.
            if scale[k] < scale[i] or (scale[k] == scale[i] and k <= i) or (fixed[i] and fixed[k]):
                continue
            square = 0.0
            for a in range(3):
                step = grid.points[at, a] - grid.points[other, a]
                square += step * step
            one = np.sqrt(square) / scale[i] / max(widths[i], widths[k])
            if one >= spacing:
                continue
            if count == len(pairs):
                more, wider = np.empty((2 * count, 2), np.int64), np.empty(2 * count)
                more[:count], wider[:count] = pairs, ratio
                pairs, ratio = more, wider
            first, second = min(i, k), max(i, k)
            if fixed[second]:
                first, second = second, first
            pairs[count, 0], pairs[count, 1], ratio[count] = first, second, one
            count += 1
    return pairs[:count], ratio[:count]


@njit(cache=True, nogil=True)
def _before(pairs: IntArray, ratio: FloatArray, a: Any, b: Any) -> bool:
    """Whether pair a is closer than pair b, or as close and named before it."""
    if ratio[a] != ratio[b]:
        return bool(ratio[a] < ratio[b])
    if pairs[a, 0] != pairs[b, 0]:
        return bool(pairs[a, 0] < pairs[b, 0])
    return bool(pairs[a, 1] < pairs[b, 1])


@njit(cache=True, nogil=True)
def closest_disjoint(pairs: IntArray, ratio: FloatArray, count: int) -> IntArray:
    """Return the pairs that are left when the closest is taken again and again, each node once.

    A pair that is the closest of both its nodes is taken whatever others do: no sorting.

    Parameters
    ----------
    pairs : (P, 2) int64
    ratio : (P,) float64
    count : int
        Number of nodes.

    Returns
    -------
    (k,) int64
        Which pairs.
    """
    left = np.arange(len(pairs))
    free = np.ones(count, np.bool_)
    best = np.empty(count, np.int64)
    chosen, taken = np.empty(count // 2 + 1, np.int64), 0
    while len(left) > 0:
        best[:] = -1
        for e in left:
            for a in range(2):
                i = pairs[e, a]
                if best[i] < 0 or _before(pairs, ratio, e, best[i]):
                    best[i] = e
        for e in left:
            i, k = pairs[e, 0], pairs[e, 1]
            if best[i] == e and best[k] == e:
                free[i] = free[k] = False
                chosen[taken] = e
                taken += 1
        kept = 0
        for e in left:
            left[kept] = e
            kept += free[pairs[e, 0]] and free[pairs[e, 1]]
        left = left[:kept]
    return chosen[:taken].copy()
