"""Values that spread over the surface."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.heap import heap_drop, heap_push
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def spread_minimum(
    indptr: IntArray,
    indices: IntArray,
    lengths: FloatArray,
    values: FloatArray,
    slope: float,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return min over points l of values_l + slope · geodesic distance, that distance, and l.

    l is -1 where no value reaches.
    """
    n = len(values)
    result = values.copy()
    carried = np.zeros(n)
    origin = np.full(n, -1)
    keys = np.empty(len(indices) + n + 1)
    heap = np.empty(len(indices) + n + 1, np.int64)
    size = 0
    for v in range(n):
        if values[v] < np.inf:
            origin[v] = v
            size = heap_push(keys, heap, size, values[v], v)
    while size > 0:
        near, v = keys[0], heap[0]
        size = heap_drop(keys, heap, size)
        if near > result[v]:
            continue
        for k in range(indptr[v], indptr[v + 1]):
            u = indices[k]
            far = near + slope * lengths[k]
            if far < result[u]:
                result[u] = far
                carried[u] = carried[v] + lengths[k]
                origin[u] = origin[v]
                size = heap_push(keys, heap, size, far, u)
    return result, carried, origin
