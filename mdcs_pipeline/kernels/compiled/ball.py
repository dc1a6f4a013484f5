"""The part of a graph within some way of one of its points."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.heap import heap_drop, heap_push
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def ball_around(
    indptr: IntArray,
    indices: IntArray,
    lengths: FloatArray,
    centre: int,
    radius: float,
    place: IntArray,
) -> tuple[IntArray, FloatArray, bool]:
    """Return the points within `radius` of one, nearest first (Dijkstra).

    Parameters
    ----------
    place : (n,) int64
        All −1; on return the number of each point in the ball, for the caller to clear.

    Returns
    -------
    ball : (k,) int64
    away : (k,) float64
        Their distances.
    whole : bool
        Whether no link leads out of it.
    """
    n = len(indptr) - 1
    distance = np.full(n, np.inf)
    ball, away = np.empty(n, np.int64), np.empty(n)
    keys, values = np.empty(len(indices) + 1), np.empty(len(indices) + 1, np.int64)
    distance[centre] = 0.0
    size = heap_push(keys, values, 0, 0.0, centre)
    count, whole = 0, True
    while size > 0:
        near, v = keys[0], values[0]
        size = heap_drop(keys, values, size)
        if near > distance[v]:
            continue
        place[v] = count
        ball[count], away[count] = v, near
        count += 1
        for e in range(indptr[v], indptr[v + 1]):
            u, far = indices[e], near + lengths[e]
            if far < distance[u]:
                if far > radius:
                    whole = False
                    continue
                distance[u] = far
                size = heap_push(keys, values, size, far, u)
    return ball[:count].copy(), away[:count].copy(), whole


@njit(cache=True, nogil=True)
def local_graph(
    indptr: IntArray, indices: IntArray, lengths: FloatArray, ball: IntArray, place: IntArray
) -> tuple[IntArray, IntArray, NDArray[np.float32]]:
    """Return the links between the points of a ball, CSR, by their numbers in it (float32)."""
    starts = np.zeros(len(ball) + 1, np.int64)
    most = 0
    for v in ball:
        most += indptr[v + 1] - indptr[v]
    ends, away = np.empty(most, np.int32), np.empty(most, np.float32)
    count = 0
    for k in range(len(ball)):
        v = ball[k]
        for e in range(indptr[v], indptr[v + 1]):
            if place[indices[e]] >= 0:
                ends[count], away[count] = place[indices[e]], lengths[e]
                count += 1
        starts[k + 1] = count
    return starts, ends[:count], away[:count]
